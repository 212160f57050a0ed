#include "pipeline/illumination/nearest_direction.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace lightsketch {
namespace {

constexpr int kMaxSide = 64;  // 64^3 bins of four bytes: 1 MB, enough for 10,000 directions

}  // namespace

NearestDirection::NearestDirection(std::span<const Eigen::Vector3d> directions, double binSize)
    : directions_(directions.begin(), directions.end()) {
  side_ = std::clamp(static_cast<int>(2 / std::max(binSize, 1e-3)), 1, kMaxSide);
  binSize_ = 2.0 / side_;
  start_.assign(flat(side_ - 1, side_ - 1, side_ - 1) + 2, 0);
  const auto binOf = [this](const Eigen::Vector3d& d) {
    return flat(bin(d.x()), bin(d.y()), bin(d.z()));
  };
  for (const auto& d : directions_) ++start_[binOf(d) + 1];
  for (std::size_t i = 1; i < start_.size(); ++i) start_[i] += start_[i - 1];
  index_.resize(directions_.size());
  std::vector<int> next(start_.begin(), start_.end() - 1);
  for (std::size_t i = 0; i < directions_.size(); ++i) {
    index_[static_cast<std::size_t>(next[binOf(directions_[i])]++)] = static_cast<int>(i);
  }
}

int NearestDirection::bin(double coordinate) const {
  return std::clamp(static_cast<int>(std::floor((coordinate + 1) / binSize_)), 0, side_ - 1);
}

int NearestDirection::nearest(const Eigen::Vector3d& query) const {
  // Everything within `chord` has been seen after one pass, so a hit that close is final.
  for (double chord = binSize_ / 2;; chord *= 2) {
    int best = -1;
    double bestSquared = std::numeric_limits<double>::max();
    near(query, chord, [&](int i) {
      const double squared = (directions_[static_cast<std::size_t>(i)] - query).squaredNorm();
      if (squared < bestSquared || (squared == bestSquared && i < best)) {
        best = i;
        bestSquared = squared;
      }
    });
    if (best >= 0 && (bestSquared <= chord * chord || chord > 2)) return best;
  }
}

}  // namespace lightsketch
