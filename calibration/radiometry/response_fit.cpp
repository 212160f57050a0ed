#include "calibration/radiometry/response_fit.h"

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "capture/frame/median.h"

namespace lightsketch {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr int kNodes = ResponseFit::kNodes;
constexpr int kNoiseBins = ResponseFit::kNoiseBins;
constexpr int kKnots = ResponseFit::kKnots;
// Second differences of ln(slope) between knots scatter by this much in common response curves
// (sRGB's largest is 0.05, at black).
constexpr double kBend = 0.05;
constexpr double kTimePrior = 0.1;    // one sigma of ln(true / nominal exposure time)
constexpr double kGauge = 1e-6;       // sigma of constraints that only fix a scale
constexpr double kClipSigmas = 4;     // samples keep that far from the clipping levels
constexpr double kOutlierSigmas = 3;  // scale of the Cauchy weights
constexpr std::size_t kFewestPlaces = 30;

std::size_t index(int value) { return static_cast<std::size_t>(value); }

double valueOfNode(double origin, int node) {
  const double root = static_cast<double>(node) / (kNodes - 1);
  return origin + (1 - origin) * root * root;
}
// The segment that a value lies in: its lower node.
int segmentOf(double origin, double value) {
  const double root = std::sqrt(std::clamp((value - origin) / (1 - origin), 0.0, 1.0));
  return std::min(static_cast<int>(root * (kNodes - 1)), kNodes - 2);
}

// The curve of one colour while it is being solved for.
struct Colour {
  double origin = 0;
  VectorXd q;         // ln(slope) at the knots; a single one for a line
  double offset = 0;  // f(value) = integral of the slope - offset
  // Tables at the nodes: the integral, and its derivatives by q.
  VectorXd integral = VectorXd::Zero(kNodes);
  MatrixXd byKnot;  // knots x nodes

  void tabulate() {
    const auto knots = static_cast<int>(q.size());
    byKnot = MatrixXd::Zero(knots, kNodes);
    VectorXd before = VectorXd::Zero(knots);
    for (int m = 0; m < kNodes; ++m) {
      VectorXd here = VectorXd::Zero(knots);
      double logSlope = q[0];
      if (knots == 1) {
        here[0] = 1;
      } else {
        const double position = static_cast<double>(m) / (kNodes - 1) * (knots - 1);
        const int k = std::min(static_cast<int>(position), knots - 2);
        here[k + 1] = position - k;
        here[k] = 1 - here[k + 1];
        logSlope = here[k] * q[k] + here[k + 1] * q[k + 1];
      }
      here *= std::exp(logSlope);
      if (m > 0) {
        const double width = valueOfNode(origin, m) - valueOfNode(origin, m - 1);
        byKnot.col(m) = byKnot.col(m - 1) + 0.5 * width * (before + here);
        integral[m] = integral[m - 1] + 0.5 * width * (before.sum() + here.sum());
      }
      before = here;
    }
  }

  struct Place {
    int node;         // the segment's lower node
    double fraction;  // within the segment
    double value;
    double slope;  // d(exposure) / d(value)
  };
  Place at(int node, double fraction) const {
    const double low = valueOfNode(origin, node);
    const double width = valueOfNode(origin, node + 1) - low;
    return {node, fraction, low + fraction * width, (integral[node + 1] - integral[node]) / width};
  }
  Place atValue(double value) const {
    const int node = segmentOf(origin, value);
    const double low = valueOfNode(origin, node);
    return at(node, (value - low) / (valueOfNode(origin, node + 1) - low));
  }
  // The value at which the curve reaches an exposure; beyond the ends it goes on straight.
  Place atExposure(double exposure) const {
    const double target = exposure + offset;
    const double* const end = integral.data() + kNodes - 1;
    const double* const above = std::upper_bound(integral.data() + 1, end, target);
    const int node = static_cast<int>(above - integral.data()) - 1;
    return at(node, (target - integral[node]) / (integral[node + 1] - integral[node]));
  }
  double integralAt(const Place& place) const {
    return integral[place.node] +
           place.fraction * (integral[place.node + 1] - integral[place.node]);
  }
  double exposureAt(double value) const { return integralAt(atValue(value)) - offset; }
  VectorXd byKnotAt(const Place& place) const {
    return (1 - place.fraction) * byKnot.col(place.node) +
           place.fraction * byKnot.col(place.node + 1);
  }
};

class Solver {
 public:
  Solver(const ResponseSamples& samples, const ResponseFitOptions& options)
      : samples_(samples), options_(options), knots_(options.linear ? 1 : kKnots) {
    colours_.resize(index(samples.colours));
    int first = samples.colours * (knots_ + 1);
    for (const auto& bracket : samples.exposures) {
      firstTime_.push_back(first);
      first += static_cast<int>(bracket.size());
      timeErrors_.emplace_back(bracket.size(), 0.0);
    }
    parameters_ = first;
    rate_.resize(samples.places.size());
    // Before anything is known: two counts of an 8-bit camera, or half a percent.
    for (int c = 0; c < samples.colours; ++c) noise_.emplace_back().fill(0.005 + samples.step);
    for (int c = 0; c < samples.colours; ++c) {
      // Knots below black would have no samples to hold them.
      const auto& black = samples.black[index(c)];
      colours_[index(c)].origin = std::max(0.0, black.value - 2 * black.sigma);
    }
  }

