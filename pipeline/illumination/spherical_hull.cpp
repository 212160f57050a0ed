#include "pipeline/illumination/spherical_hull.h"

#include <algorithm>
#include <numeric>
#include <optional>

namespace lightsketch {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kTolerance = 1e-9;

// An axis with all directions in its open half space, by the perceptron's rule.
std::optional<Vector3d> axisOf(std::span<const Vector3d> directions) {
  Vector3d axis = Vector3d::Zero();
  for (const auto& d : directions) axis += d;
  for (int attempt = 0; attempt < 1000; ++attempt) {
    if (axis.norm() > kTolerance) axis.normalize();
    double lowest = 1;
    Vector3d worst = Vector3d::Zero();
    for (const auto& d : directions) {
      if (d.dot(axis) < lowest) {
        lowest = d.dot(axis);
        worst = d;
      }
    }
    if (lowest > 1e-4) return axis;
    axis += (1e-3 - lowest) * worst;
  }
  return std::nullopt;
}

double cross(const Vector2d& a, const Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

}  // namespace

SphericalHull::SphericalHull(std::span<const Vector3d> directions) {
  const auto axis = axisOf(directions);
  if (!axis) return;
  // The gnomonic projection keeps great circles straight, so the planar hull is the spherical one.
  const Vector3d u = axis->unitOrthogonal();
  const Vector3d v = axis->cross(u);
  std::vector<Vector2d> points;
  for (const auto& d : directions) points.push_back(Vector2d(d.dot(u), d.dot(v)) / d.dot(*axis));
  std::vector<int> order(points.size());
  std::iota(order.begin(), order.end(), 0);
  const auto at = [&](int i) -> const Vector2d& { return points[static_cast<std::size_t>(i)]; };
  std::sort(order.begin(), order.end(), [&](int a, int b) {
    return at(a).x() < at(b).x() || (at(a).x() == at(b).x() && at(a).y() < at(b).y());
  });
  // Andrew's monotone chain: the lower chain, then the upper one.
  for (int pass = 0; pass < 2; ++pass) {
    const std::size_t base = index_.size();
    for (const int i : order) {
      while (index_.size() >= base + 2 &&
             cross(at(index_.back()) - at(*(index_.end() - 2)), at(i) - at(index_.back())) <= 0) {
        index_.pop_back();
      }
      index_.push_back(i);
    }
    if (index_.size() > 1) index_.pop_back();  // the other chain begins with it
    std::reverse(order.begin(), order.end());
  }
  for (const int i : index_) corners_.push_back(directions[static_cast<std::size_t>(i)]);
}

bool SphericalHull::contains(const Vector3d& direction) const {
  if (corners_.empty()) return true;
  return (closest(direction) - direction).norm() <= kTolerance;
}

Vector3d SphericalHull::closest(const Vector3d& direction) const {
  bool inside = corners_.size() >= 3;
  Vector3d best = direction;
  double bestDot = -2;
  for (std::size_t i = 0; i < corners_.size(); ++i) {
    const Vector3d& a = corners_[i];
    const Vector3d& b = corners_[(i + 1) % corners_.size()];
    const Vector3d normal = a.cross(b);
    if (normal.dot(direction) < 0) inside = false;
    // The foot on the arc's great circle if it falls on the arc, else the nearer end.
    Vector3d candidate = direction.dot(a) > direction.dot(b) ? a : b;
    const double length = normal.norm();
    if (length > 0) {
      const Vector3d foot = direction - normal * (normal.dot(direction) / (length * length));
      const bool between = normal.dot(a.cross(foot)) > 0 && normal.dot(foot.cross(b)) > 0;
      if (between && foot.norm() > 0) candidate = foot.normalized();
    }
    if (candidate.dot(direction) > bestDot) {
      bestDot = candidate.dot(direction);
      best = candidate;
    }
  }
  return inside || corners_.empty() ? direction : best;
}

}  // namespace lightsketch
