#include "pipeline/compress/packed_code.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <numbers>
#include <numeric>
#include <utility>

#include "pipeline/compress/unpack_kernels.h"

namespace lightsketch {
namespace {

using Eigen::Index;

float stepFor(float largest, float limit) {
  const float step = largest / limit;
  return step > 0 ? step : 1;
}

// The orthonormal DCT-II of S numbers: a row per frequency.
Eigen::MatrixXd dctOfLine(Index size) {
  Eigen::MatrixXd line(size, size);
  for (Index k = 0; k < size; ++k) {
    for (Index x = 0; x < size; ++x) {
      line(k, x) = std::sqrt((k > 0 ? 2.0 : 1.0) / static_cast<double>(size)) *
                   std::cos(std::numbers::pi * (static_cast<double>(x) + 0.5) *
                            static_cast<double>(k) / static_cast<double>(size));
    }
  }
  return line;
}

// The coefficients of S x S pixels in a code's order, each as vertical frequency S + horizontal.
std::vector<std::uint32_t> dctOrder(int blockSize) {
  const auto size = static_cast<std::uint32_t>(blockSize);
  std::vector<std::uint32_t> order(std::size_t{size} * size);
  std::iota(order.begin(), order.end(), 0u);
  std::stable_sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
    return a / size + a % size < b / size + b % size;
  });
  return order;
}

// Each byte is its neighbour, and the first is zero.
bool allZero(const std::byte* bytes, std::size_t count) {
  return count == 0 || (bytes[0] == std::byte{0} && std::memcmp(bytes, bytes + 1, count - 1) == 0);
}

const std::uint8_t* numbersOf(const std::byte* bytes) {
  return reinterpret_cast<const std::uint8_t*>(bytes);
}

}  // namespace

std::vector<std::uint32_t> packedRowOrder(const std::vector<std::int64_t>& blockOffset) {
  std::vector<std::uint32_t> order;
  order.reserve(static_cast<std::size_t>(blockOffset.back()));
  for (std::int64_t k = 0; order.size() < static_cast<std::size_t>(blockOffset.back()); ++k) {
    for (std::size_t j = 0; j + 1 < blockOffset.size(); ++j) {
      if (blockOffset[j] + k < blockOffset[j + 1])
        order.push_back(static_cast<std::uint32_t>(blockOffset[j] + k));
    }
  }
  return order;
}

RowMajorMatrixf dctMatrix(int blockSize) {
  const Eigen::MatrixXd line = dctOfLine(blockSize);
  const std::vector<std::uint32_t> order = dctOrder(blockSize);
  const Index size = blockSize;
  RowMajorMatrixf matrix(size * size, size * size);
  for (Index i = 0; i < size * size; ++i) {
    const Index at = order[static_cast<std::size_t>(i)];
    for (Index pixel = 0; pixel < size * size; ++pixel) {
      matrix(i, pixel) =
          static_cast<float>(line(at / size, pixel / size) * line(at % size, pixel % size));
    }
  }
  return matrix;
}

Eigen::Matrix3f opponentColours() {
  Eigen::Matrix3d colours;
  colours << 1, 1, 1, 1, 0, -1, 1, -2, 1;
  colours.rowwise().normalize();
  return colours.cast<float>();
}

void splitBytes(std::span<const std::uint16_t> numbers, std::byte* lower, std::byte* upper) {
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    lower[i] = static_cast<std::byte>(numbers[i] & 0xff);
    upper[i] = static_cast<std::byte>(numbers[i] >> 8);
  }
}

Unpacker::Unpacker(RelightableModel& model, int lights)
    : model_(model),
      rows_(static_cast<std::size_t>(model.rows())),
      p_(static_cast<std::size_t>(model.layout.pixelsPerBlock())),
      q_(static_cast<std::size_t>(model.rank)),
      lights_(static_cast<std::size_t>(lights)),
      order_(packedRowOrder(model.blockOffset)),
      inverse_(rows_),
      bytesOfE_(ElementType::kInt8, 2 * p_ * rows_),
      hasUpper_(p_),
      linesOfV_(3 * q_ * lights_) {
  for (std::size_t i = 0; i < rows_; ++i) inverse_[order_[i]] = static_cast<std::uint32_t>(i);
  model_.U = {FactorValues(ElementType::kInt16, static_cast<std::size_t>(model.panels()) * q_ *
                                                    RelightableModel::kPanelRows),
              {}};
}

void Unpacker::lineOfE(std::size_t k, const std::byte* lower, const std::byte* upper) {
  std::memcpy(bytesOfE_.data() + k * rows_, lower, rows_);
  hasUpper_[k] = !allZero(upper, rows_);
  if (hasUpper_[k]) std::memcpy(bytesOfE_.data() + (p_ + k) * rows_, upper, rows_);
}

void Unpacker::lineOfU(std::size_t k, const std::byte* lower, const std::byte* upper) {
  constexpr std::size_t kPanel = RelightableModel::kPanelRows;
  placeColumn({numbersOf(lower), allZero(upper, rows_) ? nullptr : numbersOf(upper)}, inverse_,
              q_ * kPanel, model_.U.values.as<std::int16_t>().data() + k * kPanel);
}

