#include "calibration/pose/board_pose.h"

#include <ceres/ceres.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "calibration/lens/lens_calibration.h"
#include "calibration/pose/sight.h"
#include "capture/frame/median.h"

namespace lightsketch {
namespace {

using Eigen::Isometry3d;
using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::Vector3d;
using Matrix6d = Eigen::Matrix<double, 6, 6>;

constexpr int kFewestMoments = 3;
constexpr int kFewestCorners = 6;

struct SeenCorner {
  Vector3d onBoard;
  Sight sight;
  double pixelsPerSigma = 0;  // turns whitened residuals into pixels
};

struct SeenBoard {
  std::vector<SeenCorner> corners;
  Isometry3d cameraFromBoard = Isometry3d::Identity();  // seed
  double lensVariance = 0;                              // mean over corners, radians^2
};

// Corner of a board in the scene camera's picture.
struct SceneResidual {
  const SeenCorner& corner;
  const Matrix3d& board;
  template <class T>
  bool operator()(const T* boardPose, T* out) const {
    corner.sight.residual<T>(transformed<T>(board, boardPose, corner.onBoard.cast<T>()), out);
    return true;
  }
};

// Corner of a board in a source camera's picture.
struct SourceResidual {
  const SeenCorner& corner;
  const Matrix3d& board;
  const Matrix3d& camera;
  template <class T>
  bool operator()(const T* boardPose, const T* cameraPose, T* out) const {
    const auto point = transformed<T>(board, boardPose, corner.onBoard.cast<T>());
    corner.sight.residual<T>(transformedBack<T>(camera, cameraPose, point), out);
    return true;
  }
};

Result<SeenBoard> seenBoard(const RigCamera& camera, const BoardView& view,
                            const BoardPoseOptions& options) {
  if (static_cast<int>(view.corners.size()) < kFewestCorners) {
    return failure(ErrorCode::kInvalidArgument, "only {} corners of the board are seen by '{}'",
                   view.corners.size(), camera.name);
  }
  ASSIGN_OR_RETURN(const auto pose,
                   boardPose(*camera.model, view, options.board, options.warpMetres));
  SeenBoard seen;
  seen.cameraFromBoard = pose.cameraFromBoard;
  const Matrix2d pixels =
      options.cornerSigmaPixels * options.cornerSigmaPixels * Matrix2d::Identity();
  for (const auto& corner : view.corners) {
    auto ray = lampRay({}, *camera.model, corner.pixel, pixels);
    if (!ray) continue;  // outside the valid field
    const double lens = camera.model->directionCovariance(ray->direction).trace() / 2;
    const double all = ray->directionCovariance.trace() / 2;
    seen.lensVariance += lens;
    seen.corners.push_back(
        {options.board.corner(corner.column, corner.row, options.warpMetres), Sight::of(*ray),
         options.cornerSigmaPixels * std::sqrt(all / std::max(all - lens, 1e-300))});
  }
  if (static_cast<int>(seen.corners.size()) < kFewestCorners) {
    return failure(ErrorCode::kInvalidArgument,
                   "most corners lie outside the field of the lens of '{}'", camera.name);
  }
  seen.lensVariance /= static_cast<double>(seen.corners.size());
  return seen;
}

// Nothing where the board is seen edge-on.
std::optional<Eigen::Isometry3d> sceneFromCameraOver(const Eigen::Isometry3d& cameraFromBoard,
                                                     const Vector3d& centreOnBoard) {
  const Vector3d centre = cameraFromBoard * centreOnBoard;
  Vector3d z = cameraFromBoard.linear().col(2);
  if (z.dot(centre) > 0) z = -z;  // towards the camera
  const Vector3d x = Vector3d::UnitX() - z.x() * z;
  if (x.norm() < 0.1 || z.dot(-centre.normalized()) < 0.1) return std::nullopt;
  Eigen::Isometry3d cameraFromScene = Eigen::Isometry3d::Identity();
  cameraFromScene.linear() << x.normalized(), z.cross(x.normalized()), z;
  cameraFromScene.translation() = centre;
  return cameraFromScene.inverse();
}

double angleBetween(const Isometry3d& a, const Isometry3d& b) {
  return Eigen::AngleAxisd(a.linear().transpose() * b.linear()).angle();
}

// One moment of the solve.
struct Placed {
  std::size_t evidence = 0;
  SeenBoard scene;
  std::vector<std::optional<SeenBoard>> sources;
  PoseBlock board;
  bool used = true;
};

class BoardSolver {
 public:
  BoardSolver(std::vector<Placed> placed, std::vector<PoseBlock> cameras)
      : placed_(std::move(placed)), cameras_(std::move(cameras)) {}

