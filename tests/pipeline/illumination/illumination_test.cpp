#include "pipeline/illumination/illumination.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <numbers>

#include "pipeline/illumination/light_grid.h"
#include "pipeline/sketch/image_file.h"

namespace lightsketch {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;
using std::numbers::pi;

// A map whose radiance is the direction itself (plus 2, to stay positive).
RadianceImage directionMap(int width) {
  RadianceImage map(width, width / 2, 3);
  for (int y = 0; y < map.height(); ++y) {
    for (int x = 0; x < width; ++x) {
      const double longitude = pi * (1 - 2 * (x + 0.5) / width);
      const double latitude = pi * (0.5 - (y + 0.5) / map.height());
      map(x, y, 0) = static_cast<float>(2 + std::cos(latitude) * std::sin(longitude));
      map(x, y, 1) = static_cast<float>(2 + std::sin(latitude));
      map(x, y, 2) = static_cast<float>(2 + std::cos(latitude) * std::cos(longitude));
    }
  }
  return map;
}

RadianceImage constantMap(int width, float value) { return {width, width / 2, 3, value}; }

TEST(EnvironmentRadiance, FollowsTheLatLongOfOpenExr) {
  const auto map = directionMap(512);
  for (const Vector3d& d :
       {Vector3d(0, 0, 1), Vector3d(1, 0, 0), Vector3d(0, 1, 0), Vector3d(0, 0, -1),
        Vector3d(-1, 0, 0), Vector3d(0, -1, 0), Vector3d(0.48, 0.6, -0.64)}) {
    const Vector3f radiance = environmentRadiance(map, d);
    // Half a texel is 0.006 radians; at the poles the map has no sample, so nothing to interpolate.
    EXPECT_LT((radiance - Vector3f::Constant(2) - d.cast<float>()).norm(), 0.0065f)
        << d.transpose();
  }
}

// The labelled map draws, on each of its four level faces, dark arms of the coordinate cross from
// the face's centre towards the positive axes; towards the negative ones there is none.
TEST(EnvironmentRadiance, FindsTheAxesOfTheLabelledMap) {
  const std::filesystem::path path =
      LIGHTSKETCH_SOURCE_DIR "/../shared/data/env/orientation/OrientationLatLong.exr";
  if (!std::filesystem::exists(path)) GTEST_SKIP() << path << " is not here";
  const auto map = readImage(path);
  ASSERT_TRUE(map) << map.error().message;
  // Darkest blue (its text is light blue) within half a degree, against lines two texels wide.
  const auto darkest = [&](const Vector3d& direction) {
    float least = 1;
    for (double dx : {-0.008, 0.0, 0.008}) {
      for (double dy : {-0.008, 0.0, 0.008}) {
        for (double dz : {-0.008, 0.0, 0.008}) {
          least = std::min(
              least,
              environmentRadiance(*map, (direction + Vector3d(dx, dy, dz)).normalized()).z());
        }
      }
    }
    return least;
  };
  const Vector3d x = Vector3d::UnitX();
  const Vector3d y = Vector3d::UnitY();
  const Vector3d z = Vector3d::UnitZ();
  const std::pair<Vector3d, Vector3d> faces[] = {{x, z}, {-x, z}, {z, x}, {-z, x}};
  for (const auto& [face, across] : faces) {
    EXPECT_LT(darkest(face + 0.2 * y), 0.3f) << face.transpose();
    EXPECT_LT(darkest(face + 0.2 * across), 0.3f) << face.transpose();
    EXPECT_GT(darkest(face - 0.25 * y), 0.45f) << face.transpose();
    EXPECT_GT(darkest(face - 0.2 * across), 0.45f) << face.transpose();
  }
}

TEST(EnvironmentIntensities, OfAConstantMapAreTheSolidAngles) {
  const auto grid = LightGrid::create(500);
  std::vector<Vector3d> lights = grid->directions();
  lights.push_back(lights[3]);  // a coinciding light shares its cell
  lights.push_back(Vector3d(lights[7] + Vector3d(1e-7, 0, 0)).normalized());
  const auto intensities = intensitiesOf(constantMap(64, 1), lights, {.lampIrradiance = 1});
  ASSERT_TRUE(intensities) << intensities.error().message;
  const auto areas = voronoiSolidAngles(lights);
  double total = 0;
  for (std::size_t i = 0; i < lights.size(); ++i) {
    for (int c = 0; c < 3; ++c) {
      EXPECT_FLOAT_EQ((*intensities)(static_cast<Eigen::Index>(i), c),
                      static_cast<float>((*areas)[i]));
    }
    total += (*intensities)(static_cast<Eigen::Index>(i), 0);
  }
  EXPECT_NEAR(total, 2 * pi, 1e-4);  // float sums
}

// Moments of the map over the hemisphere are known: the integral of (2 + x, 2 + y, 2 + z) is
// (4 pi, 4 pi, 5 pi).
TEST(EnvironmentIntensities, IntegrateTheMapOverTheHemisphere) {
  const auto grid = LightGrid::create(300);
  const auto intensities =
      intensitiesOf(directionMap(256), grid->directions(), {.lampIrradiance = 1});
  ASSERT_TRUE(intensities);
  const Vector3f total = intensities->colwise().sum().transpose();
  // Texels of 1.4 degrees are constant each; cells' sampled areas are off by up to 1e-3.
  EXPECT_NEAR(total.x(), 4 * pi, 2e-3 * 4 * pi);
  EXPECT_NEAR(total.y(), 4 * pi, 2e-3 * 4 * pi);
  EXPECT_NEAR(total.z(), 5 * pi, 2e-3 * 5 * pi);
}

TEST(EnvironmentIntensities, ASmallSunGoesToTheLightNextToIt) {
  const auto grid = LightGrid::create(200);
  auto map = constantMap(1024, 0);
  // Texel (300, 100): longitude 74.4 degrees, latitude 72.3 degrees.
  for (int c = 0; c < 3; ++c) map(300, 100, c) = 5000;
  const double longitude = pi * (1 - 2 * 300.5 / 1024);
  const double latitude = pi * (0.5 - 100.5 / 512);
  const Vector3d sun(std::cos(latitude) * std::sin(longitude), std::sin(latitude),
                     std::cos(latitude) * std::cos(longitude));
  const auto intensities = intensitiesOf(map, grid->directions());
  ASSERT_TRUE(intensities);
  const int nearest = grid->nearest(sun);
  const double texel =
      2 * pi / 1024 * (std::sin(latitude + pi / 1024) - std::sin(latitude - pi / 1024));
  // Divided by the default lamp irradiance pi; 1 percent for the cell's sampled area.
  EXPECT_NEAR((*intensities)(nearest, 1), 5000 * texel / pi, 0.01 * 5000 * texel / pi);
  EXPECT_NEAR(intensities->col(1).sum(), (*intensities)(nearest, 1), 1e-9);
  // Turned by half a turn about +y the sun stands behind the scene, where nobody is lit by it.
  const auto turned = intensitiesOf(map, grid->directions(), {.rotationDegrees = 180});
  EXPECT_EQ(turned->sum(), 0);
  // From +z towards +x: the sun of a quarter turn on.
  const auto quarter = intensitiesOf(map, grid->directions(), {.rotationDegrees = -70});
  const double other = longitude - 70 * pi / 180;
  const Vector3d moved(std::cos(latitude) * std::sin(other), std::sin(latitude),
                       std::cos(latitude) * std::cos(other));
  EXPECT_GT((*quarter)(grid->nearest(moved), 0), 0);
}

TEST(EnvironmentIntensities, RefuseMapsThatAreNotLatLong) {
  const std::vector<Vector3d> lights{Vector3d::UnitZ()};
  EXPECT_FALSE(intensitiesOf(RadianceImage(64, 64, 3), lights));
  EXPECT_FALSE(intensitiesOf(RadianceImage(), lights));
  EXPECT_FALSE(intensitiesOf(constantMap(64, 1), {}));
  EXPECT_FALSE(intensitiesOf(constantMap(64, 1), lights, {.lampIrradiance = 0}));
}

TEST(LampIntensities, OfALampAtALightAreThatLightInItsColour) {
  const auto grid = LightGrid::create(100);
  const auto interpolator = DirectionInterpolator::create(
      grid->directions(),
      {.kernel = InterpolationSettings::Kernel::kLinear, .trendDegree = 1, .nugget = 0});
  ASSERT_TRUE(interpolator);
  const std::vector<DirectionalLamp> lamps{{grid->directions()[5], {1, 0.5, 0}},
                                           {grid->directions()[9], {0, 0, 2}}};
  const auto intensities = intensitiesOf(lamps, *interpolator);
  LightIntensities expected = LightIntensities::Zero(100, 3);
  expected.row(5) << 1, 0.5f, 0;
  expected.row(9) << 0, 0, 2;
  EXPECT_LT((intensities - expected).cwiseAbs().maxCoeff(), 1e-6f);
}

TEST(ReadLights, ReadsLampsAndNamesWhatIsWrong) {
  const auto path = std::filesystem::path(testing::TempDir()) / "lights.json";
  const auto write = [&](const char* text) { std::ofstream(path) << text; };
  write(R"({"format": "lightsketch-lights", "formatVersion": 1, "lights": [
            {"direction": [0, 0, 2], "colour": [1, 0.5, 0.25]}, {"direction": [1, 0, 0]}]})");
  const auto lamps = readLights(path);
  ASSERT_TRUE(lamps) << lamps.error().message;
  ASSERT_EQ(lamps->size(), 2u);
  EXPECT_EQ((*lamps)[0].direction, Vector3d::UnitZ());
  EXPECT_EQ((*lamps)[0].colour, Vector3d(1, 0.5, 0.25));
  EXPECT_EQ((*lamps)[1].colour, Vector3d::Ones());
  for (
      const char* bad :
      {R"({"format": "lightsketch-lights", "formatVersion": 1, "lights": [{"direction": [0, 0, 0]}]})",
       R"({"format": "lightsketch-lights", "formatVersion": 1, "lights": []})",
       R"({"format": "lightsketch-lights", "formatVersion": 1, "lights": [7]})",
       R"({"format": "lightsketch-lights", "formatVersion": 2, "lights": []})", "{"}) {
    write(bad);
    const auto refused = readLights(path);
    ASSERT_FALSE(refused) << bad;
    EXPECT_NE(refused.error().message.find("lights.json"), std::string::npos);
  }
}

}  // namespace
}  // namespace lightsketch
