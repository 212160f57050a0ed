#include "pipeline/compress/factorise.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <utility>
#include <vector>

#include "capture/frame/hash64.h"
#include "pipeline/compress/kernels.h"
#include "pipeline/compress/lapack.h"

namespace lightsketch {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr const char* kStage = "second stage";

// Rows of L that are worked on at once.
constexpr Index kStrip = 2048;

// Calls work(first row, count) for all strips of L; false if it was told to stop.
template <class Work>
bool forStrips(const LargeMatrix& L, Progress& progress, const Work& work) {
  for (Index at = 0; at < L.rows(); at += kStrip) {
    if (progress.cancelled()) return false;
    const Index count = std::min(kStrip, L.rows() - at);
    work(at, count);
    L.release(static_cast<std::size_t>(at), static_cast<std::size_t>(count));
  }
  return true;
}

MatrixView strip(const LargeMatrix& L, Index first, Index count) {
  return {L.data() + first * L.cols(), static_cast<std::size_t>(count),
          static_cast<std::size_t>(L.cols())};
}

MatrixView strip(const RowMajorMatrixf& matrix, Index first, Index count) {
  return MatrixView(matrix).middleRows(static_cast<std::size_t>(first),
                                       static_cast<std::size_t>(count));
}

// Y = L X.
bool apply(const LargeMatrix& L, const RowMajorMatrixf& X, RowMajorMatrixf& Y, Progress& progress) {
  const PackedMatrix right(MatrixView(X), Cores::kAll);
  Y.resize(L.rows(), X.cols());
  return forStrips(L, progress, [&](Index first, Index count) {
    multiply(strip(L, first, count), right, Y.row(first).data(), right.columns(), Cores::kAll);
  });
}

// Z = L^T Y.
bool applyTransposed(const LargeMatrix& L, const RowMajorMatrixf& Y, RowMajorMatrixf& Z,
                     Progress& progress) {
  Z.setZero(L.cols(), Y.cols());
  return forStrips(L, progress, [&](Index first, Index count) {
    multiply(strip(L, first, count).transposed(), strip(Y, first, count), Z.data(),
             static_cast<std::size_t>(Y.cols()), Cores::kAll, Into::kAdd);
  });
}

RowMajorMatrixf product(const RowMajorMatrixf& A, const MatrixXd& B) {
  return product(MatrixView(A), MatrixView(RowMajorMatrixf(B.cast<float>())), Cores::kAll);
}

// Gram matrix of the rows (or columns) of a matrix, lower triangle, in double.
MatrixXd gramOf(const Eigen::Ref<const RowMajorMatrixf, 0, Eigen::OuterStride<>>& matrix,
                bool ofRows) {
  const Index side = ofRows ? matrix.rows() : matrix.cols();
  const Index depth = ofRows ? matrix.cols() : matrix.rows();
  MatrixXd gram = MatrixXd::Zero(side, side);
  const Index chunk = std::max<Index>(64, (Index{1} << 22) / side);
  for (Index at = 0; at < depth; at += chunk) {
    const Index count = std::min(chunk, depth - at);
    addGram(ofRows ? MatrixXd(matrix.middleCols(at, count).cast<double>())
                   : MatrixXd(matrix.middleRows(at, count).transpose().cast<double>()),
            gram);
  }
  return gram;
}

// Principal axes of a tall matrix's columns: its product with `rotation` has orthogonal columns of
// these lengths, longest first.
struct Axes {
  VectorXd lengths;
  MatrixXd rotation;
};

Axes axesOf(const RowMajorMatrixf& matrix) {
  MatrixXd gram = gramOf(matrix, false);
  Axes axes;
  largestEigen(gram, static_cast<int>(matrix.cols()), axes.lengths, axes.rotation);
  axes.lengths = axes.lengths.cwiseMax(0.0).cwiseSqrt();
  return axes;
}

// Orthonormal basis of a tall matrix's columns in its place, given its axes; what is nothing beside
// the longest becomes zero. Twice, as at first short columns inherit the rounding of long ones.
void orthonormalise(RowMajorMatrixf& matrix, Axes axes) {
  for (int round = 0;; ++round) {
    const double nothing = 1e-6 * axes.lengths[0];
    for (Index k = 0; k < matrix.cols(); ++k)
      axes.rotation.col(k) *= axes.lengths[k] > nothing ? 1 / axes.lengths[k] : 0;
    matrix = product(matrix, axes.rotation);
    if (round == 1) return;
    axes = axesOf(matrix);
  }
}

bool exactStage(const LargeMatrix& L, int q, SecondStage& result, Progress& progress) {
  const bool ofRows = L.rows() < L.cols();
  MatrixXd gram = gramOf(L.matrix(), ofRows);
  progress.update(kStage, 1, 3);
  if (progress.cancelled()) return false;
  VectorXd values;
  MatrixXd vectors;
  largestEigen(gram, q, values, vectors);
  progress.update(kStage, 2, 3);
  if (progress.cancelled()) return false;
  result.keptEnergy = values.cwiseMax(0.0).sum();
  const RowMajorMatrixf basis = vectors.cast<float>();
  if (ofRows) {
    RowMajorMatrixf right;
    if (!applyTransposed(L, basis, right, progress)) return false;
    result.U = basis;
    result.V = right.transpose();
  } else {
    if (!apply(L, basis, result.U, progress)) return false;
    result.V = basis.transpose();
  }
  return true;
}

// L^T S, where every row of S has one entry, 1 or -1, in a column by chance: what a product with a
// full random matrix would show of L's rows, for the price of reading them.
bool sketchRows(const LargeMatrix& L, Index width, RowMajorMatrixf& sketch, Progress& progress) {
  constexpr Index kColumns = 512;
  RowMajorMatrixf sums = RowMajorMatrixf::Zero(width, L.cols());
  const bool whole = forStrips(L, progress, [&](Index first, Index count) {
    oneapi::tbb::parallel_for(Index{0}, (L.cols() + kColumns - 1) / kColumns, [&](Index part) {
      const Index at = part * kColumns;
      const Index columns = std::min(kColumns, L.cols() - at);
      for (Index row = first; row < first + count; ++row) {
        const std::uint64_t hash = hash64(static_cast<std::uint64_t>(row));
        auto target = sums.row(static_cast<Index>((hash >> 1) % static_cast<std::uint64_t>(width)))
                          .segment(at, columns);
        const auto source = L.matrix().row(row).segment(at, columns);
        if (hash & 1) {
          target += source;
        } else {
          target -= source;
        }
      }
    });
  });
  sketch = sums.transpose();
  return whole;
}

// matrix -= basis basis^T matrix.
void removeFrom(RowMajorMatrixf& matrix, const RowMajorMatrixf& basis) {
  RowMajorMatrixf inner(basis.cols(), matrix.cols());
  multiply(MatrixView(basis).transposed(), MatrixView(matrix), inner.data(),
           static_cast<std::size_t>(inner.cols()), Cores::kAll);
  inner = -inner;
  multiply(MatrixView(basis), MatrixView(inner), matrix.data(),
           static_cast<std::size_t>(matrix.cols()), Cores::kAll, Into::kAdd);
}

void appendColumns(RowMajorMatrixf& matrix, const RowMajorMatrixf& more) {
  RowMajorMatrixf both(more.rows(), matrix.cols() + more.cols());
  both << matrix, more;
  matrix = std::move(both);
}

// Block Krylov iteration: the space is spanned by a sketch of L's rows and its images under L^T L,
// one after the other; Rayleigh and Ritz find the best of it.
bool randomisedStage(const LargeMatrix& L, int q, SecondStageMethod method, SecondStage& result,
                     Progress& progress) {
  constexpr Index kPanel = 32;  // what the products like best
  constexpr std::size_t kMostPasses = 41;
  constexpr double kGoodEnough = 0.01;  // dB
  constexpr Index kDeep = 4;            // products until a span is wide enough
  const Index side = std::min(L.rows(), L.cols());
  // Narrow blocks make a deeper space of as many columns, wide ones better products.
  const bool span = method == SecondStageMethod::kSpan;
  const Index width = std::min(span ? (q + kPanel + kDeep * kPanel - 1) / (kDeep * kPanel) * kPanel
                                    : std::max(kPanel, (q / 3 + kPanel / 2) / kPanel * kPanel),
                               side);
  RowMajorMatrixf basis(L.cols(), 0);  // orthonormal columns
  RowMajorMatrixf image(L.rows(), 0);  // L basis
  RowMajorMatrixf next;
  if (!sketchRows(L, width, next, progress)) return false;
  orthonormalise(next, axesOf(next));
  result.width = static_cast<int>(width);
  for (double lastGain = 0;;) {
    RowMajorMatrixf projected;
    if (!apply(L, next, projected, progress)) return false;
    progress.update(kStage, static_cast<std::size_t>(++result.passes), kMostPasses);
    appendColumns(basis, next);
    appendColumns(image, projected);
    if (image.cols() >= std::min<Index>(q + kPanel, side)) {
      const Axes axes = axesOf(image);
      const double kept = axes.lengths.head(q).squaredNorm();
      const double gain = kept - result.keptEnergy;
      const double lost = std::max(result.totalEnergy - kept, 1e-7 * result.totalEnergy);
      // Each gain is a smaller part of the one before, a tenth or less as a rule.
      const double toCome = result.keptEnergy == 0
                                ? lost
                                : gain * (lastGain > 0 ? std::min(gain / lastGain, 0.5) : 0.25);
      lastGain = result.keptEnergy == 0 ? 0 : gain;
      result.keptEnergy = kept;
      result.leftToGain = toCome < lost ? -10 * std::log10(1 - toCome / lost) : 10;
      if (span || result.leftToGain < kGoodEnough || image.cols() + width > side) {
        result.U = product(image, axes.rotation.leftCols(q));
        result.V = product(basis, axes.rotation.leftCols(q)).transpose();
        return true;
      }
    }
    // Of nearly equal lengths, or short directions drown in the rounding of long ones.
    orthonormalise(projected, axesOf(projected));
    if (!applyTransposed(L, projected, next, progress)) return false;
    progress.update(kStage, static_cast<std::size_t>(++result.passes), kMostPasses);
    for (int round = 0; round < 2; ++round) {
      removeFrom(next, basis);
      orthonormalise(next, axesOf(next));
    }
  }
}

// Gives each column of U and row of V the same largest value, so that neither leaves the range of
// half floats.
void balance(SecondStage& result) {
  Eigen::RowVectorXf scale = result.U.cwiseAbs().colwise().maxCoeff();
  for (Index k = 0; k < result.V.rows(); ++k) {
    const float v = result.V.row(k).cwiseAbs().maxCoeff();
    scale[k] = scale[k] > 0 && v > 0 ? std::sqrt(v / scale[k]) : 1;
    result.V.row(k) /= scale[k];
  }
  result.U.array().rowwise() *= scale.array();
}

}  // namespace

