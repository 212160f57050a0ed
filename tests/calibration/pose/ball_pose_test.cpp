#include "calibration/pose/ball_pose.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>

#include "tests/calibration/pose/synthetic_ball.h"

namespace lightsketch {
namespace {

using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kRadius = 0.03;

// A rig, a waved lamp, and what its cameras see.
struct Wave {
  std::shared_ptr<const CameraModel> sceneModel = perspectiveCamera();
  std::shared_ptr<const CameraModel> sourceModel = sourceFisheye();
  CameraPose scene = sceneCameraPose();
  std::vector<CameraPose> sources;
  std::vector<Vector3d> centres{Vector3d::Zero()};
  std::vector<Vector3d> lamps;
  BallSetup setup;
  std::vector<BallMoment> moments;

  explicit Wave(int count, double highlightNoise, double lampNoise, unsigned seed = 1,
                int sourceCount = 1, const std::vector<Vector3d>& balls = {Vector3d::Zero()}) {
    centres = balls;
    sources.push_back(sourceCameraPose({0.1, 0.01, 0.02}, {0.2, -0.1, 0.3}));
    if (sourceCount > 1) sources.push_back(sourceCameraPose({-0.2, 0.03, 0}, {0.1, 0.2, -2}));
    std::mt19937 random(seed);
    std::normal_distribution<double> normal;
    const auto measured = [&](const Vector2d& pixel, double sigma) {
      const double declared = std::max(sigma, 1e-3);
      return PixelMeasurement{pixel + sigma * Vector2d(normal(random), normal(random)),
                              declared * declared * Matrix2d::Identity()};
    };
    setup.sceneCamera = {"scene", sceneModel.get()};
    for (std::size_t k = 0; k < sources.size(); ++k) {
      setup.sourceCameras.push_back({"source" + std::to_string(k), sourceModel.get()});
    }
    for (const auto& centre : centres) {
      const Vector3d inCamera = scene.sceneFromCamera.inverse() * centre;
      const double sigma = std::max(highlightNoise, 1e-3) / 900 / 3;  // the outline is an average
      BallCone cone;
      cone.axis = inCamera.normalized();
      const Vector3d u = cone.axis.unitOrthogonal();
      const double off = highlightNoise / 900 / 3;
      cone.axis = (cone.axis + off * normal(random) * u + off * normal(random) * cone.axis.cross(u))
                      .normalized();
      cone.angularRadius =
          Angle::radians(std::asin(kRadius / inCamera.norm()) + off * normal(random));
      cone.covariance = sigma * sigma * Matrix3d::Identity();
      setup.outlines.push_back(cone);
      setup.radiiMetres.push_back(kRadius);
    }
    for (const auto& source : sources) {
      // By a ruler, to 2 mm.
      const double sigma = highlightNoise > 0 ? 0.002 : 0;
      setup.sourceDistances.push_back(MeasuredLength{
          (source.sceneFromCamera.translation() - centres[0]).norm() + sigma * normal(random),
          0.002});
    }
    while (static_cast<int>(lamps.size()) < count) {
      const Vector3d lamp = randomLamp(random);
      BallMoment moment;
      moment.name = "moment " + std::to_string(lamps.size());
      bool whole = true;
      for (const auto& centre : centres) {
        const Vector3d point =
            fermatPoint(scene.sceneFromCamera.translation(), lamp, centre, kRadius);
        moment.highlights.push_back(measured(
            *sceneModel->projectPoint(scene.sceneFromCamera.inverse() * point), highlightNoise));
      }
      for (const auto& source : sources) {
        const auto pixel = sourceModel->projectPoint(source.sceneFromCamera.inverse() * lamp);
        whole = whole && pixel;
        if (pixel) moment.lamps.push_back(measured(*pixel, lampNoise));
      }
      if (!whole) continue;
      lamps.push_back(lamp);
      moments.push_back(moment);
    }
  }

