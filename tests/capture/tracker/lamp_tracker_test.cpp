#include "capture/tracker/lamp_tracker.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>
#include <random>

#include "synthetic_room.h"

namespace lightsketch {
namespace {

constexpr double kFramesPerSecond = 12;

double degreesBetween(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return Angle::radians(std::atan2(a.cross(b).norm(), a.dot(b))).degrees();
}

// A hand that roams the half space z > 0 at about one metre: up to 45 degrees a second, with
// tremor.
Eigen::Vector3d handAt(double t, double phase = 0) {
  const double theta = 1.35 * std::abs(std::sin(0.31 * t + phase)) + 0.02 * std::sin(7 * t);
  const double phi = 0.55 * t + 0.3 * std::sin(0.9 * t + phase) + 0.02 * std::sin(9 * t + 1);
  const double distance = 1 + 0.08 * std::sin(0.7 * t) + 0.01 * std::sin(8 * t);
  return distance * Eigen::Vector3d(std::sin(theta) * std::cos(phi),
                                    std::sin(theta) * std::sin(phi), std::cos(theta));
}

struct Score {
  std::vector<double> errors;  // degrees, of every accepted observation
  int visible = 0;             // frames in which the lamp could have been seen whole
  int found = 0;
  double percentile(double p) {
    std::sort(errors.begin(), errors.end());
    return errors.empty()
               ? 1e9
               : errors[static_cast<std::size_t>(p * static_cast<double>(errors.size() - 1))];
  }
  int falseAccepts() const {
    return static_cast<int>(
        std::count_if(errors.begin(), errors.end(), [](double e) { return e > 2; }));
  }
};

void learn(LampTracker& tracker, SyntheticRoom& room, int frames = 10) {
  LampPicture dark;
  dark.lit = false;
  for (int i = 0; i < frames; ++i) {
    ASSERT_TRUE(tracker.learnBackground(room.draw(-1 + i / kFramesPerSecond, dark)));
  }
}

Score follow(LampTracker& tracker, SyntheticRoom& room, double seconds,
             const std::function<LampPicture(double)>& pictureAt, double start = 0) {
  Score score;
  for (double t = start; t < start + seconds; t += 1 / kFramesPerSecond) {
    const LampPicture picture = pictureAt(t);
    const auto result = tracker.track(room.draw(t, picture));
    EXPECT_TRUE(result);
    const bool whole =
        picture.lit && picture.covered == 0 && room.model()->project(picture.lamp).has_value();
    score.visible += whole ? 1 : 0;
    EXPECT_EQ(result->observation.has_value(), result->state == TrackState::kTracking);
    EXPECT_EQ(result->reason.empty(), result->state == TrackState::kTracking);
    if (!result->observation) continue;
    score.found += whole ? 1 : 0;
    const double error = degreesBetween(result->observation->directionInSource, picture.lamp);
    score.errors.push_back(picture.lit && picture.covered < 1 ? error : 180.0);
  }
  return score;
}

TEST(LampTracker, FollowsARoamingLampToASmallFractionOfADegree) {
  for (const PixelFormat format : {PixelFormat::kMono8, PixelFormat::kMono12}) {
    SyntheticRoom room(1, format);
    LampTracker tracker(room.model());
    learn(tracker, room);
    Score score = follow(tracker, room, 40, [](double t) {
      LampPicture picture;
      picture.lamp = handAt(t);
      return picture;
    });
    std::printf("roaming: median %.3f p95 %.3f max %.3f deg, found %d of %d\n",
                score.percentile(0.5), score.percentile(0.95), score.percentile(1), score.found,
                score.visible);
    // A pixel is 0.19 degrees wide; the spot is 8 pixels across and saturated inside.
    EXPECT_LT(score.percentile(0.5), 0.05);
    EXPECT_LT(score.percentile(0.95), 0.15);
    EXPECT_EQ(score.falseAccepts(), 0);
    EXPECT_GT(score.found, score.visible * 8 / 10);
  }
}

TEST(LampTracker, NeverTakesAReflectionForTheLampWhenTheLampIsCovered) {
  for (std::uint32_t seed = 1; seed <= 2; ++seed) {
    SyntheticRoom room(seed);
    LampTracker tracker(room.model());
    learn(tracker, room);
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> uniform(0, 1);
    // Covered for 0.3 to 3 seconds again and again, coming and going within 0.2 s.
    std::vector<std::pair<double, double>> covers;
    for (double t = 3; t < 60; t += 3 + 4 * uniform(random)) {
      covers.emplace_back(t, t + 0.3 + 2.7 * uniform(random));
    }
    int hiddenWithReflection = 0;
    Score score = follow(tracker, room, 60, [&](double t) {
      LampPicture picture;
      picture.lamp = handAt(t, seed);
      for (const auto& [from, to] : covers) {
        const double c = std::min({1.0, (t - from) / 0.2, (to - t) / 0.2});
        if (c > 0) picture.covered = std::max(picture.covered, c);
      }
      picture.coverAngle = t;
      if (picture.covered == 1) {
        for (const auto& [image, r] : room.reflections(picture.lamp)) {
          if (r > 0 && room.model()->project(image)) ++hiddenWithReflection;
        }
      }
      return picture;
    });
    std::printf(
        "covered: median %.3f p95 %.3f max %.3f deg, found %d of %d, %d lone "
        "reflections\n",
        score.percentile(0.5), score.percentile(0.95), score.percentile(1), score.found,
        score.visible, hiddenWithReflection);
    EXPECT_EQ(score.falseAccepts(), 0) << seed;
    EXPECT_LT(score.percentile(0.95), 0.5) << seed;
    EXPECT_GT(score.found, score.visible / 2) << seed;
    EXPECT_GT(hiddenWithReflection, 5) << "the test must tempt the tracker";
  }
}

TEST(LampTracker, APartlyCoveredLampIsRefusedOrItsCovarianceCoversTheBias) {
  SyntheticRoom room(3);
  LampTracker tracker(room.model());
  learn(tracker, room);
  int accepted = 0, withinThreeSigma = 0;
  for (double t = 0; t < 40; t += 1 / kFramesPerSecond) {
    LampPicture picture;
    picture.lamp = handAt(t);
    picture.covered = std::max(0.0, 0.8 * std::sin(1.3 * t));  // slow: no sudden step
    picture.coverAngle = 0.5 * t;
    const auto result = tracker.track(room.draw(t, picture));
    ASSERT_TRUE(result);
    if (!result->observation) continue;
    const auto& seen = *result->observation;
    const double error = degreesBetween(seen.directionInSource, picture.lamp);
    EXPECT_LT(error, 1.0) << t;
    if (error > 1) break;
    ++accepted;
    const double sigma = Angle::radians(std::sqrt(seen.directionCovariance.trace() / 2)).degrees();
    withinThreeSigma += error < 3 * sigma ? 1 : 0;
  }
  EXPECT_GT(accepted, 100);
  EXPECT_GT(withinThreeSigma, accepted * 9 / 10);
}

TEST(LampTracker, StaticLightsAreNeverTheLamp) {
  SyntheticRoom room(5);
  room.flicker = 1.8;  // mains flicker at a short exposure
  LampTracker tracker(room.model());
  learn(tracker, room, 16);
  // Lamp off, then passing right across both ceiling lamps, then off again.
  Score score = follow(tracker, room, 30, [&](double t) {
    LampPicture picture;
    picture.lit = t > 4 && t < 26;
    const auto& lamps = room.ceilingLamps();
    const double s = 0.5 + 0.6 * std::sin(0.8 * t);
    picture.lamp = ((1 - s) * lamps[0] + s * lamps[1]).normalized() +
                   0.01 * Eigen::Vector3d(std::sin(7 * t), std::cos(6 * t), 0);
    return picture;
  });
  std::printf("past lights: median %.3f p95 %.3f max %.3f deg, found %d of %d\n",
              score.percentile(0.5), score.percentile(0.95), score.percentile(1), score.found,
              score.visible);
  EXPECT_EQ(score.falseAccepts(), 0);
  EXPECT_LT(score.percentile(0.95), 0.5);
  EXPECT_GT(score.found, score.visible / 4);
}

TEST(LampTracker, ALightSwitchedOnInTheRoomIsNotTheLamp) {
  SyntheticRoom room(6);
  LampTracker tracker(room.model());
  learn(tracker, room);
  const auto roaming = [&](double t) {
    LampPicture picture;
    picture.lamp = handAt(t);
    return picture;
  };
  follow(tracker, room, 15, roaming);
  // The lamp is out of sight; somebody switches on one that is as bright and stands still.
  const Score score = follow(
      tracker, room, 5,
      [&](double) {
        LampPicture picture;
        picture.lamp = Eigen::Vector3d(0.2, -0.1, 1);
        return picture;
      },
      15);
  EXPECT_TRUE(score.errors.empty());
}

TEST(LampTracker, SaysLostWhenSwitchedOffAndFindsItAgain) {
  SyntheticRoom room(7);
  LampTracker tracker(room.model());
  learn(tracker, room);
  for (double t = 0; t < 20; t += 1 / kFramesPerSecond) {
    LampPicture picture;
    picture.lamp = handAt(t);
    picture.lit = !(t > 8 && t < 12);
    const auto result = tracker.track(room.draw(t, picture));
    ASSERT_TRUE(result);
    if (t > 8.1 && t < 12) {
      EXPECT_EQ(result->state, TrackState::kLost) << t;
      EXPECT_FALSE(result->reason.empty());
    }
    if (t > 12.5 && t < 13) {
      EXPECT_EQ(result->state, TrackState::kTracking) << t;
    }
  }
}

TEST(LampTracker, ALampThatWasOnWhileLearningIsNotInTheBackground) {
  SyntheticRoom room(8);
  LampTracker tracker(room.model());
  for (int i = 0; i < 16; ++i) {
    LampPicture picture;
    picture.lamp = handAt(5 + i / kFramesPerSecond);
    ASSERT_TRUE(tracker.learnBackground(room.draw(5 + i / kFramesPerSecond, picture)));
  }
  Score score = follow(
      tracker, room, 20,
      [](double t) {
        LampPicture picture;
        picture.lamp = handAt(t - 1.3);  // over the same places
        return picture;
      },
      6.4);
  EXPECT_GT(score.found, score.visible * 7 / 10);
  EXPECT_LT(score.percentile(0.95), 0.15);
}

TEST(LampTracker, LearnsFromItsFirstFramesIfNobodyTaughtIt) {
  SyntheticRoom room(9);
  LampTracker tracker(room.model());
  LampPicture picture;
  int learning = 0, tracking = 0;
  for (double t = 0; t < 4; t += 1 / kFramesPerSecond) {
    picture.lamp = handAt(t);
    const auto result = tracker.track(room.draw(t, picture));
    ASSERT_TRUE(result);
    learning += result->state == TrackState::kLearning ? 1 : 0;
    tracking += result->state == TrackState::kTracking ? 1 : 0;
  }
  EXPECT_EQ(learning, 8);
  EXPECT_GT(tracking, 20);
}

TEST(LampTracker, NothingBelowTheAllowedPlaneIsAccepted) {
  SyntheticRoom room(10);
  LampTrackerOptions options;
  options.allowedNormal = Eigen::Vector3d(0, -1, 0);  // above the table only
  options.allowedMinimum = 0;
  LampTracker tracker(room.model(), options);
  learn(tracker, room);
  for (double t = 0; t < 20; t += 1 / kFramesPerSecond) {
    LampPicture picture;
    picture.lamp = handAt(t);
    const auto result = tracker.track(room.draw(t, picture));
    ASSERT_TRUE(result);
    if (result->observation) {
      EXPECT_LE(result->observation->directionInSource.y(), 0);
    }
  }
  EXPECT_GT(tracker.trail().size(), 40u);
}

TEST(LampTracker, CovarianceIsTangentialAndHonest) {
  SyntheticRoom room(11);
  LampTrackerOptions options;
  options.trailLength = 50;
  LampTracker tracker(room.model(), options);
  learn(tracker, room);
  follow(tracker, room, 15, [](double t) {
    LampPicture picture;
    picture.lamp = handAt(t);
    return picture;
  });
  ASSERT_EQ(tracker.trail().size(), 50u);
  double squared = 0;
  for (const LampObservation& seen : tracker.trail()) {
    EXPECT_NEAR((seen.directionCovariance * seen.directionInSource).norm(), 0, 1e-9);
    EXPECT_GT(seen.confidence, 0.3);
    EXPECT_LE(seen.confidence, 1.0);
    const double t = toSeconds(seen.time.time_since_epoch());
    const double error = degreesBetween(seen.directionInSource, handAt(t));
    const double sigma = Angle::radians(std::sqrt(seen.directionCovariance.trace() / 2)).degrees();
    squared += error * error / (2 * sigma * sigma) / 50;
  }
  // Reduced chi-square: not overconfident, nor ten times too careful.
  EXPECT_LT(squared, 2);
  EXPECT_GT(squared, 0.01);
}

TEST(LampTracker, RefusesFramesThatCannotBeThisCameras) {
  SyntheticRoom room(12);
  LampTracker tracker(room.model());
  Frame frame = room.draw(0, {});
  frame.width = 480;
  EXPECT_EQ(tracker.track(frame).error().code, ErrorCode::kInvalidArgument);
  frame = room.draw(0, {});
  frame.format = PixelFormat::kBayerRG8;
  EXPECT_EQ(tracker.learnBackground(frame).error().code, ErrorCode::kUnsupported);
  frame.format = PixelFormat::kMono8;
  frame.bytes.pop_back();
  EXPECT_EQ(tracker.learnBackground(frame).error().code, ErrorCode::kCorrupt);
}

}  // namespace
}  // namespace lightsketch
