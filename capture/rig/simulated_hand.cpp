#include "capture/rig/simulated_hand.h"
#include "capture/frame/direction.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <deque>
#include <mutex>
#include <numbers>
#include <random>
#include <vector>

namespace lightsketch {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kStep = 0.005;
constexpr double kDegree = std::numbers::pi / 180;

// Aimed movements of a hand that holds a lamp at arm's length.
constexpr double kReactionSeconds = 0.25;
constexpr double kReactionSpread = 0.04;
constexpr double kLampOffReactionSeconds = 0.3;
constexpr double kPeakSpeed = 60 * kDegree;          // per second
constexpr double kPassingSpeed = 28 * kDegree;       // with which a target is swept over
constexpr double kSpeedPerDistance = 1.8;            // per second
constexpr double kSpeedLag = 0.06;                   // seconds
constexpr double kPeakAcceleration = 450 * kDegree;  // per second squared
constexpr double kArrivalAngle = 1.5 * kDegree;
constexpr double kCoastSeconds = 0.22;    // decay of the speed after a target
constexpr double kPatienceSeconds = 0.4;  // then it turns back to the last target

constexpr double kTremorHertz = 9.5;
constexpr double kTremorAngle = 0.11 * kDegree;  // rms per axis
constexpr double kDriftAngle = 0.4 * kDegree;
constexpr double kDriftSeconds = 1.5;
constexpr double kRadiusWobble = 0.025;
constexpr double kRadiusSeconds = 3;

// Mean time between lapses, and how long each lasts.
constexpr double kPauseEvery = 20, kPauseMin = 0.4, kPauseMax = 1.2;
constexpr double kLeaveEvery = 40, kLeaveMin = 0.8, kLeaveMax = 1.8;
constexpr double kCoverEvery = 14, kCoverMin = 0.3, kCoverMax = 1.0;
constexpr double kCoverSlideSeconds = 0.08;

// Noise with a memory of `seconds` and unit variance.
class Wander {
 public:
  explicit Wander(double seconds) : keep_(std::exp(-kStep / seconds)) {}
  double next(double gaussian) {
    value_ = keep_ * value_ + std::sqrt(1 - keep_ * keep_) * gaussian;
    return value_;
  }

 private:
  double keep_;
  double value_ = 0;
};

// Narrow-band noise of unit variance: a second-order resonator driven by white noise.
class Tremor {
 public:
  double next(double gaussian) {
    constexpr double kRadius = 0.97;  // bandwidth about 2 Hz
    const double a1 = 2 * kRadius * std::cos(2 * std::numbers::pi * kTremorHertz * kStep);
    constexpr double a2 = -kRadius * kRadius;
    // Variance of an AR(2) process driven by unit noise.
    const double variance = (1 - a2) / ((1 + a2) * ((1 - a2) * (1 - a2) - a1 * a1));
    const double value = a1 * last_ + a2 * beforeLast_ + gaussian / std::sqrt(variance);
    beforeLast_ = last_;
    last_ = value;
    return value;
  }

 private:
  double last_ = 0;
  double beforeLast_ = 0;
};

// What was shown, and when the person acts on it.
struct Perceived {
  double timeSeconds;
  Guide guide;
};

}  // namespace

struct SimulatedHand::State {
  State(std::uint32_t seed, const HandOptions& theOptions) : options(theOptions), random(seed) {
    nextPause = exponential(kPauseEvery);
    nextLeave = 5 + exponential(kLeaveEvery);
    nextCover = 3 + exponential(kCoverEvery);
    direction = Vector3d(-0.35, -0.45, 0.8).normalized();
    path.push_back(LampState{true, 0, meanDistance(0) * direction});
    if (options.sweeps) chooseWaypoint();
  }

  // Two slow swings that never meet: the whole range within half a minute.
  double meanDistance(double t) const {
    const double swing = 0.6 * std::sin(0.47 * t + 0.4) + 0.4 * std::sin(0.83 * t + 2.1);
    return 0.5 * (options.minDistanceMetres + options.maxDistanceMetres) +
           0.5 * (options.maxDistanceMetres - options.minDistanceMetres) * swing;
  }

  double uniform(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
  }
  double exponential(double mean) {
    return std::exponential_distribution<double>(1 / mean)(random);
  }
  double gaussian() { return normal(random); }

