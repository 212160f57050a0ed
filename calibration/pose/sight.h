// Internal to calibration/pose: what an observed pixel demands of a point, for the solvers.
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <cmath>

#include "calibration/model/lamp_position.h"

namespace lightsketch {

// A ray in its camera's own frame. Two residuals of unit variance say how far off it a point is.
struct Sight {
  Eigen::Vector3d origin;
  Eigen::Vector3d direction;
  Eigen::Matrix<double, 2, 3> whitener;

  static Sight of(const LampRay& ray) {
    Eigen::Matrix<double, 3, 2> basis;
    basis.col(0) = ray.direction.unitOrthogonal();
    basis.col(1) = ray.direction.cross(basis.col(0));
    const Eigen::Matrix2d covariance = basis.transpose() * ray.directionCovariance * basis;
    Sight sight;
    sight.origin = ray.origin;
    sight.direction = ray.direction;
    sight.whitener =
        covariance.llt().matrixL().solve(Eigen::Matrix<double, 2, 3>(basis.transpose()));
    return sight;
  }

  // 2 tan(angle / 2) towards where the point is seen: unlike the sine it grows up to 180 degrees,
  // so that a point behind the camera is no solution. T is double or a Ceres jet.
  template <class T>
  void residual(const Eigen::Matrix<T, 3, 1>& point, T* out) const {
    const Eigen::Matrix<T, 3, 1> seen = (point - origin.cast<T>()).normalized();
    const T along = seen.dot(direction.cast<T>());
    const T scale = T(2) / (T(1 + 1e-9) + along);
    Eigen::Map<Eigen::Matrix<T, 2, 1>> residuals(out);
    residuals = scale * (whitener.cast<T>() * seen);
  }
};

// exp(w) v, smooth at w = 0.
template <class T>
Eigen::Matrix<T, 3, 1> rotated(const Eigen::Matrix<T, 3, 1>& w, const Eigen::Matrix<T, 3, 1>& v) {
  using std::cos;
  using std::sin;
  using std::sqrt;
  const T theta2 = w.squaredNorm();
  if (theta2 < T(1e-14)) return v + w.cross(v) + T(0.5) * w.cross(w.cross(v));
  const T theta = sqrt(theta2);
  const Eigen::Matrix<T, 3, 1> wv = w.cross(v);
  return v + sin(theta) / theta * wv + (T(1) - cos(theta)) / theta2 * w.cross(wv);
}

inline Eigen::Matrix3d rotationOf(const Eigen::Vector3d& w) {
  const double angle = w.norm();
  return angle > 0 ? Eigen::AngleAxisd(angle, w / angle).toRotationMatrix()
                   : Eigen::Matrix3d(Eigen::Matrix3d::Identity());
}

// A pose as a solver sees it: a reference and six parameters (w, t), exp(w) R and t. Folded after
// each solve, so that its covariance is that of the left perturbation that CameraPose wants.
struct PoseBlock {
  Eigen::Matrix3d reference = Eigen::Matrix3d::Identity();
  Eigen::Matrix<double, 6, 1> parameters = Eigen::Matrix<double, 6, 1>::Zero();

  static PoseBlock of(const Eigen::Isometry3d& pose) {
    PoseBlock block;
    block.reference = pose.linear();
    block.parameters.tail<3>() = pose.translation();
    return block;
  }
  Eigen::Isometry3d pose() const {
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    // Through a quaternion: rounding must not add up over many folds.
    pose.linear() = Eigen::Quaterniond(rotationOf(parameters.head<3>()) * reference)
                        .normalized()
                        .toRotationMatrix();
    pose.translation() = parameters.tail<3>();
    return pose;
  }
  void fold() { *this = of(pose()); }
};

// A point through the pose, and through its inverse.
template <class T>
Eigen::Matrix<T, 3, 1> transformed(const Eigen::Matrix3d& reference, const T* pose,
                                   const Eigen::Matrix<T, 3, 1>& point) {
  const Eigen::Matrix<T, 3, 1> w(pose[0], pose[1], pose[2]);
  const Eigen::Matrix<T, 3, 1> t(pose[3], pose[4], pose[5]);
  return rotated<T>(w, reference.cast<T>() * point) + t;
}
template <class T>
Eigen::Matrix<T, 3, 1> transformedBack(const Eigen::Matrix3d& reference, const T* pose,
                                       const Eigen::Matrix<T, 3, 1>& point) {
  const Eigen::Matrix<T, 3, 1> w(-pose[0], -pose[1], -pose[2]);
  const Eigen::Matrix<T, 3, 1> t(pose[3], pose[4], pose[5]);
  return reference.transpose().cast<T>() * rotated<T>(w, point - t);
}

}  // namespace lightsketch
