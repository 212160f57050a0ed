// How a recording goes, from what became of its frames.
#pragma once

#include <cstddef>
#include <deque>
#include <optional>
#include <utility>

#include "capture/session/recorder.h"

namespace lightsketch {

// Times are those of the frames' decisions, in order.
class SketchPace {
 public:
  void add(const JudgedFrame& judged);
  // What to tell the person now: the fault that most frames of the last second had, unless enough
  // of them were kept all the same. A single bad frame is none of their business.
  std::optional<Refusal> trouble(TimePoint now) const;
  bool keptWithin(TimePoint now, double seconds) const;
  // Over the last half minute; 0 before the first.
  double keptPerMinute(TimePoint now) const;
  // In the busiest five seconds so far.
  double mostKeptPerSecond() const;

 private:
  std::ptrdiff_t keptSince(TimePoint now, double seconds) const;

  std::deque<std::pair<TimePoint, Refusal>> judged_;  // of the last second
  std::deque<TimePoint> kept_;                        // of the last half minute
  std::ptrdiff_t mostKept_ = 0;
  std::optional<TimePoint> first_;
};

}  // namespace lightsketch