  // (rotation vector, translation) by which a pose is off, in the convention of its covariance.
  Eigen::Matrix<double, 6, 1> error(const CameraPose& found, std::size_t k) const {
    const Eigen::AngleAxisd turn(
        Matrix3d(found.sceneFromCamera.linear() * sources[k].sceneFromCamera.linear().transpose()));
    Eigen::Matrix<double, 6, 1> off;
    off << turn.axis() * turn.angle(),
        found.sceneFromCamera.translation() - sources[k].sceneFromCamera.translation();
    return off;
  }
};

double degrees(double radians) { return Angle::radians(radians).degrees(); }

TEST(PoseFromMirrorBall, IsExactWithoutNoise) {
  const Wave wave(60, 0, 0);
  const auto found = poseFromMirrorBalls(wave.setup, wave.moments);
  ASSERT_TRUE(found) << found.error().message;
  const auto off = wave.error(found->pose.rig.sourceCameras.at(0), 0);
  // Fermat's point is good to 1e-7 m, a 250th of a pixel's noise of 1e-3 that is declared.
  EXPECT_LT(degrees(off.head<3>().norm()), 0.002);
  EXPECT_LT(off.tail<3>().norm(), 5e-5);
  EXPECT_EQ(found->pose.used, 60);
  for (const auto& lamp : found->lamps) {
    EXPECT_LT((lamp.position - wave.lamps[lamp.moment]).norm(), 2e-3);
  }
}

TEST(PoseFromMirrorBall, CovarianceIsHonest) {
  double sum = 0;
  int cases = 0;
  for (unsigned seed = 1; seed <= 12; ++seed) {
    const Wave wave(120, 0.1, 0.1, seed);
    const auto found = poseFromMirrorBalls(wave.setup, wave.moments);
    ASSERT_TRUE(found) << found.error().message;
    const CameraPose& pose = found->pose.rig.sourceCameras.at(0);
    const auto off = wave.error(pose, 0);
    sum += off.dot(pose.covariance.inverse() * off) / 6;
    ++cases;
    EXPECT_LT(degrees(off.head<3>().norm()), 0.6) << seed;
    EXPECT_LT(off.tail<3>().norm(), 0.01) << seed;
    EXPECT_NEAR(found->pose.residualSigmas, 1, 0.25) << seed;
  }
  // Chi-square of 72 degrees of freedom over 72: 1 with a sigma of 0.17.
  EXPECT_GT(sum / cases, 0.5);
  EXPECT_LT(sum / cases, 1.7);
}

TEST(PoseFromMirrorBall, TwoSourceCamerasGiveTheDirectionAtTheSubject) {
  const Wave wave(150, 0.1, 0.1, 3, 2);
  const auto found = poseFromMirrorBalls(wave.setup, wave.moments);
  ASSERT_TRUE(found) << found.error().message;
  std::mt19937 random(99);
  std::normal_distribution<double> normal(0, 0.1);
  std::vector<double> errors;
  while (errors.size() < 300) {
    const Vector3d lamp = randomLamp(random);
    std::vector<LampRay> rays;
    for (std::size_t k = 0; k < 2; ++k) {
      const auto pixel =
          wave.sourceModel->projectPoint(wave.sources[k].sceneFromCamera.inverse() * lamp);
      if (!pixel) break;
      rays.push_back(*lampRay(found->pose.rig.sourceCameras[k], *wave.sourceModel,
                              *pixel + Vector2d(normal(random), normal(random)),
                              0.01 * Matrix2d::Identity()));
    }
    if (rays.size() < 2) continue;
    const auto position = triangulateLamp(rays);
    ASSERT_TRUE(position) << position.error().message;
    errors.push_back(degreesBetween(position->position, lamp));
  }
  std::sort(errors.begin(), errors.end());
  // The bar for the whole chain.
  EXPECT_LT(errors[150], 0.2);
  EXPECT_LT(errors[285], 0.5);
}

TEST(PoseFromMirrorBall, TwoBallsApartFixTheScale) {
  Wave one(80, 0.1, 0.1, 4);
  Wave two(80, 0.1, 0.1, 4, 1, {{-0.12, 0.05, 0}, {0.12, -0.05, 0.02}});
  one.setup.sourceDistances.clear();
  two.setup.sourceDistances.clear();
  const auto single = poseFromMirrorBalls(one.setup, one.moments);
  BallSetup setup = two.setup;
  setup.sceneCameraPose = two.scene;
  const auto pair = poseFromMirrorBalls(setup, two.moments);
  ASSERT_TRUE(single && pair);
  const auto sigma = [](const BallPoseCalibration& found) {
    const CameraPose& pose = found.pose.rig.sourceCameras.at(0);
    return std::sqrt(pose.covariance.bottomRightCorner<3, 3>().trace());
  };
  EXPECT_LT(sigma(*pair), 0.5 * sigma(*single));
  EXPECT_LT(two.error(pair->pose.rig.sourceCameras.at(0), 0).tail<3>().norm(), 4 * sigma(*pair));
  EXPECT_LT((pair->balls.at(1).centre - two.centres[1]).norm(), 0.003);
}

TEST(PoseFromMirrorBall, ThrowsOutMomentsThatSawAnotherLight) {
  Wave wave(120, 0.1, 0.1, 5);
  std::mt19937 random(17);
  std::vector<std::size_t> wrong;
  for (std::size_t i = 0; i < wave.moments.size(); i += 6) {
    wrong.push_back(i);
    // A lamp pixel of quite another moment.
    wave.moments[i].lamps[0] = wave.moments[(i + 37) % wave.moments.size()].lamps[0];
  }
  const auto found = poseFromMirrorBalls(wave.setup, wave.moments);
  ASSERT_TRUE(found) << found.error().message;
  int caught = 0;
  for (const std::size_t i : wrong) {
    const auto& evidence = found->pose.evidence.at(i);
    if (evidence.rejected.find("contradict") != std::string::npos) ++caught;
  }
  // A wrong lamp that happens to lie in the epipolar plane fits some distance.
  EXPECT_GE(caught, static_cast<int>(wrong.size()) - 4);
  EXPECT_GE(found->pose.used, 97);
  const auto off = wave.error(found->pose.rig.sourceCameras.at(0), 0);
  EXPECT_LT(degrees(off.head<3>().norm()), 0.4);
  EXPECT_LT(off.tail<3>().norm(), 0.01);
}

TEST(PoseFromMirrorBall, KnownSceneCameraKeepsItsFrame) {
  Wave wave(60, 0, 0, 6, 1, {{0.04, -0.02, 0.01}});
  BallSetup setup = wave.setup;
  setup.sceneCameraPose = wave.scene;
  const auto found = poseFromMirrorBalls(setup, wave.moments);
  ASSERT_TRUE(found) << found.error().message;
  const auto off = wave.error(found->pose.rig.sourceCameras.at(0), 0);
  EXPECT_LT(degrees(off.head<3>().norm()), 0.002);
  EXPECT_LT(off.tail<3>().norm(), 5e-5);
  EXPECT_LT((found->balls.at(0).centre - wave.centres[0]).norm(), 1e-5);
}

TEST(PoseFromMirrorBall, SaysWhatIsWrongInOneLine) {
  const auto complaint = [](const BallSetup& setup, const std::vector<BallMoment>& moments) {
    const auto found = poseFromMirrorBalls(setup, moments);
    if (found) return std::string("accepted");
    EXPECT_EQ(found.error().message.find('\n'), std::string::npos);
    return found.error().message;
  };
  const Wave wave(40, 0.1, 0.1);
  auto few = wave.moments;
  few.resize(6);
  EXPECT_NE(complaint(wave.setup, few).find("only 6 moments"), std::string::npos);

  auto still = wave.moments;
  for (auto& moment : still) moment.lamps = still.front().lamps;
  EXPECT_NE(complaint(wave.setup, still).find("lamp never moved"), std::string::npos);

  auto ceiling = wave.moments;
  for (auto& moment : ceiling) moment.highlights = ceiling.front().highlights;
  EXPECT_NE(complaint(wave.setup, ceiling).find("all in one place"), std::string::npos);

  BallSetup noRadius = wave.setup;
  noRadius.radiiMetres = {0};
  EXPECT_NE(complaint(noRadius, wave.moments).find("radius is missing"), std::string::npos);
  noRadius.radiiMetres = {};
  EXPECT_NE(complaint(noRadius, wave.moments).find("radi"), std::string::npos);

  auto shuffled = wave.moments;
  for (std::size_t i = 0; i < shuffled.size(); ++i) {
    shuffled[i].lamps = wave.moments[(i * 17 + 5) % shuffled.size()].lamps;
  }
  EXPECT_NE(complaint(wave.setup, shuffled).find("contradict"), std::string::npos)
      << complaint(wave.setup, shuffled);
}

}  // namespace
}  // namespace lightsketch
