#include "pipeline/validate/frame_check.h"

#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <numeric>
#include <optional>
#include <span>

#include "capture/frame/direction.h"
#include "capture/frame/median.h"
#include "capture/frame/srgb.h"
#include "pipeline/illumination/direction_interpolation.h"

namespace lightsketch {
namespace {

using Eigen::MatrixXf;
using Eigen::Vector3d;
using Eigen::Vector3f;
using Eigen::VectorXf;

constexpr std::size_t kNeighbours = 48;   // that predict a frame
constexpr std::size_t kScaleSample = 16;  // nearest of them, whose residuals say what is usual
constexpr std::size_t kSpreadSample = 24;
constexpr int kMostRounds = 100;
// Frames closer than this part of the usual spacing neither predict each other nor count twice: a
// hand at rest gives twins that share its shadow.
constexpr double kTwins = 0.4;
constexpr double kDerivativeStep = 0.02;  // radians
constexpr float kCauchy = 2.4f;           // scale of the robust loss for unit noise, 95 % efficient
constexpr float kHuber = 2.5f;            // residuals beyond are cut off in what predicts others
constexpr float kDark = -4;               // residual over scale of a cell in shadow
constexpr float kMostResidual = 20;
// A place where everything is off must not pass for usual: local scales and spreads count up to
// these factors of the set's own.
constexpr float kMostLocalScale = 2;
constexpr double kMostLocalSpread = 2.5;
// Nobody sees less than these: 1.25 % of brightness, 0.17 degrees.
constexpr float kLeastScale = 0.002f;  // of white: half a level of 8 bits
constexpr double kLeastGainSpread = 0.0125;
constexpr double kLeastShiftSpread = 0.003;
constexpr double kFarthestShift = 0.35;  // radians; a fit that goes farther has lost its way

template <class T>
T robustSigma(std::vector<T>& absolute) {  // from absolute deviations of a Gaussian
  return T(1.4826) * median(absolute);
}

// What the fit of one frame against its prediction found.
struct Fit {
  Eigen::Vector2d shift = Eigen::Vector2d::Zero();  // radians in the frame's tangent plane
  double gain = 0;                                  // relative change of the square root
  double gainAlone = 0;                             // the same with the shift held at 0
  double residual = 0;                              // log rms of what is left, in local scales
  double dark = 0;  // the worst connected dark patch: sum of residual over scale, per cell
  double darkPart = 0;
  std::array<double, 4> darkBox{};
};

// Centre and width of a figure among a frame's neighbours.
struct Usual {
  double centre = 0;
  double width = 1;
  double score(double value) const { return (value - centre) / width; }
};

struct Scores {
  Usual gain, gainAlone, shift, dark, residual;
  // Near the horizon a shift looks much like a gain: both ways of asking must agree.
  double exposure(const Fit& fit) const {
    return std::min(std::abs(gain.score(fit.gain)), std::abs(gainAlone.score(fit.gainAlone)));
  }
  double worst(const Fit& fit, const FrameCheckOptions& options) const {
    return std::max({exposure(fit) * options.threshold / options.exposureThreshold,
                     shift.score(fit.shift.norm()), dark.score(fit.dark),
                     residual.score(fit.residual)});
  }
};

class Checker {
 public:
  Checker(std::vector<Vector3d> directions, MatrixXf pictures, int columns,
          const FrameCheckOptions& options)
      : options_(options),
        directions_(std::move(directions)),
        n_(static_cast<int>(directions_.size())),
        columns_(columns),
        rows_(static_cast<int>(pictures.rows()) / columns),
        pictures_(std::move(pictures)),
        active_(directions_.size(), true),
        lamps_(directions_.size()),
        fits_(directions_.size()),
        scores_(directions_.size()) {
    const Eigen::Index m = pictures_.rows();
    for (MatrixXf* matrix : {&predicted_, &alongU_, &alongV_, &residual_, &fitted_, &scale_}) {
      matrix->resize(m, n_);
    }
    std::vector<float> values(pictures_.data(), pictures_.data() + pictures_.size());
    const auto white = values.begin() + static_cast<std::ptrdiff_t>(values.size() * 99 / 100);
    std::nth_element(values.begin(), white, values.end());
    leastScale_ = std::max(1e-6f, kLeastScale * *white);
    std::vector<double> reach;
    for (int i = 0; i < n_; ++i) {
      Lamp& lamp = lamps_[at(i)];
      lamp.u = direction(i).unitOrthogonal();
      lamp.v = direction(i).cross(lamp.u);
      lamp.nearest = byDistance(direction(i));
      reach.push_back(
          angleBetween(direction(i), direction(lamp.nearest[std::min(at(n_) - 1, kScaleSample)]))
              .radians());
    }
    // Of a regular grid, 16 neighbours lie within 2.5 spacings.
    spacing_ = median(reach) / 2.5;
  }

