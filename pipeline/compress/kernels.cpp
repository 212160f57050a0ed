#include "pipeline/compress/kernels.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <new>
#include <stdexcept>

// Vectors of a length known only at run time do not fit in arrays.
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "pipeline/compress/kernels.cpp"
#include "hwy/foreach_target.h"
#include "hwy/highway.h"

#ifndef LIGHTSKETCH_KERNELS_ONCE
#define LIGHTSKETCH_KERNELS_ONCE
namespace lightsketch {
namespace {

using AlignedValues = hwy::AlignedFreeUniquePtr<float[]>;

// Highway's own gives a null pointer where there is no memory.
AlignedValues allocateOrThrow(std::size_t size) {
  AlignedValues values = hwy::AllocateAligned<float>(size);
  if (!values) throw std::bad_alloc();
  return values;
}

// Values of one thread that outlive a call, so that calls by the thousand need not allocate.
class Scratch {
 public:
  float* of(std::size_t size) {
    if (size > size_) {
      values_ = allocateOrThrow(size);
      size_ = size;
    }
    return values_.get();
  }

 private:
  AlignedValues values_;
  std::size_t size_ = 0;
};
thread_local Scratch packedScratch;  // columns or rows being worked on
thread_local Scratch basisScratch;   // the other side

// Steps of the inner dimension at once: a strip of B and a few rows of A stay in the first cache.
constexpr std::size_t kDepth = 256;
// Columns of a Gram matrix at once: their packed panels stay in the second cache.
constexpr std::size_t kGramColumns = 144;
constexpr std::size_t kProjectedColumns = 64;

}  // namespace
}  // namespace lightsketch
#endif

