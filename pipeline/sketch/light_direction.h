// Where a frame's light comes from.
#pragma once

#include <Eigen/Core>
#include <optional>

#include "calibration/model/lamp_position.h"

namespace lightsketch {

struct LightDirection {
  // Unit vector from the subject to the lamp, scene frame.
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();
  // One-sigma covariance of `direction` on the unit sphere (rank 2, radians^2), scene frame. Zero
  // where unknown.
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  // The lamp itself in metres, scene frame, where it is known (then the light is a point light).
  std::optional<Eigen::Vector3d> position;
  // One-sigma covariance of `position`, metres^2. Zero where unknown.
  Eigen::Matrix3d positionCovariance = Eigen::Matrix3d::Zero();
};

// The light at the subject, the scene frame's origin, of a lamp whose place is known.
inline LightDirection lightDirectionOf(const LampPosition& lamp) {
  const double distance = lamp.position.norm();
  LightDirection light;
  light.direction = lamp.position / distance;
  const Eigen::Matrix3d perMetre =
      (Eigen::Matrix3d::Identity() - light.direction * light.direction.transpose()) / distance;
  light.covariance = perMetre * lamp.covariance * perMetre.transpose();
  light.position = lamp.position;
  light.positionCovariance = lamp.covariance;
  return light;
}

}  // namespace lightsketch
