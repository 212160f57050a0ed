#include "pipeline/compress/near_light.h"

#include <gtest/gtest.h>

#include <cmath>

#include "pipeline/compress/compress.h"
#include "pipeline/illumination/light_grid.h"
#include "tests/pipeline/compress/test_sketch.h"

namespace lightsketch {
namespace {

using Eigen::Vector3d;
using testing::freshFolder;
using testing::reconstruct;
using testing::rmsDifference;

constexpr int kSide = 48;
constexpr double kWidthMetres = 0.5;
constexpr double kLampMetres = 0.8;

Vector3d pointAt(int x, int y) {
  return {kWidthMetres * ((x + 0.5) / kSide - 0.5), kWidthMetres * (0.5 - (y + 0.5) / kSide), 0};
}

// A matte relief: flat, but with normals of its own everywhere.
RadianceImage relief(const std::function<Vector3d(const Vector3d& point)>& lightVector) {
  RadianceImage image(kSide, kSide, 3);
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const Vector3d normal =
          Vector3d(0.4 * std::sin(0.7 * x), 0.4 * std::sin(0.5 * y + 0.3 * x), 1).normalized();
      const double shade = std::max(0.0, normal.dot(lightVector(pointAt(x, y))));
      for (int c = 0; c < 3; ++c) image(x, y, c) = static_cast<float>((0.3 + 0.2 * c) * shade);
    }
  }
  return image;
}

TEST(NearLight, ModelOfANearLampIsThatOfAFarOneOnceTheSurfaceIsKnown) {
  std::vector<Vector3d> lights;
  const LightGrid grid = LightGrid::create(200).value();
  for (const Vector3d& d : grid.directions()) {
    if (d.z() > 0.2) lights.push_back(d);
  }
  SketchManifest manifest;
  manifest.width = manifest.height = kSide;
  auto sketch = Sketch::create(freshFolder("sketch"), manifest).value();
  for (const Vector3d& light : lights) {
    FrameRecord record;
    record.light.direction = light;
    record.light.position = kLampMetres * light;
    const Vector3d lamp = *record.light.position;
    ASSERT_TRUE(sketch.append(record, relief([&](const Vector3d& point) {
                                // Of a lamp that gives the origin irradiance 1.
                                const Vector3d to = lamp - point;
                                return Vector3d(kLampMetres * kLampMetres * to /
                                                std::pow(to.norm(), 3));
                              })));
  }
  auto surface = std::make_shared<SurfacePoints>(kSide, kSide, 3);
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      const Vector3d point = pointAt(x, y);
      for (int c = 0; c < 3; ++c) (*surface)(x, y, c) = static_cast<float>(point[c]);
    }
  }
  const auto errorWith = [&](std::shared_ptr<const SurfacePoints> points) {
    SilentProgress progress;
    CompressOptions options;
    options.surface = std::move(points);
    auto result = compress(sketch, options, progress);
    EXPECT_TRUE(result) << (result ? "" : result.error().message);
    double sum = 0;
    int count = 0;
    for (std::size_t i = 0; i < result->model.lights.size(); i += 37) {
      const Vector3d light = result->model.lights[i];
      if (light.z() < 0.4) continue;
      Eigen::VectorXf s = Eigen::VectorXf::Zero(3 * result->model.lightCount());
      s.segment(3 * static_cast<Eigen::Index>(i), 3).setOnes();
      sum += rmsDifference(reconstruct(result->model, s),
                           relief([&](const Vector3d&) { return light; }));
      ++count;
    }
    EXPECT_GT(count, 10);
    return sum / count;
  };
  const double far = errorWith(nullptr);
  const double near = errorWith(surface);
  // Taken as far away, light is 17 degrees off at the rim of the relief; a block is 17 cm wide
  // here, so that some of the gradient inside it remains.
  EXPECT_GT(far, 0.04);
  EXPECT_LT(near, far / 4);
}

TEST(NearLight, SurfaceIsWhereTheCameraSeesIt) {
  FisheyeParameters lens;
  lens.width = 64;
  lens.height = 48;
  lens.fx = lens.fy = 100;
  lens.cx = 32;
  lens.cy = 24;
  lens.maxFieldAngle = Angle::degrees(60);
  const auto camera = FisheyeModel::create(lens).value();
  // One metre above the table, looking down, its x to the right.
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.linear() = Vector3d(1, -1, -1).asDiagonal();
  pose.translation() = Vector3d(0.1, 0.2, 1);
  const auto flat = flatSurface(*camera, pose).value();
  Image<float> depth(64, 48, 1, 1.0f);
  const auto deep = surfaceFromDepth(*camera, pose, depth).value();
  for (const auto& [x, y] : {std::pair{3, 5}, {60, 40}, {31, 23}}) {
    const Vector3d point(flat(x, y, 0), flat(x, y, 1), flat(x, y, 2));
    EXPECT_NEAR(point.z(), 0, 1e-6);
    const auto pixel = camera->project(pose.inverse() * point);
    ASSERT_TRUE(pixel);
    EXPECT_NEAR((*pixel - Eigen::Vector2d(x + 0.5, y + 0.5)).norm(), 0, 1e-4);  // floats
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(deep(x, y, c), flat(x, y, c), 1e-6);
  }
  pose.linear() = Vector3d(1, 1, 1).asDiagonal();  // looks away from the table
  EXPECT_FALSE(flatSurface(*camera, pose));
  EXPECT_FALSE(surfaceFromDepth(*camera, pose, Image<float>(10, 10, 1, 1.0f)));
}

TEST(NearLight, NeedsToKnowWhereTheLampWas) {
  auto sketch = testing::makeSketch(
      freshFolder("sketch"), 16, 16, testing::randomLights(20, 1),
      [](const Vector3d& light) { return testing::renderBalls(16, 16, light); });
  CompressOptions options;
  options.surface = std::make_shared<SurfacePoints>(16, 16, 3);
  SilentProgress progress;
  const auto result = compress(sketch, options, progress);
  ASSERT_FALSE(result);
  EXPECT_NE(result.error().message.find("frame 0 has no lamp position"), std::string::npos);
}

}  // namespace
}  // namespace lightsketch
