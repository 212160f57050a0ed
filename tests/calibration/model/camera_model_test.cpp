#include "calibration/model/camera_model.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <limits>
#include <numbers>
#include <random>

#include "calibration/model/fisheye_projection.h"
#include "capture/frame/file.h"
#include "tests/capture/frame/temporary_folder.h"

namespace lightsketch {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

FisheyeParameters fisheye() {
  FisheyeParameters p;
  p.width = 960;
  p.height = 960;
  p.fx = 290;
  p.fy = 292;
  p.cx = 483;
  p.cy = 477;
  p.k = {-0.02, 0.004, -0.003, 0.0004};
  p.p = {0.0008, -0.0005};
  p.maxFieldAngle = Angle::degrees(100);
  return p;
}

Vector3d directionAt(double thetaDegrees, double phiDegrees) {
  const double theta = Angle::degrees(thetaDegrees).radians();
  const double phi = Angle::degrees(phiDegrees).radians();
  return {std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi), std::cos(theta)};
}

TEST(KannalaBrandt, WithoutDistortionIsEquidistant) {
  FisheyeParameters p = fisheye();
  p.k = {};
  p.p = {};
  const auto model = FisheyeModel::create(p).value();
  const Vector2d pixel = model->project(5.0 * directionAt(60, 90)).value();
  EXPECT_NEAR(pixel.x(), p.cx, 1e-9);
  EXPECT_NEAR(pixel.y(), p.cy + p.fy * std::numbers::pi / 3, 1e-9);
}

TEST(KannalaBrandt, FollowsItsEquation) {
  const FisheyeParameters p = fisheye();
  const auto model = FisheyeModel::create(p).value();
  const double theta = 0.9;
  const double phi = 0.4;
  const double d = theta + p.k[0] * std::pow(theta, 3) + p.k[1] * std::pow(theta, 5) +
                   p.k[2] * std::pow(theta, 7) + p.k[3] * std::pow(theta, 9);
  const double x = d * std::cos(phi);
  const double y = d * std::sin(phi);
  const double xd = x + 2 * p.p[0] * x * y + p.p[1] * (d * d + 2 * x * x);
  const double yd = y + p.p[0] * (d * d + 2 * y * y) + 2 * p.p[1] * x * y;
  const Vector3d direction(std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi),
                           std::cos(theta));
  const Vector2d pixel = model->project(direction).value();
  EXPECT_NEAR(pixel.x(), p.fx * xd + p.cx, 1e-9);
  EXPECT_NEAR(pixel.y(), p.fy * yd + p.cy, 1e-9);
}

TEST(KannalaBrandt, UnprojectInvertsProjectOverTheFieldBeyond90Degrees) {
  const auto model = FisheyeModel::create(fisheye()).value();
  double worst = 0;
  for (double theta = 0; theta <= 99.9; theta += 0.9) {
    for (double phi = 0; phi < 360; phi += 7) {
      const Vector3d direction = directionAt(theta, phi);
      const auto pixel = model->project(direction);
      ASSERT_TRUE(pixel) << theta;
      const auto back = model->unproject(*pixel);
      ASSERT_TRUE(back) << theta;
      worst = std::max(worst, (*back - direction).norm());
      EXPECT_NEAR(back->norm(), 1, 1e-12);
    }
  }
  EXPECT_LT(worst, 1e-9);  // the interface's promise
}

TEST(KannalaBrandt, ProjectInvertsUnprojectOnEveryPixelOfTheField) {
  const auto model = FisheyeModel::create(fisheye()).value();
  int inside = 0;
  for (double y = 0.5; y < 960; y += 13) {
    for (double x = 0.5; x < 960; x += 13) {
      const auto direction = model->unproject({x, y});
      if (!direction) continue;
      ++inside;
      EXPECT_LT((model->project(*direction).value() - Vector2d(x, y)).norm(), 1e-7);
    }
  }
  EXPECT_GT(inside, 3500);  // the image circle covers most of 74 x 74 probes
}

