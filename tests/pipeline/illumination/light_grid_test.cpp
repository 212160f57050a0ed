#include "pipeline/illumination/light_grid.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <numeric>
#include <random>

namespace lightsketch {
namespace {

using Eigen::Vector3d;
using std::numbers::pi;
using Domain = LightGrid::Domain;

Vector3d randomDirection(std::mt19937& random) {
  std::normal_distribution<double> normal;
  return Vector3d(normal(random), normal(random), normal(random)).normalized();
}

double angle(const Vector3d& a, const Vector3d& b) { return 2 * std::asin((a - b).norm() / 2); }

double sum(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0);
}

std::vector<Vector3d> randomLights(int count, std::uint32_t seed) {
  std::mt19937 random(seed);
  std::vector<Vector3d> lights;
  for (int i = 0; i < count; ++i) {
    Vector3d d = randomDirection(random);
    d.z() = std::abs(d.z());
    lights.push_back(d);
  }
  return lights;
}

TEST(LightGrid, RefusesCountsOutsideItsRange) {
  EXPECT_FALSE(LightGrid::create(63));
  EXPECT_FALSE(LightGrid::create(10001));
  EXPECT_TRUE(LightGrid::create(64));
}

// The plain spiral's closest pair lies at 0.81 of the hexagonal lattice's spacing and its rim nodes
// on the rim; the bars ask for better.
TEST(LightGrid, NodesAreNearlyEquidistant) {
  for (const Domain domain : {Domain::kHemisphere, Domain::kSphere}) {
    for (const int count : {64, 257, 1000, 4096, 10000}) {
      const auto grid = LightGrid::create(count, domain);
      ASSERT_TRUE(grid);
      ASSERT_EQ(grid->size(), count);
      double closest = pi;
      double loneliest = 0;
      double lowest = 1;
      const auto& nodes = grid->directions();
      for (std::size_t i = 0; i < nodes.size(); ++i) {
        ASSERT_NEAR(nodes[i].norm(), 1, 1e-12);
        double nearest = pi;
        for (std::size_t j = 0; j < nodes.size(); ++j) {
          if (i != j) nearest = std::min(nearest, angle(nodes[i], nodes[j]));
        }
        closest = std::min(closest, nearest);
        loneliest = std::max(loneliest, nearest);
        lowest = std::min(lowest, nodes[i].z());
      }
      const double spacing = grid->spacing().radians();
      fmt::print(
          "{} {:5}: neighbours at {:.3f} to {:.3f} of {:.2f} degrees, lowest node {:.2f} spacings "
          "up\n",
          domain == Domain::kHemisphere ? "hemisphere" : "sphere    ", count, closest / spacing,
          loneliest / spacing, grid->spacing().degrees(), std::asin(lowest) / spacing);
      EXPECT_GT(closest / spacing, 0.85);
      EXPECT_LT(loneliest / spacing, 1.05);
      if (domain == Domain::kHemisphere) {
        EXPECT_GT(std::asin(lowest) / spacing, 0.3);
      }
    }
  }
}

TEST(LightGrid, NearestAgreesWithBruteForceInEveryDirection) {
  std::mt19937 random(1);
  for (const int count : {64, 1000, 5000}) {
    const auto grid = LightGrid::create(count);
    ASSERT_TRUE(grid);
    for (int k = 0; k < 2000; ++k) {
      const Vector3d query = randomDirection(random);  // below the horizon as well
      const auto& nodes = grid->directions();
      double best = 9;
      for (const auto& node : nodes) best = std::min(best, (node - query).squaredNorm());
      const int found = grid->nearest(query);
      ASSERT_EQ((nodes[static_cast<std::size_t>(found)] - query).squaredNorm(), best);
    }
    for (int i = 0; i < count; ++i) {
      ASSERT_EQ(grid->nearest(grid->directions()[static_cast<std::size_t>(i)]), i);
    }
  }
}

TEST(VoronoiSolidAngles, OfAGridCoverTheHemisphereAndTheSphere) {
  for (const int count : {64, 1000, 10000}) {
    const auto hemisphere = LightGrid::create(count);
    const auto cells = voronoiSolidAngles(hemisphere->directions());
    ASSERT_TRUE(cells);
    EXPECT_NEAR(sum(*cells), 2 * pi, 1e-9);  // exact areas: only rounding is left
    const auto [smallest, largest] = std::minmax_element(cells->begin(), cells->end());
    EXPECT_GT(*smallest * count / (2 * pi), 0.75);
    EXPECT_LT(*largest * count / (2 * pi), 1.25);
    const auto sphere = LightGrid::create(count, Domain::kSphere);
    const auto all = voronoiSolidAngles(sphere->directions(), {.hemisphereOnly = false});
    ASSERT_TRUE(all);
    EXPECT_NEAR(sum(*all), 4 * pi, 1e-9);
  }
}

// Monte Carlo over the sphere: 400,000 points put the one-sigma error of a fraction f at
// sqrt(f (1 - f) / 400000) of 4 pi; five of them are allowed.
TEST(VoronoiSolidAngles, AgreeWithSampling) {
  const auto lights = randomLights(40, 7);
  const CellOptions options{.reach = Angle::degrees(20), .hemisphereOnly = true};
  const auto areas = voronoiSolidAngles(lights, options);
  ASSERT_TRUE(areas);
  std::mt19937 random(2);
  constexpr int kSamples = 400000;
  std::vector<int> hits(lights.size(), 0);
  for (int k = 0; k < kSamples; ++k) {
    const Vector3d d = randomDirection(random);
    if (d.z() < 0) continue;
    std::size_t best = 0;
    for (std::size_t i = 1; i < lights.size(); ++i) {
      if (lights[i].dot(d) > lights[best].dot(d)) best = i;
    }
    if (lights[best].dot(d) >= std::cos(options.reach.radians())) ++hits[best];
  }
  for (std::size_t i = 0; i < lights.size(); ++i) {
    const double fraction = static_cast<double>(hits[i]) / kSamples;
    const double sigma = std::sqrt(std::max(fraction, 1e-5) * (1 - fraction) / kSamples);
    EXPECT_NEAR((*areas)[i] / (4 * pi), fraction, 5 * sigma) << i;
  }
}

TEST(VoronoiSolidAngles, OfFewLightsAreCapsAndHalfCaps) {
  const Angle reach = Angle::degrees(25);
  const double cap = 2 * pi * (1 - std::cos(reach.radians()));
  const Vector3d up = Vector3d::UnitZ();
  const std::vector<Vector3d> one{up};
  EXPECT_NEAR(voronoiSolidAngles(one, {.reach = reach})->at(0), cap, 1e-12);
  // A light on the rim keeps the half above the horizon.
  const std::vector<Vector3d> rim{Vector3d::UnitX()};
  EXPECT_NEAR(voronoiSolidAngles(rim, {.reach = reach})->at(0), cap / 2, 1e-12);
  EXPECT_NEAR(voronoiSolidAngles(rim, {.reach = reach, .hemisphereOnly = false})->at(0), cap,
              1e-12);
  // Two far apart have a cap each; two that coincide, or nearly so, share one.
  const std::vector<Vector3d> apart{up, Vector3d(1, 0, 1e-3).normalized()};
  EXPECT_NEAR(voronoiSolidAngles(apart, {.reach = reach})->at(0), cap, 1e-12);
  for (const double distance : {0.0, 1e-9, 1e-6}) {
    const std::vector<Vector3d> twins{up, Vector3d(distance, 0, 1).normalized(), up};
    const auto areas = voronoiSolidAngles(twins, {.reach = reach});
    EXPECT_NEAR(sum(*areas), cap, 1e-5);
    for (const double area : *areas) EXPECT_GT(area, cap * 0.24);
  }
  // Without a reach given, one, two and three lights get one too.
  const std::vector<Vector3d> three{up, Vector3d(0.3, 0, 1).normalized(),
                                    Vector3d(0, 0.3, 1).normalized()};
  for (std::size_t n = 1; n <= 3; ++n) {
    const auto areas = voronoiSolidAngles(std::span(three).first(n));
    ASSERT_TRUE(areas);
    for (const double area : *areas) EXPECT_GT(area, 1e-3);
    EXPECT_LT(sum(*areas), pi);
  }
  EXPECT_FALSE(voronoiSolidAngles({}));
}

// Lights in a cone of 40 degrees cover that cone and a rim around it, not the hemisphere.
TEST(VoronoiSolidAngles, LeaveTheUnseenPartToNobody) {
  const auto grid = LightGrid::create(600);
  std::vector<Vector3d> seen;
  for (const auto& d : grid->directions()) {
    if (d.z() > std::cos(40 * pi / 180)) seen.push_back(d);
  }
  const double covered = sum(*voronoiSolidAngles(seen));
  EXPECT_GT(covered, 2 * pi * (1 - std::cos(40 * pi / 180)));
  EXPECT_LT(covered, 2 * pi * (1 - std::cos((40 + 1.2 * grid->spacing().degrees()) * pi / 180)));
}

}  // namespace
}  // namespace lightsketch
