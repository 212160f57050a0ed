#include "calibration/lens/lens_calibration.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>
#include <thread>

#include "calibration/lens/lens_field.h"
#include "calibration/lens/lens_solver.h"
#include "calibration/lens/lens_validation.h"
#include "calibration/lens/plane_pose.h"

namespace lightsketch {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr std::size_t kFewestViews = 4;
constexpr std::size_t kFewestViewsToSplit = 8;
constexpr std::size_t kFewestCorners = 6;

// Where one view's corners lie, rms from their middle and against another view's, in pixels.
double pixelExtent(const BoardView& view) {
  Vector2d middle = Vector2d::Zero();
  for (const auto& corner : view.corners) middle += corner.pixel;
  middle /= static_cast<double>(view.corners.size());
  double sum = 0;
  for (const auto& corner : view.corners) sum += (corner.pixel - middle).squaredNorm();
  return std::sqrt(sum / static_cast<double>(view.corners.size()));
}

bool alike(const BoardView& a, const BoardView& b) {
  std::map<std::pair<int, int>, Vector2d> pixels;
  for (const auto& corner : a.corners) pixels[{corner.column, corner.row}] = corner.pixel;
  double sum = 0;
  int count = 0;
  for (const auto& corner : b.corners) {
    const auto found = pixels.find({corner.column, corner.row});
    if (found == pixels.end()) continue;
    sum += (found->second - corner.pixel).squaredNorm();
    ++count;
  }
  return count > 0 && std::sqrt(sum / count) < 0.05 * pixelExtent(a);
}

std::vector<std::size_t> usedViews(const SolverData& data) {
  std::vector<std::size_t> views;
  for (std::size_t i = 0; i < data.views.size(); ++i) {
    if (data.views[i].used) views.push_back(i);
  }
  return views;
}

// The solve as it goes on: data with what is thrown out, state, and why.
class Calibration {
 public:
  Calibration(std::span<const BoardView> views, const BoardGeometry& board, int width, int height,
              const LensCalibrationOptions& options, Progress& progress)
      : input_(views), board_(board), options_(options), progress_(progress) {
    data_.width = width;
    data_.height = height;
    threads_ = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  }

  Result<LensCalibration> run();

 private:
  Result<void> readViews();
  Result<void> seed();
  Result<void> checkBoard();
  bool solve(const LensMask& mask, double robustPixels, bool warp);
  // Solves and throws out corners until both agree.
  Result<void> solveAndReject(const LensMask& mask);
  Result<LensFamily> chooseFamily(std::vector<FamilyTrial>& trials);
  Result<LensCalibration> finish(LensFamily family, double solveSeconds);
  Result<void> requireViews() const;
  Result<void> requireNotCancelled() const {
    if (!progress_.cancelled()) return {};
    return failure(ErrorCode::kCancelled, "lens calibration: cancelled");
  }

