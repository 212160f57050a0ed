#include "pipeline/compress/factorise.h"

#include <gtest/gtest.h>

#include <Eigen/QR>
#include <Eigen/SVD>
#include <memory>
#include <random>
#include <span>

#include "pipeline/compress/first_stage.h"

namespace lightsketch {
namespace {

using Eigen::Index;
using Eigen::MatrixXf;

MatrixXf randomMatrix(Index rows, Index columns, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal;
  return MatrixXf::NullaryExpr(rows, columns, [&] { return normal(random); });
}

// Known singular values: 1, 1/2, 1/4, ...
MatrixXf geometricMatrix(Index rows, Index columns, unsigned seed) {
  const Index side = std::min(rows, columns);
  const MatrixXf left =
      Eigen::HouseholderQR<MatrixXf>(randomMatrix(rows, side, seed)).householderQ() *
      MatrixXf::Identity(rows, side);
  const MatrixXf right =
      Eigen::HouseholderQR<MatrixXf>(randomMatrix(columns, side, seed + 1)).householderQ() *
      MatrixXf::Identity(columns, side);
  Eigen::VectorXf values(side);
  for (Index k = 0; k < side; ++k) values[k] = std::ldexp(1.0f, static_cast<int>(-k));
  return left * values.asDiagonal() * right.transpose();
}

// What rank q must leave of geometricMatrix (Eckart and Young).
double geometricTail(Index side, int q) {
  double sum = 0;
  for (Index k = q; k < side; ++k) sum += std::ldexp(1.0, static_cast<int>(-2 * k));
  return std::sqrt(sum);
}

BlockFactors blockOf(const MatrixXf& A, int b, int missing = 0) {
  const Index p = A.rows();
  auto inside = std::make_unique<bool[]>(static_cast<std::size_t>(p));
  for (Index k = 0; k < p; ++k) inside[static_cast<std::size_t>(k)] = k >= missing;
  return factoriseBlock(std::span<const float>(A.data(), static_cast<std::size_t>(A.size())),
                        {inside.get(), static_cast<std::size_t>(p)}, {.most = b});
}

// Single precision through a Gram matrix keeps a basis orthonormal to some 1e-6 and loses nothing
// that rank 6 of a geometric spectrum could see.
TEST(FactoriseBlock, IsTheBestBasisOfItsRank) {
  const MatrixXf A = geometricMatrix(64, 90, 1);
  for (const int b : {1, 3, 6}) {
    const BlockFactors block = blockOf(A, b);
    EXPECT_LT((block.E * block.E.transpose() - MatrixXf::Identity(b, b)).cwiseAbs().maxCoeff(),
              1e-5f);
    EXPECT_NEAR((A - block.E.transpose() * block.L).norm(), geometricTail(64, b), 1e-5);
  }
}

TEST(FactoriseBlock, GivesItsInputBackAtFullRank) {
  // More columns than pixels: to the bit. Fewer: to rounding, through a basis of the columns.
  const MatrixXf wide = randomMatrix(64, 90, 2);
  const BlockFactors whole = blockOf(wide, 64);
  EXPECT_EQ(whole.E.transpose() * whole.L, wide);
  const MatrixXf tall = geometricMatrix(64, 12, 3);
  const BlockFactors columns = blockOf(tall, 12);
  EXPECT_LT((columns.E.transpose() * columns.L - tall).cwiseAbs().maxCoeff(), 1e-6f);
  EXPECT_LT((columns.E * columns.E.transpose() - MatrixXf::Identity(12, 12)).cwiseAbs().maxCoeff(),
            1e-5f);
}

// Energies of geometricMatrix are 4^-k: a threshold keeps just those above it, however many were
// tried first, and as well as if their number had been known.
TEST(FactoriseBlock, KeepsWhatIsAboveTheThreshold) {
  const MatrixXf A = geometricMatrix(256, 300, 9) + 3 * geometricMatrix(256, 300, 10);
  const Eigen::VectorXd energies =
      Eigen::JacobiSVD<Eigen::MatrixXd>(A.cast<double>()).singularValues().array().square();
  auto inside = std::make_unique<bool[]>(256);
  std::fill_n(inside.get(), 256, true);
  const std::span<const float> columns(A.data(), static_cast<std::size_t>(A.size()));
  for (const double threshold : {0.5, 1e-2, 1e-4}) {
    const auto above = (energies.array() > threshold).count();
    const BlockFactors block =
        factoriseBlock(columns, {inside.get(), 256}, {.most = 64, .threshold = threshold});
    ASSERT_EQ(block.E.rows(), above);
    for (Index k = 0; k < above; ++k)
      EXPECT_NEAR(block.rowEnergy[static_cast<std::size_t>(k)], energies[k],
                  1e-4 * energies[k] + 1e-6);
    // A ten-thousandth of what is left, and single precision's 1e-6 of all.
    EXPECT_NEAR((A - block.E.transpose() * block.L).squaredNorm(), energies.tail(256 - above).sum(),
                2e-4 * energies.tail(256 - above).sum() + 1e-5);
  }
}

// Energies that fall slowly to far below the first: one number of vectors after the other turns out
// too small, each after steps of its own. A gap says how many there are.
TEST(LeadingEigenvectors, AreAllAboveTheThresholdHoweverManyWereTriedFirst) {
  constexpr Index kPixels = 1024;
  const auto inside = std::make_unique<bool[]>(kPixels);
  std::fill_n(inside.get(), kPixels, true);
  for (const Index above : {70, 150, 300}) {
    RowMajorMatrixf gram = RowMajorMatrixf::Zero(kPixels, kPixels);
    for (Index k = 0; k < kPixels; ++k)
      gram(k, k) = std::pow(static_cast<float>(k + 1), -1.5f) * (k < above ? 1.0f : 0.25f);
    const double threshold = 0.5 * std::pow(static_cast<double>(above), -1.5);
    const RowMajorMatrixf found =
        leadingEigenvectors(gram, {inside.get(), kPixels}, {.most = 0, .threshold = threshold});
    ASSERT_EQ(found.rows(), above);
    EXPECT_LT((found * found.transpose() - MatrixXf::Identity(above, above)).cwiseAbs().maxCoeff(),
              1e-4f);
    // They are the first coordinates, but for what the energy hardly shows.
    EXPECT_GT(found.leftCols(above).squaredNorm(), 0.99f * static_cast<float>(above));
  }
}

TEST(FactoriseBlock, SparesNothingForPixelsBeyondThePicture) {
  MatrixXf A = randomMatrix(64, 90, 4);
  A.topRows(20).setZero();
  const BlockFactors block = blockOf(A, 44, 20);
  EXPECT_EQ(block.E.transpose() * block.L, A);
}

TEST(FactoriseAll, ExactlyIsTheBestFactorisationOfItsRank) {
  SilentProgress progress;
  for (const auto& [rows, columns] : {std::pair<Index, Index>{200, 60}, {60, 200}}) {
    const RowMajorMatrixf L = geometricMatrix(rows, columns, 5);
    for (const int q : {1, 4, 10}) {
      const auto result = factoriseAll(LargeMatrix(L), q, SecondStageMethod::kExact, progress);
      ASSERT_TRUE(result);
      EXPECT_EQ(result->V.rows(), q);
      EXPECT_NEAR((L - result->U * result->V).norm(), geometricTail(60, q), 2e-6);  // float sums
      EXPECT_NEAR(result->keptEnergy / result->totalEnergy, 1 - std::ldexp(1.0, -2 * q), 1e-6);
    }
    for (const auto method : {SecondStageMethod::kAuto, SecondStageMethod::kExact}) {
      const auto full = factoriseAll(LargeMatrix(L), 60, method, progress);
      EXPECT_LT((L - full->U * full->V).cwiseAbs().maxCoeff(), 1e-6f);
      EXPECT_NEAR(full->keptEnergy, full->totalEnergy, 1e-6);
    }
  }
}

// Rank 12 in truth: nothing may come of directions that are only rounding.
TEST(FactoriseAll, RandomisedFindsAllOfALowRank) {
  SilentProgress progress;
  const RowMajorMatrixf L = randomMatrix(700, 12, 11) * randomMatrix(12, 500, 12);
  const auto result = factoriseAll(LargeMatrix(L), 40, SecondStageMethod::kRandomised, progress);
  ASSERT_TRUE(result);
  EXPECT_LT((L - result->U * result->V).norm(), 1e-5f * L.norm());
}

TEST(FactoriseAll, RandomisedIsNearlyAsGoodAsExact) {
  SilentProgress progress;
  for (const auto& [rows, columns] : {std::pair<Index, Index>{500, 300}, {300, 500}}) {
    // Singular values fall only like 1 / sqrt(k), the hard case for a random start.
    const MatrixXf left =
        Eigen::HouseholderQR<MatrixXf>(randomMatrix(rows, 300, 6)).householderQ() *
        MatrixXf::Identity(rows, 300);
    Eigen::VectorXf values(300);
    for (Index k = 0; k < 300; ++k) values[k] = 1 / std::sqrt(static_cast<float>(k + 1));
    const MatrixXf right =
        Eigen::HouseholderQR<MatrixXf>(randomMatrix(columns, 300, 7)).householderQ() *
        MatrixXf::Identity(columns, 300);
    const RowMajorMatrixf L = left * values.asDiagonal() * right.transpose();
    const auto exact = factoriseAll(LargeMatrix(L), 40, SecondStageMethod::kExact, progress);
    const auto randomised =
        factoriseAll(LargeMatrix(L), 40, SecondStageMethod::kRandomised, progress);
    ASSERT_TRUE(exact && randomised);
    EXPECT_FALSE(randomised->exact);
    const double best = (L - exact->U * exact->V).norm();
    const double found = (L - randomised->U * randomised->V).norm();
    EXPECT_LT(found, best * 1.0035);  // 0.03 dB
    EXPECT_LT(randomised->leftToGain, 0.01);
    EXPECT_GE(found, best * (1 - 1e-5));
  }
}

// Radiances of a bright scene: without balancing, U's values leave the range of half floats.
TEST(FactoriseAll, KeepsBothFactorsInTheRangeOfHalfs) {
  SilentProgress progress;
  const RowMajorMatrixf L = 60000 * geometricMatrix(300, 90, 8);
  const auto result = factoriseAll(LargeMatrix(L), 20, SecondStageMethod::kAuto, progress);
  ASSERT_TRUE(result);
  EXPECT_LT(result->U.cwiseAbs().maxCoeff(), 65504.0f);
  EXPECT_LT(result->V.cwiseAbs().maxCoeff(), 65504.0f);
}

}  // namespace
}  // namespace lightsketch
