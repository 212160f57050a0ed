// Convex hull of directions on the sphere. Internal to this folder.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <span>
#include <vector>

namespace lightsketch {

// The directions that are non-negative combinations of the given ones. Directions that fit into no
// half space have the whole sphere as their hull.
class SphericalHull {
 public:
  explicit SphericalHull(std::span<const Eigen::Vector3d> directions);
  bool contains(const Eigen::Vector3d& direction) const;
  // The closest direction of the hull; the direction itself if it lies inside.
  Eigen::Vector3d closest(const Eigen::Vector3d& direction) const;
  // Indices of the hull's corners, counter-clockwise seen from outside; empty for the whole sphere.
  const std::vector<int>& corners() const { return index_; }

 private:
  std::vector<Eigen::Vector3d> corners_;
  std::vector<int> index_;
};

}  // namespace lightsketch