TEST(KannalaBrandt, HasNoPixelOutsideTheField) {
  const auto model = FisheyeModel::create(fisheye()).value();
  EXPECT_TRUE(model->project(directionAt(99.99, 20)));
  EXPECT_FALSE(model->project(directionAt(100.01, 20)));
  EXPECT_FALSE(model->project({0, 0, -1}));
  EXPECT_FALSE(model->project({std::numeric_limits<double>::quiet_NaN(), 0, 1}));
  EXPECT_FALSE(model->unproject({5000, 5000}));
  EXPECT_FALSE(model->unproject({std::numeric_limits<double>::infinity(), 0}));

  FisheyeParameters whole = fisheye();
  whole.k = {};
  whole.p = {};
  whole.maxFieldAngle = Angle::degrees(180);
  // Straight back lies on a whole circle of pixels, not on the principal point.
  EXPECT_FALSE(FisheyeModel::create(whole).value()->project({0, 0, -1}));
}

TEST(KannalaBrandt, PixelsPerRadianOfAnEquidistantLens) {
  FisheyeParameters p = fisheye();
  p.k = {};
  p.p = {};
  p.fy = p.fx;
  const auto model = FisheyeModel::create(p).value();
  for (const double degrees : {1.0, 45.0, 90.0, 100.0}) {
    const double theta = Angle::degrees(degrees).radians();
    const Eigen::JacobiSVD<Eigen::Matrix2d> svd(model->pixelsPerRadian(directionAt(degrees, 30)));
    // Radially f; along the circle f theta / sin theta. The difference quotient's step is 1e-5, and
    // at the rim the quotient is one-sided.
    const double tolerance = degrees == 100.0 ? 0.02 : 1e-4;
    EXPECT_NEAR(svd.singularValues()[0], p.fx * theta / std::sin(theta), tolerance) << degrees;
    EXPECT_NEAR(svd.singularValues()[1], p.fx, tolerance) << degrees;
  }
}

TEST(KannalaBrandt, RefusesLensesThatFold) {
  FisheyeParameters p = fisheye();
  p.k = {-0.3, 0, 0, 0};  // 1 + 3 k theta^2 = 0 at 60.4 degrees
  const auto folded = FisheyeModel::create(p);
  ASSERT_FALSE(folded);
  EXPECT_NE(folded.error().message.find("60."), std::string::npos) << folded.error().message;
  p.maxFieldAngle = Angle::degrees(60);
  EXPECT_TRUE(FisheyeModel::create(p));

  p = fisheye();
  p.p = {0.5, 0};
  EXPECT_FALSE(FisheyeModel::create(p));
}

TEST(KannalaBrandt, RefusesNonsense) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto refused = [](auto&& change) {
    FisheyeParameters p = fisheye();
    change(p);
    return !FisheyeModel::create(p);
  };
  EXPECT_TRUE(refused([&](auto& p) { p.fx = nan; }));
  EXPECT_TRUE(refused([&](auto& p) { p.fy = -1; }));
  EXPECT_TRUE(refused([&](auto& p) { p.cx = nan; }));
  EXPECT_TRUE(refused([&](auto& p) { p.k[2] = nan; }));
  EXPECT_TRUE(refused([&](auto& p) { p.width = 0; }));
  EXPECT_TRUE(refused([&](auto& p) { p.maxFieldAngle = Angle::degrees(181); }));
  EXPECT_TRUE(refused([&](auto& p) { p.maxFieldAngle = Angle::degrees(0); }));
}

// --- Sixteen parameters and a moving pupil
// --------------------------------------------------------

// A fisheye with all of its terms, its pupil moving by some millimetres as those of real ones do.
FisheyeParameters fisheye624() {
  FisheyeParameters p = fisheye();
  p.k = {-0.02, 0.004, -0.003, 0.0004, 0.0002, -0.00003};
  p.s = {0.0006, -0.0001, -0.0004, 0.0002};
  p.pupilMetres = {0.002, -0.0003};
  return p;
}

