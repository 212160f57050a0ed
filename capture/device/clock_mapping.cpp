#include "capture/device/clock_mapping.h"

#include <algorithm>
#include <cmath>

namespace lightsketch {
namespace {

constexpr std::size_t kComparisons = 128;  // a minute at two a second: drift changes slower
constexpr double kDriftSigma = 100e-6;
constexpr double kMinSigma = 1e-6;  // seconds; a weight must be finite

}  // namespace

void ClockMapping::add(std::int64_t deviceTimeNs, TimePoint host, Duration sigma) {
  comparisons_.push_back({deviceTimeNs, host, std::max(kMinSigma, toSeconds(sigma))});
  if (comparisons_.size() > kComparisons) comparisons_.pop_front();
}

std::optional<ClockMapping::Mapped> ClockMapping::map(std::int64_t deviceTimeNs) const {
  if (comparisons_.empty()) return std::nullopt;
  // host - host0 = x + a + b x with x the device's seconds since the latest comparison. Only
  // differences of large numbers are turned to floating point.
  const Comparison& origin = comparisons_.back();
  const auto seconds = [&](std::int64_t time) {
    return 1e-9 * static_cast<double>(time - origin.deviceTimeNs);
  };
  double s0 = 0, sx = 0, sxx = 1 / (kDriftSigma * kDriftSigma), sy = 0, sxy = 0;
  double best = comparisons_.front().sigmaSeconds;
  for (const Comparison& c : comparisons_) {
    const double w = 1 / (c.sigmaSeconds * c.sigmaSeconds);
    const double x = seconds(c.deviceTimeNs);
    const double y = toSeconds(c.host - origin.host) - x;
    s0 += w;
    sx += w * x;
    sxx += w * x * x;
    sy += w * y;
    sxy += w * x * y;
    best = std::min(best, c.sigmaSeconds);
  }
  const double determinant = s0 * sxx - sx * sx;
  const double a = (sxx * sy - sx * sxy) / determinant;
  const double b = (s0 * sxy - sx * sy) / determinant;
  const double x = seconds(deviceTimeNs);
  const double variance = (sxx - 2 * sx * x + s0 * x * x) / determinant;
  return Mapped{origin.host + Duration(deviceTimeNs - origin.deviceTimeNs) + fromSeconds(a + b * x),
                fromSeconds(std::sqrt(variance + best * best))};
}

}  // namespace lightsketch
