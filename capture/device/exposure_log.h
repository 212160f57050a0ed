// Which exposure setting a frame was taken with, when it can change while frames come.
#pragma once

#include <optional>
#include <utility>

#include "capture/frame/time.h"

namespace lightsketch {

// What a camera was told about its exposure.
struct ExposureSetting {
  double seconds = 0;
  double gainDb = 0;
};

// What a camera says of a frame itself (chunk data), where it can.
struct ToldExposure {
  std::optional<double> seconds;
  std::optional<double> gainDb;
};

// Decides by the host time at which a frame's exposure started. Not thread-safe.
class ExposureLog {
 public:
  // `settlingFrames`: how many frames that start after a change may still have the old setting.
  explicit ExposureLog(int settlingFrames) : settlingFrames_(settlingFrames) {}

  void reset(ExposureSetting setting) {
    current_ = setting;
    change_.reset();
  }
  // Around telling the camera: what happens between the two calls is in doubt.
  void beginChange() {
    if (!change_) change_ = Change{current_, Clock::now(), std::nullopt, settlingFrames_};
    change_->after.reset();
    change_->settling = settlingFrames_;
  }
  void endChange(ExposureSetting setting) {
    current_ = setting;
    change_->after = Clock::now();
  }
  // Nothing: in doubt.
  std::optional<ExposureSetting> of(TimePoint start, Duration sigma,
                                    const ToldExposure& told = {}) {
    const bool gainKnown = told.gainDb || !change_ || change_->previous.gainDb == current_.gainDb;
    if (told.seconds && gainKnown) {
      return ExposureSetting{*told.seconds, told.gainDb.value_or(current_.gainDb)};
    }
    if (!change_) return current_;
    const Duration margin = 3 * sigma + std::chrono::milliseconds(1);
    if (start + margin < change_->before) return change_->previous;
    if (!change_->after || start - margin < *change_->after) return std::nullopt;
    if (change_->settling-- > 0) return std::nullopt;
    change_.reset();
    return current_;
  }

  const ExposureSetting& current() const { return current_; }
  // Whether a change was begun before `time` that frames do not surely show yet.
  bool isChangingAt(TimePoint time) const { return change_ && change_->before < time; }

 private:
  struct Change {
    ExposureSetting previous;
    TimePoint before;
    std::optional<TimePoint> after;  // nothing: the camera is being told just now
    int settling;                    // frames still to be skipped
  };
  int settlingFrames_;
  ExposureSetting current_;
  std::optional<Change> change_;
};

}  // namespace lightsketch
