#include "calibration/lens/lens_field.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

namespace lightsketch {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

double fieldAngleOf(const Vector3d& p) { return std::atan2(std::hypot(p.x(), p.y()), p.z()); }

int sectorOf(const Vector3d& p) {
  const double turn = std::atan2(p.y(), p.x()) / (2 * std::numbers::pi);
  return std::min(kFieldSectors - 1, static_cast<int>((turn - std::floor(turn)) * kFieldSectors));
}

template <class Visit>
void eachUsedCorner(const SolverData& data, std::span<const std::size_t> views, Visit visit) {
  for (const std::size_t v : views) {
    for (const auto& corner : data.views[v].corners) {
      if (corner.used) visit(v, corner);
    }
  }
}

// Of the middle of eighth `i` of the circle, clockwise from the right as y points down.
const char* const kSides[] = {"right", "bottom right", "bottom", "bottom left",
                              "left",  "top left",     "top",    "top right"};

}  // namespace

std::vector<Angle> coveredField(const SolverData& data, std::span<const std::size_t> views,
                                const SolverState& state) {
  std::vector<double> seen(kFieldSectors, 0);
  eachUsedCorner(data, views, [&](std::size_t v, const SolverCorner& corner) {
    const Vector3d p = pointOf(state, corner, state.poses[v]);
    double& sector = seen[static_cast<std::size_t>(sectorOf(p))];
    sector = std::max(sector, fieldAngleOf(p));
  });
  std::vector<Angle> field;
  const auto at = [&](int i) {
    return seen[static_cast<std::size_t>((i + kFieldSectors) % kFieldSectors)];
  };
  for (int i = 0; i < kFieldSectors; ++i) {
    const double before = std::max(at(i - 1), at(i - 2));
    const double after = std::max(at(i + 1), at(i + 2));
    const double reach = std::max(at(i), std::min(before, after));
    field.push_back(Angle::radians(std::max(0.0, reach - std::numbers::pi / 180)));
  }
  return field;
}

