#include "pipeline/relight/frame_rate_governor.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <random>

namespace lightsketch {
namespace {

constexpr double kTarget = 1.0 / 30;

struct Outcome {
  int late = 0;     // frames over the target
  int changes = 0;  // of the share
  double least = 1;
  double most = 0;
  double last = 0;
};

// Draws `frames` frames that take seconds(share, frame number).
Outcome simulate(FrameRateGovernor& governor, int frames,
                 const std::function<double(double, int)>& seconds) {
  Outcome result;
  for (int i = 0; i < frames; ++i) {
    const double share = governor.share();
    const double took = seconds(share, i);
    result.late += took > kTarget ? 1 : 0;
    result.last = governor.frame(took);
    result.changes += result.last != share ? 1 : 0;
    result.least = std::min(result.least, result.last);
    result.most = std::max(result.most, result.last);
  }
  return result;
}

// A frame costs `fixed` and, with all bases, `bases` more; both in parts of the target.
std::function<double(double, int)> load(double fixed, double bases) {
  return [=](double share, int) { return kTarget * (fixed + bases * share); };
}

TEST(FrameRateGovernor, LeavesAMachineAloneThatIsFastEnough) {
  FrameRateGovernor governor;
  const Outcome result = simulate(governor, 1000, load(0.1, 0.89));
  EXPECT_EQ(result.changes, 0);
  EXPECT_EQ(result.last, 1);
}

TEST(FrameRateGovernor, DropsBasesWithinAFewFrames) {
  for (const double bases : {1.2, 2.0, 8.0}) {
    FrameRateGovernor governor;
    const Outcome result = simulate(governor, 20, load(0.2, bases));
    EXPECT_LE(result.late, 6) << bases;
    // And no more than needed: what is left of the time is a fifth at most.
    EXPECT_GT(0.2 + bases * result.last, 0.8) << bases;
    EXPECT_LT(0.2 + bases * result.last, 1) << bases;
  }
}

TEST(FrameRateGovernor, DoesNotOscillateUnderSteadyLoad) {
  for (const double bases : {1.05, 1.5, 3.0, 7.0}) {
    FrameRateGovernor governor;
    simulate(governor, 200, load(0.2, bases));
    // 3000 frames are 100 seconds. Tries to rise become rare: one in 240 frames, each at most two
    // late frames and a way back.
    const Outcome result = simulate(governor, 3000, load(0.2, bases));
    EXPECT_LE(result.late, 40) << bases;
    EXPECT_LE(result.changes, 40) << bases;
    EXPECT_GT(result.least, 0.6 * 0.8 / bases) << bases;
  }
}

TEST(FrameRateGovernor, RestoresAllBasesWhenTheLoadIsGone) {
  FrameRateGovernor governor;
  simulate(governor, 3000, load(0.2, 7.0));
  ASSERT_LT(governor.share(), 0.2);
  const Outcome result = simulate(governor, 30, load(0.05, 0.5));
  EXPECT_EQ(result.late, 0);
  EXPECT_EQ(governor.share(), 1);
}

TEST(FrameRateGovernor, RestoresAllBasesEvenWithLittleToSpare) {
  // Frames of 0.85 to 0.98 of the target: nothing but a try shows that all bases fit.
  FrameRateGovernor governor;
  simulate(governor, 3000, load(0.2, 3.0));
  ASSERT_LT(governor.share(), 0.3);
  const Outcome result = simulate(governor, 1500, load(0.8, 0.18));
  EXPECT_EQ(result.late, 0);
  EXPECT_EQ(governor.share(), 1);
}

TEST(FrameRateGovernor, OneLateFrameIsNotALoad) {
  FrameRateGovernor governor;
  const auto hiccups = [](double share, int i) {
    return kTarget * (i % 20 == 19 ? 5 : 0.6 * share);
  };
  EXPECT_EQ(simulate(governor, 1000, hiccups).changes, 0);
}

TEST(FrameRateGovernor, HoldsTheTargetUnderNoise) {
  FrameRateGovernor governor;
  std::mt19937 random(1);
  std::normal_distribution<double> noise(1, 0.03);
  const auto noisy = [&](double share, int) { return kTarget * (0.1 + 2 * share) * noise(random); };
  simulate(governor, 100, noisy);
  const Outcome result = simulate(governor, 3000, noisy);
  EXPECT_LT(result.late, 150);  // one in twenty
  EXPECT_LT(result.changes, 80);
  EXPECT_GT(result.least, 0.3);
}

TEST(FrameRateGovernor, NeverGoesBelowTheSmallestShare) {
  FrameRateGovernor governor({.targetSeconds = kTarget, .smallestShare = 0.25});
  const Outcome result = simulate(governor, 500, load(2, 1));
  EXPECT_EQ(result.least, 0.25);
  EXPECT_EQ(governor.share(), 0.25);
}

}  // namespace
}  // namespace lightsketch
