// Light that falls on a relightable model: from lamps and from environment maps, as one intensity
// per light of the model and colour channel.
#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <span>
#include <vector>

#include "capture/frame/image.h"
#include "capture/frame/result.h"
#include "pipeline/illumination/direction_interpolation.h"
#include "pipeline/illumination/light_grid.h"

namespace lightsketch {

// n x 3: how much of each captured light, in red, green and blue. 1 is the lamp as captured.
using LightIntensities = Eigen::Matrix<float, Eigen::Dynamic, 3>;

struct DirectionalLamp {
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  // towards the lamp
  Eigen::Vector3d colour = Eigen::Vector3d::Ones();      // in units of the captured lamp
};

// `lights file`: JSON {"format": "lightsketch-lights", "formatVersion": 1, "lights":
// [{"direction": [x,y,z], "colour": [r,g,b]}, ...]}.
Result<std::vector<DirectionalLamp>> readLights(const std::filesystem::path& path);

LightIntensities intensitiesOf(std::span<const DirectionalLamp> lamps,
                               const DirectionInterpolator& interpolator);

// Radiance of a lat-long map in a direction (OpenEXR convention: centre of the picture +z, a
// quarter from the left +x, top +y), bilinear.
Eigen::Vector3f environmentRadiance(const RadianceImage& latLong, const Eigen::Vector3d& direction);

// Radiance integrated over each light's Voronoi cell (LightCells with the same
// options): s_i = sum over the cell of L(w) dw / lampIrradiance. `lampIrradiance` is the
// irradiance, in the map's units, that the captured lamp puts on a surface facing it; pi by
// default, so that a white matte surface under the lamp has radiance 1. A constant map of radiance
// 1 with lampIrradiance 1 gives the cells' solid angles.
struct EnvironmentOptions {
  double lampIrradiance = 3.14159265358979323846;
  double rotationDegrees = 0;  // turns the map about +y, from +z towards +x
  CellOptions cells = {};
};
Result<LightIntensities> intensitiesOf(const RadianceImage& latLong,
                                       std::span<const Eigen::Vector3d> lights,
                                       const EnvironmentOptions& options = {});

}  // namespace lightsketch