  std::vector<Placed>& placed() { return placed_; }
  std::vector<PoseBlock>& cameras() { return cameras_; }

  // Twice, folded in between, so that the parameters end at their reference.
  bool solve() {
    for (int round = 0; round < 2; ++round) {
      ceres::Problem problem;
      build(problem);
      ceres::Solver::Options options;
      options.linear_solver_type = ceres::DENSE_SCHUR;
      options.max_num_iterations = 100;
      options.function_tolerance = 1e-12;
      options.logging_type = ceres::SILENT;
      auto* order = new ceres::ParameterBlockOrdering;
      for (auto& moment : placed_) {
        if (moment.used) order->AddElementToGroup(moment.board.parameters.data(), 0);
      }
      for (auto& camera : cameras_) order->AddElementToGroup(camera.parameters.data(), 1);
      options.linear_solver_ordering.reset(order);
      ceres::Solver::Summary summary;
      ceres::Solve(options, &problem, &summary);
      if (!summary.IsSolutionUsable()) return false;
      for (auto& moment : placed_) moment.board.fold();
      for (auto& camera : cameras_) camera.fold();
    }
    return true;
  }

  // Of each camera's pose; empty where it is not determined.
  std::vector<Matrix6d> covariances() {
    ceres::Problem problem;
    build(problem);
    ceres::Covariance::Options options;
    options.algorithm_type = ceres::SPARSE_QR;
    ceres::Covariance covariance(options);
    std::vector<std::pair<const double*, const double*>> blocks;
    for (const auto& camera : cameras_) {
      blocks.emplace_back(camera.parameters.data(), camera.parameters.data());
    }
    if (!covariance.Compute(blocks, &problem)) return {};
    std::vector<Matrix6d> result;
    for (const auto& camera : cameras_) {
      Matrix6d values;
      covariance.GetCovarianceBlock(camera.parameters.data(), camera.parameters.data(),
                                    values.data());
      result.push_back((values + values.transpose()) / 2);
    }
    return result;
  }

  // Sum of squares of a moment's residuals in sigmas and in pixels, and how many there are.
  struct Misfit {
    double squares = 0;
    double pixels = 0;
    int count = 0;
  };
  Misfit misfit(const Placed& moment) const {
    Misfit sum;
    const auto add = [&](const SeenCorner& corner, const Eigen::Vector2d& e) {
      sum.squares += e.squaredNorm();
      sum.pixels += e.squaredNorm() * corner.pixelsPerSigma * corner.pixelsPerSigma;
      sum.count += 2;
    };
    Eigen::Vector2d e = Eigen::Vector2d::Zero();
    for (const auto& corner : moment.scene.corners) {
      SceneResidual{corner, moment.board.reference}(moment.board.parameters.data(), e.data());
      add(corner, e);
    }
    for (std::size_t k = 0; k < cameras_.size(); ++k) {
      if (!moment.sources[k]) continue;
      for (const auto& corner : moment.sources[k]->corners) {
        SourceResidual{corner, moment.board.reference, cameras_[k].reference}(
            moment.board.parameters.data(), cameras_[k].parameters.data(), e.data());
        add(corner, e);
      }
    }
    return sum;
  }

