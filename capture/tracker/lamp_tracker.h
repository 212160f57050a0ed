// Finds the hand-held lamp in the source camera's frames and follows it.
#pragma once

#include <Eigen/Core>
#include <deque>
#include <memory>
#include <optional>
#include <string>

#include "calibration/model/camera_model.h"
#include "capture/frame/frame.h"
#include "capture/frame/result.h"

namespace lightsketch {

struct LampObservation {
  TimePoint time;                     // mid-exposure
  Eigen::Vector2d pixel;              // sub-pixel centroid
  Eigen::Matrix2d covariance;         // pixels^2, one sigma
  double spreadPixels = 0;            // rms radius of the blob
  double flux = 0;                    // sum of the blob above background, in units of saturation
  double confidence = 0;              // 0..1
  Eigen::Vector3d directionInSource;  // unit, source camera frame, from the camera to the lamp
  // A point of that ray, metres; not 0 for a lens whose pupil moves.
  Eigen::Vector3d originInSource = Eigen::Vector3d::Zero();
  Eigen::Matrix3d directionCovariance;  // rank 2, radians^2; pixel noise and the lens's own
  bool beyondCalibration = false;       // the lens was never calibrated there; do not trust it
};

enum class TrackState {
  kLearning,   // the static lights are not known yet
  kTracking,   // `observation` is the lamp
  kLost,       // no lamp: covered, out of the field, switched off
  kAmbiguous,  // something is lit, but it may be a reflection or a static light
};

struct TrackResult {
  TrackState state = TrackState::kLearning;
  std::optional<LampObservation> observation;  // only in kTracking
  std::string reason;                          // for the other states, for the user
};

struct LampTrackerOptions {
  // Directions (source camera frame) where a lamp can be at all; anything else is a reflection. The
  // plane through the camera: n . direction >= minimum. Default: no restriction.
  Eigen::Vector3d allowedNormal = Eigen::Vector3d::Zero();
  double allowedMinimum = -1;
  double blackLevel = 0;  // counts of the frames' format
  std::size_t trailLength = 4096;
};

// One source camera's tracker. Rather reports nothing than a reflection: see README.md for the
// tests that a bright spot must pass. Not thread-safe: one thread feeds it.
class LampTracker {
 public:
  LampTracker(std::shared_ptr<const CameraModel> model, LampTrackerOptions options = {});
  ~LampTracker();
  LampTracker(LampTracker&&) noexcept;
  LampTracker& operator=(LampTracker&&) noexcept;

  // Frames without the lamp teach the static lights (ceiling lamps, windows); the last 16 count,
  // and a lamp that moves through a minority of them is taken out. Without any, track() learns from
  // its own first frames.
  Result<void> learnBackground(const Frame& frame);
  // Frames in time order. Fails only for a frame of another shape than the model's, or in colour.
  Result<TrackResult> track(const Frame& frame);

  const std::deque<LampObservation>& trail() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace lightsketch