  // False if cancelled.
  bool run(Progress& progress) {
    for (rounds_ = 0; rounds_ < kMostRounds; ++rounds_) {
      if (progress.cancelled()) return false;
      progress.update("comparing frames with their neighbours", at(rounds_), at(rounds_) + 1);
      predictAndFit();
      if (!setAside()) break;
    }
    progress.update("comparing frames with their neighbours", at(rounds_) + 1, at(rounds_) + 1);
    return true;
  }

  FrameVerdict verdict(int i) const {
    const Fit& fit = fits_[at(i)];
    const Scores& usual = scores_[at(i)];
    const float cells = static_cast<float>(pictures_.rows());
    FrameVerdict verdict;
    verdict.direction = verdict.fitted = direction(i);
    verdict.exposureScore = usual.exposure(fit);
    verdict.directionScore = usual.shift.score(fit.shift.norm());
    verdict.shadowScore = usual.dark.score(fit.dark);
    verdict.residualScore = usual.residual.score(fit.residual);
    verdict.gain = gainOf(fit);
    verdict.gainSigma = 2 * usual.gain.width;
    verdict.shift = Angle::radians(fit.shift.norm());
    verdict.shiftSigma = Angle::radians(usual.shift.width);
    verdict.residual = residual_.col(i).norm() / std::sqrt(cells);
    verdict.residualFitted = fitted_.col(i).norm() / std::sqrt(cells);
    if (usual.worst(fit, options_) <= options_.threshold) return verdict;

    // A shift of several degrees leaves much in the first-order fit, so it is tried to its end
    // first. What then is dark or odd is neither gain's nor direction's fault.
    const bool odd = verdict.residualScore > options_.threshold;
    const bool shifted = verdict.directionScore > options_.threshold;
    if (shifted && followShift(i, verdict)) {
      verdict.fault = FrameFault::kDirection;
    } else if (verdict.shadowScore > options_.threshold) {
      verdict.fault = FrameFault::kShadow;
      verdict.darkPart = fit.darkPart;
      verdict.darkBox = fit.darkBox;
    } else if (odd) {
      verdict.fault = FrameFault::kOther;
    } else if (shifted) {
      verdict.fault = FrameFault::kDirection;
    } else {
      verdict.fault = FrameFault::kExposure;
      correctGain(i, verdict);
    }
    const Lamp& lamp = lamps_[at(i)];
    for (std::size_t k = 0; k < lamp.predictors.size(); ++k) {
      verdict.prediction.emplace_back(lamp.predictors[k],
                                      lamp.weights(static_cast<Eigen::Index>(k), 0));
    }
    return verdict;
  }

  Angle spacing() const { return Angle::radians(spacing_); }
  int rounds() const { return rounds_; }

 private:
  struct Lamp {
    Vector3d u, v;                // tangents
    std::vector<int> nearest;     // all frames by distance
    std::vector<int> predictors;  // the active ones that predict it, by distance
    // Of the predictors: for the prediction and its derivatives along u and v.
    Eigen::Matrix<float, Eigen::Dynamic, 3> weights;
  };

