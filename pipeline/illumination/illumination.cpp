#include "pipeline/illumination/illumination.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "capture/frame/json.h"
#include "pipeline/illumination/lat_long.h"

namespace lightsketch {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;
using std::numbers::pi;

Vector3f texel(const RadianceImage& image, int x, int y) {
  return {image(x, y, 0), image(x, y, 1), image(x, y, 2)};
}

}  // namespace

Result<std::vector<DirectionalLamp>> readLights(const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const Json json, readJsonFile(path));
  RETURN_IF_ERROR(checkFormat(json, "lightsketch-lights", 1, path.string()));
  if (!json.contains("lights") || !json["lights"].is_array() || json["lights"].empty()) {
    return failure(ErrorCode::kCorrupt, "{}: 'lights' must be an array of at least one lamp",
                   path.string());
  }
  std::vector<DirectionalLamp> lamps;
  for (const Json& entry : json["lights"]) {
    const std::string where = fmt::format("{}: lamp {}", path.string(), lamps.size() + 1);
    ASSIGN_OR_RETURN(const Eigen::VectorXd direction, jsonVector(entry, "direction", 3, where));
    if (!(direction.norm() > 1e-6)) {
      return failure(ErrorCode::kCorrupt, "{}: 'direction' has no length", where);
    }
    DirectionalLamp lamp;
    lamp.direction = direction.normalized();
    if (entry.contains("colour")) {
      ASSIGN_OR_RETURN(const Eigen::VectorXd colour, jsonVector(entry, "colour", 3, where));
      lamp.colour = colour;
    }
    lamps.push_back(lamp);
  }
  return lamps;
}

LightIntensities intensitiesOf(std::span<const DirectionalLamp> lamps,
                               const DirectionInterpolator& interpolator) {
  Eigen::Matrix<double, Eigen::Dynamic, 3> sum =
      Eigen::Matrix<double, Eigen::Dynamic, 3>::Zero(interpolator.lightCount(), 3);
  for (const auto& lamp : lamps) {
    sum += interpolator.weights(lamp.direction) * lamp.colour.transpose();
  }
  return sum.cast<float>();
}

Vector3f environmentRadiance(const RadianceImage& latLong, const Vector3d& direction) {
  const double longitude = std::atan2(direction.x(), direction.z());
  const double latitude = std::asin(std::clamp(direction.y() / direction.norm(), -1.0, 1.0));
  const double x = (1 - longitude / pi) / 2 * latLong.width() - 0.5;
  const double y = (0.5 - latitude / pi) * latLong.height() - 0.5;
  const double left = std::floor(x);
  const double top = std::floor(y);
  const auto fx = static_cast<float>(x - left);
  const auto fy = static_cast<float>(y - top);
  // Longitude wraps, latitude does not.
  const int width = latLong.width();
  const int x0 = (static_cast<int>(left) + width) % width;
  const int x1 = (x0 + 1) % width;
  const int y0 = std::clamp(static_cast<int>(top), 0, latLong.height() - 1);
  const int y1 = std::clamp(static_cast<int>(top) + 1, 0, latLong.height() - 1);
  return (1 - fy) * ((1 - fx) * texel(latLong, x0, y0) + fx * texel(latLong, x1, y0)) +
         fy * ((1 - fx) * texel(latLong, x0, y1) + fx * texel(latLong, x1, y1));
}

Result<void> checkEnvironment(const RadianceImage& latLong, const EnvironmentOptions& options) {
  if (latLong.channels() != 3 || latLong.width() < 2 || latLong.width() != 2 * latLong.height()) {
    return failure(ErrorCode::kInvalidArgument,
                   "an environment map must be lat-long, twice as wide as high; this one is {}x{}",
                   latLong.width(), latLong.height());
  }
  for (std::size_t i = 0; i < latLong.size(); ++i) {
    if (!std::isfinite(latLong.data()[i])) {
      return failure(
          ErrorCode::kInvalidArgument,
          "the environment map is not finite at pixel {}, {} (a sun beyond half floats?); "
          "clip it first",
          i % latLong.rowSize() / 3, i / latLong.rowSize());
    }
  }
  if (!(options.lampIrradiance > 0)) {
    return failure(ErrorCode::kInvalidArgument, "the lamp's irradiance must be positive, not {}",
                   options.lampIrradiance);
  }
  return {};
}

Result<LightIntensities> intensitiesOf(const RadianceImage& latLong,
                                       std::span<const Vector3d> lights,
                                       const EnvironmentOptions& options) {
  RETURN_IF_ERROR(checkEnvironment(latLong, options));
  ASSIGN_OR_RETURN(const auto cells, LightCells::create(lights, options.cells));

  // Each texel is cut into samples x samples parts, which go to the light whose cell they lie in.
  const int samples = std::clamp(2048 / latLong.width(), 1, 32);
  const int rows = latLong.height() * samples;
  const int columns = latLong.width() * samples;
  const double rotation = options.rotationDegrees * pi / 180;
  const Eigen::AngleAxisd worldFromMap(rotation, Vector3d::UnitY());
  Eigen::Matrix<double, Eigen::Dynamic, 4> sums =
      Eigen::Matrix<double, Eigen::Dynamic, 4>::Zero(static_cast<Eigen::Index>(lights.size()), 4);
  for (int y = 0; y < rows; ++y) {
    const double area =
        latLongBandArea(static_cast<double>(y) / rows, static_cast<double>(y + 1) / rows) / columns;
    for (int x = 0; x < columns; ++x) {
      const Vector3d direction =
          worldFromMap * latLongDirection((x + 0.5) / columns, (y + 0.5) / rows);
      const int cell = cells.cellOf(direction);
      if (cell < 0) continue;
      const Vector3f radiance = texel(latLong, x / samples, y / samples);
      sums.row(cell) += area * Eigen::RowVector4d(radiance.x(), radiance.y(), radiance.z(), 1);
    }
  }

  // Mean radiance over the cell times the cell's exact area, so that a constant map gives exactly
  // the solid angles. A cell too small for any sample takes the map's value at its light.
  LightIntensities intensities(static_cast<Eigen::Index>(lights.size()), 3);
  for (std::size_t i = 0; i < lights.size(); ++i) {
    const auto row = sums.row(cells.firstTwin(static_cast<int>(i)));
    const Vector3d mean =
        row[3] > 0
            ? Vector3d(row.head<3>().transpose() / row[3])
            : Vector3d(
                  environmentRadiance(latLong, worldFromMap.inverse() * lights[i]).cast<double>());
    intensities.row(static_cast<Eigen::Index>(i)) =
        (mean * (cells.solidAngles()[i] / options.lampIrradiance)).cast<float>().transpose();
  }
  return intensities;
}

}  // namespace lightsketch
