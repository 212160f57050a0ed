// Near-uniform light directions, and the part of the sphere that belongs to each of a set of lights.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "capture/frame/angle.h"
#include "capture/frame/result.h"

namespace lightsketch {

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
  // Look-up structure: the implementer's choice.
};

// Area in steradians of each light's Voronoi cell on the sphere. Cells are clipped to what the
// lights cover: points farther than `reach` from every light belong to nobody (and, with
// `hemisphereOnly`, points with z < 0 do not either), so that rim lights do not absorb the unseen
// part. The cells add up to the covered solid angle.
struct CellOptions {
  Angle reach = Angle::degrees(0);  // 0: chosen from the lights' own spacing
  bool hemisphereOnly = true;
};
Result<std::vector<double>> voronoiSolidAngles(std::span<const Eigen::Vector3d> lights,
                                               const CellOptions& options = {});

}  // namespace lightsketch
