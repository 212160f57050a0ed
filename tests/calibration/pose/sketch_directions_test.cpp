#include <gtest/gtest.h>

#include <algorithm>

#include "calibration/pose/check_directions.h"
#include "calibration/pose/relight_sketch.h"
#include "tests/calibration/pose/synthetic_ball.h"
#include "tests/capture/frame/temporary_folder.h"

namespace lightsketch {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector3d;

SketchManifest manifestOf(int width, int height) {
  SketchManifest manifest;
  manifest.width = width;
  manifest.height = height;
  manifest.software = "test 1";
  return manifest;
}

// --- checkDirections ---------------------------------------------------------------------------

// A ball 12 cm beside the subject, seen by a perspective camera; the lamp 0.6 to 1.5 m away.
class Check : public testing::Test {
 protected:
  static constexpr int kFrames = 8;
  const Vector3d centre_{0.12, 0.06, 0.03};
  const double radius_ = 0.05;
  std::shared_ptr<const CameraModel> model_ = perspectiveCamera();

  struct Shot {
    Vector3d lamp;
    RadianceImage image;
  };
  const std::vector<Shot>& shots() const {
    static const std::vector<Shot> shots = [&] {
      const BallPicture picture(model_, sceneCameraPose(), centre_, radius_);
      std::mt19937 random(3);
      std::vector<Shot> result;
      for (int i = 0; i < kFrames; ++i) {
        const Vector3d lamp = randomLamp(random);
        result.push_back({lamp, picture.render(&lamp, 0.004, 7 + unsigned(i))});
      }
      return result;
    }();
    return shots;
  }

  Sketch sketchOff(double degrees, bool positions) {
    auto sketch = Sketch::create(folder_ / "s", manifestOf(640, 480)).value();
    for (const auto& [lamp, image] : shots()) {
      // Turned about an axis across it: every direction is off by the same angle.
      const Vector3d wrong =
          Eigen::AngleAxisd(Angle::degrees(degrees).radians(), lamp.unitOrthogonal()) * lamp;
      FrameRecord record;
      record.light.direction = wrong.normalized();
      if (positions) record.light.position = wrong;
      EXPECT_TRUE(sketch.append(record, image));
    }
    return sketch;
  }
  BallHint hint() const {
    const Vector3d inCamera = sceneCameraPose().sceneFromCamera.inverse() * centre_;
    return {*model_->project(inCamera) + Vector2d(4, 3), 900 * radius_ / inCamera.z()};
  }
  CheckCamera camera() const { return {model_.get(), sceneCameraPose(), radius_}; }

