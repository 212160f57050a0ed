// Poses of source cameras from a board that scene camera and source cameras see at the same time.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "calibration/lens/board.h"
#include "calibration/pose/pose_calibration.h"
#include "capture/frame/progress.h"
#include "capture/frame/result.h"

namespace lightsketch {

// One board, held still, in the pictures of all cameras.
struct BoardMoment {
  std::string name;
  BoardView scene;
  std::vector<std::optional<BoardView>> sources;  // by source camera; nothing where not seen
};

struct BoardPoseOptions {
  BoardGeometry board;
  Eigen::Vector2d warpMetres = Eigen::Vector2d::Zero();
  double cornerSigmaPixels = 0.2;  // what a corner is expected to be off
  double outlierSigmas = 4;        // moments beyond this many expected sigmas rms are left out
  Result<void> validate() const;
};

// The scene camera in the scene frame where a board lies flat at the subject: origin in the board's
// centre, z along its normal towards the camera, x as right as the camera sees it.
Result<CameraPose> sceneCameraFromFlatBoard(const RigCamera& sceneCamera, const BoardView& view,
                                            const BoardGeometry& board,
                                            const Eigen::Vector2d& warpMetres);

// All boards and source cameras in one least-squares problem with a robust loss, angles weighted by
// pixels and lens. `sceneCameraPose`: the scene camera in the scene frame, with its covariance, as
// known from rig.json or from sceneCameraFromFlatBoard(). Fails with what to do for fewer than
// three usable moments of a source camera, or a board that hardly moved.
Result<PoseCalibration> poseFromBoards(const RigCamera& sceneCamera,
                                       std::span<const RigCamera> sourceCameras,
                                       const CameraPose& sceneCameraPose,
                                       std::span<const BoardMoment> moments,
                                       const BoardPoseOptions& options, Progress& progress);

}  // namespace lightsketch
