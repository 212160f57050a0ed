// One recording, between the recorder's thread and the screen.
#pragma once

#include <functional>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

#include "capture/session/recorder.h"

namespace lightsketch {

// Thread-safe. The recorder puts, the UI thread takes what came since it last looked: the newest
// state, and what became of each frame, so that none is missed however late the screen is.
class SketchSession {
 public:
  struct News {
    RecorderState state;
    std::vector<JudgedFrame> judged;  // oldest first
  };

  // `onNews` is called on the recorder's thread, once until take(); it must only wake somebody.
  explicit SketchSession(std::function<void()> onNews) : onNews_(std::move(onNews)) {}

  void put(const RecorderState& state) {
    const std::lock_guard lock(mutex_);
    const bool asleep = !news_;
    if (asleep) news_.emplace();
    if (state.judged) news_->judged.push_back(*state.judged);
    news_->state = state;
    if (asleep && onNews_) onNews_();
  }
  std::optional<News> take() {
    const std::lock_guard lock(mutex_);
    return std::exchange(news_, std::nullopt);
  }
  // Nobody is told any more.
  void close() {
    const std::lock_guard lock(mutex_);
    onNews_ = nullptr;
  }

  RecorderControl& control() { return control_; }

 private:
  RecorderControl control_;
  std::mutex mutex_;  // Guards everything below.
  std::function<void()> onNews_;
  std::optional<News> news_;
};

}  // namespace lightsketch
