#include "calibration/pose/mirror_ball.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace lightsketch {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

struct Reflection {
  Vector3d point;
  Vector3d direction;
};

// Nothing where the ray misses the ball.
std::optional<Reflection> reflect(const Vector3d& eye, const Vector3d& direction,
                                  const Vector3d& centre, double radius) {
  const Vector3d to = centre - eye;
  const double along = to.dot(direction);
  const double inside = radius * radius - (to - along * direction).squaredNorm();
  if (!(inside > 0) || along <= 0) return std::nullopt;
  Reflection reflection;
  reflection.point = eye + (along - std::sqrt(inside)) * direction;
  const Vector3d normal = (reflection.point - centre) / radius;
  reflection.direction = (direction - 2 * direction.dot(normal) * normal).normalized();
  return reflection;
}

}  // namespace

Result<MirrorBall> ballFromOutline(const CameraPose& pose, const CameraModel& model,
                                   const BallCone& cone, double radius) {
  if (!(radius > 0 && std::isfinite(radius))) {
    return failure(
        ErrorCode::kInvalidArgument,
        "mirror ball: its radius is missing; measure its diameter and give half of it in "
        "metres");
  }
  const double angle = cone.angularRadius.radians();
  if (!(angle > 0 && angle < 1.5)) {
    return failure(ErrorCode::kInvalidArgument, "mirror ball: its outline has no size");
  }
  const double distance = radius / std::sin(angle);
  Matrix3d perAngle;
  perAngle.col(0) = distance * cone.axis.unitOrthogonal();
  perAngle.col(1) = distance * cone.axis.cross(cone.axis.unitOrthogonal());
  perAngle.col(2) = -distance / std::tan(angle) * cone.axis;
  const Matrix3d turned = pose.sceneFromCamera.linear() * perAngle;
  MirrorBall ball;
  ball.radiusMetres = radius;
  ball.centre = pose.sceneFromCamera * (model.rayOrigin(cone.axis) + distance * cone.axis);
  ball.centreCovariance = turned * cone.covariance * turned.transpose();
  return ball;
}

std::optional<Vector3d> directionFromHighlight(const BallCircle& circle,
                                               const Vector2d& highlight) {
  const Vector2d offset = (highlight - circle.centre) / circle.radiusPixels;
  const double inside = 1 - offset.squaredNorm();
  if (!(inside > 0)) return std::nullopt;
  const Vector3d normal(offset.x(), -offset.y(), std::sqrt(inside));
  return (2 * normal.z() * normal - Vector3d::UnitZ()).normalized();
}

Result<LampRay> rayFromHighlight(const CameraPose& pose, const CameraModel& model,
                                 const MirrorBall& ball, const PixelMeasurement& highlight) {
  CameraPose exact = pose;
  exact.covariance.setZero();
  ASSIGN_OR_RETURN(const auto seen, lampRay(exact, model, highlight.pixel, highlight.covariance));
  const auto reflection = reflect(seen.origin, seen.direction, ball.centre, ball.radiusMetres);
  if (!reflection) {
    return failure(ErrorCode::kInvalidArgument,
                   "mirror ball: the highlight at ({:.1f}, {:.1f}) lies outside the ball's outline",
                   highlight.pixel.x(), highlight.pixel.y());
  }
  // By differences: of the direction in which the highlight is seen, and of the ball's centre.
  const double step = 1e-6;
  Eigen::Matrix<double, 6, 6> jacobian = Eigen::Matrix<double, 6, 6>::Zero();
  for (int i = 0; i < 6; ++i) {
    for (const double sign : {-1.0, 1.0}) {
      Vector3d direction = seen.direction;
      Vector3d centre = ball.centre;
      if (i < 3) {
        direction = (direction + sign * step * Vector3d::Unit(i)).normalized();
      } else {
        centre[i - 3] += sign * step * ball.radiusMetres;
      }
      // At the very rim one side misses; what is left is one-sided and halved.
      const auto there =
          reflect(seen.origin, direction, centre, ball.radiusMetres).value_or(*reflection);
      jacobian.col(i).head<3>() += sign * there.point;
      jacobian.col(i).tail<3>() += sign * there.direction;
    }
    jacobian.col(i) /= 2 * step * (i < 3 ? 1.0 : ball.radiusMetres);
  }
  Eigen::Matrix<double, 6, 6> input = Eigen::Matrix<double, 6, 6>::Zero();
  input.topLeftCorner<3, 3>() = seen.directionCovariance;
  input.bottomRightCorner<3, 3>() = ball.centreCovariance;
  const Eigen::Matrix<double, 6, 6> output = jacobian * input * jacobian.transpose();
  LampRay ray;
  ray.origin = reflection->point;
  ray.direction = reflection->direction;
  ray.originCovariance = output.topLeftCorner<3, 3>();
  ray.originDirectionCovariance = output.topRightCorner<3, 3>();
  ray.directionCovariance = output.bottomRightCorner<3, 3>();
  return ray;
}

Vector3d mirrorNormal(const Vector3d& eye, const Vector3d& lamp, double radius) {
  const double a = eye.norm();
  const double b = lamp.norm();
  const Vector3d e1 = eye / a;
  Vector3d e2 = lamp - lamp.dot(e1) * e1;
  const double sine = e2.norm() / b;
  if (sine < 1e-12) return e1;
  e2.normalize();
  const double full = std::atan2(sine, lamp.dot(e1) / b);
  // Angle of incidence less angle of reflection, rising with the normal's angle from the eye.
  double low = 0;
  double high = full;
  double angle = full / 2;
  for (int i = 0; i < 60; ++i) {
    const double back = full - angle;
    const double xa = a * std::cos(angle) - radius;
    const double ya = a * std::sin(angle);
    const double xb = b * std::cos(back) - radius;
    const double yb = b * std::sin(back);
    const double f = std::atan2(ya, xa) - std::atan2(yb, xb);
    (f < 0 ? low : high) = angle;
    const double slope = (a * a - radius * a * std::cos(angle)) / (xa * xa + ya * ya) +
                         (b * b - radius * b * std::cos(back)) / (xb * xb + yb * yb);
    double next = angle - f / slope;
    if (!(next > low && next < high)) next = (low + high) / 2;
    const double moved = std::abs(next - angle);
    angle = next;
    if (moved < 1e-15) break;
  }
  return std::cos(angle) * e1 + std::sin(angle) * e2;
}

}  // namespace lightsketch
