// Where a frame's light comes from.
#pragma once

#include <Eigen/Core>
#include <optional>

namespace lightsketch {

struct LightDirection {
  // Unit vector from the subject to the lamp, scene frame.
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();
  // One-sigma covariance of `direction` on the unit sphere (rank 2, radians^2), scene frame. Zero
  // where unknown.
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  // The lamp itself in metres, scene frame, where it is known (then the light is a point light).
  std::optional<Eigen::Vector3d> position;
};

}  // namespace lightsketch
