#include "pipeline/compress/factorise.h"

#include <cblas.h>
#include <lapack.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <stdexcept>
#include <utility>
#include <vector>

namespace lightsketch {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::MatrixXf;
using Eigen::VectorXd;

constexpr const char* kStage = "second stage";

void symmetricEigen(int n, float* a, int first, int last, float* values, float* vectors) {
  char job = 'V';
  char range = 'I';
  char lower = 'L';
  float zero = 0;
  float workSize = 0;
  lapack_int intSize = 0;
  lapack_int found = 0;
  lapack_int info = 0;
  lapack_int query = -1;
  std::vector<lapack_int> support(static_cast<std::size_t>(2 * n));
  LAPACK_ssyevr(&job, &range, &lower, &n, a, &n, &zero, &zero, &first, &last, &zero, &found, values,
                vectors, &n, support.data(), &workSize, &query, &intSize, &query, &info);
  auto size = static_cast<lapack_int>(workSize);
  std::vector<float> work(static_cast<std::size_t>(size));
  std::vector<lapack_int> ints(static_cast<std::size_t>(intSize));
  LAPACK_ssyevr(&job, &range, &lower, &n, a, &n, &zero, &zero, &first, &last, &zero, &found, values,
                vectors, &n, support.data(), work.data(), &size, ints.data(), &intSize, &info);
  if (info != 0 || found != last - first + 1)
    throw std::runtime_error("eigenvalues did not converge");
}

void symmetricEigen(int n, double* a, int first, int last, double* values, double* vectors) {
  char job = 'V';
  char range = 'I';
  char lower = 'L';
  double zero = 0;
  double workSize = 0;
  lapack_int intSize = 0;
  lapack_int found = 0;
  lapack_int info = 0;
  lapack_int query = -1;
  std::vector<lapack_int> support(static_cast<std::size_t>(2 * n));
  LAPACK_dsyevr(&job, &range, &lower, &n, a, &n, &zero, &zero, &first, &last, &zero, &found, values,
                vectors, &n, support.data(), &workSize, &query, &intSize, &query, &info);
  auto size = static_cast<lapack_int>(workSize);
  std::vector<double> work(static_cast<std::size_t>(size));
  std::vector<lapack_int> ints(static_cast<std::size_t>(intSize));
  LAPACK_dsyevr(&job, &range, &lower, &n, a, &n, &zero, &zero, &first, &last, &zero, &found, values,
                vectors, &n, support.data(), work.data(), &size, ints.data(), &intSize, &info);
  if (info != 0 || found != last - first + 1)
    throw std::runtime_error("eigenvalues did not converge");
}

// The `count` largest eigenvalues of a symmetric matrix (lower triangle), largest first, with their
// vectors as columns.
template <class Matrix>
void largestEigen(Matrix& gram, int count,
                  Eigen::Matrix<typename Matrix::Scalar, Eigen::Dynamic, 1>& values,
                  Matrix& vectors) {
  const auto n = static_cast<int>(gram.rows());
  values.resize(n);
  vectors.resize(n, count);
  symmetricEigen(n, gram.data(), n - count + 1, n, values.data(), vectors.data());
  values = values.head(count).reverse().eval();
  vectors = vectors.rowwise().reverse().eval();
}

// Orthonormal basis of the columns of a tall matrix, in place.
void orthonormalise(MatrixXf& matrix) {
  auto rows = static_cast<lapack_int>(matrix.rows());
  auto columns = static_cast<lapack_int>(matrix.cols());
  lapack_int info = 0;
  lapack_int size = columns * 64;
  std::vector<float> work(static_cast<std::size_t>(size));
  std::vector<float> tau(static_cast<std::size_t>(columns));
  LAPACK_sgeqrf(&rows, &columns, matrix.data(), &rows, tau.data(), work.data(), &size, &info);
  LAPACK_sorgqr(&rows, &columns, &columns, matrix.data(), &rows, tau.data(), work.data(), &size,
                &info);
  if (info != 0) throw std::runtime_error("orthonormalisation failed");
}

// Gram matrix of L's rows (side = rows) or columns, lower triangle, in double.
MatrixXd gramOf(const RowMajorMatrixf& L, bool ofRows) {
  const Index side = ofRows ? L.rows() : L.cols();
  const Index depth = ofRows ? L.cols() : L.rows();
  MatrixXd gram = MatrixXd::Zero(side, side);
  const Index chunk = std::max<Index>(64, (Index{1} << 24) / side);
  for (Index at = 0; at < depth; at += chunk) {
    const Index count = std::min(chunk, depth - at);
    const MatrixXd part =
        ofRows ? MatrixXd(L.middleCols(at, count).cast<double>())
               : MatrixXd(L.middleRows(at, count).transpose().cast<double>());  // side x count
    cblas_dsyrk(CblasColMajor, CblasLower, CblasNoTrans, static_cast<int>(side),
                static_cast<int>(count), 1, part.data(), static_cast<int>(side), 1, gram.data(),
                static_cast<int>(side));
  }
  return gram;
}

// Row-major C (m x n) = A (m x k) B (k x n).
void multiply(const RowMajorMatrixf& A, const RowMajorMatrixf& B, RowMajorMatrixf& C) {
  C.resize(A.rows(), B.cols());
  cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, static_cast<int>(A.rows()),
              static_cast<int>(B.cols()), static_cast<int>(A.cols()), 1, A.data(),
              static_cast<int>(A.cols()), B.data(), static_cast<int>(B.cols()), 0, C.data(),
              static_cast<int>(B.cols()));
}

