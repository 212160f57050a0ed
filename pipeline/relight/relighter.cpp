#include "pipeline/relight/relighter.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <vector>

#include "capture/frame/vectorise.h"

namespace lightsketch {
namespace {

namespace tbb = oneapi::tbb;

struct Rgb {
  float r = 0, g = 0, b = 0;
};

Result<void> checkShapes(const RelightableModel& model, const LightIntensities& intensities) {
  if (const auto misfit = misfitOf(model))
    return failure(ErrorCode::kInvalidArgument, "model: {}", *misfit);
  if (intensities.rows() != model.lightCount()) {
    return failure(ErrorCode::kInvalidArgument,
                   "relight: {} light intensities given, the model has {} lights",
                   intensities.rows(), model.lightCount());
  }
  return {};
}

// One row of V s, all lights.
LIGHTSKETCH_VECTORISED
Rgb dotLights(const float* row, const float* s, Eigen::Index lights) {
  float r = 0, g = 0, b = 0;
#pragma omp simd reduction(+ : r, g, b)
  for (Eigen::Index i = 0; i < lights; ++i) {
    r += row[3 * i] * s[3 * i];
    g += row[3 * i + 1] * s[3 * i + 1];
    b += row[3 * i + 2] * s[3 * i + 2];
  }
  return {r, g, b};
}

// One row of U times v; v's channels lie one after the other.
LIGHTSKETCH_VECTORISED
Rgb dotRank(const float* row, const float* v, Eigen::Index rank) {
  float r = 0, g = 0, b = 0;
#pragma omp simd reduction(+ : r, g, b)
  for (Eigen::Index k = 0; k < rank; ++k) {
    r += row[k] * v[k];
    g += row[k] * v[rank + k];
    b += row[k] * v[2 * rank + k];
  }
  return {r, g, b};
}

// Adds one basis picture to the block in the three colours of `l`.
LIGHTSKETCH_VECTORISED
void addBasis(const float* basis, Rgb l, float* block, Eigen::Index pixels) {
  float* r = block;
  float* g = block + pixels;
  float* b = block + 2 * pixels;
#pragma omp simd
  for (Eigen::Index k = 0; k < pixels; ++k) {
    r[k] += l.r * basis[k];
    g[k] += l.g * basis[k];
    b[k] += l.b * basis[k];
  }
}

// v = V s, returned as its three channels one after the other. Touches only the lights that are on:
// for a few lamps this reads a few columns of V instead of all of it.
std::vector<float> lightTheBasis(const Factors& model, const LightIntensities& intensities) {
  const Eigen::Index lights = intensities.rows();
  const Eigen::Index rank = model.V.rows();
  const Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor> s = intensities;
  std::vector<Eigen::Index> on;
  for (Eigen::Index i = 0; i < lights; ++i) {
    if (!s.row(i).isZero(0)) on.push_back(i);
  }
  const bool sparse = static_cast<Eigen::Index>(on.size()) * 8 < lights;

  std::vector<float> v(static_cast<std::size_t>(3 * rank));
  tbb::parallel_for(tbb::blocked_range<Eigen::Index>(0, rank, 32), [&](const auto& range) {
    for (Eigen::Index k = range.begin(); k < range.end(); ++k) {
      const float* row = model.V.data() + k * model.V.cols();
      Rgb sum;
      if (sparse) {
        for (const Eigen::Index i : on) {
          sum.r += row[3 * i] * s(i, 0);
          sum.g += row[3 * i + 1] * s(i, 1);
          sum.b += row[3 * i + 2] * s(i, 2);
        }
      } else {
        sum = dotLights(row, s.data(), lights);
      }
      float* out = v.data() + k;
      out[0] = sum.r;
      out[rank] = sum.g;
      out[2 * rank] = sum.b;
    }
  });
  return v;
}

}  // namespace

Result<RadianceImage> relight(const RelightableModel& model, const LightIntensities& intensities) {
  RETURN_IF_ERROR(checkShapes(model, intensities));
  const Factors factors = factorsOf(model);
  const BlockLayout& layout = model.layout;
  const std::vector<float> v = lightTheBasis(factors, intensities);
  const Eigen::Index rank = factors.U.cols();
  const Eigen::Index pixels = layout.pixelsPerBlock();
  const int size = layout.blockSize;

  RadianceImage picture(layout.width, layout.height, 3);
  tbb::parallel_for(tbb::blocked_range<int>(0, layout.blocks(), 16), [&](const auto& range) {
    std::vector<float> block(static_cast<std::size_t>(3 * pixels));
    for (int j = range.begin(); j < range.end(); ++j) {
      // l = U_j v and E_j^T l, a row of both at a time.
      std::fill(block.begin(), block.end(), 0.0f);
      const auto first = model.blockOffset[static_cast<std::size_t>(j)];
      const auto last = model.blockOffset[static_cast<std::size_t>(j) + 1];
      for (auto row = first; row < last; ++row) {
        const Rgb l = dotRank(factors.U.data() + row * rank, v.data(), rank);
        addBasis(factors.E.data() + row * pixels, l, block.data(), pixels);
      }
      // Into the picture; what pads the rim falls away.
      const int x0 = (j % layout.columns()) * size;
      const int y0 = (j / layout.columns()) * size;
      const int columns = std::min(size, layout.width - x0);
      const int rows = std::min(size, layout.height - y0);
      for (int y = 0; y < rows; ++y) {
        const float* from = block.data() + y * size;
        float* to = &picture(x0, y0 + y);
        for (int x = 0; x < columns; ++x) {
          to[3 * x] = from[x];
          to[3 * x + 1] = from[pixels + x];
          to[3 * x + 2] = from[2 * pixels + x];
        }
      }
    }
  });
  return picture;
}

}  // namespace lightsketch
