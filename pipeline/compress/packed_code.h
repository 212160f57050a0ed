// The numbers that a packed model's file holds, and how they become a model that is ready to draw.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "pipeline/compress/large_pages.h"
#include "pipeline/compress/model.h"

namespace lightsketch {

// Integers whose steps rate and distortion chose, in an order in which neighbours have like
// statistics. Signs are folded, 0, -1, 1, -2, 2 to 0, 1, 2, 3, 4, so that small numbers of either
// sign have an empty upper byte. Rows stand as packedRowOrder says.
struct PackedCode {
  using Numbers = std::vector<std::uint16_t, LargePages<std::uint16_t>>;

  BlockLayout layout;
  std::vector<std::int64_t> blockOffset;  // as Factors
  int rank = 0;
  int lights = 0;

  // p x rows: each row's basis picture as its orthonormal two-dimensional DCT-II, coefficients as
  // dctMatrix says.
  Numbers E;
  std::vector<float> stepE;  // rows
  Numbers U;                 // q x rows
  std::vector<float> stepU;  // q
  // 3 q x n: of each k the lights' grey, red-blue and green-magenta (see opponentColours).
  Numbers V;
  std::vector<float> stepV;  // q

  std::size_t rows() const { return stepE.size(); }
};

inline std::uint16_t foldSign(int value) {
  return static_cast<std::uint16_t>(value >= 0 ? 2 * value : -2 * value - 1);
}
inline int unfoldSign(std::uint16_t folded) { return (folded >> 1) ^ -(folded & 1); }

// The rows of E and U as they stand in a code: all blocks' first ones, then all second ones...
std::vector<std::size_t> packedRowOrder(const std::vector<std::int64_t>& blockOffset);

// The orthonormal DCT-II of S x S pixels as a matrix, p x p: a row per coefficient, by rising
// vertical plus horizontal frequency, within it by rising vertical frequency; a column per pixel.
RowMajorMatrixf dctMatrix(int blockSize);

// Orthonormal: (r + g + b) / sqrt 3, (r - b) / sqrt 2, (r - 2 g + b) / sqrt 6, as rows.
Eigen::Matrix3f opponentColours();

// Fills the model's layout, blocks, rank, storage, code, E, U and V. Uses all cores.
void setPacked(RelightableModel& model, std::shared_ptr<const PackedCode> code);

}  // namespace lightsketch
