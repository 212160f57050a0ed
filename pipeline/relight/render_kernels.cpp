#include "pipeline/relight/render_kernels.h"

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <new>
#include <stdexcept>

// Scalable vectors cannot lie in arrays, as the accumulators do; NEON serves those machines.
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV | HWY_SSSE3)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "pipeline/relight/render_kernels.cpp"
#include <hwy/aligned_allocator.h>
#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>  // compiles what follows once for each target

#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace lightsketch::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

using F = hn::ScalableTag<float>;
using VF = hn::Vec<F>;
constexpr std::size_t kLanes = hn::MaxLanes(F());
constexpr std::size_t kPanelRows = RelightableModel::kPanelRows;

// Vectors summed at once, in three colours each: what the registers hold.
#if HWY_TARGET <= HWY_AVX3 || HWY_ARCH_ARM
constexpr std::size_t kTile = 8;
#else
constexpr std::size_t kTile = 4;
#endif

template <class D>
HWY_INLINE hn::Vec<D> loadFloats(D d, const float* from) {
  return hn::LoadU(d, from);
}
template <class D>
HWY_INLINE hn::Vec<D> loadFloats(D d, const hwy::float16_t* from) {
  return hn::PromoteTo(d, hn::LoadU(hn::Rebind<hwy::float16_t, D>(), from));
}
template <class D>
HWY_INLINE hn::Vec<D> loadFloats(D d, const std::int8_t* from) {
  const hn::Rebind<std::int32_t, D> di;
  return hn::ConvertTo(d, hn::PromoteTo(di, hn::LoadU(hn::Rebind<std::int8_t, D>(), from)));
}
template <class D>
HWY_INLINE hn::Vec<D> loadFloats(D d, const std::int16_t* from) {
  const hn::Rebind<std::int32_t, D> di;
  return hn::ConvertTo(d, hn::PromoteTo(di, hn::LoadU(hn::Rebind<std::int16_t, D>(), from)));
}

// Calls f(first number, as its type).
template <class Function>
HWY_INLINE void withNumbers(const FactorValues& values, const Function& f) {
  switch (values.type()) {
    case ElementType::kFloat32:
      return f(reinterpret_cast<const float*>(values.data()));
    case ElementType::kFloat16:
      return f(reinterpret_cast<const hwy::float16_t*>(values.data()));
    case ElementType::kInt8:
      return f(reinterpret_cast<const std::int8_t*>(values.data()));
    case ElementType::kInt16:
      return f(reinterpret_cast<const std::int16_t*>(values.data()));
  }
}

template <class T>
hwy::AlignedFreeUniquePtr<T[]> allocated(std::size_t count) {
  auto memory = hwy::AllocateAligned<T>(count);
  if (!memory) throw std::bad_alloc();
  return memory;
}

// Three vectors of sums, one per colour, for each of kVectors vectors of rows or pixels.
template <std::size_t kVectors>
struct Sums {
  VF at[kVectors][3];
};

// Both products of relighting are this one: sums(i, c) = sum over k < count of A(i, k) x_c(k), for
// kVectors vectors of i. Column k of A lies at from + k stride; every kPerPanel vectors another
// panel starts, panelStride further on. Fetches ahead of itself.
//
// What is fetched while column k is worked on lies `ahead` elements further on, from column `turn`
// on another `skip`.
struct Fetch {
  std::size_t ahead = 0;
  std::size_t turn = 0;
  std::size_t skip = 0;
};
template <std::size_t kVectors, std::size_t kPerPanel, class T>
HWY_INLINE void multiply(const T* HWY_RESTRICT from, std::size_t panelStride, std::size_t stride,
                         std::size_t count, const std::array<const float*, 3>& x,
                         const Fetch& fetch, Sums<kVectors>& sums) {
  const F d;
  constexpr std::size_t kPerLine = 64 / sizeof(T);
#pragma GCC unroll 8
  for (std::size_t t = 0; t < kVectors; ++t) {
    for (std::size_t c = 0; c < 3; ++c) sums.at[t][c] = hn::Zero(d);
  }
  const T* HWY_RESTRICT fetched = from + fetch.ahead;
  for (std::size_t k = 0; k < count; ++k, from += stride, fetched += stride) {
    if (k == fetch.turn) fetched += fetch.skip;
    const VF x0 = hn::Set(d, x[0][k]);
    const VF x1 = hn::Set(d, x[1][k]);
    const VF x2 = hn::Set(d, x[2][k]);
    for (std::size_t panel = 0; panel < kVectors / kPerPanel; ++panel) {
      for (std::size_t i = 0; i < kPerPanel * kLanes; i += kPerLine) {
        hwy::Prefetch(fetched + panel * panelStride + i);
      }
    }
#pragma GCC unroll 8
    for (std::size_t t = 0; t < kVectors; ++t) {
      const VF a = loadFloats(d, from + t / kPerPanel * panelStride + t % kPerPanel * kLanes);
      sums.at[t][0] = hn::MulAdd(a, x0, sums.at[t][0]);
      sums.at[t][1] = hn::MulAdd(a, x1, sums.at[t][1]);
      sums.at[t][2] = hn::MulAdd(a, x2, sums.at[t][2]);
    }
  }
}

