// The simulated rig: a scene camera and a source camera on loopback addresses, looking at a still
// life that a simulated hand lights with a lamp.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "calibration/model/camera_model.h"
#include "calibration/model/rig_geometry.h"
#include "capture/frame/result.h"
#include "capture/rig/gige_device.h"

namespace lightsketch {

struct SimulatedRigOptions {
  std::string sceneAddress = "127.0.0.11";
  std::string sourceAddress = "127.0.0.12";
  std::filesystem::path scene;  // a samples/*.json scene; empty: the built-in still life
  std::uint32_t seed = 1;
  double framesPerSecond = 12;
  double packetLoss = 0;
  // Frames rendered beforehand and served from memory in a loop, so that timing the program does
  // not time the ray caster. 0: traced live.
  int prerenderedFrames = 0;
};

// Ground truth, for tests and reports only; never part of what the pipeline sees.
struct LampTruth {
  double timeSeconds = 0;  // since the rig's start
  bool lit = false;
  bool visibleToSource = false;       // lit, inside the field, behind neither hand nor object
  Eigen::Vector3d lampInScene;        // metres
  Eigen::Vector3d directionInSource;  // unit, source camera frame
};

// What darkness reads as in the scene camera's frames, in counts: known from its data sheet.
int sceneBlackLevelCounts(PixelFormat format);

class SimulatedRig {
 public:
  static Result<std::unique_ptr<SimulatedRig>> start(const SimulatedRigOptions& options = {});
  ~SimulatedRig();

  // What a careful calibration would have found: the closest Kannala-Brandt model to the true lens
  // (which is not of that family), and the cameras' poses.
  std::shared_ptr<const CameraModel> calibratedSourceModel() const;
  RigGeometry geometry() const;
  // Time zero of all truths, on the host's clock.
  TimePoint startTime() const;
  // Truth at a time since the start; times the hand has been simulated for only.
  LampTruth truthAt(double timeSeconds) const;
  // Of both cameras together.
  std::uint64_t framesSent() const;

 private:
  struct State;
  explicit SimulatedRig(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace lightsketch
