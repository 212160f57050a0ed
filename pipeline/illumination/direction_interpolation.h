// Predicts the picture under an unseen light as a weighted sum of the pictures under known ones.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "capture/frame/result.h"

namespace lightsketch {

struct InterpolationSettings {
  enum class Kernel { kThinPlate, kLinear, kCubic };  // of the chord distance d: d^2 log d, d, d^3
  Kernel kernel = Kernel::kThinPlate;
  int trendDegree = 1;   // polynomial in (x, y, z) restricted to the sphere: 0 to 3
  double nugget = 1e-4;  // smoothing on the kernel's diagonal
  // Outside the lights' hull, the query is moved towards the hull by this fraction of its distance
  // (1: clamped to the hull).
  double outsideClamp = 0;
  // Height counts so many times in the kernel's distance: 0 compares directions as seen from above,
  // 1 is the sphere's chord; more where the picture changes fast as a low light rises.
  double stretch = 1;
  std::string describe() const;
};

// Weights depend on directions only, never on pixels. Immutable, thread-safe.
class DirectionInterpolator {
 public:
  // Directions are unit vectors, at least one. Lowers the trend where there are too few lights for
  // it; near-duplicate directions are fine.
  static Result<DirectionInterpolator> create(std::span<const Eigen::Vector3d> lights,
                                              const InterpolationSettings& settings);
  // One weight per light; they add up to 1.
  Eigen::VectorXd weights(const Eigen::Vector3d& direction) const;
  // Whether the direction lies inside the lights' convex hull on the sphere.
  bool insideHull(const Eigen::Vector3d& direction) const;
  int lightCount() const;
  // As used: with the trend lowered where the lights did not determine it.
  const InterpolationSettings& settings() const;

 private:
  struct State;
  std::shared_ptr<const State> state_;
};

// Leave-one-out over the lights: tries kernels, trends, nuggets and clamps and returns the settings
// with the least squared error over `samples` (n lights x m values, in the domain that will be
// interpolated).
Result<InterpolationSettings> chooseInterpolation(std::span<const Eigen::Vector3d> lights,
                                                  const Eigen::MatrixXf& samples);

}  // namespace lightsketch
