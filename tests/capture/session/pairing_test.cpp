#include "capture/session/pairing.h"

#include <gtest/gtest.h>

#include <array>
#include <vector>

#include <Eigen/Geometry>
#include <cmath>

namespace lightsketch {
namespace {

TimePoint at(double seconds) { return TimePoint(fromSeconds(seconds)); }

TrackResult seen(LampObservation lamp) { return {TrackState::kTracking, lamp, {}}; }

LampObservation seenAt(double seconds, double azimuth) {
  LampObservation seen;
  seen.time = at(seconds);
  seen.pixel = {100 * azimuth, 50};
  seen.covariance = 0.01 * Eigen::Matrix2d::Identity();
  seen.directionInSource = {std::cos(azimuth), std::sin(azimuth), 0};
  const Eigen::Vector3d& d = seen.directionInSource;
  seen.directionCovariance = 1e-6 * (Eigen::Matrix3d::Identity() - d * d.transpose());
  seen.confidence = 1 - azimuth;
  return seen;
}

TEST(ObservationHistory, InterpolatesALampOnAGreatCircleExactly) {
  ObservationHistory history;
  history.add(at(1.0), seen(seenAt(1.0, 0.1)));
  history.add(at(1.1), seen(seenAt(1.1, 0.2)));
  const auto paired = history.at(at(1.03), Duration(0), 0.15);
  ASSERT_TRUE(paired);
  const Eigen::Vector3d expected(std::cos(0.13), std::sin(0.13), 0);
  EXPECT_LT((paired->lamp.directionInSource - expected).norm(), 1e-9);
  EXPECT_NEAR(paired->lamp.pixel.x(), 13, 1e-6);
  EXPECT_NEAR(paired->radiansPerSecond, 1.0, 1e-6);
  EXPECT_NEAR(paired->secondsToBefore, 0.03, 1e-9);
  EXPECT_NEAR(paired->secondsToAfter, 0.07, 1e-9);
  EXPECT_NEAR(paired->lamp.confidence, 0.8, 1e-9);
}

TEST(ObservationHistory, FollowsALampThatSpeedsUp) {
  // 8 rad/s^2 along a great circle. A straight line between frames 1/12 s apart is off by
  // a t^2 / 8 = 7e-3; the parabola through three is exact but for the circle's curvature.
  const auto azimuth = [](double t) { return 0.2 + 4 * t * t; };
  ObservationHistory history;
  for (int i = 0; i < 3; ++i)
    history.add(at(1 + i / 12.0), seen(seenAt(1 + i / 12.0, azimuth(i / 12.0))));
  const double t = 1.5 / 12;
  const auto paired = history.at(at(1 + t), Duration(0), 0.15);
  ASSERT_TRUE(paired);
  const Eigen::Vector3d expected(std::cos(azimuth(t)), std::sin(azimuth(t)), 0);
  EXPECT_LT((paired->lamp.directionInSource - expected).norm(), 1e-3);
  EXPECT_GT(paired->lamp.directionCovariance.trace(), 5e-6);
}

TEST(ObservationHistory, ClockUncertaintySmearsAlongThePath) {
  ObservationHistory history;
  history.add(at(1.0), seen(seenAt(1.0, 0.1)));
  history.add(at(1.1), seen(seenAt(1.1, 0.2)));
  const auto paired = history.at(at(1.05), fromSeconds(0.01), 0.15);
  ASSERT_TRUE(paired);
  // 1 rad/s for 0.01 s, along y' (tangent in the plane), the observations' own 1e-3, and a hand's
  // tremor of 0.1 degrees, which is free between frames so far apart.
  const double tremor = std::pow(Angle::degrees(0.1).radians(), 2);
  const Eigen::Vector3d along(-std::sin(0.15), std::cos(0.15), 0);
  EXPECT_NEAR(along.dot(paired->lamp.directionCovariance * along), 1e-4 + 1e-6 + tremor, 1e-6);
  EXPECT_NEAR(paired->lamp.directionCovariance(2, 2), 1e-6 + tremor, 1e-8);
}

TEST(ObservationHistory, NeedsTheLampOnBothSidesAndClose) {
  ObservationHistory history;
  EXPECT_EQ(history.at(at(1), Duration(0), 0.15).error(), PairingFailure::kUnpaired);
  history.add(at(1.0), seen(seenAt(1.0, 0.1)));
  history.add(at(1.1), {TrackState::kLost, std::nullopt, "covered"});
  EXPECT_EQ(history.trouble(), "covered");
  history.add(at(1.4), seen(seenAt(1.4, 0.2)));
  history.add(at(1.5), seen(seenAt(1.5, 0.2)));
  EXPECT_EQ(history.at(at(0.9), Duration(0), 0.15).error(), PairingFailure::kUnpaired);
  EXPECT_EQ(history.at(at(1.05), Duration(0), 0.15).error(), PairingFailure::kLampNotSeen);
  EXPECT_EQ(history.at(at(1.2), Duration(0), 0.15).error(), PairingFailure::kUnpaired);
  EXPECT_EQ(history.at(at(1.6), Duration(0), 0.15).error(), PairingFailure::kUnpaired);
  EXPECT_TRUE(history.at(at(1.45), Duration(0), 0.15));
}

TEST(LightAtSubject, TakesTheParallaxOut) {
  RigGeometry rig;
  CameraPose pose;
  pose.sceneFromCamera.translation() = Eigen::Vector3d(0.2, -0.1, 0.05);
  pose.sceneFromCamera.linear() =
      Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  rig.sourceCameras.push_back(pose);
  const Eigen::Vector3d lamp = 0.9 * Eigen::Vector3d(0.3, 0.5, 0.6).normalized();

  LampObservation seen;
  seen.directionInSource = (pose.sceneFromCamera.inverse() * lamp).normalized();
  const Eigen::Vector3d& d = seen.directionInSource;
  seen.directionCovariance = 1e-6 * (Eigen::Matrix3d::Identity() - d * d.transpose());

  const std::array all{SeenLamp{0, seen}};
  const LightDirection far = lightAtSubject(all, rig).value();
  EXPECT_FALSE(far.position);
  EXPECT_GT((far.direction - lamp.normalized()).norm(), 0.1);

  rig.lampRadiusMetres = 0.9;
  const LightDirection near = lightAtSubject(all, rig).value();
  ASSERT_TRUE(near.position);
  EXPECT_LT((*near.position - lamp).norm(), 1e-9);
  EXPECT_LT((near.direction - lamp.normalized()).norm(), 1e-9);
  // A radius that is 5 percent off moves the direction by one sigma of what is claimed.
  rig.lampRadiusMetres = 0.9 * 1.05;
  const Eigen::Vector3d moved = lightAtSubject(all, rig)->direction - near.direction;
  const double sigma = std::sqrt(moved.normalized().dot(near.covariance * moved.normalized()));
  EXPECT_NEAR(moved.norm() / sigma, 1, 0.1);
  EXPECT_NEAR((near.covariance * near.direction).norm(), 0, 1e-9);
}

TEST(LightAtSubject, TwoCamerasTellTheDistanceAndWhetherTheySeeTheSameLight) {
  RigGeometry rig;
  rig.sourceCameras.resize(2);
  rig.sourceCameras[0].sceneFromCamera.translation() = Eigen::Vector3d(0.1, 0, 0);
  rig.sourceCameras[1].sceneFromCamera.translation() = Eigen::Vector3d(-0.2, 0.05, 0);
  const Eigen::Vector3d lamp(0.3, 0.5, 0.8);
  std::vector<SeenLamp> seen;
  for (std::size_t i = 0; i < 2; ++i) {
    LampObservation one;
    const auto& pose = rig.sourceCameras[i].sceneFromCamera;
    one.directionInSource = (pose.inverse() * lamp).normalized();
    const Eigen::Vector3d& d = one.directionInSource;
    one.directionCovariance = 1e-6 * (Eigen::Matrix3d::Identity() - d * d.transpose());
    seen.push_back({i, one});
  }
  const LightDirection light = lightAtSubject(seen, rig).value();
  ASSERT_TRUE(light.position);
  EXPECT_LT((*light.position - lamp).norm(), 1e-6);
  // 1 milliradian each, 0.3 m apart, 1 m away: some 5 mm along the line of sight.
  const double sigma = std::sqrt(light.positionCovariance.trace());
  EXPECT_GT(sigma, 0.002);
  EXPECT_LT(sigma, 0.01);

  // A reflection in one of them: 3 degrees off the plane that both lines of sight should share.
  seen[1].lamp.directionInSource =
      Eigen::AngleAxisd(0.05, Eigen::Vector3d::UnitX()) * seen[1].lamp.directionInSource;
  const auto refused = lightAtSubject(seen, rig);
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().message.find("different lights"), std::string::npos);
}

}  // namespace
}  // namespace lightsketch
