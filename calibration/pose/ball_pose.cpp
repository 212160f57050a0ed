#include "calibration/pose/ball_pose.h"

#include <ceres/ceres.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <random>

#include "calibration/pose/sight.h"
#include "capture/frame/median.h"

namespace lightsketch {
namespace {

using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Vector6d = Eigen::Matrix<double, 6, 1>;

constexpr std::size_t kFewestMoments = 10;
// A lamp or highlight that stays within this says nothing about a rotation.
constexpr double kLeastMotionDegrees = 10;
// Distances of a hand-held lamp scatter by a factor of e at one sigma: so weak that it only holds
// lamps whose two lines of sight are parallel.
constexpr double kDistanceScatter = 1;

double valueOf(double x) { return x; }
template <class T, int N>
double valueOf(const ceres::Jet<T, N>& x) {
  return x.a;
}

// Where a ball shows `eye` the lamp. The normal is solved for in doubles; its derivatives are the
// implicit function's: one Newton step with the tangent-plane Hessian leaves the value and carries
// the jets. Nothing where the lamp or the eye is within the ball.
template <class T>
bool mirrorPoint(const Vector3d& eye, const Eigen::Matrix<T, 3, 1>& centre, double radius,
                 const Eigen::Matrix<T, 3, 1>& lamp, Eigen::Matrix<T, 3, 1>& point) {
  using Vector3T = Eigen::Matrix<T, 3, 1>;
  const Vector3T a = eye.cast<T>() - centre;
  const Vector3T b = lamp - centre;
  const Vector3d a0(valueOf(a[0]), valueOf(a[1]), valueOf(a[2]));
  const Vector3d b0(valueOf(b[0]), valueOf(b[1]), valueOf(b[2]));
  if (!(a0.norm() > 1.001 * radius && b0.norm() > 1.001 * radius)) return false;
  const Vector3d n = mirrorNormal(a0, b0, radius);
  Eigen::Matrix<double, 3, 2> tangent;
  tangent.col(0) = n.unitOrthogonal();
  tangent.col(1) = n.cross(tangent.col(0));
  const Vector3d toEye = a0 - radius * n;
  const Vector3d toLamp = b0 - radius * n;
  const Vector3d u = toEye.normalized();
  const Vector3d w = toLamp.normalized();
  const Matrix3d one = Matrix3d::Identity();
  const Matrix2d slope = tangent.transpose() *
                             (-radius / toEye.norm() * (one - u * u.transpose()) -
                              radius / toLamp.norm() * (one - w * w.transpose())) *
                             tangent -
                         (u + w).dot(n) * Matrix2d::Identity();
  const Matrix2d inverse = slope.inverse();
  if (!inverse.allFinite()) return false;
  const Vector3T foot = (radius * n).cast<T>();
  const Eigen::Matrix<T, 2, 1> unbalanced =
      tangent.transpose().cast<T>() * ((a - foot).normalized() + (b - foot).normalized());
  const Vector3T normal = n.cast<T>() - tangent.cast<T>() * (inverse.cast<T>() * unbalanced);
  point = centre + T(radius) * normal.normalized();
  return true;
}

// A lamp as the solver sees it: (a, b, log distance) about a line from a fixed anchor. In metres a
// lamp whose lines of sight are nearly parallel has no curvature to hold a step; its logarithm has
// that of the prior.
struct LampBlock {
  Vector3d anchor = Vector3d::Zero();
  Vector3d direction = Vector3d::UnitZ();
  Vector3d parameters = Vector3d::Zero();

