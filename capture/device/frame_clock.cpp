#include "capture/device/frame_clock.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "capture/frame/median.h"

namespace lightsketch {
namespace {

using std::chrono::milliseconds;

constexpr std::size_t kFrames = 16;  // that a typical delay is taken from
// From a frame's mapped time to its first packet it takes nearly always the same time. What differs
// by more than this has a wrong time, or comes from a computer too busy to tell.
constexpr auto kDelayTolerance = milliseconds(200);
constexpr auto kDoubt = std::chrono::seconds(2);  // then the latch is no longer believed
// By arrival, what lies between exposure and first packet: where frames timed by the latch told,
// and where nothing is known of the camera. Common ones take up to a readout.
constexpr auto kKnownOverhead = milliseconds(2);
constexpr auto kUnknownOverhead = milliseconds(10);
// A single arrival, and frames without any time of their own, come as late as the link and a busy
// machine make them: enough for a lamp that is held still, and a recording refuses the others.
constexpr auto kSingleArrival = milliseconds(100);
constexpr auto kComparisonInterval = std::chrono::seconds(1);

void keep(std::deque<Duration>& values, Duration value) {
  values.push_back(value);
  if (values.size() > kFrames) values.pop_front();
}
Duration medianOf(const std::deque<Duration>& values) {
  std::vector<Duration> copy(values.begin(), values.end());
  return median(copy);
}
Duration leastOf(const std::deque<Duration>& values) { return *std::ranges::min_element(values); }

// By how much the least of some delays exceeds the least possible one: a mean excess of m over it
// leaves m / n for the least of n (exact for exponential ones).
Duration leastsExcess(const std::deque<Duration>& delays) {
  if (delays.size() < 2) return kSingleArrival;
  const Duration least = leastOf(delays);
  Duration sum(0);
  for (const Duration delay : delays) sum += delay - least;
  const auto n = static_cast<long>(delays.size());
  return sum / (n * (n - 1));
}

}  // namespace

void FrameClock::compared(std::int64_t deviceTimeNs, TimePoint host, Duration sigma) {
  const auto expected = latch_.map(deviceTimeNs);
  const Duration error = expected ? host - expected->host : Duration(0);
  if (std::chrono::abs(error) > 5 * (sigma + kKnownOverhead)) latch_ = {};  // it has been set
  latch_.add(deviceTimeNs, host, sigma);
}

std::optional<ClockMapping::Mapped> FrameClock::map(std::int64_t deviceTimeNs,
                                                    TimePoint firstPacket, TimePoint arrival,
                                                    double exposureSeconds) {
  const Duration exposure = fromSeconds(exposureSeconds);
  auto mapped = latch_.map(deviceTimeNs);
  const bool agreed = mapped && agrees(*mapped, firstPacket, arrival, exposure);
  if (!mapped || disbelieved_) {
    mapped = byArrival(deviceTimeNs, firstPacket, exposure);
  } else if (!agreed) {
    mapped.reset();
  }
  lastTime_ = deviceTimeNs;
  return mapped;
}

bool FrameClock::agrees(const ClockMapping::Mapped& latched, TimePoint firstPacket,
                        TimePoint arrival, Duration exposure) {
  const Duration overhead = firstPacket - latched.host - exposure;
  const Duration usual = overheads_.empty() ? overhead : medianOf(overheads_);
  const bool early = arrival < latched.host + exposure - 5 * latched.sigma - kKnownOverhead;
  const bool late = arrival - latched.host - exposure > kDoubt;
  if (early || late || std::chrono::abs(overhead - usual) > kDelayTolerance) {
    agreeing_ = 0;
    if (!doubtSince_) doubtSince_ = arrival;
    if (!disbelieved_ && arrival - *doubtSince_ > kDoubt) {
      disbelieved_ = true;
      arrivals_ = {};
      offsets_.clear();
    }
    return false;
  }
  doubtSince_.reset();
  if (!disbelieved_ || ++agreeing_ >= static_cast<int>(kFrames)) {
    disbelieved_ = false;
    agreeing_ = 0;
    keep(overheads_, overhead);
  }
  return true;
}

// The lower envelope of arrival over the camera's time: the frame with the least delay says when
// its exposure began, give or take what its own delay exceeded the least possible one by.
std::optional<ClockMapping::Mapped> FrameClock::byArrival(std::int64_t deviceTimeNs,
                                                          TimePoint firstPacket,
                                                          Duration exposure) {
  const Duration overhead = overheads_.empty() ? Duration(0) : leastOf(overheads_);
  const TimePoint start = firstPacket - exposure - overhead;
  const Duration interval = firstPacket - std::exchange(lastFirstPacket_, firstPacket);
  if (lastTime_ == deviceTimeNs) {
    // No time of its own: only as long as frames come as regularly as they were taken.
    keep(intervals_, interval);
    const Duration usual = medianOf(intervals_);
    if (intervals_.size() < kFrames || std::chrono::abs(interval - usual) > usual / 4) return {};
    return ClockMapping::Mapped{start, kSingleArrival};
  }
  const auto expected = arrivals_.map(deviceTimeNs);
  const Duration delay = expected ? start - expected->host : Duration(0);
  // Nothing arrives before its time: what the mapping was made from was late.
  bool anew = !expected || delay < -2 * kKnownOverhead;
  bool wasSet = delay < -kDelayTolerance;
  if (delay > kDelayTolerance) {  // late, or the clock was set
    if (!lateSince_) lateSince_ = firstPacket;
    if (firstPacket - *lateSince_ < kDoubt) return {};
    wasSet = anew = true;
  }
  lateSince_.reset();
  if (wasSet) offsets_.clear();
  keep(offsets_, start.time_since_epoch() - Duration(deviceTimeNs));
  if (anew) arrivals_ = {};
  if (anew || Duration(deviceTimeNs - comparedAt_) > kComparisonInterval) {
    Duration sigma = kUnknownOverhead;
    if (!overheads_.empty()) sigma = kKnownOverhead + medianOf(overheads_) - overhead;
    arrivals_.add(deviceTimeNs, TimePoint(leastOf(offsets_) + Duration(deviceTimeNs)),
                  sigma + leastsExcess(offsets_));
    comparedAt_ = deviceTimeNs;
  }
  return arrivals_.map(deviceTimeNs);
}

}  // namespace lightsketch