  static std::size_t at(int i) { return static_cast<std::size_t>(i); }
  const Vector3d& direction(int i) const { return directions_[at(i)]; }
  static double gainOf(const Fit& fit) { return (1 + fit.gain) * (1 + fit.gain); }

  std::vector<int> byDistance(const Vector3d& from) const {
    std::vector<double> cosine;
    for (const Vector3d& other : directions_) cosine.push_back(from.dot(other));
    std::vector<int> order(at(n_));
    std::iota(order.begin(), order.end(), 0);
    std::ranges::stable_sort(order, [&](int a, int b) { return cosine[at(a)] > cosine[at(b)]; });
    return order;
  }

  // Of frame i, lit from `from`; `nearest`: all frames by distance.
  std::vector<int> predictorsOf(int i, const Vector3d& from,
                                const std::vector<int>& nearest) const {
    const double tooClose = std::cos(kTwins * spacing_);
    std::vector<int> chosen;
    for (const int j : nearest) {
      const Vector3d& other = direction(j);
      if (j == i || !active_[at(j)] || from.dot(other) > tooClose) continue;
      const bool twin =
          std::ranges::any_of(chosen, [&](int k) { return direction(k).dot(other) > tooClose; });
      if (!twin) chosen.push_back(j);
      if (chosen.size() == kNeighbours) break;
    }
    return chosen;
  }

  // Weights of `predictors` for the picture at `direction` and its derivatives along u and v. The
  // settings hardly matter (see the README), so they are not chosen anew in every round.
  Eigen::Matrix<float, Eigen::Dynamic, 3> weightsAt(const Vector3d& direction, const Vector3d& u,
                                                    const Vector3d& v,
                                                    const std::vector<int>& predictors) const {
    std::vector<Vector3d> lights;
    for (const int j : predictors) lights.push_back(this->direction(j));
    InterpolationSettings settings;
    settings.kernel = InterpolationSettings::Kernel::kThinPlate;
    settings.trendDegree = 2;
    settings.nugget = 1e-3;
    const auto interpolator = DirectionInterpolator::create(lights, settings);
    Eigen::Matrix<float, Eigen::Dynamic, 3> weights(static_cast<Eigen::Index>(lights.size()), 3);
    if (!interpolator) return weights.setConstant(1.0f / static_cast<float>(lights.size()));
    const auto weightsOf = [&](const Vector3d& query) -> VectorXf {
      return interpolator->weights(query.normalized()).cast<float>();
    };
    constexpr double h = kDerivativeStep;
    weights.col(0) = weightsOf(direction);
    weights.col(1) =
        (weightsOf(direction + h * u) - weightsOf(direction - h * u)) / static_cast<float>(2 * h);
    weights.col(2) =
        (weightsOf(direction + h * v) - weightsOf(direction - h * v)) / static_cast<float>(2 * h);
    return weights;
  }

  Eigen::Matrix<float, Eigen::Dynamic, 3> weighted(const Lamp& lamp) const {
    MatrixXf pictures(pictures_.rows(), static_cast<Eigen::Index>(lamp.predictors.size()));
    for (std::size_t k = 0; k < lamp.predictors.size(); ++k) {
      pictures.col(static_cast<Eigen::Index>(k)) = edited_.col(lamp.predictors[k]);
    }
    return pictures * lamp.weights;
  }

