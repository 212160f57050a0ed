#include "capture/rig/fisheye_lens.h"
#include "capture/frame/direction.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

namespace lightsketch {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector3d;

Vector3d directionAt(double theta, double azimuth) {
  return {std::sin(theta) * std::cos(azimuth), std::sin(theta) * std::sin(azimuth),
          std::cos(theta)};
}

using Unknowns = Eigen::Matrix<double, 10, 1>;

FisheyeParameters parametersOf(const Unknowns& u) {
  FisheyeParameters p;
  p.width = p.height = FisheyeLens::kSize;
  p.fx = u[0];
  p.fy = u[1];
  p.cx = u[2];
  p.cy = u[3];
  for (int i = 0; i < 4; ++i) p.k[static_cast<std::size_t>(i)] = u[4 + i];
  p.p = {u[8], u[9]};
  p.maxFieldAngle = FisheyeLens::kMaxFieldAngle;
  return p;
}

}  // namespace

Vector2d FisheyeLens::projectUnbounded(const Vector3d& direction) const {
  const FisheyeLensShape& l = shape_;
  const double radius = std::hypot(direction.x(), direction.y());
  const double theta = std::atan2(radius, direction.z());
  const double c = radius > 1e-14 ? direction.x() / radius : 1;
  const double s = radius > 1e-14 ? direction.y() / radius : 0;
  const double cos3 = c * (4 * c * c - 3);  // cosine of three times the azimuth
  const double d =
      (l.bend * std::sin(theta / l.bend) + l.ripple * theta * std::sin(l.rippleFrequency * theta)) *
      (1 + l.squeeze * theta * theta * cos3);
  // Decentring that grows with the angle itself, unlike Brown's, which grows with d squared.
  const double x = d * c + l.decentreX * theta * theta * (1 + 0.6 * c * s);
  const double y = d * s + l.decentreY * theta * theta * (1 + 0.6 * s * s);
  return {l.focalX * x + l.centreX, l.focalY * y + l.centreY};
}

std::optional<Vector2d> FisheyeLens::project(const Vector3d& direction) const {
  const double theta = std::atan2(std::hypot(direction.x(), direction.y()), direction.z());
  if (!(theta <= kMaxFieldAngle.radians())) return std::nullopt;
  return projectUnbounded(direction);
}

Vector3d FisheyeLens::unprojectUnbounded(const Vector2d& pixel) const {
  const Vector2d n((pixel.x() - shape_.centreX) / shape_.focalX,
                   (pixel.y() - shape_.centreY) / shape_.focalY);
  Vector3d direction = directionAt(std::min(n.norm() * 1.1, 1.7), std::atan2(n.y(), n.x()));
  // Newton's method on the tangent plane of the current direction.
  for (int i = 0; i < 30; ++i) {
    const Vector3d u = direction.unitOrthogonal();
    const Vector3d v = direction.cross(u);
    const Vector2d error = pixel - projectUnbounded(direction);
    if (error.norm() < 1e-10) break;
    Vector2d step = jacobian(direction, u, v).inverse() * error;
    if (step.norm() > 0.2) step *= 0.2 / step.norm();
    direction = (direction + step.x() * u + step.y() * v).normalized();
  }
  return direction;
}

std::optional<Vector3d> FisheyeLens::unproject(const Vector2d& pixel) const {
  const Vector3d direction = unprojectUnbounded(pixel);
  if (angleBetween(direction, Vector3d::UnitZ()) > kMaxFieldAngle) return std::nullopt;
  return direction;
}

Matrix2d FisheyeLens::jacobian(const Vector3d& direction, const Vector3d& u,
                               const Vector3d& v) const {
  constexpr double kStep = 1e-6;
  Matrix2d j;
  j.col(0) = (projectUnbounded(direction + kStep * u) - projectUnbounded(direction - kStep * u)) /
             (2 * kStep);
  j.col(1) = (projectUnbounded(direction + kStep * v) - projectUnbounded(direction - kStep * v)) /
             (2 * kStep);
  return j;
}

Result<LensFit> fitKannalaBrandt(const FisheyeLens& lens) {
  // Directions all over the field, where a calibration would have had its board corners.
  std::vector<Vector3d> directions;
  std::vector<Vector2d> pixels;
  for (int ring = 0; ring < 60; ++ring) {
    const double theta = FisheyeLens::kMaxFieldAngle.radians() * (ring + 0.5) / 60;
    for (int spoke = 0; spoke < 72; ++spoke) {
      directions.push_back(directionAt(theta, 2 * std::numbers::pi * spoke / 72));
      pixels.push_back(*lens.project(directions.back()));
    }
  }
  const auto residuals = [&](const Unknowns& u) -> Result<Eigen::VectorXd> {
    ASSIGN_OR_RETURN(const auto model, FisheyeModel::create(parametersOf(u)));
    Eigen::VectorXd r(2 * static_cast<Eigen::Index>(directions.size()));
    for (std::size_t i = 0; i < directions.size(); ++i) {
      r.segment<2>(2 * static_cast<Eigen::Index>(i)) = *model->project(directions[i]) - pixels[i];
    }
    return r;
  };

  Unknowns u;
  u << 340, 340, FisheyeLens::kSize / 2, FisheyeLens::kSize / 2, -0.06, 0, 0, 0, 0, 0;
  for (int iteration = 0; iteration < 15; ++iteration) {
    ASSIGN_OR_RETURN(const auto r, residuals(u));
    Eigen::MatrixXd j(r.size(), 10);
    for (int i = 0; i < 10; ++i) {
      Unknowns moved = u;
      const double step = i < 4 ? 1e-4 : 1e-7;
      moved[i] += step;
      ASSIGN_OR_RETURN(const auto shifted, residuals(moved));
      j.col(i) = (shifted - r) / step;
    }
    const Unknowns delta = (j.transpose() * j).ldlt().solve(j.transpose() * r);
    u -= delta;
    if (delta.norm() < 1e-9) break;
  }

  LensFit fit;
  ASSIGN_OR_RETURN(fit.model, FisheyeModel::create(parametersOf(u)));
  double worst = 0;
  for (std::size_t i = 0; i < directions.size(); ++i) {
    // The rim's pixels may lie a hair outside the model's field; there is nothing to compare there.
    const auto seen = fit.model->unproject(pixels[i]);
    if (seen) worst = std::max(worst, angleBetween(*seen, directions[i]).radians());
  }
  fit.maxError = Angle::radians(worst);
  return fit;
}

}  // namespace lightsketch