TEST(Fisheye624, FollowsItsEquation) {
  const FisheyeParameters p = fisheye624();
  const double theta = 1.1;
  const double phi = -2.2;
  double d = theta;
  for (int i = 0; i < 6; ++i) d += p.k[static_cast<std::size_t>(i)] * std::pow(theta, 2 * i + 3);
  const double x = d * std::cos(phi);
  const double y = d * std::sin(phi);
  const double r2 = d * d;
  const double xd =
      x + 2 * p.p[0] * x * y + p.p[1] * (r2 + 2 * x * x) + p.s[0] * r2 + p.s[1] * r2 * r2;
  const double yd =
      y + p.p[0] * (r2 + 2 * y * y) + 2 * p.p[1] * x * y + p.s[2] * r2 + p.s[3] * r2 * r2;
  const Vector2d pixel = FisheyeModel::create(p)
                             .value()
                             ->project({std::sin(theta) * std::cos(phi),
                                        std::sin(theta) * std::sin(phi), std::cos(theta)})
                             .value();
  EXPECT_NEAR(pixel.x(), p.fx * xd + p.cx, 1e-9);
  EXPECT_NEAR(pixel.y(), p.fy * yd + p.cy, 1e-9);
}

TEST(Fisheye624, UnprojectInvertsProjectBeyond90Degrees) {
  const auto model = FisheyeModel::create(fisheye624()).value();
  for (double theta = 0; theta <= 99.9; theta += 1.7) {
    for (double phi = 0; phi < 360; phi += 13) {
      const Vector3d direction = directionAt(theta, phi);
      const auto back = model->unproject(model->project(direction).value());
      ASSERT_TRUE(back) << theta;
      EXPECT_LT((*back - direction).norm(), 1e-9) << theta;  // the interface's promise
    }
  }
}

TEST(MovingPupil, RaysPassThroughWhereThePupilIs) {
  const FisheyeParameters p = fisheye624();
  const auto model = FisheyeModel::create(p).value();
  const double theta = Angle::degrees(70).radians();
  const double z =
      p.pupilMetres[0] * theta * theta + p.pupilMetres[1] * theta * theta * theta * theta;
  EXPECT_LT((model->rayOrigin(3 * directionAt(70, 200)) - Vector3d(0, 0, z)).norm(), 1e-15);
}

TEST(MovingPupil, PointsOfAPixelsRayProjectToThePixel) {
  const auto model = FisheyeModel::create(fisheye624()).value();
  double worstFar = 0;
  double worstNear = 0;
  int rays = 0;
  for (double y = 0.5; y < 960; y += 37) {
    for (double x = 0.5; x < 960; x += 37) {
      const auto direction = model->unproject({x, y});
      // Seen from the camera's origin a near point is elsewhere than its ray points: not at the
      // rim.
      if (!direction || !(direction->z() > -0.15)) continue;
      ++rays;
      const Vector3d origin = model->rayOrigin(*direction);
      const auto error = [&](double metres) {
        const auto pixel = model->projectPoint(origin + metres * *direction);
        return pixel ? (*pixel - Vector2d(x, y)).norm() : 1e9;
      };
      worstFar = std::max({worstFar, error(1), error(4)});
      worstNear = std::max(worstNear, error(0.2));
    }
  }
  EXPECT_GT(rays, 450);
  EXPECT_LT(worstFar, 1e-6);
  // Three rounds of shift over distance: 3 mm at 20 cm leave a thousandth of a corner's noise.
  EXPECT_LT(worstNear, 1e-4);
}