  void act(const Guide& guide) {
    if (guide.mode == Guide::Mode::kFollow) {
      // A target below the table top is out of reach: the nearest place just above it.
      Vector3d wanted = guide.target.normalized();
      wanted.z() = std::max(wanted.z(), 0.01);
      if (!(mode == Guide::Mode::kFollow) || angleBetween(wanted, target).radians() > 1e-6)
        arrived = false;
      target = wanted.normalized();
    } else if (guide.mode == Guide::Mode::kWander && mode != Guide::Mode::kWander) {
      chooseWaypoint();
    }
    mode = guide.mode;
    lit = mode != Guide::Mode::kLampOff;
  }

  // Anywhere above the table, not too close: what a person does who covers the sky without a guide.
  void chooseWaypoint() {
    arrived = false;
    if (options.sweeps) {
      // Down from the zenith in four turns, and up again.
      constexpr int kTurns = 4, kPerTurn = 14, kWaypoints = kTurns * kPerTurn;
      const int place = waypoint++ % (2 * kWaypoints);
      const int i = place < kWaypoints ? place : 2 * kWaypoints - 1 - place;
      const double theta = 84 * kDegree * std::sqrt((i + 0.5) / kWaypoints);
      const double azimuth = 2 * std::numbers::pi * i / kPerTurn;
      target = Vector3d(std::sin(theta) * std::cos(azimuth), std::sin(theta) * std::sin(azimuth),
                        std::cos(theta));
      return;
    }
    for (int tries = 0; tries < 20; ++tries) {
      const double z = uniform(0.03, 1);
      const double azimuth = uniform(0, 2 * std::numbers::pi);
      const double r = std::sqrt(1 - z * z);
      target = Vector3d(r * std::cos(azimuth), r * std::sin(azimuth), z);
      const double angle = angleBetween(target, direction).radians();
      if (angle > 20 * kDegree && angle < 80 * kDegree) break;
    }
  }

  // The velocity (radians per second, tangent to the sphere) that the person wants now.
  Vector3d wantedVelocity(double t) {
    if (mode == Guide::Mode::kLampOff || t < pauseUntil) return Vector3d::Zero();
    const bool away = t < leaveUntil;
    const Vector3d aim = away ? Vector3d(direction.x(), direction.y(), -0.35).normalized() : target;
    const double distance = angleBetween(direction, aim).radians();
    Vector3d toAim = aim - aim.dot(direction) * direction;
    toAim = toAim.norm() > 1e-9 ? toAim.normalized() : Vector3d(Vector3d::Zero());
    if (away) return std::min(kPeakSpeed, 4 * distance) * toAim;

    // First approach: sweep over the target; the next one is expected to come in time.
    if (!arrived && distance < kArrivalAngle) {
      arrived = true;
      arrivedAt = t;
      velocityOnArrival = velocity;
      if (mode == Guide::Mode::kWander) chooseWaypoint();
    }
    if (!arrived) {
      return std::min(kPeakSpeed, kPassingSpeed + kSpeedPerDistance * distance) * toAim;
    }
    // No new target yet: coast a little, then turn back and stay.
    if (t - arrivedAt < kPatienceSeconds) {
      return std::exp(-(t - arrivedAt) / kCoastSeconds) * velocityOnArrival;
    }
    return std::min(kPeakSpeed, 4.5 * distance) * toAim;
  }

  void lapses(double t) {
    if (mode == Guide::Mode::kLampOff || options.sweeps) return;
    if (t > nextPause) {
      pauseUntil = t + uniform(kPauseMin, kPauseMax);
      nextPause = pauseUntil + exponential(kPauseEvery);
    }
    if (t > nextLeave) {
      leaveUntil = t + uniform(kLeaveMin, kLeaveMax);
      nextLeave = leaveUntil + 5 + exponential(kLeaveEvery);
      arrived = false;
    }
    if (t > nextCover) {
      coverUntil = t + uniform(kCoverMin, kCoverMax);
      nextCover = coverUntil + 2 + exponential(kCoverEvery);
    }
  }

