// Measures a relightable model against captures that it has not seen.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "capture/frame/image.h"
#include "capture/frame/json.h"
#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/compress/model.h"
#include "pipeline/sketch/sketch.h"

namespace lightsketch {

struct ValidateOptions {
  std::string holdOutRule;  // must be the one the model was made with; empty: take the model's
  // For the superposition check: a lat-long map and its name; empty: a sky made by formula.
  RadianceImage environment;
  std::string environmentName;
  std::filesystem::path modelFile;  // for bytes and bits per pixel; empty: no size is reported
  double exposure = 1;              // factor on radiance before it becomes 8-bit sRGB
  int pictures = 9;                 // held-out lights that the report shows, worst to best
};

// The sky used where no environment is given, lat-long: blue overhead, a warm horizon and a soft
// bright patch at the upper right.
RadianceImage analyticSky();

struct PictureError {
  double psnr = 0;             // 8-bit sRGB, see psnr8
  std::optional<double> ssim;  // see ssim8
  double relative = 0;         // linear light, see linearError
  double linearPsnr = 0;
  bool identical = false;  // not one 8-bit sample differs
};

struct HeldOutLight {
  int id = 0;          // in the sketch
  std::string origin;  // imported file name, if any
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();
  bool insideHull = false;            // of the captured directions
  double nearestCapturedDegrees = 0;  // to the closest direction that the model was made from
  PictureError error;
};

// Means over images (each image counts the same).
struct MeanError {
  int count = 0;
  double psnr = 0;
  std::optional<double> ssim;
  double relative = 0;
  double linearPsnr = 0;
};

// 8-bit sRGB, possibly shrunk; difference is |relit - truth| x kDifferenceGain.
inline constexpr int kDifferenceGain = 4;
struct PictureTriple {
  Image<std::uint8_t> truth;
  Image<std::uint8_t> relit;
  Image<std::uint8_t> difference;
};

struct ShownLight {
  std::size_t light = 0;  // index into ValidationReport::lights
  PictureTriple pictures;
};

// The model's picture under an environment against the weighted sum of the original captures.
struct Superposition {
  std::string environment;
  double exposure = 1;  // chosen so that 99 percent of the sum's values show as 90 percent or less
  // The model lit by the same lamps: one per capture, as strong as its Voronoi cell is bright.
  PictureError sameLamps;
  // The model integrating the environment, as far as the captures cover it, over its own lights'
  // cells.
  PictureError ownCells;
  double coveredSolidAngle = 0;  // by the captures' cells, steradians
  PictureTriple pictures;        // of sameLamps
  // relight(s1 + s2) against relight(s1) + relight(s2), largest difference as a part of the largest
  // value.
  double linearity = 0;
};

struct ModelSize {
  std::uint64_t bytes = 0;
  double bitsPerPixel = 0;
  double ratioToHalf = 0;  // training captures as half-float RGB / bytes
  double ratioToFloat = 0;
};

struct ValidationReport {
  std::string sketch;
  std::string model;  // file name
  std::filesystem::path modelFile;
  std::string holdOutRule;
  std::string software;  // that made the model
  std::string interpolation;
  Json modelNotes;  // figures of the compression
  int width = 0;
  int height = 0;
  int captured = 0;  // images the model was made from
  int modelLights = 0;
  int rank = 0;
  std::int64_t basisRows = 0;  // sum of the blocks' ranks
  int blockSize = 0;
  std::string storage;
  double exposure = 1;

  std::vector<HeldOutLight> lights;     // by id
  std::vector<std::size_t> worstFirst;  // indices into lights, by PSNR
  MeanError all;
  MeanError inside;
  MeanError outside;
  std::optional<Superposition> superposition;  // not of single-lamp models: theirs do not add up
  std::optional<ModelSize> size;

  std::vector<Eigen::Vector3d> capturedDirections;
  std::vector<Eigen::Vector3d> hull;  // closed outline of the captured directions' hull
  double pictureExposure = 1;         // factor on radiance in the pictures shown
  int pictureShrink = 1;              // pictures shown at 1 / this
  std::vector<ShownLight> shown;      // worst to best

  const HeldOutLight& worst() const { return lights[worstFirst.front()]; }
  const HeldOutLight& median() const { return lights[worstFirst[(worstFirst.size() - 1) / 2]]; }
  const HeldOutLight& best() const { return lights[worstFirst.back()]; }

  // A short table for the command line.
  std::string describe() const;
};

// Every figure, as report.json holds it.
Json toJson(const ValidationReport& report);

// Factor on radiance at which 99 percent of the picture's values show as 90 percent grey or less.
double exposureToShow(const RadianceImage& picture);

// Frame `id` as captured, the model's picture under its light, and their difference, in full size,
// at `exposure`. `interpolator` is the model's (interpolatorFor).
Result<PictureTriple> heldOutPictures(const Sketch& sketch, const RelightableModel& model,
                                      const DirectionInterpolator& interpolator, int id,
                                      double exposure);

// Predicts every held-out frame from the model at its direction and compares. Refuses a model made
// with another hold-out rule, one that saw a held-out frame, and an empty hold-out. Uses all cores.
Result<ValidationReport> validate(const Sketch& sketch, const RelightableModel& model,
                                  const ValidateOptions& options, Progress& progress);

}  // namespace lightsketch
