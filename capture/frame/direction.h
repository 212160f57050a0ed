// Between two directions.
#pragma once

#include <Eigen/Geometry>
#include <cmath>

#include "capture/frame/angle.h"

namespace lightsketch {

// Of any lengths but 0; exact for small angles and near 180 degrees too.
inline Angle angleBetween(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return Angle::radians(std::atan2(a.cross(b).norm(), a.dot(b)));
}

}  // namespace lightsketch
