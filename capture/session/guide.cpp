#include "capture/session/guide.h"
#include "capture/frame/direction.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>

namespace lightsketch {
namespace {

using Eigen::Vector3d;

// A person's reaction and the way of a frame through the program, at first and at most.
constexpr double kFirstLeadSeconds = 0.3;
constexpr double kLongestLeadSeconds = 0.5;
constexpr double kLeadPerHit = 0.01;   // longer by this
constexpr double kLeadPerMiss = 0.85;  // shorter by this factor
constexpr double kMissedAfterSeconds = 0.8;
// In vain: longer than it takes to get there unhurriedly and to try for a while.
constexpr double kPatienceSeconds = 1.5;
constexpr double kUnseenSeconds = 0.7;
constexpr double kHoldSeconds = 5;
constexpr double kUnhurried = Angle::degrees(20).radians();  // a second
constexpr std::chrono::milliseconds kBetweenWrites{100};

}  // namespace

GuidePlan::GuidePlan(bool hold) : hold_(hold), leadSeconds_(kFirstLeadSeconds) {}

void GuidePlan::choose(const Coverage& coverage, double seconds, const Vector3d& from,
                       const Vector3d& heading) {
  std::vector<int> skip;
  for (const Passing& p : passing_) skip.push_back(p.cell);
  target_ = coverage.next(from, heading, skip);
  // Only cells that are being passed remain.
  if (!target_) target_ = coverage.next(from, heading);
  targetSince_ = seconds;
  if (target_) {
    const Vector3d& aim = coverage.grid().directions()[static_cast<std::size_t>(*target_)];
    allowedSeconds_ = kPatienceSeconds + angleBetween(lastSeen_, aim).radians() / kUnhurried +
                      (hold_ ? kHoldSeconds : 0);
  }
}

void GuidePlan::updateUnseen(const Coverage& coverage, double seconds) {
  if (!unseenSince_) unseenSince_ = seconds;
  if (target_ && seconds - *unseenSince_ > kUnseenSeconds) {
    // Where it is wanted it cannot be seen. Once: it may also have been put away.
    unseenSince_ = std::numeric_limits<double>::infinity();
    failed_.push_back(*target_);
    passing_.push_back({*target_, seconds + kMissedAfterSeconds});
    choose(coverage, seconds, lastSeen_, Vector3d::Zero());
    return;
  }
  follow(coverage, seconds, lastSeen_, Vector3d::Zero());
}

void GuidePlan::update(const Coverage& coverage, double seconds, const Vector3d& lamp,
                       const Vector3d& velocity) {
  unseenSince_.reset();
  follow(coverage, seconds, lamp, velocity);
}

void GuidePlan::follow(const Coverage& coverage, double seconds, const Vector3d& lamp,
                       const Vector3d& velocity) {
  lastSeen_ = lamp;
  std::erase_if(passing_, [&](const Passing& p) {
    if (coverage.captured(p.cell)) {
      leadSeconds_ = std::min(kLongestLeadSeconds, leadSeconds_ + kLeadPerHit);
      return true;
    }
    if (seconds <= p.until) return false;
    leadSeconds_ *= kLeadPerMiss;
    return true;
  });
  if (!target_ || coverage.captured(*target_)) {
    choose(coverage, seconds, lamp, velocity);
    return;
  }
  const Vector3d& aim = coverage.grid().directions()[static_cast<std::size_t>(*target_)];
  const Vector3d way = aim - lamp;
  const double closing = way.norm() > 0 ? velocity.dot(way.normalized()) : velocity.norm();
  if (!hold_ && closing > 0 && angleBetween(lamp, aim).radians() < leadSeconds_ * closing) {
    passing_.push_back({*target_, seconds + kMissedAfterSeconds});
    choose(coverage, seconds, aim, way);
  } else if (seconds - targetSince_ > allowedSeconds_) {
    failed_.push_back(*target_);
    passing_.push_back({*target_, seconds + kMissedAfterSeconds});
    choose(coverage, seconds, lamp, velocity);
  }
}

GuideWriter::GuideWriter(Camera& camera, std::function<void(const Error&)> onFirstFailure)
    : camera_(camera), onFirstFailure_(std::move(onFirstFailure)) {
  supported_ = camera_.hasFeature("GuideMode");
  if (supported_) thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
}

GuideWriter::~GuideWriter() = default;

void GuideWriter::stop() {
  thread_.request_stop();
  if (thread_.joinable()) thread_.join();
}

void GuideWriter::show(Mode mode, const Vector3d& target) {
  if (!supported_) return;
  {
    const std::lock_guard lock(mutex_);
    wish_ = Wish{mode, target};
  }
  changed_.notify_one();
}

void GuideWriter::run(const std::stop_token& stop) {
  std::optional<Wish> written;
  bool failed = false;
  while (!stop.stop_requested()) {
    Wish wish;
    {
      std::unique_lock lock(mutex_);
      if (!changed_.wait(lock, stop, [&] { return wish_ && wish_ != written; })) return;
      wish = *wish_;
    }
    if (auto status = write(wish)) {
      written = wish;
    } else if (!failed) {
      failed = true;  // tried again below, but said once
      onFirstFailure_(status.error());
    }
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, stop, kBetweenWrites, [] { return false; });
  }
}

Result<void> GuideWriter::write(const Wish& wish) {
  RETURN_IF_ERROR(camera_.setFeature("GuideX", wish.target.x()));
  RETURN_IF_ERROR(camera_.setFeature("GuideY", wish.target.y()));
  RETURN_IF_ERROR(camera_.setFeature("GuideZ", wish.target.z()));
  // Last: the camera acts on this one.
  return camera_.setFeature("GuideMode", static_cast<int>(wish.mode));
}

}  // namespace lightsketch
