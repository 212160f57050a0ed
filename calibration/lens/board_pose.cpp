// boardPose(): one view of a known board through any calibrated camera.
#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <Eigen/Cholesky>
#include <cmath>

#include "calibration/lens/lens_calibration.h"
#include "calibration/lens/plane_pose.h"

namespace lightsketch {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

// Residual of a corner under exp(w) R, t + dt. The camera is known by its values alone, so its part
// of the derivative is numerical.
class CornerCost final : public ceres::SizedCostFunction<2, 6> {
 public:
  CornerCost(const CameraModel& model, const Isometry3d& pose, const Vector3d& corner,
             const Vector2d& pixel)
      : model_(model), pose_(pose), corner_(corner), pixel_(pixel) {}

  bool Evaluate(const double* const* parameters, double* residuals,
                double** jacobians) const override {
    using Jet = ceres::Jet<double, 6>;
    const Vector3d turned = pose_.linear() * corner_;
    const Jet start[3] = {Jet(turned.x()), Jet(turned.y()), Jet(turned.z())};
    Jet delta[6];
    for (int i = 0; i < 6; ++i) delta[i] = Jet(parameters[0][i], i);
    Jet moved[3];
    ceres::AngleAxisRotatePoint(delta, start, moved);
    Vector3d point;
    Eigen::Matrix<double, 3, 6> byPose;
    for (int i = 0; i < 3; ++i) {
      const Jet sum = moved[i] + delta[3 + i] + pose_.translation()[i];
      point[i] = sum.a;
      byPose.row(i) = sum.v.transpose();
    }
    const auto projected = model_.projectPoint(point);
    if (!projected) return false;
    Eigen::Map<Vector2d>(residuals, 2) = *projected - pixel_;
    if (!jacobians || !jacobians[0]) return true;
    Eigen::Matrix<double, 2, 3> byPoint;
    const double step = 1e-6 * point.norm();
    for (int i = 0; i < 3; ++i) {
      const auto ahead = model_.projectPoint(point + step * Vector3d::Unit(i));
      const auto behind = model_.projectPoint(point - step * Vector3d::Unit(i));
      if (ahead && behind) {
        byPoint.col(i) = (*ahead - *behind) / (2 * step);
      } else if (ahead) {  // at the rim of the field
        byPoint.col(i) = (*ahead - *projected) / step;
      } else if (behind) {
        byPoint.col(i) = (*projected - *behind) / step;
      } else {
        return false;
      }
    }
    using Jacobian = Eigen::Matrix<double, 2, 6, Eigen::RowMajor>;
    Eigen::Map<Jacobian>(jacobians[0], 2, 6) = byPoint * byPose;
    return true;
  }

 private:
  const CameraModel& model_;
  const Isometry3d pose_;
  const Vector3d corner_;
  const Vector2d pixel_;
};

struct Corners {
  std::vector<Vector3d> onBoard;
  std::vector<Vector2d> pixels;
};

struct Refined {
  Isometry3d pose;
  double cost;
};
std::optional<Refined> refine(const CameraModel& model, const Corners& corners,
                              const Isometry3d& start, double robustPixels) {
  // Ceres complains on standard error about a start that cannot be evaluated.
  for (const auto& corner : corners.onBoard) {
    if (!model.projectPoint(start * corner)) return std::nullopt;
  }
  double delta[6] = {};
  ceres::Problem problem;
  for (std::size_t i = 0; i < corners.pixels.size(); ++i) {
    problem.AddResidualBlock(new CornerCost(model, start, corners.onBoard[i], corners.pixels[i]),
                             new ceres::CauchyLoss(robustPixels), delta);
  }
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
  options.max_num_iterations = 100;
  options.function_tolerance = 1e-12;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (!summary.IsSolutionUsable()) return std::nullopt;
  const Vector3d w(delta[0], delta[1], delta[2]);
  Refined refined{start, summary.final_cost};
  if (w.norm() > 0) {
    refined.pose.linear() =
        Eigen::AngleAxisd(w.norm(), w.normalized()).toRotationMatrix() * start.linear();
  }
  refined.pose.translation() += Vector3d(delta[3], delta[4], delta[5]);
  return refined;
}

}  // namespace

