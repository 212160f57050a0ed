#include "pipeline/compress/packed_code.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <random>

namespace lightsketch {
namespace {

// Against the inverse DCT as a matrix and each number's place as the code's order defines it, for
// blocks that do and do not fill vectors, with numbers of one byte and of two.
TEST(PackedCode, BecomesTheFactorsThatItStandsFor) {
  std::mt19937 random(5);
  for (const int size : {2, 5, 8, 16}) {
    auto code = std::make_shared<PackedCode>();
    code->layout = {7 * size, 5 * size, size};
    code->rank = 6;
    code->lights = 9;
    code->blockOffset = {0};
    for (int j = 0; j < 35; ++j)
      code->blockOffset.push_back(code->blockOffset.back() + (j * 7) % (size < 4 ? 4 : 21));
    const auto rows = static_cast<std::size_t>(code->blockOffset.back());
    const auto p = static_cast<std::size_t>(size * size);
    const auto drawn = [&](std::size_t lines, std::size_t length) {
      PackedCode::Numbers numbers;
      for (std::size_t k = 0; k < lines; ++k) {
        std::normal_distribution<float> normal(0, k % 3 == 0 ? 900.0f : 20.0f);
        for (std::size_t i = 0; i < length; ++i)
          numbers.push_back(foldSign(static_cast<int>(normal(random))));
      }
      return numbers;
    };
    code->E = drawn(p, rows);
    code->U = drawn(6, rows);
    code->V = drawn(18, 9);
    code->stepE.resize(rows);
    for (auto& step : code->stepE) step = std::exp(std::normal_distribution<float>()(random));
    code->stepU = {1, 2, 3, 4, 5, 6};
    code->stepV = {6, 5, 4, 3, 2, 1};
    RelightableModel model;
    model.lights.assign(9, Eigen::Vector3d::UnitZ());
    setPacked(model, code);
    const Factors factors = factorsOf(model);
    const auto order = packedRowOrder(code->blockOffset);
    const RowMajorMatrixf dct = dctMatrix(size);
    for (std::size_t i = 0; i < rows; ++i) {
      const auto row = static_cast<Eigen::Index>(order[i]);
      Eigen::RowVectorXf coefficients(p);
      for (std::size_t k = 0; k < p; ++k)
        coefficients[static_cast<Eigen::Index>(k)] =
            static_cast<float>(unfoldSign(code->E[k * rows + i])) * code->stepE[i];
      const Eigen::RowVectorXf pixels = coefficients * dct;
      // Half a step of 1 / 127 of the largest, and rounding.
      ASSERT_LE((pixels - factors.E.row(row)).cwiseAbs().maxCoeff(),
                0.501f / 127 * pixels.cwiseAbs().maxCoeff());
      for (std::size_t k = 0; k < 6; ++k) {
        ASSERT_EQ(factors.U(row, static_cast<Eigen::Index>(k)),
                  static_cast<float>(unfoldSign(code->U[k * rows + i])) * code->stepU[k]);
      }
    }
    for (Eigen::Index k = 0; k < 6; ++k) {
      const float largest = factors.V.row(k).cwiseAbs().maxCoeff();
      for (Eigen::Index i = 0; i < 9; ++i) {
        Eigen::Vector3f opponent;
        for (Eigen::Index c = 0; c < 3; ++c) {
          opponent[c] = static_cast<float>(
                            unfoldSign(code->V[static_cast<std::size_t>((3 * k + c) * 9 + i)])) *
                        code->stepV[static_cast<std::size_t>(k)];
        }
        const Eigen::Vector3f rgb = opponentColours().transpose() * opponent;
        for (Eigen::Index c = 0; c < 3; ++c)
          ASSERT_NEAR(factors.V(k, 3 * i + c), rgb[c], 0.51f / 32767 * largest);
      }
    }
  }
}

}  // namespace
}  // namespace lightsketch
