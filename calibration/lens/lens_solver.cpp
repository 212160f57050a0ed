#include "calibration/lens/lens_solver.h"

#include <ceres/ceres.h>
#include <ceres/normal_prior.h>
#include <ceres/rotation.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "calibration/lens/plane_pose.h"
#include "capture/frame/median.h"

namespace lightsketch {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr int kLens = FisheyeLayout::kCount;
constexpr int kBoard = 3;

// Predicted minus observed pixel of a corner. Derivatives of the lens are jets as wide as the
// parameters that are solved for: ten times faster than all at once where only poses move.
class CornerCost final : public ceres::SizedCostFunction<2, kLens, 6, kBoard> {
 public:
  CornerCost(const SolverCorner& corner, const LensMask& free) : corner_(corner) {
    for (std::size_t i = 0; i < free.size(); ++i) {
      if (free[i]) free_[static_cast<std::size_t>(count_++)] = static_cast<int>(i);
    }
  }

  bool Evaluate(const double* const* parameters, double* residuals,
                double** jacobians) const override {
    if (!jacobians) {
      double rotated[3];
      const auto onBoard = boardPoint(parameters[2]);
      ceres::AngleAxisRotatePoint(parameters[1], onBoard.data(), rotated);
      for (int i = 0; i < 3; ++i) rotated[i] += parameters[1][3 + i];
      project(parameters[0], parameters[0], rotated, residuals);
      return true;
    }
    if (count_ == 0) return differentiate<3>(parameters, residuals, jacobians);
    if (count_ <= 10) return differentiate<13>(parameters, residuals, jacobians);
    if (count_ <= 16) return differentiate<19>(parameters, residuals, jacobians);
    return differentiate<3 + kLens>(parameters, residuals, jacobians);
  }

 private:
  Vector3d boardPoint(const double* board) const {
    return {corner_.point.x(), corner_.point.y() * (1 + board[2]),
            board[0] * corner_.bulge.x() + board[1] * corner_.bulge.y()};
  }

  template <class T>
  void project(const double* values, const T* lens, const T* point, T* residual) const {
    const bool pupilFree =
        count_ > 0 && free_[static_cast<std::size_t>(count_ - 1)] >= FisheyeLayout::kPupil;
    if (pupilFree || values[FisheyeLayout::kPupil] != 0 || values[FisheyeLayout::kPupil + 1] != 0) {
      projectFisheyePoint(lens, point, residual);
    } else {
      projectFisheyeDirection(lens, point, residual);
    }
    residual[0] -= corner_.pixel.x();
    residual[1] -= corner_.pixel.y();
  }

  // Jets of `width`: the point's three coordinates first, then the free lens parameters.
  template <int width>
  bool differentiate(const double* const* parameters, double* residuals, double** jacobians) const {
    using Jet = ceres::Jet<double, width>;
    using Turn = ceres::Jet<double, 3>;
    const auto onBoard = boardPoint(parameters[2]);
    Turn w[3];
    Turn rotated[3];
    Turn x[3];
    for (int i = 0; i < 3; ++i) {
      w[i] = Turn(parameters[1][i], i);
      x[i] = Turn(onBoard[i]);
    }
    ceres::AngleAxisRotatePoint(w, x, rotated);
    Jet point[3];
    for (int i = 0; i < 3; ++i) point[i] = Jet(rotated[i].a + parameters[1][3 + i], i);
    Jet lens[kLens];
    for (int i = 0; i < kLens; ++i) lens[i] = Jet(parameters[0][i]);
    const int count = std::min(count_, width - 3);  // the same, but the compiler knows its bound
    for (int i = 0; i < count; ++i) lens[free_[static_cast<std::size_t>(i)]].v[3 + i] = 1;
    Jet residual[2];
    project(parameters[0], lens, point, residual);
    residuals[0] = residual[0].a;
    residuals[1] = residual[1].a;

    Eigen::Matrix<double, 2, 3> byPoint;
    byPoint << residual[0].v.template head<3>().transpose(),
        residual[1].v.template head<3>().transpose();
    if (jacobians[0]) {
      Eigen::Map<Eigen::Matrix<double, 2, kLens, Eigen::RowMajor>> byLens(jacobians[0]);
      byLens.setZero();
      for (int i = 0; i < count; ++i) {
        for (int axis = 0; axis < 2; ++axis) {
          byLens(axis, free_[static_cast<std::size_t>(i)]) = residual[axis].v[3 + i];
        }
      }
    }
    if (jacobians[1]) {
      Eigen::Map<Eigen::Matrix<double, 2, 6, Eigen::RowMajor>> byPose(jacobians[1]);
      Eigen::Matrix3d byTurn;
      for (int i = 0; i < 3; ++i) byTurn.row(i) = rotated[i].v.transpose();
      byPose << byPoint * byTurn, byPoint;
    }
    if (jacobians[2]) {
      Eigen::Map<Eigen::Matrix<double, 2, kBoard, Eigen::RowMajor>> byBoard(jacobians[2]);
      Eigen::Matrix3d ofBoard = Eigen::Matrix3d::Zero();  // columns: the board's parameters
      ofBoard(2, 0) = corner_.bulge.x();
      ofBoard(2, 1) = corner_.bulge.y();
      ofBoard(1, 2) = corner_.point.y();
      for (int i = 0; i < 3; ++i) {
        const Vector3d column = ofBoard.col(i);
        Vector3d turned;
        ceres::AngleAxisRotatePoint(parameters[1], column.data(), turned.data());
        byBoard.col(i) = byPoint * turned;
      }
    }
    return true;
  }

