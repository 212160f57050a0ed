// Faults of known size, injected into an analytic set, are found with their size.
#include "pipeline/validate/frame_check.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <set>

#include "capture/frame/direction.h"
#include "pipeline/validate/frame_check_report.h"

namespace lightsketch {
namespace {

using Eigen::Vector3d;

constexpr int kSide = 48;
constexpr int kFrames = 160;  // 7 degrees apart over the cap

// A matte ball on a matte table, a far lamp: albedo max(0, n . l). The ball has attached shadows,
// so that pictures are not linear in the direction.
RadianceImage ballPicture(const Vector3d& light) {
  RadianceImage picture(kSide, kSide, 3);
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const double px = (2.0 * x + 1) / kSide - 1;
      const double py = 1 - (2.0 * y + 1) / kSide;
      const double squared = 0.49 - px * px - py * py;
      const Vector3d normal =
          squared > 0 ? Vector3d(px, py, std::sqrt(squared)) / 0.7 : Vector3d(0, 0, 1);
      for (int c = 0; c < 3; ++c) {
        picture(x, y, c) = static_cast<float>((0.7 - 0.15 * c) * std::max(0.0, normal.dot(light)));
      }
    }
  }
  return picture;
}

struct TestSet {
  std::vector<Vector3d> directions;
  std::vector<RadianceImage> images;

  TestSet() {
    for (int i = 0; i < kFrames; ++i) {
      const double z = 1 - 0.75 * (i + 0.5) / kFrames;
      const double turn = i * std::numbers::pi * (3 - std::sqrt(5.0));
      const double r = std::sqrt(1 - z * z);
      add({r * std::cos(turn), r * std::sin(turn), z});
    }
  }
  void add(const Vector3d& direction) {
    directions.push_back(direction);
    images.push_back(ballPicture(direction));
  }
  LightStack stack() const {
    return LightStack::of(kSide, kSide, directions, [this](int i) -> Result<RadianceImage> {
      return images[static_cast<std::size_t>(i)];
    });
  }
  FrameCheck check() const {
    SilentProgress quiet;
    auto result = checkFrames(stack(), {}, quiet);
    EXPECT_TRUE(result) << result.error().message;
    return *result;
  }
  void scale(std::size_t i, double gain) {
    for (float& value : images[i].values()) value *= static_cast<float>(gain);
  }
  void darken(std::size_t i, int x0, int x1, double factor) {
    for (int y = 0; y < kSide; ++y) {
      for (int x = x0; x < x1; ++x) {
        for (int c = 0; c < 3; ++c) images[i](x, y, c) *= static_cast<float>(factor);
      }
    }
  }
  // Says that frame i was lit from `degrees` beside where it was.
  void turn(std::size_t i, double degrees, double azimuth) {
    const Vector3d u = directions[i].unitOrthogonal();
    const Vector3d axis = std::cos(azimuth) * u + std::sin(azimuth) * directions[i].cross(u);
    directions[i] = Eigen::AngleAxisd(Angle::degrees(degrees).radians(), axis) * directions[i];
  }
};

int alarmsBeside(const FrameCheck& check, const std::set<std::size_t>& faults) {
  int alarms = 0;
  for (std::size_t i = 0; i < check.frames.size(); ++i) {
    alarms += check.frames[i].fault != FrameFault::kNone && !faults.contains(i);
  }
  return alarms;
}

// Of 160 frames; at z of 3 a Gaussian figure would give one in 370.
constexpr int kFewAlarms = 3;

TEST(FrameCheck, LeavesACleanSetAlone) {
  const FrameCheck check = TestSet().check();
  ASSERT_EQ(check.frames.size(), std::size_t{kFrames});
  EXPECT_LE(alarmsBeside(check, {}), kFewAlarms);
  EXPECT_NEAR(check.spacing.degrees(), 9, 2);  // sqrt(2 pi 0.75 / 160) is 9.8 degrees
}

TEST(FrameCheck, MeasuresAnExposureJump) {
  TestSet set;
  set.scale(30, 0.7);
  set.scale(90, 1.5);
  const FrameCheck check = set.check();
  // Neighbours predict a matte ball's brightness to a percent or two.
  EXPECT_EQ(check.frames[30].fault, FrameFault::kExposure);
  EXPECT_NEAR(check.frames[30].gain, 0.7, 0.03);
  EXPECT_EQ(check.frames[90].fault, FrameFault::kExposure);
  EXPECT_NEAR(check.frames[90].gain, 1.5, 0.06);
  EXPECT_TRUE(check.frames[90].correctable);
  EXPECT_LE(alarmsBeside(check, {30, 90}), kFewAlarms);
}

TEST(FrameCheck, FindsTheDirectionThatAPictureWasTakenUnder) {
  TestSet set;
  const TestSet truth;
  set.turn(25, 5, 0.4);
  set.turn(70, 5, 2.5);
  const FrameCheck check = set.check();
  for (const std::size_t i : {25, 70}) {
    const FrameVerdict& frame = check.frames[i];
    EXPECT_EQ(frame.fault, FrameFault::kDirection) << i;
    EXPECT_TRUE(frame.correctable) << i;
    // A fifth of the fault; lights are 9 degrees apart.
    EXPECT_LT(angleBetween(frame.fitted, truth.directions[i]).degrees(), 1) << i;
    EXPECT_NEAR(frame.shift.degrees(), 5, 1) << i;
  }
  EXPECT_LE(alarmsBeside(check, {25, 70}), kFewAlarms);
}

