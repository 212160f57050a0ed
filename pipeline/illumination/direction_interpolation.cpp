#include "pipeline/illumination/direction_interpolation.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>

#include "pipeline/illumination/kriging_system.h"
#include "pipeline/illumination/spherical_hull.h"

namespace lightsketch {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;
using Kernel = InterpolationSettings::Kernel;

// Above this many lights a query uses only its nearest ones: the whole system would take n^2 memory
// and n^3 time, and far lights carry next to no weight.
constexpr std::size_t kMaxSystem = 1024;
constexpr std::size_t kNeighbours = 96;
constexpr double kCoincident = 1e-12;  // squared chord

// The best system the lights allow: the trend lowered as far as needed, then the linear kernel with
// a constant trend, which any set of distinct lights determines.
std::optional<KrigingSystem> solveLowering(const std::vector<Vector3d>& lights,
                                           InterpolationSettings& settings) {
  for (; settings.trendDegree >= lowestTrend(settings.kernel); --settings.trendDegree) {
    if (auto system = KrigingSystem::solve(lights, settings)) return system;
  }
  settings.kernel = Kernel::kLinear;
  settings.trendDegree = 0;
  settings.stretch = 1;
  return KrigingSystem::solve(lights, settings);
}

// Indices of the `count` lights nearest to a direction.
std::vector<std::size_t> nearestLights(std::span<const Vector3d> lights, const Vector3d& direction,
                                       std::size_t count) {
  std::vector<std::size_t> order(lights.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  count = std::min(count, order.size());
  std::nth_element(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(count) - 1,
                   order.end(), [&](std::size_t a, std::size_t b) {
                     const double da = lights[a].dot(direction);
                     const double db = lights[b].dot(direction);
                     return da > db || (da == db && a < b);
                   });
  order.resize(count);
  return order;
}

Result<void> checkDirections(std::span<const Vector3d> lights) {
  if (lights.empty())
    return failure(ErrorCode::kInvalidArgument, "no lights to interpolate between");
  for (const auto& light : lights) {
    if (!(std::abs(light.norm() - 1) < 1e-6)) {
      return failure(ErrorCode::kInvalidArgument, "a light direction is not a unit vector");
    }
  }
  return {};
}

Vector3d clamped(const Vector3d& direction, const SphericalHull& hull, double fraction) {
  if (fraction == 0) return direction;
  const Vector3d moved = (1 - fraction) * direction + fraction * hull.closest(direction);
  return moved.norm() > 1e-6 ? moved.normalized() : direction;
}

}  // namespace

std::string InterpolationSettings::describe() const {
  static constexpr const char* kNames[] = {"thin plate", "linear", "cubic"};
  return fmt::format(
      "{} kernel{}, trend of degree {}, nugget {:g}, clamped by {:g} outside the hull",
      kNames[static_cast<int>(kernel)],
      stretch == 1 ? std::string() : fmt::format(" stretched by {:g}", stretch), trendDegree,
      nugget, outsideClamp);
}

struct DirectionInterpolator::State {
  explicit State(std::span<const Vector3d> directions) : hull(directions) {}
  InterpolationSettings settings;
  SphericalHull hull;
  std::size_t lightCount = 0;
  std::vector<Vector3d> lights;       // distinct ones
  std::vector<std::size_t> distinct;  // per light given: its place in `lights`
  std::vector<double> share;          // per light given: 1 / number of lights that coincide with it
  std::optional<KrigingSystem> system;  // empty if solved per query from the nearest lights
};

Result<DirectionInterpolator> DirectionInterpolator::create(std::span<const Vector3d> lights,
                                                            const InterpolationSettings& settings) {
  RETURN_IF_ERROR(checkDirections(lights));
  if (settings.trendDegree < 0 || settings.trendDegree > 3 || !(settings.nugget >= 0) ||
      !(settings.outsideClamp >= 0 && settings.outsideClamp <= 1) || !(settings.stretch >= 0)) {
    return failure(ErrorCode::kInvalidArgument, "interpolation settings out of range: {}",
                   settings.describe());
  }
  auto state = std::make_shared<State>(lights);
  state->settings = settings;
  state->lightCount = lights.size();
  // Lights that coincide would make the system singular; they share one place and its weight.
  std::vector<std::size_t> order(lights.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return lights[a].x() < lights[b].x(); });
  state->distinct.assign(lights.size(), 0);
  std::vector<int> members;
  for (std::size_t k = 0; k < order.size(); ++k) {
    const Vector3d& light = lights[order[k]];
    std::optional<std::size_t> twin;
    for (std::size_t l = k; l-- > 0 && !twin && light.x() - lights[order[l]].x() < 1e-6;) {
      if ((lights[order[l]] - light).squaredNorm() < kCoincident) twin = state->distinct[order[l]];
    }
    if (!twin) {
      twin = state->lights.size();
      state->lights.push_back(light);
      members.push_back(0);
    }
    state->distinct[order[k]] = *twin;
    ++members[*twin];
  }
  for (const std::size_t place : state->distinct) state->share.push_back(1.0 / members[place]);
  if (state->lights.size() <= kMaxSystem) {
    state->system = solveLowering(state->lights, state->settings);
    if (!state->system) {
      return failure(ErrorCode::kInvalidArgument, "the {} light directions cannot be interpolated",
                     lights.size());
    }
  }
  DirectionInterpolator interpolator;
  interpolator.state_ = std::move(state);
  return interpolator;
}