  SolverCorner corner_;
  std::array<int, kLens> free_{};
  int count_ = 0;
};

class CancelCallback final : public ceres::IterationCallback {
 public:
  explicit CancelCallback(const Progress* progress) : progress_(progress) {}
  ceres::CallbackReturnType operator()(const ceres::IterationSummary&) override {
    return progress_ && progress_->cancelled() ? ceres::SOLVER_ABORT : ceres::SOLVER_CONTINUE;
  }

 private:
  const Progress* progress_;
};

// Holds what `free` does not name.
template <std::size_t n>
void hold(ceres::Problem& problem, double* values, const std::array<bool, n>& free) {
  std::vector<int> constant;
  for (std::size_t i = 0; i < n; ++i) {
    if (!free[i]) constant.push_back(static_cast<int>(i));
  }
  if (constant.size() == n) {
    problem.SetParameterBlockConstant(values);
  } else if (!constant.empty()) {
    problem.SetManifold(values, new ceres::SubsetManifold(static_cast<int>(n), constant));
  }
}

// A lens law to begin with: radius over focal length and the series of its k.
struct LensLaw {
  double (*angle)(double radius);
  double (*radius)(double angle);
  double largestDegrees;
  std::array<double, 4> k;
};
const std::array<LensLaw, 4> kLaws{{
    {[](double r) { return r; }, [](double t) { return t; }, 130, {0, 0, 0, 0}},  // equidistant
    {[](double r) { return 2 * std::asin(std::min(r / 2, 1.0)); },
     [](double t) { return 2 * std::sin(t / 2); },
     130,
     {-1.0 / 24, 1.0 / 1920, -1.0 / 322560, 0}},  // equisolid
    {[](double r) { return 2 * std::atan(r / 2); },
     [](double t) { return 2 * std::tan(t / 2); },
     120,
     {1.0 / 12, 1.0 / 120, 17.0 / 20160, 31.0 / 362880}},  // stereographic
    {[](double r) { return std::atan(r); },
     [](double t) { return std::tan(t); },
     60,
     {1.0 / 3, 2.0 / 15, 17.0 / 315, 62.0 / 2835}},  // perspective
}};

std::vector<std::size_t> usedViews(const SolverData& data) {
  std::vector<std::size_t> views;
  for (std::size_t i = 0; i < data.views.size(); ++i) {
    if (data.views[i].used) views.push_back(i);
  }
  return views;
}

}  // namespace

PoseVector poseVector(const Eigen::Isometry3d& pose) {
  const Eigen::AngleAxisd turn(pose.linear());
  const Vector3d w = turn.angle() * turn.axis();
  const Vector3d t = pose.translation();
  return {w.x(), w.y(), w.z(), t.x(), t.y(), t.z()};
}

