// Maps a camera's own clock to the host's.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "capture/frame/time.h"

namespace lightsketch {

// The host's time as a line over the device's, by least squares over the latest comparisons, each
// weighted by its own error. Quartz is good for 100 ppm (kDriftSigma), which is what the slope is
// held to until the comparisons know better. Not thread-safe.
class ClockMapping {
 public:
  struct Mapped {
    TimePoint host;
    Duration
        sigma;  // one sigma, never below that of the best single comparison, because what the
                // comparisons have in common (unequal paths there and back) does not average out
  };

  // When the device's clock showed `deviceTimeNs`, the host's showed `host`, give or take `sigma`.
  void add(std::int64_t deviceTimeNs, TimePoint host, Duration sigma);
  // Nothing before the first comparison.
  std::optional<Mapped> map(std::int64_t deviceTimeNs) const;

 private:
  struct Comparison {
    std::int64_t deviceTimeNs;
    TimePoint host;
    double sigmaSeconds;
  };
  std::deque<Comparison> comparisons_;
};

}  // namespace lightsketch