  void predictAndFit() {
    tbb::parallel_for(0, n_, [&](int i) {
      Lamp& lamp = lamps_[at(i)];
      auto predictors = predictorsOf(i, direction(i), lamp.nearest);
      if (predictors == lamp.predictors) return;
      lamp.predictors = std::move(predictors);
      lamp.weights = weightsAt(direction(i), lamp.u, lamp.v, lamp.predictors);
    });
    // A neighbour's outlying cells are cut down to what is usual before they predict, three times:
    // pseudo-values of Huber's M-estimator (Huber 1981, 7.8), here of a local interpolation.
    constexpr int kEdits = 3;
    edited_ = pictures_;
    for (int edit = 0; edit < kEdits; ++edit) {
      tbb::parallel_for(0, n_, [&](int i) {
        const Eigen::Matrix<float, Eigen::Dynamic, 3> values = weighted(lamps_[at(i)]);
        predicted_.col(i) = values.col(0);
        alongU_.col(i) = values.col(1);
        alongV_.col(i) = values.col(2);
      });
      residual_ = pictures_ - predicted_;
      findScale(residual_);
      if (edit + 1 == kEdits) break;
      edited_ = predicted_ + residual_.cwiseMin(kHuber * scale_).cwiseMax(-kHuber * scale_);
    }
    // What is left by the fit is much smaller where hands wobble: its own scale, then again.
    constexpr int kFits = 3;
    for (int pass = 0; pass < kFits; ++pass) {
      tbb::parallel_for(0, n_, [&](int i) { fit(i); });
      findScale(fitted_);
    }
    tbb::parallel_for(0, n_, [&](int i) {
      const VectorXf scaled = fitted_.col(i).cwiseQuotient(scale_.col(i));
      weigh(scaled, fits_[at(i)]);
    });
    findUsual();
  }

  // What residual is usual for a cell: among the neighbours, held between parts of the cell's own
  // over all frames and of the whole picture's.
  void findScale(const MatrixXf& residual) {
    const int m = static_cast<int>(residual.rows());
    std::vector<float> ofCell(at(m));
    tbb::parallel_for(0, m, [&](int c) {
      std::vector<float> values;
      for (int j = 0; j < n_; ++j) {
        if (active_[at(j)]) values.push_back(std::abs(residual(c, j)));
      }
      ofCell[at(c)] = robustSigma(values);
    });
    auto copy = ofCell;
    const float all = median(copy);
    tbb::parallel_for(0, n_, [&](int i) {
      const auto& predictors = lamps_[at(i)].predictors;
      std::vector<float> values;
      for (int c = 0; c < m; ++c) {
        values.clear();
        for (std::size_t k = 0; k < std::min(kScaleSample, predictors.size()); ++k) {
          values.push_back(std::abs(residual(c, predictors[k])));
        }
        const float cell = ofCell[at(c)];
        const float local = std::min(robustSigma(values), kMostLocalScale * std::max(cell, all));
        scale_(c, i) =
            std::max(leastScale_, std::sqrt(local * local + 0.25f * (cell * cell + all * all)));
      }
    });
  }

  // Gain and shift that explain the picture best: picture = predicted (1 + gain) + along . shift,
  // Cauchy's loss, by reweighting.
  template <int Unknowns>
  Eigen::Matrix<float, Unknowns, 1> solve(
      const Eigen::Matrix<float, Eigen::Dynamic, Unknowns>& design, const VectorXf& target,
      VectorXf& left) const {
    using Solution = Eigen::Matrix<float, Unknowns, 1>;
    Solution x = Solution::Zero();
    left = target;
    for (int step = 0; step < 8; ++step) {
      // From the frame's own spread down to the usual one, or a large gain would be taken for
      // outliers beside the few cells that it leaves alone.
      std::vector<float> sizes(left.data(), left.data() + left.size());
      for (float& size : sizes) size = std::abs(size);
      const float scale = kCauchy * std::max(1.0f, robustSigma(sizes));
      const VectorXf weight = (1 + (left.array() / scale).square()).inverse();
      const Eigen::Matrix<float, Unknowns, Unknowns> normal =
          design.transpose() * weight.asDiagonal() * design;
      const Solution right = design.transpose() * weight.cwiseProduct(target);
      x = normal.template cast<double>()
              .ldlt()
              .solve(right.template cast<double>())
              .template cast<float>();
      if (!x.allFinite()) x.setZero();
      left = target - design * x;
    }
    return x;
  }