void Unpacker::lineOfV(std::size_t k, const std::byte* lower, const std::byte* upper) {
  std::uint16_t* const to = linesOfV_.data() + k * lights_;
  for (std::size_t i = 0; i < lights_; ++i) {
    to[i] = static_cast<std::uint16_t>(std::to_integer<unsigned>(lower[i]) |
                                       std::to_integer<unsigned>(upper[i]) << 8);
  }
}

void Unpacker::finish(std::span<const float> stepE, std::vector<float> stepU,
                      std::span<const float> stepV) {
  finishE(stepE);
  model_.U.scale = std::move(stepU);
  finishV(stepV);
}

// Basis pictures as pixels: int8 with a scale each adds an error far below the code's own.
void Unpacker::finishE(std::span<const float> stepE) {
  model_.E = {FactorValues(ElementType::kInt8, rows_ * p_), std::vector<float>(rows_)};
  const RowMajorMatrixf line = dctOfLine(model_.layout.blockSize).cast<float>();
  const std::vector<std::uint32_t> position = dctOrder(model_.layout.blockSize);
  const InverseDct dct{static_cast<std::size_t>(model_.layout.blockSize),
                       {line.data(), static_cast<std::size_t>(line.size())},
                       position};
  std::vector<ByteLine> coefficients(p_);
  for (std::size_t k = 0; k < p_; ++k) {
    const std::uint8_t* const lower = numbersOf(bytesOfE_.data()) + k * rows_;
    coefficients[k] = {lower, hasUpper_[k] ? lower + p_ * rows_ : nullptr};
  }
  std::int8_t* const pixels = model_.E.values.as<std::int8_t>().data();
  constexpr std::size_t kStrip = 512;  // rows
  oneapi::tbb::parallel_for(std::size_t{0}, (rows_ + kStrip - 1) / kStrip, [&](std::size_t s) {
    const std::size_t first = s * kStrip;
    const std::size_t last = std::min(rows_, first + kStrip);
    std::array<float, kStrip> largest;
    inverseTransform(dct, coefficients, first, last, order_.data() + first, pixels, largest.data());
    for (std::size_t i = first; i < last; ++i)
      model_.E.scale[order_[i]] = stepFor(stepE[i] * largest[i - first], 127);
  });
  bytesOfE_ = {};
}

// Colours turned back, rounded to 16 bits with a scale per k, and transposed.
void Unpacker::finishV(std::span<const float> stepV) {
  model_.V = {FactorValues(ElementType::kInt16, 3 * lights_ * q_), std::vector<float>(q_)};
  const Eigen::Matrix3f colours = opponentColours();
  const std::size_t columns = 3 * lights_;
  std::vector<std::int16_t, LargePages<std::int16_t>> turned(q_ * columns);
  oneapi::tbb::parallel_for(std::size_t{0}, q_, [&](std::size_t k) {
    Eigen::Matrix3Xf opponent(3, static_cast<Index>(lights_));
    for (std::size_t c = 0; c < 3; ++c) {
      const std::uint16_t* const from = linesOfV_.data() + (3 * k + c) * lights_;
      for (std::size_t i = 0; i < lights_; ++i) {
        opponent(static_cast<Index>(c), static_cast<Index>(i)) =
            static_cast<float>(unfoldSign(from[i])) * stepV[k];
      }
    }
    const Eigen::Matrix3Xf rgb = colours.transpose() * opponent;
    const float scale = stepFor(lights_ > 0 ? rgb.cwiseAbs().maxCoeff() : 0, 32767);
    model_.V.scale[k] = scale;
    // To the nearest, halves away from zero; plain enough to become vectors.
    for (std::size_t i = 0; i < columns; ++i) {
      const float value = rgb.data()[i] / scale;
      turned[k * columns + i] =
          static_cast<std::int16_t>(static_cast<int>(value + std::copysign(0.5f, value)));
    }
  });
  std::int16_t* const v = model_.V.values.as<std::int16_t>().data();
  constexpr std::size_t kStrip = 64;  // columns of V
  oneapi::tbb::parallel_for(std::size_t{0}, (columns + kStrip - 1) / kStrip, [&](std::size_t s) {
    const std::size_t last = std::min(columns, (s + 1) * kStrip);
    for (std::size_t k = 0; k < q_; ++k) {
      for (std::size_t i = s * kStrip; i < last; ++i) v[i * q_ + k] = turned[k * columns + i];
    }
  });
}

void setPacked(RelightableModel& model, std::shared_ptr<const PackedCode> code) {
  model.layout = code->layout;
  model.blockOffset = code->blockOffset;
  model.rank = code->rank;
  model.storage = Storage::kPacked;
  Unpacker unpacker(model, code->lights);
  const auto unpack = [&](const PackedCode::Numbers& numbers, std::size_t length, auto line) {
    if (length == 0) return;
    oneapi::tbb::parallel_for(std::size_t{0}, numbers.size() / length, [&](std::size_t k) {
      std::vector<std::byte> bytes(2 * length);
      splitBytes(std::span(numbers).subspan(k * length, length), bytes.data(),
                 bytes.data() + length);
      (unpacker.*line)(k, bytes.data(), bytes.data() + length);
    });
  };
  unpack(code->E, code->rows(), &Unpacker::lineOfE);
  unpack(code->U, code->rows(), &Unpacker::lineOfU);
  unpack(code->V, static_cast<std::size_t>(code->lights), &Unpacker::lineOfV);
  unpacker.finish(code->stepE, code->stepU, code->stepV);
  model.code = std::move(code);
}

}  // namespace lightsketch