// sRGB of a linear value as a level 0..255 in the low bits of a float near 2^23, whose upper bits
// are 0x4B0000. Above 0.0031308 the curve 255 (1.055 x^(1/2.4) - 0.055) is, to 0.12 levels,
// -20 + 78.356 x^(1/4) + 209.123 x^(1/2) - 12.396 x (minimax; -20 is an integer so that it can be
// one with 2^23); below it is a straight line. IEC 61966-2-1.
HWY_INLINE hn::Vec<hn::RebindToUnsigned<F>> srgbLevel(VF linear) {
  const F d;
  const VF x = hn::Min(hn::Max(linear, hn::Zero(d)), hn::Set(d, 1.0f));
#if HWY_ARCH_X86 && HWY_TARGET != HWY_EMU128 && HWY_TARGET != HWY_SCALAR
  const VF root4 = hn::ApproximateReciprocalSqrt(hn::ApproximateReciprocalSqrt(x));  // 12 bits
#else
  const VF root4 = hn::Sqrt(hn::Sqrt(x));
#endif
  const VF line = hn::MulAdd(x, hn::Set(d, 255 * 12.92f), hn::Set(d, 8388608.0f));
  const VF curve =
      hn::MulAdd(root4, hn::MulAdd(root4, hn::Set(d, 209.12263f), hn::Set(d, 78.355823f)),
                 hn::MulAdd(x, hn::Set(d, -12.396289f), hn::Set(d, 8388608.0f - 20)));
  return hn::BitCast(hn::RebindToUnsigned<F>(),
                     hn::IfThenElse(hn::Lt(x, hn::Set(d, 0.0031308f)), line, curve));
}

// Writes one vector of pixels. `streamed`: past the caches, at an aligned address.
template <PixelFormat kFormat>
HWY_INLINE void storePixels(VF r, VF g, VF b, std::byte* to, bool streamed) {
  const F d;
  if constexpr (kFormat == PixelFormat::kBgra8) {
    const hn::RebindToUnsigned<F> du;
    // The upper bits of a level vanish: shifted out, or under the alpha.
    const auto pixels = hn::Or3(hn::Or(srgbLevel(b), hn::Set(du, 0xff000000u)),
                                hn::ShiftLeft<8>(srgbLevel(g)), hn::ShiftLeft<16>(srgbLevel(r)));
    auto* const words = reinterpret_cast<std::uint32_t*>(to);
    if (streamed) {
      hn::Stream(pixels, du, words);
    } else {
      hn::StoreU(pixels, du, words);
    }
  } else if constexpr (kFormat == PixelFormat::kRgbFloat) {
    hn::StoreInterleaved3(r, g, b, d, reinterpret_cast<float*>(to));
  } else {
    const hn::Rebind<hwy::float16_t, F> dh;
    const hn::Rebind<std::uint16_t, F> du;
    const VF largest = hn::Set(d, 65504.0f);
    const auto half = [&](VF v) HWY_ATTR {
      return hn::BitCast(du, hn::DemoteTo(dh, hn::Max(hn::Min(v, largest), hn::Neg(largest))));
    };
    auto* const words = reinterpret_cast<std::uint16_t*>(to);
    if constexpr (kFormat == PixelFormat::kRgbHalf) {
      hn::StoreInterleaved3(half(r), half(g), half(b), du, words);
    } else {
      hn::StoreInterleaved4(half(r), half(g), half(b), hn::Set(du, std::uint16_t{0x3c00}), du,
                            words);
    }
  }
}