  void fit(int i) {
    const VectorXf inverse = scale_.col(i).cwiseInverse();
    Eigen::Matrix<float, Eigen::Dynamic, 3> design(pictures_.rows(), 3);
    design << predicted_.col(i).cwiseProduct(inverse), alongU_.col(i).cwiseProduct(inverse),
        alongV_.col(i).cwiseProduct(inverse);
    const VectorXf target = residual_.col(i).cwiseProduct(inverse);
    VectorXf left;
    fits_[at(i)].gainAlone = solve<1>(design.col(0), target, left)[0];
    const Vector3f x = solve(design, target, left);
    fits_[at(i)].gain = x[0];
    fits_[at(i)].shift = x.tail<2>().cast<double>();
    fitted_.col(i) = left.cwiseProduct(scale_.col(i));
  }

  // Size of what is left, and its worst connected dark patch.
  void weigh(const VectorXf& scaled, Fit& fit) const {
    const auto cells = static_cast<double>(scaled.size());
    fit.residual = std::log(
        scaled.cwiseMin(kMostResidual).cwiseMax(-kMostResidual).norm() / std::sqrt(cells) + 1e-6);
    fit.dark = 0;
    std::vector<char> dark(at(static_cast<int>(scaled.size())));
    for (Eigen::Index c = 0; c < scaled.size(); ++c)
      dark[at(static_cast<int>(c))] = scaled[c] < kDark;
    std::vector<int> stack;
    for (int start = 0; start < static_cast<int>(scaled.size()); ++start) {
      if (!dark[at(start)]) continue;
      double sum = 0;
      int count = 0;
      int left = columns_, right = 0, top = rows_, bottom = 0;
      dark[at(start)] = false;
      stack.assign(1, start);
      const auto visit = [&](int x, int y) {
        if (x < 0 || y < 0 || x >= columns_ || y >= rows_ || !dark[at(y * columns_ + x)]) return;
        dark[at(y * columns_ + x)] = false;
        stack.push_back(y * columns_ + x);
      };
      while (!stack.empty()) {
        const int cell = stack.back();
        stack.pop_back();
        const int x = cell % columns_;
        const int y = cell / columns_;
        sum += std::min(kMostResidual, -scaled[cell]);
        ++count;
        left = std::min(left, x);
        right = std::max(right, x);
        top = std::min(top, y);
        bottom = std::max(bottom, y);
        visit(x - 1, y);
        visit(x + 1, y);
        visit(x, y - 1);
        visit(x, y + 1);
      }
      if (sum / cells <= fit.dark) continue;
      fit.dark = sum / cells;
      fit.darkPart = count / cells;
      fit.darkBox = {static_cast<double>(left) / columns_, static_cast<double>(top) / rows_,
                     static_cast<double>(right + 1 - left) / columns_,
                     static_cast<double>(bottom + 1 - top) / rows_};
    }
  }

  // A figure's usual value and width for every frame, from its neighbours and the whole set.
  template <class Get, class Put>
  void findUsual(Get get, bool centred, double sigmaOfMedian, double least, Put put) {
    std::vector<double> values;
    const auto centreAndWidth = [&]() -> Usual {
      Usual usual;
      auto copy = values;
      if (centred) usual.centre = median(copy);
      for (double& value : values) value = std::abs(value - usual.centre);
      usual.width = sigmaOfMedian * median(values);
      return usual;
    };
    for (int j = 0; j < n_; ++j) {
      if (active_[at(j)]) values.push_back(get(fits_[at(j)]));
    }
    const Usual all = centreAndWidth();
    for (int i = 0; i < n_; ++i) {
      values.clear();
      const auto& predictors = lamps_[at(i)].predictors;
      for (std::size_t k = 0; k < std::min(kSpreadSample, predictors.size()); ++k) {
        values.push_back(get(fits_[at(predictors[k])]));
      }
      const Usual local = centreAndWidth();
      const double most = kMostLocalSpread * all.width;
      Usual usual;
      usual.centre = std::clamp(local.centre, all.centre - most, all.centre + most);
      usual.width = std::hypot(std::min(local.width, most), 0.5 * all.width, least);
      put(scores_[at(i)], usual);
    }
  }