Result<BoardPose> boardPose(const CameraModel& model, const BoardView& view,
                            const BoardGeometry& board, const Vector2d& warpMetres) {
  Corners corners;
  std::vector<Vector3d> bearings;
  std::vector<Vector2d> points;
  Vector3d centre = Vector3d::Zero();
  for (const auto& corner : view.corners) {
    if (corner.column < 0 || corner.row < 0 || corner.column >= board.columns ||
        corner.row >= board.rows) {
      return failure(ErrorCode::kInvalidArgument,
                     "board pose: {} has a corner in column {}, row {}, but the board has {} x {} "
                     "inner corners; give the board's true size",
                     view.name, corner.column, corner.row, board.columns, board.rows);
    }
    const auto bearing = model.unproject(corner.pixel);
    if (!bearing) continue;
    corners.onBoard.push_back(board.corner(corner.column, corner.row, warpMetres));
    corners.pixels.push_back(corner.pixel);
    bearings.push_back(*bearing);
    points.push_back(corners.onBoard.back().head<2>());
    centre += corners.onBoard.back();
  }
  const std::size_t count = points.size();
  if (count < 6) {
    return failure(ErrorCode::kInvalidArgument,
                   "board pose: {} shows {} corners within the lens's field, at least 6 are "
                   "needed; show more of the board",
                   view.name, count);
  }
  centre /= static_cast<double>(count);
  const auto first = planePose(bearings, points);
  if (!first) {
    return failure(ErrorCode::kInvalidArgument,
                   "board pose: the corners that {} shows lie on a line; show more of the board",
                   view.name);
  }
  // One pixel is far beyond a good corner's error and far below a wrong one's. The pose that a
  // narrow view mistakes for the true one is tried too; the better fit stands.
  constexpr double kRobustPixels = 1;
  auto best = refine(model, corners, first->cameraFromBoard, kRobustPixels);
  if (const auto other =
          refine(model, corners, flippedPose(first->cameraFromBoard, centre), kRobustPixels);
      other && (!best || other->cost < best->cost)) {
    best = other;
  }
  if (!best) {
    return failure(ErrorCode::kInvalidArgument,
                   "board pose: no pose explains {}; check the camera model and the board's size",
                   view.name);
  }
  if ((best->pose * centre).dot(best->pose.linear().col(2)) < 0) {
    return failure(ErrorCode::kInvalidArgument,
                   "board pose: the corners of {} are numbered as in a mirror; number them as seen "
                   "from the board's front",
                   view.name);
  }

  // Weights of the Cauchy loss keep wrong corners out of the covariance too.
  BoardPose result;
  result.cameraFromBoard = best->pose;
  Matrix6 information = Matrix6::Zero();
  double squares = 0;
  double weights = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const double zero[6] = {};
    const double* blocks[] = {zero};
    Vector2d residual;
    Eigen::Matrix<double, 2, 6, Eigen::RowMajor> jacobian;
    double* jacobians[] = {jacobian.data()};
    if (!CornerCost(model, best->pose, corners.onBoard[i], corners.pixels[i])
             .Evaluate(blocks, residual.data(), jacobians)) {
      continue;
    }
    const double weight = 1 / (1 + residual.squaredNorm() / (kRobustPixels * kRobustPixels));
    information += weight * jacobian.transpose() * jacobian;
    squares += weight * residual.squaredNorm();
    weights += weight;
  }
  result.residualPixels = std::sqrt(squares / (2 * weights));
  const double variance = squares / std::max(1.0, 2 * weights - 6);
  result.covariance = variance * information.ldlt().solve(Matrix6::Identity());
  return result;
}

}  // namespace lightsketch
