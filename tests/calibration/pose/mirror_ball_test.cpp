#include "calibration/pose/mirror_ball.h"

#include <gtest/gtest.h>

#include <Eigen/LU>

#include "tests/calibration/pose/synthetic_ball.h"

namespace lightsketch {
namespace {

using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

TEST(MirrorNormal, IsTheShortestWaysPoint) {
  std::mt19937 random(5);
  const Vector3d eye(0.02, -0.05, 1);
  for (int i = 0; i < 200; ++i) {
    const Vector3d lamp = randomLamp(random);
    const double radius = 0.03;
    const Vector3d expected = fermatPoint(eye, lamp, Vector3d::Zero(), radius) / radius;
    // A path of 1 m is flat to rounding over 1e-7 of the normal's turn.
    EXPECT_LT((mirrorNormal(eye, lamp, radius) - expected).norm(), 1e-6);
  }
}

TEST(MirrorNormal, LampBehindTheCameraIsSeenInTheMiddle) {
  EXPECT_LT((mirrorNormal({0, 0, 1}, {0, 0, 2}, 0.03) - Vector3d::UnitZ()).norm(), 1e-12);
}

TEST(OrthographicHighlight, HalfWayToTheRimMeansSixtyDegrees) {
  const BallCircle circle{{100, 80}, 50, 1};
  // sin 30 of the radius: the normal leans 30 degrees, the light 60.
  const auto right = directionFromHighlight(circle, {125, 80}).value();
  EXPECT_LT((right - Vector3d(std::sin(std::numbers::pi / 3), 0, 0.5)).norm(), 1e-12);
  const auto up = directionFromHighlight(circle, {100, 55}).value();
  EXPECT_LT((up - Vector3d(0, std::sin(std::numbers::pi / 3), 0.5)).norm(), 1e-12);
  EXPECT_LT((directionFromHighlight(circle, {100, 80}).value() - Vector3d::UnitZ()).norm(), 1e-12);
  EXPECT_FALSE(directionFromHighlight(circle, {100, 131}));
}

TEST(RayFromHighlight, LeadsToTheLamp) {
  const auto model = perspectiveCamera();
  const CameraPose pose = sceneCameraPose();
  const MirrorBall ball{{0.05, -0.03, 0.02}, 0.03, Matrix3d::Zero()};
  std::mt19937 random(7);
  for (int i = 0; i < 50; ++i) {
    const Vector3d lamp = randomLamp(random);
    const Vector3d point =
        fermatPoint(pose.sceneFromCamera.translation(), lamp, ball.centre, ball.radiusMetres);
    const auto pixel = model->projectPoint(pose.sceneFromCamera.inverse() * point).value();
    const auto ray = rayFromHighlight(pose, *model, ball, {pixel, Matrix2d::Identity()}).value();
    // Fermat's point is good to 1e-6 rad of the normal; grazing light magnifies that.
    EXPECT_LT((lamp - ray.origin).cross(ray.direction).norm(), 2e-5);
    EXPECT_GT((lamp - ray.origin).dot(ray.direction), 0);
  }
}

TEST(RayFromHighlight, CovarianceIsWhatNoiseDoes) {
  const auto model = perspectiveCamera();
  const CameraPose pose = sceneCameraPose();
  MirrorBall ball{Vector3d::Zero(), 0.03, Vector3d(1e-9, 2e-9, 9e-8).asDiagonal()};
  const Vector2d pixel(335, 231);
  const Matrix2d pixels = Vector2d(0.01, 0.02).asDiagonal();
  const auto ray = rayFromHighlight(pose, *model, ball, {pixel, pixels}).value();
  std::mt19937 random(11);
  std::normal_distribution<double> normal;
  Eigen::Matrix<double, 6, 6> sum = Eigen::Matrix<double, 6, 6>::Zero();
  const int draws = 20000;
  for (int i = 0; i < draws; ++i) {
    MirrorBall moved = ball;
    for (int k = 0; k < 3; ++k) {
      moved.centre[k] += std::sqrt(ball.centreCovariance(k, k)) * normal(random);
    }
    const Vector2d at(pixel.x() + 0.1 * normal(random),
                      pixel.y() + std::sqrt(0.02) * normal(random));
    const auto there = rayFromHighlight(pose, *model, moved, {at, pixels}).value();
    Eigen::Matrix<double, 6, 1> off;
    off << there.origin - ray.origin, there.direction - ray.direction;
    sum += off * off.transpose() / draws;
  }
  // 1 percent is one sigma of 20000 draws' variance.
  const Matrix3d origin = sum.topLeftCorner<3, 3>();
  const Matrix3d direction = sum.bottomRightCorner<3, 3>();
  const Matrix3d mixed = sum.topRightCorner<3, 3>();
  EXPECT_LT((ray.originCovariance - origin).norm(), 0.05 * origin.norm());
  EXPECT_LT((ray.directionCovariance - direction).norm(), 0.05 * direction.norm());
  EXPECT_LT((ray.originDirectionCovariance - mixed).norm(), 0.05 * mixed.norm());
}

TEST(RayFromHighlight, RefusesAHighlightBesideTheBall) {
  const auto ray = rayFromHighlight(sceneCameraPose(), *perspectiveCamera(),
                                    {Vector3d::Zero(), 0.03, Matrix3d::Zero()},
                                    {{500, 240}, Matrix2d::Identity()});
  ASSERT_FALSE(ray);
  EXPECT_NE(ray.error().message.find("outside the ball"), std::string::npos);
}

TEST(BallFromOutline, StandsWhereASphereOfThatSizeMust) {
  const auto model = perspectiveCamera();
  BallCone cone;
  cone.axis = Vector3d(0.1, -0.05, 1).normalized();
  cone.angularRadius = Angle::radians(std::asin(0.03 / 0.8));
  cone.covariance = Vector3d(1e-8, 1e-8, 1e-8).asDiagonal();
  const CameraPose pose = sceneCameraPose();
  const auto ball = ballFromOutline(pose, *model, cone, 0.03).value();
  EXPECT_LT((ball.centre - pose.sceneFromCamera * Vector3d(0.8 * cone.axis)).norm(), 1e-12);
  // Along the axis: 0.8^2 / 0.03 m per radian.
  const Vector3d along = pose.sceneFromCamera.linear() * cone.axis;
  EXPECT_NEAR(std::sqrt(along.dot(ball.centreCovariance * along)), 0.8 * 0.8 / 0.03 * 1e-4, 2e-6);
  EXPECT_NE(ballFromOutline(pose, *model, cone, 0).error().message.find("radius is missing"),
            std::string::npos);
}

}  // namespace
}  // namespace lightsketch
