#include "pipeline/compress/kernels.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>
#include <tuple>
#include <vector>

#include "hwy/targets.h"
#include "pipeline/compress/model.h"

namespace lightsketch {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;

RowMajorMatrixf randomMatrix(Index rows, Index columns, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal;
  return RowMajorMatrixf::NullaryExpr(rows, columns, [&] { return normal(random); });
}

std::vector<std::uint16_t> halfsOf(const RowMajorMatrixf& matrix) {
  std::vector<std::uint16_t> halfs;
  for (Index i = 0; i < matrix.size(); ++i)
    halfs.push_back(Eigen::numext::bit_cast<std::uint16_t>(Eigen::half(matrix.data()[i])));
  return halfs;
}

RowMajorMatrixf rounded(const RowMajorMatrixf& matrix) {
  return matrix.unaryExpr([](float value) { return static_cast<float>(Eigen::half(value)); });
}

// A sum of n products of order 1 in single precision errs by some 1e-7 sqrt(n) of its size.
constexpr double kTolerance = 2e-5;

// Every set of instructions that this processor has and that there are kernels for.
class Kernels : public ::testing::TestWithParam<int64_t> {
 protected:
  void SetUp() override { hwy::SetSupportedTargetsForTest(GetParam()); }
  void TearDown() override { hwy::SetSupportedTargetsForTest(0); }
};

std::vector<int64_t> targets() {
  std::vector<int64_t> all;
  for (int64_t bit = 1; bit > 0 && bit <= HWY_SCALAR; bit <<= 1) {
    if (hwy::SupportedTargets() & kernelTargets() & bit) all.push_back(bit);
  }
  return all;
}

INSTANTIATE_TEST_SUITE_P(All, Kernels, ::testing::ValuesIn(targets()),
                         [](const auto& target) { return hwy::TargetName(target.param); });

TEST_P(Kernels, ProductsAreThoseOfPlainLoops) {
  for (const auto& [m, n, k] : {std::tuple<Index, Index, Index>{1, 1, 1},
                                {3, 5, 7},
                                {8, 32, 256},
                                {13, 33, 257},
                                {300, 47, 600},
                                {9, 100, 0}}) {
    const RowMajorMatrixf A = randomMatrix(m, k, 1);
    const RowMajorMatrixf B = randomMatrix(k, n, 2);
    const Eigen::MatrixXf columnMajorA = A;
    const Eigen::MatrixXf columnMajorB = B;
    const MatrixXd expected = A.cast<double>() * B.cast<double>();
    for (const Cores cores : {Cores::kOne, Cores::kAll}) {
      for (const MatrixView& left : {MatrixView(A), MatrixView(columnMajorA)}) {
        for (const MatrixView& right : {MatrixView(B), MatrixView(columnMajorB)}) {
          // Rows of C lie apart; what lies between them must stay.
          RowMajorMatrixf C = RowMajorMatrixf::Constant(m, n + 3, 7);
          multiply(left, right, C.data(), static_cast<std::size_t>(n + 3), cores);
          EXPECT_LT((C.leftCols(n).cast<double>() - expected).norm(),
                    kTolerance * (1 + expected.norm()));
          EXPECT_EQ(C.rightCols(3), RowMajorMatrixf::Constant(m, 3, 7));
          multiply(left, right, C.data(), static_cast<std::size_t>(n + 3), cores, Into::kAdd);
          EXPECT_LT((C.leftCols(n).cast<double>() - 2 * expected).norm(),
                    kTolerance * (1 + expected.norm()));
        }
      }
    }
  }
}

TEST_P(Kernels, GramMatricesAndProjectionsAreThoseOfPlainLoops) {
  for (const auto& [p, count, b] : {std::tuple<Index, Index, Index>{4, 1, 1},
                                    {9, 30, 4},
                                    {64, 145, 10},
                                    {81, 300, 37},
                                    {256, 500, 33}}) {
    const RowMajorMatrixf columns = randomMatrix(count, p, 3);
    const RowMajorMatrixf E = randomMatrix(b, p, 4);
    const auto halfs = halfsOf(columns);
    for (const bool half : {false, true}) {
      const MatrixXd A = (half ? rounded(columns) : columns).transpose().cast<double>();
      const auto n = static_cast<std::size_t>(count);
      const auto pixels = static_cast<std::size_t>(p);
      RowMajorMatrixf gram(p, p);
      RowMajorMatrixf L(b, count);
      if (half) {
        gramOfColumns(halfs.data(), n, pixels, gram.data());
        projectColumns(halfs.data(), n, pixels, E.data(), static_cast<std::size_t>(b), L.data());
      } else {
        gramOfColumns(columns.data(), n, pixels, gram.data());
        projectColumns(columns.data(), n, pixels, E.data(), static_cast<std::size_t>(b), L.data());
      }
      const MatrixXd expected = A * A.transpose();
      EXPECT_LT((gram.cast<double>() - expected).norm(), kTolerance * expected.norm());
      EXPECT_EQ(gram, RowMajorMatrixf(gram.transpose()));
      const MatrixXd projected = E.cast<double>() * A;
      EXPECT_LT((L.cast<double>() - projected).norm(), kTolerance * projected.norm());
    }
  }
}

TEST_P(Kernels, HalfsComeOutPlaneByPlane) {
  constexpr std::size_t kPixels = 71;  // no multiple of any vector
  RowMajorMatrixf pixels = randomMatrix(kPixels, 3, 5);
  pixels(0, 0) = 1e6f;
  pixels(70, 2) = -1e6f;
  std::vector<std::uint16_t> halfs(3 * kPixels);
  planarHalfs(pixels.data(), kPixels, halfs.data());
  for (std::size_t c = 0; c < 3; ++c) {
    for (std::size_t i = 0; i < kPixels; ++i) {
      const float value =
          std::clamp(pixels(static_cast<Index>(i), static_cast<Index>(c)), -65504.0f, 65504.0f);
      const auto half = Eigen::numext::bit_cast<Eigen::half>(halfs[c * kPixels + i]);
      // Half a unit of the last place; old processors round by halves' whole unit.
      EXPECT_NEAR(static_cast<float>(half), value, 1e-3f * std::abs(value) + 6.2e-5f);
    }
  }
}

}  // namespace
}  // namespace lightsketch
