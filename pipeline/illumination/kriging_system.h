// Kernel interpolation on the sphere with a polynomial trend (universal kriging) in its dual form.
// Internal to this folder.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "pipeline/illumination/direction_interpolation.h"

namespace lightsketch {

// The lowest trend that makes the kernel conditionally positive definite.
int lowestTrend(InterpolationSettings::Kernel kernel);

//   [K + nugget I, P; P^T, 0] [w; m] = [k(q); p(q)]
// inverted once. Its inverse also gives every leave-one-out error in closed form.
class KrigingSystem {
 public:
  // Nothing if the lights do not determine the trend (too few, or on one plane or conic). Lights
  // that coincide need a nugget. `settings.outsideClamp` has no meaning here.
  static std::optional<KrigingSystem> solve(std::vector<Eigen::Vector3d> lights,
                                            const InterpolationSettings& settings);

  Eigen::VectorXd weights(const Eigen::Vector3d& q) const;
  // Weights at q of the system without light i (whose own weight comes out as zero): the inverse of
  // a matrix less row and column i is B - b_i b_i^T / b_ii.
  Eigen::VectorXd weightsWithout(Eigen::Index i, const Eigen::Vector3d& q) const;
  // Squared leave-one-out errors of the first lights, e_i = (B y)_i / b_ii (Rippa 1999), summed
  // over all samples y: b_i^T (sum of y y^T) b_i / b_ii^2. Nothing if the lights but one do not
  // determine the trend.
  std::optional<Eigen::VectorXd> leaveOneOut(const Eigen::MatrixXd& products,
                                             Eigen::Index targets) const;
  // Row i: the weights by which the other lights predict light i. Nothing as above.
  std::optional<Eigen::MatrixXd> leaveOneOutWeights() const;

 private:
  Eigen::Index count() const { return static_cast<Eigen::Index>(lights_.size()); }
  double kernel(const Eigen::Vector3d& a, const Eigen::Vector3d& b) const;
  Eigen::VectorXd rightSide(const Eigen::Vector3d& q) const;

  InterpolationSettings settings_;
  std::vector<Eigen::Vector3d> lights_;
  Eigen::MatrixXd inverse_;
};

}  // namespace lightsketch
