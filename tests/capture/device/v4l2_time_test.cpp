#include "capture/device/v4l2_time.h"

#include <gtest/gtest.h>

#include <cmath>

namespace lightsketch {
namespace {

using namespace std::chrono_literals;

constexpr Duration kExposure = 20ms;
constexpr Duration kInterval = 40ms;
const TimePoint kArrival{1000s};

V4l2FrameTime timeOf(V4l2Stamp kind, TimePoint stamp) {
  return v4l2FrameTime(kind, stamp, kArrival, kExposure, kInterval);
}

TEST(V4l2FrameTime, AStampTellsWhenExposureStarted) {
  const TimePoint stamp = kArrival - 30ms;
  EXPECT_EQ(timeOf(V4l2Stamp::kExposureStart, stamp).exposureStart, stamp);
  EXPECT_EQ(timeOf(V4l2Stamp::kReadoutStart, stamp).exposureStart, stamp - kExposure);
  // Readout took between nothing and an interval; 20 ms are in the middle.
  EXPECT_EQ(timeOf(V4l2Stamp::kFrameEnd, stamp).exposureStart, stamp - 20ms - kExposure);
  EXPECT_EQ(timeOf(V4l2Stamp::kNone, stamp).exposureStart, kArrival - 20ms - kExposure);
}

// The true start lies anywhere in an interval: a uniform distribution's sigma is its length over
// the root of 12, 11.5 ms here, and the stamp's own error adds to it.
TEST(V4l2FrameTime, SigmaGrowsWithWhatTheStampLeavesOpen) {
  const TimePoint stamp = kArrival - 30ms;
  const double sharp = toSeconds(timeOf(V4l2Stamp::kExposureStart, stamp).sigma);
  EXPECT_GT(sharp, 0);
  EXPECT_EQ(toSeconds(timeOf(V4l2Stamp::kReadoutStart, stamp).sigma), sharp);
  for (const V4l2Stamp kind : {V4l2Stamp::kFrameEnd, V4l2Stamp::kNone}) {
    EXPECT_NEAR(toSeconds(timeOf(kind, stamp).sigma), 0.040 / std::sqrt(12.0) + sharp, 1e-6);
  }
}

TEST(V4l2FrameTime, ImpossibleStampsAreNotBelieved) {
  const V4l2FrameTime byArrival = timeOf(V4l2Stamp::kNone, kArrival);
  for (const TimePoint stamp :
       {TimePoint{}, kArrival + 1ms, kArrival + 35ms, TimePoint{1'700'000'000s}, kArrival - 1100ms,
        TimePoint::min(), TimePoint::max()}) {
    for (const V4l2Stamp kind :
         {V4l2Stamp::kExposureStart, V4l2Stamp::kReadoutStart, V4l2Stamp::kFrameEnd}) {
      EXPECT_EQ(timeOf(kind, stamp).exposureStart, byArrival.exposureStart);
      EXPECT_EQ(timeOf(kind, stamp).sigma, byArrival.sigma);
    }
  }
  // Late, because the machine was busy, is believed.
  EXPECT_EQ(timeOf(V4l2Stamp::kExposureStart, kArrival - 900ms).exposureStart, kArrival - 900ms);
}

}  // namespace
}  // namespace lightsketch