 private:
  void build(ceres::Problem& problem) {
    for (auto& moment : placed_) {
      if (!moment.used) continue;
      double* board = moment.board.parameters.data();
      for (const auto& corner : moment.scene.corners) {
        problem.AddResidualBlock(new ceres::AutoDiffCostFunction<SceneResidual, 2, 6>(
                                     new SceneResidual{corner, moment.board.reference}),
                                 new ceres::HuberLoss(3), board);
      }
      for (std::size_t k = 0; k < cameras_.size(); ++k) {
        if (!moment.sources[k]) continue;
        for (const auto& corner : moment.sources[k]->corners) {
          problem.AddResidualBlock(
              new ceres::AutoDiffCostFunction<SourceResidual, 2, 6, 6>(
                  new SourceResidual{corner, moment.board.reference, cameras_[k].reference}),
              new ceres::HuberLoss(3), board, cameras_[k].parameters.data());
        }
      }
    }
  }

  std::vector<Placed> placed_;
  std::vector<PoseBlock> cameras_;
};

// The candidate closest to all others: a few wrong ones do not move it.
Isometry3d medianPose(const std::vector<Isometry3d>& candidates, double metresPerRadian) {
  std::size_t best = 0;
  double bestSum = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    double sum = 0;
    for (const auto& other : candidates) {
      sum += metresPerRadian * angleBetween(candidates[i], other) +
             (candidates[i].translation() - other.translation()).norm();
    }
    if (sum < bestSum) {
      bestSum = sum;
      best = i;
    }
  }
  return candidates[best];
}

Result<void> enoughMoments(const std::vector<Placed>& placed,
                           std::span<const RigCamera> sourceCameras) {
  for (std::size_t k = 0; k < sourceCameras.size(); ++k) {
    int moments = 0;
    for (const auto& moment : placed) moments += moment.used && moment.sources[k] ? 1 : 0;
    if (moments < kFewestMoments) {
      return failure(ErrorCode::kInvalidArgument,
                     "calibrate pose: only {} usable moments show the board to '{}' and the scene "
                     "camera at once; take at least {}, the board held still where both see it",
                     moments, sourceCameras[k].name, kFewestMoments);
    }
  }
  return {};
}

}  // namespace

Result<void> BoardPoseOptions::validate() const {
  if (board.columns < 2 || board.rows < 2 || !(board.spacingMetres > 0)) {
    return failure(ErrorCode::kInvalidArgument,
                   "calibrate pose: the board must have at least 2 x 2 corners a positive distance "
                   "apart");
  }
  if (!(cornerSigmaPixels > 0) || !(outlierSigmas > 1)) {
    return failure(
        ErrorCode::kInvalidArgument,
        "calibrate pose: the corner's sigma must be positive, the outlier limit above 1");
  }
  return {};
}

Result<CameraPose> sceneCameraFromFlatBoard(const RigCamera& sceneCamera, const BoardView& view,
                                            const BoardGeometry& board,
                                            const Eigen::Vector2d& warp) {
  ASSIGN_OR_RETURN(const auto seen, boardPose(*sceneCamera.model, view, board, warp));
  const Vector3d centreOnBoard(0.5 * (board.columns - 1) * board.spacingMetres,
                               0.5 * (board.rows - 1) * board.spacingMetres, 0);
  const auto found = sceneFromCameraOver(seen.cameraFromBoard, centreOnBoard);
  if (!found) {
    return failure(ErrorCode::kInvalidArgument,
                   "{}: the board at the subject is seen edge-on by the scene camera; lay it flat, "
                   "its front to the camera",
                   view.name);
  }
  CameraPose pose;
  pose.camera = sceneCamera.name;
  pose.sceneFromCamera = *found;

  // By differences: each of the board's six errors, in the camera frame.
  constexpr double kStep = 1e-6;
  Matrix6d jacobian;
  for (int i = 0; i < 6; ++i) {
    Eigen::Isometry3d moved = seen.cameraFromBoard;
    if (i < 3) {
      moved.linear() = Eigen::AngleAxisd(kStep, Vector3d::Unit(i)) * moved.linear();
    } else {
      moved.translation()[i - 3] += kStep;
    }
    const auto there = sceneFromCameraOver(moved, centreOnBoard).value_or(*found);
    const Eigen::AngleAxisd turn(there.linear() * found->linear().transpose());
    jacobian.col(i) << turn.axis() * turn.angle() / kStep,
        (there.translation() - found->translation()) / kStep;
  }
  pose.covariance = jacobian * seen.covariance * jacobian.transpose();
  return pose;
}

