#include "pipeline/illumination/light_grid.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "capture/frame/direction.h"
#include "pipeline/illumination/nearest_direction.h"
#include "pipeline/illumination/spherical_hull.h"

namespace lightsketch {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using std::numbers::pi;

// Fibonacci spiral: equal areas along z, golden angle around it.
std::vector<Vector3d> spiral(int count, double lowestZ) {
  const double goldenAngle = pi * (3 - std::sqrt(5.0));
  std::vector<Vector3d> points;
  points.reserve(static_cast<std::size_t>(count));
  for (int i = 0; i < count; ++i) {
    const double z = 1 - (1 - lowestZ) * (i + 0.5) / count;
    const double r = std::sqrt(1 - z * z);
    points.emplace_back(r * std::cos(goldenAngle * i), r * std::sin(goldenAngle * i), z);
  }
  return points;
}

// Neighbour distance, as a chord, of a hexagonal lattice with this area per node.
double hexagonalSpacing(double areaPerNode) { return std::sqrt(areaPerNode * 2 / std::sqrt(3.0)); }

// Lets neighbours repel each other. On the hemisphere each node also meets the mirror images below
// the rim, which keeps the rim nodes half a spacing above it.
void relax(std::vector<Vector3d>& points, LightGrid::Domain domain, double spacing) {
  constexpr int kSteps = 40;
  const bool mirrored = domain == LightGrid::Domain::kHemisphere;
  const std::size_t count = points.size();
  std::vector<Vector3d> all(points);
  for (int step = 0; step < kSteps; ++step) {
    all.assign(points.begin(), points.end());
    if (mirrored) {
      for (const auto& p : points) {
        if (p.z() < 1.6 * spacing) all.emplace_back(p.x(), p.y(), -p.z());
      }
    }
    const NearestDirection bins(all, spacing);
    const double gain = 0.2 * spacing * (1 - static_cast<double>(step) / kSteps);
    for (std::size_t i = 0; i < count; ++i) {
      Vector3d push = Vector3d::Zero();
      bins.near(all[i], 1.6 * spacing, [&](int j) {
        const Vector3d apart = all[i] - all[static_cast<std::size_t>(j)];
        const double squared = apart.squaredNorm() / (spacing * spacing);
        // Riesz energy with exponent 6: mostly the nearest neighbours count.
        if (squared > 1e-6 && squared < 1.6 * 1.6) push += apart / (spacing * std::pow(squared, 4));
      });
      const double length = push.norm();
      if (length > 1) push /= length;
      points[i] = (all[i] + gain * push).normalized();
      points[i].z() = mirrored ? std::max(points[i].z(), 0.0) : points[i].z();
    }
  }
}

}  // namespace

Result<LightGrid> LightGrid::create(int count, Domain domain) {
  if (count < 64 || count > 10000) {
    return failure(ErrorCode::kInvalidArgument, "a direction grid has 64 to 10000 nodes, not {}",
                   count);
  }
  const bool hemisphere = domain == Domain::kHemisphere;
  const double spacing = hexagonalSpacing((hemisphere ? 2 : 4) * pi / count);
  LightGrid grid;
  grid.domain_ = domain;
  grid.directions_ = spiral(count, hemisphere ? 0 : -1);
  relax(grid.directions_, domain, spacing);
  grid.nearest_ = std::make_shared<const NearestDirection>(grid.directions_, spacing);
  return grid;
}

Angle LightGrid::spacing() const {
  const double area = (domain_ == Domain::kHemisphere ? 2 : 4) * pi / size();
  return Angle::radians(2 * std::asin(hexagonalSpacing(area) / 2));
}

int LightGrid::nearest(const Vector3d& direction) const { return nearest_->nearest(direction); }

namespace {

// Exact area of one light's cell. Seen in the gnomonic projection about the light, the cell is a
// convex polygon (bisectors and the horizon are great circles, hence straight lines) cut by the
// circle of radius tan(reach).
class Cell {
 public:
  explicit Cell(const Vector3d& light, double reach)
      : light_(light), reach_(reach), u_(light.unitOrthogonal()), v_(light.cross(u_)) {
    const double r = 2 * std::tan(reach);  // well outside the circle
    polygon_ = {{-r, -r}, {r, -r}, {r, r}, {-r, r}};
  }

  // Keeps the points x with x . normal >= 0.
  void clip(const Vector3d& normal) {
    const Vector2d direction(normal.dot(u_), normal.dot(v_));
    const double offset = normal.dot(light_);
    std::vector<Vector2d> kept;
    kept.reserve(polygon_.size() + 1);
    for (std::size_t i = 0; i < polygon_.size(); ++i) {
      const Vector2d& a = polygon_[i];
      const Vector2d& b = polygon_[(i + 1) % polygon_.size()];
      const double fa = a.dot(direction) + offset;
      const double fb = b.dot(direction) + offset;
      if (fa >= 0) kept.push_back(a);
      if ((fa >= 0) != (fb >= 0)) kept.push_back(a + (b - a) * (fa / (fa - fb)));
    }
    polygon_ = std::move(kept);
  }

  // Sum over the edges of the signed area between edge and light, so that the light need not lie
  // inside.
  double area() const {
    double sum = 0;
    for (std::size_t i = 0; i < polygon_.size(); ++i) {
      sum += wedge(polygon_[i], polygon_[(i + 1) % polygon_.size()]);
    }
    return std::max(sum, 0.0);
  }

