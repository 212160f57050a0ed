#include "capture/session/pairing.h"
#include "capture/frame/direction.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

namespace lightsketch {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kHistorySeconds = 10;
constexpr double kRadiusUncertainty = 0.05;
constexpr double kBendUncertainty = 0.5;
// A hand trembles at 8 to 12 Hz by a tenth of a degree (2 mm at arm's length), too fast for source
// frames to follow: between them that much is unknown, near them as much as it moves meanwhile.
constexpr double kTremorRadians = Angle::degrees(0.1).radians();
constexpr double kTremorRadiansPerSecond = 2 * std::numbers::pi * 10 * kTremorRadians;
constexpr double kSameLight = 1e-4;  // rays that miss each other so improbably are of two lights

Vector3d slerp(const Vector3d& a, const Vector3d& b, double f) {
  const double angle = angleBetween(a, b).radians();
  if (angle < 1e-9) return a;
  return ((std::sin((1 - f) * angle) * a + std::sin(f * angle) * b) / std::sin(angle)).normalized();
}

}  // namespace

void ObservationHistory::add(TimePoint time, TrackResult result) {
  {
    const std::lock_guard lock(mutex_);
    entries_.push_back({time, std::move(result.observation), std::move(result.reason)});
    while (toSeconds(time - entries_.front().time) > kHistorySeconds) entries_.pop_front();
  }
  changed_.notify_all();
}

void ObservationHistory::end() {
  {
    const std::lock_guard lock(mutex_);
    ended_ = true;
  }
  changed_.notify_all();
}

bool ObservationHistory::waitFor(TimePoint time, Duration patience) const {
  std::unique_lock lock(mutex_);
  return changed_.wait_for(lock, patience, [&] {
    return ended_ || (!entries_.empty() && entries_.back().time >= time);
  });
}

tl::expected<PairedLamp, PairingFailure> ObservationHistory::at(TimePoint time,
                                                                Duration timeUncertainty,
                                                                double maxSeconds) const {
  const std::lock_guard lock(mutex_);
  const auto after = std::find_if(entries_.begin(), entries_.end(),
                                  [&](const Entry& e) { return e.time >= time; });
  if (after == entries_.end() || after == entries_.begin()) {
    return tl::unexpected(PairingFailure::kUnpaired);
  }
  const auto before = std::prev(after);
  PairedLamp paired;
  paired.secondsToBefore = toSeconds(time - before->time);
  paired.secondsToAfter = toSeconds(after->time - time);
  if (std::max(paired.secondsToBefore, paired.secondsToAfter) > maxSeconds) {
    return tl::unexpected(PairingFailure::kUnpaired);
  }
  if (!before->observation || !after->observation) {
    return tl::unexpected(PairingFailure::kLampNotSeen);
  }
  const LampObservation& a = *before->observation;
  const LampObservation& b = *after->observation;
  const double span = paired.secondsToBefore + paired.secondsToAfter;
  const double f = paired.secondsToBefore / span;
  paired.radiansPerSecond = angleBetween(a.directionInSource, b.directionInSource).radians() / span;

  LampObservation& lamp = paired.lamp;
  lamp.time = time;
  const Vector3d straight = slerp(a.directionInSource, b.directionInSource, f);
  lamp.directionInSource = straight;
  lamp.originInSource = (1 - f) * a.originInSource + f * b.originInSource;
  lamp.beyondCalibration = a.beyondCalibration || b.beyondCalibration;
  lamp.pixel = (1 - f) * a.pixel + f * b.pixel;
  // A hand changes its speed by up to 450 degrees a second squared, which costs a straight line up
  // to 0.4 degrees at 12 frames a second: bend it by the frame before, where there is one.
  if (before != entries_.begin()) {
    const auto earlier = std::prev(before);
    const double gap = toSeconds(before->time - earlier->time);
    if (earlier->observation && gap < maxSeconds) {
      const Vector3d& e = earlier->observation->directionInSource;
      const Vector3d bend =
          ((b.directionInSource - a.directionInSource) / span - (a.directionInSource - e) / gap) /
          (span + gap);  // second divided difference
      const double past = paired.secondsToBefore;
      const double amount = past * (span - past);
      lamp.directionInSource =
          (straight - amount * (bend - bend.dot(straight) * straight)).normalized();
      lamp.pixel -= amount *
                    ((b.pixel - a.pixel) / span - (a.pixel - earlier->observation->pixel) / gap) /
                    (span + gap);
    }
  }
  lamp.covariance = (1 - f) * a.covariance + f * b.covariance;
  lamp.spreadPixels = (1 - f) * a.spreadPixels + f * b.spreadPixels;
  lamp.flux = (1 - f) * a.flux + f * b.flux;
  lamp.confidence = std::min(a.confidence, b.confidence);
  // The clocks' disagreement moves the lamp along its path.
  const double clock = toSeconds(timeUncertainty) / span;
  const Vector3d along = clock * (b.directionInSource - a.directionInSource);
  const Eigen::Vector2d alongPixel = clock * (b.pixel - a.pixel);
  const Matrix3d tangent =
      Matrix3d::Identity() - lamp.directionInSource * lamp.directionInSource.transpose();
  // What the bend changed is also a measure of what is still unknown.
  const Vector3d bent = kBendUncertainty * (lamp.directionInSource - straight);
  const double tremor =
      std::min(kTremorRadians,
               kTremorRadiansPerSecond * std::min(paired.secondsToBefore, paired.secondsToAfter));
  paired.interpolationCovariance =
      tangent * (bent * bent.transpose() + tremor * tremor * Matrix3d::Identity()) * tangent;
  lamp.directionCovariance = tangent *
                                 ((1 - f) * a.directionCovariance + f * b.directionCovariance +
                                  along * along.transpose()) *
                                 tangent +
                             paired.interpolationCovariance;
  lamp.covariance += alongPixel * alongPixel.transpose();
  return paired;
}

std::optional<std::pair<LampObservation, LampObservation>> ObservationHistory::latest() const {
  const std::lock_guard lock(mutex_);
  if (entries_.size() < 2) return std::nullopt;
  const Entry& last = entries_.back();
  const Entry& previous = entries_[entries_.size() - 2];
  if (!last.observation || !previous.observation) return std::nullopt;
  return std::pair(*previous.observation, *last.observation);
}

std::string ObservationHistory::trouble() const {
  const std::lock_guard lock(mutex_);
  return entries_.empty() ? std::string() : entries_.back().reason;
}

Result<LightDirection> lightAtSubject(std::span<const SeenLamp> seen, const RigGeometry& rig) {
  std::vector<LampRay> rays;
  for (const SeenLamp& one : seen) {
    rays.push_back(lampRay(rig.sourceCameras.at(one.camera), one.lamp.originInSource,
                           one.lamp.directionInSource, one.lamp.directionCovariance));
  }
  if (rays.size() > 1) {
    ASSIGN_OR_RETURN(const LampPosition lamp, triangulateLamp(rays));
    if (lamp.probability < kSameLight) {
      return failure(ErrorCode::kInvalidArgument,
                     "the source cameras see different lights, or their poses are off");
    }
    return lightDirectionOf(lamp);
  }
  const LampRay& ray = rays.at(0);
  if (rig.lampRadiusMetres) {
    const auto lamp =
        lampAtRadius(ray, *rig.lampRadiusMetres, kRadiusUncertainty * *rig.lampRadiusMetres);
    if (lamp) return lightDirectionOf(*lamp);
  }
  LightDirection light;
  light.direction = ray.direction;
  light.covariance = ray.directionCovariance;
  return light;
}

}  // namespace lightsketch