  std::span<const BoardView> input_;
  const BoardGeometry& board_;
  const LensCalibrationOptions& options_;
  Progress& progress_;
  int threads_ = 1;
  SolverData data_;
  SolverState state_;
  std::vector<std::string> viewReasons_;
};

Result<void> Calibration::requireViews() const {
  const auto used = usedViews(data_).size();
  if (used >= kFewestViews) return {};
  std::string first;
  for (std::size_t v = 0; v < viewReasons_.size() && first.empty(); ++v) {
    if (!viewReasons_[v].empty()) {
      first = fmt::format(" ({}: {})", input_[v].name, viewReasons_[v]);
    }
  }
  return failure(ErrorCode::kInvalidArgument,
                 "lens calibration: {} of {} views can be used{}, at least {} are needed; take 20 "
                 "to 40 pictures of the board, tilted, all over the picture",
                 used, input_.size(), first, kFewestViews);
}

Result<void> Calibration::readViews() {
  viewReasons_.resize(input_.size());
  for (std::size_t v = 0; v < input_.size(); ++v) {
    SolverView view;
    std::vector<Vector2d> points;
    for (const auto& corner : input_[v].corners) {
      if (corner.column < 0 || corner.row < 0 || corner.column >= board_.columns ||
          corner.row >= board_.rows) {
        return failure(ErrorCode::kInvalidArgument,
                       "lens calibration: {} has a corner in column {}, row {}, but the board is "
                       "said to have {} x {} inner corners; give the board's true size",
                       input_[v].name, corner.column, corner.row, board_.columns, board_.rows);
      }
      if (!corner.pixel.allFinite()) {
        return failure(ErrorCode::kInvalidArgument,
                       "lens calibration: {} has a corner without a position", input_[v].name);
      }
      SolverCorner out;
      out.point = board_.corner(corner.column, corner.row).head<2>();
      out.bulge = {board_.corner(corner.column, corner.row, {1, 0}).z(),
                   board_.corner(corner.column, corner.row, {0, 1}).z()};
      out.pixel = corner.pixel;
      view.corners.push_back(out);
      points.push_back(out.point);
    }
    if (view.corners.size() < kFewestCorners) {
      viewReasons_[v] =
          fmt::format("{} corners, at least {} are needed", view.corners.size(), kFewestCorners);
      view.used = false;
    } else if (!spanPlane(points)) {
      viewReasons_[v] = "its corners lie on a line";
      view.used = false;
    }
    data_.views.push_back(std::move(view));
  }
  RETURN_IF_ERROR(requireViews());

  std::vector<std::size_t> distinct;
  for (const std::size_t v : usedViews(data_)) {
    if (std::ranges::none_of(distinct,
                             [&](std::size_t d) { return alike(input_[d], input_[v]); })) {
      distinct.push_back(v);
    }
  }
  if (distinct.size() < kFewestViews) {
    return failure(ErrorCode::kInvalidArgument,
                   "lens calibration: the {} views are all alike, only {} differ from one another; "
                   "move and tilt the board between pictures",
                   usedViews(data_).size(), distinct.size());
  }
  return {};
}

bool Calibration::solve(const LensMask& mask, double robustPixels, bool warp) {
  SolveOptions options;
  options.lens = mask;
  options.warp = warp;
  options.robustPixels = robustPixels;
  options.threads = threads_;
  options.progress = &progress_;
  return solveLens(data_, usedViews(data_), state_, options);
}

// From nothing to a Kannala-Brandt lens that the bulk of the corners agrees with.
Result<void> Calibration::seed() {
  const auto noFit = [&] {
    return failure(ErrorCode::kInvalidArgument,
                   "lens calibration: no lens fits these corners; check that the board really has "
                   "{} x {} inner corners (columns x rows), all of one size",
                   board_.columns, board_.rows);
  };
  if (!seedLens(data_, state_)) return noFit();
  for (std::size_t v = 0; v < data_.views.size(); ++v) {
    if (!data_.views[v].used && viewReasons_[v].empty()) {
      viewReasons_[v] = "no pose of the board explains it";
    }
  }
  const LensMask mask = lensMask(LensFamily::kKannalaBrandt);
  for (int stage = 0; stage < 2; ++stage) {
    const double scale = std::max(0.1, 3 * robustSigma(data_, usedViews(data_), state_));
    const bool solved = solve(mask, scale, stage > 0 && options_.solveWarp);
    RETURN_IF_ERROR(requireNotCancelled());
    if (!solved) return noFit();
  }
  RETURN_IF_ERROR(checkBoard());
  const double sigma = robustSigma(data_, usedViews(data_), state_);
  if (sigma > 0.004 * std::hypot(data_.width, data_.height)) return noFit();
  return {};
}

// Is the board what it was said to be?
Result<void> Calibration::checkBoard() {
  const auto views = usedViews(data_);
  const double sigma = robustSigma(data_, views, state_);

  // Squares that are no squares: free their aspect and see whether that explains the misfit.
  SolverState stretched = state_;
  SolveOptions options;
  options.lens = lensMask(LensFamily::kKannalaBrandt);
  options.aspect = true;
  options.warp = options_.solveWarp;
  options.robustPixels = std::max(0.1, 3 * sigma);
  options.threads = threads_;
  options.iterations = 30;
  if (solveLens(data_, views, stretched, options) &&
      robustSigma(data_, views, stretched) < 0.6 * sigma && std::abs(stretched.board[2]) > 0.01) {
    return failure(ErrorCode::kInvalidArgument,
                   "lens calibration: the board's squares are {:.3f} times as high as they are "
                   "wide; print the board at one scale and give its true columns x rows",
                   1 + stretched.board[2]);
  }

  std::vector<std::size_t> mirrored;
  for (const std::size_t v : views) {
    const auto pose = poseFrom(state_.poses[v]);
    Vector3d at = Vector3d::Zero();
    for (const auto& corner : data_.views[v].corners)
      at += pointOf(state_, corner, state_.poses[v]);
    if (at.dot(pose.linear().col(2)) < 0) mirrored.push_back(v);
  }
  const bool fits = sigma < 0.004 * std::hypot(data_.width, data_.height);
  if (fits && 2 * mirrored.size() > views.size()) {
    return failure(ErrorCode::kInvalidArgument,
                   "lens calibration: the corners of {} of {} views are numbered as in a mirror; "
                   "number columns left to right and rows top to bottom as seen from the board's "
                   "front, and do not flip the pictures",
                   mirrored.size(), views.size());
  }
  for (const std::size_t v : mirrored) {
    data_.views[v].used = false;
    viewReasons_[v] = "its corners are numbered as in a mirror";
  }
  return requireViews();
}

Result<void> Calibration::solveAndReject(const LensMask& mask) {
  for (int round = 0; round < 8; ++round) {
    // 0.02 px: no corner is better known, even where nearly all agree.
    const double sigma = std::max(0.02, robustSigma(data_, usedViews(data_), state_));
    bool changed = false;
    for (const std::size_t v : usedViews(data_)) {
      std::size_t used = 0;
      auto& corners = data_.views[v].corners;
      for (auto& corner : corners) {
        const double error = residualOf(state_, corner, state_.poses[v]).norm();
        const bool good = error <= options_.outlierSigmas * sigma;
        changed |= good != corner.used;
        corner.used = good;
        used += good;
      }
      if (used < kFewestCorners || 2 * used < corners.size()) {
        data_.views[v].used = false;
        viewReasons_[v] =
            fmt::format("{} of its {} corners do not fit", corners.size() - used, corners.size());
      }
    }
    RETURN_IF_ERROR(requireViews());
    if (!changed && round > 0) break;
    if (!solve(mask, 0, options_.solveWarp)) {
      RETURN_IF_ERROR(requireNotCancelled());
      return failure(ErrorCode::kInvalidArgument,
                     "lens calibration: the solve did not converge; take more views, tilted 20 to "
                     "40 degrees and spread over the picture");
    }
    RETURN_IF_ERROR(requireNotCancelled());
  }
  return {};
}

Result<LensFamily> Calibration::chooseFamily(std::vector<FamilyTrial>& trials) {
  const auto views = usedViews(data_);
  if (options_.family || views.size() < kFewestViewsToSplit) {
    return options_.family.value_or(LensFamily::kKannalaBrandt);
  }
  // One set of corners for all: those that the richest central lens agrees with.
  const SolverData before = data_;
  const SolverState start = state_;
  RETURN_IF_ERROR(solveAndReject(lensMask(LensFamily::kFisheye624)));
  const auto splits = randomHalves(usedViews(data_), 4, options_.seed);
  for (const LensFamily family : {LensFamily::kKannalaBrandt, LensFamily::kKannalaBrandtPupil,
                                  LensFamily::kFisheye624, LensFamily::kFisheye624Pupil}) {
    const LensMask mask = lensMask(family);
    state_ = start;
    if (!solve(mask, 0, options_.solveWarp)) continue;
    auto validation = validateHalves(data_, splits, state_, mask, options_.solveWarp, progress_);
    if (!validation) {
      RETURN_IF_ERROR(requireNotCancelled());
      continue;
    }
    trials.push_back({family, validation->heldOutPixels, validation->splitHalf.rms, false});
  }
  int corners = 0;
  for (const std::size_t v : usedViews(data_)) {
    corners += static_cast<int>(std::ranges::count_if(data_.views[v].corners, &SolverCorner::used));
  }
  data_ = before;
  state_ = start;
  // More parameters are earned by what views foretell of one another: held-out corners must become
  // likelier by more than chance lets them, kEarned per parameter in twice the log-likelihood, and
  // halves must agree nearly as well.
  constexpr double kEarned = 6;
  FamilyTrial* best = nullptr;
  for (FamilyTrial& trial : trials) {
    if (best) {
      const double gain = 2.0 * corners * 2 * std::log(best->heldOutPixels / trial.heldOutPixels);
      const auto more = std::ranges::count(lensMask(trial.family), true) -
                        std::ranges::count(lensMask(best->family), true);
      if (!(gain > kEarned * static_cast<double>(more)) ||
          trial.splitHalf.radians() > 1.5 * best->splitHalf.radians()) {
        continue;
      }
    }
    best = &trial;
  }
  if (!best) return LensFamily::kKannalaBrandt;
  best->chosen = true;
  return best->family;
}

Result<LensCalibration> Calibration::finish(LensFamily family, double solveSeconds) {
  const LensMask mask = lensMask(family);
  const auto views = usedViews(data_);
  const auto statistics = lensStatistics(data_, views, state_, mask, options_.solveWarp);
  LensCalibration result;
  result.family = family;
  result.solveSeconds = solveSeconds;
  result.warpMetres = {state_.board[0], state_.board[1]};
  result.cornersUsed = statistics.corners;
  result.viewsUsed = static_cast<int>(views.size());
  result.residualPixels = statistics.rms;

  LensUncertainty uncertainty;
  uncertainty.covariance = statistics.covariance;
  uncertainty.coveredField = coveredField(data_, views, state_);
  const double focalSigma = std::sqrt(statistics.covariance(0, 0)) / state_.lens[0];
  if (!(focalSigma < 0.02)) {
    return failure(ErrorCode::kInvalidArgument,
                   "lens calibration: the views are too alike to tell the focal length ({:.0f} "
                   "percent uncertain); tilt the board 20 to 40 degrees in different directions",
                   100 * focalSigma);
  }

  ASSIGN_OR_RETURN(result.model, lensModel(data_, state_, uncertainty));
  double modelVariance =
      std::pow(residualPattern(data_, views, state_, *result.model, statistics.sigma).radians(), 2);
  if (options_.splits > 0 && views.size() >= kFewestViewsToSplit) {
    ASSIGN_OR_RETURN(const auto validation,
                     validateHalves(data_, randomHalves(views, options_.splits, options_.seed),
                                    state_, mask, options_.solveWarp, progress_));
    result.splitHalf = validation.splitHalf;
    // The difference of two halves has four times the variance of the whole; per axis, half of it.
    const double excess = std::pow(result.splitHalf.rms.radians(), 2) -
                          std::pow(result.splitHalf.predicted.radians(), 2);
    modelVariance += std::max(0.0, excess) / 8;
  }
  uncertainty.modelError = Angle::radians(std::sqrt(modelVariance));
  ASSIGN_OR_RETURN(result.model, lensModel(data_, state_, uncertainty));

  const double sigma = std::max(0.02, robustSigma(data_, views, state_));
  for (std::size_t v = 0; v < data_.views.size(); ++v) {
    ViewResult view;
    view.name = input_[v].name;
    view.rejected = viewReasons_[v];
    const bool posed = data_.views[v].used || state_.poses[v] != PoseVector{};
    if (posed) view.cameraFromBoard = poseFrom(state_.poses[v]);
    for (std::size_t i = 0; i < input_[v].corners.size(); ++i) {
      const auto& seen = input_[v].corners[i];
      const auto& corner = data_.views[v].corners[i];
      CornerResidual out;
      out.column = seen.column;
      out.row = seen.row;
      out.pixel = seen.pixel;
      if (posed) {
        out.residual = residualOf(state_, corner, state_.poses[v]);
        const Vector3d p = pointOf(state_, corner, state_.poses[v]);
        out.fieldAngle = Angle::radians(std::atan2(std::hypot(p.x(), p.y()), p.z()));
      }
      if (!view.rejected.empty()) {
        out.rejected = "its view was thrown out";
      } else if (!corner.used) {
        out.rejected = fmt::format("{:.1f} px off, {:.0f} sigmas", out.residual.norm(),
                                   out.residual.norm() / sigma);
      }
      view.corners.push_back(std::move(out));
    }
    result.views.push_back(std::move(view));
  }

  auto field = adviseOnField(data_, views, state_, *result.model);
  result.advice = std::move(field.advice);
  result.warnings = std::move(field.warnings);
  if (views.size() < kFewestViewsToSplit) {
    result.warnings.push_back(
        fmt::format("{} views are too few to check the lens on views that it did not see: take at "
                    "least {}",
                    views.size(), kFewestViewsToSplit));
  }
  return result;
}

Result<LensCalibration> Calibration::run() {
  using Clock = std::chrono::steady_clock;
  const auto seconds = [](Clock::duration d) { return std::chrono::duration<double>(d).count(); };
  auto start = Clock::now();
  progress_.update("solving", 0, 1);
  RETURN_IF_ERROR(readViews());
  RETURN_IF_ERROR(seed());
  RETURN_IF_ERROR(solveAndReject(lensMask(LensFamily::kKannalaBrandt)));
  double solving = seconds(Clock::now() - start);

  std::vector<FamilyTrial> trials;
  ASSIGN_OR_RETURN(const auto family, chooseFamily(trials));
  start = Clock::now();
  if (family != LensFamily::kKannalaBrandt) RETURN_IF_ERROR(solveAndReject(lensMask(family)));
  solving += seconds(Clock::now() - start);
  progress_.update("solving", 1, 1);
  ASSIGN_OR_RETURN(auto result, finish(family, solving));
  result.trials = std::move(trials);
  return result;
}

}  // namespace

