// The numbers that a packed model's file holds, and how they become a model that is ready to draw.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
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
std::vector<std::uint32_t> packedRowOrder(const std::vector<std::int64_t>& blockOffset);

// The orthonormal DCT-II of S x S pixels as a matrix, p x p: a row per coefficient, by rising
// vertical plus horizontal frequency, within it by rising vertical frequency; a column per pixel.
RowMajorMatrixf dctMatrix(int blockSize);

// Orthonormal: (r + g + b) / sqrt 3, (r - b) / sqrt 2, (r - 2 g + b) / sqrt 6, as rows.
Eigen::Matrix3f opponentColours();

// HDF5's shuffle of 16-bit numbers: all lower bytes, then all upper ones.
void splitBytes(std::span<const std::uint16_t> numbers, std::byte* lower, std::byte* upper);

// Makes a model's E, U and V from a code's lines as a file gives them: with split bytes, in any
// order, on any thread, each line once. A line of U goes straight to where it stays.
class Unpacker {
 public:
  // The model's layout, blocks and rank are set; its U is allocated here.
  Unpacker(RelightableModel& model, int lights);
  // Line k of the code's E, U or V.
  void lineOfE(std::size_t k, const std::byte* lower, const std::byte* upper);
  void lineOfU(std::size_t k, const std::byte* lower, const std::byte* upper);
  void lineOfV(std::size_t k, const std::byte* lower, const std::byte* upper);
  // After all lines, with the code's steps. Uses all cores.
  void finish(std::span<const float> stepE, std::vector<float> stepU, std::span<const float> stepV);

 private:
  void finishE(std::span<const float> stepE);
  void finishV(std::span<const float> stepV);

  RelightableModel& model_;
  std::size_t rows_;
  std::size_t p_;
  std::size_t q_;
  std::size_t lights_;
  std::vector<std::uint32_t> order_;    // packedRowOrder
  std::vector<std::uint32_t> inverse_;  // where each row stands in the code
  // Of E: the lower bytes of all lines, then the upper ones of those that have any. Memory that is
  // not touched is none: three quarters of a model's coefficients fit a byte.
  FactorValues bytesOfE_;
  std::vector<std::uint8_t> hasUpper_;
  PackedCode::Numbers linesOfV_;
};

// Fills the model's layout, blocks, rank, storage, code, E, U and V. Uses all cores.
void setPacked(RelightableModel& model, std::shared_ptr<const PackedCode> code);

}  // namespace lightsketch
