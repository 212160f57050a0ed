// A camera's lens as a value: which direction falls on which pixel.
// Camera frame: x right, y down, z forward. Pixels: centre of the top-left pixel at (0.5, 0.5).
#pragma once

#include <Eigen/Core>
#include <array>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "capture/frame/angle.h"
#include "capture/frame/json.h"
#include "capture/frame/result.h"

namespace lightsketch {

// Immutable, so thread-safe.
class CameraModel {
 public:
  virtual ~CameraModel() = default;

  virtual int width() const = 0;
  virtual int height() const = 0;
  // Largest angle from the optical axis (+z) for which the model is valid; may exceed 90 degrees.
  virtual Angle maxFieldAngle() const = 0;

  // Direction (any length but 0, camera frame) to pixel. Nothing outside the valid field. The pixel
  // may lie outside the image.
  virtual std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& direction) const = 0;
  // Pixel to unit direction; inverse of project() to 1e-9. Nothing outside the valid field.
  virtual std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& pixel) const = 0;
  // As project(), for a point in metres: lenses whose pupil moves see near points shifted.
  virtual std::optional<Eigen::Vector2d> projectPoint(const Eigen::Vector3d& point) const {
    return project(point);
  }
  // A point of the ray that unproject() gives the direction of, metres, camera frame.
  virtual Eigen::Vector3d rayOrigin(const Eigen::Vector3d& /*direction*/) const {
    return Eigen::Vector3d::Zero();
  }
  // False where the calibration never saw a board: further out than the outermost corner of that
  // azimuth, less one degree. True for models that do not say.
  virtual bool covers(const Eigen::Vector3d& /*direction*/) const { return true; }
  // One-sigma covariance of the unit direction that a pixel stands for, from the calibration alone
  // (rank 2, radians^2, camera frame), after the best common rotation: what is left when the pose
  // is estimated with the same model. Zero for models that do not say.
  virtual Eigen::Matrix3d directionCovariance(const Eigen::Vector3d& /*direction*/) const {
    return Eigen::Matrix3d::Zero();
  }

  // d(pixel)/d(tangent-plane displacement of the unit direction), 2x2, in pixels per radian, along
  // two orthonormal axes normal to the direction. Numerical; its singular values tell how many
  // pixels a radian takes there.
  Eigen::Matrix2d pixelsPerRadian(const Eigen::Vector3d& direction) const;

  // Content of the camera file without its identity.
  virtual Json parameters() const = 0;
  virtual std::string modelName() const = 0;
};

// A fisheye. With theta the angle to +z,
//   d = theta (1 + k0 theta^2 + k1 theta^4 + .. + k5 theta^12)
//   (x, y) = d (cos phi, sin phi), r2 = d^2
//   x' = x + 2 p0 x y + p1 (r2 + 2 x^2) + s0 r2 + s1 r2^2
//   y' = y + p0 (r2 + 2 y^2) + 2 p1 x y + s2 r2 + s3 r2^2
//   pixel = (fx x' + cx, fy y' + cy)
// With k4, k5 and s all 0 it is Kannala and Brandt 2006 with Brown's tangential terms; with them
// "Fisheye624" (six radial, two tangential, four thin-prism terms). The entrance pupil may move
// along the axis: a ray of angle theta passes through (0, 0, a theta^2 + b theta^4).
struct FisheyeParameters {
  int width = 0;
  int height = 0;
  double fx = 0;
  double fy = 0;
  double cx = 0;
  double cy = 0;
  std::array<double, 6> k{};
  std::array<double, 2> p{};
  std::array<double, 4> s{};
  std::array<double, 2> pupilMetres{};  // a, b
  Angle maxFieldAngle = Angle::degrees(90);

  // In the order of FisheyeLayout (fisheye_projection.h).
  Eigen::VectorXd vector() const;
  void setVector(const Eigen::VectorXd& values);
};

// What a calibration knows about its own result.
struct LensUncertainty {
  // Of FisheyeParameters::vector(), 18 x 18, poses and board marginalised out; zero rows where a
  // parameter was held. Empty: unknown.
  Eigen::MatrixXd covariance;
  // One sigma of what the lens does beyond its model, any direction; added to the covariance's.
  Angle modelError;
  // Outermost observed corner less one degree, per sector of azimuth: sector i of n is
  // [i, i + 1) 360/n degrees of atan2(y, x). Empty: unknown.
  std::vector<Angle> coveredField;
};

class FisheyeModel final : public CameraModel {
 public:
  // Fails with kInvalidArgument where two directions of the field share a pixel.
  static Result<std::shared_ptr<const FisheyeModel>> create(
      const FisheyeParameters& parameters, const LensUncertainty& uncertainty = {});

  int width() const override { return parameters_.width; }
  int height() const override { return parameters_.height; }
  Angle maxFieldAngle() const override { return parameters_.maxFieldAngle; }
  std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& direction) const override;
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& pixel) const override;
  std::optional<Eigen::Vector2d> projectPoint(const Eigen::Vector3d& point) const override;
  Eigen::Vector3d rayOrigin(const Eigen::Vector3d& direction) const override;
  bool covers(const Eigen::Vector3d& direction) const override;
  Eigen::Matrix3d directionCovariance(const Eigen::Vector3d& direction) const override;
  Json parameters() const override;
  std::string modelName() const override;  // "kannala-brandt" or "fisheye624"

  const FisheyeParameters& values() const { return parameters_; }
  const LensUncertainty& uncertainty() const { return uncertainty_; }

 private:
  FisheyeModel(const FisheyeParameters& parameters, const LensUncertainty& uncertainty);
  // d(direction) / d(parameters) at a fixed pixel, in an orthonormal basis of the tangent plane;
  // 2 x 18. Nothing outside the field.
  std::optional<Eigen::Matrix<double, 2, Eigen::Dynamic>> sensitivity(
      const Eigen::Vector3d& direction, const Eigen::Vector3d& u, const Eigen::Vector3d& v) const;

  FisheyeParameters parameters_;
  LensUncertainty uncertainty_;
  Eigen::VectorXd vector_;
  Eigen::Matrix<double, 3, Eigen::Dynamic> rotationOf_;  // best common rotation per parameter
};

// Our camera file: JSON, "format": "lightsketch-camera", "formatVersion": 2 (1 had no uncertainty,
// pupil or fisheye624), "model": "kannala-brandt" or "fisheye624". Fails with file, field and
// reason.
Result<std::shared_ptr<const CameraModel>> loadCameraModel(const std::filesystem::path& path);
Result<std::shared_ptr<const CameraModel>> cameraModelFromJson(const Json& json,
                                                               std::string_view where);
Json cameraModelToJson(const CameraModel& model);
Result<void> saveCameraModel(const CameraModel& model, const std::filesystem::path& path);

}  // namespace lightsketch