Eigen::Isometry3d poseFrom(const PoseVector& v) {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  const Vector3d w(v[0], v[1], v[2]);
  if (w.norm() > 0) pose.linear() = Eigen::AngleAxisd(w.norm(), w.normalized()).toRotationMatrix();
  pose.translation() = Vector3d(v[3], v[4], v[5]);
  return pose;
}

double priorWeight(int parameter) {
  if (parameter >= FisheyeLayout::kPupil) return 10;  // 3 cm at 0.3 px
  return parameter >= FisheyeLayout::kRadial ? 1 : 0;
}

LensMask lensMask(LensFamily family) {
  LensMask mask{};
  const bool rich = family == LensFamily::kFisheye624 || family == LensFamily::kFisheye624Pupil;
  const bool pupil =
      family == LensFamily::kKannalaBrandtPupil || family == LensFamily::kFisheye624Pupil;
  const auto free = [&](int first, int count) {
    for (int i = first; i < first + count; ++i) mask[static_cast<std::size_t>(i)] = true;
  };
  free(FisheyeLayout::kFocal, 4);
  free(FisheyeLayout::kRadial, rich ? 6 : 4);
  free(FisheyeLayout::kTangential, 2);
  if (rich) free(FisheyeLayout::kPrism, 4);
  if (pupil) free(FisheyeLayout::kPupil, 2);
  return mask;
}

bool solveLens(const SolverData& data, std::span<const std::size_t> views, SolverState& state,
               const SolveOptions& options) {
  ceres::Problem problem;
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  auto* lens = state.lens.data();
  auto* board = state.board.data();
  for (const std::size_t i : views) {
    double* pose = state.poses[i].data();
    for (const auto& corner : data.views[i].corners) {
      if (!corner.used) continue;
      problem.AddResidualBlock(
          new CornerCost(corner, options.lens),
          options.robustPixels > 0 ? new ceres::CauchyLoss(options.robustPixels) : nullptr, lens,
          pose, board);
    }
    if (problem.HasParameterBlock(pose)) ordering->AddElementToGroup(pose, 0);
  }
  if (problem.NumResidualBlocks() == 0) return false;
  ordering->AddElementToGroup(lens, 1);
  ordering->AddElementToGroup(board, 1);
  ceres::Matrix weights = ceres::Matrix::Zero(kLens, kLens);
  for (int i = 0; i < kLens; ++i) weights(i, i) = priorWeight(i);
  problem.AddResidualBlock(new ceres::NormalPrior(weights, VectorXd(Eigen::Map<const VectorXd>(
                                                               state.expected.data(), kLens))),
                           nullptr, lens);
  hold(problem, lens, options.lens);
  hold(problem, board, std::array<bool, kBoard>{options.warp, options.warp, options.aspect});

  ceres::Solver::Options solver;
  solver.linear_solver_type = ceres::DENSE_SCHUR;
  solver.linear_solver_ordering = ordering;
  solver.num_threads = options.threads;
  solver.max_num_iterations = options.iterations;
  solver.function_tolerance = 1e-8;
  solver.logging_type = ceres::SILENT;
  CancelCallback cancel(options.progress);
  solver.callbacks.push_back(&cancel);
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &problem, &summary);
  return summary.IsSolutionUsable();
}

Vector2d residualOf(const SolverState& state, const SolverCorner& corner, const PoseVector& pose) {
  Vector2d residual;
  const double* blocks[] = {state.lens.data(), pose.data(), state.board.data()};
  CornerCost(corner, {}).Evaluate(blocks, residual.data(), nullptr);
  return residual;
}

Vector3d pointOf(const SolverState& state, const SolverCorner& corner, const PoseVector& pose) {
  return poseFrom(pose) *
         Vector3d(corner.point.x(), corner.point.y() * (1 + state.board[2]),
                  state.board[0] * corner.bulge.x() + state.board[1] * corner.bulge.y());
}