  TemporaryFolder folder_;
  SilentProgress progress_;
};

TEST_F(Check, PositionsThatAreRightAgreeThoughTheBallStandsAside) {
  const auto check = checkDirections(sketchOff(0, true), hint(), camera(), progress_);
  ASSERT_TRUE(check) << check.error().message;
  EXPECT_GE(check->checked, kFrames - 1);
  // A tenth of a pixel of 48, seen askew: an eighth of a degree, doubled by the reflection.
  EXPECT_LT(check->median.degrees(), 0.4);
  EXPECT_LT(check->percentile95.degrees(), 0.8);
}

TEST_F(Check, DirectionsThatAreTwoDegreesOffShow) {
  const auto check = checkDirections(sketchOff(2, true), hint(), camera(), progress_);
  ASSERT_TRUE(check) << check.error().message;
  EXPECT_NEAR(check->median.degrees(), 2, 0.4);
}

TEST_F(Check, OrthographicBallSeesTheParallaxOfItsPlace) {
  // Taken as distant, a lamp at 1 m is off by what 13 cm aside make of it: 7 degrees and less.
  const auto check = checkDirections(sketchOff(0, false), hint(), std::nullopt, progress_);
  ASSERT_TRUE(check) << check.error().message;
  EXPECT_GT(check->median.degrees(), 2);
  EXPECT_LT(check->median.degrees(), 15);
}

TEST_F(Check, WithOneSourceCameraTheBallTellsWhereTheLampWas) {
  const CameraPose source = sourceCameraPose({-0.15, 0.02, 0}, {0.1, 0.2, -2});
  RigGeometry rig;
  rig.sceneCamera = sceneCameraPose();
  rig.sourceCameras = {source};
  rig.sourceCameras[0].camera = "only";
  const std::map<std::string, std::shared_ptr<const CameraModel>> models = {
      {"only", sourceFisheye()}};
  auto sketch = Sketch::create(folder_ / "one", manifestOf(640, 480)).value();
  std::vector<Vector3d> lamps;
  for (const auto& [lamp, image] : shots()) {
    const auto pixel = models.at("only")->projectPoint(source.sceneFromCamera.inverse() * lamp);
    if (!pixel) continue;
    FrameRecord record;
    record.light.direction = Vector3d::UnitX();  // of a bad calibration
    record.lampPixels.push_back({"only", *pixel, 0.0025 * Matrix2d::Identity()});
    ASSERT_TRUE(sketch.append(record, image));
    lamps.push_back(lamp);
  }
  ASSERT_GE(lamps.size(), 6u);
  RelightSketchOptions options;
  options.lampRadiusMetres = 1;  // for frames whose highlight is not found
  // Drawn with some care: an outline further from the hint than that counts as something else.
  options.ball =
      ReferenceBall{camera(), BallHint{hint().centre - Vector2d(3, 2), 1.02 * hint().radiusPixels}};
  const auto summary = relightSketch(sketch, models, rig, options, progress_);
  ASSERT_TRUE(summary) << summary.error().message;
  EXPECT_GE(summary->byBall, static_cast<int>(lamps.size()) - 1);
  std::vector<double> errors;
  for (std::size_t i = 0; i < lamps.size(); ++i) {
    const LightDirection& light = sketch.frames()[i].light;
    errors.push_back(
        Angle::radians(std::acos(std::min(1.0, light.direction.dot(lamps[i].normalized()))))
            .degrees());
  }
  std::sort(errors.begin(), errors.end());
  // The ball's line of sight is good to a quarter of a degree, 0.27 m from the camera's: distance
  // to some 2 percent, which moves 10 degrees of parallax by 0.2.
  EXPECT_LT(errors[errors.size() / 2], 0.3);
}

TEST_F(Check, SaysWhatIsMissing) {
  const Sketch sketch = sketchOff(0, true);
  CheckCamera noRadius = camera();
  noRadius.ballRadiusMetres = 0;
  const auto missing = checkDirections(sketch, hint(), noRadius, progress_);
  ASSERT_FALSE(missing);
  EXPECT_NE(missing.error().message.find("radius is missing"), std::string::npos);
  const auto nowhere = checkDirections(sketch, BallHint{{80, 400}, 40}, camera(), progress_);
  ASSERT_FALSE(nowhere);
  EXPECT_NE(nowhere.error().message.find("not found near"), std::string::npos);
}

// --- relightSketch -----------------------------------------------------------------------------

class Relight : public testing::Test {
 protected:
  static constexpr int kFrames = 40;
  Relight() {
    rig_.sceneCamera = sceneCameraPose();
    rig_.sourceCameras = {sourceCameraPose({0.1, 0, 0}, {0.2, -0.1, 0.3}),
                          sourceCameraPose({-0.2, 0.03, 0}, {0.1, 0.2, -2})};
    rig_.sourceCameras[0].camera = "left";
    rig_.sourceCameras[1].camera = "right";
    models_ = {{"left", sourceFisheye()}, {"right", sourceFisheye()}};
  }

  // `power` of the lamp in each frame; pictures are a matte plane at the subject.
  Sketch sketchOf(
      int cameras, double noisePixels,
      const std::function<double(int)>& power = [](int) { return 1.0; }) {
    auto sketch = Sketch::create(folder_ / "s", manifestOf(16, 12)).value();
    std::mt19937 random(3);
    std::normal_distribution<double> normal(0, noisePixels);
    while (static_cast<int>(lamps_.size()) < kFrames) {
      const Vector3d lamp = randomLamp(random);
      FrameRecord record;
      record.light.direction = Vector3d::UnitX();  // of a bad calibration
      for (int k = 0; k < cameras; ++k) {
        const auto& pose = rig_.sourceCameras[static_cast<std::size_t>(k)];
        const auto pixel =
            models_.at(pose.camera)->projectPoint(pose.sceneFromCamera.inverse() * lamp);
        if (!pixel) break;
        const double sigma = std::max(noisePixels, 0.01);
        record.lampPixels.push_back({pose.camera, *pixel + Vector2d(normal(random), normal(random)),
                                     sigma * sigma * Matrix2d::Identity()});
      }
      if (static_cast<int>(record.lampPixels.size()) < cameras) continue;
      const double shade =
          0.1 * power(static_cast<int>(lamps_.size())) * lamp.normalized().z() / lamp.squaredNorm();
      RadianceImage image(16, 12, 3);
      for (int y = 0; y < 12; ++y) {
        for (int x = 0; x < 16; ++x) {
          for (int c = 0; c < 3; ++c) {
            image(x, y, c) = static_cast<float>(shade * (c == 0 ? 1.2 : 1));
          }
        }
      }
      EXPECT_TRUE(sketch.append(record, image));
      lamps_.push_back(lamp);
    }
    return sketch;
  }
  std::vector<double> errors(const Sketch& sketch) const {
    std::vector<double> result;
    for (const auto& frame : sketch.frames()) {
      result.push_back(
          degreesBetween(frame.light.direction, lamps_[static_cast<std::size_t>(frame.id)]));
    }
    std::sort(result.begin(), result.end());
    return result;
  }

