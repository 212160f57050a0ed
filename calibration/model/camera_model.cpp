#include "calibration/model/camera_model.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cmath>
#include <numbers>

#include "calibration/model/fisheye_projection.h"

namespace lightsketch {
namespace {

using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr std::string_view kFormat = "lightsketch-camera";
constexpr int kFormatVersion = 2;

// The part of the lens equation after the radial law, on (x, y) = d (cos phi, sin phi).
Vector2d addDecentring(const Vector2d& n, const FisheyeParameters& f) {
  const double r2 = n.squaredNorm();
  return {n.x() + 2 * f.p[0] * n.x() * n.y() + f.p[1] * (r2 + 2 * n.x() * n.x()) +
              r2 * (f.s[0] + r2 * f.s[1]),
          n.y() + f.p[0] * (r2 + 2 * n.y() * n.y()) + 2 * f.p[1] * n.x() * n.y() +
              r2 * (f.s[2] + r2 * f.s[3])};
}

Matrix2d decentringJacobian(const Vector2d& n, const FisheyeParameters& f) {
  const double r2 = n.squaredNorm();
  Matrix2d j;
  j << 1 + 2 * f.p[0] * n.y() + 6 * f.p[1] * n.x(), 2 * f.p[0] * n.x() + 2 * f.p[1] * n.y(),
      2 * f.p[0] * n.x() + 2 * f.p[1] * n.y(), 1 + 6 * f.p[0] * n.y() + 2 * f.p[1] * n.x();
  j.row(0) += 2 * (f.s[0] + 2 * r2 * f.s[1]) * n.transpose();
  j.row(1) += 2 * (f.s[2] + 2 * r2 * f.s[3]) * n.transpose();
  return j;
}

double distort(double theta, const FisheyeParameters& f) {
  const double t2 = theta * theta;
  double sum = 0;
  for (std::size_t i = f.k.size(); i-- > 0;) sum = t2 * (f.k[i] + sum);
  return theta * (1 + sum);
}

double distortDerivative(double theta, const FisheyeParameters& f) {
  const double t2 = theta * theta;
  double sum = 0;
  for (std::size_t i = f.k.size(); i-- > 0;) {
    sum = t2 * ((2.0 * static_cast<double>(i) + 3) * f.k[i] + sum);
  }
  return 1 + sum;
}

double fieldAngleOf(const Vector3d& direction) {
  return std::atan2(std::hypot(direction.x(), direction.y()), direction.z());
}

}  // namespace

VectorXd FisheyeParameters::vector() const {
  VectorXd v(FisheyeLayout::kCount);
  v << fx, fy, cx, cy, k[0], k[1], k[2], k[3], k[4], k[5], p[0], p[1], s[0], s[1], s[2], s[3],
      pupilMetres[0], pupilMetres[1];
  return v;
}

void FisheyeParameters::setVector(const VectorXd& v) {
  fx = v[0];
  fy = v[1];
  cx = v[2];
  cy = v[3];
  for (int i = 0; i < 6; ++i) k[static_cast<std::size_t>(i)] = v[FisheyeLayout::kRadial + i];
  for (int i = 0; i < 2; ++i) p[static_cast<std::size_t>(i)] = v[FisheyeLayout::kTangential + i];
  for (int i = 0; i < 4; ++i) s[static_cast<std::size_t>(i)] = v[FisheyeLayout::kPrism + i];
  for (int i = 0; i < 2; ++i) {
    pupilMetres[static_cast<std::size_t>(i)] = v[FisheyeLayout::kPupil + i];
  }
}

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

FisheyeModel::FisheyeModel(const FisheyeParameters& parameters, const LensUncertainty& uncertainty)
    : parameters_(parameters), uncertainty_(uncertainty), vector_(parameters.vector()) {}

Result<std::shared_ptr<const FisheyeModel>> FisheyeModel::create(
    const FisheyeParameters& parameters, const LensUncertainty& uncertainty) {
  if (parameters.width <= 0 || parameters.height <= 0 || parameters.width > 100'000 ||
      parameters.height > 100'000 || !(parameters.fx > 0) || !(parameters.fy > 0)) {
    return failure(ErrorCode::kInvalidArgument,
                   "camera model: image size and focal lengths must be positive");
  }
  if (!parameters.vector().allFinite()) {
    return failure(ErrorCode::kInvalidArgument, "camera model: every parameter must be finite");
  }
  const double limit = parameters.maxFieldAngle.radians();
  if (!(limit > 0 && limit <= std::numbers::pi)) {
    return failure(ErrorCode::kInvalidArgument,
                   "camera model: the valid field must lie between 0 and 180 degrees off axis");
  }
  const auto& covariance = uncertainty.covariance;
  if (covariance.size() != 0 &&
      (covariance.rows() != FisheyeLayout::kCount || covariance.cols() != FisheyeLayout::kCount ||
       !covariance.allFinite() || !(covariance.diagonal().minCoeff() >= 0))) {
    return failure(ErrorCode::kInvalidArgument,
                   "camera model: the covariance must be {0} x {0} with no negative variance",
                   FisheyeLayout::kCount);
  }
  for (int i = 0; i <= 1000; ++i) {
    const double theta = limit * i / 1000;
    bool invertible = distortDerivative(theta, parameters) > 0;
    // Around a circle the determinant is a trigonometric polynomial of low degree: 32 azimuths find
    // where it is least.
    for (int j = 0; j < 32 && invertible; ++j) {
      const double phi = 2 * std::numbers::pi * j / 32;
      const Vector2d n = distort(theta, parameters) * Vector2d(std::cos(phi), std::sin(phi));
      invertible = decentringJacobian(n, parameters).determinant() > 0;
    }
    if (!invertible) {
      return failure(
          ErrorCode::kInvalidArgument,
          "camera model: two angles fall on one pixel at {:.1f} degrees off axis; reduce "
          "the valid field",
          Angle::radians(theta).degrees());
    }
  }
  std::shared_ptr<FisheyeModel> model(new FisheyeModel(parameters, uncertainty));
  if (covariance.size() != 0) {
    // The rotation that best explains what a parameter does to all directions of the field: a
    // linear least-squares fit of omega x v to the sensitivities, equal weight per solid angle.
    Matrix3d normal = Matrix3d::Zero();
    Eigen::Matrix<double, 3, Eigen::Dynamic> right(3, FisheyeLayout::kCount);
    right.setZero();
    constexpr int kSamples = 400;
    for (int i = 0; i < kSamples; ++i) {
      // Fibonacci spiral over the cap (Gonzalez 2010).
      const double z = 1 - (1 - std::cos(limit)) * (i + 0.5) / kSamples;
      const double phi = i * std::numbers::pi * (3 - std::sqrt(5.0));
      const double r = std::sqrt(1 - z * z);
      const Vector3d direction(r * std::cos(phi), r * std::sin(phi), z);
      if (!model->covers(direction)) continue;
      const Vector3d u = direction.unitOrthogonal();
      const Vector3d v = direction.cross(u);
      const auto s = model->sensitivity(direction, u, v);
      if (!s) continue;
      Eigen::Matrix<double, 2, 3> turn;  // omega x direction, along u and v
      turn.row(0) = direction.cross(u).transpose();
      turn.row(1) = direction.cross(v).transpose();
      normal += turn.transpose() * turn;
      right += turn.transpose() * *s;
    }
    model->rotationOf_ = normal.ldlt().solve(right);
    if (!model->rotationOf_.allFinite()) {
      return failure(ErrorCode::kInvalidArgument,
                     "camera model: the covered field is too small for a covariance");
    }
  }
  return std::shared_ptr<const FisheyeModel>(std::move(model));
}

std::optional<Vector2d> FisheyeModel::project(const Vector3d& direction) const {
  if (!(fieldAngleOf(direction) <= parameters_.maxFieldAngle.radians())) return std::nullopt;
  if (direction.x() == 0 && direction.y() == 0 && !(direction.z() > 0)) {
    return std::nullopt;  // straight back: every azimuth at once
  }
  Vector2d pixel;
  projectFisheyeDirection(vector_.data(), direction.data(), pixel.data());
  return pixel;
}

std::optional<Vector2d> FisheyeModel::projectPoint(const Vector3d& point) const {
  if (!project(point)) return std::nullopt;
  Vector2d pixel;
  projectFisheyePoint(vector_.data(), point.data(), pixel.data());
  return pixel;
}

Vector3d FisheyeModel::rayOrigin(const Vector3d& direction) const {
  const double t2 = std::pow(fieldAngleOf(direction), 2);
  return {0, 0, t2 * (parameters_.pupilMetres[0] + t2 * parameters_.pupilMetres[1])};
}

std::optional<Vector3d> FisheyeModel::unproject(const Vector2d& pixel) const {
  const Vector2d target((pixel.x() - parameters_.cx) / parameters_.fx,
                        (pixel.y() - parameters_.cy) / parameters_.fy);
  if (!target.allFinite()) return std::nullopt;

  // Undo the decentring, then the radial law; both by Newton's method.
  Vector2d n = target;
  for (int i = 0; i < 20; ++i) {
    const Vector2d step = decentringJacobian(n, parameters_)
                              .partialPivLu()
                              .solve(addDecentring(n, parameters_) - target);
    n -= step;
    if (step.norm() < 1e-14) break;
  }
  if (!((addDecentring(n, parameters_) - target).norm() < 1e-10)) return std::nullopt;
  const double limit = parameters_.maxFieldAngle.radians();
  const double d = n.norm();
  if (!(d <= distort(limit, parameters_) * (1 + 1e-12))) return std::nullopt;
  double low = 0;
  double high = limit;
  double theta = std::min(d, limit);
  for (int i = 0; i < 60; ++i) {
    const double error = distort(theta, parameters_) - d;
    (error > 0 ? high : low) = theta;
    double next = theta - error / distortDerivative(theta, parameters_);
    if (!(next >= low && next <= high)) next = 0.5 * (low + high);
    const double change = std::abs(next - theta);
    theta = next;
    if (change < 1e-15) break;
  }
  if (d == 0) return Vector3d(0, 0, 1);
  return Vector3d(n.x() / d * std::sin(theta), n.y() / d * std::sin(theta), std::cos(theta));
}

bool FisheyeModel::covers(const Vector3d& direction) const {
  const auto& field = uncertainty_.coveredField;
  if (field.empty()) return true;
  const double turn = std::atan2(direction.y(), direction.x()) / (2 * std::numbers::pi);
  const auto count = static_cast<double>(field.size());
  const auto sector = static_cast<std::size_t>((turn - std::floor(turn)) * count);
  return fieldAngleOf(direction) <= field[std::min(sector, field.size() - 1)].radians();
}

std::optional<Eigen::Matrix<double, 2, Eigen::Dynamic>> FisheyeModel::sensitivity(
    const Vector3d& direction, const Vector3d& u, const Vector3d& v) const {
  constexpr double kStep = 1e-6;
  const auto at = [&](const VectorXd& values, const Vector3d& towards) {
    Vector2d pixel;
    projectFisheyeDirection(values.data(), towards.data(), pixel.data());
    return pixel;
  };
  Matrix2d byDirection;
  byDirection.col(0) =
      (at(vector_, direction + kStep * u) - at(vector_, direction - kStep * u)) / (2 * kStep);
  byDirection.col(1) =
      (at(vector_, direction + kStep * v) - at(vector_, direction - kStep * v)) / (2 * kStep);
  const auto lu = byDirection.fullPivLu();
  if (!lu.isInvertible() || !byDirection.allFinite()) return std::nullopt;
  Eigen::Matrix<double, 2, Eigen::Dynamic> byParameter(2, FisheyeLayout::kCount);
  VectorXd moved = vector_;
  for (int i = 0; i < FisheyeLayout::kCount; ++i) {
    // The equation is linear in all but the pupil, which far directions do not feel.
    const double step = i < FisheyeLayout::kRadial ? 1e-3 : 1e-6;
    moved[i] = vector_[i] + step;
    const Vector2d ahead = at(moved, direction);
    moved[i] = vector_[i] - step;
    byParameter.col(i) = (ahead - at(moved, direction)) / (2 * step);
    moved[i] = vector_[i];
  }
  return -lu.solve(byParameter);
}

Matrix3d FisheyeModel::directionCovariance(const Vector3d& direction) const {
  const double modelError = uncertainty_.modelError.radians();
  if (uncertainty_.covariance.size() == 0 && modelError == 0) return Matrix3d::Zero();
  const Vector3d axis = direction.normalized();
  Eigen::Matrix<double, 3, 2> tangent;
  tangent.col(0) = axis.unitOrthogonal();
  tangent.col(1) = axis.cross(tangent.col(0));
  Matrix2d inPlane = modelError * modelError * Matrix2d::Identity();
  if (uncertainty_.covariance.size() != 0) {
    auto s = sensitivity(axis, tangent.col(0), tangent.col(1));
    if (!s) return Matrix3d::Zero();
    // Minus what the best rotation takes away.
    s->row(0) -= axis.cross(tangent.col(0)).transpose() * rotationOf_;
    s->row(1) -= axis.cross(tangent.col(1)).transpose() * rotationOf_;
    inPlane += *s * uncertainty_.covariance * s->transpose();
  }
  return tangent * inPlane * tangent.transpose();
}

std::string FisheyeModel::modelName() const {
  const auto& f = parameters_;
  const bool plain = f.k[4] == 0 && f.k[5] == 0 && f.s == std::array<double, 4>{};
  return plain ? "kannala-brandt" : "fisheye624";
}

Json FisheyeModel::parameters() const {
  const auto& f = parameters_;
  Json json = {{"width", f.width}, {"height", f.height},
               {"fx", f.fx},       {"fy", f.fy},
               {"cx", f.cx},       {"cy", f.cy},
               {"p", f.p},         {"maxFieldAngleDegrees", f.maxFieldAngle.degrees()}};
  if (modelName() == "kannala-brandt") {
    json["k"] = {f.k[0], f.k[1], f.k[2], f.k[3]};
  } else {
    json["k"] = f.k;
    json["s"] = f.s;
  }
  if (f.pupilMetres != std::array<double, 2>{}) json["pupilMetres"] = f.pupilMetres;
  if (uncertainty_.covariance.size() != 0) {
    json["covariance"] = lightsketch::toJson(VectorXd(uncertainty_.covariance.reshaped()));
  }
  if (uncertainty_.modelError.radians() != 0) {
    json["modelErrorDegrees"] = uncertainty_.modelError.degrees();
  }
  if (!uncertainty_.coveredField.empty()) {
    json["coveredFieldDegrees"] = Json::array();
    for (const Angle angle : uncertainty_.coveredField) {
      json["coveredFieldDegrees"].push_back(angle.degrees());
    }
  }
  return json;
}

namespace {

// An array of exactly `count` numbers.
Result<void> readArray(const Json& values, std::string_view field, std::string_view where,
                       double* out, int count) {
  ASSIGN_OR_RETURN(const auto numbers, jsonVector(values, field, count, where));
  std::copy(numbers.begin(), numbers.end(), out);
  return {};
}

}  // namespace

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
  if (name != "kannala-brandt" && name != "fisheye624") {
    return failure(ErrorCode::kUnsupported,
                   "{}: unknown lens model '{}'; known: kannala-brandt, fisheye624", where, name);
  }
  ASSIGN_OR_RETURN(const Json* found, jsonMember(json, "parameters", where));
  const Json& values = *found;
  FisheyeParameters f;
  ASSIGN_OR_RETURN(const auto width, jsonInteger(values, "width", where, 1, 100'000));
  ASSIGN_OR_RETURN(const auto height, jsonInteger(values, "height", where, 1, 100'000));
  f.width = static_cast<int>(width);
  f.height = static_cast<int>(height);
  ASSIGN_OR_RETURN(f.fx, jsonNumber(values, "fx", where));
  ASSIGN_OR_RETURN(f.fy, jsonNumber(values, "fy", where));
  ASSIGN_OR_RETURN(f.cx, jsonNumber(values, "cx", where));
  ASSIGN_OR_RETURN(f.cy, jsonNumber(values, "cy", where));
  RETURN_IF_ERROR(readArray(values, "p", where, f.p.data(), 2));
  if (name == "kannala-brandt") {
    RETURN_IF_ERROR(readArray(values, "k", where, f.k.data(), 4));
  } else {
    RETURN_IF_ERROR(readArray(values, "k", where, f.k.data(), 6));
    RETURN_IF_ERROR(readArray(values, "s", where, f.s.data(), 4));
  }
  if (values.contains("pupilMetres")) {
    RETURN_IF_ERROR(readArray(values, "pupilMetres", where, f.pupilMetres.data(), 2));
  }
  ASSIGN_OR_RETURN(const auto field, jsonNumber(values, "maxFieldAngleDegrees", where));
  f.maxFieldAngle = Angle::degrees(field);

  LensUncertainty uncertainty;
  if (values.contains("covariance")) {
    constexpr int n = FisheyeLayout::kCount;
    ASSIGN_OR_RETURN(const auto covariance, jsonVector(values, "covariance", n * n, where));
    uncertainty.covariance = covariance.reshaped(n, n);
  }
  if (values.contains("modelErrorDegrees")) {
    ASSIGN_OR_RETURN(const auto degrees, jsonNumber(values, "modelErrorDegrees", where));
    uncertainty.modelError = Angle::degrees(degrees);
  }
  if (values.contains("coveredFieldDegrees")) {
    const Json& sectors = values["coveredFieldDegrees"];
    const int count = sectors.is_array() && sectors.size() <= 3600
                          ? static_cast<int>(sectors.size())
                          : 36;  // jsonVector says what is wrong
    ASSIGN_OR_RETURN(const auto covered, jsonVector(values, "coveredFieldDegrees", count, where));
    for (const double degrees : covered) {
      uncertainty.coveredField.push_back(Angle::degrees(degrees));
    }
  }
  auto model = FisheyeModel::create(f, uncertainty);
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
