// One clock for everything: CLOCK_MONOTONIC. A frame's time is its mid-exposure.
#pragma once

#include <chrono>

namespace lightsketch {

using Clock = std::chrono::steady_clock;
using TimePoint = Clock::time_point;
using Duration = std::chrono::nanoseconds;
using Seconds = std::chrono::duration<double>;

inline double toSeconds(Duration duration) {
  return std::chrono::duration_cast<Seconds>(duration).count();
}
inline Duration fromSeconds(double seconds) {
  return std::chrono::duration_cast<Duration>(Seconds(seconds));
}

}  // namespace lightsketch