VectorXd DirectionInterpolator::weights(const Vector3d& direction) const {
  const State& s = *state_;
  const Vector3d query = clamped(direction, s.hull, s.settings.outsideClamp);
  VectorXd distinct = VectorXd::Zero(static_cast<Eigen::Index>(s.lights.size()));
  if (s.system) {
    distinct = s.system->weights(query);
  } else {
    std::vector<Vector3d> subset;
    const auto chosen = nearestLights(s.lights, query, kNeighbours);
    for (const std::size_t i : chosen) subset.push_back(s.lights[i]);
    InterpolationSettings settings = s.settings;
    const auto system = solveLowering(subset, settings);
    const VectorXd local = system ? system->weights(query)
                                  : VectorXd::Constant(static_cast<Eigen::Index>(chosen.size()),
                                                       1.0 / static_cast<double>(chosen.size()));
    for (std::size_t k = 0; k < chosen.size(); ++k) {
      distinct[static_cast<Eigen::Index>(chosen[k])] = local[static_cast<Eigen::Index>(k)];
    }
  }
  VectorXd weights(static_cast<Eigen::Index>(s.lightCount));
  for (std::size_t i = 0; i < s.lightCount; ++i) {
    weights[static_cast<Eigen::Index>(i)] =
        distinct[static_cast<Eigen::Index>(s.distinct[i])] * s.share[i];
  }
  return weights;
}

bool DirectionInterpolator::insideHull(const Vector3d& direction) const {
  return state_->hull.contains(direction);
}

int DirectionInterpolator::lightCount() const { return static_cast<int>(state_->lightCount); }

const InterpolationSettings& DirectionInterpolator::settings() const { return state_->settings; }

Result<InterpolationSettings> chooseInterpolation(std::span<const Vector3d> lights,
                                                  const Eigen::MatrixXf& samples) {
  RETURN_IF_ERROR(checkDirections(lights));
  if (samples.rows() != static_cast<Eigen::Index>(lights.size()) || !samples.allFinite()) {
    return failure(ErrorCode::kInvalidArgument,
                   "interpolation needs finite samples of all {} lights, got {} rows",
                   lights.size(), samples.rows());
  }
  // One neighbourhood of all lights with every light left out in turn; or, for many lights, spread
  // neighbourhoods with only their first light left out.
  struct Neighbourhood {
    std::vector<Vector3d> lights;
    MatrixXd products;         // sum over the samples of y y^T
    Eigen::Index targets = 0;  // the first ones
  };
  std::vector<Neighbourhood> neighbourhoods;
  const auto gather = [&](const std::vector<std::size_t>& chosen, Eigen::Index targets) {
    MatrixXd rows(static_cast<Eigen::Index>(chosen.size()), samples.cols());
    Neighbourhood part{{}, {}, targets};
    for (std::size_t k = 0; k < chosen.size(); ++k) {
      part.lights.push_back(lights[chosen[k]]);
      rows.row(static_cast<Eigen::Index>(k)) =
          samples.row(static_cast<Eigen::Index>(chosen[k])).cast<double>();
    }
    part.products = rows * rows.transpose();
    neighbourhoods.push_back(std::move(part));
  };
  if (lights.size() <= kMaxSystem / 2) {
    std::vector<std::size_t> all(lights.size());
    std::iota(all.begin(), all.end(), std::size_t{0});
    gather(all, static_cast<Eigen::Index>(lights.size()));
  } else {
    constexpr std::size_t kTargets = 64;
    for (std::size_t k = 0; k < kTargets; ++k) {
      const std::size_t target = k * lights.size() / kTargets;
      auto chosen = nearestLights(lights, lights[target], kNeighbours);
      std::iter_swap(chosen.begin(), std::find(chosen.begin(), chosen.end(), target));
      gather(chosen, 1);
    }
  }

  InterpolationSettings best;
  double bestError = std::numeric_limits<double>::max();
  for (const Kernel kernel : {Kernel::kThinPlate, Kernel::kLinear, Kernel::kCubic}) {
    for (int degree = lowestTrend(kernel); degree <= 3; ++degree) {
      for (const double nugget : {1e-4, 1e-3, 1e-2, 3e-2, 1e-1}) {
        constexpr double kClamps[] = {0, 0.5, 1};
        double error[3] = {0, 0, 0};
        bool determined = true;
        for (const auto& part : neighbourhoods) {
          const auto system = KrigingSystem::solve(
              part.lights, {.kernel = kernel, .trendDegree = degree, .nugget = nugget});
          const auto squared =
              system ? system->leaveOneOut(part.products, part.targets) : std::nullopt;
          if (!squared) {
            determined = false;
            break;
          }
          for (double& e : error) e += squared->sum();
          if (part.targets == 1) continue;
          // Only a corner of the hull lies outside the hull of the others; only there clamps
          // differ.
          const SphericalHull whole(part.lights);
          for (const int corner : whole.corners()) {
            std::vector<Vector3d> others(part.lights);
            others.erase(others.begin() + corner);
            const SphericalHull hull(others);
            for (int c = 1; c < 3; ++c) {
              const Vector3d query =
                  clamped(part.lights[static_cast<std::size_t>(corner)], hull, kClamps[c]);
              VectorXd residual = system->weightsWithout(corner, query);
              residual[corner] -= 1;
              error[c] += residual.dot(part.products * residual) - (*squared)[corner];
            }
          }
        }
        if (!determined) continue;
        for (int c = 0; c < 3; ++c) {
          if (error[c] < bestError) {
            bestError = error[c];
            best = {.kernel = kernel,
                    .trendDegree = degree,
                    .nugget = nugget,
                    .outsideClamp = kClamps[c]};
          }
        }
      }
    }
  }
  return best;
}

}  // namespace lightsketch