TEST(MovingPupil, NearPointsAreSeenElsewhereThanFarOnes) {
  const auto model = FisheyeModel::create(fisheye624()).value();
  const Vector3d point = 0.2 * directionAt(60, 0);
  // The angle of the one ray through the point, by bisection.
  double low = 1;
  double high = 1.2;
  while (high - low > 1e-13) {
    const double theta = 0.5 * (low + high);
    const double pupil = 0.002 * theta * theta - 0.0003 * std::pow(theta, 4);
    (std::atan2(point.x(), point.z() - pupil) > theta ? low : high) = theta;
  }
  const double degrees = Angle::radians(low).degrees();
  EXPECT_GT(degrees, 60.4);  // the pupil is 1.8 mm further ahead: 1.8 sin(60) / 200 radians
  const Vector2d expected = model->project(directionAt(degrees, 0)).value();
  EXPECT_LT((model->projectPoint(point).value() - expected).norm(), 1e-4);  // as above, at 20 cm
  EXPECT_LT((model->projectPoint(1e6 * point).value() - model->project(point).value()).norm(),
            1e-5);
}

TEST(MovingPupil, WithoutOnePointsAreDirections) {
  const auto model = FisheyeModel::create(fisheye()).value();
  const Vector3d direction = directionAt(80, 33);
  EXPECT_EQ(model->rayOrigin(direction), Vector3d::Zero());
  EXPECT_LT((*model->projectPoint(0.1 * direction) - *model->project(direction)).norm(), 1e-9);
}

// --- What a lens knows of itself
// ------------------------------------------------------------------

TEST(CoveredField, IsToldBySector) {
  LensUncertainty uncertainty;
  for (const double degrees : {10.0, 20.0, 30.0, 40.0}) {
    uncertainty.coveredField.push_back(Angle::degrees(degrees));
  }
  const auto model = FisheyeModel::create(fisheye(), uncertainty).value();
  const auto edge = [&](double phi) {
    double theta = 0;
    while (theta < 90 && model->covers(directionAt(theta + 1, phi))) theta += 1;
    return theta + 0.5;
  };
  EXPECT_NEAR(edge(45), 10, 0.6);  // steps of one degree
  EXPECT_NEAR(edge(135), 20, 0.6);
  EXPECT_NEAR(edge(225), 30, 0.6);
  EXPECT_NEAR(edge(315), 40, 0.6);
  EXPECT_NEAR(edge(0.01), 10, 0.6);
  EXPECT_NEAR(edge(-0.01), 40, 0.6);
  // The smallest angle below 0 rounds to a whole turn.
  EXPECT_TRUE(model->covers({std::sin(0.6), -1e-20, std::cos(0.6)}));
  EXPECT_TRUE(model->covers({0, 0, 1}));
  EXPECT_TRUE(FisheyeModel::create(fisheye()).value()->covers(directionAt(99, 0)));
}

TEST(DirectionCovariance, IsZeroForALensThatDoesNotSay) {
  const auto model = FisheyeModel::create(fisheye()).value();
  EXPECT_EQ(model->directionCovariance(directionAt(50, 20)), Eigen::Matrix3d::Zero());
}

TEST(DirectionCovariance, HoldsTheModelErrorInEveryDirection) {
  LensUncertainty uncertainty;
  uncertainty.modelError = Angle::degrees(0.03);
  const auto model = FisheyeModel::create(fisheye(), uncertainty).value();
  const Vector3d direction = directionAt(85, 250);
  const double sigma = Angle::degrees(0.03).radians();
  const Eigen::Matrix3d expected =
      sigma * sigma * (Eigen::Matrix3d::Identity() - direction * direction.transpose());
  EXPECT_LT((model->directionCovariance(2 * direction) - expected).norm(), 1e-12 * sigma);
}