TEST(FrameCheck, FindsAShadowAndWhereItLies) {
  TestSet set;
  set.darken(40, 12, 27, 0.2);  // 31 % of the picture
  const FrameCheck check = set.check();
  const FrameVerdict& frame = check.frames[40];
  EXPECT_EQ(frame.fault, FrameFault::kShadow);
  EXPECT_FALSE(frame.correctable);
  // Cells are 0.03 of the picture wide and half-covered ones count, and on the ball's dark side
  // there is nothing to darken.
  EXPECT_NEAR(frame.darkPart, 0.31, 0.06);
  EXPECT_NEAR(frame.darkBox[0], 0.25, 0.04);
  EXPECT_NEAR(frame.darkBox[2], 0.31, 0.07);
  EXPECT_LE(alarmsBeside(check, {40}), kFewAlarms);
}

// A hand at rest under one's own shadow: ten twins that agree with each other.
TEST(FrameCheck, TwinsDoNotVouchForEachOther) {
  TestSet set;
  const Vector3d at = Vector3d(0.45, 0.1, 0.85).normalized();
  std::set<std::size_t> faults;
  for (int k = 0; k < 10; ++k) {
    set.add((at + 1e-3 * Vector3d(std::cos(k), std::sin(k), 0)).normalized());
    faults.insert(set.images.size() - 1);
    set.darken(set.images.size() - 1, 20, 40, 0.25);
  }
  const FrameCheck check = set.check();
  for (const std::size_t i : faults) EXPECT_EQ(check.frames[i].fault, FrameFault::kShadow) << i;
  EXPECT_LE(alarmsBeside(check, faults), kFewAlarms);
}

TEST(FrameCheck, ATenthOfFaultsHidesNone) {
  TestSet set;
  std::set<std::size_t> faults;
  for (std::size_t k = 0; k < 15; ++k) {
    const std::size_t i = 5 + 10 * k;  // spread over the cap, some beside each other
    faults.insert(i);
    if (k % 3 == 0) set.scale(i, k % 2 == 0 ? 0.65 : 1.4);
    if (k % 3 == 1) set.turn(i, 5, 0.7 * static_cast<double>(k));
    if (k % 3 == 2) set.darken(i, static_cast<int>(k), static_cast<int>(k) + 16, 0.2);
  }
  const FrameCheck check = set.check();
  for (const std::size_t i : faults) EXPECT_NE(check.frames[i].fault, FrameFault::kNone) << i;
  EXPECT_LE(alarmsBeside(check, faults), kFewAlarms);
}

TEST(FrameCheck, PredictsWhatTheFrameShouldLookLike) {
  TestSet set;
  set.darken(40, 12, 27, 0.2);
  const FrameCheck check = set.check();
  const RadianceImage truth = ballPicture(set.directions[40]);
  double predicted = 0;
  ASSERT_FALSE(check.frames[40].prediction.empty());
  for (const auto& [from, weight] : check.frames[40].prediction) {
    EXPECT_NE(from, 40);
    predicted += weight * std::sqrt(set.images[static_cast<std::size_t>(from)](20, 24, 1));
  }
  EXPECT_NEAR(predicted * predicted, truth(20, 24, 1), 0.02 * truth(20, 24, 1));
}

TEST(FrameCheck, ReportShowsEveryFrameAtFault) {
  TestSet set;
  set.darken(40, 12, 27, 0.2);
  set.scale(90, 1.5);
  const FrameCheck check = set.check();
  SilentProgress quiet;
  FrameCheckReportOptions options;
  options.title = "a <ball>";
  const auto page = frameCheckPage(set.stack(), check, options, quiet);
  ASSERT_TRUE(page) << page.error().message;
  for (const std::string id : {"40", "90"}) {
    EXPECT_NE(page->find("<figure id=\"frame-" + id + "\">"), std::string::npos);
    EXPECT_NE(page->find("<a href=\"#frame-" + id + "\">"), std::string::npos);
  }
  EXPECT_NE(page->find("a &lt;ball&gt;"), std::string::npos);
  EXPECT_EQ(page->find("src=\"http"), std::string::npos);
}

TEST(FrameCheck, ReportShowsAFrameThatNothingPredicts) {
  TestSet set;
  set.scale(90, 1.5);
  FrameCheck check = set.check();
  ASSERT_EQ(check.bad(), std::vector<int>{90});
  check.frames[90].prediction.clear();
  SilentProgress quiet;
  const auto page = frameCheckPage(set.stack(), check, {}, quiet);
  ASSERT_TRUE(page) << page.error().message;
  EXPECT_NE(page->find("<figure id=\"frame-90\">"), std::string::npos);
}

TEST(FrameCheck, RefusesSetsTooSmallToJudge) {
  TestSet set;
  set.directions.resize(8);
  SilentProgress quiet;
  const auto result = checkFrames(set.stack(), {}, quiet);
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kInvalidArgument);
}

}  // namespace
}  // namespace lightsketch