Result<SecondStage> factoriseAll(LargeMatrix L, int q, SecondStageMethod method,
                                 Progress& progress) {
  const auto side = static_cast<int>(std::min(L.rows(), L.cols()));
  const bool full = method == SecondStageMethod::kAuto && q == side;
  SecondStage result;
  if (side == 0) {  // nothing was worth a row: pictures that are black
    result.U.setZero(L.rows(), q);
    result.V.setZero(q, L.cols());
    result.exact = true;
    return result;
  }
  result.exact = full || method == SecondStageMethod::kExact ||
                 (method == SecondStageMethod::kAuto && q > side / 4);
  progress.update(kStage, 0, 1);
  std::vector<double> rowEnergy(static_cast<std::size_t>(L.rows()));
  const auto& matrix = L.matrix();
  bool whole = forStrips(L, progress, [&](Index first, Index count) {
    oneapi::tbb::parallel_for(first, first + count, [&](Index row) {
      rowEnergy[static_cast<std::size_t>(row)] = matrix.row(row).cast<double>().squaredNorm();
    });
  });
  result.totalEnergy = std::accumulate(rowEnergy.begin(), rowEnergy.end(), 0.0);
  if (whole && full) {
    const bool wide = L.rows() < L.cols();
    (wide ? result.V : result.U) = matrix;
    (wide ? result.U : result.V).setIdentity(side, side);
    result.keptEnergy = result.totalEnergy;
  } else if (whole) {
    whole = result.exact ? exactStage(L, q, result, progress)
                         : randomisedStage(L, q, method, result, progress);
  }
  if (!whole || progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
  balance(result);
  progress.update(kStage, 1, 1);
  return result;
}

}  // namespace lightsketch
