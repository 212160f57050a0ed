// Lenses and boards with a known truth, written apart from the code that they test: own radial
// laws, own projection, own inverse.
#pragma once

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <cmath>
#include <functional>
#include <numbers>
#include <optional>
#include <random>
#include <vector>

#include "calibration/lens/board.h"
#include "calibration/model/camera_model.h"

namespace lightsketch {

inline constexpr double kDegree = std::numbers::pi / 180;

inline double angleOf(const Eigen::Vector3d& p) {
  return std::atan2(std::hypot(p.x(), p.y()), p.z());
}

struct TrueLens {
  // kFamily: a polynomial of theta. kOutside: equisolid-like with a ripple, decentring and unequal
  // focal lengths; no polynomial. kPupil: kOutside's law whose pupil moves by 4 mm theta^2.
  // kPinhole: a perspective lens with a little barrel.
  enum class Kind { kFamily, kOutside, kPupil, kPinhole };
  Kind kind = Kind::kFamily;
  int width = 1920;
  int height = 1920;
  double focal = 560;
  double cx = 967.3;
  double cy = 951.8;

  Eigen::Vector2d project(const Eigen::Vector3d& p) const {
    const double rho = std::hypot(p.x(), p.y());
    const double theta = std::atan2(rho, p.z());
    const double c = rho > 1e-14 ? p.x() / rho : 1;
    const double s = rho > 1e-14 ? p.y() / rho : 0;
    const double t = theta * theta;
    if (kind == Kind::kFamily) {
      const double d =
          theta * (1 + 0.042 * t - 0.014 * t * t + 0.0035 * t * t * t - 0.0006 * t * t * t * t);
      return {focal * d * c + cx, 1.0007 * focal * d * s + cy};
    }
    if (kind == Kind::kPinhole) {
      const double r = std::tan(theta);
      const double d = r * (1 - 0.12 * r * r + 0.03 * r * r * r * r);
      return {focal * d * c + cx, 1.0004 * focal * d * s + cy};
    }
    const double d = 1.62 * std::sin(theta / 1.62) + 0.0016 * std::sin(5.5 * theta) * theta;
    const double x = d * c;
    const double y = d * s;
    const double xd = x + 2 * 0.0007 * x * y - 0.0005 * (d * d + 2 * x * x);
    const double yd = y + 0.0007 * (d * d + 2 * y * y) - 2 * 0.0005 * x * y;
    return {1.02 * focal * xd + cx, 1.0213 * focal * yd + cy};
  }

  // A point in metres.
  Eigen::Vector2d see(Eigen::Vector3d p) const {
    if (kind == Kind::kPupil) {
      // The ray's own angle, to which these rounds bring the point's, says how far the pupil is.
      const double z = p.z();
      for (int i = 0; i < 12; ++i) p.z() = z - 0.004 * std::pow(angleOf(p), 2);
    }
    return project(p);
  }
};

struct SceneOptions {
  int views = 40;
  double noisePixels = 0.2;
  double fieldDegrees = 94;  // no corner lies further out
  unsigned seed = 1;
  Eigen::Vector2d warp{0.0012, -0.0007};
  double nearest = 0.30;  // metres
  double farthest = 0.65;
  double leastTilt = 15;  // degrees against the line of sight
  double mostTilt = 45;
};

inline BoardGeometry largeBoard() {
  BoardGeometry board;
  board.columns = 14;
  board.rows = 10;
  board.spacingMetres = 0.045;
  return board;
}

// Boards all over the field, near the edge too, tilted and rolled at random.
inline std::vector<BoardView> syntheticViews(const TrueLens& lens, const BoardGeometry& board,
                                             const SceneOptions& options) {
  std::mt19937 random(options.seed);
  std::normal_distribution<double> normal(0, 1);
  std::uniform_real_distribution<double> uniform(0, 1);
  std::vector<BoardView> views;
  const Eigen::Vector3d middle((board.columns - 1) * board.spacingMetres / 2,
                               (board.rows - 1) * board.spacingMetres / 2, 0);
  for (int attempt = 0; static_cast<int>(views.size()) < options.views && attempt < 100'000;
       ++attempt) {
    const double k = static_cast<double>(views.size());
    const double theta =
        0.93 * options.fieldDegrees * kDegree * std::sqrt((k + 0.5) / options.views);
    const double phi = 2 * std::numbers::pi * k * 0.618034 + 0.2 * normal(random);
    const Eigen::Vector3d sight(std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi),
                                std::cos(theta));
    const double distance =
        options.nearest + (options.farthest - options.nearest) * uniform(random);
    const Eigen::Vector3d hinge =
        Eigen::AngleAxisd(2 * std::numbers::pi * uniform(random), sight) * sight.unitOrthogonal();
    const double tilt =
        (options.leastTilt + (options.mostTilt - options.leastTilt) * uniform(random)) * kDegree;
    const Eigen::Vector3d z = Eigen::AngleAxisd(tilt, hinge) * sight;
    const Eigen::Vector3d x =
        Eigen::AngleAxisd(2 * std::numbers::pi * uniform(random), z) * z.unitOrthogonal();
    Eigen::Matrix3d rotation;
    rotation << x, z.cross(x), z;
    const Eigen::Vector3d translation = distance * sight - rotation * middle;
    BoardView view;
    view.name = "view " + std::to_string(views.size() + 1);
    for (int row = 0; row < board.rows; ++row) {
      for (int column = 0; column < board.columns; ++column) {
        const double u = 2.0 * column / (board.columns - 1) - 1;
        const double v = 2.0 * row / (board.rows - 1) - 1;
        const Eigen::Vector3d onBoard(
            column * board.spacingMetres, row * board.spacingMetres,
            options.warp.x() * (1 - u * u) + options.warp.y() * (1 - v * v));
        const Eigen::Vector3d p = rotation * onBoard + translation;
        if (angleOf(p) > options.fieldDegrees * kDegree) continue;
        if (z.dot(p) < 0.05 * p.norm()) continue;  // edge on
        Eigen::Vector2d pixel = lens.see(p);
        if (pixel.x() < 2 || pixel.y() < 2 || pixel.x() > lens.width - 2 ||
            pixel.y() > lens.height - 2) {
          continue;
        }
        const double down = normal(random);  // drawn in an order that compilers do not choose
        const double across = normal(random);
        pixel += options.noisePixels * Eigen::Vector2d(across, down);
        view.corners.push_back({column, row, pixel});
      }
    }
    if (view.corners.size() >= 40) views.push_back(std::move(view));
  }
  return views;
}