Result<PoseCalibration> poseFromBoards(const RigCamera& sceneCamera,
                                       std::span<const RigCamera> sourceCameras,
                                       const CameraPose& sceneCameraPose,
                                       std::span<const BoardMoment> moments,
                                       const BoardPoseOptions& options, Progress& progress) {
  RETURN_IF_ERROR(options.validate());
  PoseCalibration result;
  std::vector<Placed> placed;
  for (const auto& moment : moments) {
    if (progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
    result.evidence.push_back({moment.name, {}, 0});
    std::string& reason = result.evidence.back().rejected;
    Placed place;
    place.evidence = result.evidence.size() - 1;
    auto scene = seenBoard(sceneCamera, moment.scene, options);
    if (!scene) {
      reason = scene.error().message;
      continue;
    }
    place.scene = std::move(*scene);
    place.sources.resize(sourceCameras.size());
    bool any = false;
    for (std::size_t k = 0; k < sourceCameras.size() && k < moment.sources.size(); ++k) {
      if (!moment.sources[k]) continue;
      auto source = seenBoard(sourceCameras[k], *moment.sources[k], options);
      if (source) {
        place.sources[k] = std::move(*source);
        any = true;
      } else {
        reason = source.error().message;
      }
    }
    if (!any) {
      if (reason.empty()) reason = "no source camera sees the board";
      continue;
    }
    reason.clear();
    place.board = PoseBlock::of(place.scene.cameraFromBoard);
    placed.push_back(std::move(place));
    progress.update("boards", result.evidence.size(), moments.size());
  }

  // Each pair says where the source camera stands; the median of them starts the solve.
  std::vector<PoseBlock> cameras(sourceCameras.size());
  for (std::size_t k = 0; k < sourceCameras.size(); ++k) {
    std::vector<Isometry3d> candidates;
    double distance = 0;
    for (const auto& moment : placed) {
      if (!moment.sources[k]) continue;
      candidates.push_back(moment.scene.cameraFromBoard *
                           moment.sources[k]->cameraFromBoard.inverse());
      distance += moment.scene.cameraFromBoard.translation().norm();
    }
    if (candidates.empty()) continue;
    const double metresPerRadian = distance / static_cast<double>(candidates.size());
    const Isometry3d median = medianPose(candidates, metresPerRadian);
    cameras[k] = PoseBlock::of(median);
    // A pair that is far off would only drag the others.
    for (auto& moment : placed) {
      if (!moment.sources[k]) continue;
      const Isometry3d own =
          moment.scene.cameraFromBoard * moment.sources[k]->cameraFromBoard.inverse();
      const double degrees = Angle::radians(angleBetween(own, median)).degrees();
      const double metres = (own.translation() - median.translation()).norm();
      if (degrees < 15 && metres < 0.25 * metresPerRadian) continue;
      moment.sources[k].reset();
      auto& evidence = result.evidence[moment.evidence];
      evidence.rejected = fmt::format(
          "puts '{}' {:.1f} degrees and {:.0f} mm from where the other moments put it; the board "
          "moved between the pictures, or its numbering is mirrored",
          sourceCameras[k].name, degrees, 1000 * metres);
      moment.used = std::any_of(moment.sources.begin(), moment.sources.end(),
                                [](const auto& source) { return source.has_value(); });
      if (moment.used) evidence.rejected.clear();
    }
  }

  BoardSolver solver(std::move(placed), std::move(cameras));
  for (int round = 0;; ++round) {
    RETURN_IF_ERROR(enoughMoments(solver.placed(), sourceCameras));
    if (!solver.solve()) {
      return failure(ErrorCode::kInvalidArgument,
                     "calibrate pose: the boards cannot be brought together; check the board's "
                     "size and that both cameras' lenses are calibrated");
    }
    // The worst moment beyond the limit goes, then everything is solved again: its pull on the
    // others ends.
    std::vector<double> all;
    for (auto& moment : solver.placed()) {
      const auto misfit = solver.misfit(moment);
      double& sigmas = result.evidence[moment.evidence].residualSigmas;
      sigmas = std::sqrt(misfit.squares / std::max(1, misfit.count - 6));
      if (moment.used) all.push_back(sigmas);
    }
    const double limit = options.outlierSigmas * std::max(1.0, median(all));
    Placed* worst = nullptr;
    for (auto& moment : solver.placed()) {
      if (moment.used && result.evidence[moment.evidence].residualSigmas > limit &&
          (!worst || result.evidence[moment.evidence].residualSigmas >
                         result.evidence[worst->evidence].residualSigmas)) {
        worst = &moment;
      }
    }
    if (!worst) break;
    worst->used = false;
    auto& evidence = result.evidence[worst->evidence];
    evidence.rejected = fmt::format(
        "its corners are off by {:.1f} sigmas; the board moved between the pictures, or is not the "
        "one that was said",
        evidence.residualSigmas);
  }

  // Sums over what was used.
  double squares = 0;
  double pixels = 0;
  int count = 0;
  std::vector<double> lens(sourceCameras.size(), 0.0);
  std::vector<int> views(sourceCameras.size(), 0);
  double sceneLens = 0;
  double widest = 0;
  const Placed* first = nullptr;
  for (const auto& moment : solver.placed()) {
    if (!moment.used) continue;
    ++result.used;
    const auto misfit = solver.misfit(moment);
    squares += misfit.squares;
    pixels += misfit.pixels;
    count += misfit.count;
    sceneLens += moment.scene.lensVariance;
    for (std::size_t k = 0; k < sourceCameras.size(); ++k) {
      if (!moment.sources[k]) continue;
      lens[k] += moment.sources[k]->lensVariance;
      ++views[k];
    }
    if (!first) first = &moment;
    widest = std::max(widest, angleBetween(first->board.pose(), moment.board.pose()));
  }
  const int freedom = count - 6 * (result.used + static_cast<int>(sourceCameras.size()));
  result.residualSigmas = std::sqrt(squares / std::max(1, freedom));
  result.residualPixels = std::sqrt(2 * pixels / count);
  if (Angle::radians(widest).degrees() < 10) {
    result.warnings.push_back(
        fmt::format("the board was tilted by {:.0f} degrees at most; tilt it more from moment to "
                    "moment",
                    Angle::radians(widest).degrees()));
  }
  auto covariances = solver.covariances();
  if (covariances.empty()) {
    return failure(ErrorCode::kInvalidArgument,
                   "calibrate pose: the boards do not determine the cameras' poses; hold the board "
                   "at more places and tilts");
  }
  const double scale = std::max(1.0, result.residualSigmas * result.residualSigmas);
  result.rig.sceneCamera = sceneCameraPose;
  result.rig.sceneCamera.camera = sceneCamera.name;
  for (std::size_t k = 0; k < sourceCameras.size(); ++k) {
    CameraPose pose;
    pose.camera = sourceCameras[k].name;
    pose.sceneFromCamera = solver.cameras()[k].pose();
    pose.covariance = scale * covariances[k];
    // A lens is off by the same amount all over one board: its error averages over the boards, not
    // over the corners.
    pose.covariance.topLeftCorner<3, 3>() +=
        (lens[k] / (views[k] * views[k]) + sceneLens / (result.used * result.used)) *
        Matrix3d::Identity();
    result.rig.sourceCameras.push_back(inSceneFrame(result.rig.sceneCamera, pose));
  }
  return result;
}

}  // namespace lightsketch