double robustSigma(const SolverData& data, std::span<const std::size_t> views,
                   const SolverState& state) {
  std::vector<double> sizes;
  for (const std::size_t i : views) {
    for (const auto& corner : data.views[i].corners) {
      if (!corner.used) continue;
      const Vector2d residual = residualOf(state, corner, state.poses[i]);
      sizes.push_back(std::abs(residual.x()));
      sizes.push_back(std::abs(residual.y()));
    }
  }
  return sizes.empty() ? 0 : 1.4826 * median(sizes);  // of a normal distribution
}

LensStatistics lensStatistics(const SolverData& data, std::span<const std::size_t> views,
                              const SolverState& state, const LensMask& mask, bool warp) {
  std::vector<int> free;  // columns of lens and board together
  for (int i = 0; i < kLens; ++i) {
    if (mask[static_cast<std::size_t>(i)]) free.push_back(i);
  }
  const auto lensCount = static_cast<Eigen::Index>(free.size());
  if (warp) free.insert(free.end(), {kLens, kLens + 1});
  const auto count = static_cast<Eigen::Index>(free.size());

  // Each view's information on the shared parameters, its pose marginalised: a Schur complement.
  LensStatistics statistics;
  std::vector<MatrixXd> informations;
  std::vector<VectorXd> pulls;
  MatrixXd total = MatrixXd::Zero(count, count);
  double squares = 0;
  for (const std::size_t i : views) {
    MatrixXd shared = MatrixXd::Zero(count, count);
    Eigen::Matrix<double, 6, 6> own = Eigen::Matrix<double, 6, 6>::Zero();
    MatrixXd cross = MatrixXd::Zero(count, 6);
    VectorXd pull = VectorXd::Zero(count);
    for (const auto& corner : data.views[i].corners) {
      if (!corner.used) continue;
      Eigen::Matrix<double, 2, kLens, Eigen::RowMajor> byLens;
      Eigen::Matrix<double, 2, 6, Eigen::RowMajor> byPose;
      Eigen::Matrix<double, 2, kBoard, Eigen::RowMajor> byBoard;
      Vector2d residual;
      const double* blocks[] = {state.lens.data(), state.poses[i].data(), state.board.data()};
      double* jacobians[] = {byLens.data(), byPose.data(), byBoard.data()};
      CornerCost(corner, mask).Evaluate(blocks, residual.data(), jacobians);
      Eigen::Matrix<double, 2, kLens + kBoard> all;
      all << byLens, byBoard;
      const Eigen::Matrix<double, 2, Eigen::Dynamic> j = all(Eigen::all, free);
      shared += j.transpose() * j;
      cross += j.transpose() * byPose;
      own += byPose.transpose() * byPose;
      pull += j.transpose() * residual;
      squares += residual.squaredNorm();
      ++statistics.corners;
    }
    shared -= cross * own.ldlt().solve(cross.transpose());
    total += shared;
    informations.push_back(std::move(shared));
    pulls.push_back(std::move(pull));
  }
  for (Eigen::Index i = 0; i < lensCount; ++i) {
    const double weight = priorWeight(free[static_cast<std::size_t>(i)]);
    total(i, i) += weight * weight;
  }
  const double freedom = 2.0 * statistics.corners - static_cast<double>(count) -
                         6.0 * static_cast<double>(views.size());
  statistics.rms = std::sqrt(squares / std::max(1.0, 2.0 * statistics.corners));
  statistics.sigma = std::sqrt(squares / std::max(1.0, freedom));

  // Scaled to a unit diagonal: the parameters' units differ by ten orders of magnitude.
  const VectorXd scale = total.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  const MatrixXd scaled = scale.asDiagonal() * total * scale.asDiagonal();
  const MatrixXd inverse = scale.asDiagonal() *
                           scaled.ldlt().solve(MatrixXd::Identity(count, count)) *
                           scale.asDiagonal();
  // Pulls of views on the parameters against their information (the "sandwich" of Huber 1967, as
  // one number): what corners of one view have in common shows here and nowhere else. A view's pull
  // is diminished by its own share in the solution.
  double seen = 0;
  double explained = 0;
  for (std::size_t v = 0; v < pulls.size(); ++v) {
    const MatrixXd share = inverse * informations[v];
    seen += pulls[v].dot(inverse * pulls[v]);
    explained += share.trace() - share.cwiseProduct(share.transpose()).sum();
  }
  if (explained > 0 && statistics.sigma > 0) {
    statistics.overdispersion =
        std::max(1.0, seen / (explained * statistics.sigma * statistics.sigma));
  }
  const double variance = statistics.sigma * statistics.sigma * statistics.overdispersion;
  statistics.covariance = MatrixXd::Zero(kLens, kLens);
  for (Eigen::Index a = 0; a < lensCount; ++a) {
    for (Eigen::Index b = 0; b < lensCount; ++b) {
      statistics.covariance(free[static_cast<std::size_t>(a)], free[static_cast<std::size_t>(b)]) =
          variance * (inverse(a, b) + inverse(b, a)) / 2;
    }
  }
  return statistics;
}

