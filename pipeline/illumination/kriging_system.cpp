#include "pipeline/illumination/kriging_system.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <cmath>
#include <utility>

namespace lightsketch {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;
using Kernel = InterpolationSettings::Kernel;

int trendSize(int degree) { return (degree + 1) * (degree + 1); }

// Polynomials in x, y, z restricted to the sphere: spherical harmonics up to `degree`, not
// normalised.
VectorXd trend(const Vector3d& d, int degree) {
  const double x = d.x();
  const double y = d.y();
  const double z = d.z();
  VectorXd values(16);
  values << 1, x, y, z, x * y, y * z, z * x, x * x - y * y, 3 * z * z - 1, y * (3 * x * x - y * y),
      x * y * z, y * (5 * z * z - 1), z * (5 * z * z - 3), x * (5 * z * z - 1), z * (x * x - y * y),
      x * (x * x - 3 * y * y);
  return values.head(trendSize(degree));
}

}  // namespace

int lowestTrend(Kernel kernel) { return kernel == Kernel::kLinear ? 0 : 1; }

std::optional<KrigingSystem> KrigingSystem::solve(std::vector<Vector3d> lights,
                                                  const InterpolationSettings& settings) {
  const auto n = static_cast<Eigen::Index>(lights.size());
  const int terms = trendSize(settings.trendDegree);
  if (terms > n) return std::nullopt;
  KrigingSystem system;
  system.settings_ = settings;
  MatrixXd P(n, terms);
  for (Eigen::Index i = 0; i < n; ++i) {
    P.row(i) = trend(lights[static_cast<std::size_t>(i)], settings.trendDegree).transpose();
  }
  // A trend that the lights hardly determine would swing wildly between and beyond them.
  const VectorXd gram = Eigen::SelfAdjointEigenSolver<MatrixXd>(P.transpose() * P).eigenvalues();
  if (gram[0] < 1e-9 * gram[gram.size() - 1]) return std::nullopt;
  MatrixXd& A = system.inverse_;
  A = MatrixXd::Zero(n + terms, n + terms);
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j < i; ++j) {
      A(i, j) = A(j, i) =
          system.kernel(lights[static_cast<std::size_t>(i)], lights[static_cast<std::size_t>(j)]);
    }
    A(i, i) = settings.nugget;
  }
  A.topRightCorner(n, terms) = P;
  A.bottomLeftCorner(terms, n) = P.transpose();
  // Eigen, not BLAS: systems are small and many, and threads would cost more than they give.
  A = Eigen::PartialPivLU<MatrixXd>(A).inverse();
  if (!A.allFinite()) return std::nullopt;
  system.lights_ = std::move(lights);
  return system;
}

VectorXd KrigingSystem::weights(const Vector3d& q) const {
  return inverse_.topRows(count()) * rightSide(q);
}

VectorXd KrigingSystem::weightsWithout(Eigen::Index i, const Vector3d& q) const {
  VectorXd right = rightSide(q);
  right[i] = 0;
  const VectorXd w = inverse_ * right;
  return (w - inverse_.col(i) * (w[i] / inverse_(i, i))).head(count());
}

std::optional<VectorXd> KrigingSystem::leaveOneOut(const MatrixXd& products,
                                                   Eigen::Index targets) const {
  const VectorXd diagonal = inverse_.diagonal().head(targets);
  if (diagonal.minCoeff() <= 0) return std::nullopt;
  const MatrixXd rows = inverse_.topLeftCorner(targets, count());
  const VectorXd sums = (rows * products).cwiseProduct(rows).rowwise().sum();
  return VectorXd(sums.cwiseQuotient(diagonal.cwiseAbs2()));
}

std::optional<MatrixXd> KrigingSystem::leaveOneOutWeights() const {
  const VectorXd diagonal = inverse_.diagonal().head(count());
  if (diagonal.minCoeff() <= 0) return std::nullopt;
  MatrixXd weights =
      -(diagonal.cwiseInverse().asDiagonal() * inverse_.topLeftCorner(count(), count()));
  weights.diagonal().setZero();
  return weights;
}

// Its sign makes the kernel conditionally positive definite with the lowest trend.
double KrigingSystem::kernel(const Vector3d& a, const Vector3d& b) const {
  const Vector3d step = a - b;
  const double squared = step.head<2>().squaredNorm() + std::pow(settings_.stretch * step.z(), 2);
  if (squared == 0) return 0;
  switch (settings_.kernel) {
    case Kernel::kThinPlate:
      return squared * 0.5 * std::log(squared);
    case Kernel::kLinear:
      return -std::sqrt(squared);
    case Kernel::kCubic:
      return squared * std::sqrt(squared);
  }
  return 0;
}

VectorXd KrigingSystem::rightSide(const Vector3d& q) const {
  VectorXd right(inverse_.rows());
  for (Eigen::Index i = 0; i < count(); ++i) {
    right[i] = kernel(q, lights_[static_cast<std::size_t>(i)]);
  }
  right.tail(inverse_.rows() - count()) = trend(q, settings_.trendDegree);
  return right;
}

}  // namespace lightsketch