  // Sets a curve to start from, and the places' rates with it.
  template <class LogSlope>
  void start(LogSlope logSlope) {
    for (int c = 0; c < samples_.colours; ++c) {
      Colour& colour = colours_[index(c)];
      colour.q.resize(knots_);
      for (int k = 0; k < knots_; ++k) {
        const double root = knots_ == 1 ? 0.7 : static_cast<double>(k) / (knots_ - 1);
        colour.q[k] = logSlope(colour.origin + (1 - colour.origin) * root * root);
      }
      colour.tabulate();
      const double black = samples_.black[index(c)].value;
      const double scale = colour.integralAt(colour.atValue(samples_.saturation)) -
                           colour.integralAt(colour.atValue(black));
      colour.q.array() -= std::log(scale);
      colour.tabulate();
      colour.offset = colour.integralAt(colour.atValue(black));
    }
    for (std::size_t p = 0; p < rate_.size(); ++p) {
      const auto& place = samples_.places[p];
      const auto& exposures = samples_.exposures[index(place.bracket)];
      double light = 0, time = 0;
      for (std::size_t j = 0; j < exposures.size(); ++j) {
        const double v = place.values[j];
        if (v < samples_.black[index(place.colour)].value + 0.02 || v > 0.95 * samples_.saturation)
          continue;
        light += std::max(colours_[index(place.colour)].exposureAt(v), 1e-9);
        time += exposures[j].seconds;
      }
      rate_[p] = time > 0 ? std::log(light / time) : std::numeric_limits<double>::quiet_NaN();
    }
  }