  void findUsual() {
    constexpr double kGaussian = 1.4826;
    constexpr double kRayleigh = 1 / 1.1774;  // of the length of a vector of two Gaussians
    findUsual([](const Fit& f) { return f.gain; }, true, kGaussian, kLeastGainSpread / 2,
              [](Scores& s, const Usual& usual) { s.gain = usual; });
    findUsual([](const Fit& f) { return f.gainAlone; }, true, kGaussian, kLeastGainSpread / 2,
              [](Scores& s, const Usual& usual) { s.gainAlone = usual; });
    findUsual([](const Fit& f) { return f.shift.norm(); }, false, kRayleigh, kLeastShiftSpread,
              [](Scores& s, const Usual& usual) { s.shift = usual; });
    findUsual([](const Fit& f) { return f.dark; }, true, kGaussian, 0.02,
              [](Scores& s, const Usual& usual) { s.dark = usual; });
    findUsual([](const Fit& f) { return f.residual; }, true, kGaussian, 0.05,
              [](Scores& s, const Usual& usual) { s.residual = usual; });
  }

  // Takes out the frames that stand out most among their neighbours. A bad frame spoils its
  // neighbours' predictions too, so the others get another chance.
  bool setAside() {
    std::vector<double> worst;
    for (int i = 0; i < n_; ++i) worst.push_back(scores_[at(i)].worst(fits_[at(i)], options_));
    std::vector<int> out;
    for (int i = 0; i < n_; ++i) {
      if (!active_[at(i)] || worst[at(i)] <= options_.threshold) continue;
      const auto& predictors = lamps_[at(i)].predictors;
      const auto last = predictors.begin() +
                        static_cast<std::ptrdiff_t>(std::min<std::size_t>(8, predictors.size()));
      if (std::all_of(predictors.begin(), last,
                      [&](int j) { return worst[at(j)] <= 1.5 * worst[at(i)]; })) {
        out.push_back(i);
      }
    }
    for (const int i : out) active_[at(i)] = false;
    return !out.empty();
  }

  // Put right only where the gain alone, without a shift, leaves nothing unusual.
  void correctGain(int i, FrameVerdict& verdict) const {
    const VectorXf inverse = scale_.col(i).cwiseInverse();
    VectorXf left;
    Fit fit = fits_[at(i)];
    solve<1>(predicted_.col(i).cwiseProduct(inverse), residual_.col(i).cwiseProduct(inverse), left);
    weigh(left, fit);
    verdict.gain = (1 + fit.gainAlone) * (1 + fit.gainAlone);
    verdict.residualFitted =
        left.cwiseProduct(scale_.col(i)).norm() / std::sqrt(static_cast<double>(left.size()));
    verdict.correctable =
        std::max(scores_[at(i)].dark.score(fit.dark),
                 scores_[at(i)].residual.score(fit.residual)) <= options_.threshold;
  }

  // Gauss-Newton to the direction that fits best. False, with nothing said in `verdict`, if
  // something unusual is left there or the fit does not come to rest.
  bool followShift(int i, FrameVerdict& verdict) const {
    const VectorXf inverse = scale_.col(i).cwiseInverse();
    Lamp lamp = lamps_[at(i)];
    Fit fit = fits_[at(i)];
    Vector3d direction = this->direction(i);
    VectorXf left;
    for (int step = 0; step < 4; ++step) {
      direction = (direction + fit.shift.x() * lamp.u + fit.shift.y() * lamp.v).normalized();
      if (angleBetween(direction, this->direction(i)).radians() > kFarthestShift) return false;
      lamp.u = (lamp.u - lamp.u.dot(direction) * direction).normalized();
      lamp.v = direction.cross(lamp.u);
      lamp.predictors = predictorsOf(i, direction, byDistance(direction));
      lamp.weights = weightsAt(direction, lamp.u, lamp.v, lamp.predictors);
      const Eigen::Matrix<float, Eigen::Dynamic, 3> values = weighted(lamp);
      const Eigen::Matrix<float, Eigen::Dynamic, 3> design = inverse.asDiagonal() * values;
      const Vector3f x =
          solve(design, (pictures_.col(i) - values.col(0)).cwiseProduct(inverse), left);
      fit.gain = x[0];
      fit.shift = x.tail<2>().cast<double>();
    }
    weigh(left, fit);
    if (scores_[at(i)].worst(fit, options_) > options_.threshold) return false;
    verdict.fitted = direction;
    verdict.shift = angleBetween(direction, this->direction(i));
    verdict.gain = gainOf(fit);
    verdict.residualFitted =
        left.cwiseProduct(scale_.col(i)).norm() / std::sqrt(static_cast<double>(left.size()));
    verdict.correctable = true;
    return true;
  }

