// The products that compression spends its time in, by vector instructions chosen at run time:
// OpenBLAS 0.3.21 takes processors it does not know for older ones and leaves half of their
// arithmetic unused. Single precision; all matrices row-major unless a view says otherwise.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <utility>

#include "hwy/aligned_allocator.h"

namespace lightsketch {

// Element (r, c) is data[r * rowStep + c * columnStep]; one of the steps is 1.
struct MatrixView {
  const float* data = nullptr;
  std::size_t rows = 0;
  std::size_t columns = 0;
  std::size_t rowStep = 0;
  std::size_t columnStep = 1;

  MatrixView() = default;
  MatrixView(const float* values, std::size_t rowCount, std::size_t columnCount)
      : data(values), rows(rowCount), columns(columnCount), rowStep(columnCount) {}
  // Any plain float matrix, of either storage order.
  template <class Derived>
  explicit MatrixView(const Eigen::PlainObjectBase<Derived>& matrix)
      : data(matrix.data()),
        rows(static_cast<std::size_t>(matrix.rows())),
        columns(static_cast<std::size_t>(matrix.cols())),
        rowStep(static_cast<std::size_t>(matrix.rowStride())),
        columnStep(static_cast<std::size_t>(matrix.colStride())) {}

  MatrixView transposed() const {
    MatrixView view = *this;
    std::swap(view.rows, view.columns);
    std::swap(view.rowStep, view.columnStep);
    return view;
  }
  MatrixView middleRows(std::size_t first, std::size_t count) const {
    MatrixView view = *this;
    view.data += first * rowStep;
    view.rows = count;
    return view;
  }
};

enum class Cores {
  kOne,  // for callers that are parallel themselves
  kAll,
};
enum class Into { kSet, kAdd };

// The right side of a product, ready for it.
class PackedMatrix {
 public:
  PackedMatrix(const MatrixView& matrix, Cores cores);
  std::size_t rows() const { return rows_; }
  std::size_t columns() const { return columns_; }
  const float* data() const { return values_.get(); }

 private:
  std::size_t rows_;
  std::size_t columns_;
  hwy::AlignedFreeUniquePtr<float[]> values_;
};

// C = A B, or C += A B; row r of C begins at C + r * rowStep. The result does not depend on the
// number of cores. Fastest where A's rows are many.
void multiply(const MatrixView& A, const PackedMatrix& B, float* C, std::size_t rowStep,
              Cores cores, Into into = Into::kSet);
inline void multiply(const MatrixView& A, const MatrixView& B, float* C, std::size_t rowStep,
                     Cores cores, Into into = Into::kSet) {
  multiply(A, PackedMatrix(B, cores), C, rowStep, cores, into);
}

// A B as a matrix.
inline Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> product(
    const MatrixView& A, const MatrixView& B, Cores cores) {
  Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> C(
      static_cast<Eigen::Index>(A.rows), static_cast<Eigen::Index>(B.columns));
  multiply(A, B, C.data(), B.columns, cores);
  return C;
}

// For `count` columns of p values each, one after the other (half or single precision): the Gram
// matrix, p x p, both triangles, of the p rows: sum over columns of a a^T. One core.
void gramOfColumns(const std::uint16_t* columns, std::size_t count, std::size_t p, float* gram);
void gramOfColumns(const float* columns, std::size_t count, std::size_t p, float* gram);

// The same columns in the basis E (b x p): L = E A, b x count. One core.
void projectColumns(const std::uint16_t* columns, std::size_t count, std::size_t p, const float* E,
                    std::size_t b, float* L);
void projectColumns(const float* columns, std::size_t count, std::size_t p, const float* E,
                    std::size_t b, float* L);

// Pixels of red, green, blue to one row of half floats per channel, 3 x count; values beyond half's
// range become its largest.
void planarHalfs(const float* pixels, std::size_t count, std::uint16_t* halfs);

// Bits of the sets of instructions (Highway's targets) that all of this was built for.
std::int64_t kernelTargets();

}  // namespace lightsketch