// Moving the centre of an equidistant lens by s pixels moves the direction of a pixel by s/f
// outwards and s/f sin(theta)/theta around; turning the camera by w s/f moves it by w s/f outwards
// and w s/f cos(theta) around. What the best w leaves is known in closed form.
TEST(DirectionCovariance, OfAMovedCentreIsWhatNoRotationExplains) {
  for (const double field : {20.0, 95.0}) {
    FisheyeParameters p = fisheye();
    p.k = {};
    p.p = {};
    p.fy = p.fx;
    p.maxFieldAngle = Angle::degrees(field);
    constexpr double kPixels = 0.3;
    LensUncertainty uncertainty;
    uncertainty.covariance.setZero(FisheyeLayout::kCount, FisheyeLayout::kCount);
    uncertainty.covariance(FisheyeLayout::kCentre, FisheyeLayout::kCentre) = kPixels * kPixels;
    const auto model = FisheyeModel::create(p, uncertainty).value();

    // The best w over the cap: least squares, equal weight per solid angle.
    double above = 0;
    double below = 0;
    const double limit = Angle::degrees(field).radians();
    for (int i = 0; i < 10'000; ++i) {
      const double theta = limit * (i + 0.5) / 10'000;
      const double around = std::sin(theta) / theta;
      above += (1 + around * std::cos(theta)) * std::sin(theta);
      below += (1 + std::cos(theta) * std::cos(theta)) * std::sin(theta);
    }
    const double w = above / below;
    const double moved = kPixels / p.fx;
    for (const double degrees : {0.3 * field, 0.9 * field}) {
      const double theta = Angle::degrees(degrees).radians();
      const auto sigma = [&](double phi) {
        return std::sqrt(model->directionCovariance(directionAt(degrees, phi)).trace());
      };
      // 400 samples place w to a thousandth.
      EXPECT_NEAR(sigma(0), moved * std::abs(1 - w), 2e-3 * moved) << degrees;
      EXPECT_NEAR(sigma(90), moved * std::abs(std::sin(theta) / theta - w * std::cos(theta)),
                  2e-3 * moved)
          << degrees;
      // Nearly all of it is rotation where the field is narrow.
      if (field == 20.0) {
        EXPECT_LT(sigma(90), 0.05 * moved);
      }
    }
  }
}

TEST(DirectionCovariance, AgreesWithLensesDrawnFromTheCovariance) {
  const FisheyeParameters p = fisheye624();
  constexpr int n = FisheyeLayout::kCount;
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  // Sizes as a calibration has them, correlated at random.
  Eigen::VectorXd size(n);
  size << 0.2, 0.2, 0.3, 0.3, 2e-4, 2e-4, 1e-4, 2e-5, 5e-6, 1e-6, 1e-4, 1e-4, 5e-5, 2e-5, 5e-5,
      2e-5, 1e-4, 1e-4;
  Eigen::MatrixXd root(n, n);
  for (double& value : root.reshaped()) value = normal(random);
  root = size.asDiagonal() * root / std::sqrt(static_cast<double>(n));
  LensUncertainty uncertainty;
  uncertainty.covariance = root * root.transpose();
  uncertainty.coveredField.assign(36, Angle::degrees(80));
  const auto model = FisheyeModel::create(p, uncertainty).value();

  // Directions evenly over the covered cap, in rings of equal area; the first ones are compared.
  std::vector<Vector3d> directions = {directionAt(2, 10), directionAt(40, 120),
                                      directionAt(60, 300), directionAt(79, 45),
                                      directionAt(79, 190)};
  const std::size_t compared = directions.size();
  constexpr int kRings = 30;
  for (int ring = 0; ring < kRings; ++ring) {
    const double z = 1 - (1 - std::cos(Angle::degrees(80).radians())) * (ring + 0.5) / kRings;
    for (int i = 0; i < 24; ++i) {
      directions.push_back(
          directionAt(Angle::radians(std::acos(z)).degrees(), 15 * i + 7.5 * (ring % 2)));
    }
  }
  std::vector<Vector2d> pixels;
  for (const Vector3d& direction : directions) pixels.push_back(*model->project(direction));

  constexpr int kDraws = 1000;
  std::vector<Eigen::Matrix3d> scatter(compared, Eigen::Matrix3d::Zero());
  for (int draw = 0; draw < kDraws; ++draw) {
    Eigen::VectorXd step(n);
    for (double& value : step) value = normal(random);
    FisheyeParameters other = p;
    other.setVector(p.vector() + root * step);
    const auto drawn = FisheyeModel::create(other).value();
    std::vector<Vector3d> seen;
    Eigen::Matrix3d correlation = Eigen::Matrix3d::Zero();
    for (std::size_t i = 0; i < directions.size(); ++i) {
      seen.push_back(drawn->unproject(pixels[i]).value());
      correlation += directions[i] * seen[i].transpose();
    }
    // The best rotation (Kabsch 1976); the differences are far too small for a mirror.
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(correlation,
                                                Eigen::ComputeFullU | Eigen::ComputeFullV);
    const Eigen::Matrix3d best = svd.matrixU() * svd.matrixV().transpose();
    for (std::size_t i = 0; i < compared; ++i) {
      const Vector3d left = best * seen[i] - directions[i];
      scatter[i] += left * left.transpose() / kDraws;
    }
  }
  for (std::size_t i = 0; i < compared; ++i) {
    const Eigen::Matrix3d told = model->directionCovariance(directions[i]);
    EXPECT_LT((told * directions[i]).norm(), 1e-9 * told.norm()) << i;  // rank 2
    // A thousand draws know a sigma to 2.2 percent.
    const auto sigmas = [](const Eigen::Matrix3d& covariance) {
      const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance,
                                                                  Eigen::EigenvaluesOnly);
      return Vector2d(solver.eigenvalues().tail<2>().cwiseMax(0).cwiseSqrt());
    };
    const Vector2d expected = sigmas(scatter[i]);
    EXPECT_NEAR(sigmas(told)[0] / expected[0], 1, 0.1) << i;
    EXPECT_NEAR(sigmas(told)[1] / expected[1], 1, 0.1) << i;
  }
}