bool seedLens(SolverData& data, SolverState& state) {
  const Vector2d centre(data.width / 2.0, data.height / 2.0);
  // A few dozen corners of a view tell as much about its pose here as all.
  struct Sample {
    std::vector<Vector2d> points;
    std::vector<Vector2d> offsets;
  };
  std::vector<Sample> samples(data.views.size());
  double edge = 0;
  for (std::size_t v = 0; v < data.views.size(); ++v) {
    const auto& corners = data.views[v].corners;
    const std::size_t step = std::max<std::size_t>(1, corners.size() / 40);
    for (std::size_t i = 0; i < corners.size(); i += step) {
      samples[v].points.push_back(corners[i].point);
      samples[v].offsets.push_back(corners[i].pixel - centre);
      edge = std::max(edge, samples[v].offsets.back().norm());
    }
  }
  const auto place = [&](const LensLaw& law, double focal) {
    std::vector<std::optional<PlanePose>> poses;
    for (const Sample& sample : samples) {
      std::vector<Vector3d> bearings;
      for (const Vector2d& offset : sample.offsets) {
        const double theta = law.angle(offset.norm() / focal);
        const Vector2d side = offset.stableNormalized() * std::sin(theta);
        bearings.emplace_back(side.x(), side.y(), std::cos(theta));
      }
      poses.push_back(planePose(bearings, sample.points));
    }
    return poses;
  };

  // Each law has its best focal length by the corners' errors in pixels; a short solve then tells
  // the laws apart.
  double least = INFINITY;
  SolverState best;
  std::vector<bool> bestPlaced;
  for (const LensLaw& law : kLaws) {
    double lawLeast = INFINITY;
    double lawFocal = 0;
    for (double degrees = 6; degrees < law.largestDegrees; degrees *= 1.1) {
      const double focal = edge / law.radius(degrees * std::numbers::pi / 180);
      std::vector<double> errors;
      for (const auto& pose : place(law, focal)) {
        if (pose) errors.push_back(pose->medianError * focal);
      }
      if (errors.empty()) continue;
      const double error = median(errors);
      if (error < lawLeast) {
        lawLeast = error;
        lawFocal = focal;
      }
    }
    if (!std::isfinite(lawLeast)) continue;

    SolverState trial;
    trial.lens[0] = trial.lens[1] = lawFocal;
    trial.lens[2] = centre.x();
    trial.lens[3] = centre.y();
    std::copy(law.k.begin(), law.k.end(), trial.lens.begin() + FisheyeLayout::kRadial);
    trial.expected = trial.lens;
    trial.poses.resize(data.views.size());
    const auto poses = place(law, lawFocal);
    std::vector<bool> placed(data.views.size());
    for (std::size_t v = 0; v < poses.size(); ++v) {
      placed[v] = poses[v].has_value();
      if (placed[v]) trial.poses[v] = poseVector(poses[v]->cameraFromBoard);
    }
    SolverData thin = data;
    std::vector<std::size_t> views;
    for (std::size_t v = 0; v < poses.size(); ++v) {
      if (!placed[v]) continue;
      views.push_back(v);
      auto& corners = thin.views[v].corners;
      const std::size_t step = std::max<std::size_t>(1, corners.size() / 40);
      for (std::size_t i = 0; i < corners.size(); ++i) corners[i].used = i % step == 0;
    }
    SolveOptions options;
    options.iterations = 15;
    options.robustPixels = std::max(1.0, 3 * robustSigma(thin, views, trial));
    if (!solveLens(thin, views, trial, options)) continue;
    for (int i = 0; i < FisheyeLayout::kRadial + 2; ++i) {
      options.lens[static_cast<std::size_t>(i)] = true;
    }
    options.robustPixels = std::max(1.0, 3 * robustSigma(thin, views, trial));
    if (!solveLens(thin, views, trial, options)) continue;
    const double error = robustSigma(thin, views, trial);
    if (error < least && trial.lens[0] > 0 && trial.lens[1] > 0) {
      least = error;
      best = trial;
      bestPlaced = placed;
    }
  }
  if (!std::isfinite(least)) return false;
  state = best;
  for (std::size_t v = 0; v < data.views.size(); ++v) {
    if (!bestPlaced[v]) data.views[v].used = false;
  }
  // A narrow view's pose may have settled in its other minimum.
  const double sigma = robustSigma(data, usedViews(data), state);
  for (const std::size_t v : usedViews(data)) {
    const std::array<std::size_t, 1> one{v};
    const double error = robustSigma(data, one, state);
    if (error < 2 * sigma) continue;
    SolverState flipped = state;
    Vector2d middle = Vector2d::Zero();
    for (const auto& corner : data.views[v].corners) {
      middle += corner.point / static_cast<double>(data.views[v].corners.size());
    }
    flipped.poses[v] =
        poseVector(flippedPose(poseFrom(state.poses[v]), {middle.x(), middle.y(), 0}));
    SolveOptions options;
    options.iterations = 30;
    options.robustPixels = 3 * sigma;
    if (solveLens(data, one, flipped, options) && robustSigma(data, one, flipped) < error) {
      state.poses[v] = flipped.poses[v];
    }
  }
  return true;
}