  // One Gauss-Newton step; the largest change of a parameter that matters, or nothing if the
  // equations cannot be solved.
  std::optional<double> step() {
    MatrixXd normal = MatrixXd::Zero(parameters_, parameters_);
    VectorXd right = VectorXd::Zero(parameters_);
    std::vector<VectorXd> coupling(rate_.size());
    std::vector<std::pair<double, double>> own(rate_.size());  // curvature and gradient by rate
    for (std::size_t p = 0; p < rate_.size(); ++p) {
      const auto& place = samples_.places[p];
      const auto times = static_cast<int>(place.values.size());
      const int n = knots_ + 1 + times;  // this place's columns: its colour, its bracket's times
      MatrixXd rows = MatrixXd::Zero(times, n);  // scaled by the root of their weights
      VectorXd byRate(times), errors(times);
      int used = 0;
      forEachSample(p, [&](int j, const Colour::Place& at, double exposure, double error,
                           double weight) {
        const double root = std::sqrt(weight);
        const double scale = root / at.slope;
        const MatrixXd& byKnot = colours_[index(place.colour)].byKnot;
        rows.row(used).head(knots_) = -scale * (1 - at.fraction) * byKnot.col(at.node).transpose() -
                                      scale * at.fraction * byKnot.col(at.node + 1).transpose();
        rows(used, knots_) = scale;
        rows(used, knots_ + 1 + j) = scale * exposure;
        byRate[used] = scale * exposure;
        errors[used] = root * error;
        ++used;
      });
      VectorXd& v = coupling[p];
      auto& [u, rho] = own[p];
      if (used < 2) {
        u = 0;
        continue;
      }
      rows.conservativeResize(used, n);
      u = byRate.head(used).squaredNorm();
      rho = byRate.head(used).dot(errors.head(used));
      v.noalias() = rows.transpose() * byRate.head(used);
      MatrixXd local = MatrixXd::Zero(n, n);
      local.selfadjointView<Eigen::Lower>().rankUpdate(rows.transpose());
      local.selfadjointView<Eigen::Lower>().rankUpdate(v, -1 / u);
      const VectorXd localRight = rows.transpose() * errors.head(used) - v * (rho / u);
      scatter(place, local, localRight, normal, right);
    }
    addPriors(normal, right);
    // Levenberg: what no sample determines stays where it is.
    normal.diagonal().array() += 1;
    normal = normal.selfadjointView<Eigen::Lower>();
    const Eigen::LDLT<MatrixXd> factor(normal);
    VectorXd delta = factor.solve(right);
    if (factor.info() != Eigen::Success || !delta.allFinite()) return std::nullopt;

    // A step that changes a slope by more than a factor e leaves the region of linearity.
    double largest = 0;
    for (int c = 0; c < samples_.colours; ++c) {
      largest = std::max(largest, delta.segment(firstOf(c), knots_).cwiseAbs().maxCoeff());
    }
    const double shorten = std::min(1.0, 1 / std::max(largest, 1e-12));
    for (std::size_t p = 0; p < rate_.size(); ++p) {
      const auto [u, rho] = own[p];
      if (u == 0) continue;
      const auto& place = samples_.places[p];
      VectorXd local(coupling[p].size());
      local << delta.segment(firstOf(place.colour), knots_ + 1),
          delta.segment(firstTime_[index(place.bracket)],
                        static_cast<Eigen::Index>(place.values.size()));
      rate_[p] += std::clamp(shorten * (rho - coupling[p].dot(local)) / u, -1.0, 1.0);
    }
    for (int c = 0; c < samples_.colours; ++c) {
      Colour& colour = colours_[index(c)];
      colour.q += shorten * delta.segment(firstOf(c), knots_);
      colour.offset += shorten * delta[firstOf(c) + knots_];
      colour.tabulate();
    }
    for (std::size_t b = 0; b < timeErrors_.size(); ++b) {
      for (std::size_t j = 0; j < timeErrors_[b].size(); ++j) {
        timeErrors_[b][j] += shorten * delta[firstTime_[b] + static_cast<int>(j)];
      }
    }
    normal_ = std::move(normal);
    return largest;
  }

  // Noise per value from the residuals: median absolute deviation, so that what moved in the scene
  // does not count.
  void estimateNoise() {
    std::vector<std::array<std::vector<double>, kNoiseBins>> errors(index(samples_.colours));
    for (std::size_t p = 0; p < rate_.size(); ++p) {
      const auto& place = samples_.places[p];
      double curvature = 0;  // of the place's rate
      forEachSample(p, [&](int, const Colour::Place& at, double exposure, double, double weight) {
        curvature += weight * std::pow(exposure / at.slope, 2);
      });
      forEachSample(
          p, [&](int j, const Colour::Place& at, double exposure, double error, double weight) {
            // A sample pulls its place's rate towards itself: its residual is smaller than its
            // error by the root of one minus its leverage. Without that, a bin of small noise would
            // draw the fit through its samples and shrink to nothing.
            const double freedom = 1 - weight * std::pow(exposure / at.slope, 2) / curvature;
            if (freedom < 0.1) return;
            const int frames = samples_.exposures[index(place.bracket)][index(j)].frames;
            errors[index(place.colour)][binOf(at.value)].push_back(std::abs(error) *
                                                                   std::sqrt(frames / freedom));
          });
    }
    const double rounding = samples_.step / std::sqrt(12.0);
    for (std::size_t c = 0; c < errors.size(); ++c) {
      std::array<double, kNoiseBins> sigma{};
      for (std::size_t b = 0; b < sigma.size(); ++b) {
        // Three bins at a time: noise changes smoothly.
        std::vector<double> list;
        for (std::size_t near = b > 0 ? b - 1 : 0; near < std::min(b + 2, sigma.size()); ++near) {
          list.insert(list.end(), errors[c][near].begin(), errors[c][near].end());
        }
        if (list.size() < 40) continue;
        sigma[b] = std::max(1.4826 * median(list), rounding);
      }
      // Empty bins take their neighbour's, from below first.
      if (std::ranges::all_of(sigma, [](double s) { return s == 0; })) continue;
      for (std::size_t b = 1; b < sigma.size(); ++b) {
        if (sigma[b] == 0) sigma[b] = sigma[b - 1];
      }
      for (std::size_t b = sigma.size() - 1; b-- > 0;) {
        if (sigma[b] == 0) sigma[b] = sigma[b + 1];
      }
      noise_[c] = sigma;
    }
  }

