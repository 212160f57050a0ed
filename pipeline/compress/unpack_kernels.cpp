#include "pipeline/compress/unpack_kernels.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <new>

// Vectors of a length known only at run time do not fit in arrays.
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "pipeline/compress/unpack_kernels.cpp"
#include "hwy/aligned_allocator.h"
#include "hwy/cache_control.h"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

HWY_BEFORE_NAMESPACE();
namespace lightsketch {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using F = hn::ScalableTag<float>;
using VF = hn::Vec<F>;
constexpr std::size_t kLanes = HWY_LANES(float);
constexpr std::size_t kTile = 16;  // pixels that are turned at once

// A vector of folded numbers from place i on.
HWY_INLINE hn::Vec<hn::RebindToSigned<F>> unfolded(const ByteLine& line, std::size_t i) {
  const hn::RebindToSigned<F> di;
  const hn::Rebind<std::uint8_t, F> d8;
  auto folded = hn::PromoteTo(di, hn::LoadU(d8, line.lower + i));
  if (line.upper) {
    folded = hn::Or(folded, hn::ShiftLeft<8>(hn::PromoteTo(di, hn::LoadU(d8, line.upper + i))));
  }
  const auto sign = hn::Neg(hn::And(folded, hn::Set(di, 1)));
  return hn::Xor(hn::ShiftRight<1>(folded), sign);
}

// kCount pixels of a line from x on, and those that mirror them: even frequencies are the same in
// both halves, odd ones of opposite sign. Each number is a vector, of as many pictures.
template <std::size_t kCount>
HWY_INLINE void transformPixels(const InverseDct& dct, const float* HWY_RESTRICT from,
                                std::size_t step, std::size_t x, float* HWY_RESTRICT to) {
  const F d;
  const std::size_t size = dct.size;
  VF even[kCount], odd[kCount];
#pragma GCC unroll 8
  for (std::size_t t = 0; t < kCount; ++t) even[t] = odd[t] = hn::Zero(d);
  for (std::size_t k = 0; k < size; k += 2) {
    const float* const weights = dct.line.data() + k * size + x;
    const VF value = hn::Load(d, from + k * step);
#pragma GCC unroll 8
    for (std::size_t t = 0; t < kCount; ++t)
      even[t] = hn::MulAdd(value, hn::Set(d, weights[t]), even[t]);
    if (k + 1 == size) break;
    const VF next = hn::Load(d, from + (k + 1) * step);
#pragma GCC unroll 8
    for (std::size_t t = 0; t < kCount; ++t)
      odd[t] = hn::MulAdd(next, hn::Set(d, weights[size + t]), odd[t]);
  }
#pragma GCC unroll 8
  for (std::size_t t = 0; t < kCount; ++t) {
    hn::Store(hn::Add(even[t], odd[t]), d, to + (x + t) * step);
    if (2 * (x + t) + 1 < size) {
      hn::Store(hn::Sub(even[t], odd[t]), d, to + (size - 1 - x - t) * step);
    }
  }
}

HWY_INLINE void transformLine(const InverseDct& dct, const float* from, std::size_t step,
                              float* to) {
  const std::size_t half = (dct.size + 1) / 2;
  std::size_t x = 0;
  for (; x + 8 <= half; x += 8) transformPixels<8>(dct, from, step, x, to);
  for (; x + 2 <= half; x += 2) transformPixels<2>(dct, from, step, x, to);
  for (; x < half; ++x) transformPixels<1>(dct, from, step, x, to);
}

// kTile pixels of kLanes pictures each become kLanes pictures of kTile pixels: merging the first
// half with the second, byte by byte, rotates the bits of every index by one.
HWY_INLINE void turn([[maybe_unused]] std::int8_t* tile) {
#if HWY_TARGET != HWY_SCALAR  // there a tile is one picture
  const hn::FixedTag<std::int8_t, kTile> d;
  std::array<hn::Vec<decltype(d)>, kLanes> in, out;
#pragma GCC unroll 16
  for (std::size_t i = 0; i < kLanes; ++i) in[i] = hn::Load(d, tile + i * kTile);
#pragma GCC unroll 4
  for (std::size_t bit = 1; bit < kTile; bit *= 2) {
#pragma GCC unroll 8
    for (std::size_t i = 0; i < kLanes / 2; ++i) {
      out[2 * i] = hn::InterleaveLower(d, in[i], in[i + kLanes / 2]);
      out[2 * i + 1] = hn::InterleaveUpper(d, in[i], in[i + kLanes / 2]);
    }
    in = out;
  }
#pragma GCC unroll 16
  for (std::size_t i = 0; i < kLanes; ++i) hn::Store(in[i], d, tile + i * kTile);
#endif
}

void inverseTransformHere(const InverseDct& dct, std::span<const ByteLine> coefficients,
                          std::size_t first, std::size_t last, const std::uint32_t* targets,
                          std::int8_t* pixels, float* largest) {
  const F d;
  const hn::Rebind<std::int8_t, F> d8;
  const std::size_t size = dct.size;
  const std::size_t p = size * size;
  const std::size_t padded = (p + kTile - 1) / kTile * kTile;
  const auto memory = hwy::AllocateAligned<float>(2 * padded * kLanes);
  if (!memory) throw std::bad_alloc();
  float* const one = memory.get();
  float* const other = one + padded * kLanes;
  alignas(64) std::int8_t tile[kTile * kLanes];
  alignas(64) float most[kLanes];
  for (std::size_t i = first; i < last; i += kLanes) {
    for (std::size_t k = 0; k < p; ++k) {
      // Too many lines for the processor to guess which ones come next.
      hwy::Prefetch(coefficients[k].lower + i + 128);
      hn::Store(hn::ConvertTo(d, unfolded(coefficients[k], i)), d, one + dct.position[k] * kLanes);
    }
    for (std::size_t y = 0; y < size; ++y)
      transformLine(dct, one + y * size * kLanes, kLanes, other + y * size * kLanes);
    for (std::size_t x = 0; x < size; ++x)
      transformLine(dct, other + x * kLanes, size * kLanes, one + x * kLanes);
    VF peak = hn::Zero(d);
    for (std::size_t k = 0; k < p; ++k)
      peak = hn::Max(peak, hn::Abs(hn::Load(d, one + k * kLanes)));
    hn::Store(peak, d, most);
    const VF factor = hn::Div(hn::Set(d, 127.0f), hn::Max(peak, hn::Set(d, 1e-30f)));
    const std::size_t pictures = std::min(kLanes, last - i);
    std::copy_n(most, pictures, largest + (i - first));
    for (std::size_t pixel = 0; pixel < p; pixel += kTile) {
      for (std::size_t t = 0; t < kTile; ++t) {
        const auto rounded =
            hn::NearestInt(hn::Mul(hn::Load(d, one + (pixel + t) * kLanes), factor));
        hn::StoreU(hn::DemoteTo(d8, rounded), d8, tile + t * kLanes);
      }
      turn(tile);
      for (std::size_t lane = 0; lane < pictures; ++lane) {
        std::int8_t* const to = pixels + targets[i - first + lane] * p + pixel;
        if (pixel + kTile <= p) {
          std::memcpy(to, tile + lane * kTile, kTile);
        } else {
          std::memcpy(to, tile + lane * kTile, p - pixel);
        }
      }
    }
  }
}

void placeColumnHere(const ByteLine& line, std::span<const std::uint32_t> sources,
                     std::size_t panelStride, std::int16_t* u) {
  constexpr std::size_t kPanel = 32;
  constexpr std::size_t kRows = 8 * kPanel;  // at once: bytes that were stored one by one are not
                                             // ready to be read as a vector yet
  const hn::CappedTag<std::int16_t, kPanel> d;
  const hn::Rebind<std::uint8_t, decltype(d)> d8;
  alignas(64) std::uint8_t lower[kRows] = {};
  alignas(64) std::uint8_t upper[kRows] = {};
  const std::size_t rows = sources.size();
  for (std::size_t first = 0; first < rows; first += kRows) {
    const std::size_t count = std::min(kRows, rows - first);
    const std::uint32_t* const from = sources.data() + first;
    for (std::size_t i = 0; i < count; ++i) lower[i] = line.lower[from[i]];
    if (line.upper) {
      for (std::size_t i = 0; i < count; ++i) upper[i] = line.upper[from[i]];
    }
    // Rows beyond the last one are zeros.
    std::fill(lower + count, lower + kRows, std::uint8_t{0});
    std::fill(upper + count, upper + kRows, std::uint8_t{0});
    for (std::size_t i = 0; i < count; i += kPanel) {
      std::int16_t* const panel = u + (first + i) / kPanel * panelStride;
      for (std::size_t t = 0; t < kPanel; t += hn::Lanes(d)) {
        const auto folded = hn::Or(hn::PromoteTo(d, hn::Load(d8, lower + i + t)),
                                   hn::ShiftLeft<8>(hn::PromoteTo(d, hn::Load(d8, upper + i + t))));
        const auto sign = hn::Neg(hn::And(folded, hn::Set(d, std::int16_t{1})));
        const auto half = hn::And(hn::ShiftRight<1>(folded), hn::Set(d, std::int16_t{0x7fff}));
        hn::Stream(hn::Xor(half, sign), d, panel + t);
      }
    }
  }
  hwy::FlushStream();
}

}  // namespace HWY_NAMESPACE
}  // namespace lightsketch
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lightsketch {

HWY_EXPORT(inverseTransformHere);
HWY_EXPORT(placeColumnHere);

void inverseTransform(const InverseDct& dct, std::span<const ByteLine> coefficients,
                      std::size_t first, std::size_t last, const std::uint32_t* targets,
                      std::int8_t* pixels, float* largest) {
  HWY_DYNAMIC_DISPATCH(inverseTransformHere)
  (dct, coefficients, first, last, targets, pixels, largest);
}

void placeColumn(const ByteLine& line, std::span<const std::uint32_t> sources,
                 std::size_t panelStride, std::int16_t* u) {
  HWY_DYNAMIC_DISPATCH(placeColumnHere)(line, sources, panelStride, u);
}

}  // namespace lightsketch
#endif  // HWY_ONCE