std::string describe(LensFamily family) {
  switch (family) {
    case LensFamily::kKannalaBrandt:
      return "Kannala-Brandt + tangential";
    case LensFamily::kFisheye624:
      return "Fisheye624";
    case LensFamily::kKannalaBrandtPupil:
      return "Kannala-Brandt + tangential + moving pupil";
    case LensFamily::kFisheye624Pupil:
      return "Fisheye624 + moving pupil";
  }
  throw std::logic_error("unknown lens family");
}

Result<void> LensCalibrationOptions::validate() const {
  if (!(outlierSigmas >= 2 && outlierSigmas <= 100)) {
    return failure(ErrorCode::kInvalidArgument,
                   "lens calibration: outlierSigmas must lie between 2 and 100");
  }
  if (splits < 0 || splits > 1000) {
    return failure(ErrorCode::kInvalidArgument,
                   "lens calibration: splits must lie between 0 and 1000");
  }
  return {};
}

Result<LensCalibration> calibrateLens(std::span<const BoardView> views, const BoardGeometry& board,
                                      int width, int height, const LensCalibrationOptions& options,
                                      Progress& progress) {
  RETURN_IF_ERROR(options.validate());
  if (width <= 0 || height <= 0) {
    return failure(ErrorCode::kInvalidArgument,
                   "lens calibration: the pictures' size must be positive");
  }
  if (board.columns < 2 || board.rows < 2 || !(board.spacingMetres > 0)) {
    return failure(ErrorCode::kInvalidArgument,
                   "lens calibration: a board has at least 2 x 2 inner corners and a positive "
                   "spacing");
  }
  return Calibration(views, board, width, height, options, progress).run();
}

}  // namespace lightsketch