  std::size_t usablePlaces() const {
    std::size_t count = 0;
    for (std::size_t p = 0; p < rate_.size(); ++p) {
      int used = 0;
      forEachSample(p, [&](auto&&...) { ++used; });
      count += used >= 2;
    }
    return count;
  }

  // Mean square of the residuals over their variance, outliers limited.
  double misfit() const {
    double sum = 0, count = 0;
    for (std::size_t p = 0; p < rate_.size(); ++p) {
      const auto c = index(samples_.places[p].colour);
      forEachSample(p, [&](int, const Colour::Place& at, double, double error, double) {
        sum += std::min(std::pow(error / noise_[c][binOf(at.value)], 2), 25.0);
        ++count;
      });
    }
    return count > 0 ? sum / count : std::numeric_limits<double>::infinity();
  }

  ResponseFit result() const {
    ResponseFit fit;
    fit.timeErrors = timeErrors_;
    fit.noiseBins = noise_;
    const MatrixXd covariance = normal_.ldlt().solve(MatrixXd::Identity(parameters_, parameters_));
    std::vector<std::pair<double, double>> reached(index(samples_.colours), {1.0, 0.0});
    for (std::size_t p = 0; p < rate_.size(); ++p) {
      auto& range = reached[index(samples_.places[p].colour)];
      forEachSample(p, [&](int, const Colour::Place& at, double, double, double) {
        range.first = std::min(range.first, at.value);
        range.second = std::max(range.second, at.value);
      });
    }
    for (int c = 0; c < samples_.colours; ++c) {
      const Colour& colour = colours_[index(c)];
      ResponseFit::Curve curve;
      curve.origin = colour.origin;
      const MatrixXd ofColour = covariance.block(firstOf(c), firstOf(c), knots_ + 1, knots_ + 1);
      const Colour::Place black = colour.atExposure(0);
      VectorXd a(knots_ + 1);
      a << colour.byKnotAt(black), -1;
      curve.black = black.value;
      curve.blackSigma = std::sqrt(std::max(a.dot(ofColour * a), 0.0)) / black.slope;
      // Derivatives of ln(exposure) at the nodes.
      MatrixXd byParameter(kNodes, knots_ + 1);
      for (int m = 0; m < kNodes; ++m) {
        curve.exposure.push_back(colour.integral[m] - colour.offset);
        byParameter.row(m) << colour.byKnot.col(m).transpose(), -1;
        byParameter.row(m) /= std::max(curve.exposure.back(), ResponseFit::kDarkest);
      }
      // A common factor of the exposures means nothing: its part is taken off.
      const double darkest =
          std::max(reached[index(c)].first, colour.atExposure(ResponseFit::kDarkest).value);
      const int low = segmentOf(colour.origin, darkest);
      const int high = std::max(low, segmentOf(colour.origin, reached[index(c)].second));
      const Eigen::RowVectorXd common =
          byParameter.middleRows(low, high - low + 1).colwise().mean();
      byParameter.rowwise() -= common;
      for (int m = 0; m < kNodes; ++m) {
        const double variance = byParameter.row(m).dot(ofColour * byParameter.row(m).transpose());
        curve.logSigma.push_back(std::sqrt(std::max(variance, 0.0)));
      }
      curve.lowest = reached[index(c)].first;
      curve.highest = reached[index(c)].second;
      fit.curves.push_back(std::move(curve));
    }
    double sum = 0;
    std::size_t usable = 0, disagreeing = 0;
    for (std::size_t p = 0; p < rate_.size(); ++p) {
      const int c = samples_.places[p].colour;
      double worst = 0;
      int used = 0;
      forEachSample(p, [&](int, const Colour::Place& at, double, double error, double) {
        const double sigma = noise_[index(c)][binOf(at.value)];
        fit.residuals.push_back({c, at.value, error});
        sum += std::min(error * error, 25 * sigma * sigma);
        worst = std::max(worst, std::abs(error) / std::max(6 * sigma, kContradiction));
        ++used;
      });
      if (used < 2) continue;
      ++usable;
      disagreeing += worst > 1;
    }
    fit.spread = std::sqrt(sum / std::max<double>(1, static_cast<double>(fit.residuals.size())));
    fit.disagreeing =
        static_cast<double>(disagreeing) / std::max<double>(1, static_cast<double>(usable));
    return fit;
  }

