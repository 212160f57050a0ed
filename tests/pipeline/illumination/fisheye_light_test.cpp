#include "pipeline/illumination/fisheye_light.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <numbers>

#include "pipeline/illumination/light_grid.h"

namespace lightsketch {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;
using std::numbers::pi;

// An equidistant lens (d = theta); a picture as wide as 190 degrees.
std::shared_ptr<const CameraModel> lens(int size, double fieldDegrees) {
  FisheyeParameters parameters;
  parameters.width = size;
  parameters.height = size;
  parameters.maxFieldAngle = Angle::degrees(fieldDegrees);
  parameters.fx = parameters.fy = size / 2.0 / Angle::degrees(95).radians();
  parameters.cx = parameters.cy = size / 2.0;
  return *FisheyeModel::create(parameters);
}

// A camera that looks along `forward`.
Isometry3d facing(const Vector3d& forward) {
  Isometry3d pose = Isometry3d::Identity();
  const Vector3d x = Vector3d::UnitY().cross(forward).normalized();
  pose.linear().col(0) = x;
  pose.linear().col(1) = forward.cross(x);
  pose.linear().col(2) = forward;
  return pose;
}

Frame constantFrame(PixelFormat format, int size, std::uint32_t count) {
  Frame frame;
  frame.format = format;
  frame.width = frame.height = size;
  const auto& info = pixelFormatInfo(format);
  for (int i = 0; i < size * size; ++i) {
    for (int k = 0; k < info.bytesPerPixel; ++k) {
      frame.bytes.push_back(
          static_cast<std::uint8_t>(info.bits > 8 ? count >> (8 * k) & 0xff : count));
    }
  }
  return frame;
}

TEST(FisheyeLight, OfAConstantSkyIsTheSolidAngles) {
  const auto grid = LightGrid::create(500);
  const auto light = FisheyeLight::create(*lens(480, 95), facing(Vector3d::UnitZ()),
                                          grid->directions(), {.lampIrradiance = 1});
  ASSERT_TRUE(light) << light.error().message;
  EXPECT_NEAR(light->coveredSolidAngle(), 2 * pi, 1e-9);
  const auto areas = voronoiSolidAngles(grid->directions());
  for (const auto& [format, count, saturation] : {std::tuple{PixelFormat::kMono8, 51u, 255.0},
                                                  {PixelFormat::kMono12, 819u, 4095.0},
                                                  {PixelFormat::kMono16, 13107u, 65535.0},
                                                  {PixelFormat::kBayerRG8, 51u, 255.0},
                                                  {PixelFormat::kBayerRG12, 819u, 4095.0},
                                                  {PixelFormat::kRgb8, 51u, 255.0}}) {
    LightIntensities out;
    const auto done = light->intensities(constantFrame(format, 480, count), 5, out);
    ASSERT_TRUE(done) << done.error().message;
    ASSERT_EQ(out.rows(), 500);
    for (Eigen::Index i = 0; i < out.rows(); ++i) {
      for (int c = 0; c < 3; ++c) {  // radiance 5 at saturation, a fifth of it seen
        EXPECT_NEAR(out(i, c), areas->at(static_cast<std::size_t>(i)) * 5 * count / saturation,
                    1e-5 * areas->at(static_cast<std::size_t>(i)));
      }
    }
  }
}

TEST(FisheyeLight, CountsOnlyWhatTheCameraSees) {
  const auto sphere = LightGrid::create(1000, LightGrid::Domain::kSphere);
  for (const double field : {40.0, 70.0, 90.0}) {
    const auto light = FisheyeLight::create(*lens(480, field), facing(Vector3d(0.6, 0, 0.8)),
                                            sphere->directions(), {.lampIrradiance = 1});
    ASSERT_TRUE(light);
    LightIntensities out;
    ASSERT_TRUE(light->intensities(constantFrame(PixelFormat::kMono8, 480, 255), 1, out));
    // A cap of the field's radius, less the quads at its rim: up to 0.8 degrees of it.
    const double cap = 2 * pi * (1 - std::cos(Angle::degrees(field).radians()));
    const double rim = 2 * pi * std::sin(Angle::degrees(field).radians()) * 0.8 * pi / 180;
    EXPECT_LT(light->coveredSolidAngle(), cap * (1 + 1e-3));
    EXPECT_GT(light->coveredSolidAngle(), cap - rim);
    EXPECT_NEAR(out.col(0).sum(), light->coveredSolidAngle(), 1e-4);
  }
}

// A sky whose radiance is 1 + (direction along an axis): its integral over the hemisphere about +z
// is 2 pi + pi for +z, and each light's share is its cell's solid angle times the value at the
// cell's centroid.
TEST(FisheyeLight, PutsLightWhereItComesFrom) {
  const int size = 960;
  const auto camera = lens(size, 95);
  const auto pose = facing(Vector3d(0.05, -0.04, 1).normalized());
  const auto grid = LightGrid::create(300);
  const auto light = FisheyeLight::create(*camera, pose, grid->directions(), {.lampIrradiance = 1});
  ASSERT_TRUE(light);
  for (const Vector3d& axis : {Vector3d(1, 0, 0), Vector3d(0, 1, 0), Vector3d(0, 0, 1)}) {
    auto frame = constantFrame(PixelFormat::kMono16, size, 0);
    for (int y = 0; y < size; ++y) {
      for (int x = 0; x < size; ++x) {
        const auto ray = camera->unproject({x + 0.5, y + 0.5});
        if (!ray) continue;
        const double radiance = 1 + (pose.linear() * *ray).dot(axis);
        const auto count = static_cast<unsigned>(std::lround(radiance / 2 * 65535));
        const std::size_t at =
            2 * (static_cast<std::size_t>(y) * size + static_cast<std::size_t>(x));
        frame.bytes[at] = static_cast<std::uint8_t>(count & 0xff);
        frame.bytes[at + 1] = static_cast<std::uint8_t>(count >> 8);
      }
    }
    LightIntensities out;
    ASSERT_TRUE(light->intensities(frame, 2, out));
    for (std::size_t i = 0; i < grid->directions().size(); ++i) {
      // Lights lie near their cells' centroids (to a tenth of 9 degrees) but for the rim's, which
      // are cut or reach beyond them.
      const Vector3d& l = grid->directions()[i];
      if (l.z() < 0.25 || light->solidAngles()[i] < 0.9 * 2 * pi / 300) continue;
      const double mean = out(static_cast<Eigen::Index>(i), 0) / light->solidAngles()[i];
      EXPECT_NEAR(mean, 1 + l.dot(axis), 0.025) << l.transpose();
    }
    if (axis.z() == 1) {
      EXPECT_NEAR(out.col(0).sum(), 3 * pi, 2e-3 * 3 * pi);  // cells' parts, as above
    }
  }
}

TEST(FisheyeLight, TellsColoursApart) {
  const auto grid = LightGrid::create(100);
  const auto light =
      FisheyeLight::create(*lens(240, 95), facing(Vector3d::UnitZ()), grid->directions());
  ASSERT_TRUE(light);
  // R 200, G 100, B 50 in the mosaic's cell of 2 x 2, row by row.
  for (const auto& [format, cell] :
       {std::pair{PixelFormat::kBayerRG8, std::array{200, 100, 100, 50}},
        {PixelFormat::kBayerGR8, {100, 200, 50, 100}},
        {PixelFormat::kBayerGB8, {100, 50, 200, 100}},
        {PixelFormat::kBayerBG8, {50, 100, 100, 200}}}) {
    auto bayer = constantFrame(format, 240, 0);
    for (int y = 0; y < 240; ++y) {
      for (int x = 0; x < 240; ++x) {
        bayer.bytes[static_cast<std::size_t>(y * 240 + x)] =
            static_cast<std::uint8_t>(cell[static_cast<std::size_t>(2 * (y % 2) + x % 2)]);
      }
    }
    LightIntensities out;
    ASSERT_TRUE(light->intensities(bayer, 1, out));
    EXPECT_NEAR(out(50, 0) / out(50, 1), 2, 1e-5) << pixelFormatInfo(format).name;
    EXPECT_NEAR(out(50, 2) / out(50, 1), 0.5, 1e-5) << pixelFormatInfo(format).name;
  }
}

TEST(FisheyeLight, TakesOffBlackAndUsesTheSensorsResponse) {
  const auto grid = LightGrid::create(100);
  const auto camera = lens(240, 95);
  const auto pose = facing(Vector3d::UnitZ());
  const auto sumOf = [&](const FisheyeLightOptions& options, int count) {
    const auto light = FisheyeLight::create(*camera, pose, grid->directions(), options);
    EXPECT_TRUE(light);
    LightIntensities out;
    EXPECT_TRUE(light->intensities(
        constantFrame(PixelFormat::kMono8, 240, static_cast<std::uint32_t>(count)), 1, out));
    return static_cast<double>(out.col(0).sum());
  };
  EXPECT_NEAR(sumOf({.lampIrradiance = 1, .blackLevel = 15}, 15), 0, 1e-6);
  EXPECT_NEAR(sumOf({.lampIrradiance = 1, .blackLevel = 15}, 135), pi, 1e-4);
  auto sensor = std::make_shared<SensorModel>();
  sensor->width = sensor->height = 240;
  // Half of the counts' range is a quarter of the exposure.
  sensor->response = *ResponseCurve::tabulated({{0, 0.25, 1}}, 255, 255);
  EXPECT_NEAR(sumOf({.lampIrradiance = 1, .sensor = sensor}, 255), 2 * pi, 1e-4);
  EXPECT_NEAR(sumOf({.lampIrradiance = 1, .sensor = sensor}, 127), 2 * pi * 0.25 * 254 / 255, 1e-4);
  sensor->flatField = *FlatField::create(2, 2, 1, {1, 0.5, 1, 0.5});
  const double shaded = sumOf({.lampIrradiance = 1, .sensor = sensor}, 255);
  // 1 / (1 - u / 2) over a picture symmetrical about u = 1/2: between its least and its most.
  EXPECT_GT(shaded, 2 * pi * 4 / 3);
  EXPECT_LT(shaded, 2 * pi * 2);
}

TEST(FisheyeLight, LeavesHotPixelsOut) {
  const auto grid = LightGrid::create(100);
  auto sensor = std::make_shared<SensorModel>();
  sensor->width = sensor->height = 240;
  sensor->hotPixels = {{100, 120}, {101, 120}};
  const auto light =
      FisheyeLight::create(*lens(240, 95), facing(Vector3d::UnitZ()), grid->directions(),
                           {.lampIrradiance = 1, .sensor = sensor});
  ASSERT_TRUE(light);
  auto frame = constantFrame(PixelFormat::kMono8, 240, 100);
  frame.bytes[120 * 240 + 100] = frame.bytes[120 * 240 + 101] = 255;
  LightIntensities out;
  ASSERT_TRUE(light->intensities(frame, 2.55, out));
  EXPECT_NEAR(out.col(0).sum(), 2 * pi, 1e-4);
}

TEST(FisheyeLight, GivesCellsSmallerThanAPixelTheLightThere) {
  const auto grid = LightGrid::create(4096);                                         // 2.2 degrees
  const auto light = FisheyeLight::create(*lens(64, 95), facing(Vector3d::UnitZ()),  // quads of 6
                                          grid->directions(), {.lampIrradiance = 1});
  ASSERT_TRUE(light);
  LightIntensities out;
  ASSERT_TRUE(light->intensities(constantFrame(PixelFormat::kMono8, 64, 255), 1, out));
  EXPECT_NEAR(out.col(0).sum(), light->coveredSolidAngle(), 1e-4);
  EXPECT_NEAR(light->coveredSolidAngle(), 2 * pi, 0.15);  // quads at the field's rim see nothing
}

TEST(FisheyeLight, RefusesFramesOfOtherCameras) {
  const auto grid = LightGrid::create(64);
  const auto light =
      FisheyeLight::create(*lens(64, 95), facing(Vector3d::UnitZ()), grid->directions());
  ASSERT_TRUE(light);
  LightIntensities out;
  EXPECT_FALSE(light->intensities(constantFrame(PixelFormat::kMono8, 32, 0), 1, out));
  auto torn = constantFrame(PixelFormat::kMono8, 64, 0);
  torn.bytes.pop_back();
  EXPECT_FALSE(light->intensities(torn, 1, out));
}

}  // namespace
}  // namespace lightsketch
