#include "capture/session/coverage.h"
#include "capture/frame/direction.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

namespace lightsketch {
namespace {

// Neighbours on a near-hexagonal grid are one spacing away, the next ring 1.7.
constexpr double kNeighbourReach = 1.4;

// What next() weighs, in spacings. Chosen by simulated tours over 64 to 1000 directions: see the
// README.
constexpr double kPerOpenNeighbour = 0.35;
constexpr double kPerTurn = 0.4;  // for turning back
constexpr double kPerPostponement = 6;

}  // namespace

Coverage::Coverage(LightGrid grid)
    : grid_(std::move(grid)),
      neighbours_(grid_.directions().size()),
      captured_(grid_.directions().size()),
      postponed_(grid_.directions().size()) {
  const auto& directions = grid_.directions();
  const double closest = std::cos(kNeighbourReach * grid_.spacing().radians());
  for (std::size_t i = 0; i < directions.size(); ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      if (directions[i].dot(directions[j]) < closest) continue;
      neighbours_[i].push_back(static_cast<int>(j));
      neighbours_[j].push_back(static_cast<int>(i));
    }
  }
}

std::optional<int> Coverage::cellOf(const Eigen::Vector3d& direction) const {
  if (grid_.domain() == LightGrid::Domain::kHemisphere &&
      direction.z() < -std::sin(0.5 * grid_.spacing().radians())) {
    return std::nullopt;
  }
  return grid_.nearest(direction);
}

void Coverage::add(const Eigen::Vector3d& direction) {
  const auto cell = cellOf(direction);
  if (cell && captured_[static_cast<std::size_t>(*cell)]++ == 0) ++capturedCount_;
}

void Coverage::remove(const Eigen::Vector3d& direction) {
  const auto cell = cellOf(direction);
  if (!cell || captured_[static_cast<std::size_t>(*cell)] == 0) return;
  if (--captured_[static_cast<std::size_t>(*cell)] == 0) --capturedCount_;
}

double Coverage::fraction() const {
  return static_cast<double>(capturedCount_) / static_cast<double>(grid_.size());
}

void Coverage::postpone(int cell) {
  postponed_[static_cast<std::size_t>(cell)] += 1;
  for (const int n : neighbours_[static_cast<std::size_t>(cell)]) {
    postponed_[static_cast<std::size_t>(n)] += 0.25;
  }
}

std::optional<int> Coverage::next(const Eigen::Vector3d& here, const Eigen::Vector3d& heading,
                                  std::span<const int> skip) const {
  const auto open = [&](int cell) {
    return !captured(cell) && std::find(skip.begin(), skip.end(), cell) == skip.end();
  };
  const double spacing = grid_.spacing().radians();
  const Eigen::Vector3d forward = heading - heading.dot(here) * here;
  std::optional<int> best;
  double least = std::numeric_limits<double>::infinity();
  for (int cell = 0; cell < grid_.size(); ++cell) {
    if (!open(cell)) continue;
    const auto i = static_cast<std::size_t>(cell);
    const Eigen::Vector3d& there = grid_.directions()[i];
    double cost = angleBetween(here, there).radians() / spacing + kPerPostponement * postponed_[i];
    if (cost >= least) continue;
    // A cell with few open neighbours would be left behind as an island.
    for (const int n : neighbours_[i]) cost += open(n) ? kPerOpenNeighbour : 0;
    const Eigen::Vector3d towards = there - there.dot(here) * here;
    const double lengths = towards.norm() * forward.norm();
    if (lengths > 1e-9) cost += kPerTurn * (1 - towards.dot(forward) / lengths) / 2;
    if (cost < least) {
      least = cost;
      best = cell;
    }
  }
  return best;
}

}  // namespace lightsketch