 private:
  // A residual that no noise of a working camera explains, as a fraction of full scale.
  static constexpr double kContradiction = 0.04;

  int firstOf(int colour) const { return colour * (knots_ + 1); }
  static std::size_t binOf(double value) {
    return static_cast<std::size_t>(
        std::clamp(std::sqrt(std::max(value, 0.0)) * kNoiseBins, 0.0, kNoiseBins - 1.0));
  }

  // Calls body(exposure index, place on the curve, exposure, error, weight) for every sample whose
  // predicted value keeps clear of the clipping levels.
  template <class Body>
  void forEachSample(std::size_t p, Body body) const {
    if (!std::isfinite(rate_[p])) return;
    const auto& place = samples_.places[p];
    const auto c = index(place.colour);
    const auto& black = samples_.black[c];
    const auto& exposures = samples_.exposures[index(place.bracket)];
    for (std::size_t j = 0; j < exposures.size(); ++j) {
      const double exposure =
          exposures[j].seconds * std::exp(rate_[p] + timeErrors_[index(place.bracket)][j]);
      if (exposure > 1) continue;
      const Colour::Place at = colours_[c].atExposure(exposure);
      const double sigma = noise_[c][binOf(at.value)];
      if (at.value > samples_.saturation - std::max(kClipSigmas * sigma, samples_.step)) continue;
      if (black.clipped && at.value < kClipSigmas * sigma) continue;
      const double error = place.values[j] - at.value;
      const double frames = exposures[j].frames;
      const double scaled = error / (kOutlierSigmas * sigma);
      body(static_cast<int>(j), at, exposure, error,
           frames / (sigma * sigma) / (1 + frames * scaled * scaled));
    }
  }

  void scatter(const ResponseSamples::Place& place, const MatrixXd& local,
               const VectorXd& localRight, MatrixXd& normal, VectorXd& right) const {
    const int c = firstOf(place.colour);
    const int t = firstTime_[index(place.bracket)];
    const int n = knots_ + 1;
    const auto times = static_cast<int>(place.values.size());
    // Times come after colours, so everything stays in the lower triangle.
    normal.block(c, c, n, n) += local.topLeftCorner(n, n);
    normal.block(t, c, times, n) += local.bottomLeftCorner(times, n);
    normal.block(t, t, times, times) += local.bottomRightCorner(times, times);
    right.segment(c, n) += localRight.head(n);
    right.segment(t, times) += localRight.tail(times);
  }

  void addPriors(MatrixXd& normal, VectorXd& right) const {
    const auto add = [&](const VectorXd& row, double error, double sigma) {
      normal.selfadjointView<Eigen::Lower>().rankUpdate(row, 1 / (sigma * sigma));
      right += row * (error / (sigma * sigma));
    };
    VectorXd row(parameters_);
    for (int c = 0; c < samples_.colours; ++c) {
      const Colour& colour = colours_[index(c)];
      for (int k = 1; k + 1 < knots_; ++k) {
        row.setZero();
        row[firstOf(c) + k - 1] = row[firstOf(c) + k + 1] = 1;
        row[firstOf(c) + k] = -2;
        add(row, -(colour.q[k - 1] - 2 * colour.q[k] + colour.q[k + 1]), kBend);
      }
      // No light at the black value; exposure 1 at saturation.
      const auto tie = [&](double value, double exposure, double sigma) {
        const Colour::Place at = colour.atValue(value);
        row.setZero();
        row.segment(firstOf(c), knots_) = colour.byKnotAt(at);
        row[firstOf(c) + knots_] = -1;
        add(row, exposure - (colour.integralAt(at) - colour.offset), sigma);
      };
      const auto& black = samples_.black[index(c)];
      tie(black.value, 0, black.sigma * colour.atValue(black.value).slope);
      tie(samples_.saturation, 1, kGauge);
    }
    for (std::size_t b = 0; b < timeErrors_.size(); ++b) {
      const auto& exposures = samples_.exposures[b];
      VectorXd mean = VectorXd::Zero(parameters_), slope = mean;
      double centre = 0, meanError = 0, slopeError = 0;
      for (const auto& exposure : exposures) centre += std::log(exposure.seconds);
      centre /= static_cast<double>(exposures.size());
      for (std::size_t j = 0; j < exposures.size(); ++j) {
        const int t = firstTime_[b] + static_cast<int>(j);
        const double error = timeErrors_[b][j];
        row.setZero();
        row[t] = 1;
        add(row, -error, options_.estimateTimes ? kTimePrior : kGauge);
        mean[t] = 1;
        meanError -= error;
        slope[t] = std::log(exposures[j].seconds) - centre;
        slopeError -= slope[t] * error;
      }
      // (f^g, t^g) explains the same pictures for every g, and so does a common factor: nominal
      // times are right on the whole.
      add(mean, meanError, kGauge);
      add(slope, slopeError, kGauge);
    }
  }