  static LampBlock of(const Vector3d& from, const Vector3d& lamp) {
    return {from, (lamp - from).normalized(), {0, 0, std::log((lamp - from).norm())}};
  }
  template <class T>
  Eigen::Matrix<T, 3, 1> at(const T* p) const {
    using std::exp;
    const Vector3d u = direction.unitOrthogonal();
    const Eigen::Matrix<T, 3, 1> towards =
        direction.cast<T>() + p[0] * u.cast<T>() + p[1] * direction.cross(u).cast<T>();
    return anchor.cast<T>() + exp(p[2]) * towards.normalized();
  }
  Vector3d position() const { return at<double>(parameters.data()); }
};

struct HighlightResidual {
  const Sight& sight;
  double radius;
  const LampBlock& block;
  template <class T>
  bool operator()(const T* centre, const T* lamp, T* out) const {
    Eigen::Matrix<T, 3, 1> point;
    if (!mirrorPoint<T>(sight.origin, Eigen::Map<const Eigen::Matrix<T, 3, 1>>(centre), radius,
                        block.at<T>(lamp), point)) {
      return false;
    }
    sight.residual<T>(point, out);
    return true;
  }
};

struct LampResidual {
  const Sight& sight;
  const Matrix3d& camera;
  const LampBlock& block;
  template <class T>
  bool operator()(const T* pose, const T* lamp, T* out) const {
    sight.residual<T>(transformedBack<T>(camera, pose, block.at<T>(lamp)), out);
    return true;
  }
};

struct OutlineResidual {
  Vector3d origin;
  BallCone cone;
  double radius;
  Matrix3d whitener;
  template <class T>
  bool operator()(const T* centre, T* out) const {
    using std::asin;
    using std::sqrt;
    const Eigen::Matrix<T, 3, 1> to =
        Eigen::Map<const Eigen::Matrix<T, 3, 1>>(centre) - origin.cast<T>();
    const T distance = to.norm();
    if (distance <= T(radius)) return false;
    const Vector3d u = cone.axis.unitOrthogonal();
    const Vector3d v = cone.axis.cross(u);
    const Eigen::Matrix<T, 3, 1> off(u.cast<T>().dot(to) / distance, v.cast<T>().dot(to) / distance,
                                     asin(T(radius) / distance) - T(cone.angularRadius.radians()));
    Eigen::Map<Eigen::Matrix<T, 3, 1>> residuals(out);
    residuals = whitener.cast<T>() * off;
    return true;
  }
};

struct DistanceResidual {
  template <class T>
  bool operator()(const T* lamp, const T* logMean, T* out) const {
    out[0] = (lamp[2] - logMean[0]) / T(kDistanceScatter);
    return true;
  }
};

struct MeanDistanceResidual {
  double logMean;
  double sigma;
  template <class T>
  bool operator()(const T* value, T* out) const {
    out[0] = (value[0] - T(logMean)) / T(sigma);
    return true;
  }
};

struct SourceDistanceResidual {
  MeasuredLength measured;
  template <class T>
  bool operator()(const T* pose, const T* centre, T* out) const {
    using std::sqrt;
    const Eigen::Matrix<T, 3, 1> to = Eigen::Map<const Eigen::Matrix<T, 3, 1>>(centre) -
                                      Eigen::Map<const Eigen::Matrix<T, 3, 1>>(pose + 3);
    out[0] = (sqrt(to.squaredNorm() + T(1e-12)) - T(measured.metres)) / T(measured.sigmaMetres);
    return true;
  }
};

// The ball's outline in a source camera's own picture.
struct SourceOutlineResidual {
  OutlineResidual outline;
  const Matrix3d& camera;
  template <class T>
  bool operator()(const T* pose, const T* centre, T* out) const {
    const Eigen::Matrix<T, 3, 1> point = Eigen::Map<const Eigen::Matrix<T, 3, 1>>(centre);
    const Eigen::Matrix<T, 3, 1> inSource = transformedBack<T>(camera, pose, point);
    return outline(inSource.data(), out);
  }
};

// For the seed: the lamp on the reflected ray, a common distance from the ball.
struct SphereResidual {
  Vector3d centre;
  Vector3d mirror;
  Vector3d reflected;
  Vector3d seen;  // source camera's direction
  const Matrix3d& camera;
  template <class T>
  bool operator()(const T* pose, const T* logDistance, T* out) const {
    using std::exp;
    using std::sqrt;
    const Vector3d from = mirror - centre;
    const double along = from.dot(reflected);
    const T distance = exp(logDistance[0]);
    const T inside = distance * distance + T(along * along - from.squaredNorm());
    if (inside <= T(0)) return false;
    const Eigen::Matrix<T, 3, 1> lamp =
        mirror.cast<T>() + (sqrt(inside) - T(along)) * reflected.cast<T>();
    Sight sight{Vector3d::Zero(), seen, Eigen::Matrix<double, 2, 3>::Zero()};
    sight.whitener.row(0) = seen.unitOrthogonal();
    sight.whitener.row(1) = seen.cross(seen.unitOrthogonal());
    sight.residual<T>(transformedBack<T>(camera, pose, lamp), out);
    return true;
  }
};

// Rotation that best turns `from` into `to` (Kabsch; Wahba's problem).
Matrix3d bestRotation(std::span<const Vector3d> from, std::span<const Vector3d> to) {
  Matrix3d sum = Matrix3d::Zero();
  for (std::size_t i = 0; i < from.size(); ++i) sum += to[i] * from[i].transpose();
  const Eigen::JacobiSVD<Matrix3d> svd(sum, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Vector3d signs(1, 1, (svd.matrixU() * svd.matrixV().transpose()).determinant() > 0 ? 1 : -1);
  return svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
}

// Least median over random pairs: up to half of the moments may be wrong.
Matrix3d robustRotation(std::span<const Vector3d> from, std::span<const Vector3d> to) {
  std::mt19937 random(1);
  Matrix3d best = Matrix3d::Identity();
  double bestMedian = std::numeric_limits<double>::infinity();
  std::vector<double> errors(from.size());
  for (int trial = 0; trial < 400; ++trial) {
    const std::size_t i = random() % from.size();
    const std::size_t j = random() % from.size();
    if (from[i].cross(from[j]).norm() < 0.1) continue;
    const std::array<Vector3d, 2> two{from[i], from[j]};
    const std::array<Vector3d, 2> targets{to[i], to[j]};
    const Matrix3d rotation = bestRotation(two, targets);
    for (std::size_t k = 0; k < from.size(); ++k) {
      errors[k] = (rotation * from[k] - to[k]).squaredNorm();
    }
    const double middle = median(errors);
    if (middle < bestMedian) {
      bestMedian = middle;
      best = rotation;
    }
  }
  return best;
}

double widestDegrees(const std::vector<Vector3d>& directions) {
  double widest = 0;
  for (std::size_t i = 0; i < directions.size(); ++i) {
    for (std::size_t j = 0; j < i; ++j) {
      widest = std::max(widest, (directions[i] - directions[j]).norm());
    }
  }
  return Angle::radians(2 * std::asin(std::min(1.0, widest / 2))).degrees();
}

struct Placed {
  std::size_t moment = 0;
  std::vector<std::optional<Sight>> highlights;
  std::vector<std::optional<Sight>> lamps;
  std::vector<std::optional<LampRay>> reflected;  // scene camera frame, for the seed
  std::vector<double> highlightPixels;            // per sigma, by ball
  std::vector<double> lampPixels;
  LampBlock lamp;
  bool used = true;

  int observations() const {
    const auto count = [](const auto& list) {
      return std::count_if(list.begin(), list.end(), [](const auto& x) { return x.has_value(); });
    };
    return static_cast<int>(count(highlights) + count(lamps));
  }
};

class BallSolver {
 public:
  const BallSetup* setup = nullptr;
  std::vector<Placed> placed;
  std::vector<MirrorBall> balls;  // scene camera frame
  std::vector<PoseBlock> cameras;
  double logMean = 0;

  // How far from free of error the solution is; nothing where it fails.
  std::optional<double> solve() {
    double cost = 0;
    for (int round = 0; round < 2; ++round) {
      ceres::Problem problem;
      build(problem);
      ceres::Solver::Options options;
      options.linear_solver_type = ceres::DENSE_SCHUR;
      options.max_num_iterations = 200;
      options.function_tolerance = 1e-10;
      options.num_threads = 2;
      options.logging_type = ceres::SILENT;
      auto* order = new ceres::ParameterBlockOrdering;
      for (auto& moment : placed) {
        if (moment.used) order->AddElementToGroup(moment.lamp.parameters.data(), 0);
      }
      for (auto& ball : balls) order->AddElementToGroup(ball.centre.data(), 1);
      for (auto& camera : cameras) order->AddElementToGroup(camera.parameters.data(), 1);
      order->AddElementToGroup(&logMean, 1);
      options.linear_solver_ordering.reset(order);
      ceres::Solver::Summary summary;
      ceres::Solve(options, &problem, &summary);
      if (!summary.IsSolutionUsable()) return std::nullopt;
      cost = summary.final_cost;
      for (auto& camera : cameras) camera.fold();
    }
    return cost;
  }

  // Joint covariance of a camera's six and the first ball's three; false where undetermined.
  bool covariances(std::vector<Eigen::Matrix<double, 9, 9>>& joint,
                   std::vector<Matrix3d>& centres) {
    ceres::Problem problem;
    build(problem);
    ceres::Covariance::Options options;
    options.algorithm_type = ceres::SPARSE_QR;
    ceres::Covariance covariance(options);
    std::vector<std::pair<const double*, const double*>> blocks;
    const double* first = balls.front().centre.data();
    for (const auto& ball : balls) blocks.emplace_back(ball.centre.data(), ball.centre.data());
    for (const auto& camera : cameras) {
      blocks.emplace_back(camera.parameters.data(), camera.parameters.data());
      blocks.emplace_back(camera.parameters.data(), first);
    }
    if (!covariance.Compute(blocks, &problem)) return false;
    using RowMajor3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    for (const auto& ball : balls) {
      RowMajor3 own;
      covariance.GetCovarianceBlock(ball.centre.data(), ball.centre.data(), own.data());
      centres.emplace_back(own);
    }
    for (const auto& camera : cameras) {
      Eigen::Matrix<double, 6, 6, Eigen::RowMajor> own;
      Eigen::Matrix<double, 6, 3, Eigen::RowMajor> mixed;
      const double* pose = camera.parameters.data();
      covariance.GetCovarianceBlock(pose, pose, own.data());
      covariance.GetCovarianceBlock(pose, first, mixed.data());
      Eigen::Matrix<double, 9, 9> all;
      all << own, mixed, mixed.transpose(), centres.front();
      joint.push_back((all + all.transpose()) / 2);
    }
    return true;
  }

  struct Misfit {
    double squares = 0;
    double pixels = 0;
    int count = 0;
  };
  Misfit misfit(const Placed& moment) const {
    Misfit sum;
    Vector2d e = Vector2d::Zero();
    const auto add = [&](double pixelsPerSigma) {
      sum.squares += e.squaredNorm();
      sum.pixels += e.squaredNorm() * pixelsPerSigma * pixelsPerSigma;
      sum.count += 2;
    };
    for (std::size_t b = 0; b < balls.size(); ++b) {
      if (!moment.highlights[b]) continue;
      HighlightResidual{*moment.highlights[b], balls[b].radiusMetres, moment.lamp}(
          balls[b].centre.data(), moment.lamp.parameters.data(), e.data());
      add(moment.highlightPixels[b]);
    }
    for (std::size_t k = 0; k < cameras.size(); ++k) {
      if (!moment.lamps[k]) continue;
      LampResidual{*moment.lamps[k], cameras[k].reference, moment.lamp}(
          cameras[k].parameters.data(), moment.lamp.parameters.data(), e.data());
      add(moment.lampPixels[k]);
    }
    return sum;
  }

 private:
  void build(ceres::Problem& problem) {
    const auto whitenerOf = [](const BallCone& cone) {
      return Matrix3d(cone.covariance.llt().matrixL().solve(Matrix3d(Matrix3d::Identity())));
    };
    for (std::size_t k = 0; k < cameras.size(); ++k) {
      double* pose = cameras[k].parameters.data();
      double* centre = balls.front().centre.data();
      if (k < setup->sourceDistances.size() && setup->sourceDistances[k]) {
        problem.AddResidualBlock(new ceres::AutoDiffCostFunction<SourceDistanceResidual, 1, 6, 3>(
                                     new SourceDistanceResidual{*setup->sourceDistances[k]}),
                                 nullptr, pose, centre);
      }
      if (k < setup->sourceOutlines.size() && setup->sourceOutlines[k]) {
        const BallCone& cone = *setup->sourceOutlines[k];
        problem.AddResidualBlock(
            new ceres::AutoDiffCostFunction<SourceOutlineResidual, 3, 6, 3>(
                new SourceOutlineResidual{{setup->sourceCameras[k].model->rayOrigin(cone.axis),
                                           cone, balls.front().radiusMetres, whitenerOf(cone)},
                                          cameras[k].reference}),
            nullptr, pose, centre);
      }
    }
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<MeanDistanceResidual, 1, 1>(
            new MeanDistanceResidual{std::log(setup->lampDistance.metres),
                                     setup->lampDistance.sigmaMetres / setup->lampDistance.metres}),
        nullptr, &logMean);
    for (std::size_t b = 0; b < balls.size(); ++b) {
      const BallCone& cone = setup->outlines[b];
      const Matrix3d whitener = whitenerOf(cone);
      problem.AddResidualBlock(
          new ceres::AutoDiffCostFunction<OutlineResidual, 3, 3>(
              new OutlineResidual{setup->sceneCamera.model->rayOrigin(cone.axis), cone,
                                  balls[b].radiusMetres, whitener}),
          nullptr, balls[b].centre.data());
    }
    for (auto& moment : placed) {
      if (!moment.used) continue;
      double* lamp = moment.lamp.parameters.data();
      for (std::size_t b = 0; b < balls.size(); ++b) {
        if (!moment.highlights[b]) continue;
        problem.AddResidualBlock(
            new ceres::AutoDiffCostFunction<HighlightResidual, 2, 3, 3>(
                new HighlightResidual{*moment.highlights[b], balls[b].radiusMetres, moment.lamp}),
            new ceres::HuberLoss(3), balls[b].centre.data(), lamp);
      }
      for (std::size_t k = 0; k < cameras.size(); ++k) {
        if (!moment.lamps[k]) continue;
        problem.AddResidualBlock(
            new ceres::AutoDiffCostFunction<LampResidual, 2, 6, 3>(
                new LampResidual{*moment.lamps[k], cameras[k].reference, moment.lamp}),
            new ceres::HuberLoss(3), cameras[k].parameters.data(), lamp);
      }
      problem.AddResidualBlock(
          new ceres::AutoDiffCostFunction<DistanceResidual, 1, 3, 1>(new DistanceResidual), nullptr,
          lamp, &logMean);
    }
  }
};

// One source camera by itself, all lamps on one sphere around the first ball.
struct Seed {
  PoseBlock camera;
  double logDistance = 0;
  double cost = std::numeric_limits<double>::infinity();
};
Seed seedCamera(const std::vector<Placed>& placed, const std::vector<MirrorBall>& balls,
                std::size_t k, double startDistance) {
  std::vector<Vector3d> seen;
  std::vector<Vector3d> reflected;
  std::vector<std::pair<Vector3d, Vector3d>> centreAndMirror;
  for (const auto& moment : placed) {
    if (!moment.used || !moment.lamps[k]) continue;
    for (std::size_t b = 0; b < balls.size(); ++b) {
      if (!moment.reflected[b]) continue;
      seen.push_back(moment.lamps[k]->direction);
      reflected.push_back(moment.reflected[b]->direction);
      centreAndMirror.emplace_back(balls[b].centre, moment.reflected[b]->origin);
    }
  }
  Seed seed;
  seed.camera.reference = robustRotation(seen, reflected);
  seed.camera.parameters.tail<3>() = balls.front().centre;
  seed.logDistance = std::log(startDistance);
  for (int round = 0; round < 2; ++round) {
    ceres::Problem problem;
    for (std::size_t i = 0; i < seen.size(); ++i) {
      problem.AddResidualBlock(
          new ceres::AutoDiffCostFunction<SphereResidual, 2, 6, 1>(
              new SphereResidual{centreAndMirror[i].first, centreAndMirror[i].second, reflected[i],
                                 seen[i], seed.camera.reference}),
          new ceres::CauchyLoss(Angle::degrees(2).radians()), seed.camera.parameters.data(),
          &seed.logDistance);
    }
    problem.SetParameterLowerBound(&seed.logDistance, 0, std::log(startDistance / 3));
    problem.SetParameterUpperBound(&seed.logDistance, 0, std::log(startDistance * 3));
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_QR;
    options.max_num_iterations = 100;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    if (!summary.IsSolutionUsable()) return seed;
    seed.cost = summary.final_cost;
    seed.camera.fold();
  }
  return seed;
}

Result<void> checkSetup(const BallSetup& setup) {
  if (setup.outlines.empty() || setup.sourceCameras.empty()) {
    return failure(ErrorCode::kInvalidArgument,
                   "calibrate pose: needs a mirror ball and a source camera");
  }
  if (setup.radiiMetres.size() != setup.outlines.size()) {
    return failure(
        ErrorCode::kInvalidArgument,
        "calibrate pose: {} mirror balls but {} radii; give the radius of each in metres",
        setup.outlines.size(), setup.radiiMetres.size());
  }
  const auto sound = [](const MeasuredLength& length) {
    return length.metres > 0 && length.sigmaMetres > 0 && std::isfinite(length.metres);
  };
  bool lengths = sound(setup.lampDistance);
  for (const auto& distance : setup.sourceDistances)
    lengths = lengths && (!distance || sound(*distance));
  if (!lengths) {
    return failure(ErrorCode::kInvalidArgument,
                   "calibrate pose: measured distances and their errors must be positive");
  }
  return {};
}

}  // namespace

Result<void> BallPoseOptions::validate() const {
  if (!(outlierSigmas > 1)) {
    return failure(ErrorCode::kInvalidArgument,
                   "calibrate pose: the outlier limit must be above 1");
  }
  return {};
}

Result<BallPoseCalibration> poseFromMirrorBalls(const BallSetup& setup,
                                                std::span<const BallMoment> moments,
                                                const BallPoseOptions& options) {
  RETURN_IF_ERROR(options.validate());
  RETURN_IF_ERROR(checkSetup(setup));
  const CameraPose inCamera;  // the scene camera's own frame
  BallSolver solver;
  solver.setup = &setup;
  for (std::size_t b = 0; b < setup.outlines.size(); ++b) {
    ASSIGN_OR_RETURN(const auto ball, ballFromOutline(inCamera, *setup.sceneCamera.model,
                                                      setup.outlines[b], setup.radiiMetres[b]));
    if (!(setup.outlines[b].covariance.llt().info() == Eigen::Success)) {
      return failure(ErrorCode::kInvalidArgument,
                     "calibrate pose: the ball's outline has no covariance");
    }
    solver.balls.push_back(ball);
  }

  BallPoseCalibration result;
  auto& evidence = result.pose.evidence;
  for (std::size_t i = 0; i < moments.size(); ++i) {
    const BallMoment& moment = moments[i];
    evidence.push_back({moment.name, {}, 0});
    std::string& reason = evidence.back().rejected;
    Placed place;
    place.moment = i;
    place.highlights.resize(solver.balls.size());
    place.reflected.resize(solver.balls.size());
    place.highlightPixels.resize(solver.balls.size());
    place.lamps.resize(setup.sourceCameras.size());
    place.lampPixels.resize(setup.sourceCameras.size());
    const auto pixelsPerSigma = [](const PixelMeasurement& pixel, const CameraModel& model,
                                   const LampRay& ray) {
      const double lens = model.directionCovariance(ray.direction).trace();
      const double all = ray.directionCovariance.trace();
      return std::sqrt(pixel.covariance.trace() / 2 * all / std::max(all - lens, 1e-300));
    };
    bool highlight = false;
    for (std::size_t b = 0; b < solver.balls.size() && b < moment.highlights.size(); ++b) {
      if (!moment.highlights[b]) continue;
      const PixelMeasurement& seen = *moment.highlights[b];
      const auto ray = lampRay(inCamera, *setup.sceneCamera.model, seen.pixel, seen.covariance);
      const auto reflected =
          rayFromHighlight(inCamera, *setup.sceneCamera.model, solver.balls[b], seen);
      if (!ray || !reflected) {
        reason = ray ? reflected.error().message : ray.error().message;
        continue;
      }
      place.highlights[b] = Sight::of(*ray);
      place.highlightPixels[b] = pixelsPerSigma(seen, *setup.sceneCamera.model, *ray);
      place.reflected[b] = *reflected;
      highlight = true;
    }
    bool lamp = false;
    for (std::size_t k = 0; k < setup.sourceCameras.size() && k < moment.lamps.size(); ++k) {
      if (!moment.lamps[k]) continue;
      const PixelMeasurement& seen = *moment.lamps[k];
      const CameraModel& model = *setup.sourceCameras[k].model;
      const auto ray = lampRay(inCamera, model, seen.pixel, seen.covariance);
      if (!ray || !model.covers(ray->direction)) {
        reason = fmt::format("the lamp lies outside the covered field of the lens of '{}'",
                             setup.sourceCameras[k].name);
        continue;
      }
      place.lamps[k] = Sight::of(*ray);
      place.lampPixels[k] = pixelsPerSigma(seen, model, *ray);
      lamp = true;
    }
    const auto sound = [](const auto& sights) {
      return std::all_of(sights.begin(), sights.end(),
                         [](const auto& sight) { return !sight || sight->whitener.allFinite(); });
    };
    if (!sound(place.highlights) || !sound(place.lamps)) {
      return failure(ErrorCode::kInvalidArgument, "calibrate pose: '{}': a pixel has no covariance",
                     moment.name);
    }
    if (!highlight || !lamp) {
      if (reason.empty()) {
        reason = !highlight ? "no highlight on the ball" : "no source camera sees the lamp";
      }
      continue;
    }
    reason.clear();
    solver.placed.push_back(std::move(place));
  }

  // What can be told before anything is solved.
  if (solver.placed.size() < kFewestMoments) {
    return failure(ErrorCode::kInvalidArgument,
                   "calibrate pose: only {} moments show the lamp both on the mirror ball and to a "
                   "source camera, at least {} are needed; wave the lamp for 20 seconds where both "
                   "see it",
                   solver.placed.size(), kFewestMoments);
  }
  for (std::size_t k = 0; k < setup.sourceCameras.size(); ++k) {
    std::vector<Vector3d> seen;
    std::vector<Vector3d> reflected;
    for (const auto& moment : solver.placed) {
      if (!moment.lamps[k]) continue;
      seen.push_back(moment.lamps[k]->direction);
      for (const auto& ray : moment.reflected) {
        if (ray) reflected.push_back(ray->direction);
      }
    }
    const std::string& name = setup.sourceCameras[k].name;
    if (seen.size() < kFewestMoments) {
      return failure(ErrorCode::kInvalidArgument,
                     "calibrate pose: '{}' sees the lamp in {} moments with a highlight, at least "
                     "{} are needed; wave the lamp for 20 seconds where it sees it",
                     name, seen.size(), kFewestMoments);
    }
    if (widestDegrees(seen) < kLeastMotionDegrees) {
      return failure(
          ErrorCode::kInvalidArgument,
          "calibrate pose: the lamp never moved: it stays within {:.1f} degrees in '{}'; "
          "wave it all around the subject",
          widestDegrees(seen), name);
    }
    if (widestDegrees(reflected) < kLeastMotionDegrees) {
      return failure(
          ErrorCode::kInvalidArgument,
          "calibrate pose: the highlights are all in one place on the mirror ball, while "
          "'{}' sees the lamp move; they are a room light: darken the room or subtract "
          "the ambient picture",
          name);
    }
  }

  // The better of two starts; then the whole.
  std::optional<BallSolver> best;
  double bestCost = std::numeric_limits<double>::infinity();
  for (const double factor : {0.6, 1.5}) {
    const double start = factor * setup.lampDistance.metres;
    BallSolver trial = solver;
    std::vector<double> distances;
    for (std::size_t k = 0; k < setup.sourceCameras.size(); ++k) {
      const Seed seed = seedCamera(trial.placed, trial.balls, k, start);
      trial.cameras.push_back(seed.camera);
      distances.push_back(seed.logDistance);
    }
    std::sort(distances.begin(), distances.end());
    trial.logMean = distances[distances.size() / 2];
    for (auto& moment : trial.placed) {
      for (std::size_t b = 0; b < trial.balls.size(); ++b) {
        if (!moment.reflected[b]) continue;
        moment.lamp = LampBlock::of(
            trial.balls.front().centre,
            moment.reflected[b]->origin + std::exp(trial.logMean) * moment.reflected[b]->direction);
        break;
      }
    }
    const auto cost = trial.solve();
    if (cost && *cost < bestCost) {
      bestCost = *cost;
      best = std::move(trial);
    }
  }
  if (!best) {
    return failure(ErrorCode::kInvalidArgument,
                   "calibrate pose: highlights and lamp pixels cannot be brought together; check "
                   "that they are of the same moments and the lenses calibrated");
  }

  // Moments that contradict the others go, all at once: each has its own lamp and pulls on nothing
  // but the cameras, and the loss has held that back.
  for (int round = 0; round < 4; ++round) {
    std::vector<double> all;
    for (const auto& moment : best->placed) {
      const auto misfit = best->misfit(moment);
      double& sigmas = evidence[moment.moment].residualSigmas;
      sigmas = std::sqrt(misfit.squares / std::max(1, misfit.count - 3));
      if (moment.used) all.push_back(sigmas);
    }
    // The median of |normal| is 0.67. Beyond three times what the pixels' covariances expect, it is
    // no longer they that were too small.
    const double limit = options.outlierSigmas * std::clamp(median(all) / 0.67, 1.0, 3.0);
    bool rejected = false;
    for (auto& moment : best->placed) {
      auto& own = evidence[moment.moment];
      if (!moment.used || own.residualSigmas <= limit) continue;
      moment.used = false;
      rejected = true;
      own.rejected = fmt::format(
          "highlight and lamp contradict each other by {:.1f} sigmas; another light, or pictures "
          "of "
          "different moments",
          own.residualSigmas);
    }
    if (!rejected) break;
    const auto left = std::count_if(best->placed.begin(), best->placed.end(),
                                    [](const Placed& moment) { return moment.used; });
    if (left < static_cast<std::ptrdiff_t>(kFewestMoments) ||
        2 * left < std::ptrdiff_t(best->placed.size())) {
      return failure(ErrorCode::kInvalidArgument,
                     "calibrate pose: highlights and lamp contradict each other in {} of {} "
                     "moments; check that the pictures are of the same moments, the ball's radius "
                     "and the lenses",
                     static_cast<std::ptrdiff_t>(best->placed.size()) - left, best->placed.size());
    }
    if (!best->solve()) {
      return failure(ErrorCode::kInvalidArgument,
                     "calibrate pose: the solution fell apart without the moments that contradict "
                     "it; wave the lamp again");
    }
  }

  double squares = 0;
  double pixels = 0;
  int count = 0;
  for (const auto& moment : best->placed) {
    if (!moment.used) continue;
    ++result.pose.used;
    const auto misfit = best->misfit(moment);
    evidence[moment.moment].residualSigmas =
        std::sqrt(misfit.squares / std::max(1, misfit.count - 3));
    squares += misfit.squares;
    pixels += misfit.pixels;
    count += misfit.count;
  }
  const int freedom = count - 3 * result.pose.used - 6 * static_cast<int>(best->cameras.size());
  result.pose.residualSigmas = std::sqrt(squares / std::max(1, freedom));
  result.pose.residualPixels = std::sqrt(2 * pixels / count);

  std::vector<Eigen::Matrix<double, 9, 9>> joint;
  std::vector<Matrix3d> centres;
  if (!best->covariances(joint, centres)) {
    return failure(ErrorCode::kInvalidArgument,
                   "calibrate pose: the moments do not determine the source cameras' poses; wave "
                   "the lamp all around the subject, near and far");
  }
  const double scale = std::max(1.0, result.pose.residualSigmas * result.pose.residualSigmas);
  const Vector3d origin = best->balls.front().centre;
  CameraPose scene;
  if (setup.sceneCameraPose) {
    scene = *setup.sceneCameraPose;
    scene.camera = setup.sceneCamera.name;
  } else {
    scene = sceneCameraFromBall(setup.sceneCamera, origin, scale * centres.front());
  }
  result.pose.rig.sceneCamera = scene;
  for (std::size_t k = 0; k < best->cameras.size(); ++k) {
    CameraPose pose;
    pose.camera = setup.sourceCameras[k].name;
    pose.sceneFromCamera = best->cameras[k].pose();
    if (setup.sceneCameraPose) {
      pose.covariance = scale * joint[k].topLeftCorner<6, 6>();
      pose = inSceneFrame(scene, pose);
    } else {
      // Relative to the ball, whose error it partly shares.
      Eigen::Matrix<double, 6, 9> relative = Eigen::Matrix<double, 6, 9>::Zero();
      relative.leftCols<6>().setIdentity();
      relative.bottomRightCorner<3, 3>() = -Matrix3d::Identity();
      CameraPose exact = scene;
      exact.covariance.setZero();
      pose.covariance = scale * relative * joint[k] * relative.transpose();
      pose = inSceneFrame(exact, pose);
    }
    const double sigma = std::sqrt(pose.covariance.bottomRightCorner<3, 3>().trace());
    if (sigma > 0.01) {
      result.pose.warnings.push_back(fmt::format(
          "'{}' is placed to {:.0f} mm only; wave longer, near and far, or use two balls",
          pose.camera, 1000 * sigma));
    }
    result.pose.rig.sourceCameras.push_back(std::move(pose));
  }
  for (std::size_t b = 0; b < best->balls.size(); ++b) {
    MirrorBall ball = best->balls[b];
    const Matrix3d rotation = scene.sceneFromCamera.linear();
    ball.centre = scene.sceneFromCamera * ball.centre;
    ball.centreCovariance = scale * rotation * centres[b] * rotation.transpose();
    result.balls.push_back(ball);
  }
  for (const auto& moment : best->placed) {
    if (moment.used)
      result.lamps.push_back({moment.moment, scene.sceneFromCamera * moment.lamp.position()});
  }
  return result;
}

}  // namespace lightsketch
