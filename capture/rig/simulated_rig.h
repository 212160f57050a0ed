// The simulated rig: a scene camera and one or two source cameras on loopback addresses, looking at
// a still life that a simulated hand lights with a lamp, or at what their calibration needs.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "calibration/model/camera_model.h"
#include "calibration/model/rig_geometry.h"
#include "capture/frame/result.h"
#include "capture/rig/gige_device.h"
#include "capture/rig/held_board.h"
#include "capture/rig/rig_program.h"
#include "capture/rig/sensor.h"
#include "capture/rig/still_life.h"

namespace lightsketch {

struct SimulatedRigOptions {
  std::string sceneAddress = "127.0.0.11";
  std::string sourceAddress = "127.0.0.12";
  std::string secondSource;     // address of a second source camera, say 127.0.0.13; empty: none
  std::filesystem::path scene;  // a samples/*.json scene; empty: the built-in still life
  std::uint32_t seed = 1;
  double framesPerSecond = 12;
  double packetLoss = 0;
  // Frames rendered beforehand and served from memory in a loop, so that timing the program does
  // not time the ray caster. 0: traced live.
  int prerenderedFrames = 0;
  // What happens in front of the cameras at first. The feature "RigProgram" of any of them switches
  // it later, unless frames are rendered beforehand.
  RigProgram program = RigProgram::kLamp;
  RigBoard board;
  double ballRadiusMetres = 0.025;
  // How far from the subject the hand holds the lamp, wandering slowly in between.
  double minLampDistanceMetres = 0.9;
  double maxLampDistanceMetres = 0.9;
  // The lamp's power wanders by this share up and down.
  double lampPowerDrift = 0;
  // A matte white patch stands at the edge of the built-in still life.
  bool referencePatch = false;
  SensorFlaws sceneFlaws, sourceFlaws;
  bool stampFrames = false;  // the scene camera's, see readStamp
};

// A rectangle of the scene camera's picture, wholly on the face of the reference patch.
struct PatchTruth {
  Region pixels;
  Eigen::Vector3d centreInScene;  // of the face, whose normal is +z
  double albedo = 0;
};

// Ground truth, for tests and reports only; never part of what the pipeline sees.
struct LampTruth {
  double timeSeconds = 0;  // since the rig's start
  bool lit = false;
  bool visibleToSource = false;       // lit, inside the field, behind neither hand nor object
  Eigen::Vector3d lampInScene;        // metres
  Eigen::Vector3d directionInSource;  // unit, source camera frame
  double power = 1;                   // against the nominal lamp's
  // Per source camera; the first repeats the above.
  struct Seen {
    bool visible = false;
    Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();
  };
  std::vector<Seen> sources;
};

// The board's own frame is that of RigBoard.
struct BoardTruth {
  Eigen::Isometry3d sceneFromBoard = Eigen::Isometry3d::Identity();
  bool still = false;
};

// What darkness reads as in the scene camera's frames, in counts: known from its data sheet.
int sceneBlackLevelCounts(PixelFormat format);

class SimulatedRig {
 public:
  static Result<std::unique_ptr<SimulatedRig>> start(const SimulatedRigOptions& options = {});
  ~SimulatedRig();

  // What a careful calibration would have found: the closest Kannala-Brandt model to the true lens
  // (which is not of that family), and the cameras' poses.
  std::shared_ptr<const CameraModel> calibratedSourceModel(std::size_t source = 0) const;
  // `lampRadiusMetres` only where the hand keeps to one distance.
  RigGeometry geometry() const;
  std::size_t sourceCount() const;
  // Time zero of all truths, on the host's clock.
  TimePoint startTime() const;
  // Truth at a time since the start; times the hand has been simulated for only.
  LampTruth truthAt(double timeSeconds) const;
  RigProgram programAt(double timeSeconds) const;
  // Nothing while no board is shown.
  std::optional<BoardTruth> boardAt(double timeSeconds) const;
  // Of an inner corner of the bent board, board frame.
  Eigen::Vector3d boardCorner(int column, int row) const;
  // How long the board takes until its way repeats.
  double boardPeriodSeconds() const;
  ChromeBall mirrorBall() const;
  // What the lenses really do. Nothing outside a source camera's field.
  std::optional<Eigen::Vector3d> trueDirection(const Eigen::Vector2d& pixel,
                                               std::size_t source = 0) const;
  std::optional<Eigen::Vector2d> truePixel(const Eigen::Vector3d& directionInSource,
                                           std::size_t source = 0) const;
  // Nothing without a patch.
  std::optional<PatchTruth> referencePatch() const;
  // Light, as a fraction of the range at gain 0, that counts of a format stand for.
  double trueSceneSignal(PixelFormat format, double counts) const;
  double trueSourceSignal(PixelFormat format, double counts) const;
  // Pixels with a leak, as (column, row).
  std::vector<Eigen::Vector2i> sceneHotPixels() const;
  std::vector<Eigen::Vector2i> sourceHotPixels(std::size_t source = 0) const;
  // Relative illumination by the lens; 1 in the middle.
  double sceneFalloff(const Eigen::Vector2d& pixel) const;
  double sourceFalloff(const Eigen::Vector2d& pixel, std::size_t source = 0) const;
  // The scene camera is a pinhole with its centre in the middle of the picture.
  double sceneFocalLengthPixels() const;
  // Of all cameras together.
  std::uint64_t framesSent() const;
  // What goes wrong with a camera: 0 the scene camera, then the source cameras.
  void setFaults(std::size_t camera, const GigeFaults& faults);
  void unplug(std::size_t camera);
  // Fails if somebody has taken its address meanwhile.
  Result<void> plugIn(std::size_t camera);

 private:
  struct State;
  explicit SimulatedRig(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace lightsketch