  const ResponseSamples& samples_;
  const ResponseFitOptions& options_;
  const int knots_;
  int parameters_ = 0;
  std::vector<int> firstTime_;
  std::vector<Colour> colours_;
  std::vector<double> rate_;  // ln(exposure per second) of every place
  std::vector<std::vector<double>> timeErrors_;
  std::vector<std::array<double, kNoiseBins>> noise_;
  MatrixXd normal_;
};

}  // namespace

double ResponseFit::Curve::nodeValue(int node) const { return valueOfNode(origin, node); }

double ResponseFit::Curve::exposureAt(double value) const {
  const int node = segmentOf(origin, value);
  const double low = nodeValue(node);
  const double fraction = (value - low) / (nodeValue(node + 1) - low);
  return exposure[index(node)] + fraction * (exposure[index(node + 1)] - exposure[index(node)]);
}

double ResponseFit::noiseSigma(int colour, double value) const {
  const double position = std::sqrt(std::clamp(value, 0.0, 1.0)) * kNoiseBins - 0.5;
  const auto low = static_cast<std::size_t>(std::clamp(position, 0.0, kNoiseBins - 2.0));
  const auto& bins = noiseBins[index(colour)];
  return std::lerp(bins[low], bins[low + 1],
                   std::clamp(position - static_cast<double>(low), 0.0, 1.0));
}

Result<ResponseFit> fitResponse(const ResponseSamples& samples, const ResponseFitOptions& options) {
  const auto unsolvable = [] {
    return failure(ErrorCode::kInvalidArgument,
                   "the bracket does not determine a response: too few places are properly exposed "
                   "at two exposures; take more exposures, a factor of 2 apart, of a scene with "
                   "many levels of grey");
  };
  // Cameras are linear or close to sRGB; from the better of the two the solver finds the rest.
  const auto straight = [](double) { return 0.0; };
  const auto gamma = [](double value) { return 1.4 * std::log((value + 0.055) / 1.055); };
  Solver fromLine(samples, options);
  fromLine.start(straight);
  if (fromLine.usablePlaces() < kFewestPlaces) return unsolvable();
  Solver fromGamma(samples, options);
  const auto advance = [](Solver& s) {
    for (int i = 0; i < 5; ++i) {
      if (!s.step()) return std::numeric_limits<double>::infinity();
    }
    return s.misfit();
  };
  bool gammaIsBetter = false;
  if (!options.linear) {
    fromGamma.start(gamma);
    gammaIsBetter = advance(fromGamma) < advance(fromLine);
  }
  Solver& solver = gammaIsBetter ? fromGamma : fromLine;
  int iteration = 0;
  for (; iteration < 30; ++iteration) {
    const auto change = solver.step();
    if (!change) return unsolvable();
    if (iteration >= 2 && iteration < 16) solver.estimateNoise();
    if (iteration >= 18 && *change < 1e-3) break;
  }
  if (solver.usablePlaces() < kFewestPlaces) return unsolvable();
  ResponseFit fit = solver.result();
  fit.iterations = iteration;
  return fit;
}

}  // namespace lightsketch
