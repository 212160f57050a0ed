#include "pipeline/illumination/interpolation_mixture.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <optional>

#include "pipeline/illumination/kriging_system.h"
#include "pipeline/illumination/spherical_hull.h"

namespace lightsketch {

using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;
using Kernel = InterpolationSettings::Kernel;

std::vector<InterpolationCandidate> interpolationCandidates(std::span<const Vector3d> lights) {
  const bool many = lights.size() > 256;
  std::vector<InterpolationSettings> all;
  for (const double stretch : {0.0, 1.0, 2.0, 5.0}) {
    for (const Kernel kernel : {Kernel::kThinPlate, Kernel::kLinear, Kernel::kCubic}) {
      for (int degree = lowestTrend(kernel); degree <= 2; ++degree) {
        for (const double nugget : {1e-3, 3e-2, 3e-1}) {
          if (many && (kernel == Kernel::kCubic || degree != 1 || nugget > 0.1)) continue;
          all.push_back(
              {.kernel = kernel, .trendDegree = degree, .nugget = nugget, .stretch = stretch});
        }
      }
    }
  }
  std::vector<std::optional<MatrixXd>> weights(all.size());
  oneapi::tbb::parallel_for(std::size_t{0}, all.size(), [&](std::size_t k) {
    const auto system = KrigingSystem::solve({lights.begin(), lights.end()}, all[k]);
    if (system) weights[k] = system->leaveOneOutWeights();
  });
  std::vector<InterpolationCandidate> candidates;
  for (std::size_t k = 0; k < all.size(); ++k) {
    if (weights[k]) candidates.push_back({all[k], weights[k]->cast<float>()});
  }
  return candidates;
}

std::vector<int> rimLights(std::span<const Vector3d> lights) {
  return SphericalHull(lights).corners();
}

VectorXd bestMixture(const MatrixXd& errorProducts) {
  const MatrixXd& G = errorProducts;
  const auto count = G.rows();
  VectorXd a = VectorXd::Constant(count, 1.0 / static_cast<double>(count));
  VectorXd gradient = G * a;
  const double tolerance = 1e-7 * G.diagonal().maxCoeff();
  for (int step = 0; step < 20000; ++step) {
    Eigen::Index to = 0;
    gradient.minCoeff(&to);
    Eigen::Index from = to;
    for (Eigen::Index k = 0; k < count; ++k) {
      if (a[k] > 0 && gradient[k] > gradient[from]) from = k;
    }
    const double gain = gradient[from] - gradient[to];
    if (!(gain > tolerance)) break;
    const double curvature = G(to, to) + G(from, from) - 2 * G(to, from);
    const double move = curvature * a[from] > gain ? gain / curvature : a[from];
    a[to] += move;
    a[from] = move == a[from] ? 0 : a[from] - move;
    gradient += move * (G.col(to) - G.col(from));
  }
  return a;
}

}  // namespace lightsketch
