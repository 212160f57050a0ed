#include "calibration/model/lamp_position.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace lightsketch {
namespace {

using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Basis = Eigen::Matrix<double, 3, 2>;

Matrix3d crossMatrix(const Vector3d& v) {
  Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

Basis tangentBasis(const Vector3d& direction) {
  Basis basis;
  basis.col(0) = direction.unitOrthogonal();
  basis.col(1) = direction.cross(basis.col(0));
  return basis;
}

// Probability that chi-square of `odd` degrees of freedom is at least `value`: Abramowitz and
// Stegun 26.4.4; n rays leave 2 n - 3 degrees of freedom, always odd.
double chiSquareTail(double value, int odd) {
  const double half = value / 2;
  double sum = std::erfc(std::sqrt(half));
  double term = std::exp(-half) * std::sqrt(half) / std::tgamma(1.5);
  for (int k = 3; k <= odd; k += 2) {
    sum += term;
    term *= half / (k / 2.0);
  }
  return std::clamp(sum, 0.0, 1.0);
}

// Covariance of the direction in which the lamp is seen, at a distance: the origin's error counts
// by 1/distance.
Matrix3d sightCovariance(const LampRay& ray, double distance) {
  const Matrix3d mixed = ray.originDirectionCovariance + ray.originDirectionCovariance.transpose();
  return ray.directionCovariance + mixed / distance + ray.originCovariance / (distance * distance);
}

struct Normal {
  Matrix3d matrix = Matrix3d::Zero();
  Vector3d vector = Vector3d::Zero();
  double cost = 0;
};

Normal normalEquations(std::span<const LampRay> rays, const Vector3d& point) {
  Normal normal;
  for (const auto& ray : rays) {
    const Vector3d to = point - ray.origin;
    const double distance = to.norm();
    const Vector3d sight = to / distance;
    const Basis basis = tangentBasis(ray.direction);
    const Vector2d miss = basis.transpose() * sight;
    const Eigen::Matrix<double, 2, 3> jacobian =
        basis.transpose() * (Matrix3d::Identity() - sight * sight.transpose()) / distance;
    const Matrix2d covariance = basis.transpose() * sightCovariance(ray, distance) * basis;
    const Matrix2d weight = covariance.inverse();
    normal.matrix += jacobian.transpose() * weight * jacobian;
    normal.vector -= jacobian.transpose() * weight * miss;
    normal.cost += miss.dot(weight * miss);
  }
  return normal;
}

}  // namespace

Result<LampRay> lampRay(const CameraPose& pose, const CameraModel& model, const Vector2d& pixel,
                        const Matrix2d& pixelCovariance) {
  const auto direction = model.unproject(pixel);
  if (!direction) {
    return failure(ErrorCode::kInvalidArgument,
                   "camera '{}': pixel ({:.1f}, {:.1f}) lies outside the lens's valid field",
                   pose.camera, pixel.x(), pixel.y());
  }
  const Matrix2d radiansPerPixel = model.pixelsPerRadian(*direction).inverse();
  const Basis basis = tangentBasis(*direction);  // pixelsPerRadian's own axes
  const Basis perPixel = basis * radiansPerPixel;
  return lampRay(
      pose, model.rayOrigin(*direction), *direction,
      perPixel * pixelCovariance * perPixel.transpose() + model.directionCovariance(*direction));
}

LampRay lampRay(const CameraPose& pose, const Vector3d& origin, const Vector3d& direction,
                const Matrix3d& covariance) {
  const Matrix3d rotation = pose.sceneFromCamera.linear();
  const Vector3d offset = rotation * origin;
  LampRay ray;
  ray.origin = pose.sceneFromCamera.translation() + offset;
  ray.direction = (rotation * direction).normalized();
  // exp(w) R turns the ray by w x direction and its origin about the camera.
  Eigen::Matrix<double, 3, 6> originPerPose;
  originPerPose << -crossMatrix(offset), Matrix3d::Identity();
  Eigen::Matrix<double, 3, 6> directionPerPose;
  directionPerPose << -crossMatrix(ray.direction), Matrix3d::Zero();
  ray.directionCovariance = rotation * covariance * rotation.transpose() +
                            directionPerPose * pose.covariance * directionPerPose.transpose();
  ray.originCovariance = originPerPose * pose.covariance * originPerPose.transpose();
  ray.originDirectionCovariance = originPerPose * pose.covariance * directionPerPose.transpose();
  return ray;
}

Result<LampPosition> triangulateLamp(std::span<const LampRay> rays) {
  if (rays.size() < 2) {
    return failure(ErrorCode::kInvalidArgument,
                   "lamp position: {} line of sight, at least 2 cameras must see the lamp; use a "
                   "second source camera or give the lamp's distance",
                   rays.size());
  }
  // Seed: the point closest to all lines.
  Matrix3d sum = Matrix3d::Zero();
  Vector3d right = Vector3d::Zero();
  for (const auto& ray : rays) {
    const Basis basis = tangentBasis(ray.direction);
    const Matrix2d own = basis.transpose() * ray.directionCovariance * basis;
    if (!(own.allFinite() && own.determinant() > 0 && own(0, 0) > 0)) {
      return failure(ErrorCode::kInvalidArgument,
                     "lamp position: a line of sight has no covariance; give the lamp pixel's");
    }
    const Matrix3d across = Matrix3d::Identity() - ray.direction * ray.direction.transpose();
    sum += across;
    right += across * ray.origin;
  }
  double widest = 0;
  double blur = 0;  // sine of three sigmas of a line of sight
  for (const auto& a : rays) {
    blur = std::max(blur, 3 * std::sqrt(a.directionCovariance.trace()));
    for (const auto& b : rays) widest = std::max(widest, a.direction.cross(b.direction).norm());
  }
  const auto tooParallel = [&] {
    return failure(ErrorCode::kNotFound,
                   "lamp position: the lines of sight are too parallel ({:.3f} degrees) to tell "
                   "the lamp's distance; set the source cameras further apart or give the distance",
                   Angle::radians(std::asin(std::min(1.0, widest))).degrees());
  };
  // Below this the seed is rounding error.
  if (widest < 1e-6) return tooParallel();
  Vector3d point = sum.ldlt().solve(right);

  Normal normal;
  for (int iteration = 0; iteration < 50; ++iteration) {
    for (const auto& ray : rays) {
      if ((point - ray.origin).dot(ray.direction) <= 0) {
        if (widest < blur) return tooParallel();
        return failure(ErrorCode::kInvalidArgument,
                       "lamp position: the lines of sight meet behind a camera; they saw different "
                       "lights, or a pose is wrong");
      }
    }
    normal = normalEquations(rays, point);
    const Vector3d step = normal.matrix.ldlt().solve(normal.vector);
    // Half the way to the nearest camera at most, so that no step jumps behind one.
    double limit = 1;
    for (const auto& ray : rays) {
      limit = std::min(limit, 0.5 * (point - ray.origin).norm() / std::max(step.norm(), 1e-300));
    }
    point += limit * step;
    if (!point.allFinite()) return tooParallel();
    if (step.norm() < 1e-12 * point.norm() + 1e-15) break;
  }
  normal = normalEquations(rays, point);
  const Eigen::SelfAdjointEigenSolver<Matrix3d> modes(normal.matrix);
  double nearest = (point - rays.front().origin).norm();
  for (const auto& ray : rays) nearest = std::min(nearest, (point - ray.origin).norm());
  const double weakest = modes.eigenvalues()[0];
  if (!(weakest > 0) || 1 / std::sqrt(weakest) > nearest / 2) return tooParallel();

  LampPosition lamp;
  lamp.position = point;
  lamp.covariance = normal.matrix.inverse();
  lamp.chiSquare = normal.cost;
  lamp.degreesOfFreedom = 2 * static_cast<int>(rays.size()) - 3;
  lamp.probability = chiSquareTail(lamp.chiSquare, lamp.degreesOfFreedom);
  return lamp;
}

Result<LampPosition> lampAtRadius(const LampRay& ray, double radius, double radiusSigma) {
  if (!(radius > 0 && std::isfinite(radius)) || !(radiusSigma >= 0)) {
    return failure(ErrorCode::kInvalidArgument,
                   "lamp position: the lamp's distance must be positive, and its error not "
                   "negative");
  }
  if (ray.origin.norm() >= radius) {
    return failure(ErrorCode::kInvalidArgument,
                   "lamp position: the camera is {:.2f} m from the subject, further than the lamp "
                   "({:.2f} m); give the lamp's true distance",
                   ray.origin.norm(), radius);
  }
  const double along = ray.origin.dot(ray.direction);
  const double range =
      -along + std::sqrt(along * along + radius * radius - ray.origin.squaredNorm());
  LampPosition lamp;
  lamp.position = ray.origin + range * ray.direction;
  // The point stays on the sphere: p . dp = r dr with dp = d(origin) + range d(direction) +
  // direction d(range).
  const Vector3d& p = lamp.position;
  const double slope = p.dot(ray.direction);
  const Matrix3d slide = Matrix3d::Identity() - ray.direction * p.transpose() / slope;
  const Vector3d perRadius = ray.direction * radius / slope;
  lamp.covariance = slide * (range * range * sightCovariance(ray, range)) * slide.transpose() +
                    radiusSigma * radiusSigma * perRadius * perRadius.transpose();
  return lamp;
}

double lampFallOff(double distance, double reference) {
  return (reference / distance) * (reference / distance);
}

}  // namespace lightsketch
