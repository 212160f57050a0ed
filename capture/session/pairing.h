// The lamp at the scene frame's time, from source frames before and after it.
#pragma once

#include <Eigen/Core>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <optional>
#include <span>
#include <string>

#include "calibration/model/rig_geometry.h"
#include "capture/frame/result.h"
#include "capture/tracker/lamp_tracker.h"
#include "pipeline/sketch/light_direction.h"

namespace lightsketch {

// The lamp between two source frames, interpolated: nearest pairing alone costs half a degree for a
// lamp at 28 degrees a second.
struct PairedLamp {
  LampObservation lamp;        // at the scene frame's time; confidence is the lower of both
  double secondsToBefore = 0;  // from the source frame before to the scene frame
  double secondsToAfter = 0;
  double radiansPerSecond = 0;  // the lamp's speed at the source camera
  // The part of lamp.directionCovariance that interpolating adds, which lamp.covariance lacks.
  Eigen::Matrix3d interpolationCovariance = Eigen::Matrix3d::Zero();
};

enum class PairingFailure { kUnpaired, kLampNotSeen };

// What the tracker said over the last seconds. Thread-safe: one thread adds, others ask.
class ObservationHistory {
 public:
  void add(TimePoint time, TrackResult result);
  // No more will come.
  void end();
  // Waits until a source frame at or after `time` was tracked or the history has ended; false if
  // `patience` was over before.
  bool waitFor(TimePoint time, Duration patience) const;
  tl::expected<PairedLamp, PairingFailure> at(TimePoint time, Duration timeUncertainty,
                                              double maxSeconds) const;
  // The two latest frames, if the lamp was seen in both: newest last.
  std::optional<std::pair<LampObservation, LampObservation>> latest() const;
  // Why the lamp was not seen in the latest frame; empty if it was.
  std::string trouble() const;

 private:
  struct Entry {
    TimePoint time;
    std::optional<LampObservation> observation;
    std::string reason;
  };
  mutable std::mutex mutex_;  // Guards everything below.
  mutable std::condition_variable changed_;
  std::deque<Entry> entries_;
  bool ended_ = false;
};

struct SeenLamp {
  std::size_t camera;  // index into RigGeometry::sourceCameras
  LampObservation lamp;
};

// From what source cameras see of the lamp at one time to the light that falls on the subject.
// Two and more: triangulated. One: on the sphere of the rig's lamp radius about the subject, a
// twentieth of it taken as its one-sigma uncertainty (parallax costs 5 degrees otherwise: the
// camera stands beside the subject); without a radius the lamp is taken to be far away. Fails where
// the cameras do not see the same light, or too near together to tell its distance.
Result<LightDirection> lightAtSubject(std::span<const SeenLamp> seen, const RigGeometry& rig);

}  // namespace lightsketch
