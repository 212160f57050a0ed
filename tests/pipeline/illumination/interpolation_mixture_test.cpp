#include "pipeline/illumination/interpolation_mixture.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

namespace lightsketch {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

std::vector<Vector3d> randomLights(int count, std::uint32_t seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::vector<Vector3d> lights;
  while (static_cast<int>(lights.size()) < count) {
    const Vector3d d = Vector3d(normal(random), normal(random), normal(random)).normalized();
    if (d.z() > 0.2) lights.push_back(d);
  }
  return lights;
}

TEST(InterpolationCandidates, LeaveOneOutIsWhatTheOtherLightsPredict) {
  const auto lights = randomLights(30, 1);
  const auto candidates = interpolationCandidates(lights);
  ASSERT_GT(candidates.size(), 40u);
  for (const auto& candidate : candidates) {
    for (const int left : {0, 17}) {
      std::vector<Vector3d> others = lights;
      others.erase(others.begin() + left);
      const auto by = DirectionInterpolator::create(others, candidate.settings).value();
      const VectorXd expected = by.weights(lights[static_cast<std::size_t>(left)]);
      EXPECT_EQ(candidate.leaveOneOut(left, left), 0);
      for (int j = 0, k = 0; j < 30; ++j) {
        if (j == left) continue;
        // 1e-4: inverted in double precision at condition numbers up to 1e8, kept as floats.
        EXPECT_NEAR(candidate.leaveOneOut(left, j), expected[k++], 1e-4)
            << candidate.settings.describe();
      }
    }
  }
}

TEST(InterpolationCandidates, TooFewLightsDetermineNone) {
  EXPECT_TRUE(interpolationCandidates(randomLights(1, 2)).empty());
  // Three lights less one still determine a constant trend.
  for (const auto& candidate : interpolationCandidates(randomLights(3, 2)))
    EXPECT_EQ(candidate.settings.trendDegree, 0);
}

TEST(InterpolationCandidates, HeightCountsAsOftenAsTheStretchSays) {
  const auto lights = randomLights(40, 3);
  const Vector3d query = Vector3d(0.5, -0.4, 0.3).normalized();
  const Vector3d mirrored(query.x(), query.y(), -query.z());
  const auto differ = [&](double stretch) {
    const auto interpolator =
        DirectionInterpolator::create(lights, {.kernel = InterpolationSettings::Kernel::kLinear,
                                               .trendDegree = 0,
                                               .nugget = 0,
                                               .stretch = stretch})
            .value();
    return (interpolator.weights(query) - interpolator.weights(mirrored)).norm();
  };
  EXPECT_LT(differ(0), 1e-9);  // seen from above they are one direction
  EXPECT_GT(differ(1), 0.1);
  EXPECT_FALSE(DirectionInterpolator::create(lights, {.stretch = -1}));
}

TEST(BestMixture, WeighsIndependentErrorsByTheirInverseSquares) {
  // Least squares of independent errors of variances 1, 4 and 100: shares as 1 : 1/4 : 1/100.
  const VectorXd a = bestMixture(Eigen::Vector3d(1, 4, 100).asDiagonal().toDenseMatrix());
  EXPECT_NEAR(a[0], 1 / 1.26, 1e-4);
  EXPECT_NEAR(a[1], 0.25 / 1.26, 1e-4);
  EXPECT_NEAR(a[2], 0.01 / 1.26, 1e-4);
}

TEST(BestMixture, LeavesOutWhatOnlyAddsErrors) {
  // The second's errors are the first's, twice as large.
  const MatrixXd products = Eigen::Vector2d(1, 2) * Eigen::RowVector2d(1, 2);
  EXPECT_EQ(bestMixture(products), Eigen::Vector2d(1, 0));
}

TEST(BestMixture, IsNoWorseThanAnyOneOrAnyPair) {
  std::mt19937 random(4);
  std::normal_distribution<double> normal;
  const MatrixXd errors = MatrixXd::NullaryExpr(12, 30, [&] { return 1 + normal(random); });
  const MatrixXd G = errors * errors.transpose();
  const VectorXd a = bestMixture(G);
  EXPECT_NEAR(a.sum(), 1, 1e-12);
  EXPECT_GE(a.minCoeff(), 0);
  const double least = a.dot(G * a);
  for (int i = 0; i < 12; ++i) {
    for (int j = 0; j < 12; ++j) {
      for (double share = 0; share <= 1; share += 0.1) {
        VectorXd b = VectorXd::Zero(12);
        b[i] += share;
        b[j] += 1 - share;
        EXPECT_LE(least, b.dot(G * b) * (1 + 1e-6));
      }
    }
  }
}

TEST(BestMixture, OfErrorsThatAreAllZeroIsAMixtureStill) {
  EXPECT_NEAR(bestMixture(MatrixXd::Zero(3, 3)).sum(), 1, 1e-12);
}

TEST(RimLights, AreOutsideTheHullOfTheOthers) {
  auto lights = randomLights(25, 5);
  const auto rim = rimLights(lights);
  ASSERT_GE(rim.size(), 3u);
  for (int i = 0; i < 25; ++i) {
    std::vector<Vector3d> others = lights;
    others.erase(others.begin() + i);
    const bool inside =
        DirectionInterpolator::create(others, {})->insideHull(lights[static_cast<std::size_t>(i)]);
    EXPECT_EQ(!inside, std::find(rim.begin(), rim.end(), i) != rim.end());
  }
}

}  // namespace
}  // namespace lightsketch
