// The geometry of lat-long maps, and what is demanded of one. Internal to this folder.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <numbers>

#include "pipeline/illumination/illumination.h"

namespace lightsketch {

// OpenEXR's lat-long (ImfEnvmap.h): latitude from +pi/2 (top) to -pi/2, longitude from +pi (left
// edge) to -pi, 0 at +z and pi/2 at +x. u and v: place as a fraction of the map's width and height.
inline Eigen::Vector3d latLongDirection(double u, double v) {
  const double longitude = std::numbers::pi * (1 - 2 * u);
  const double latitude = std::numbers::pi * (0.5 - v);
  return {std::cos(latitude) * std::sin(longitude), std::sin(latitude),
          std::cos(latitude) * std::cos(longitude)};
}

// Steradians of the band v0 <= v <= v1, all the way round.
inline double latLongBandArea(double v0, double v1) {
  constexpr double pi = std::numbers::pi;
  return 2 * pi * (std::sin(pi * (0.5 - v0)) - std::sin(pi * (0.5 - v1)));
}

// Fails for maps that are not lat-long or not finite, and for options that make no sense.
Result<void> checkEnvironment(const RadianceImage& latLong, const EnvironmentOptions& options);

}  // namespace lightsketch
