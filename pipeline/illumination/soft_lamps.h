// Lamps that are not points.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "capture/frame/angle.h"
#include "capture/frame/result.h"
#include "pipeline/illumination/illumination.h"

namespace lightsketch {

struct DiscLamp {
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  // towards its centre
  Eigen::Vector3d colour = Eigen::Vector3d::Ones();  // in units of the captured lamp, whatever size
  Angle radius;                                      // seen from the scene; up to 90 degrees
};

// Discs of light as intensities of a model's lights. A disc's light is the same in sum whatever its
// radius is. Below half the lights' spacing it cannot be told from a point; from one and a half
// spacings on each light gets the part of its cell that the disc covers; blended between.
// Immutable, thread-safe; copies share nothing that is large.
class SoftLamps {
 public:
  static Result<SoftLamps> create(std::span<const Eigen::Vector3d> lights,
                                  const DirectionInterpolator& interpolator,
                                  const CellOptions& cells = {});

  // Adds the lamp's light to `out`, which has a row per light.
  void add(const DiscLamp& lamp, LightIntensities& out) const;
  LightIntensities intensitiesOf(std::span<const DiscLamp> lamps) const;

 private:
  explicit SoftLamps(const DirectionInterpolator& interpolator) : interpolator_(interpolator) {}

  DirectionInterpolator interpolator_;
  std::vector<Eigen::Vector3d> lights_;
  std::vector<double> areas_;  // steradians
  std::vector<double> sides_;  // their square roots, radians
  double spacing_ = 0;         // the median of these
};

}  // namespace lightsketch