void exactStage(const RowMajorMatrixf& L, int q, SecondStage& result, Progress& progress) {
  const bool ofRows = L.rows() < L.cols();
  MatrixXd gram = gramOf(L, ofRows);
  progress.update(kStage, 1, 3);
  if (progress.cancelled()) return;
  VectorXd values;
  MatrixXd vectors;
  largestEigen(gram, q, values, vectors);
  progress.update(kStage, 2, 3);
  if (progress.cancelled()) return;
  result.keptEnergy = values.cwiseMax(0.0).sum();
  if (ofRows) {
    result.U = vectors.cast<float>();
    multiply(RowMajorMatrixf(result.U.transpose()), L, result.V);
  } else {
    const RowMajorMatrixf basis = vectors.cast<float>();
    multiply(L, basis, result.U);
    result.V = basis.transpose();
  }
}

void randomisedStage(const RowMajorMatrixf& L, int q, SecondStage& result, Progress& progress) {
  constexpr int kOversampling = 16;
  constexpr int kPowerIterations = 2;
  constexpr std::size_t kSteps = 2 * kPowerIterations + 3;
  const auto rows = static_cast<int>(L.rows());
  const auto columns = static_cast<int>(L.cols());
  const int width = std::min({q + kOversampling, rows, columns});
  std::size_t step = 0;
  const auto goOn = [&] {
    progress.update(kStage, ++step, kSteps);
    return !progress.cancelled();
  };
  // L lies row by row: to BLAS, its transpose column by column.
  const auto apply = [&](CBLAS_TRANSPOSE transpose, const MatrixXf& X) {
    const int height = transpose == CblasTrans ? rows : columns;
    MatrixXf Y(height, width);
    cblas_sgemm(CblasColMajor, transpose, CblasNoTrans, height, width, static_cast<int>(X.rows()),
                1, L.data(), columns, X.data(), static_cast<int>(X.rows()), 0, Y.data(), height);
    return Y;
  };
  std::mt19937 random(20040808);
  std::normal_distribution<float> normal;
  const MatrixXf start = MatrixXf::NullaryExpr(columns, width, [&] { return normal(random); });
  MatrixXf Q = apply(CblasTrans, start);
  orthonormalise(Q);
  for (int k = 0; k < kPowerIterations; ++k) {
    if (!goOn()) return;
    MatrixXf Z = apply(CblasNoTrans, Q);
    orthonormalise(Z);
    if (!goOn()) return;
    Q = apply(CblasTrans, Z);
    orthonormalise(Q);
  }
  if (!goOn()) return;
  const MatrixXf Bt = apply(CblasNoTrans, Q);  // (Q^T L)^T
  // The SVD of the small B = Q^T L through B B^T: L ~ (Q W) (W^T B).
  MatrixXd gram = Bt.cast<double>().transpose() * Bt.cast<double>();
  VectorXd values;
  MatrixXd vectors;
  largestEigen(gram, q, values, vectors);
  if (!goOn()) return;
  result.keptEnergy = values.cwiseMax(0.0).sum();
  const MatrixXf W = vectors.cast<float>();
  result.U = Q * W;
  result.V = (Bt * W).transpose();
}

