#include "calibration/lens/mrcal_check.h"

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <chrono>
#include <cmath>

#include "calibration/lens/mrcal_spline.h"

extern "C" {  // the header of 2.2 has no guard of its own
#include <mrcal/mrcal.h>
}

namespace lightsketch {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// The rotation that best turns `from` into `to`, in least squares (Kabsch 1976).
Eigen::Matrix3d bestRotation(const std::vector<Vector3d>& from, const std::vector<Vector3d>& to) {
  Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < from.size(); ++i) sum += to[i] * from[i].transpose();
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(sum, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Vector3d signs(1, 1, (svd.matrixU() * svd.matrixV().transpose()).determinant());
  return svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
}

}  // namespace

Result<void> MrcalCheckOptions::validate() const {
  if (knots >= 6 && knots <= 60) return {};
  return failure(ErrorCode::kInvalidArgument, "mrcal check: {} knots each way; give 6 to 60",
                 knots);
}

Result<MrcalCheck> checkWithMrcal(const LensCalibration& calibration, const BoardGeometry& board,
                                  const MrcalCheckOptions& options) {
  RETURN_IF_ERROR(options.validate());
  const FisheyeModel& model = *calibration.model;
  const auto start = std::chrono::steady_clock::now();
  // Knots only where there are corners: others would be held by regularisation alone.
  Angle farthest;
  for (const ViewResult& view : calibration.views) {
    for (const CornerResidual& corner : view.corners) {
      if (view.rejected.empty() && corner.rejected.empty()) {
        farthest = std::max(farthest, corner.fieldAngle);
      }
    }
  }
  const Angle field = std::min(model.maxFieldAngle(), farthest + Angle::degrees(3));
  ASSIGN_OR_RETURN(SplinedLens lens,
                   fitSpline([&](const Vector3d& v) { return model.project(v); }, model.width(),
                             model.height(), field, options.knots));

  // mrcal wants whole boards; a corner of negative weight is none.
  std::vector<mrcal_observation_board_t> observations;
  std::vector<mrcal_pose_t> frames;
  std::vector<mrcal_point3_t> pool;
  for (const ViewResult& view : calibration.views) {
    if (!view.rejected.empty()) continue;
    mrcal_observation_board_t observation{};
    observation.icam.intrinsics = 0;
    observation.icam.extrinsics = -1;
    observation.iframe = static_cast<int>(frames.size());
    observations.push_back(observation);
    const Eigen::AngleAxisd turn(view.cameraFromBoard.linear());
    const Vector3d rotation = turn.angle() * turn.axis();
    mrcal_pose_t pose{};
    for (int i = 0; i < 3; ++i) {
      pose.r.xyz[i] = rotation[i];
      pose.t.xyz[i] = view.cameraFromBoard.translation()[i];
    }
    frames.push_back(pose);
    const std::size_t first = pool.size();
    mrcal_point3_t none{};
    none.z = -1;
    pool.resize(first + static_cast<std::size_t>(board.cornerCount()), none);
    for (const CornerResidual& corner : view.corners) {
      if (!corner.rejected.empty()) continue;
      if (corner.column < 0 || corner.row < 0 || corner.column >= board.columns ||
          corner.row >= board.rows) {
        return failure(ErrorCode::kInvalidArgument,
                       "mrcal check: corner ({}, {}) is not on a board of {} x {}", corner.column,
                       corner.row, board.columns, board.rows);
      }
      mrcal_point3_t& point =
          pool[first + static_cast<std::size_t>(corner.row * board.columns + corner.column)];
      point.x = corner.pixel.x() - 0.5;
      point.y = corner.pixel.y() - 0.5;
      point.z = 1;
    }
  }
  const auto used = std::count_if(pool.begin(), pool.end(), [](const auto& p) { return p.z > 0; });
  if (frames.size() < 3) {
    return failure(ErrorCode::kInvalidArgument, "mrcal check: {} views; it needs 3 or more",
                   frames.size());
  }

  mrcal_lensmodel_t lensModel{};
  mrcal_lensmodel_from_name(&lensModel, lens.name().c_str());
  mrcal_calobject_warp_t warp{};
  warp.x2 = calibration.warpMetres.x();
  warp.y2 = calibration.warpMetres.y();
  const int imagerSize[2] = {lens.width, lens.height};
  mrcal_problem_selections_t selections{};
  // The core's place is taken by the knots: both would be free together.
  selections.do_optimize_intrinsics_distortions = true;
  selections.do_optimize_frames = true;
  selections.do_apply_regularization = true;
  const mrcal_problem_constants_t constants{0, 1e3};
  mrcal_stats_t stats{};
  // Poses and knots first, then the board's bend with them.
  for (const bool bend : {false, true}) {
    selections.do_optimize_calobject_warp = bend;
    stats = mrcal_optimize(nullptr, 0, nullptr, 0, lens.values.data(), nullptr, frames.data(),
                           nullptr, &warp, 1, 0, static_cast<int>(frames.size()), 0, 0,
                           observations.data(), nullptr, static_cast<int>(observations.size()), 0,
                           pool.data(), &lensModel, imagerSize, selections, &constants,
                           board.spacingMetres, board.columns, board.rows, false, false);
    if (!(stats.rms_reproj_error__pixels >= 0)) {
      return failure(ErrorCode::kInvalidArgument,
                     "mrcal check: mrcal did not converge from our result");
    }
  }

  MrcalCheck check;
  check.lens = lens.name();
  // By our own count: mrcal's rms includes the corners that are not there.
  double squares = 0;
  for (std::size_t i = 0; i < pool.size(); ++i) {
    if (!(pool[i].z > 0)) continue;
    const auto corners = static_cast<std::size_t>(board.cornerCount());
    const mrcal_pose_t& pose = frames[i / corners];
    const Vector3d rotation(pose.r.x, pose.r.y, pose.r.z);
    const Vector3d translation(pose.t.x, pose.t.y, pose.t.z);
    const int place = static_cast<int>(i % corners);
    const Vector3d onBoard =
        board.corner(place % board.columns, place / board.columns, {warp.x2, warp.y2});
    const Vector3d point =
        Eigen::AngleAxisd(rotation.norm(), rotation.stableNormalized()) * onBoard + translation;
    squares += (lens.project(point) - Vector2d(pool[i].x + 0.5, pool[i].y + 0.5)).squaredNorm();
  }
  check.residualPixels = std::sqrt(squares / (2 * static_cast<double>(used)));
  check.solveSeconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  std::vector<Vector3d> ours;
  std::vector<Vector3d> theirs;
  for (const Vector3d& v : capDirections(model.maxFieldAngle(), 4000)) {
    const auto pixel = model.project(v);
    if (!pixel || !model.covers(v)) continue;
    const auto seen = lens.unproject(*pixel);
    if (!seen) continue;
    ours.push_back(v);
    theirs.push_back(*seen);
  }
  if (ours.size() < 10) {
    return failure(ErrorCode::kInvalidArgument, "mrcal check: the covered field is empty");
  }
  const Eigen::Matrix3d turn = bestRotation(theirs, ours);
  std::vector<double> sums;
  std::vector<int> counts;
  double sum = 0;
  for (std::size_t i = 0; i < ours.size(); ++i) {
    const Vector3d turned = turn * theirs[i];
    const double error = std::atan2(turned.cross(ours[i]).norm(), turned.dot(ours[i]));
    sum += error * error;
    check.largest = std::max(check.largest, Angle::radians(error));
    const double off = std::atan2(ours[i].head<2>().norm(), ours[i].z());
    const auto bin = static_cast<std::size_t>(Angle::radians(off).degrees() / 5);
    if (bin >= sums.size()) {
      sums.resize(bin + 1, 0);
      counts.resize(bin + 1, 0);
    }
    sums[bin] += error * error;
    ++counts[bin];
  }
  check.rms = Angle::radians(std::sqrt(sum / static_cast<double>(ours.size())));
  for (std::size_t bin = 0; bin < sums.size(); ++bin) {
    check.byFieldAngle.push_back(Angle::radians(std::sqrt(sums[bin] / counts[bin])));
  }
  check.cameraModel = cameraModelText(
      lens, coveredPolygon(model),
      fmt::format("mrcal's lens from the corners of a lightsketch calibration: {} corners of {} "
                  "views, {:.3f} pixels rms per coordinate",
                  used, frames.size(), check.residualPixels));
  return check;
}

}  // namespace lightsketch
