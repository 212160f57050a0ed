// The inner loops of relighting, compiled for every vector instruction set that Highway knows here
// and chosen at run time.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <span>

#include "pipeline/compress/model.h"

namespace lightsketch {

enum class PixelFormat {
  kBgra8,     // sRGB, alpha 255
  kRgbHalf,   // linear
  kRgbaHalf,  // linear, alpha 1
  kRgbFloat,  // linear
};
constexpr std::size_t bytesPerPixel(PixelFormat format) {
  constexpr std::size_t kBytes[] = {4, 6, 8, 12};
  return kBytes[static_cast<int>(format)];
}

// How many of `count` bases a share of them keeps; the tolerance lets 0.3f of 10 be 3.
inline std::size_t keptOf(std::size_t count, float share) {
  return static_cast<std::size_t>(std::ceil(static_cast<double>(count) * double{share} - 1e-4));
}

struct RenderTarget {
  PixelFormat format = PixelFormat::kBgra8;
  std::byte* pixels = nullptr;
  std::size_t strideBytes = 0;
};

// v as the kernels read it: red, green and blue, each `rank` numbers for the columns of U that are
// to be used, with the scales of U and V and the exposure in them.
struct LitBasis {
  std::size_t rank = 0;
  std::array<const float*, 3> v = {};
};

// Draws the blocks first <= j < last: l = U v, block = E^T l, tone curve, output. Every block is
// summed in the same order whatever the range is.
void renderBlocks(const RelightableModel& model, const LitBasis& basis, float share,
                  const RenderTarget& target, int first, int last);

// A light and how much of it is to be added.
struct LightChange {
  int light = 0;
  std::array<double, 3> amount = {};
};
// v[c][k] += sum over changes of amount[c] V(k, 3 light + c), without V's scales. v holds three
// times litStride(rank) numbers; those beyond the rank become junk.
constexpr std::size_t litStride(int rank) {
  return (static_cast<std::size_t>(rank) + 15) / 16 * 16;
}
void addLights(const RelightableModel& model, std::span<const LightChange> changes, double* v);

}  // namespace lightsketch
