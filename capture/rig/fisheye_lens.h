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

//   d(theta) = b sin(theta / b) + ripple theta sin(w theta), times a three-lobed squeeze
//   1 + squeeze theta^2 cos(3 phi); decentred by theta^2 (decentre.x (1 + 0.6 cos phi sin phi),
//   decentre.y (1 + 0.6 sin^2 phi)), with fx != fy.
struct FisheyeLensShape {
  double focalX, focalY, centreX, centreY;
  double bend;  // b
  double ripple, rippleFrequency;
  double squeeze;
  double decentreX, decentreY;
};
// Of the two source cameras.
inline constexpr FisheyeLensShape kFirstLens{344.6,  345.1, 483.7,   476.2,  1.62,
                                             0.0007, 5.5,   0.00005, 0.0002, -0.0003};
inline constexpr FisheyeLensShape kSecondLens{341.9,  341.3, 474.8,    482.9,    1.66,
                                              0.0006, 6.1,   -0.00006, -0.00025, 0.0002};

// Camera frame: x right, y down, z forward. 960 x 960 pixels, field 185 degrees. Immutable, so
// thread-safe.
class FisheyeLens {
 public:
  explicit FisheyeLens(const FisheyeLensShape& shape = kFirstLens) : shape_(shape) {}
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

 private:
  Eigen::Vector2d projectUnbounded(const Eigen::Vector3d& direction) const;

  FisheyeLensShape shape_;
};

struct LensFit {
  std::shared_ptr<const CameraModel> model;
  Angle maxError;  // over the field, between the true direction and the model's
};

// Least squares over the whole field (Gauss-Newton, numerical Jacobian, residuals in pixels).
Result<LensFit> fitKannalaBrandt(const FisheyeLens& lens);

}  // namespace lightsketch