// l = U v for panels of 32 rows, and in the same go the scale that E's rows have.
class RowSums {
 public:
  // For the blocks' rows begin <= row < end.
  RowSums(const RelightableModel& model, const LitBasis& basis, std::size_t begin, std::size_t end)
      : model_(model),
        basis_(basis),
        panel_(begin / kPanelRows),
        endPanel_((end + kPanelRows - 1) / kPanelRows),
        firstRow_(panel_ * kPanelRows),
        stride_((endPanel_ - panel_) * kPanelRows),
        sums_(allocated<float>(3 * stride_ + 1)) {}

  // Makes sure that the rows before `end` are there; returns them from `begin` on.
  HWY_INLINE std::array<const float*, 3> rows(std::size_t begin, std::size_t end) {
    while (panel_ * kPanelRows < end) {
      withNumbers(model_.U.values, [&](const auto* u) HWY_ATTR { next(u); });
    }
    const float* const l = sums_.get() + (begin - firstRow_);
    return {l, l + stride_, l + 2 * stride_};
  }

 private:
  static constexpr std::size_t kVectors = kPanelRows / kLanes;  // of a panel

  template <class T>
  HWY_INLINE void next(const T* u) {
    const std::size_t panelStride = static_cast<std::size_t>(model_.rank) * kPanelRows;
    const T* const from = u + panel_ * panelStride;
    if constexpr (kVectors >= kTile) {
      for (std::size_t i = 0; i < kPanelRows; i += kTile * kLanes) {
        sum<kTile, kTile>(from + i, panelStride, i);
      }
      ++panel_;
    } else {
      constexpr std::size_t kPanels = kTile / kVectors;
      if (panel_ + kPanels <= endPanel_) {
        sum<kTile, kVectors>(from, panelStride, 0);
        panel_ += kPanels;
      } else {
        sum<kVectors, kVectors>(from, panelStride, 0);
        ++panel_;
      }
    }
  }

  template <std::size_t kSummed, std::size_t kPerPanel, class T>
  HWY_INLINE void sum(const T* from, std::size_t panelStride, std::size_t offset) {
    const F d;
    Sums<kSummed> sums;
    // 48 columns ahead: a whole panel would drive out of the first cache what is needed next. The
    // last ones fetch the first ones of the panels that come next.
    constexpr std::size_t kAhead = 48;
    constexpr std::size_t kPanelsSummed = std::max<std::size_t>(1, kSummed / kPerPanel);
    const std::size_t turn = basis_.rank - std::min(basis_.rank, kAhead);
    const Fetch fetch{kAhead * kPanelRows, turn,
                      kPanelsSummed * panelStride - basis_.rank * kPanelRows};
    multiply<kSummed, kPerPanel>(from, panelStride, kPanelRows, basis_.rank, basis_.v, fetch, sums);
    const std::size_t row = panel_ * kPanelRows + offset;
    float* const to = sums_.get() + (row - firstRow_);
#pragma GCC unroll 8
    for (std::size_t t = 0; t < kSummed; ++t) {
      for (std::size_t c = 0; c < 3; ++c)
        hn::Store(sums.at[t][c], d, to + c * stride_ + t * kLanes);
    }
    const std::vector<float>& scale = model_.E.scale;
    if (scale.empty()) return;
    const std::size_t rows = std::min(kSummed * kLanes, scale.size() - std::min(row, scale.size()));
    for (std::size_t c = 0; c < 3; ++c) {
      float* const l = to + c * stride_;
      for (std::size_t i = 0; i < rows; ++i) l[i] *= scale[row + i];
    }
  }

