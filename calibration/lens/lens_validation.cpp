#include "calibration/lens/lens_validation.h"

#include <tbb/parallel_for.h>

#include <Eigen/SVD>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <numbers>
#include <random>

#include "calibration/lens/lens_field.h"

namespace lightsketch {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Even over the cap out to `limit`: a Fibonacci spiral (Gonzalez 2010).
std::vector<Vector3d> directionsWithin(double limit, int count) {
  std::vector<Vector3d> directions;
  for (int i = 0; i < count; ++i) {
    const double z = 1 - (1 - std::cos(limit)) * (i + 0.5) / count;
    const double phi = i * std::numbers::pi * (3 - std::sqrt(5.0));
    const double r = std::sqrt(1 - z * z);
    directions.emplace_back(r * std::cos(phi), r * std::sin(phi), z);
  }
  return directions;
}

struct Half {
  std::shared_ptr<const FisheyeModel> model;
  double heldOutSquares = 0;
  int heldOutCorners = 0;
};

Half solveHalf(const SolverData& data, const std::vector<std::size_t>& seen,
               const std::vector<std::size_t>& heldOut, const SolverState& start,
               const LensMask& mask, bool warp, const Progress& progress) {
  Half half;
  SolverState state = start;
  SolveOptions options;
  options.lens = mask;
  options.warp = warp;
  options.iterations = 50;
  options.progress = &progress;
  if (!solveLens(data, seen, state, options)) return half;
  LensUncertainty uncertainty;
  uncertainty.covariance = lensStatistics(data, seen, state, mask, warp).covariance;
  uncertainty.coveredField = coveredField(data, seen, state);
  auto model = lensModel(data, state, uncertainty);
  if (!model) return half;
  half.model = *model;
  // Only the poses of the other views are theirs.
  options.lens = {};
  options.warp = false;
  if (!solveLens(data, heldOut, state, options)) return half;
  for (const std::size_t v : heldOut) {
    for (const auto& corner : data.views[v].corners) {
      if (!corner.used) continue;
      half.heldOutSquares += residualOf(state, corner, state.poses[v]).squaredNorm();
      ++half.heldOutCorners;
    }
  }
  return half;
}

// Least-squares rotation of b onto a (Kabsch 1976).
Matrix3d bestRotation(const std::vector<Vector3d>& a, const std::vector<Vector3d>& b) {
  Matrix3d correlation = Matrix3d::Zero();
  for (std::size_t i = 0; i < a.size(); ++i) correlation += a[i] * b[i].transpose();
  const Eigen::JacobiSVD<Matrix3d> svd(correlation, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const double sign = (svd.matrixU() * svd.matrixV().transpose()).determinant();
  return svd.matrixU() * Vector3d(1, 1, sign).asDiagonal() * svd.matrixV().transpose();
}

}  // namespace

std::vector<Split> randomHalves(std::span<const std::size_t> views, int count, std::uint32_t seed) {
  std::mt19937 random(seed);
  std::vector<Split> splits;
  for (int i = 0; i < count; ++i) {
    std::vector<std::size_t> order(views.begin(), views.end());
    std::shuffle(order.begin(), order.end(), random);
    const auto middle = order.begin() + static_cast<std::ptrdiff_t>(order.size() / 2);
    splits.emplace_back(std::vector<std::size_t>(order.begin(), middle),
                        std::vector<std::size_t>(middle, order.end()));
  }
  return splits;
}

Result<Validation> validateHalves(const SolverData& data, const std::vector<Split>& splits,
                                  const SolverState& state, const LensMask& mask, bool warp,
                                  Progress& progress) {
  std::vector<Half> halves(2 * splits.size());
  std::atomic<std::size_t> done = 0;
  tbb::parallel_for(std::size_t{0}, halves.size(), [&](std::size_t i) {
    if (progress.cancelled()) return;
    const auto& [first, second] = splits[i / 2];
    halves[i] = i % 2 == 0 ? solveHalf(data, first, second, state, mask, warp, progress)
                           : solveHalf(data, second, first, state, mask, warp, progress);
    progress.update("validating on halves of the views", ++done, halves.size());
  });
  if (progress.cancelled()) {
    return failure(ErrorCode::kCancelled, "lens calibration: cancelled");
  }
  ASSIGN_OR_RETURN(const auto whole, lensModel(data, state, {}));

  Validation validation;
  SplitHalf& result = validation.splitHalf;
  double heldOutSquares = 0;
  int heldOutCorners = 0;
  double limit = 0;
  for (const Half& half : halves) {
    heldOutSquares += half.heldOutSquares;
    heldOutCorners += half.heldOutCorners;
    if (!half.model) continue;
    for (const Angle angle : half.model->uncertainty().coveredField) {
      limit = std::max(limit, angle.radians());
    }
  }
  validation.heldOutPixels = std::sqrt(heldOutSquares / std::max(1, heldOutCorners));

  const auto directions = directionsWithin(limit, 500);
  std::vector<double> squares(directions.size());
  std::vector<double> predicted(directions.size());
  std::vector<int> counts(directions.size());
  for (std::size_t s = 0; s < splits.size(); ++s) {
    const auto& a = halves[2 * s].model;
    const auto& b = halves[2 * s + 1].model;
    if (!a || !b) continue;
    ++result.splits;
    std::vector<Vector3d> byA;
    std::vector<Vector3d> byB;
    std::vector<std::size_t> which;
    for (std::size_t i = 0; i < directions.size(); ++i) {
      const auto pixel = whole->project(directions[i]);
      if (!pixel) continue;
      const auto inA = a->unproject(*pixel);
      const auto inB = b->unproject(*pixel);
      if (!inA || !inB || !a->covers(*inA) || !b->covers(*inB)) continue;
      byA.push_back(*inA);
      byB.push_back(*inB);
      which.push_back(i);
    }
    if (which.size() < 10) continue;
    const Matrix3d rotation = bestRotation(byA, byB);
    for (std::size_t j = 0; j < which.size(); ++j) {
      const Vector3d turned = rotation * byB[j];
      squares[which[j]] += std::pow(std::atan2(turned.cross(byA[j]).norm(), turned.dot(byA[j])), 2);
      predicted[which[j]] +=
          a->directionCovariance(byA[j]).trace() + b->directionCovariance(byB[j]).trace();
      ++counts[which[j]];
    }
  }
  const auto rings = static_cast<std::size_t>(limit * 180 / std::numbers::pi / 5) + 1;
  std::vector<double> ringSquares(rings);
  std::vector<int> ringCounts(rings);
  double sum = 0;
  double predictedSum = 0;
  int count = 0;
  for (std::size_t i = 0; i < directions.size(); ++i) {
    if (counts[i] == 0) continue;
    result.largest = std::max(result.largest, Angle::radians(std::sqrt(squares[i] / counts[i])));
    sum += squares[i];
    predictedSum += predicted[i];
    count += counts[i];
    const double degrees = std::acos(directions[i].z()) * 180 / std::numbers::pi;
    const auto ring = std::min(rings - 1, static_cast<std::size_t>(degrees / 5));
    ringSquares[ring] += squares[i];
    ringCounts[ring] += counts[i];
  }
  result.rms = Angle::radians(std::sqrt(sum / std::max(1, count)));
  result.predicted = Angle::radians(std::sqrt(predictedSum / std::max(1, count)));
  for (std::size_t ring = 0; ring < rings; ++ring) {
    result.byFieldAngle.push_back(Angle::radians(
        ringCounts[ring] > 0 ? std::sqrt(ringSquares[ring] / ringCounts[ring]) : std::nan("")));
  }
  return validation;
}

}  // namespace lightsketch