 private:
  // Signed area on the sphere of the triangle (light, a, b) within the circle.
  double wedge(const Vector2d& a, const Vector2d& b) const {
    const double radius = std::tan(reach_);
    const Vector2d along = b - a;
    const double length = along.norm();
    if (length == 0) return 0;
    const Vector2d t = along / length;
    const double from = a.dot(t);
    const double to = b.dot(t);
    const double distance = t.x() * a.y() - t.y() * a.x();  // signed, of the line from the light
    if (distance == 0) return 0;
    const double d = std::abs(distance);
    // Azimuth along the edge, measured from the foot of the perpendicular.
    const auto azimuth = [d](double s) { return std::atan2(s, d); };
    const double half = d < radius ? std::sqrt(radius * radius - d * d) : 0;
    const double low = std::clamp(from, -half, half);
    const double high = std::clamp(to, -half, half);
    double sum = 0;
    if (d < radius && low < high) {
      // Integral of 1 - cos(theta) over the azimuth, with tan(theta) = d / cos(azimuth).
      const auto primitive = [d](double phi) {
        return phi - std::asin(std::sin(phi) / std::sqrt(1 + d * d));
      };
      sum += primitive(azimuth(high)) - primitive(azimuth(low));
    }
    const double inside = d < radius && low < high ? azimuth(high) - azimuth(low) : 0;
    sum += (1 - std::cos(reach_)) * (azimuth(to) - azimuth(from) - inside);
    return distance < 0 ? sum : -sum;
  }

  Vector3d light_;
  double reach_;
  Vector3d u_;
  Vector3d v_;
  std::vector<Vector2d> polygon_;
};

// Twice the distance within which nine in ten points of the lights' hull find a
// light: one spacing of a regular grid, which fills the gaps between lights, those at a grid's rim
// (0.71 spacings) included, and adds a rim.
double reachFromSpacing(std::span<const Vector3d> lights, const NearestDirection& nearest) {
  const SphericalHull hull(lights);
  std::vector<double> distances;
  for (const Vector3d& point : spiral(8000, -1)) {
    if (!hull.contains(point)) continue;
    const Vector3d& light = lights[static_cast<std::size_t>(nearest.nearest(point))];
    distances.push_back(angleBetween(light, point).radians());
  }
  constexpr double kLoneReach = 15 * pi / 180;  // of lights that span no area
  if (distances.size() < 8) return kLoneReach;
  const auto rank = distances.begin() + static_cast<std::ptrdiff_t>(distances.size() * 9 / 10);
  std::nth_element(distances.begin(), rank, distances.end());
  return 2 * *rank;
}

}  // namespace

Result<LightCells> LightCells::create(std::span<const Vector3d> lights,
                                      const CellOptions& options) {
  if (lights.empty())
    return failure(ErrorCode::kInvalidArgument, "no lights to divide the sphere among");
  for (const auto& light : lights) {
    if (!(std::abs(light.norm() - 1) < 1e-6)) {
      return failure(ErrorCode::kInvalidArgument, "a light direction is not a unit vector");
    }
  }
  LightCells cells;
  cells.lights_.assign(lights.begin(), lights.end());
  const double typical = hexagonalSpacing(4 * pi / static_cast<double>(lights.size()));
  cells.nearest_ = std::make_shared<const NearestDirection>(lights, typical);
  constexpr double kMaxReach = 80 * pi / 180;  // the projection needs less than a quarter turn
  const double reach = options.reach.radians() > 0 ? options.reach.radians()
                                                   : reachFromSpacing(lights, *cells.nearest_);
  cells.reach_ = Angle::radians(std::min(reach, kMaxReach));
  cells.hemisphereOnly_ =
      options.hemisphereOnly &&
      std::all_of(lights.begin(), lights.end(), [](const Vector3d& l) { return l.z() >= 0; });

  const double chord = 2 * std::sin(std::min(2 * cells.reach_.radians(), pi) / 2) + 1e-9;
  cells.twin_.resize(lights.size());
  cells.areas_.resize(lights.size());
  std::vector<int> share(lights.size(), 0);
  for (std::size_t i = 0; i < lights.size(); ++i) {
    Cell cell(lights[i], cells.reach_.radians());
    if (cells.hemisphereOnly_) cell.clip(Vector3d::UnitZ());
    int twin = static_cast<int>(i);
    cells.nearest_->near(lights[i], chord, [&](int j) {
      const Vector3d normal = lights[i] - lights[static_cast<std::size_t>(j)];
      if (normal.squaredNorm() < 1e-20) {
        twin = std::min(twin, j);
      } else {
        cell.clip(normal);
      }
    });
    cells.twin_[i] = twin;
    ++share[static_cast<std::size_t>(twin)];
    cells.areas_[i] = cell.area();
  }
  for (std::size_t i = 0; i < lights.size(); ++i) {
    cells.areas_[i] /= share[static_cast<std::size_t>(cells.twin_[i])];
  }
  return cells;
}

int LightCells::cellOf(const Vector3d& direction) const {
  if (hemisphereOnly_ && direction.z() < 0) return -1;
  const int light = nearest_->nearest(direction);
  const bool reached = angleBetween(lights_[static_cast<std::size_t>(light)], direction) <= reach_;
  return reached ? light : -1;
}

Result<std::vector<double>> voronoiSolidAngles(std::span<const Vector3d> lights,
                                               const CellOptions& options) {
  ASSIGN_OR_RETURN(const auto cells, LightCells::create(lights, options));
  return cells.solidAngles();
}

}  // namespace lightsketch
