#include "capture/device/clock_mapping.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace lightsketch {
namespace {

using std::chrono::microseconds;

// A device clock that is `offset` seconds off and runs `ppm` fast.
struct Truth {
  double offset;
  double ppm;
  TimePoint zero{std::chrono::hours(1000)};

  TimePoint host(double seconds) const { return zero + fromSeconds(seconds); }
  std::int64_t device(double seconds) const {
    return (host(seconds).time_since_epoch() + fromSeconds(offset + 1e-6 * ppm * seconds)).count();
  }
};

TEST(ClockMapping, KnowsNothingBeforeTheFirstComparison) {
  EXPECT_FALSE(ClockMapping().map(0).has_value());
}

TEST(ClockMapping, ExactComparisonsGiveTheTrueLine) {
  const Truth truth{-77.25, 50};
  ClockMapping mapping;
  for (int i = 0; i < 10; ++i) mapping.add(truth.device(i), truth.host(i), microseconds(1));
  for (const double t : {0.5, 9.7, 11.0}) {
    const auto mapped = mapping.map(truth.device(t));
    ASSERT_TRUE(mapped);
    // The prior pulls the slope towards zero by 1e-6 of it: nothing next to a microsecond.
    EXPECT_LT(std::abs(toSeconds(mapped->host - truth.host(t))), 1e-6) << t;
  }
}

TEST(ClockMapping, AloneComparisonIsTrustedLessTheLongerAgoItWas) {
  const Truth truth{3, 0};
  ClockMapping mapping;
  mapping.add(truth.device(0), truth.host(0), microseconds(20));
  const auto now = mapping.map(truth.device(0));
  const auto later = mapping.map(truth.device(10));
  // 100 ppm of drift may have made 1 ms in 10 s.
  EXPECT_NEAR(toSeconds(later->sigma), 1e-3, 1e-4);
  EXPECT_LT(toSeconds(now->sigma), 50e-6);
  EXPECT_EQ(later->host, truth.host(10));
}

TEST(ClockMapping, OneSigmaIsHonestUnderNoise) {
  // Uniform errors of comparisons as a latch within a round trip makes them, now and then large.
  const Truth truth{1e4, -80};
  std::mt19937 random(7);
  int inside = 0, total = 0;
  double worst = 0;
  for (int run = 0; run < 100; ++run) {
    ClockMapping mapping;
    for (int i = 0; i < 20; ++i) {
      const double roundTrip = i % 7 == 3 ? 5e-3 : 200e-6;
      const double error = std::uniform_real_distribution<>(-roundTrip / 2, roundTrip / 2)(random);
      const double t = 0.5 * i;
      mapping.add(truth.device(t), truth.host(t + error),
                  fromSeconds(roundTrip / (2 * std::sqrt(3.0))));
    }
    const auto mapped = mapping.map(truth.device(9.8));
    const double error = std::abs(toSeconds(mapped->host - truth.host(9.8)));
    worst = std::max(worst, error);
    ++total;
    if (error <= toSeconds(mapped->sigma)) ++inside;
  }
  // At least the 68 percent that one sigma promises; the sigma errs towards caution.
  EXPECT_GE(inside, 68 * total / 100);
  EXPECT_LT(worst, 200e-6);  // never worse than one ordinary round trip
}

}  // namespace
}  // namespace lightsketch
