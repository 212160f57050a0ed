#include "capture/device/frame_clock.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>

namespace lightsketch {
namespace {

constexpr double kExposure = 0.005;
constexpr double kInterval = 0.125;

// A camera on a busy machine: packets come `overhead` after an exposure and then later by a random
// time, ten times as late for one in ten; the clock is latched twice a second.
struct World {
  FrameClock clock;
  double overhead = 0.015, jitter = 0.002;
  double clockOffset = 1000, drift = 50e-6;
  bool latch = true;
  double now = 0;
  std::mt19937 random{1};

  static TimePoint host(double seconds) {
    return TimePoint(std::chrono::hours(10)) + fromSeconds(seconds);
  }
  std::int64_t device(double seconds) const {
    return std::llround(1e9 * (seconds * (1 + drift) + clockOffset));
  }

  struct Seen {
    int frames = 0, mapped = 0, wrong = 0;
    double largestError = 0, lastSigma = 0;
  };
  // Frames for some seconds; `stamp` makes their time of the true one.
  Seen run(double seconds, const std::function<std::int64_t(double)>& stamp) {
    Seen seen;
    std::exponential_distribution<double> late(1 / jitter);
    for (const double end = now + seconds; now < end; now += kInterval) {
      if (latch && std::fmod(now, 0.5) < kInterval) {
        clock.compared(device(now), host(now + 1e-4 * std::sin(now)),
                       std::chrono::microseconds(50));
      }
      const double delay = late(random) * (random() % 10 == 0 ? 10 : 1);
      const double first = now + kExposure + overhead + delay;
      const auto mapped = clock.map(stamp(now), host(first), host(first + 0.01), kExposure);
      ++seen.frames;
      if (!mapped) continue;
      ++seen.mapped;
      const double error = std::abs(toSeconds(mapped->host - host(now)));
      seen.largestError = std::max(seen.largestError, error);
      seen.lastSigma = toSeconds(mapped->sigma);
      seen.wrong += error > 3 * seen.lastSigma;
    }
    return seen;
  }
  Seen run(double seconds) {
    return run(seconds, [this](double t) { return device(t); });
  }
};

TEST(FrameClock, FollowsTheLatch) {
  World world;
  const auto seen = world.run(20);
  EXPECT_EQ(seen.mapped, seen.frames);
  EXPECT_EQ(seen.wrong, 0);
  EXPECT_LT(seen.largestError, 3e-4);
  EXPECT_FALSE(world.clock.latchDisbelieved());
}

TEST(FrameClock, WithoutALatchItAdmitsTheOverheadAndTheJitter) {
  for (const double overhead : {0.0, 0.02}) {
    World world;
    world.latch = false;
    world.overhead = overhead;
    const auto first = world.run(0.1);
    EXPECT_EQ(first.wrong, 0) << overhead;
    EXPECT_GT(first.lastSigma, 0.05);  // of a single arrival
    const auto then = world.run(20);
    EXPECT_EQ(then.wrong, 0) << overhead;
    EXPECT_LT(then.lastSigma, 0.02);
    EXPECT_FALSE(world.clock.latchDisbelieved());
  }
}

TEST(FrameClock, TimesOfAnotherEpochAreMappedByArrivalsWithTheOverheadKnown) {
  World world;
  world.run(5);
  const auto foreign = [&](double t) { return world.device(t) + 1'000'000'000'000'000; };
  const auto doubt = world.run(1.8, foreign);
  EXPECT_EQ(doubt.mapped, 0);  // nobody knows yet
  const auto then = world.run(20, foreign);
  EXPECT_GT(then.mapped, then.frames - 6);
  EXPECT_EQ(then.wrong, 0);
  EXPECT_LT(then.lastSigma, 0.01);
  EXPECT_TRUE(world.clock.latchDisbelieved());
  // The epoch returns, and with it the latch.
  const auto doubtAgain = world.run(2.5);
  EXPECT_EQ(doubtAgain.wrong, 0);
  const auto back = world.run(10);
  EXPECT_EQ(back.mapped, back.frames);
  EXPECT_LT(back.largestError, 3e-4);
  EXPECT_FALSE(world.clock.latchDisbelieved());
}

TEST(FrameClock, FramesWithoutATimeAdmitTheirArrivals) {
  World world;
  world.run(5);
  const auto zero = [](double) { return std::int64_t{0}; };
  world.run(5, zero);
  const auto seen = world.run(20, zero);
  EXPECT_GT(seen.mapped, seen.frames / 2);
  EXPECT_EQ(seen.wrong, 0);
  EXPECT_GE(seen.lastSigma, 0.1);
}

TEST(FrameClock, AClockThatIsSetCostsFramesAndNoneIsWrong) {
  for (const bool latch : {true, false}) {
    World world;
    world.latch = latch;
    world.run(5);
    for (const double step : {700.0, -3.0, 0.4, -0.4}) {
      world.clockOffset += step;
      const auto seen = world.run(6);
      EXPECT_EQ(seen.wrong, 0) << latch << " " << step;
      EXPECT_GT(seen.mapped, seen.frames / 3) << latch << " " << step;
    }
  }
}

}  // namespace
}  // namespace lightsketch
