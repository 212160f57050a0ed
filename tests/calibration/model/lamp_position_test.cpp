#include "calibration/model/lamp_position.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <random>

namespace lightsketch {
namespace {

using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

// A line of sight, off by `sigma` of an isotropic angle if there is a generator.
LampRay sight(const Vector3d& from, const Vector3d& lamp, Angle sigma,
              std::mt19937* random = nullptr) {
  LampRay ray;
  ray.origin = from;
  ray.direction = (lamp - from).normalized();
  ray.directionCovariance = sigma.radians() * sigma.radians() *
                            (Matrix3d::Identity() - ray.direction * ray.direction.transpose());
  if (random) {
    std::normal_distribution<double> noise(0, sigma.radians());
    const Vector3d u = ray.direction.unitOrthogonal();
    const Vector3d v = ray.direction.cross(u);
    ray.direction = (ray.direction + noise(*random) * u + noise(*random) * v).normalized();
  }
  return ray;
}

double degreesBetween(const Vector3d& a, const Vector3d& b) {
  return Angle::radians(std::atan2(a.cross(b).norm(), a.dot(b))).degrees();
}

TEST(Triangulation, FindsTheLampThatNoiselessRaysMean) {
  const Vector3d lamp(0.3, 0.5, 0.8);
  const Angle sigma = Angle::degrees(0.03);
  const std::vector<LampRay> rays{sight({-0.15, 0, 0}, lamp, sigma),
                                  sight({0.15, 0, 0}, lamp, sigma),
                                  sight({0, 0.2, 0.1}, lamp, sigma)};
  const auto found = triangulateLamp(rays).value();
  EXPECT_LT((found.position - lamp).norm(), 1e-12);
  EXPECT_NEAR(found.chiSquare, 0, 1e-12);
  EXPECT_EQ(found.degreesOfFreedom, 3);
  EXPECT_NEAR(found.probability, 1, 1e-9);
}

// Two rays off a baseline b at distance d, lamp on the perpendicular: depth sigma is
// sqrt(2) sigma d^2 / b, across it sigma d / sqrt(2).
TEST(Triangulation, CovarianceIsTheTextbooksOnTheBaselinesPerpendicular) {
  const double b = 0.3;
  const double d = 1;
  const Angle sigma = Angle::degrees(0.03);
  const std::vector<LampRay> rays{sight({-b / 2, 0, 0}, {0, 0, d}, sigma),
                                  sight({b / 2, 0, 0}, {0, 0, d}, sigma)};
  const Matrix3d covariance = triangulateLamp(rays).value().covariance;
  const double r2 = d * d + b * b / 4;
  const double s = sigma.radians();
  // Exact, from J^T J of the two angles.
  EXPECT_NEAR(std::sqrt(covariance(2, 2)), s * r2 / (std::sqrt(2.0) * b / 2), 1e-9);
  EXPECT_NEAR(std::sqrt(covariance(0, 0)), s * r2 / (std::sqrt(2.0) * d), 1e-9);
  EXPECT_NEAR(std::sqrt(covariance(1, 1)), s * std::sqrt(r2 / 2), 1e-9);
}

// FINDINGS: two fisheyes 0.3 m apart at 0.03 degrees each, lamps over the hemisphere at 1 m: 6 mm
// and 0.08 degrees at the subject (prototypes/calibration/near.cpp: a subject point 0.25 m off).
TEST(Triangulation, TwoFisheyesGiveTheFindingsFigures) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> uniform(0, 1);
  const Angle sigma = Angle::degrees(0.03);
  const Vector3d point(0.1, -0.2, 0.05);
  double squared = 0, squaredAngle = 0, chiSquares = 0;
  int inside = 0, count = 0;
  for (int i = 0; i < 4000; ++i) {
    const double z = uniform(random);
    const double phi = 2 * std::numbers::pi * uniform(random);
    const double r = std::sqrt(1 - z * z);
    const Vector3d lamp(r * std::cos(phi), r * std::sin(phi), z);
    const std::vector<LampRay> rays{sight({-0.15, 0, 0}, lamp, sigma, &random),
                                    sight({0.15, 0, 0}, lamp, sigma, &random)};
    const auto found = triangulateLamp(rays);
    if (!found) continue;  // beside the cameras, along the baseline
    const Vector3d error = found->position - lamp;
    ++count;
    squared += error.squaredNorm();
    const double angle = degreesBetween(found->position - point, lamp - point);
    squaredAngle += angle * angle;
    chiSquares += found->chiSquare;
    // 95 percent of a normal error in three dimensions lie within chi-square 7.815.
    if (error.dot(found->covariance.inverse() * error) < 7.815) ++inside;
  }
  EXPECT_GT(count, 3900);
  EXPECT_NEAR(std::sqrt(squared / count), 0.006, 0.002);
  EXPECT_NEAR(std::sqrt(squaredAngle / count), 0.08, 0.02);
  EXPECT_NEAR(static_cast<double>(inside) / count, 0.95, 0.015);  // 4 sigmas of 4000 draws
  EXPECT_NEAR(chiSquares / count, 1, 0.1);                        // one degree of freedom
}

TEST(Triangulation, TellsThatTheCamerasSawDifferentLights) {
  const Angle sigma = Angle::degrees(0.05);
  std::vector<LampRay> rays{sight({-0.15, 0, 0}, {0.2, 0.1, 1}, sigma),
                            sight({0.15, 0, 0}, {0.2, 0.15, 1}, sigma)};
  const auto found = triangulateLamp(rays).value();
  EXPECT_LT(found.probability, 1e-12);
  // The rays cross at 16 degrees; 0.05 m across the epipolar plane are 2.9 degrees between them.
  const double expected = std::pow(Angle::degrees(2.8).radians() / sigma.radians(), 2) / 2;
  EXPECT_NEAR(found.chiSquare / expected, 1, 0.15);
}

TEST(Triangulation, ProbabilityIsTheChiSquareDistributions) {
  // Miss perpendicular to the epipolar plane by 1.96 sigmas of the difference: 5 percent.
  const Angle sigma = Angle::degrees(0.02);
  LampRay a = sight({-0.5, 0, 0}, {0, 0, 1}, sigma);
  LampRay b = sight({0.5, 0, 0}, {0, 0, 1}, sigma);
  const double off = 1.959964 * std::sqrt(2.0) * sigma.radians();
  a.direction = (a.direction + off / 2 * Vector3d::UnitY()).normalized();
  b.direction = (b.direction - off / 2 * Vector3d::UnitY()).normalized();
  const std::vector<LampRay> rays{a, b};
  EXPECT_NEAR(triangulateLamp(rays).value().probability, 0.05, 1e-4);
}

TEST(Triangulation, RefusesWhatCannotBeToldInOneLine) {
  const Angle sigma = Angle::degrees(0.1);
  const auto complaint = [](const std::vector<LampRay>& rays) {
    const auto lamp = triangulateLamp(rays);
    if (lamp) return std::string("accepted");
    EXPECT_EQ(lamp.error().message.find('\n'), std::string::npos);
    return lamp.error().message;
  };
  const LampRay left = sight({-0.15, 0, 0}, {0, 0, 1}, sigma);
  EXPECT_NE(complaint({left}).find("at least 2 cameras"), std::string::npos);
  EXPECT_NE(complaint({left, left}).find("too parallel"), std::string::npos);
  EXPECT_NE(
      complaint({sight({-0.15, 0, 0}, {2, 0, 0}, sigma), sight({0.15, 0, 0}, {2, 0, 0}, sigma)})
          .find("too parallel"),
      std::string::npos);
  // 0.3 m at 100 m: 0.17 degrees, known to 0.14.
  EXPECT_NE(
      complaint({sight({-0.15, 0, 0}, {0, 0, 100}, sigma), sight({0.15, 0, 0}, {0, 0, 100}, sigma)})
          .find("too parallel"),
      std::string::npos);
  LampRay away = sight({0.15, 0, 0}, {1.5, 0, 1}, sigma);
  EXPECT_NE(complaint({sight({-0.15, 0, 0}, {-1.5, 0, 1}, sigma), away}).find("behind"),
            std::string::npos);
  away.directionCovariance.setZero();
  EXPECT_NE(complaint({left, away}).find("covariance"), std::string::npos);
}

TEST(LampAtRadius, DirectionComesBackFromTheSphere) {
  const Vector3d lamp = 0.9 * Vector3d(0.5, 0.6, 0.7).normalized();
  const LampRay ray = sight({0.1, 0, 0}, lamp, Angle::degrees(0.03));
  EXPECT_LT((lampAtRadius(ray, 0.9, 0)->position - lamp).norm(), 1e-12);
}

// Camera 10 cm beside the subject, lamp overhead: an error dr of the radius moves the direction at
// the subject by atan(0.1 / r) dr / r.
TEST(LampAtRadius, RadiusErrorAndDirectionErrorAreShown) {
  const double radius = 1;
  const LampRay ray = sight({0.1, 0, 0}, {0, 0, radius}, Angle::degrees(0.03));
  const Matrix3d covariance = lampAtRadius(ray, radius, 0.1)->covariance;
  // FINDINGS: range known to 10 percent, 0.1 m off: 0.5 degrees.
  EXPECT_NEAR(Angle::radians(std::sqrt(covariance(0, 0)) / radius).degrees(), 0.57, 0.01);

  // Against differences of the function itself, for a general ray.
  const LampRay general = sight({0.1, -0.2, 0.05}, {0.4, 0.3, 0.6}, Angle::degrees(0.5));
  const double r = Vector3d(0.4, 0.3, 0.6).norm();
  const Vector3d u = general.direction.unitOrthogonal();
  const Vector3d v = general.direction.cross(u);
  const double step = 1e-6;
  Matrix3d expected = Matrix3d::Zero();
  for (const Vector3d& axis : {u, v}) {
    LampRay moved = general;
    moved.direction = (general.direction + step * axis).normalized();
    const Vector3d per =
        (lampAtRadius(moved, r, 0)->position - lampAtRadius(general, r, 0)->position) / step;
    expected += std::pow(Angle::degrees(0.5).radians(), 2) * per * per.transpose();
  }
  const Vector3d perRadius =
      (lampAtRadius(general, r + step, 0)->position - lampAtRadius(general, r, 0)->position) / step;
  expected += 0.03 * 0.03 * perRadius * perRadius.transpose();
  EXPECT_TRUE(lampAtRadius(general, r, 0.03)->covariance.isApprox(expected, 1e-4));
}

TEST(LampAtRadius, RefusesACameraOutsideTheSphere) {
  const LampRay ray = sight({0, 0, 2}, {0, 0, 1}, Angle::degrees(0.03));
  ASSERT_FALSE(lampAtRadius(ray, 1, 0));
  EXPECT_NE(lampAtRadius(ray, 1, 0).error().message.find("further than the lamp"),
            std::string::npos);
  EXPECT_FALSE(lampAtRadius(ray, -1, 0));
}

// Pixel, pose and moving pupil, each against differences of the ray itself.
TEST(LampRay, CarriesPixelPoseAndPupil) {
  FisheyeParameters p;
  p.width = p.height = 960;
  p.fx = 290;
  p.fy = 292;
  p.cx = 483;
  p.cy = 477;
  p.k = {-0.02, 0.004};
  p.pupilMetres = {0.004, 0};
  p.maxFieldAngle = Angle::degrees(100);
  const auto model = FisheyeModel::create(p).value();
  CameraPose pose;
  pose.camera = "source";
  pose.sceneFromCamera =
      Eigen::Translation3d(0.1, 0.02, 0) * Eigen::AngleAxisd(-1.2, Vector3d(1, 2, 3).normalized());
  const Vector3d lamp(0.3, 0.5, 0.8);
  const Vector2d pixel = *model->projectPoint(pose.sceneFromCamera.inverse() * lamp);
  const LampRay exact = *lampRay(pose, *model, pixel, Matrix2d::Zero());
  // projectPoint() solves for the pupil to well below a micrometre.
  EXPECT_LT((lamp - exact.origin).cross(exact.direction).norm(), 1e-6);
  EXPECT_GT((exact.origin - pose.sceneFromCamera.translation()).norm(), 1e-3);

  Matrix2d pixels;
  pixels << 0.04, 0.01, 0.01, 0.09;
  Eigen::Matrix<double, 6, 6> root = Eigen::Matrix<double, 6, 6>::Identity();
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < i; ++j) root(i, j) = 0.3 * std::sin(3 * i + j);
  }
  pose.covariance = 1e-6 * root * root.transpose();
  const LampRay ray = *lampRay(pose, *model, pixel, pixels);

  const double step = 1e-6;
  Eigen::Matrix<double, 6, 8> jacobian;
  for (int i = 0; i < 8; ++i) {
    CameraPose moved = pose;
    Vector2d at = pixel;
    if (i < 3) {
      moved.sceneFromCamera.linear() =
          Eigen::AngleAxisd(step, Vector3d::Unit(i)) * pose.sceneFromCamera.linear();
    } else if (i < 6) {
      moved.sceneFromCamera.translation()[i - 3] += step;
    } else {
      at[i - 6] += step;
    }
    const LampRay there = *lampRay(moved, *model, at, pixels);
    jacobian.col(i) << (there.origin - exact.origin) / step,
        (there.direction - exact.direction) / step;
  }
  Eigen::Matrix<double, 8, 8> inputs = Eigen::Matrix<double, 8, 8>::Zero();
  inputs.topLeftCorner<6, 6>() = pose.covariance;
  inputs.bottomRightCorner<2, 2>() = pixels;
  const Eigen::Matrix<double, 6, 6> expected = jacobian * inputs * jacobian.transpose();
  // That the pupil moves with the pixel is left out of the origin: micrometres.
  const Matrix3d origin = expected.topLeftCorner<3, 3>();
  const Matrix3d direction = expected.bottomRightCorner<3, 3>();
  const Matrix3d mixed = expected.topRightCorner<3, 3>();
  EXPECT_LT((ray.directionCovariance - direction).norm(), 1e-3 * direction.norm());
  EXPECT_LT((ray.originCovariance - origin).norm(), 1e-3 * origin.norm());
  EXPECT_LT((ray.originDirectionCovariance - mixed).norm(), 2e-2 * mixed.norm());
  EXPECT_FALSE(lampRay(pose, *model, {5000, 5000}, pixels));
}

TEST(FallOff, IsTheInverseSquare) { EXPECT_DOUBLE_EQ(lampFallOff(2, 1), 0.25); }

}  // namespace
}  // namespace lightsketch
