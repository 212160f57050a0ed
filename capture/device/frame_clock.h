// When a GenICam camera's frames were taken, by the host's clock.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "capture/device/clock_mapping.h"

namespace lightsketch {

// A frame brings the camera's time of its start of exposure. That is mapped by what latching the
// camera's clock says, as long as frames arrive when they then should. Otherwise (no latch, times
// of another clock or none) by when frames arrive: what lies between the end of an exposure and
// the first packet is known from frames that the latch had timed, or else admitted. Frames that
// agree with the latch again for a while bring it back. Not thread-safe.
class FrameClock {
 public:
  // A stream begins: the camera may have been replaced.
  void reset() { *this = {}; }

  // By latching: the camera's clock showed `deviceTimeNs` at `host`, one sigma.
  void compared(std::int64_t deviceTimeNs, TimePoint host, Duration sigma);

  // When a frame's exposure began; nothing where that cannot be right. In order of arrival.
  std::optional<ClockMapping::Mapped> map(std::int64_t deviceTimeNs, TimePoint firstPacket,
                                          TimePoint arrival, double exposureSeconds);

  // The camera can be latched, but its frames' times are not of that clock.
  bool latchDisbelieved() const { return disbelieved_; }

 private:
  // Whether a frame arrives when the latch lets expect it; keeps account of the belief in it.
  bool agrees(const ClockMapping::Mapped& latched, TimePoint firstPacket, TimePoint arrival,
              Duration exposure);
  std::optional<ClockMapping::Mapped> byArrival(std::int64_t deviceTimeNs, TimePoint firstPacket,
                                                Duration exposure);

  ClockMapping latch_;
  bool disbelieved_ = false;
  std::optional<TimePoint> doubtSince_;  // the latch
  int agreeing_ = 0;                     // frames in a row, while it is disbelieved
  std::deque<Duration> overheads_;       // from the mapped end of exposure to the first packet

  ClockMapping arrivals_;
  std::deque<Duration> offsets_;  // of the latest frames: host's time by arrival - camera's
  std::int64_t comparedAt_ = 0;
  std::optional<TimePoint> lateSince_;
  std::optional<std::int64_t> lastTime_;
  TimePoint lastFirstPacket_;
  std::deque<Duration> intervals_;  // without times: between frames
};

}  // namespace lightsketch