  const RelightableModel& model_;
  const LitBasis& basis_;
  std::size_t panel_;  // the next one
  std::size_t endPanel_;
  std::size_t firstRow_;
  std::size_t stride_;
  hwy::AlignedFreeUniquePtr<float[]> sums_;
};

// Where the next pixels of a block go.
struct Cursor {
  std::byte* to;
  std::size_t left;  // pixels in this line
  std::size_t linePixels;
  std::size_t skipBytes;  // from the end of a line to the next

  HWY_INLINE void next(std::size_t pixels, std::size_t bytes) {
    to += pixels * bytes;
    left -= pixels;
    if (left > 0) return;
    to += skipBytes;
    left = linePixels;
  }
};

// kVectors vectors of a block's pixels from `pixel` on: E^T l and out.
template <std::size_t kVectors, PixelFormat kFormat, class T>
HWY_INLINE void drawTile(const T* e, std::size_t pixels, std::size_t rows, std::size_t ahead,
                         const std::array<const float*, 3>& l, Cursor& cursor, std::size_t pixel,
                         bool streamed, bool roots) {
  Sums<kVectors> sums;
  multiply<kVectors, kVectors>(e + pixel, 0, pixels, rows, l, {ahead, rows, 0}, sums);
  if (roots) {
    for (auto& pixelSums : sums.at) {
      for (VF& sum : pixelSums) {
        const VF root = hn::Max(sum, hn::Zero(F()));
        sum = hn::Mul(root, root);
      }
    }
  }
#pragma GCC unroll 8
  for (std::size_t t = 0; t < kVectors; ++t) {
    storePixels<kFormat>(sums.at[t][0], sums.at[t][1], sums.at[t][2], cursor.to, streamed);
    cursor.next(kLanes, bytesPerPixel(kFormat));
  }
}

template <PixelFormat kFormat, class T>
HWY_NOINLINE void drawBlocks(const RelightableModel& model, const LitBasis& basis, float share,
                             const RenderTarget& target, int first, int last, const T* e) {
  constexpr std::size_t kBytes = bytesPerPixel(kFormat);
  const BlockLayout& layout = model.layout;
  const auto size = static_cast<std::size_t>(layout.blockSize);
  const std::size_t pixels = size * size;
  const auto offset = [&](int j) {
    return static_cast<std::size_t>(model.blockOffset[static_cast<std::size_t>(j)]);
  };
  RowSums rowSums(model, basis, offset(first), offset(last));
  const std::size_t padded = (pixels + kLanes - 1) / kLanes * kLanes;
  const auto scratch = allocated<std::byte>(padded * kBytes + 64);
  const bool wholeVectors = size % kLanes == 0;
  const bool streamed = kFormat == PixelFormat::kBgra8 &&
                        reinterpret_cast<std::uintptr_t>(target.pixels) % 64 == 0 &&
                        target.strideBytes % 64 == 0;

  for (int j = first; j < last; ++j) {
    const std::size_t row = offset(j);
    const std::size_t rows = offset(j + 1) - row;
    const std::size_t kept = keptOf(rows, share);
    const std::array<const float*, 3> l = rowSums.rows(row, row + kept);
    const auto x = static_cast<std::size_t>(j % layout.columns()) * size;
    const auto y = static_cast<std::size_t>(j / layout.columns()) * size;
    const std::size_t width = std::min(size, static_cast<std::size_t>(layout.width) - x);
    const std::size_t height = std::min(size, static_cast<std::size_t>(layout.height) - y);
    std::byte* const picture = target.pixels + y * target.strideBytes + x * kBytes;

    // Straight into the picture where vectors do not leave it, else by way of a whole block.
    const bool direct = wholeVectors && width == size && height == size;
    const std::size_t linePixels = direct ? size : padded;
    Cursor cursor{direct ? picture : scratch.get(), linePixels, linePixels,
                  direct ? target.strideBytes - size * kBytes : 0};
    const T* const block = e + row * pixels;
    const std::size_t ahead = 2 * rows * pixels;
    std::size_t pixel = 0;
    for (; pixel + kTile * kLanes <= padded; pixel += kTile * kLanes) {
      drawTile<kTile, kFormat>(block, pixels, kept, ahead, l, cursor, pixel, direct && streamed,
                               model.singleLamp);
    }
    for (; pixel < padded; pixel += kLanes) {
      drawTile<1, kFormat>(block, pixels, kept, ahead, l, cursor, pixel, direct && streamed,
                           model.singleLamp);
    }
    if (direct) continue;
    for (std::size_t line = 0; line < height; ++line) {
      std::memcpy(picture + line * target.strideBytes, scratch.get() + line * size * kBytes,
                  width * kBytes);
    }
  }
  if (streamed) hwy::FlushStream();
}

