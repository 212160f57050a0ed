#include "calibration/model/camera_model.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <numbers>

namespace lightsketch {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr std::string_view kFormat = "lightsketch-camera";
constexpr int kFormatVersion = 1;

Vector2d addTangential(const Vector2d& n, const std::array<double, 2>& p) {
  const double r2 = n.squaredNorm();
  return {n.x() + 2 * p[0] * n.x() * n.y() + p[1] * (r2 + 2 * n.x() * n.x()),
          n.y() + p[0] * (r2 + 2 * n.y() * n.y()) + 2 * p[1] * n.x() * n.y()};
}

Matrix2d tangentialJacobian(const Vector2d& n, const std::array<double, 2>& p) {
  Matrix2d j;
  j << 1 + 2 * p[0] * n.y() + 6 * p[1] * n.x(), 2 * p[0] * n.x() + 2 * p[1] * n.y(),
      2 * p[0] * n.x() + 2 * p[1] * n.y(), 1 + 6 * p[0] * n.y() + 2 * p[1] * n.x();
  return j;
}

}  // namespace

Matrix2d CameraModel::pixelsPerRadian(const Vector3d& direction) const {
  const Vector3d axis = direction.normalized();
  const Vector3d u = axis.unitOrthogonal();
  const Vector3d v = axis.cross(u);
  constexpr double kStep = 1e-5;
  Matrix2d jacobian = Matrix2d::Zero();
  const std::array<Vector3d, 2> tangents{u, v};
  for (int i = 0; i < 2; ++i) {
    // Central difference, one-sided at the rim of the field.
    const Vector3d& tangent = tangents[static_cast<std::size_t>(i)];
    const auto here = project(axis);
    const auto ahead = project(axis + kStep * tangent);
    const auto behind = project(axis - kStep * tangent);
    if (ahead && behind)
      jacobian.col(i) = (*ahead - *behind) / (2 * kStep);
    else if (here && ahead)
      jacobian.col(i) = (*ahead - *here) / kStep;
    else if (here && behind)
      jacobian.col(i) = (*here - *behind) / kStep;
  }
  return jacobian;
}

Result<std::shared_ptr<const KannalaBrandtModel>> KannalaBrandtModel::create(
    const KannalaBrandtParameters& parameters) {
  if (parameters.width <= 0 || parameters.height <= 0 || parameters.width > 100'000 ||
      parameters.height > 100'000 || !(parameters.fx > 0) || !(parameters.fy > 0)) {
    return failure(ErrorCode::kInvalidArgument,
                   "camera model: image size and focal lengths must be positive");
  }
  if (!std::isfinite(parameters.fx * parameters.fy) ||
      !std::isfinite(parameters.cx + parameters.cy)) {
    return failure(ErrorCode::kInvalidArgument,
                   "camera model: focal lengths and principal point must be finite");
  }
  const double limit = parameters.maxFieldAngle.radians();
  if (!(limit > 0 && limit <= std::numbers::pi)) {
    return failure(ErrorCode::kInvalidArgument,
                   "camera model: the valid field must lie between 0 and 180 degrees off axis");
  }
  std::shared_ptr<const KannalaBrandtModel> model(new KannalaBrandtModel(parameters));
  for (int i = 0; i <= 1000; ++i) {
    const double theta = limit * i / 1000;
    bool invertible = model->distortDerivative(theta) > 0;
    // Around a circle the determinant is a trigonometric polynomial of degree 2: 16 azimuths find
    // where it is least.
    for (int j = 0; j < 16 && invertible; ++j) {
      const double phi = 2 * std::numbers::pi * j / 16;
      const Vector2d n = model->distort(theta) * Vector2d(std::cos(phi), std::sin(phi));
      invertible = tangentialJacobian(n, parameters.p).determinant() > 0;
    }
    if (!invertible) {
      return failure(
          ErrorCode::kInvalidArgument,
          "camera model: two angles fall on one pixel at {:.1f} degrees off axis; reduce "
          "the valid field",
          Angle::radians(theta).degrees());
    }
  }
  return model;
}

double KannalaBrandtModel::distort(double theta) const {
  const double t2 = theta * theta;
  const auto& k = parameters_.k;
  return theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
}

double KannalaBrandtModel::distortDerivative(double theta) const {
  const double t2 = theta * theta;
  const auto& k = parameters_.k;
  return 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])));
}

std::optional<Vector2d> KannalaBrandtModel::project(const Vector3d& direction) const {
  const double radius = std::hypot(direction.x(), direction.y());
  const double theta = std::atan2(radius, direction.z());
  if (!(theta <= parameters_.maxFieldAngle.radians())) return std::nullopt;
  if (radius == 0 && direction.z() < 0)
    return std::nullopt;  // straight back: every azimuth at once
  const double scale = radius > 0 ? distort(theta) / radius : 0;
  const Vector2d n = addTangential(scale * direction.head<2>(), parameters_.p);
  return Vector2d(parameters_.fx * n.x() + parameters_.cx, parameters_.fy * n.y() + parameters_.cy);
}