  RigGeometry rig_;
  std::map<std::string, std::shared_ptr<const CameraModel>> models_;
  std::vector<Vector3d> lamps_;
  TemporaryFolder folder_;
  SilentProgress progress_;
};

TEST_F(Relight, TwoCamerasTriangulateEveryFrameAndTheFallOffIsKept) {
  Sketch sketch = sketchOf(2, 0.1);
  const auto summary = relightSketch(sketch, models_, rig_, {}, progress_);
  ASSERT_TRUE(summary) << summary.error().message;
  EXPECT_EQ(summary->relit, kFrames);
  EXPECT_EQ(summary->triangulated, kFrames);
  const auto off = errors(sketch);
  EXPECT_LT(off[kFrames / 2], 0.05);
  EXPECT_LT(off[kFrames - 2], 0.2);
  const Sketch again = Sketch::open(folder_ / "s").value();
  for (const auto& frame : again.frames()) {
    const Vector3d& lamp = lamps_[static_cast<std::size_t>(frame.id)];
    ASSERT_TRUE(frame.light.position);
    EXPECT_LT((*frame.light.position - lamp).norm(), 0.03);
    EXPECT_GT(frame.light.positionCovariance.trace(), 0);
    EXPECT_NEAR(frame.lampScale[0] * lamp.squaredNorm() / std::pow(summary->referenceMetres, 2), 1,
                0.05);
    EXPECT_EQ(frame.calibrationId, summary->calibrationId);
  }
}

TEST_F(Relight, OneCameraWithARadiusShowsItsError) {
  Sketch sketch = sketchOf(1, 0.1);
  const auto refused = relightSketch(sketch, models_, rig_, {}, progress_);
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().message.find("give the distance"), std::string::npos);
  EXPECT_EQ(sketch.frames()[0].light.direction, Vector3d::UnitX());  // nothing written

  RelightSketchOptions options;
  options.lampRadiusMetres = 1.0;
  options.radiusError = 0.26;  // lamps from 0.6 to 1.5 m
  const auto summary = relightSketch(sketch, models_, rig_, options, progress_);
  ASSERT_TRUE(summary) << summary.error().message;
  EXPECT_EQ(summary->triangulated, 0);
  // The claim is the truth's size: sigma per axis against the median of a Rayleigh-like error.
  const double median = errors(sketch)[kFrames / 2];
  EXPECT_GT(summary->medianSigma.degrees(), 0.4 * median);
  EXPECT_LT(summary->medianSigma.degrees(), 2.5 * median);
}

TEST_F(Relight, FramesThatSawAnotherLightKeepTheirs) {
  Sketch sketch = sketchOf(2, 0.1);
  // A ceiling lamp in one camera, from the next frame on.
  FrameRecord record = sketch.frames()[3];
  record.lampPixels[1].pixel += Vector2d(40, -60);
  const int id = sketch.append(record, RadianceImage(16, 12, 3)).value();
  const auto summary = relightSketch(sketch, models_, rig_, {}, progress_);
  ASSERT_TRUE(summary) << summary.error().message;
  ASSERT_EQ(summary->refused.size(), 1u);
  EXPECT_EQ(summary->refused[0].id, id);
  EXPECT_TRUE(summary->refused[0].reason.find("different lights") != std::string::npos)
      << summary->refused[0].reason;
  EXPECT_EQ(sketch.frames()[static_cast<std::size_t>(id)].light.direction, Vector3d::UnitX());
}

TEST_F(Relight, AMattePatchGivesTheLampsPower) {
  const auto power = [](int i) { return 1 + 0.3 * std::sin(i); };
  Sketch sketch = sketchOf(2, 0.05, power);
  RelightSketchOptions options;
  options.patch = ReferencePatch{2, 2, 8, 6};
  options.referenceMetres = 1.0;
  const auto summary = relightSketch(sketch, models_, rig_, options, progress_);
  ASSERT_TRUE(summary) << summary.error().message;
  EXPECT_EQ(summary->withoutPower, 0);
  std::vector<double> ratio;
  for (const auto& frame : sketch.frames()) {
    const double expected =
        power(frame.id) / lamps_[static_cast<std::size_t>(frame.id)].squaredNorm();
    ratio.push_back(frame.lampScale[0] / expected);
    EXPECT_NEAR(frame.lampScale[1] / frame.lampScale[0], 1, 1e-3);  // half-float pixels
  }
  // One common factor (the median lamp), each within what half-float pixels and positions allow.
  for (const double r : ratio) EXPECT_NEAR(r / ratio[0], 1, 0.01);
}

TEST_F(Relight, SaysWhatIsMissing) {
  Sketch sketch = sketchOf(2, 0.1);
  auto models = models_;
  models.erase("right");
  const auto noModel = relightSketch(sketch, models, rig_, {}, progress_);
  ASSERT_FALSE(noModel);
  EXPECT_NE(noModel.error().message.find("'right'"), std::string::npos);
  RigGeometry rig = rig_;
  rig.sourceCameras.pop_back();
  const auto noPose = relightSketch(sketch, models_, rig, {}, progress_);
  ASSERT_FALSE(noPose);
  EXPECT_NE(noPose.error().message.find("no pose"), std::string::npos);
  RelightSketchOptions options;
  options.patch = ReferencePatch{10, 2, 8, 6};
  EXPECT_FALSE(relightSketch(sketch, models_, rig_, options, progress_));
}

}  // namespace
}  // namespace lightsketch