void renderBlocksHere(const RelightableModel& model, const LitBasis& basis, float share,
                      const RenderTarget& target, int first, int last) {
  withNumbers(model.E.values, [&](const auto* e) {
    switch (target.format) {
      case PixelFormat::kBgra8:
        return drawBlocks<PixelFormat::kBgra8>(model, basis, share, target, first, last, e);
      case PixelFormat::kRgbHalf:
        return drawBlocks<PixelFormat::kRgbHalf>(model, basis, share, target, first, last, e);
      case PixelFormat::kRgbaHalf:
        return drawBlocks<PixelFormat::kRgbaHalf>(model, basis, share, target, first, last, e);
      case PixelFormat::kRgbFloat:
        return drawBlocks<PixelFormat::kRgbFloat>(model, basis, share, target, first, last, e);
    }
  });
}

// v += sum of kColumns columns of V times amounts. In doubles, because increments add up for ever.
template <std::size_t kColumns, class T>
HWY_INLINE void addColumns(const std::array<const T*, kColumns>& columns,
                           const std::array<double, kColumns>& amounts, std::size_t rank,
                           double* HWY_RESTRICT v) {
  const hn::ScalableTag<double> dd;
  const hn::Rebind<float, decltype(dd)> df;
  for (std::size_t k = 0; k < rank; k += hn::Lanes(dd)) {
    auto sum = hn::LoadU(dd, v + k);
    for (std::size_t i = 0; i < kColumns; ++i) {
      sum = hn::MulAdd(hn::PromoteTo(dd, loadFloats(df, columns[i] + k)), hn::Set(dd, amounts[i]),
                       sum);
    }
    hn::StoreU(sum, dd, v + k);
  }
}

void addLightsHere(const RelightableModel& model, std::span<const LightChange> changes, double* v) {
  const auto rank = static_cast<std::size_t>(model.rank);
  withNumbers(model.V.values, [&](const auto* numbers) HWY_ATTR {
    using T = std::remove_cv_t<std::remove_pointer_t<decltype(numbers)>>;
    constexpr std::size_t kAtOnce = 4;
    for (std::size_t c = 0; c < 3; ++c) {
      double* const to = v + c * litStride(model.rank);
      std::array<const T*, kAtOnce> columns;
      std::array<double, kAtOnce> amounts;
      std::size_t found = 0;
      for (const LightChange& change : changes) {
        if (change.amount[c] == 0) continue;
        columns[found] = numbers + (3 * static_cast<std::size_t>(change.light) + c) * rank;
        amounts[found] = change.amount[c];
        if (++found < kAtOnce) continue;
        addColumns<kAtOnce, T>(columns, amounts, rank, to);
        found = 0;
      }
      for (std::size_t i = 0; i < found; ++i) {
        addColumns<1, T>({columns[i]}, {amounts[i]}, rank, to);
      }
    }
  });
}

}  // namespace lightsketch::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lightsketch {

HWY_EXPORT(renderBlocksHere);
HWY_EXPORT(addLightsHere);

void renderBlocks(const RelightableModel& model, const LitBasis& basis, float share,
                  const RenderTarget& target, int first, int last) {
  HWY_DYNAMIC_DISPATCH(renderBlocksHere)(model, basis, share, target, first, last);
}

void addLights(const RelightableModel& model, std::span<const LightChange> changes, double* v) {
  HWY_DYNAMIC_DISPATCH(addLightsHere)(model, changes, v);
}

}  // namespace lightsketch
#endif  // HWY_ONCE