TEST(LensUncertainty, RefusesNonsense) {
  LensUncertainty uncertainty;
  uncertainty.covariance.setZero(5, 5);
  EXPECT_FALSE(FisheyeModel::create(fisheye(), uncertainty));
  uncertainty.covariance.setZero(FisheyeLayout::kCount, FisheyeLayout::kCount);
  EXPECT_TRUE(FisheyeModel::create(fisheye(), uncertainty));
  uncertainty.covariance(3, 3) = -1;
  EXPECT_FALSE(FisheyeModel::create(fisheye(), uncertainty));
}

// --- Files
// ----------------------------------------------------------------------------------------

TEST(CameraFile, RoundTripKeepsEveryProjection) {
  const TemporaryFolder folder;
  const auto model = FisheyeModel::create(fisheye()).value();
  ASSERT_TRUE(saveCameraModel(*model, folder / "camera.json"));
  const auto loaded = loadCameraModel(folder / "camera.json").value();
  EXPECT_EQ(loaded->width(), 960);
  EXPECT_EQ(loaded->height(), 960);
  EXPECT_NEAR(loaded->maxFieldAngle().degrees(), 100, 1e-12);
  for (double theta = 0; theta < 100; theta += 10) {
    const Vector3d direction = directionAt(theta, 33);
    EXPECT_EQ(loaded->project(direction), model->project(direction));
  }
}

TEST(CameraFile, RoundTripKeepsAllTermsThePupilAndTheUncertainty) {
  const TemporaryFolder folder;
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  LensUncertainty uncertainty;
  uncertainty.covariance.resize(FisheyeLayout::kCount, FisheyeLayout::kCount);
  for (double& value : uncertainty.covariance.reshaped()) value = normal(random);
  uncertainty.covariance = (uncertainty.covariance * uncertainty.covariance.transpose()).eval();
  uncertainty.modelError = Angle::degrees(0.017);
  for (int i = 0; i < 36; ++i) uncertainty.coveredField.push_back(Angle::degrees(60 + i));
  const auto model = FisheyeModel::create(fisheye624(), uncertainty).value();
  EXPECT_EQ(model->modelName(), "fisheye624");
  ASSERT_TRUE(saveCameraModel(*model, folder / "camera.json"));
  const auto loaded = std::dynamic_pointer_cast<const FisheyeModel>(
      loadCameraModel(folder / "camera.json").value());
  ASSERT_TRUE(loaded);
  EXPECT_EQ(loaded->values().vector(), model->values().vector());
  EXPECT_EQ(loaded->uncertainty().covariance, uncertainty.covariance);
  EXPECT_NEAR(loaded->uncertainty().modelError.degrees(), 0.017, 1e-15);
  ASSERT_EQ(loaded->uncertainty().coveredField.size(), 36u);
  for (std::size_t i = 0; i < 36; ++i) {
    EXPECT_NEAR(loaded->uncertainty().coveredField[i].degrees(), 60 + static_cast<double>(i),
                1e-12);
  }

  // A pupil alone does not make a lens one of sixteen parameters.
  FisheyeParameters plain = fisheye();
  plain.pupilMetres = {0.001, 0.0002};
  const auto withPupil = FisheyeModel::create(plain).value();
  EXPECT_EQ(withPupil->modelName(), "kannala-brandt");
  const auto again = cameraModelFromJson(cameraModelToJson(*withPupil), "camera").value();
  EXPECT_EQ(again->rayOrigin(directionAt(70, 0)), withPupil->rayOrigin(directionAt(70, 0)));
}

