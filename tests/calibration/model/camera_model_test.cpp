#include "calibration/model/camera_model.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <limits>
#include <numbers>

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
