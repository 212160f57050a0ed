// An environment map that is turned while one watches.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>

#include "capture/frame/image.h"
#include "capture/frame/result.h"
#include "pipeline/illumination/illumination.h"

namespace lightsketch {

// What intensitiesOf(latLong, lights, options) gives, for any turn about +y, prepared once for a
// map and a model's lights so that a turn takes well under a millisecond. The picture's light is
// exactly linear in the map, and whatever the turn a constant map gives the solid angles.
// Immutable, thread-safe.
class TurnableEnvironment {
 public:
  // Fails as intensitiesOf does. Takes about as long as one call of it, on all cores.
  static Result<TurnableEnvironment> create(const RadianceImage& latLong,
                                            std::span<const Eigen::Vector3d> lights,
                                            const EnvironmentOptions& options = {});

  // As with EnvironmentOptions::rotationDegrees = yawDegrees, instead of what create() was given.
  void intensities(double yawDegrees, LightIntensities& out) const;
  int lightCount() const;

 private:
  struct Tables;
  std::shared_ptr<const Tables> tables_;
};

}  // namespace lightsketch