// Gives each column of U and row of V the same largest value, so that neither leaves the range of
// half floats.
void balance(SecondStage& result) {
  for (Index k = 0; k < result.V.rows(); ++k) {
    const float u = result.U.col(k).cwiseAbs().maxCoeff();
    const float v = result.V.row(k).cwiseAbs().maxCoeff();
    if (u <= 0 || v <= 0) continue;
    const float scale = std::sqrt(v / u);
    result.U.col(k) *= scale;
    result.V.row(k) /= scale;
  }
}

}  // namespace

SingleThreadedBlas::SingleThreadedBlas() : before_(openblas_get_num_threads()) {
  openblas_set_num_threads(1);
}
SingleThreadedBlas::~SingleThreadedBlas() { openblas_set_num_threads(before_); }

void factoriseBlock(std::span<const float> columns, std::span<const bool> inPicture, int b,
                    float* E, float* L) {
  const auto p = static_cast<int>(inPicture.size());
  const auto count = static_cast<int>(columns.size() / inPicture.size());
  const auto pixels = static_cast<int>(std::count(inPicture.begin(), inPicture.end(), true));
  if (b > pixels) throw std::logic_error("more basis vectors than pixels in a block");
  if (b == pixels) {
    // Full rank: any orthonormal basis is exact; this one needs no arithmetic and packs to nothing.
    std::fill_n(E, static_cast<std::size_t>(b) * inPicture.size(), 0.0f);
    int row = 0;
    for (int k = 0; k < p; ++k) {
      if (!inPicture[static_cast<std::size_t>(k)]) continue;
      E[row * p + k] = 1;
      for (int i = 0; i < count; ++i)
        L[row * count + i] = columns[static_cast<std::size_t>(i * p + k)];
      ++row;
    }
    return;
  }
  // Eigenvectors of the pixels' Gram matrix. In single precision it hides singular values below
  // 3e-4 of the largest, which do not matter unless all are wanted.
  const Eigen::Map<const MatrixXf> A(columns.data(), p, count);
  Eigen::Map<RowMajorMatrixf> basis(E, b, p);
  if (b == std::min(pixels, count)) {
    const MatrixXd wide = A.cast<double>();
    MatrixXd gram(p, p);
    cblas_dsyrk(CblasColMajor, CblasLower, CblasNoTrans, p, count, 1, wide.data(), p, 0,
                gram.data(), p);
    VectorXd values;
    MatrixXd vectors;
    largestEigen(gram, b, values, vectors);
    basis = vectors.transpose().cast<float>();
  } else {
    MatrixXf gram(p, p);
    cblas_ssyrk(CblasColMajor, CblasLower, CblasNoTrans, p, count, 1, A.data(), p, 0, gram.data(),
                p);
    Eigen::VectorXf values;
    MatrixXf vectors;
    largestEigen(gram, b, values, vectors);
    basis = vectors.transpose();
  }
  cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasTrans, b, count, p, 1, E, p, A.data(), p, 0, L,
              count);
}

Result<SecondStage> factoriseAll(RowMajorMatrixf L, int q, SecondStageMethod method,
                                 Progress& progress) {
  const auto side = static_cast<int>(std::min(L.rows(), L.cols()));
  const bool full = method == SecondStageMethod::kAuto && q == side;
  SecondStage result;
  result.exact = full || method == SecondStageMethod::kExact ||
                 (method == SecondStageMethod::kAuto && q > side / 6);
  progress.update(kStage, 0, 1);
  for (Index row = 0; row < L.rows(); ++row) {
    result.totalEnergy += L.row(row).cast<double>().squaredNorm();
  }
  if (full) {
    const bool wide = L.rows() < L.cols();
    (wide ? result.V : result.U) = std::move(L);
    (wide ? result.U : result.V).setIdentity(side, side);
    result.keptEnergy = result.totalEnergy;
  } else if (result.exact) {
    exactStage(L, q, result, progress);
  } else {
    randomisedStage(L, q, result, progress);
  }
  if (progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
  balance(result);
  progress.update(kStage, 1, 1);
  return result;
}

}  // namespace lightsketch