  FrameCheckOptions options_;
  std::vector<Vector3d> directions_;
  int n_;
  int columns_;
  int rows_;
  MatrixXf pictures_;  // cells x frames, square roots
  std::vector<bool> active_;
  std::vector<Lamp> lamps_;
  std::vector<Fit> fits_;
  std::vector<Scores> scores_;
  double spacing_ = 0;
  float leastScale_ = 0;
  int rounds_ = 0;
  // Cells x frames: what predicts (outliers cut down), what is predicted, its derivatives, what is
  // left before and after the fit, and what is usual of it.
  MatrixXf edited_, predicted_, alongU_, alongV_, residual_, fitted_, scale_;
};

// Square roots of the mean luminance of each cell, so that noise and errors count alike in light
// and dark.
Result<MatrixXf> cellPictures(const LightStack& stack, int columns, int rows, Progress& progress) {
  MatrixXf pictures(columns * rows, stack.size());
  std::vector<std::optional<Error>> errors(static_cast<std::size_t>(stack.size()));
  std::atomic<std::size_t> done = 0;
  tbb::parallel_for(0, stack.size(), [&](int i) {
    if (progress.cancelled()) return;
    const auto image = stack.read(i);
    if (!image) {
      errors[static_cast<std::size_t>(i)] = image.error();
      return;
    }
    for (int row = 0; row < rows; ++row) {
      for (int column = 0; column < columns; ++column) {
        const int x0 = column * stack.width() / columns;
        const int x1 = (column + 1) * stack.width() / columns;
        const int y0 = row * stack.height() / rows;
        const int y1 = (row + 1) * stack.height() / rows;
        double sum = 0;
        for (int y = y0; y < y1; ++y) {
          for (int x = x0; x < x1; ++x) {
            for (int c = 0; c < 3; ++c) sum += kRec709Luma[c] * (*image)(x, y, c);
          }
        }
        pictures(row * columns + column, i) =
            static_cast<float>(std::sqrt(std::max(0.0, sum / ((x1 - x0) * (y1 - y0)))));
      }
    }
    progress.update("reading images", ++done, static_cast<std::size_t>(stack.size()));
  });
  if (progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
  for (auto& error : errors) {
    if (error) return tl::unexpected<Error>(std::move(*error));
  }
  if (!pictures.allFinite()) {
    return failure(ErrorCode::kCorrupt, "a frame holds values that are no numbers");
  }
  return pictures;
}

}  // namespace

Result<void> FrameCheckOptions::validate() const {
  if (cells < 8 || cells > 128) {
    return failure(ErrorCode::kInvalidArgument, "cells must be 8 to 128, not {}", cells);
  }
  if (!(threshold > 0) || !(exposureThreshold > 0)) {
    return failure(ErrorCode::kInvalidArgument, "thresholds must be above 0");
  }
  return {};
}

const char* nameOf(FrameFault fault) {
  static constexpr const char* kNames[] = {"good", "shadow", "exposure", "direction", "other"};
  return kNames[static_cast<int>(fault)];
}

std::string FrameVerdict::reason() const {
  switch (fault) {
    case FrameFault::kNone:
      return "good";
    case FrameFault::kShadow:
      return fmt::format("shadow over {:.0f} % of the picture (z {:.0f})", 100 * darkPart,
                         shadowScore);
    case FrameFault::kExposure:
      return fmt::format("{:.2f} times as bright as its neighbours say (z {:.1f})", gain,
                         exposureScore);
    case FrameFault::kDirection:
      return fmt::format("direction {:.1f} degrees from where its picture fits (z {:.1f})",
                         shift.degrees(), directionScore);
    case FrameFault::kOther:
      return fmt::format("does not fit its neighbours (z {:.1f})", residualScore);
  }
  return {};
}

int FrameCheck::count(FrameFault fault) const {
  return static_cast<int>(std::ranges::count(frames, fault, &FrameVerdict::fault));
}

std::vector<int> FrameCheck::bad() const {
  std::vector<int> order;
  for (int i = 0; i < static_cast<int>(frames.size()); ++i) {
    if (frames[static_cast<std::size_t>(i)].fault != FrameFault::kNone) order.push_back(i);
  }
  const auto score = [&](int i) {
    const FrameVerdict& f = frames[static_cast<std::size_t>(i)];
    return std::max({f.exposureScore, f.directionScore, f.shadowScore, f.residualScore});
  };
  std::ranges::stable_sort(order, [&](int a, int b) { return score(a) > score(b); });
  return order;
}

Json FrameCheck::toJson() const {
  const auto vector = [](const Vector3d& v) { return Json{v.x(), v.y(), v.z()}; };
  Json list = Json::array();
  for (const int i : bad()) {
    const FrameVerdict& f = frames[static_cast<std::size_t>(i)];
    list.push_back({{"id", f.id},
                    {"fault", nameOf(f.fault)},
                    {"reason", f.reason()},
                    {"correctable", f.correctable},
                    {"direction", vector(f.direction)},
                    {"fittedDirection", vector(f.fitted)},
                    {"shiftDegrees", f.shift.degrees()},
                    {"shiftSigmaDegrees", f.shiftSigma.degrees()},
                    {"gain", f.gain},
                    {"gainSigma", f.gainSigma},
                    {"darkPart", f.darkPart},
                    {"darkBox", f.darkBox},
                    {"residual", f.residual},
                    {"residualFitted", f.residualFitted},
                    {"z",
                     {{"exposure", f.exposureScore},
                      {"direction", f.directionScore},
                      {"shadow", f.shadowScore},
                      {"residual", f.residualScore}}}});
  }
  return {{"frames", frames.size()},
          {"good", count(FrameFault::kNone)},
          {"shadow", count(FrameFault::kShadow)},
          {"exposure", count(FrameFault::kExposure)},
          {"direction", count(FrameFault::kDirection)},
          {"other", count(FrameFault::kOther)},
          {"spacingDegrees", spacing.degrees()},
          {"rounds", rounds},
          {"bad", list}};
}

Result<FrameCheck> checkFrames(const LightStack& stack, const FrameCheckOptions& options,
                               Progress& progress) {
  RETURN_IF_ERROR(options.validate());
  if (stack.size() < kFewestFrames) {
    return failure(ErrorCode::kInvalidArgument,
                   "{} frames are too few to tell good from bad ones; at least {} are needed",
                   stack.size(), kFewestFrames);
  }
  const int longer = std::max(stack.width(), stack.height());
  const auto cellsAlong = [&](int side) {
    return std::clamp(side * options.cells / longer, 1, side);
  };
  const int columns = cellsAlong(stack.width());
  const int rows = cellsAlong(stack.height());
  ASSIGN_OR_RETURN(auto pictures, cellPictures(stack, columns, rows, progress));
  Checker checker(stack.directions(), std::move(pictures), columns, options);
  if (!checker.run(progress)) return failure(ErrorCode::kCancelled, "cancelled");
  FrameCheck check;
  check.spacing = checker.spacing();
  check.rounds = checker.rounds();
  check.frames.resize(static_cast<std::size_t>(stack.size()));
  tbb::parallel_for(0, stack.size(), [&](int i) {
    FrameVerdict& verdict = check.frames[static_cast<std::size_t>(i)];
    verdict = checker.verdict(i);
    verdict.id = stack.ids()[static_cast<std::size_t>(i)];
  });
  return check;
}

}  // namespace lightsketch
