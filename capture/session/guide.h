// Where the person is asked to hold the lamp, and telling it to a camera that can pass it on.
#pragma once

#include <Eigen/Core>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "capture/device/camera.h"
#include "capture/session/coverage.h"

namespace lightsketch {

// Chooses the next target ahead of time: a person needs a quarter of a second to react, so the next
// one is shown when the lamp is about to pass the present one. How long ahead is learnt from
// whether targets are hit or missed. Not thread-safe.
class GuidePlan {
 public:
  // `hold`: the lamp is to stay at each target until that is captured.
  explicit GuidePlan(bool hold = false);
  // `seconds` on any clock that never goes back; the lamp where it was seen last, and its velocity
  // in radians per second.
  void update(const Coverage& coverage, double seconds, const Eigen::Vector3d& lamp,
              const Eigen::Vector3d& velocity);
  // The lamp is not seen now.
  void updateUnseen(const Coverage& coverage, double seconds);
  std::optional<int> target() const { return target_; }
  // Cells that the lamp was sent to in vain since the last call.
  std::vector<int> takeFailed() { return std::exchange(failed_, {}); }

 private:
  struct Passing {
    int cell;
    double until;  // then it counts as missed and may be aimed for again
  };
  void follow(const Coverage& coverage, double seconds, const Eigen::Vector3d& lamp,
              const Eigen::Vector3d& velocity);
  void choose(const Coverage& coverage, double seconds, const Eigen::Vector3d& from,
              const Eigen::Vector3d& heading);
  const bool hold_;
  std::optional<int> target_;
  double leadSeconds_;
  std::optional<double> unseenSince_;
  double targetSince_ = 0;
  double allowedSeconds_ = 0;
  Eigen::Vector3d lastSeen_ = Eigen::Vector3d::UnitZ();
  std::vector<Passing> passing_;
  std::vector<int> failed_;
};

// Writes GuideMode and GuideX, GuideY, GuideZ on a thread of its own, at most ten times a second,
// the latest wish only. Does nothing for a camera without them.
class GuideWriter {
 public:
  enum class Mode { kLampOff = 1, kFollow = 2 };  // the values of the feature
  GuideWriter(Camera& camera, std::function<void(const Error&)> onFirstFailure);
  ~GuideWriter();
  bool supported() const { return supported_; }
  // Touches the camera no more once it returns.
  void stop();
  void show(Mode mode, const Eigen::Vector3d& target = Eigen::Vector3d::UnitZ());

 private:
  struct Wish {
    Mode mode;
    Eigen::Vector3d target;
    bool operator==(const Wish&) const = default;
  };
  void run(const std::stop_token& stop);
  Result<void> write(const Wish& wish);
  Camera& camera_;
  std::function<void(const Error&)> onFirstFailure_;
  bool supported_ = false;
  std::mutex mutex_;  // Guards wish_.
  std::condition_variable_any changed_;
  std::optional<Wish> wish_;
  std::jthread thread_;
};

}  // namespace lightsketch
