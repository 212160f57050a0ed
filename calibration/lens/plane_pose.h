// Internal to calibration/lens: the pose of a flat board from the directions of its corners.
#pragma once

#include <Eigen/Geometry>
#include <optional>
#include <span>

namespace lightsketch {

struct PlanePose {
  Eigen::Isometry3d cameraFromBoard = Eigen::Isometry3d::Identity();
  double medianError = 0;  // radians between the directions and the board's corners
};

// Corners on a line, or fewer than 6: no plane.
bool spanPlane(std::span<const Eigen::Vector2d> points);

// Bearing-vector DLT: v x (H [X Y 1]) = 0 in least squares; nothing is divided by z, so directions
// beyond 90 degrees count as any other. `points`: on the board, metres; `bearings`: unit. Nothing
// where the points span no plane.
std::optional<PlanePose> planePose(std::span<const Eigen::Vector3d> bearings,
                                   std::span<const Eigen::Vector2d> points);

// The other pose that a narrow view can hardly tell apart: depths within the board negated.
// `centre`: of the corners seen, board frame.
Eigen::Isometry3d flippedPose(const Eigen::Isometry3d& cameraFromBoard,
                              const Eigen::Vector3d& centre);

}  // namespace lightsketch
