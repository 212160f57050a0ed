// A camera's lens as a value: which direction falls on which pixel.
// Camera frame: x right, y down, z forward. Pixels: centre of the top-left pixel at (0.5, 0.5).
#pragma once

#include <Eigen/Core>
#include <array>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>

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
  // d(pixel)/d(tangent-plane displacement of the unit direction), 2x2, in pixels per radian, along
  // two orthonormal axes normal to the direction. Numerical; its singular values tell how many
  // pixels a radian takes there.
  Eigen::Matrix2d pixelsPerRadian(const Eigen::Vector3d& direction) const;

  // Content of the camera file without its identity.
  virtual Json parameters() const = 0;
  virtual std::string modelName() const = 0;
};

// Kannala and Brandt 2006 with tangential terms (Brown): with theta the angle to +z,
//   d = theta (1 + k0 theta^2 + k1 theta^4 + k2 theta^6 + k3 theta^8)
//   (x, y) = d (cos phi, sin phi), r2 = d^2
//   x' = x + 2 p0 x y + p1 (r2 + 2 x^2),  y' = y + p0 (r2 + 2 y^2) + 2 p1 x y
//   pixel = (fx x' + cx, fy y' + cy)
struct KannalaBrandtParameters {
  int width = 0;
  int height = 0;
  double fx = 0;
  double fy = 0;
  double cx = 0;
  double cy = 0;
  std::array<double, 4> k{};
  std::array<double, 2> p{};
  Angle maxFieldAngle = Angle::degrees(90);
};

class KannalaBrandtModel final : public CameraModel {
 public:
  // Fails with kInvalidArgument where d(theta) is not increasing over the field.
  static Result<std::shared_ptr<const KannalaBrandtModel>> create(
      const KannalaBrandtParameters& parameters);

  int width() const override { return parameters_.width; }
  int height() const override { return parameters_.height; }
  Angle maxFieldAngle() const override { return parameters_.maxFieldAngle; }
  std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& direction) const override;
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& pixel) const override;
  Json parameters() const override;
  std::string modelName() const override { return "kannala-brandt"; }

 private:
  explicit KannalaBrandtModel(const KannalaBrandtParameters& parameters)
      : parameters_(parameters) {}
  double distort(double theta) const;
  double distortDerivative(double theta) const;
  KannalaBrandtParameters parameters_;
};

// Our camera file: JSON, "format": "lightsketch-camera", "formatVersion": 1, "model":
// "kannala-brandt". Fails with file, field and reason.
Result<std::shared_ptr<const CameraModel>> loadCameraModel(const std::filesystem::path& path);
Result<std::shared_ptr<const CameraModel>> cameraModelFromJson(const Json& json,
                                                               std::string_view where);
Json cameraModelToJson(const CameraModel& model);
Result<void> saveCameraModel(const CameraModel& model, const std::filesystem::path& path);

}  // namespace lightsketch
