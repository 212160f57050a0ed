#include "pipeline/compress/leading_eigenvectors.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cstdint>

#include "capture/frame/hash64.h"
#include "pipeline/compress/kernels.h"
#include "pipeline/compress/lapack.h"

namespace lightsketch {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;

// Uniform in [-1, 1), the same on every machine.
float noise(std::uint64_t index) {
  return static_cast<float>(hash64(index) >> 40) / static_cast<float>(1 << 23) - 1.0f;
}

void fillWithNoise(RowMajorMatrixf& X, Index column, std::span<const bool> inPicture) {
  for (Index i = 0; i < X.rows(); ++i) {
    X(i, column) = inPicture[static_cast<std::size_t>(i)]
                       ? noise(static_cast<std::uint64_t>(column * X.rows() + i))
                       : 0.0f;
  }
}

// Orthonormalises columns of any lengths that are not far from orthogonal: Cholesky-QR, twice.
// Columns that are nothing beside the longest become noise first.
void orthonormalise(RowMajorMatrixf& X, std::span<const bool> inPicture) {
  constexpr float kNothing = 1e-6f;
  const float longest = X.colwise().norm().maxCoeff();
  for (Index k = 0; k < X.cols(); ++k) {
    if (!(X.col(k).norm() > kNothing * longest)) fillWithNoise(X, k, inPicture);
  }
  for (int round = 0; round < 2; ++round) {
    X.array().rowwise() /= X.colwise().norm().array();
    MatrixXd inner = product(MatrixView(X).transposed(), MatrixView(X), Cores::kOne).cast<double>();
    inner.diagonal().array() += 1e-7;  // should they not be that far from parallel
    const MatrixXd inverse = inner.llt().matrixU().solve(MatrixXd::Identity(X.cols(), X.cols()));
    X = product(MatrixView(X), MatrixView(RowMajorMatrixf(inverse.cast<float>())), Cores::kOne);
  }
}

RowMajorMatrixf byLapack(const RowMajorMatrixf& gram, int most, double threshold) {
  MatrixXd wide = gram.cast<double>();
  Eigen::VectorXd values;
  MatrixXd vectors;
  largestEigen(wide, most, values, vectors);
  const Index kept = threshold > 0 ? (values.array() > threshold).count() : most;
  return vectors.leftCols(kept).transpose().cast<float>();
}

}  // namespace

RowMajorMatrixf leadingEigenvectors(const RowMajorMatrixf& gram, std::span<const bool> inPicture,
                                    const RankRule& rule) {
  constexpr int kFirst = 10;
  constexpr int kSpare = 6;
  constexpr int kSteps = 40;  // for each number of vectors that is tried
  const auto pixels = static_cast<int>(std::count(inPicture.begin(), inPicture.end(), true));
  const int most = rule.most > 0 ? std::min(rule.most, pixels) : pixels;
  const double energy = gram.diagonal().cast<double>().sum();
  if (rule.threshold > 0 && energy <= rule.threshold) return RowMajorMatrixf(0, gram.cols());
  // With a threshold few may do.
  int wanted = rule.threshold > 0 ? std::min(most, kFirst) : most;
  if (3 * wanted > pixels) return byLapack(gram, most, rule.threshold);

  RowMajorMatrixf X(gram.rows(), std::min(wanted + kSpare, pixels));
  for (Index k = 0; k < X.cols(); ++k) fillWithNoise(X, k, inPicture);
  orthonormalise(X, inPicture);
  Eigen::VectorXd values;
  double captured = 0;
  bool converged = false;
  int step = 0;
  while (step < kSteps) {
    ++step;
    RowMajorMatrixf Y = product(MatrixView(gram), MatrixView(X), Cores::kOne);
    const MatrixXd inner =
        product(MatrixView(X).transposed(), MatrixView(Y), Cores::kOne).cast<double>();
    const Eigen::SelfAdjointEigenSolver<MatrixXd> solver(inner);
    values = solver.eigenvalues().reverse();
    const RowMajorMatrixf rotation = solver.eigenvectors().rowwise().reverse().cast<float>();
    X = product(MatrixView(Y), MatrixView(rotation), Cores::kOne);
    orthonormalise(X, inPicture);
    const double now = values.head(wanted).sum();
    const double left = std::max(energy - now, 1e-6 * energy);
    const bool done = now - captured < 1e-4 * left;
    captured = now;
    if (!done) continue;
    if (wanted == most || !(values[wanted - 1] > rule.threshold)) {
      converged = true;
      break;
    }
    // All of these are worth keeping: there may be more.
    wanted = std::min(2 * wanted, most);
    if (3 * wanted > pixels) return byLapack(gram, most, rule.threshold);
    const Index before = X.cols();
    X.conservativeResize(Eigen::NoChange, std::min(wanted + kSpare, pixels));
    for (Index k = before; k < X.cols(); ++k) fillWithNoise(X, k, inPicture);
    orthonormalise(X, inPicture);
    captured = 0;
    step = 0;
  }
  // How many lie above a threshold is only known of vectors that have settled.
  if (!converged && rule.threshold > 0) return byLapack(gram, most, rule.threshold);
  Index kept = wanted;
  if (rule.threshold > 0) kept = (values.head(wanted).array() > rule.threshold).count();
  return X.leftCols(kept).transpose();
}

}  // namespace lightsketch