HWY_BEFORE_NAMESPACE();
namespace lightsketch {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using D = hn::ScalableTag<float>;
using V = hn::Vec<D>;
constexpr std::size_t kLanes = HWY_LANES(float);
constexpr std::size_t kPanel = 2 * kLanes;
// Rows of a register tile, two vectors wide: enough sums under way to hide the latency of a
// multiply-add, few enough for the registers.
#if HWY_TARGET == HWY_SCALAR
constexpr int kTileRows = 2;
#elif HWY_TARGET <= HWY_AVX3 || HWY_ARCH_ARM
constexpr int kTileRows = 8;
#else
constexpr int kTileRows = 4;
#endif
static_assert(kPanel % kTileRows == 0);  // a tile's rows lie in one panel

// rows x (vectors * lanes) of C, += or =, from `depth` steps: A by single values, B by vectors.
template <int kRows, int kVectors>
HWY_INLINE void tile(const float* HWY_RESTRICT a, std::size_t aRow, std::size_t aDepth,
                     const float* HWY_RESTRICT b, std::size_t bDepth, std::size_t depth,
                     float* HWY_RESTRICT c, std::size_t cRow, bool add) {
  const D d;
  V sum[kRows][kVectors];
#pragma GCC unroll 16
  for (int r = 0; r < kRows; ++r) {
#pragma GCC unroll 2
    for (int v = 0; v < kVectors; ++v) sum[r][v] = hn::Zero(d);
  }
  for (std::size_t k = 0; k < depth; ++k) {
    V right[kVectors];
#pragma GCC unroll 2
    for (int v = 0; v < kVectors; ++v)
      right[v] = hn::LoadU(d, b + static_cast<std::size_t>(v) * kLanes);
#pragma GCC unroll 16
    for (int r = 0; r < kRows; ++r) {
      const V left = hn::Set(d, a[static_cast<std::size_t>(r) * aRow]);
#pragma GCC unroll 2
      for (int v = 0; v < kVectors; ++v) sum[r][v] = hn::MulAdd(left, right[v], sum[r][v]);
    }
    a += aDepth;
    b += bDepth;
  }
#pragma GCC unroll 16
  for (int r = 0; r < kRows; ++r) {
#pragma GCC unroll 2
    for (int v = 0; v < kVectors; ++v) {
      float* target = c + static_cast<std::size_t>(r) * cRow + static_cast<std::size_t>(v) * kLanes;
      hn::StoreU(add ? hn::Add(hn::LoadU(d, target), sum[r][v]) : sum[r][v], d, target);
    }
  }
}

template <int kRows>
HWY_NOINLINE void tileOfRows(int vectors, const float* a, std::size_t aRow, std::size_t aDepth,
                             const float* b, std::size_t bDepth, std::size_t depth, float* c,
                             std::size_t cRow, bool add) {
  if (vectors == 2) {
    tile<kRows, 2>(a, aRow, aDepth, b, bDepth, depth, c, cRow, add);
  } else {
    tile<kRows, 1>(a, aRow, aDepth, b, bDepth, depth, c, cRow, add);
  }
}

// Up to kTileRows rows.
template <int kRows = kTileRows>
HWY_INLINE void tileOf(int rows, int vectors, const float* a, std::size_t aRow, std::size_t aDepth,
                       const float* b, std::size_t bDepth, std::size_t depth, float* c,
                       std::size_t cRow, bool add) {
  if constexpr (kRows > 1) {
    if (rows < kRows) {
      tileOf<kRows - 1>(rows, vectors, a, aRow, aDepth, b, bDepth, depth, c, cRow, add);
      return;
    }
  }
  tileOfRows<kRows>(vectors, a, aRow, aDepth, b, bDepth, depth, c, cRow, add);
}

// tileOf where only `columns` of the vectors' columns are C's.
HWY_INLINE void tileWithin(int rows, std::size_t columns, const float* a, std::size_t aRow,
                           std::size_t aDepth, const float* b, std::size_t bDepth,
                           std::size_t depth, float* c, std::size_t cRow, bool add) {
  const int vectors = columns > kLanes ? 2 : 1;
  if (columns == static_cast<std::size_t>(vectors) * kLanes) {
    tileOf(rows, vectors, a, aRow, aDepth, b, bDepth, depth, c, cRow, add);
    return;
  }
  HWY_ALIGN float whole[kTileRows * kPanel];
  tileOf(rows, vectors, a, aRow, aDepth, b, bDepth, depth, whole, kPanel, false);
  for (std::size_t r = 0; r < static_cast<std::size_t>(rows); ++r) {
    for (std::size_t k = 0; k < columns; ++k) {
      float& target = c[r * cRow + k];
      target = whole[r * kPanel + k] + (add ? target : 0.0f);
    }
  }
}

HWY_INLINE V load(const float* values) { return hn::LoadU(D(), values); }
HWY_INLINE V load(const std::uint16_t* values) {
  const hn::Rebind<hwy::float16_t, D> half;
  return hn::PromoteTo(D(), hn::LoadU(half, reinterpret_cast<const hwy::float16_t*>(values)));
}
HWY_INLINE float value(float number) { return number; }
HWY_INLINE float value(std::uint16_t number) {
  return static_cast<float>(Eigen::numext::bit_cast<Eigen::half>(number));
}

// --- C = A B -------------------------------------------------------------------------------------

std::size_t packedSize(std::size_t rows, std::size_t columns) {
  return (columns + kPanel - 1) / kPanel * kPanel * rows;
}

// Rows firstRow to firstRow + depth of B, panel after panel, padded with zeros.
void packB(const MatrixView& B, std::size_t firstRow, std::size_t depth, float* packed) {
  for (std::size_t at = 0; at < B.columns; at += kPanel) {
    const std::size_t columns = std::min(kPanel, B.columns - at);
    const float* source = B.data + firstRow * B.rowStep + at * B.columnStep;
    for (std::size_t k = 0; k < depth; ++k, source += B.rowStep, packed += kPanel) {
      std::size_t i = 0;
      if (B.columnStep == 1 && columns == kPanel) {
        hn::Store(hn::LoadU(D(), source), D(), packed);
        hn::Store(hn::LoadU(D(), source + kLanes), D(), packed + kLanes);
        continue;
      }
      for (; i < columns; ++i) packed[i] = source[i * B.columnStep];
      for (; i < kPanel; ++i) packed[i] = 0;
    }
  }
}

// Rows firstRow to lastRow of C. `packed`: all of B, kDepth rows after kDepth rows.
void multiplyRows(const MatrixView& A, std::size_t columns, const float* packed,
                  std::size_t firstRow, std::size_t lastRow, float* C, std::size_t rowStep,
                  bool add) {
  const std::size_t panels = (columns + kPanel - 1) / kPanel;
  const bool transposed = A.columnStep != 1;
  const std::size_t rows = lastRow - firstRow;
  float* left = transposed ? packedScratch.of((rows + kTileRows) * kDepth) : nullptr;
  for (std::size_t at = 0; at < A.columns; at += kDepth, add = true) {
    const std::size_t depth = std::min(kDepth, A.columns - at);
    const float* block = packed + at * panels * kPanel;
    if (transposed) {
      // Tiles of A, one after the other, in the order in which they are used.
      for (std::size_t k = 0; k < depth; ++k) {
        const float* source = A.data + firstRow + (at + k) * A.columnStep;
        for (std::size_t r = 0; r < rows; r += kTileRows) {
          float* target = left + r * depth + k * kTileRows;
          const std::size_t count = std::min<std::size_t>(kTileRows, rows - r);
          if (count == kTileRows) {
            const hn::CappedTag<float, kTileRows> part;
            for (std::size_t i = 0; i < kTileRows; i += hn::Lanes(part))
              hn::StoreU(hn::LoadU(part, source + r + i), part, target + i);
          } else {
            for (std::size_t i = 0; i < count; ++i) target[i] = source[r + i];
          }
        }
      }
    }
    for (std::size_t r = 0; r < rows; r += kTileRows) {
      const int tileRows = static_cast<int>(std::min<std::size_t>(kTileRows, rows - r));
      const float* a = transposed ? left + r * depth : A.data + (firstRow + r) * A.rowStep + at;
      for (std::size_t j = 0; j < panels; ++j) {
        tileWithin(tileRows, std::min(kPanel, columns - j * kPanel), a, transposed ? 1 : A.rowStep,
                   transposed ? kTileRows : 1, block + j * kPanel * depth, kPanel, depth,
                   C + (firstRow + r) * rowStep + j * kPanel, rowStep, add);
      }
    }
  }
}

// --- Blocks of pictures --------------------------------------------------------------------------

// `count` columns of p values into panels [panel][column][kPanel], padded with zeros.
template <class Source>
HWY_INLINE void packColumns(const Source* columns, std::size_t count, std::size_t p,
                            float* packed) {
  const std::size_t whole = p / kPanel;
  for (std::size_t k = 0; k < count; ++k, columns += p) {
    for (std::size_t j = 0; j < whole; ++j) {
      float* target = packed + (j * count + k) * kPanel;
      hn::Store(load(columns + j * kPanel), D(), target);
      hn::Store(load(columns + j * kPanel + kLanes), D(), target + kLanes);
    }
    if (whole * kPanel == p) continue;
    float* target = packed + (whole * count + k) * kPanel;
    for (std::size_t i = 0; i < kPanel; ++i)
      target[i] = whole * kPanel + i < p ? value(columns[whole * kPanel + i]) : 0.0f;
  }
}

template <class Source>
HWY_INLINE void gram(const Source* columns, std::size_t count, std::size_t p, float* result) {
  const std::size_t panels = (p + kPanel - 1) / kPanel;
  float* packed = packedScratch.of(panels * kPanel * kGramColumns);
  if (count == 0) std::fill_n(result, p * p, 0.0f);
  for (std::size_t at = 0; at < count; at += kGramColumns) {
    const std::size_t depth = std::min(kGramColumns, count - at);
    packColumns(columns + at * p, depth, p, packed);
    // Tiles that hold an element (j, i) with j <= i: i in a panel, by vectors, j by single values.
    for (std::size_t panel = 0; panel < panels; ++panel) {
      const std::size_t i = panel * kPanel;
      const float* b = packed + i * depth;
      for (std::size_t j = 0; j < std::min(i + kPanel, p); j += kTileRows) {
        const float* a = packed + j / kPanel * kPanel * depth + j % kPanel;
        const int rows = static_cast<int>(std::min<std::size_t>(kTileRows, p - j));
        const std::size_t skipped = j >= i + kLanes ? kLanes : 0;
        if (i + skipped >= p) continue;
        tileWithin(rows, std::min(kPanel - skipped, p - i - skipped), a, 1, kPanel, b + skipped,
                   kPanel, depth, result + j * p + i + skipped, p, at > 0);
      }
    }
  }
  for (std::size_t i = 0; i < p; ++i) {
    for (std::size_t j = 0; j < i; ++j) result[i * p + j] = result[j * p + i];
  }
}

template <class Source>
HWY_INLINE void project(const Source* columns, std::size_t count, std::size_t p, const float* E,
                        std::size_t b, float* L) {
  // L^T = A^T E^T, some columns of A at once; E^T by vectors.
  MatrixView basis(E, b, p);
  const std::size_t panels = (b + kPanel - 1) / kPanel;
  float* packedBasis = basisScratch.of(panels * kPanel * p + kProjectedColumns * panels * kPanel);
  float* part = packedBasis + panels * kPanel * p;
  packB(basis.transposed(), 0, p, packedBasis);
  float* wide = packedScratch.of(kProjectedColumns * p);
  for (std::size_t at = 0; at < count; at += kProjectedColumns) {
    const std::size_t some = std::min(kProjectedColumns, count - at);
    const Source* source = columns + at * p;
    std::size_t v = 0;
    for (; v + kLanes <= some * p; v += kLanes) hn::Store(load(source + v), D(), wide + v);
    for (; v < some * p; ++v) wide[v] = value(source[v]);
    for (std::size_t k = 0; k < some; k += kTileRows) {
      const int rows = static_cast<int>(std::min<std::size_t>(kTileRows, some - k));
      for (std::size_t j = 0; j < panels; ++j) {
        const int vectors = b - j * kPanel > kLanes ? 2 : 1;
        tileOf(rows, vectors, wide + k * p, p, 1, packedBasis + j * kPanel * p, kPanel, p,
               part + k * panels * kPanel + j * kPanel, panels * kPanel, false);
      }
    }
    for (std::size_t r = 0; r < b; ++r) {
      for (std::size_t k = 0; k < some; ++k) L[r * count + at + k] = part[k * panels * kPanel + r];
    }
  }
}

void gramOfHalfs(const std::uint16_t* columns, std::size_t count, std::size_t p, float* result) {
  gram(columns, count, p, result);
}
void gramOfFloats(const float* columns, std::size_t count, std::size_t p, float* result) {
  gram(columns, count, p, result);
}
void projectHalfs(const std::uint16_t* columns, std::size_t count, std::size_t p, const float* E,
                  std::size_t b, float* L) {
  project(columns, count, p, E, b, L);
}
void projectFloats(const float* columns, std::size_t count, std::size_t p, const float* E,
                   std::size_t b, float* L) {
  project(columns, count, p, E, b, L);
}

void planar(const float* pixels, std::size_t count, std::uint16_t* halfs) {
  const D d;
  const hn::Rebind<hwy::float16_t, D> half;
  const V most = hn::Set(d, 65504.0f);
  const V least = hn::Neg(most);
  const auto store = [&](V values, std::uint16_t* target) {
    const V bounded = hn::Min(hn::Max(values, least), most);
    hn::StoreU(hn::DemoteTo(half, bounded), half, reinterpret_cast<hwy::float16_t*>(target));
  };
  std::size_t i = 0;
  for (; i + kLanes <= count; i += kLanes) {
    V red;
    V green;
    V blue;
    hn::LoadInterleaved3(d, pixels + 3 * i, red, green, blue);
    store(red, halfs + i);
    store(green, halfs + count + i);
    store(blue, halfs + 2 * count + i);
  }
  for (; i < count; ++i) {
    for (std::size_t c = 0; c < 3; ++c) {
      const float bounded = std::clamp(pixels[3 * i + c], -65504.0f, 65504.0f);
      halfs[c * count + i] = Eigen::numext::bit_cast<std::uint16_t>(Eigen::half(bounded));
    }
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace lightsketch
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lightsketch {

HWY_EXPORT(packedSize);
HWY_EXPORT(packB);
HWY_EXPORT(multiplyRows);
HWY_EXPORT(gramOfHalfs);
HWY_EXPORT(gramOfFloats);
HWY_EXPORT(projectHalfs);
HWY_EXPORT(projectFloats);
HWY_EXPORT(planar);

namespace {

template <class Work>
void forEach(std::size_t count, Cores cores, const Work& work) {
  if (cores == Cores::kAll && count > 1) {
    oneapi::tbb::parallel_for(std::size_t{0}, count, work);
  } else {
    for (std::size_t i = 0; i < count; ++i) work(i);
  }
}

}  // namespace

std::int64_t kernelTargets() { return HWY_TARGETS; }

PackedMatrix::PackedMatrix(const MatrixView& matrix, Cores cores)
    : rows_(matrix.rows), columns_(matrix.columns) {
  const std::size_t panelled = HWY_DYNAMIC_DISPATCH(packedSize)(1, columns_);
  values_ = allocateOrThrow(std::max<std::size_t>(panelled * rows_, 1));
  forEach((rows_ + kDepth - 1) / kDepth, cores, [&](std::size_t i) {
    const std::size_t first = i * kDepth;
    HWY_DYNAMIC_DISPATCH(packB)
    (matrix, first, std::min(kDepth, rows_ - first), values_.get() + first * panelled);
  });
}

void multiply(const MatrixView& A, const PackedMatrix& B, float* C, std::size_t rowStep,
              Cores cores, Into into) {
  if (A.columns != B.rows()) throw std::logic_error("matrices that do not fit are multiplied");
  if (A.columns == 0 && into == Into::kSet) {
    for (std::size_t r = 0; r < A.rows; ++r) std::fill_n(C + r * rowStep, B.columns(), 0.0f);
  }
  // Of a transposed A, kDepth pieces this long go to the second cache at once.
  const std::size_t atOnce = A.columnStep == 1 ? 128 : 256;
  forEach((A.rows + atOnce - 1) / atOnce, cores, [&](std::size_t i) {
    const std::size_t first = i * atOnce;
    HWY_DYNAMIC_DISPATCH(multiplyRows)
    (A, B.columns(), B.data(), first, std::min(first + atOnce, A.rows), C, rowStep,
     into == Into::kAdd);
  });
}

void gramOfColumns(const std::uint16_t* columns, std::size_t count, std::size_t p, float* gram) {
  HWY_DYNAMIC_DISPATCH(gramOfHalfs)(columns, count, p, gram);
}
void gramOfColumns(const float* columns, std::size_t count, std::size_t p, float* gram) {
  HWY_DYNAMIC_DISPATCH(gramOfFloats)(columns, count, p, gram);
}
void projectColumns(const std::uint16_t* columns, std::size_t count, std::size_t p, const float* E,
                    std::size_t b, float* L) {
  HWY_DYNAMIC_DISPATCH(projectHalfs)(columns, count, p, E, b, L);
}
void projectColumns(const float* columns, std::size_t count, std::size_t p, const float* E,
                    std::size_t b, float* L) {
  HWY_DYNAMIC_DISPATCH(projectFloats)(columns, count, p, E, b, L);
}

void planarHalfs(const float* pixels, std::size_t count, std::uint16_t* halfs) {
  HWY_DYNAMIC_DISPATCH(planar)(pixels, count, halfs);
}

}  // namespace lightsketch
#endif