Result<std::shared_ptr<const FisheyeModel>> lensModel(const SolverData& data,
                                                      const SolverState& state,
                                                      const LensUncertainty& uncertainty) {
  FisheyeParameters parameters;
  parameters.setVector(Eigen::Map<const VectorXd>(state.lens.data(), kLens));
  parameters.width = data.width;
  parameters.height = data.height;
  // The angle at which the farthest corner of the image is reached.
  double farthest = 0;
  for (const double x : {0.0, static_cast<double>(data.width)}) {
    for (const double y : {0.0, static_cast<double>(data.height)}) {
      farthest = std::max(farthest, std::hypot(x - parameters.cx, y - parameters.cy));
    }
  }
  double high = 1;
  for (; high < 175; high += 0.5) {
    const double theta = high * std::numbers::pi / 180;
    double nearest = INFINITY;
    for (int i = 0; i < 8; ++i) {
      const double phi = i * std::numbers::pi / 4;
      const Vector3d direction(std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi),
                               std::cos(theta));
      Vector2d pixel;
      projectFisheyeDirection(state.lens.data(), direction.data(), pixel.data());
      nearest = std::min(nearest, (pixel - Vector2d(parameters.cx, parameters.cy)).norm());
    }
    if (nearest > farthest) break;
  }
  // create() tells whether the lens is invertible up to an angle.
  const auto fits = [&](double degrees) {
    parameters.maxFieldAngle = Angle::degrees(degrees);
    return FisheyeModel::create(parameters).has_value();
  };
  if (!fits(high)) {
    double low = 0;
    while (high - low > 0.05) {
      const double middle = (low + high) / 2;
      (fits(middle) ? low : high) = middle;
    }
    high = low;
  }
  if (high < 1) {
    return failure(ErrorCode::kInvalidArgument,
                   "lens calibration: the solved lens cannot be inverted; take more views, tilted "
                   "20 to 40 degrees and spread over the picture");
  }
  parameters.maxFieldAngle = Angle::degrees(high);
  return FisheyeModel::create(parameters, uncertainty);
}

}  // namespace lightsketch
