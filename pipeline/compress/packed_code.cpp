#include "pipeline/compress/packed_code.h"

#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <utility>

#include "pipeline/compress/kernels.h"

namespace lightsketch {
namespace {

using Eigen::Index;

// To the nearest, halves away from zero; plain enough to become vectors.
void roundTo(const float* values, std::size_t count, float factor, std::int8_t* rounded) {
  for (std::size_t i = 0; i < count; ++i) {
    const float value = values[i] * factor;
    rounded[i] = static_cast<std::int8_t>(static_cast<int>(value + std::copysign(0.5f, value)));
  }
}

float stepFor(float largest, float limit) { return largest > 0 ? largest / limit : 1; }

}  // namespace

std::vector<std::size_t> packedRowOrder(const std::vector<std::int64_t>& blockOffset) {
  std::vector<std::size_t> order;
  for (std::int64_t k = 0; order.size() < static_cast<std::size_t>(blockOffset.back()); ++k) {
    for (std::size_t j = 0; j + 1 < blockOffset.size(); ++j) {
      if (blockOffset[j] + k < blockOffset[j + 1])
        order.push_back(static_cast<std::size_t>(blockOffset[j] + k));
    }
  }
  return order;
}

RowMajorMatrixf dctMatrix(int blockSize) {
  const Index size = blockSize;
  Eigen::MatrixXd line(size, size);
  for (Index k = 0; k < size; ++k) {
    for (Index x = 0; x < size; ++x) {
      line(k, x) = std::sqrt((k > 0 ? 2.0 : 1.0) / static_cast<double>(size)) *
                   std::cos(std::numbers::pi * (static_cast<double>(x) + 0.5) *
                            static_cast<double>(k) / static_cast<double>(size));
    }
  }
  std::vector<Index> order(static_cast<std::size_t>(size * size));
  std::iota(order.begin(), order.end(), Index{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](Index a, Index b) { return a / size + a % size < b / size + b % size; });
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

void setPacked(RelightableModel& model, std::shared_ptr<const PackedCode> shared) {
  const PackedCode& code = *shared;
  const std::size_t rows = code.rows();
  const auto p = static_cast<std::size_t>(code.layout.pixelsPerBlock());
  const auto q = static_cast<std::size_t>(code.rank);
  const auto n = static_cast<std::size_t>(code.lights);
  const auto order = packedRowOrder(code.blockOffset);
  model.layout = code.layout;
  model.blockOffset = code.blockOffset;
  model.rank = code.rank;
  model.storage = Storage::kPacked;

  // Basis pictures as pixels: int8 with a scale each adds an error far below the code's own.
  model.E = {FactorValues(ElementType::kInt8, rows * p), std::vector<float>(rows)};
  const auto e = model.E.values.as<std::int8_t>();
  const PackedMatrix dct(MatrixView(dctMatrix(code.layout.blockSize)), Cores::kAll);
  constexpr std::size_t kStrip = 512;  // rows
  struct Strip {
    RowMajorMatrixf coefficients;  // a column a basis picture, as the code has it
    RowMajorMatrixf pixels;
  };
  oneapi::tbb::enumerable_thread_specific<Strip> strips;
  oneapi::tbb::parallel_for(std::size_t{0}, (rows + kStrip - 1) / kStrip, [&](std::size_t s) {
    Strip& strip = strips.local();
    const std::size_t first = s * kStrip;
    const std::size_t count = std::min(kStrip, rows - first);
    strip.coefficients.resize(static_cast<Index>(p), static_cast<Index>(count));
    strip.pixels.resize(static_cast<Index>(count), static_cast<Index>(p));
    for (std::size_t k = 0; k < p; ++k) {
      const std::uint16_t* const from = code.E.data() + k * rows + first;
      const float* const step = code.stepE.data() + first;
      float* const to = strip.coefficients.data() + k * count;
      for (std::size_t i = 0; i < count; ++i)
        to[i] = static_cast<float>(unfoldSign(from[i])) * step[i];
    }
    multiply(MatrixView(strip.coefficients).transposed(), dct, strip.pixels.data(), p, Cores::kOne);
    for (std::size_t i = 0; i < count; ++i) {
      const auto row = strip.pixels.row(static_cast<Index>(i));
      const std::size_t r = order[first + i];
      const float scale = stepFor(row.cwiseAbs().maxCoeff(), 127);
      model.E.scale[r] = scale;
      roundTo(row.data(), p, 1 / scale, e.data() + r * p);
    }
  });

  constexpr std::size_t kPanel = RelightableModel::kPanelRows;
  model.U = {
      FactorValues(ElementType::kInt16, static_cast<std::size_t>(model.panels()) * q * kPanel),
      code.stepU};
  const auto u = model.U.values.as<std::int16_t>();
  // A column at a time: it is read in one go, and where it goes fits the cache.
  oneapi::tbb::parallel_for(std::size_t{0}, q, [&](std::size_t k) {
    const std::uint16_t* const from = code.U.data() + k * rows;
    for (std::size_t i = 0; i < rows; ++i) {
      const std::size_t r = order[i];
      u[(r / kPanel * q + k) * kPanel + r % kPanel] =
          static_cast<std::int16_t>(unfoldSign(from[i]));
    }
  });

  model.V = {FactorValues(ElementType::kInt16, 3 * n * q), std::vector<float>(q)};
  const auto v = model.V.values.as<std::int16_t>();
  const Eigen::Matrix3f colours = opponentColours();
  oneapi::tbb::parallel_for(std::size_t{0}, q, [&](std::size_t k) {
    Eigen::Matrix3Xf opponent(3, static_cast<Index>(n));
    for (std::size_t c = 0; c < 3; ++c) {
      for (std::size_t i = 0; i < n; ++i) {
        opponent(static_cast<Index>(c), static_cast<Index>(i)) =
            static_cast<float>(unfoldSign(code.V[(3 * k + c) * n + i])) * code.stepV[k];
      }
    }
    const Eigen::Matrix3Xf rgb = colours.transpose() * opponent;
    const float scale = stepFor(n > 0 ? rgb.cwiseAbs().maxCoeff() : 0, 32767);
    model.V.scale[k] = scale;
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t c = 0; c < 3; ++c) {
        v[(3 * i + c) * q + k] = static_cast<std::int16_t>(
            std::lround(rgb(static_cast<Index>(c), static_cast<Index>(i)) / scale));
      }
    }
  });
  model.code = std::move(shared);
}

}  // namespace lightsketch
