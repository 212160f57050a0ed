// Internal to calibration/lens: bundle adjustment of one lens, one board and its poses.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <span>
#include <vector>

#include "calibration/lens/lens_calibration.h"
#include "calibration/model/fisheye_projection.h"

namespace lightsketch {

struct SolverCorner {
  Eigen::Vector2d point = Eigen::Vector2d::Zero();  // on the flat board, metres
  Eigen::Vector2d bulge = Eigen::Vector2d::Zero();  // 1 - u^2, 1 - v^2 of the warp
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  bool used = true;
};

struct SolverView {
  std::vector<SolverCorner> corners;
  bool used = true;
};

struct SolverData {
  int width = 0;
  int height = 0;
  std::vector<SolverView> views;
};

using LensVector = std::array<double, FisheyeLayout::kCount>;
using LensMask = std::array<bool, FisheyeLayout::kCount>;  // true: solved for

// Rotation vector and translation of cameraFromBoard.
using PoseVector = std::array<double, 6>;
PoseVector poseVector(const Eigen::Isometry3d& pose);
Eigen::Isometry3d poseFrom(const PoseVector& vector);

struct SolverState {
  LensVector lens{};
  LensVector expected{};  // what the lens is drawn to, ever so weakly: see priorWeight()
  // Warp x, y in metres, and how much longer the board's squares are along y than along x.
  std::array<double, 3> board{};
  std::vector<PoseVector> poses;  // one per view
};

// In pixels per unit of a parameter: keeps what the pictures say nothing about where it was
// expected (the higher k of a narrow lens), without a say in anything that they do tell.
double priorWeight(int parameter);

struct SolveOptions {
  LensMask lens{};
  bool warp = false;
  bool aspect = false;
  double robustPixels = 0;  // scale of a Cauchy loss; 0: plain least squares
  int iterations = 100;
  int threads = 1;
  const Progress* progress = nullptr;  // polled for a cancel
};

LensMask lensMask(LensFamily family);

// The views' used corners only. False if Ceres found no usable solution or was cancelled.
bool solveLens(const SolverData& data, std::span<const std::size_t> views, SolverState& state,
               const SolveOptions& options);

// Predicted minus observed, pixels.
Eigen::Vector2d residualOf(const SolverState& state, const SolverCorner& corner,
                           const PoseVector& pose);
// In the camera frame, metres.
Eigen::Vector3d pointOf(const SolverState& state, const SolverCorner& corner,
                        const PoseVector& pose);
// Of the used corners' coordinates, from their median magnitude: 1.4826 MAD.
double robustSigma(const SolverData& data, std::span<const std::size_t> views,
                   const SolverState& state);

struct LensStatistics {
  Eigen::MatrixXd covariance;  // of the lens, 18 x 18, poses and board marginalised
  double sigma = 0;            // of a corner's coordinate, pixels
  double rms = 0;              // of the residuals' coordinates, pixels
  int corners = 0;
  // By how much the views' pulls on the parameters exceed what independent corner noise explains;
  // a ratio of variances, at least 1, and contained in the covariance.
  double overdispersion = 1;
};
LensStatistics lensStatistics(const SolverData& data, std::span<const std::size_t> views,
                              const SolverState& state, const LensMask& mask, bool warp);

// A first lens and the poses of all views from nothing. Views that no lens can place are set
// unused. False if no view is left.
bool seedLens(SolverData& data, SolverState& state);

// The lens with the largest field for which it can be inverted, at most that of the image's
// farthest corner. Fails where not even a degree of it can.
Result<std::shared_ptr<const FisheyeModel>> lensModel(const SolverData& data,
                                                      const SolverState& state,
                                                      const LensUncertainty& uncertainty);

}  // namespace lightsketch
