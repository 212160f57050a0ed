#include "capture/session/pairing.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace lightsketch {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kHistorySeconds = 10;
constexpr double kRadiusUncertainty = 0.05;
constexpr double kBendUncertainty = 0.5;

double angleBetween(const Vector3d& a, const Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

Vector3d slerp(const Vector3d& a, const Vector3d& b, double f) {
  const double angle = angleBetween(a, b);
  if (angle < 1e-9) return a;
  return ((std::sin((1 - f) * angle) * a + std::sin(f * angle) * b) / std::sin(angle)).normalized();
}

// Where the ray from `origin` leaves the sphere about the scene's origin.
std::optional<Vector3d> onSphere(const Vector3d& origin, const Vector3d& ray, double radius) {
  const double b = origin.dot(ray);
  const double discriminant = b * b - origin.squaredNorm() + radius * radius;
  if (discriminant < 0) return std::nullopt;
  const double distance = -b + std::sqrt(discriminant);
  if (distance <= 0) return std::nullopt;
  return Vector3d(origin + distance * ray);
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

void ObservationHistory::waitFor(TimePoint time, Duration patience) const {
  std::unique_lock lock(mutex_);
  changed_.wait_for(lock, patience,
                    [&] { return ended_ || (!entries_.empty() && entries_.back().time >= time); });
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
  paired.radiansPerSecond = angleBetween(a.directionInSource, b.directionInSource) / span;

  LampObservation& lamp = paired.lamp;
  lamp.time = time;
  const Vector3d straight = slerp(a.directionInSource, b.directionInSource, f);
  lamp.directionInSource = straight;
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
  lamp.directionCovariance = tangent *
                             ((1 - f) * a.directionCovariance + f * b.directionCovariance +
                              along * along.transpose() + bent * bent.transpose()) *
                             tangent;
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

LightDirection lightAtSubject(const LampObservation& lamp, const RigGeometry& rig) {
  const Eigen::Isometry3d& sceneFromSource = rig.sourceCameras.front().sceneFromCamera;
  const Vector3d origin = sceneFromSource.translation();
  const Vector3d ray = sceneFromSource.linear() * lamp.directionInSource;
  const Matrix3d covariance =
      sceneFromSource.linear() * lamp.directionCovariance * sceneFromSource.linear().transpose();
  LightDirection light;
  const std::optional<Vector3d> position =
      rig.lampRadiusMetres ? onSphere(origin, ray, *rig.lampRadiusMetres) : std::nullopt;
  if (!position) {
    light.direction = ray;
    light.covariance = covariance;
    return light;
  }
  light.position = position;
  light.direction = position->normalized();

  // d(direction at the subject) / d(direction at the camera) and / d(radius), by differences.
  const auto directionFor = [&](const Vector3d& r, double radius) {
    return onSphere(origin, r.normalized(), radius).value_or(*position).normalized();
  };
  constexpr double kStep = 1e-4;
  const double radius = *rig.lampRadiusMetres;
  Matrix3d jacobian;
  for (int axis = 0; axis < 3; ++axis) {
    const Vector3d step = kStep * Vector3d::Unit(axis);
    jacobian.col(axis) =
        (directionFor(ray + step, radius) - directionFor(ray - step, radius)) / (2 * kStep);
  }
  const Vector3d perRadius =
      (directionFor(ray, radius * (1 + kStep)) - directionFor(ray, radius * (1 - kStep))) /
      (2 * kStep);  // for a relative change
  light.covariance = jacobian * covariance * jacobian.transpose() +
                     kRadiusUncertainty * kRadiusUncertainty * perRadius * perRadius.transpose();
  return light;
}

}  // namespace lightsketch
