#include "capture/device/v4l2_time.h"

#include <numbers>

namespace lightsketch {
namespace {

constexpr auto kOldest = std::chrono::seconds(1);  // beside exposure and readout
// What interrupts and the camera's own overhead add; as AravisCamera admits without a latch.
constexpr auto kStampSigma = std::chrono::milliseconds(2);

}  // namespace

V4l2FrameTime v4l2FrameTime(V4l2Stamp kind, TimePoint stamp, TimePoint arrival, Duration exposure,
                            Duration frameInterval) {
  if (stamp > arrival || stamp < arrival - exposure - frameInterval - kOldest) {
    kind = V4l2Stamp::kNone;
  }
  switch (kind) {
    case V4l2Stamp::kExposureStart:
      return {stamp, kStampSigma};
    case V4l2Stamp::kReadoutStart:
      return {stamp - exposure, kStampSigma};
    case V4l2Stamp::kFrameEnd:
      break;
    case V4l2Stamp::kNone:
      stamp = arrival;
      break;
  }
  const Duration uniform = fromSeconds(toSeconds(frameInterval) / (2 * std::numbers::sqrt3));
  return {stamp - frameInterval / 2 - exposure, uniform + kStampSigma};
}

}  // namespace lightsketch
