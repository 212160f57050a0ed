// From a sketch to a relightable model: densify where captures are sparse, then factor in two
// stages.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "capture/frame/image.h"
#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/compress/model.h"
#include "pipeline/compress/near_light.h"
#include "pipeline/sketch/light_stack.h"
#include "pipeline/sketch/sketch.h"

namespace lightsketch {

enum class Quality { kSmall, kStandard, kArchive };
// As the command line calls it: "small", "standard", "archive".
const char* nameOf(Quality quality);

// The picture as the first stage makes it, for somebody who waits: each finished block under the
// model's light closest to `light`, in the block's own basis.
struct CompressWatch {
  Eigen::Vector3d light = Eigen::Vector3d::UnitZ();
  // The block's top left pixel and its part of the picture, linear RGB. Called by any thread, one
  // block after the other in no order; costs nothing where it is empty.
  std::function<void(int x, int y, RadianceImage&& block)> onBlock = {};
};

struct CompressOptions {
  int blockSize = 16;  // S, 2 to 64

  // What the model is to be; at most one, kStandard if nothing is said. Ranks and roundings are
  // then chosen by rate and distortion, and the model is a packed one.
  std::optional<Quality> quality = {};
  // The file's size: as good as can be, at least 98 percent of it are used where the pictures hold
  // so much.
  std::optional<std::uint64_t> budgetBytes = {};
  // 8-bit sRGB PSNR in dB, mean over a sample of the captured pictures: as small as can be.
  std::optional<double> psnr = {};

  // Or the paper's setting, if any of these is given.
  std::optional<int> blockRank = {};    // b, 10; 0, or more than there are pixels in a block: full
  std::optional<int> rank = {};         // q, 200; 0, or more than there can be: full
  std::optional<Storage> storage = {};  // half floats

  std::string holdOutRule = {};  // see applyHoldOut
  // Nodes of the hemispherical direction grid that the captured lights are densified to (those out
  // of reach of every captured light are left out).
  static constexpr int kDensifyAuto = -1;  // by the number of captures
  static constexpr int kDensifyOff = 0;    // the model's lights are the captured ones
  int densify = kDensifyAuto;
  // The subject's surface, for lamps too near to count as far away: every block then has light
  // directions of its own and every pixel its own distance, and the model is of far lights. Needs
  // lamp positions in the sketch; always densifies. Nothing: the lamps count as far away.
  std::shared_ptr<const SurfacePoints> surface = {};
  // The model holds square roots: better pictures of one lamp in as many bytes, but of one lamp
  // only.
  bool singleLamp = false;
  // For the strips of images being worked on. Stage 2 needs 3n floats per row of E and U besides.
  std::size_t memoryLimitBytes = 1'500'000'000;
  // Where the decoded images (6 bytes a pixel) wait; nothing is left there. Empty: the system's
  // temporary folder.
  std::filesystem::path scratchFolder = {};
  CompressWatch watch = {};

  bool papersSetting() const { return blockRank || rank || storage; }
  Result<void> validate() const;
};

// Of what a model's stored factors give back, against captured pictures that it was made from.
struct MeasuredError {
  int pictures = 0;       // spread over the captured ones
  double relative = 0;    // linear light: rms error / rms, over all of them
  double linearPsnr = 0;  // dB, against 1, over all of them
  double srgbPsnr = 0;    // dB, 8-bit sRGB, mean over pictures
};

struct CompressSummary {
  std::string setting;  // what was asked for, for people
  // Squared error per stored number that ranks and roundings were chosen for (see
  // rate_distortion.h), as a part of the captured energy per pixel; 0 in the paper's setting.
  double noise = 0;

  int captures = 0;  // frames the model was made from
  int heldOut = 0;
  int lights = 0;  // n of the model
  bool densified = false;
  bool nearLight = false;             // each block's own light directions and distances were used
  std::string capturesInterpolation;  // how, chosen by leave-one-out; empty if not densified
  int blocks = 0;                     // m
  int pixelsPerBlock = 0;             // p
  std::int64_t rows = 0;              // sum of b_j
  int rank = 0;                       // q
  bool exactSecondStage = false;      // else randomised
  // Fractions of the sum of squares that are kept.
  double stage1Energy = 0;
  double stage2Energy = 0;
  // The paper's compression ratios, values against values (equations 4 and 5): after the first
  // stage and after both.
  double ratioStage1 = 0;
  double ratio = 0;
  std::uint64_t capturedBytes = 0;     // the frames as half floats
  std::uint64_t modelBytes = 0;        // the file; in the paper's setting E, U and V
  std::optional<MeasuredError> error;  // not with near lights: their pictures are not the model's
  double readSeconds = 0;
  double stage1Seconds = 0;
  double stage2Seconds = 0;

  std::string describe() const;  // some lines for people
  Json toJson() const;
};

struct CompressResult {
  RelightableModel model;
  CompressSummary summary;
};

// Uses all cores; on one machine the result depends on nothing but its input, whatever the number
// of cores. Fails with kCancelled if `progress` says so, with kIo if the scratch folder is full.
Result<CompressResult> compress(const Sketch& sketch, const CompressOptions& options,
                                Progress& progress);
// The same from any stack, all of it; `options.holdOutRule` must be empty, and the model does not
// say which sketch it is of.
Result<CompressResult> compress(const LightStack& stack, const CompressOptions& options,
                                Progress& progress);

// Predicts pictures of this model under directions between its lights.
Result<DirectionInterpolator> interpolatorFor(const RelightableModel& model);

}  // namespace lightsketch
