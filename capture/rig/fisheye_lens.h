// The lens that the simulated source camera really has. It belongs to no model family on purpose:
// what the pipeline gets instead is the closest Kannala-Brandt model, as from a careful
// calibration.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>

#include "calibration/model/camera_model.h"
#include "capture/frame/angle.h"
#include "capture/frame/result.h"

namespace lightsketch {

// Camera frame: x right, y down, z forward. Immutable, so thread-safe.
//   d(theta) = 1.62 sin(theta / 1.62) + ripple theta sin(5.5 theta), times a three-lobed squeeze;
//   decentred, with fx != fy. 960 x 960 pixels, field 185 degrees.
class FisheyeLens {
 public:
  static constexpr int kSize = 960;
  static constexpr Angle kMaxFieldAngle = Angle::degrees(92.5);

  // Nothing outside the field.
  std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& direction) const;
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& pixel) const;
  // The same law carried on beyond the field, for interpolating across its rim.
  Eigen::Vector3d unprojectUnbounded(const Eigen::Vector2d& pixel) const;
  // d(pixel) / d(displacement of the unit direction along `u` and `v`), 2x2.
  Eigen::Matrix2d jacobian(const Eigen::Vector3d& direction, const Eigen::Vector3d& u,
                           const Eigen::Vector3d& v) const;
};

struct LensFit {
  std::shared_ptr<const CameraModel> model;
  Angle maxError;  // over the field, between the true direction and the model's
};

// Least squares over the whole field (Gauss-Newton, numerical Jacobian, residuals in pixels).
Result<LensFit> fitKannalaBrandt(const FisheyeLens& lens);

}  // namespace lightsketch
