#include "calibration/lens/plane_pose.h"

#include <Eigen/Eigenvalues>
#include <Eigen/SVD>
#include <cmath>
#include <vector>

#include "capture/frame/median.h"

namespace lightsketch {

using Eigen::Isometry3d;
using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

namespace {

Vector2d middleOf(std::span<const Vector2d> points) {
  Vector2d middle = Vector2d::Zero();
  for (const auto& point : points) middle += point / static_cast<double>(points.size());
  return middle;
}

Eigen::Matrix2d scatterOf(std::span<const Vector2d> points) {
  const Vector2d middle = middleOf(points);
  Eigen::Matrix2d scatter = Eigen::Matrix2d::Zero();
  for (const auto& point : points) scatter += (point - middle) * (point - middle).transpose();
  return scatter;
}

}  // namespace

bool spanPlane(std::span<const Vector2d> points) {
  if (points.size() < 6) return false;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> spread(scatterOf(points));
  return spread.eigenvalues()[0] > 1e-4 * spread.eigenvalues()[1];
}

std::optional<PlanePose> planePose(std::span<const Vector3d> bearings,
                                   std::span<const Vector2d> points) {
  if (!spanPlane(points)) return std::nullopt;
  const std::size_t count = points.size();
  // Centred and scaled, or the normal equations lose half their digits (Hartley 1997).
  const Vector2d centre = middleOf(points);
  const double scale = std::sqrt(scatterOf(points).trace() / static_cast<double>(count));

  Eigen::Matrix<double, 9, 9> normal = Eigen::Matrix<double, 9, 9>::Zero();
  for (std::size_t i = 0; i < count; ++i) {
    // |v x p|^2 = p' (I - v v') p with p = H X: the normal matrix is a Kronecker product.
    const Vector2d at = (points[i] - centre) / scale;
    const Vector3d x(at.x(), at.y(), 1);
    const Matrix3d across = Matrix3d::Identity() - bearings[i] * bearings[i].transpose();
    for (int a = 0; a < 3; ++a) {
      for (int b = 0; b < 3; ++b) normal.block<3, 3>(3 * a, 3 * b) += x[a] * x[b] * across;
    }
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 9, 9>> solver(normal);
  if (solver.info() != Eigen::Success) return std::nullopt;
  const Eigen::Matrix<double, 9, 1> h = solver.eigenvectors().col(0);
  Matrix3d homography = h.reshaped(3, 3);
  // The board lies where the bearings point, not behind.
  double towards = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const Vector2d at = (points[i] - centre) / scale;
    towards += bearings[i].dot(homography * Vector3d(at.x(), at.y(), 1));
  }
  if (towards < 0) homography = -homography;
  const double length = (homography.col(0).norm() + homography.col(1).norm()) / 2;
  if (!(length > 0)) return std::nullopt;
  homography /= length;

  Matrix3d axes;
  axes << homography.col(0), homography.col(1), homography.col(0).cross(homography.col(1));
  const Eigen::JacobiSVD<Matrix3d> svd(axes, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Matrix3d rotation = svd.matrixU() * svd.matrixV().transpose();
  if (rotation.determinant() < 0) {
    rotation = svd.matrixU() * Vector3d(1, 1, -1).asDiagonal() * svd.matrixV().transpose();
  }
  PlanePose pose;
  pose.cameraFromBoard.linear() = rotation;
  pose.cameraFromBoard.translation() =
      homography.col(2) * scale - rotation * Vector3d(centre.x(), centre.y(), 0);
  std::vector<double> errors;
  for (std::size_t i = 0; i < count; ++i) {
    const Vector3d p = pose.cameraFromBoard * Vector3d(points[i].x(), points[i].y(), 0);
    errors.push_back(std::atan2(p.cross(bearings[i]).norm(), p.dot(bearings[i])));
  }
  pose.medianError = median(errors);
  if (!std::isfinite(pose.medianError)) return std::nullopt;
  return pose;
}

Isometry3d flippedPose(const Isometry3d& cameraFromBoard, const Vector3d& centre) {
  const Vector3d sight = (cameraFromBoard * centre).normalized();
  const Matrix3d& rotation = cameraFromBoard.linear();
  Matrix3d flipped;
  for (int axis = 0; axis < 2; ++axis) {
    flipped.col(axis) = rotation.col(axis) - 2 * rotation.col(axis).dot(sight) * sight;
  }
  flipped.col(2) = flipped.col(0).cross(flipped.col(1));
  Isometry3d pose = Isometry3d::Identity();
  pose.linear() = flipped;
  pose.translation() = cameraFromBoard * centre - flipped * centre;
  return pose;
}

}  // namespace lightsketch
