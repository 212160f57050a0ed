#include "pipeline/illumination/soft_lamps.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "capture/frame/median.h"

namespace lightsketch {
namespace {

double smoothStep(double from, double to, double x) {
  const double t = std::clamp((x - from) / (to - from), 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

}  // namespace

Result<SoftLamps> SoftLamps::create(std::span<const Eigen::Vector3d> lights,
                                    const DirectionInterpolator& interpolator,
                                    const CellOptions& cells) {
  ASSIGN_OR_RETURN(auto areas, voronoiSolidAngles(lights, cells));
  SoftLamps lamps(interpolator);
  lamps.lights_.assign(lights.begin(), lights.end());
  lamps.areas_ = std::move(areas);
  for (const double area : lamps.areas_) lamps.sides_.push_back(std::sqrt(area));
  auto sorted = lamps.sides_;
  lamps.spacing_ = median(sorted);
  return lamps;
}

void SoftLamps::add(const DiscLamp& lamp, LightIntensities& out) const {
  const double radius = std::min(lamp.radius.radians(), std::numbers::pi / 2);
  const Eigen::RowVector3f colour = lamp.colour.cast<float>().transpose();
  double asArea = smoothStep(0.5, 1.5, radius / spacing_);

  // The part of each cell within the disc, its edge as wide as the cell.
  std::vector<std::pair<Eigen::Index, double>> parts;
  double sum = 0;
  if (asArea > 0) {
    for (std::size_t i = 0; i < lights_.size(); ++i) {
      const double angle = std::acos(std::clamp(lights_[i].dot(lamp.direction), -1.0, 1.0));
      const double half = sides_[i] / 2;
      if (angle >= radius + half || half == 0) continue;
      const double part = areas_[i] * smoothStep(radius + half, radius - half, angle);
      parts.emplace_back(static_cast<Eigen::Index>(i), part);
      sum += part;
    }
    // Where there are hardly any lights within the disc, the interpolator knows better.
    const double disc = 2 * std::numbers::pi * (1 - std::cos(radius));
    asArea *= std::min(1.0, 4 * sum / disc);
  }
  for (const auto& [light, part] : parts) {
    out.row(light) += static_cast<float>(asArea * part / sum) * colour;
  }
  if (asArea < 1) {
    out += ((1 - asArea) * interpolator_.weights(lamp.direction)).cast<float>() * colour;
  }
}

LightIntensities SoftLamps::intensitiesOf(std::span<const DiscLamp> lamps) const {
  LightIntensities out = LightIntensities::Zero(static_cast<Eigen::Index>(lights_.size()), 3);
  for (const DiscLamp& lamp : lamps) add(lamp, out);
  return out;
}

}  // namespace lightsketch