// Errors in radians of the directions that `bearing` gives the truth's pixels, after the best
// common rotation over the directions out to `fieldDegrees`; NaN where it gives none.
struct DirectionErrors {
  std::vector<Eigen::Vector3d> directions;  // true
  std::vector<double> errors;

  double rms(double fromDegrees, double toDegrees) const {
    return of(fromDegrees, toDegrees).first;
  }
  double largest(double fromDegrees, double toDegrees) const {
    return of(fromDegrees, toDegrees).second;
  }

 private:
  std::pair<double, double> of(double from, double to) const {
    double sum = 0;
    double most = 0;
    int count = 0;
    for (std::size_t i = 0; i < errors.size(); ++i) {
      const double degrees = angleOf(directions[i]) / kDegree;
      if (degrees < from || degrees > to) continue;
      if (std::isnan(errors[i])) return {std::nan(""), std::nan("")};
      sum += errors[i] * errors[i];
      most = std::max(most, errors[i]);
      ++count;
    }
    return {std::sqrt(sum / count), most};
  }
};

using Bearing = std::function<std::optional<Eigen::Vector3d>(const Eigen::Vector2d&)>;

inline DirectionErrors directionErrors(const TrueLens& lens, const Bearing& bearing,
                                       double fieldDegrees) {
  DirectionErrors result;
  std::vector<std::optional<Eigen::Vector3d>> found;
  Eigen::Matrix3d correlation = Eigen::Matrix3d::Zero();
  for (double degrees = 1; degrees <= fieldDegrees + 1e-9; degrees += 1) {
    for (int i = 0; i < 72; ++i) {
      const double theta = degrees * kDegree;
      const double phi = 2 * std::numbers::pi * i / 72;
      const Eigen::Vector3d direction(std::sin(theta) * std::cos(phi),
                                      std::sin(theta) * std::sin(phi), std::cos(theta));
      result.directions.push_back(direction);
      found.push_back(bearing(lens.project(direction)));
      // Even weight per solid angle.
      if (found.back()) correlation += std::sin(theta) * direction * found.back()->transpose();
    }
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(correlation,
                                              Eigen::ComputeFullU | Eigen::ComputeFullV);
  const double sign = (svd.matrixU() * svd.matrixV().transpose()).determinant();
  const Eigen::Matrix3d rotation =
      svd.matrixU() * Eigen::Vector3d(1, 1, sign).asDiagonal() * svd.matrixV().transpose();
  for (std::size_t i = 0; i < found.size(); ++i) {
    if (!found[i]) {
      result.errors.push_back(std::nan(""));
      continue;
    }
    const Eigen::Vector3d turned = rotation * *found[i];
    result.errors.push_back(
        std::atan2(turned.cross(result.directions[i]).norm(), turned.dot(result.directions[i])));
  }
  return result;
}

inline DirectionErrors directionErrors(const TrueLens& lens, const CameraModel& model,
                                       double fieldDegrees) {
  return directionErrors(
      lens, [&](const Eigen::Vector2d& pixel) { return model.unproject(pixel); }, fieldDegrees);
}

}  // namespace lightsketch
