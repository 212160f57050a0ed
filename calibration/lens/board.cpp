#include "calibration/lens/board.h"

namespace lightsketch {

Eigen::Vector3d BoardGeometry::corner(int column, int row, const Eigen::Vector2d& warp) const {
  const double u = 2.0 * column / (columns - 1) - 1;
  const double v = 2.0 * row / (rows - 1) - 1;
  return {column * spacingMetres, row * spacingMetres,
          warp.x() * (1 - u * u) + warp.y() * (1 - v * v)};
}

}  // namespace lightsketch