FieldAdvice adviseOnField(const SolverData& data, std::span<const std::size_t> views,
                          const SolverState& state, const FisheyeModel& model) {
  FieldAdvice result;
  // How far out the corners lie on the way to the edge of the picture: the frame, or, where the
  // frame's corners lie further out than anything that was seen, the largest circle within it.
  const auto& covered = model.uncertainty().coveredField;
  const Vector2d centre(model.values().cx, model.values().cy);
  std::vector<double> seen;
  std::vector<double> frame;
  double coveredMost = 0;
  for (int i = 0; i < kFieldSectors; ++i) {
    const double degrees = covered[static_cast<std::size_t>(i)].degrees() + 1;
    coveredMost = std::max(coveredMost, degrees);
    const double theta = degrees * std::numbers::pi / 180;
    const double phi = (i + 0.5) * 2 * std::numbers::pi / kFieldSectors;
    const Vector2d side(std::cos(phi), std::sin(phi));
    const auto pixel =
        model.project({side.x() * std::sin(theta), side.y() * std::sin(theta), std::cos(theta)});
    seen.push_back(pixel ? (*pixel - centre).norm() : 0);
    const double alongX =
        (side.x() > 0 ? data.width - centre.x() : centre.x()) / std::abs(side.x());
    const double alongY =
        (side.y() > 0 ? data.height - centre.y() : centre.y()) / std::abs(side.y());
    frame.push_back(std::min(alongX, alongY));
  }
  const double reach = std::max(std::ranges::min(frame), std::ranges::max(seen));
  std::vector<double> share;
  for (std::size_t i = 0; i < kFieldSectors; ++i) {
    share.push_back(seen[i] / std::min(frame[i], reach));
  }
  // A board's corners keep a square's width from the edge.
  constexpr double kEnough = 0.88;
  const auto lacking = std::ranges::count_if(share, [](double s) { return s < kEnough; });
  if (lacking == kFieldSectors) {
    result.warnings.push_back(fmt::format(
        "the edge of the field is unknown: no corner lies beyond {:.0f} degrees off axis, {:.0f} "
        "percent of the way to the frame; directions further out are masked",
        coveredMost, 100 * std::ranges::max(share)));
    result.advice.push_back(fmt::format(
        "all around: hold the board so that its outer squares lie at the edge of the picture (so "
        "far {:.0f} degrees off axis at most)",
        coveredMost));
  } else if (lacking > 0) {
    result.warnings.push_back(fmt::format(
        "the edge of the field is unknown in {:.0f} percent of the azimuths; directions "
        "further out are masked",
        100.0 * static_cast<double>(lacking) / kFieldSectors));
    for (int side = 0; side < 8; ++side) {
      // The sectors within 22.5 degrees of the side's middle.
      double least = kEnough;
      double degrees = 0;
      for (std::size_t i = 0; i < kFieldSectors; ++i) {
        const double off = std::remainder((static_cast<double>(i) + 0.5) * 10 - side * 45, 360.0);
        if (std::abs(off) > 22.5 || share[i] >= least) continue;
        least = share[i];
        degrees = covered[i].degrees() + 1;
      }
      if (least < kEnough) {
        result.advice.push_back(
            fmt::format("{}: no corners beyond {:.0f} degrees off axis, {:.0f} percent of the way "
                        "to the edge: hold the board there",
                        kSides[side], degrees, 100 * least));
      }
    }
  }

  // Rings of the field that hold few corners, on the whole.
  std::vector<int> rings;
  int total = 0;
  eachUsedCorner(data, views, [&](std::size_t v, const SolverCorner& corner) {
    const double degrees =
        fieldAngleOf(pointOf(state, corner, state.poses[v])) * 180 / std::numbers::pi;
    const auto ring = static_cast<std::size_t>(degrees / std::max(5.0, coveredMost / 6));
    if (ring >= rings.size()) rings.resize(ring + 1);
    ++rings[ring];
    ++total;
  });
  for (std::size_t i = 0; i + 1 < rings.size(); ++i) {
    if (rings[i] * 50 >= total) continue;
    const double width = std::max(5.0, coveredMost / 6);
    result.advice.push_back(
        fmt::format("between {:.0f} and {:.0f} degrees off axis there are only {} corners: hold "
                    "the board there too",
                    width * static_cast<double>(i), width * static_cast<double>(i + 1), rings[i]));
  }

  // Tilt of the boards against the line of sight, and their distances.
  int tilted = 0;
  double nearest = INFINITY;
  double farthest = 0;
  for (const std::size_t v : views) {
    const auto& corners = data.views[v].corners;
    Vector2d middle = Vector2d::Zero();
    for (const auto& corner : corners) middle += corner.point / static_cast<double>(corners.size());
    const auto pose = poseFrom(state.poses[v]);
    const Vector3d at = pose * Vector3d(middle.x(), middle.y(), 0);
    const double cosine = pose.linear().col(2).dot(at.normalized());
    tilted += cosine < std::cos(15 * std::numbers::pi / 180);
    nearest = std::min(nearest, at.norm());
    farthest = std::max(farthest, at.norm());
  }
  if (tilted * 3 < static_cast<int>(views.size())) {
    result.advice.push_back(fmt::format(
        "only {} of {} boards are tilted by more than 15 degrees: tilt more of them, 20 to 40 "
        "degrees, in different directions",
        tilted, views.size()));
  }
  if (farthest < 1.3 * nearest) {
    result.advice.push_back(
        "all boards are about equally far away: add some at half and at twice the distance");
  }
  if (views.size() < 15) {
    result.advice.push_back(
        fmt::format("only {} views: 20 to 40 make the result far more certain", views.size()));
  }
  return result;
}

Angle residualPattern(const SolverData& data, std::span<const std::size_t> views,
                      const SolverState& state, const FisheyeModel& model, double sigma) {
  struct Cell {
    Vector2d sum = Vector2d::Zero();
    double pixelsPerRadian = 0;
    int count = 0;
  };
  std::map<std::pair<int, int>, Cell> cells;
  eachUsedCorner(data, views, [&](std::size_t v, const SolverCorner& corner) {
    const Vector3d p = pointOf(state, corner, state.poses[v]);
    const double degrees = fieldAngleOf(p) * 180 / std::numbers::pi;
    Cell& cell = cells[{static_cast<int>(degrees / 5), sectorOf(p) / 3}];
    cell.sum += residualOf(state, corner, state.poses[v]);
    cell.pixelsPerRadian += std::sqrt(std::abs(model.pixelsPerRadian(p).determinant()));
    ++cell.count;
  });
  // A cell's mean holds 2 sigma^2 / n of noise; what is above that is the lens's own.
  double sum = 0;
  double weight = 0;
  for (const auto& [key, cell] : cells) {
    const double n = cell.count;
    const double excess = (cell.sum / n).squaredNorm() - 2 * sigma * sigma / n;
    const double scale = cell.pixelsPerRadian / n;
    if (!(scale > 0)) continue;
    sum += n * excess / (scale * scale);
    weight += n;
  }
  return Angle::radians(weight > 0 ? std::sqrt(std::max(0.0, sum / weight) / 2) : 0);
}

}  // namespace lightsketch
