// What a camera sends, for tests to wait for.
#pragma once

#include <condition_variable>
#include <functional>
#include <mutex>
#include <optional>
#include <vector>

#include "capture/device/camera.h"

namespace lightsketch {

class TakenFrames {
 public:
  // Longer than any fault takes to show, on a machine that does other things too.
  static constexpr auto kPatience = std::chrono::seconds(30);

  // The camera may be started again and again.
  Result<void> start(Camera& camera) {
    {
      const std::lock_guard lock(mutex_);
      frames_.clear();
      end_.reset();
      ends_ = 0;
    }
    return camera.start(
        [this](Frame&& frame) {
          const std::lock_guard lock(mutex_);
          frames_.push_back(std::move(frame));
          changed_.notify_all();
        },
        [this](const Error& error) {
          const std::lock_guard lock(mutex_);
          end_ = error;
          ++ends_;
          changed_.notify_all();
        });
  }
  // False if that does not come in time.
  bool waitUntil(const std::function<bool(const std::vector<Frame>&)>& met) {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, kPatience, [&] { return met(frames_); });
  }
  // Of those to come from now on.
  bool waitForMore(std::size_t count) {
    std::unique_lock lock(mutex_);
    const std::size_t target = frames_.size() + count;
    return changed_.wait_for(lock, kPatience, [&] { return frames_.size() >= target; });
  }
  std::optional<Error> waitForEnd() {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, kPatience, [&] { return end_.has_value(); });
    return end_;
  }
  int ends() const {
    const std::lock_guard lock(mutex_);
    return ends_;
  }
  std::vector<Frame> frames() const {
    const std::lock_guard lock(mutex_);
    return frames_;
  }

 private:
  mutable std::mutex mutex_;  // Guards the following.
  std::condition_variable changed_;
  std::vector<Frame> frames_;
  std::optional<Error> end_;
  int ends_ = 0;
};

}  // namespace lightsketch