std::optional<Vector3d> KannalaBrandtModel::unproject(const Vector2d& pixel) const {
  const Vector2d target((pixel.x() - parameters_.cx) / parameters_.fx,
                        (pixel.y() - parameters_.cy) / parameters_.fy);
  if (!target.allFinite()) return std::nullopt;

  // Undo the tangential shift, then the radial law; both by Newton's method.
  Vector2d n = target;
  for (int i = 0; i < 20; ++i) {
    const Vector2d step = tangentialJacobian(n, parameters_.p)
                              .partialPivLu()
                              .solve(addTangential(n, parameters_.p) - target);
    n -= step;
    if (step.norm() < 1e-14) break;
  }
  if (!((addTangential(n, parameters_.p) - target).norm() < 1e-10)) return std::nullopt;
  const double limit = parameters_.maxFieldAngle.radians();
  const double d = n.norm();
  if (!(d <= distort(limit) * (1 + 1e-12))) return std::nullopt;
  double low = 0;
  double high = limit;
  double theta = std::min(d, limit);
  for (int i = 0; i < 60; ++i) {
    const double error = distort(theta) - d;
    (error > 0 ? high : low) = theta;
    double next = theta - error / distortDerivative(theta);
    if (!(next >= low && next <= high)) next = 0.5 * (low + high);
    const double change = std::abs(next - theta);
    theta = next;
    if (change < 1e-15) break;
  }
  if (d == 0) return Vector3d(0, 0, 1);
  return Vector3d(n.x() / d * std::sin(theta), n.y() / d * std::sin(theta), std::cos(theta));
}

Json KannalaBrandtModel::parameters() const {
  const auto& p = parameters_;
  return {{"width", p.width},
          {"height", p.height},
          {"fx", p.fx},
          {"fy", p.fy},
          {"cx", p.cx},
          {"cy", p.cy},
          {"k", p.k},
          {"p", p.p},
          {"maxFieldAngleDegrees", p.maxFieldAngle.degrees()}};
}

Json cameraModelToJson(const CameraModel& model) {
  return {{"format", kFormat},
          {"formatVersion", kFormatVersion},
          {"model", model.modelName()},
          {"parameters", model.parameters()}};
}

Result<std::shared_ptr<const CameraModel>> cameraModelFromJson(const Json& json,
                                                               std::string_view where) {
  RETURN_IF_ERROR(checkFormat(json, kFormat, kFormatVersion, where));
  ASSIGN_OR_RETURN(const auto name, jsonString(json, "model", where));
  if (name != "kannala-brandt") {
    return failure(ErrorCode::kUnsupported, "{}: unknown lens model '{}'; known: kannala-brandt",
                   where, name);
  }
  ASSIGN_OR_RETURN(const Json* found, jsonMember(json, "parameters", where));
  const Json& values = *found;
  KannalaBrandtParameters p;
  ASSIGN_OR_RETURN(const auto width, jsonInteger(values, "width", where, 1, 100'000));
  ASSIGN_OR_RETURN(const auto height, jsonInteger(values, "height", where, 1, 100'000));
  p.width = static_cast<int>(width);
  p.height = static_cast<int>(height);
  ASSIGN_OR_RETURN(p.fx, jsonNumber(values, "fx", where));
  ASSIGN_OR_RETURN(p.fy, jsonNumber(values, "fy", where));
  ASSIGN_OR_RETURN(p.cx, jsonNumber(values, "cx", where));
  ASSIGN_OR_RETURN(p.cy, jsonNumber(values, "cy", where));
  ASSIGN_OR_RETURN(const auto k, jsonVector(values, "k", 4, where));
  ASSIGN_OR_RETURN(const auto tangential, jsonVector(values, "p", 2, where));
  ASSIGN_OR_RETURN(const auto field, jsonNumber(values, "maxFieldAngleDegrees", where));
  for (int i = 0; i < 4; ++i) p.k[static_cast<std::size_t>(i)] = k[i];
  for (int i = 0; i < 2; ++i) p.p[static_cast<std::size_t>(i)] = tangential[i];
  p.maxFieldAngle = Angle::degrees(field);
  auto model = KannalaBrandtModel::create(p);
  if (!model) return failure(model.error().code, "{}: {}", where, model.error().message);
  return std::shared_ptr<const CameraModel>(std::move(*model));
}

Result<std::shared_ptr<const CameraModel>> loadCameraModel(const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const auto json, readJsonFile(path));
  return cameraModelFromJson(json, path.string());
}

Result<void> saveCameraModel(const CameraModel& model, const std::filesystem::path& path) {
  return writeJsonFile(path, cameraModelToJson(model));
}

}  // namespace lightsketch
