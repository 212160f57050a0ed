#include "pipeline/illumination/direction_interpolation.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

#include "pipeline/illumination/light_grid.h"

namespace lightsketch {
namespace {

using Eigen::MatrixXf;
using Eigen::Vector3d;
using Eigen::VectorXd;
using Kernel = InterpolationSettings::Kernel;

constexpr Kernel kKernels[] = {Kernel::kThinPlate, Kernel::kLinear, Kernel::kCubic};

std::vector<Vector3d> randomLights(int count, std::uint32_t seed, double lowestZ = 0.1) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::vector<Vector3d> lights;
  while (static_cast<int>(lights.size()) < count) {
    const double z = normal(random);  // drawn in an order that compilers do not choose
    const double y = normal(random);
    const Vector3d d = Vector3d(normal(random), y, z).normalized();
    if (d.z() > lowestZ) lights.push_back(d);
  }
  return lights;
}

TEST(DirectionInterpolator, WeightsAddUpToOneAndReproduceTheTrend) {
  for (const int count : {40, 1500}) {  // one system, and one per query
    const auto lights = randomLights(count, 3);
    for (const Kernel kernel : kKernels) {
      for (int degree = 1; degree <= 3; ++degree) {
        const auto interpolator = DirectionInterpolator::create(
            lights, {.kernel = kernel, .trendDegree = degree, .nugget = 1e-3});
        ASSERT_TRUE(interpolator) << interpolator.error().message;
        for (const auto& query : randomLights(20, 4, -0.2)) {
          const VectorXd w = interpolator->weights(query);
          // 1e-7: systems over near neighbours are conditioned to about 1e8.
          EXPECT_NEAR(w.sum(), 1, 1e-7);
          Vector3d linear = Vector3d::Zero();
          double cubic = 0;
          const auto f = [](const Vector3d& d) { return d.x() * d.y() * d.z() + d.z() * d.z(); };
          for (int i = 0; i < count; ++i) {
            linear += w[i] * lights[static_cast<std::size_t>(i)];
            cubic += w[i] * f(lights[static_cast<std::size_t>(i)]);
          }
          EXPECT_LT((linear - query).norm(), 1e-6);
          // Neighbours alone do not determine a cubic trend.
          if (degree == 3 && count == 40) {
            EXPECT_NEAR(cubic, f(query), 1e-5);
          }
        }
      }
    }
  }
}

TEST(DirectionInterpolator, ReproducesTheLightsThemselvesWithoutNugget) {
  const auto lights = randomLights(60, 5);
  for (const Kernel kernel : kKernels) {
    const auto interpolator =
        DirectionInterpolator::create(lights, {.kernel = kernel, .trendDegree = 1, .nugget = 0});
    ASSERT_TRUE(interpolator);
    for (int i = 0; i < 60; ++i) {
      EXPECT_LT((interpolator->weights(lights[static_cast<std::size_t>(i)]) - VectorXd::Unit(60, i))
                    .norm(),
                1e-8);
    }
  }
}

TEST(DirectionInterpolator, PredictsASmoothFunctionBetweenLights) {
  const auto grid = LightGrid::create(300);
  const auto interpolator = DirectionInterpolator::create(grid->directions(), {.nugget = 0});
  const auto f = [](const Vector3d& d) { return std::exp(d.x() - 2 * d.y() * d.z()); };
  for (const auto& query : randomLights(200, 6)) {
    const VectorXd w = interpolator->weights(query);
    double value = 0;
    for (int i = 0; i < 300; ++i)
      value += w[i] * f(grid->directions()[static_cast<std::size_t>(i)]);
    // Spacing h = 0.15: thin plates err by about h^2 times the kernel's constant.
    EXPECT_NEAR(value, f(query), 0.01);
  }
}

TEST(DirectionInterpolator, WorksForOneTwoAndThreeLightsAndTwins) {
  const std::vector<Vector3d> lights{Vector3d::UnitZ(), Vector3d::UnitX(), Vector3d::UnitY(),
                                     Vector3d::UnitZ(), Vector3d(1e-7, 0, 1).normalized()};
  for (std::size_t n = 1; n <= lights.size(); ++n) {
    for (const Kernel kernel : kKernels) {
      const auto interpolator = DirectionInterpolator::create(
          std::span(lights).first(n), {.kernel = kernel, .trendDegree = 3, .nugget = 0});
      ASSERT_TRUE(interpolator) << n;
      const VectorXd w = interpolator->weights(Vector3d::UnitZ());
      EXPECT_EQ(interpolator->lightCount(), static_cast<int>(n));
      EXPECT_NEAR(w.sum(), 1, 1e-9);
      double here = 0;
      for (std::size_t i = 0; i < n; ++i) {
        if (lights[i].z() > 0.9) here += w[static_cast<Eigen::Index>(i)];
      }
      EXPECT_NEAR(here, 1, 1e-9) << n;
    }
  }
  EXPECT_FALSE(DirectionInterpolator::create({}, {}));
  EXPECT_FALSE(DirectionInterpolator::create(lights, {.trendDegree = 4}));
  EXPECT_FALSE(DirectionInterpolator::create(lights, {.outsideClamp = 2}));
}

TEST(DirectionInterpolator, HullOfARingIsItsCap) {
  std::vector<Vector3d> ring;
  for (int i = 0; i < 36; ++i) {
    const double a = i * std::numbers::pi / 18;
    ring.emplace_back(0.8 * std::cos(a), 0.8 * std::sin(a), 0.6);
  }
  ring.push_back(Vector3d::UnitZ());
  const auto interpolator = DirectionInterpolator::create(ring, {});
  EXPECT_TRUE(interpolator->insideHull(Vector3d(0.3, -0.4, 0.9).normalized()));
  EXPECT_FALSE(interpolator->insideHull(Vector3d(0.9, 0, 0.6).normalized()));
  EXPECT_FALSE(interpolator->insideHull(-Vector3d::UnitZ()));
  for (const auto& light : ring) EXPECT_TRUE(interpolator->insideHull(light));
  // A whole sphere of lights has no outside; a pair has next to no inside.
  const auto sphere = LightGrid::create(100, LightGrid::Domain::kSphere);
  EXPECT_TRUE(
      DirectionInterpolator::create(sphere->directions(), {})->insideHull(-Vector3d::UnitZ()));
  const auto pair = DirectionInterpolator::create(std::span(ring).first(2), {});
  EXPECT_FALSE(pair->insideHull(Vector3d::UnitZ()));
  EXPECT_TRUE(pair->insideHull((ring[0] + ring[1]).normalized()));
}

TEST(DirectionInterpolator, ClampsQueriesToTheHull) {
  const auto lights = randomLights(50, 8, 0.5);
  InterpolationSettings settings{.nugget = 0, .outsideClamp = 1};
  const auto interpolator = DirectionInterpolator::create(lights, settings);
  const VectorXd w = interpolator->weights(Vector3d(1, 0.2, -0.3).normalized());
  Vector3d reached = Vector3d::Zero();  // the linear trend tells where the query went
  for (int i = 0; i < 50; ++i) reached += w[i] * lights[static_cast<std::size_t>(i)];
  EXPECT_GT(reached.z(), 0.4);
  EXPECT_TRUE(interpolator->insideHull(reached.normalized()));
}

// Leave-one-out by hand, one system less a light at a time, must rank the settings as the closed
// form does: the chosen settings' error is the least of a list of others.
TEST(ChooseInterpolation, HasTheLeastLeaveOneOutError) {
  const auto lights = randomLights(45, 9, 0.3);
  MatrixXf samples(45, 3);
  for (int i = 0; i < 45; ++i) {
    const Vector3d& d = lights[static_cast<std::size_t>(i)];
    samples.row(i) << static_cast<float>(std::max(0.0, d.x())),
        static_cast<float>(std::pow(d.z(), 20)), static_cast<float>(d.y() * d.z());
  }
  const auto error = [&](const InterpolationSettings& settings) {
    double sum = 0;
    for (int i = 0; i < 45; ++i) {
      std::vector<Vector3d> others(lights);
      others.erase(others.begin() + i);
      const auto interpolator = DirectionInterpolator::create(others, settings);
      const VectorXd w = interpolator->weights(lights[static_cast<std::size_t>(i)]);
      MatrixXf rest(44, 3);
      rest << samples.topRows(i), samples.bottomRows(44 - i);
      sum += (w.cast<float>().transpose() * rest - samples.row(i)).squaredNorm();
    }
    return sum;
  };
  const auto chosen = chooseInterpolation(lights, samples);
  ASSERT_TRUE(chosen) << chosen.error().message;
  const double least = error(*chosen);
  for (const Kernel kernel : kKernels) {
    for (const int degree : {1, 2, 3}) {
      for (const double nugget : {1e-4, 1e-2, 1e-1}) {
        for (const double clamp : {0.0, 0.5, 1.0}) {
          // A relative 1e-6 for the samples' float precision.
          EXPECT_LE(least, error({kernel, degree, nugget, clamp}) * (1 + 1e-6))
              << chosen->describe();
        }
      }
    }
  }
}

TEST(ChooseInterpolation, SmoothsNoiseAndNotSignal) {
  const auto lights = randomLights(80, 10);
  std::mt19937 random(11);
  std::normal_distribution<float> noise(0, 0.2f);
  MatrixXf noisy(80, 50);
  MatrixXf clean(80, 50);
  for (int i = 0; i < 80; ++i) {
    for (int k = 0; k < 50; ++k) {
      clean(i, k) = static_cast<float>(std::sin(3 * lights[static_cast<std::size_t>(i)].x() + k));
      noisy(i, k) = clean(i, k) + noise(random);
    }
  }
  const auto forNoise = chooseInterpolation(lights, noisy);
  const auto forSignal = chooseInterpolation(lights, clean);
  ASSERT_TRUE(forNoise && forSignal);
  EXPECT_GT(forNoise->nugget, forSignal->nugget);
}

TEST(ChooseInterpolation, FallsBackWhereThereIsNothingToCompare) {
  const std::vector<Vector3d> lights{Vector3d::UnitZ()};
  EXPECT_TRUE(chooseInterpolation(lights, MatrixXf::Ones(1, 4)));
  EXPECT_FALSE(chooseInterpolation(lights, MatrixXf::Ones(2, 4)));
  const auto many = randomLights(1500, 12);
  MatrixXf samples(1500, 2);
  for (int i = 0; i < 1500; ++i)
    samples.row(i) = many[static_cast<std::size_t>(i)].head<2>().cast<float>().transpose();
  const auto settings = chooseInterpolation(many, samples);
  ASSERT_TRUE(settings);
  EXPECT_TRUE(DirectionInterpolator::create(many, *settings));
}

}  // namespace
}  // namespace lightsketch
