// Near-uniform light directions, and the part of the sphere that belongs to each of a set of
// lights.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>
#include <vector>

#include "capture/frame/angle.h"
#include "capture/frame/result.h"

namespace lightsketch {

class NearestDirection;

// N nearly equidistant unit vectors on the hemisphere z >= 0 or on the sphere, with a fast
// nearest-node look-up. Immutable.
class LightGrid {
 public:
  enum class Domain { kHemisphere, kSphere };
  // count from 64 to 10,000.
  static Result<LightGrid> create(int count, Domain domain = Domain::kHemisphere);

  int size() const { return static_cast<int>(directions_.size()); }
  Domain domain() const { return domain_; }
  const std::vector<Eigen::Vector3d>& directions() const { return directions_; }
  // Typical distance between neighbours.
  Angle spacing() const;
  // Index of the node closest to a unit vector.
  int nearest(const Eigen::Vector3d& direction) const;

 private:
  Domain domain_ = Domain::kHemisphere;
  std::vector<Eigen::Vector3d> directions_;
  std::shared_ptr<const NearestDirection> nearest_;
};

// How the sphere is divided among lights: every point belongs to its nearest light. Points farther
// than `reach` from every light belong to nobody, so that rim lights do not absorb the unseen part.
struct CellOptions {
  Angle reach = Angle::degrees(0);  // 0: chosen from the lights' own spacing; at most 80 degrees
  // Points with z < 0 belong to nobody. Without effect where a light itself lies there.
  bool hemisphereOnly = true;
};

// The spherical Voronoi cells of a set of lights, clipped as CellOptions says. Immutable,
// thread-safe.
class LightCells {
 public:
  // Unit vectors, at least one; lights that coincide share a cell.
  static Result<LightCells> create(std::span<const Eigen::Vector3d> lights,
                                   const CellOptions& options = {});

  // Steradians of each light's cell, exact to rounding. They add up to the covered solid angle.
  const std::vector<double>& solidAngles() const { return areas_; }
  Angle reach() const { return reach_; }
  // The light that a direction belongs to; -1 if none. The first of lights that coincide.
  int cellOf(const Eigen::Vector3d& direction) const;
  // The first light that coincides with light i: i itself if there is no other.
  int firstTwin(int i) const { return twin_[static_cast<std::size_t>(i)]; }

 private:
  std::vector<Eigen::Vector3d> lights_;
  std::shared_ptr<const NearestDirection> nearest_;
  std::vector<double> areas_;
  std::vector<int> twin_;
  Angle reach_;
  bool hemisphereOnly_ = true;
};

// LightCells::solidAngles() alone.
Result<std::vector<double>> voronoiSolidAngles(std::span<const Eigen::Vector3d> lights,
                                               const CellOptions& options = {});

}  // namespace lightsketch
