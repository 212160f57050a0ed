// A sketch: one scene recorded under many light directions, as a folder that any program can read.
//
//   sketch.json    what was recorded, by what (written once, atomically)
//   rig.json       where the cameras stood (optional)
//   frames.jsonl   the journal, append-only, an event a line, each closed by its own checksum
//   frames/000123.exr   linear half RGB, light and exposure also in the header
//   ambient.exr    the scene without the lamp (optional)
//   room-1.exr     what the first source camera saw at the start, in HDR (with a bracket only)
//   calibration/   camera models used
//   lock           held by the one program that writes
//
// A frame counts as recorded only when its EXR is on disk and its journal line is written and
// synced. Nothing is ever rewritten: undo and corrections are events too.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "calibration/model/rig_geometry.h"
#include "capture/frame/image.h"
#include "capture/frame/json.h"
#include "capture/frame/result.h"
#include "capture/frame/time.h"
#include "pipeline/sketch/light_direction.h"

namespace lightsketch {

// The lamp as one source camera saw it.
struct LampPixel {
  std::string camera;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();  // pixels^2
};

struct FrameRecord {
  int id = 0;            // from 0 in journal order; never reused
  std::string file;      // relative to the sketch, "frames/000123.exr"
  std::string checksum;  // of that file
  std::string origin;    // an imported set's file name; empty for recorded frames
  LightDirection light;
  std::vector<LampPixel> lampPixels;
  std::string calibrationId;  // checksum of the camera model that gave `light`; empty if imported
  double exposureSeconds = 0;
  double gainDb = 0;
  // Factor per channel by which the lamp was stronger than the reference lamp; consumers divide by
  // it. Never baked into the pixels.
  std::array<double, 3> lampScale{1, 1, 1};
  double midExposureSeconds = 0;   // since the recording's start
  double pairingErrorSeconds = 0;  // scene frame's time against the source frames used
  double saturatedFraction = 0;    // of the scene frame's pixels
  Json gates = Json::object();     // what each gate measured
  bool dropped = false;
  std::string dropReason;
};

struct SketchManifest {
  int width = 0;
  int height = 0;
  int directions = 0;              // nodes of the direction grid aimed at; 0 for imported sets
  bool fullSphere = false;         // else the hemisphere z >= 0
  bool ambientSubtracted = false;  // recorded frames already are without the ambient light
  std::string software;            // name and version
  Json cameras = Json::array();    // {"role", "address", "model", "serial"}
  Json provenance = Json::object();
};

class Sketch {
 public:
  // Creates folder and files; the folder must not exist or be empty.
  static Result<Sketch> create(const std::filesystem::path& folder, const SketchManifest& manifest,
                               const std::optional<RigGeometry>& rig = std::nullopt);
  // Replays the journal. A torn last line (a crash while writing it: cut short, or with zeros in
  // it) was never acknowledged and is ignored; any other damaged line fails with file and line.
  // Changes nothing on disk.
  static Result<Sketch> open(const std::filesystem::path& folder);
  // As open(), ready to go on recording: cuts the torn line off (its id is used again), removes
  // images without a line and partial files. Fails while another program writes; the lock goes with
  // its process, however that ends.
  static Result<Sketch> openForAppend(const std::filesystem::path& folder);

  Sketch(Sketch&&) noexcept;
  Sketch& operator=(Sketch&&) noexcept;
  ~Sketch();

  const std::filesystem::path& folder() const;
  const SketchManifest& manifest() const;
  const std::optional<RigGeometry>& rig() const;
  // All frames in journal order, dropped ones included; frames()[i].id == i.
  const std::vector<FrameRecord>& frames() const;
  // Indices of frames that are not dropped.
  std::vector<int> activeFrames() const;

  // Not thread-safe; one thread records. `record`'s id, file and checksum are filled in. Returns
  // the id once the frame is durable.
  Result<int> append(FrameRecord record, const RadianceImage& radiance);
  // The same in bulk without a sync per frame; sync() makes all of them durable. For imports into a
  // folder that nobody sees before it is whole.
  Result<int> appendUnsynced(FrameRecord record, const RadianceImage& radiance);
  Result<void> sync();

  // Durable on return. Dropping a dropped frame and restoring one that is not say nothing.
  Result<void> drop(int id, const std::string& reason);
  Result<void> restore(int id);
  // Without `lampScale` the frame keeps its own.
  Result<void> relight(int id, const LightDirection& light, const std::string& calibrationId,
                       const std::optional<std::array<double, 3>>& lampScale = std::nullopt);
  Result<void> note(const std::string& text);

  Result<void> writeAmbient(const RadianceImage& radiance);
  // Nothing if none was recorded.
  Result<std::optional<RadianceImage>> readAmbient() const;
  // Verifies the checksum; the error names the file and the frame to drop. Thread-safe.
  Result<RadianceImage> readFrame(int id) const;

 private:
  struct State;
  explicit Sketch(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace lightsketch
