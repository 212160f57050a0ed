#include "ui/app/calibration_feed.h"

#include <utility>

namespace lightsketch {

void CalibrationFeed::publish(const LiveViewState& state) {
  const std::lock_guard lock(mutex_);
  state_ = state;
}

bool CalibrationFeed::ask(const std::string& wish, std::stop_token stop) {
  std::unique_lock lock(mutex_);
  question_ = QString::fromStdString(wish);
  answer_.reset();
  answered_.wait(lock, stop, [&] { return answer_.has_value(); });
  question_.clear();
  return answer_.value_or(false);
}

std::optional<LiveViewState> CalibrationFeed::take() {
  const std::lock_guard lock(mutex_);
  return std::exchange(state_, std::nullopt);
}

QString CalibrationFeed::question() const {
  const std::lock_guard lock(mutex_);
  return question_;
}

void CalibrationFeed::answer(bool go) {
  {
    const std::lock_guard lock(mutex_);
    answer_ = go;
  }
  answered_.notify_one();
}

}  // namespace lightsketch