  void step() {
    const double t = static_cast<double>(path.size()) * kStep;
    while (!perceived.empty() && perceived.front().timeSeconds <= t) {
      act(perceived.front().guide);
      perceived.pop_front();
    }
    lapses(t);

    // Muscles: the speed lags behind the wish and cannot change faster than they allow.
    Vector3d acceleration = (wantedVelocity(t) - velocity) / kSpeedLag;
    if (acceleration.norm() > kPeakAcceleration)
      acceleration *= kPeakAcceleration / acceleration.norm();
    velocity += kStep * acceleration;
    direction = (direction + kStep * velocity).normalized();
    velocity -= velocity.dot(direction) * direction;

    // What the hand adds without being asked.
    sideways = (sideways - sideways.dot(direction) * direction).normalized();
    const Vector3d& u = sideways;
    const Vector3d v = direction.cross(u);
    const double du =
        kTremorAngle * tremorU.next(gaussian()) + kDriftAngle * driftU.next(gaussian());
    const double dv =
        kTremorAngle * tremorV.next(gaussian()) + kDriftAngle * driftV.next(gaussian());
    Vector3d shaken = (direction + du * u + dv * v).normalized();
    const double radius =
        meanDistance(t) *
        (1 + std::clamp(kRadiusWobble * radiusWander.next(gaussian()), -0.08, 0.08));
    // The lamp does not go through the table, unless the person takes it away below its edge.
    if (t >= leaveUntil + 0.5 && shaken.z() < 0.005 && direction.z() > -0.02) shaken.z() = 0.005;

    const double slide = kStep / kCoverSlideSeconds;
    cover = std::clamp(cover + (t < coverUntil ? slide : -slide), 0.0, 1.0);
    path.push_back(LampState{lit, cover, radius * shaken.normalized()});
  }

  // Guards everything below.
  mutable std::mutex mutex;
  std::vector<LampState> path;  // at multiples of kStep
  std::deque<Perceived> perceived;

  HandOptions options;
  int waypoint = 0;
  std::mt19937 random;
  std::normal_distribution<double> normal;
  Tremor tremorU, tremorV;
  Wander driftU{kDriftSeconds}, driftV{kDriftSeconds}, radiusWander{kRadiusSeconds};

  Guide::Mode mode = Guide::Mode::kWander;
  bool lit = true;
  bool arrived = false;
  double arrivedAt = 0;
  Vector3d velocityOnArrival = Vector3d::Zero();
  Vector3d direction;
  Vector3d sideways = Vector3d::UnitX();  // tangent carried along without twisting
  Vector3d velocity = Vector3d::Zero();
  Vector3d target = Vector3d(0.3, -0.2, 0.9).normalized();
  double cover = 0;
  double pauseUntil = -1, leaveUntil = -1, coverUntil = -1;
  double nextPause, nextLeave, nextCover;
};

SimulatedHand::SimulatedHand(std::uint32_t seed, const HandOptions& options)
    : state_(std::make_unique<State>(seed, options)) {}
SimulatedHand::~SimulatedHand() = default;

void SimulatedHand::guide(const Guide& guide, double timeSeconds) {
  const std::lock_guard lock(state_->mutex);
  State& s = *state_;
  const double reaction = guide.mode == Guide::Mode::kLampOff
                              ? kLampOffReactionSeconds
                              : std::max(0.15, kReactionSeconds + kReactionSpread * s.gaussian());
  // In the order shown: a later wish never overtakes an earlier one.
  const double earliest = s.perceived.empty() ? 0 : s.perceived.back().timeSeconds;
  s.perceived.push_back({std::max(timeSeconds + reaction, earliest), guide});
}

void SimulatedHand::advanceTo(double timeSeconds) {
  const std::lock_guard lock(state_->mutex);
  while (static_cast<double>(state_->path.size() - 1) * kStep < timeSeconds) state_->step();
}

LampState SimulatedHand::at(double timeSeconds) const {
  const std::lock_guard lock(state_->mutex);
  const auto& path = state_->path;
  const double place = std::clamp(timeSeconds / kStep, 0.0, static_cast<double>(path.size() - 1));
  const auto before = static_cast<std::size_t>(place);
  const auto after = std::min(before + 1, path.size() - 1);
  const double f = place - static_cast<double>(before);
  LampState state = path[before];
  state.position = (1 - f) * path[before].position + f * path[after].position;
  state.cover = (1 - f) * path[before].cover + f * path[after].cover;
  return state;
}

LampState SpiralMotion::at(double timeSeconds) const {
  // Down from the zenith and up again, so that the loop closes; equal areas in equal times.
  const double turns = timeSeconds / periodSeconds_;
  const double phase = turns - std::floor(turns);
  const double z = 0.98 - 0.9 * (phase < 0.5 ? 2 * phase : 2 - 2 * phase);
  // No faster than a hand: a turn in 10 seconds.
  const double rounds = std::clamp(std::round(periodSeconds_ / 10), 1.0, 6.0);
  const double azimuth = 2 * std::numbers::pi * rounds * phase;
  const double r = std::sqrt(1 - z * z);
  return {true, 0, kLampDistanceMetres * Vector3d(r * std::cos(azimuth), r * std::sin(azimuth), z)};
}

}  // namespace lightsketch
