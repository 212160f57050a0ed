// The products that compression spends its time in, by vector instructions chosen at run time:
// OpenBLAS 0.3.21 takes processors it does not know for older ones and leaves half of their
// arithmetic unused. Single precision; all matrices row-major unless a view says otherwise.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>

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

// C = A B, or C += A B; row r of C begins at C + r * rowStep. The result does not depend on the
// number of cores. Fastest where B's columns are few (up to some hundred) or A's rows many: B is
// packed as a whole.
void multiply(const MatrixView& A, const MatrixView& B, float* C, std::size_t rowStep, Cores cores,
              Into into = Into::kSet);

// For `count` columns of p values each, one after the other (half or single precision): the Gram
// matrix, p x p, both triangles, of the p rows: sum over columns of a a^T. One core.
void gramOfColumns(const std::uint16_t* columns, std::size_t count, std::size_t p, float* gram);
void gramOfColumns(const float* columns, std::size_t count, std::size_t p, float* gram);

// The same columns in the basis E (b x p): L = E A, b x count. One core.
void projectColumns(const std::uint16_t* columns, std::size_t count, std::size_t p, const float* E,
                    std::size_t b, float* L);
void projectColumns(const float* columns, std::size_t count, std::size_t p, const float* E,
                    std::size_t b, float* L);

}  // namespace lightsketch
