// From pictures of a board to a calibrated fisheye: seeds itself, solves with Ceres, throws out
// what does not fit and says why, and measures how far its result can be trusted.
#pragma once

#include <Eigen/Geometry>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "calibration/lens/board.h"
#include "calibration/model/camera_model.h"
#include "capture/frame/angle.h"
#include "capture/frame/progress.h"
#include "capture/frame/result.h"

namespace lightsketch {

enum class LensFamily {
  kKannalaBrandt,       // k0..k3, tangential
  kFisheye624,          // + k4, k5, thin prism
  kKannalaBrandtPupil,  // + moving pupil
  kFisheye624Pupil,
};
std::string describe(LensFamily family);  // "Kannala-Brandt + tangential"

struct LensCalibrationOptions {
  // Nothing: Kannala-Brandt, and a richer family only where split-half validation earns it.
  std::optional<LensFamily> family;
  bool solveWarp = true;
  double outlierSigmas = 4;  // corners beyond this many robust sigmas are thrown out
  int splits = 10;           // random halves of the views for the split-half difference; 0: none
  std::uint32_t seed = 1;    // of the splits
  Result<void> validate() const;
};

struct CornerResidual {
  int column = 0;
  int row = 0;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();     // observed
  Eigen::Vector2d residual = Eigen::Vector2d::Zero();  // predicted minus observed, pixels
  Angle fieldAngle;
  std::string rejected;  // why it was thrown out; empty if it was used
};

struct ViewResult {
  std::string name;
  std::string rejected;  // why the whole view was thrown out; empty if it was used
  Eigen::Isometry3d cameraFromBoard = Eigen::Isometry3d::Identity();
  std::vector<CornerResidual> corners;
};

// Differences between lenses solved from random halves of the views, after the best rotation, over
// the field that both halves cover.
struct SplitHalf {
  int splits = 0;
  Angle rms;                        // over all splits and directions
  Angle largest;                    // of any direction, rms over the splits
  Angle predicted;                  // rms of the same difference as the covariance predicts it
  std::vector<Angle> byFieldAngle;  // rms per 5 degrees of field angle, from 0; NaN where uncovered
};

struct FamilyTrial {
  LensFamily family = LensFamily::kKannalaBrandt;
  double heldOutPixels = 0;  // rms reprojection error of views that the solve did not see
  Angle splitHalf;
  bool chosen = false;
};

struct LensCalibration {
  std::shared_ptr<const FisheyeModel> model;  // with covariance, model error and covered field
  LensFamily family = LensFamily::kKannalaBrandt;
  Eigen::Vector2d warpMetres = Eigen::Vector2d::Zero();
  std::vector<ViewResult> views;
  int cornersUsed = 0;
  int viewsUsed = 0;
  double residualPixels = 0;  // rms per coordinate of the corners used
  SplitHalf splitHalf;
  std::vector<FamilyTrial> trials;    // empty if the family was given
  std::vector<std::string> advice;    // what to shoot next, for the user
  std::vector<std::string> warnings;  // "the edge of the field, beyond 74 degrees, is unknown"
  double solveSeconds = 0;            // of the final solve, splits and trials not counted
};

// `width` and `height`: of the pictures. Fails with kInvalidArgument and what to do about it for
// too few views, views that are all alike, a board of another size or numbering than was said.
// Thread-safe.
Result<LensCalibration> calibrateLens(std::span<const BoardView> views, const BoardGeometry& board,
                                      int width, int height, const LensCalibrationOptions& options,
                                      Progress& progress);

// Where one view of a known board stands, by a calibrated camera: bearing-vector DLT, then least
// squares with a robust loss. Fails for fewer than 6 corners or corners on a line.
struct BoardPose {
  Eigen::Isometry3d cameraFromBoard = Eigen::Isometry3d::Identity();
  // Of (rotation vector, translation) applied on the left: exp(w) R, t + dt; camera frame.
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();
  double residualPixels = 0;
};
Result<BoardPose> boardPose(const CameraModel& model, const BoardView& view,
                            const BoardGeometry& board,
                            const Eigen::Vector2d& warpMetres = Eigen::Vector2d::Zero());

}  // namespace lightsketch