TEST(CameraFile, FilesOfVersion1AreRead) {
  const Json json = {{"format", "lightsketch-camera"},
                     {"formatVersion", 1},
                     {"model", "kannala-brandt"},
                     {"parameters",
                      {{"width", 960},
                       {"height", 960},
                       {"fx", 290},
                       {"fy", 292},
                       {"cx", 483},
                       {"cy", 477},
                       {"k", {-0.02, 0.004, -0.003, 0.0004}},
                       {"p", {0.0008, -0.0005}},
                       {"maxFieldAngleDegrees", 100}}}};
  const auto loaded = cameraModelFromJson(json, "camera.json");
  ASSERT_TRUE(loaded) << loaded.error().message;
  const auto model = FisheyeModel::create(fisheye()).value();
  const Vector3d direction = directionAt(95, 111);
  EXPECT_EQ((*loaded)->project(direction), model->project(direction));
  EXPECT_TRUE((*loaded)->covers(direction));
  EXPECT_EQ((*loaded)->directionCovariance(direction), Eigen::Matrix3d::Zero());
}

TEST(CameraFile, RefusesBadFilesWithFileAndField) {
  const TemporaryFolder folder;
  const auto file = folder / "camera.json";
  const Json good = cameraModelToJson(*FisheyeModel::create(fisheye()).value());
  const auto complaint = [&](const Json& json) {
    writeContent(file, json.dump());
    const auto loaded = loadCameraModel(file);
    if (loaded) return std::string("accepted");
    EXPECT_EQ(loaded.error().message.rfind(file.string(), 0), 0u) << loaded.error().message;
    return loaded.error().message.substr(file.string().size());
  };
  ASSERT_EQ(complaint(good), "accepted");
  for (const auto& [field, value] : good["parameters"].items()) {
    Json json = good;
    json["parameters"].erase(field);
    EXPECT_NE(complaint(json).find("'" + field + "' is missing"), std::string::npos);
    json["parameters"][field] = "text";
    EXPECT_NE(complaint(json).find("'" + field + "'"), std::string::npos);
  }
  Json json = good;
  json["formatVersion"] = 3;
  EXPECT_NE(complaint(json).find("newer"), std::string::npos);
  json = good;
  json["model"] = "pinhole";
  EXPECT_NE(complaint(json).find("'pinhole'"), std::string::npos);
  json = good;
  json.erase("parameters");
  EXPECT_NE(complaint(json).find("'parameters'"), std::string::npos);
  json = good;
  json["parameters"]["k"] = {-1, 0, 0, 0};
  EXPECT_NE(complaint(json).find("fall on one pixel"), std::string::npos);
  EXPECT_FALSE(loadCameraModel(folder / "absent.json"));

  const std::string text = good.dump();
  for (std::size_t size = 0; size < text.size(); ++size) {
    writeContent(file, text.substr(0, size));
    EXPECT_FALSE(loadCameraModel(file)) << size;
  }
}

}  // namespace
}  // namespace lightsketch
