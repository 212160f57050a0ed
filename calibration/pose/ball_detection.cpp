#include "calibration/pose/ball_detection.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <random>
#include <vector>

#include "capture/frame/median.h"
#include "capture/frame/srgb.h"

namespace lightsketch {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kAzimuths = 180;
constexpr double kCoverageWithHint = 0.4;
constexpr double kCoverageAlone = 0.6;
constexpr double kEdge = 0.008;          // least slope of an edge, encoded units per pixel
constexpr float kLeastHighlight = 0.1f;  // of saturation: a mirror shows the lamp itself
constexpr double kFineEdge = 0.0015;     // the same in linear units, once the place is known
// What no average over the outline takes out: blooming, a lens's blur, the ball's own shade.
constexpr double kOutlineBiasPixels = 0.05;
constexpr double kUnseenBias = 0.02;  // of the radius, for an outline that hardly shows

// Encoded, a lamp's glare does not hide a dim outline; linear, the middle of an edge's slope is
// where the edge is (encoded, 0.1 pixels off).
Image<float> luminanceOf(const RadianceImage& image, bool encoded) {
  Image<float> result(image.width(), image.height(), 1);
  for (int y = 0; y < image.height(); ++y) {
    const auto from = image.row(y);
    const auto to = result.row(y);
    for (std::size_t x = 0; x < to.size(); ++x) {
      const float light = kRec709Luma[0] * from[3 * x] + kRec709Luma[1] * from[3 * x + 1] +
                          kRec709Luma[2] * from[3 * x + 2];
      const float clipped = std::clamp(light, 0.0f, 1.0f);
      to[x] = encoded ? srgbEncode(clipped) : clipped;
    }
  }
  return result;
}

// A picture that was taken for the lamp's highlight is dark all over else.
RadianceImage wellExposed(const RadianceImage& image) {
  std::vector<float> values(image.values().begin(), image.values().end());
  const auto high = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 10 * 9);
  std::nth_element(values.begin(), high, values.end());
  constexpr float kBright = 0.2f;
  RadianceImage exposed = image;
  if (!(*high > 0 && *high < kBright)) return exposed;
  const float gain = kBright / *high;
  for (float& value : exposed.values()) value *= gain;
  return exposed;
}

double sampleAt(const Image<float>& image, const Vector2d& pixel) {
  const double x = std::clamp(pixel.x() - 0.5, 0.0, image.width() - 1.0);
  const double y = std::clamp(pixel.y() - 0.5, 0.0, image.height() - 1.0);
  const int x0 = std::min(static_cast<int>(x), std::max(0, image.width() - 2));
  const int y0 = std::min(static_cast<int>(y), std::max(0, image.height() - 2));
  const int x1 = std::min(x0 + 1, image.width() - 1);
  const int y1 = std::min(y0 + 1, image.height() - 1);
  const double u = x - x0;
  const double v = y - y0;
  return (1 - v) * ((1 - u) * image(x0, y0) + u * image(x1, y0)) +
         v * ((1 - u) * image(x0, y1) + u * image(x1, y1));
}

// Slope along a unit direction, smoothed along it by the derivative of a Gaussian of 1 pixel.
double slopeAt(const Image<float>& image, const Vector2d& pixel, const Vector2d& direction) {
  static constexpr double kStep = 0.5;
  static constexpr int kReach = 6;
  double sum = 0;
  double weight = 0;
  for (int i = 1; i <= kReach; ++i) {
    const double t = kStep * i;
    const double w = t * std::exp(-t * t / 2);
    sum += w * (sampleAt(image, pixel + t * direction) - sampleAt(image, pixel - t * direction));
    weight += 2 * t * w;
  }
  return sum / weight;
}

struct Edge {
  Vector2d pixel;
  int azimuth = 0;
};

// Local maxima of the slope's size along [from, to], each to a fraction of a step.
std::vector<std::pair<double, double>> edgesAlong(const Image<float>& image, const Vector2d& start,
                                                  const Vector2d& direction, double from, double to,
                                                  double least) {
  constexpr double kStep = 0.5;
  std::vector<double> slopes;
  for (double t = from; t <= to; t += kStep) {
    slopes.push_back(std::abs(slopeAt(image, start + t * direction, direction)));
  }
  std::vector<std::pair<double, double>> edges;  // strength, place
  for (std::size_t i = 1; i + 1 < slopes.size(); ++i) {
    if (slopes[i] < least || slopes[i] < slopes[i - 1] || slopes[i] <= slopes[i + 1]) continue;
    const double curve = slopes[i - 1] - 2 * slopes[i] + slopes[i + 1];
    const double shift = curve < 0 ? 0.5 * (slopes[i - 1] - slopes[i + 1]) / curve : 0;
    edges.emplace_back(slopes[i], from + kStep * (static_cast<double>(i) + shift));
  }
  std::sort(edges.rbegin(), edges.rend());
  return edges;
}

// What outlines are made of: three numbers that pixels lie on or off.
struct Curve {
  // Through three or more pixels; nothing if they are on a line.
  std::function<std::optional<Vector3d>(const std::vector<Vector2d>&)> through;
  // Signed distance from the curve, pixels.
  std::function<double(const Vector3d&, const Vector2d&)> distance;
  // Point of the curve at an azimuth and the outward normal there.
  std::function<std::optional<std::pair<Vector2d, Vector2d>>(const Vector3d&, double)> at;
};

struct Outline {
  Vector3d curve = Vector3d::Zero();
  std::vector<Vector2d> edges;
  double coverage = 0;
};

std::optional<Outline> outlineNear(const Image<float>& encoded, const Image<float>& image,
                                   const BallHint& hint, const Curve& curve) {
  const double r = hint.radiusPixels;
  std::vector<Edge> edges;
  for (int a = 0; a < kAzimuths; ++a) {
    const double phi = 2 * std::numbers::pi * a / kAzimuths;
    const Vector2d direction(std::cos(phi), std::sin(phi));
    int taken = 0;
    for (const auto& [strength, place] :
         edgesAlong(encoded, hint.centre, direction, 0.6 * r, 1.4 * r, kEdge)) {
      const Vector2d pixel = hint.centre + place * direction;
      const bool inside = pixel.x() > 1 && pixel.y() > 1 && pixel.x() < image.width() - 1 &&
                          pixel.y() < image.height() - 1;
      if (inside) edges.push_back({pixel, a});
      if (++taken == 3) break;
    }
  }
  if (edges.size() < 6) return std::nullopt;

  const double tolerance = std::max(1.0, 0.01 * r);
  std::mt19937 random(1);
  struct Candidate {
    Vector3d curve = Vector3d::Zero();
    Vector2d centre = Vector2d::Zero();
    double radius = 0;
    int count = 0;  // azimuths with an edge on it
  };
  std::vector<Candidate> candidates;
  for (int trial = 0; trial < 3000; ++trial) {
    std::vector<Vector2d> three;
    for (int i = 0; i < 3; ++i) three.push_back(edges[random() % edges.size()].pixel);
    const auto found = curve.through(three);
    if (!found) continue;
    // Of the hint's size and place.
    const auto right = curve.at(*found, 0);
    const auto left = curve.at(*found, std::numbers::pi);
    if (!right || !left) continue;
    Candidate candidate;
    candidate.curve = *found;
    candidate.radius = (right->first - left->first).norm() / 2;
    candidate.centre = (right->first + left->first) / 2;
    if (candidate.radius < 0.65 * r || candidate.radius > 1.35 * r ||
        (candidate.centre - hint.centre).norm() > 0.4 * r) {
      continue;
    }
    int last = -1;
    for (const auto& edge : edges) {
      if (edge.azimuth == last || std::abs(curve.distance(*found, edge.pixel)) > tolerance)
        continue;
      ++candidate.count;
      last = edge.azimuth;
    }
    if (candidate.count >= kAzimuths / 5) candidates.push_back(candidate);
  }
  if (candidates.empty()) return std::nullopt;
  const auto byCount = [](const Candidate& a, const Candidate& b) { return a.count < b.count; };
  Candidate best = *std::max_element(candidates.begin(), candidates.end(), byCount);
  // A ball on a table mirrors the table's rim as a circle, often starker than the ball's outline,
  // where it mirrors what is right behind it. But the outline is around everything else.
  for (;;) {
    std::vector<Candidate> around;
    for (const Candidate& c : candidates) {
      if (c.radius > 1.04 * best.radius && 2 * c.count > best.count &&
          (c.centre - best.centre).norm() + best.radius < c.radius + 2 * tolerance) {
        around.push_back(c);
      }
    }
    if (around.empty()) break;
    best = *std::max_element(around.begin(), around.end(), byCount);
  }

  Outline outline;
  outline.curve = best.curve;
  for (int round = 0; round < 4; ++round) {
    const double reach = round == 0 ? 2 * tolerance : 2.0;
    outline.edges.clear();
    for (int a = 0; a < kAzimuths; ++a) {
      const auto place = curve.at(outline.curve, 2 * std::numbers::pi * a / kAzimuths);
      if (!place ||
          !(place->first.x() > 1 && place->first.y() > 1 && place->first.x() < image.width() - 1 &&
            place->first.y() < image.height() - 1)) {
        continue;
      }
      const auto found =
          edgesAlong(image, place->first, place->second, -reach - 0.5, reach + 0.5, kFineEdge);
      if (!found.empty())
        outline.edges.push_back(place->first + found.front().second * place->second);
    }
    // Twice: fit, then without what is far off.
    for (int pass = 0; pass < 2; ++pass) {
      const auto fitted = curve.through(outline.edges);
      if (!fitted) return std::nullopt;
      outline.curve = *fitted;
      std::vector<double> off;
      for (const auto& edge : outline.edges) {
        off.push_back(std::abs(curve.distance(outline.curve, edge)));
      }
      std::vector<double> sorted = off;
      const double limit = std::max(0.15, 3 * 1.48 * median(sorted));
      std::vector<Vector2d> kept;
      for (std::size_t i = 0; i < off.size(); ++i) {
        if (off[i] <= limit) kept.push_back(outline.edges[i]);
      }
      outline.edges = std::move(kept);
      if (outline.edges.size() < 10) return std::nullopt;
    }
  }
  const auto fitted = curve.through(outline.edges);
  if (!fitted) return std::nullopt;
  outline.curve = *fitted;
  outline.coverage = static_cast<double>(outline.edges.size()) / kAzimuths;
  return outline;
}

// Circle (x, y, r): x^2 + y^2 = 2 c . p + (r^2 - c^2), linear (Kasa); few pixels of scatter on a
// whole circle leave no bias that matters.
Curve circleCurve() {
  Curve curve;
  curve.through = [](const std::vector<Vector2d>& pixels) -> std::optional<Vector3d> {
    if (pixels.size() < 3) return std::nullopt;
    Vector2d mean = Vector2d::Zero();
    for (const auto& p : pixels) mean += p / static_cast<double>(pixels.size());
    Matrix3d normal = Matrix3d::Zero();
    Vector3d right = Vector3d::Zero();
    for (const auto& p : pixels) {
      const Vector3d row((p - mean).x(), (p - mean).y(), 1);
      normal += row * row.transpose();
      right += row * (p - mean).squaredNorm();
    }
    const Eigen::FullPivLU<Matrix3d> lu(normal);
    if (!lu.isInvertible()) return std::nullopt;
    const Vector3d s = lu.solve(right);
    const Vector2d centre = s.head<2>() / 2;
    const double r2 = s[2] + centre.squaredNorm();
    if (!(r2 > 0)) return std::nullopt;
    return Vector3d(centre.x() + mean.x(), centre.y() + mean.y(), std::sqrt(r2));
  };
  curve.distance = [](const Vector3d& c, const Vector2d& p) {
    return (p - c.head<2>()).norm() - c[2];
  };
  curve.at = [](const Vector3d& c, double azimuth) {
    const Vector2d normal(std::cos(azimuth), std::sin(azimuth));
    return std::optional(std::pair(Vector2d(c.head<2>() + c[2] * normal), normal));
  };
  return curve;
}

// Cone v . g = 1 with g = axis / cos(angle), linear for unit rays v.
Curve coneCurve(const CameraModel& model) {
  Curve curve;
  curve.through = [&model](const std::vector<Vector2d>& pixels) -> std::optional<Vector3d> {
    if (pixels.size() < 3) return std::nullopt;
    std::vector<Vector3d> rays;
    Vector3d mean = Vector3d::Zero();
    for (const auto& p : pixels) {
      const auto ray = model.unproject(p);
      if (!ray) continue;
      rays.push_back(*ray);
      mean += *ray;
    }
    if (rays.size() < 3) return std::nullopt;
    mean.normalize();
    Matrix3d frame;
    frame << mean.unitOrthogonal(), mean.cross(mean.unitOrthogonal()), mean;
    // In units of the spread, else the normal matrix is as narrow as the cone.
    double spread = 0;
    for (const auto& ray : rays) spread = std::max(spread, ray.cross(mean).norm());
    if (!(spread > 0)) return std::nullopt;
    Matrix3d normal = Matrix3d::Zero();
    Vector3d right = Vector3d::Zero();
    for (const auto& ray : rays) {
      const Vector3d local = frame.transpose() * ray;
      // local . g = 1 with g = (spread-scaled tangent parts, 1 + deficit spread^2).
      const Vector3d row(local.x() / spread, local.y() / spread, local.z());
      normal += row * row.transpose();
      right += row * (local.head<2>().squaredNorm() / (1 + local.z()) / (spread * spread));
    }
    const Eigen::FullPivLU<Matrix3d> lu(normal);
    if (!lu.isInvertible()) return std::nullopt;
    const Vector3d s = lu.solve(right);
    const Vector3d g =
        frame * Vector3d(s.x() * spread, s.y() * spread, 1 + s.z() * spread * spread);
    return g.norm() > 1 ? std::optional<Vector3d>(g) : std::nullopt;
  };
  curve.distance = [&model](const Vector3d& g, const Vector2d& p) {
    const auto ray = model.unproject(p);
    if (!ray) return 1e9;
    const Vector3d axis = g.normalized();
    const double off =
        std::atan2(ray->cross(axis).norm(), ray->dot(axis)) - std::acos(1 / g.norm());
    const double perRadian = std::sqrt(std::abs(model.pixelsPerRadian(axis).determinant()));
    return off * perRadian;
  };
  curve.at = [&model](const Vector3d& g,
                      double azimuth) -> std::optional<std::pair<Vector2d, Vector2d>> {
    const Vector3d axis = g.normalized();
    const double angle = std::acos(1 / g.norm());
    const Vector3d u = (Vector3d::UnitX() - axis.x() * axis).normalized();
    const Vector3d side = std::cos(azimuth) * u + std::sin(azimuth) * axis.cross(u);
    const auto ray = [&](double a) { return Vector3d(std::cos(a) * axis + std::sin(a) * side); };
    const auto pixel = model.project(ray(angle));
    // The edge's normal, not the radius: across the curve's own tangent.
    const double step = 1e-3;
    const Vector3d before = std::cos(azimuth - step) * u + std::sin(azimuth - step) * axis.cross(u);
    const Vector3d after = std::cos(azimuth + step) * u + std::sin(azimuth + step) * axis.cross(u);
    const auto p0 = model.project(std::cos(angle) * axis + std::sin(angle) * before);
    const auto p1 = model.project(std::cos(angle) * axis + std::sin(angle) * after);
    const auto outside = model.project(ray(angle * 1.01));
    if (!pixel || !p0 || !p1 || !outside) return std::nullopt;
    const Vector2d tangent = (*p1 - *p0).normalized();
    Vector2d normal(-tangent.y(), tangent.x());
    if (normal.dot(*outside - *pixel) < 0) normal = -normal;
    return std::pair(*pixel, normal);
  };
  return curve;
}

// Circles of the picture, best first.
std::vector<BallHint> roundThings(const Image<float>& image) {
  std::vector<BallHint> hints;
  try {
    cv::Mat small;
    const cv::Mat whole(image.height(), image.width(), CV_32F, const_cast<float*>(image.data()));
    const double shrink = std::min(1.0, 480.0 / std::max(image.width(), image.height()));
    cv::resize(whole, small, {}, shrink, shrink, cv::INTER_AREA);
    double top = 0;
    cv::minMaxLoc(small, nullptr, &top);
    cv::Mat bytes;
    small.convertTo(bytes, CV_8U, 255 / std::max(top, 1e-3));
    cv::GaussianBlur(bytes, bytes, {5, 5}, 1.2);
    std::vector<cv::Vec3f> circles;
    const int side = std::min(small.cols, small.rows);
    cv::HoughCircles(bytes, circles, cv::HOUGH_GRADIENT, 1.5, side / 10.0, 60, 25, side / 30,
                     side / 2);
    for (std::size_t i = 0; i < circles.size() && i < 12; ++i) {
      hints.push_back({{(circles[i][0] + 0.5) / shrink, (circles[i][1] + 0.5) / shrink},
                       circles[i][2] / shrink});
    }
  } catch (const cv::Exception&) {
    return {};  // no circles is what the caller reports
  }
  return hints;
}

Result<Outline> findOutline(const RadianceImage& image, const std::optional<BallHint>& hint,
                            const Curve& curve) {
  if (image.channels() != 3 || image.width() < 8 || image.height() < 8) {
    return failure(ErrorCode::kInvalidArgument, "mirror ball: needs an RGB picture");
  }
  const RadianceImage exposed = wellExposed(image);
  const Image<float> encoded = luminanceOf(exposed, true);
  const Image<float> linear = luminanceOf(exposed, false);
  if (hint) {
    if (!(hint->radiusPixels >= 3) || !hint->centre.allFinite()) {
      return failure(ErrorCode::kInvalidArgument,
                     "mirror ball: the hint must be a centre and a radius of 3 pixels or more");
    }
    auto outline = outlineNear(encoded, linear, *hint, curve);
    if (!outline || outline->coverage < kCoverageWithHint) {
      return failure(ErrorCode::kNotFound,
                     "mirror ball: not found near ({:.0f}, {:.0f}) with a radius of {:.0f}: {:.0f} "
                     "percent of its outline shows; give a closer hint, or a background that "
                     "stands out from the ball",
                     hint->centre.x(), hint->centre.y(), hint->radiusPixels,
                     outline ? 100 * outline->coverage : 0.0);
    }
    return std::move(*outline);
  }
  std::optional<Outline> best;
  double second = 0;
  const auto extent = [&](const Outline& outline) {
    const auto a = curve.at(outline.curve, 0);
    const auto b = curve.at(outline.curve, std::numbers::pi);
    return std::pair(Vector2d((a->first + b->first) / 2), (a->first - b->first).norm() / 2);
  };
  for (const auto& candidate : roundThings(encoded)) {
    auto outline = outlineNear(encoded, linear, candidate, curve);
    if (!outline || outline->coverage < kCoverageAlone) continue;
    if (!best) {
      best = std::move(outline);
      continue;
    }
    const auto [bestCentre, bestRadius] = extent(*best);
    const auto [centre, radius] = extent(*outline);
    const bool same = (centre - bestCentre).norm() < 0.2 * bestRadius &&
                      std::abs(radius - bestRadius) < 0.2 * bestRadius;
    if (outline->coverage > best->coverage) {
      if (!same) second = best->coverage;
      best = std::move(outline);
    } else if (!same) {
      second = std::max(second, outline->coverage);
    }
  }
  if (!best) {
    return failure(ErrorCode::kNotFound,
                   "mirror ball: not found in the picture; say where it is (centre and radius in "
                   "pixels)");
  }
  if (second > 0.9 * best->coverage) {
    return failure(ErrorCode::kNotFound,
                   "mirror ball: several round things could be it; say where it is (centre and "
                   "radius in pixels)");
  }
  return std::move(*best);
}

}  // namespace

Result<BallCircle> findBallCircle(const RadianceImage& image, const std::optional<BallHint>& hint) {
  ASSIGN_OR_RETURN(const auto outline, findOutline(image, hint, circleCurve()));
  return BallCircle{outline.curve.head<2>(), outline.curve[2], outline.coverage};
}

Result<BallCone> findBallCone(const RadianceImage& image, const CameraModel& model,
                              const std::optional<BallHint>& hint) {
  if (image.width() != model.width() || image.height() != model.height()) {
    return failure(ErrorCode::kInvalidArgument,
                   "mirror ball: the picture is {} x {}, the camera model for {} x {}",
                   image.width(), image.height(), model.width(), model.height());
  }
  const Curve curve = coneCurve(model);
  ASSIGN_OR_RETURN(const auto outline, findOutline(image, hint, curve));
  BallCone cone;
  cone.axis = outline.curve.normalized();
  cone.angularRadius = Angle::radians(std::acos(1 / outline.curve.norm()));
  cone.coverage = outline.coverage;
  // Normal equations of the three angles; the scatter of the edges gives the scale.
  const Vector3d u = cone.axis.unitOrthogonal();
  const Vector3d v = cone.axis.cross(u);
  Matrix3d normal = Matrix3d::Zero();
  double squares = 0;
  for (const auto& edge : outline.edges) {
    const Vector3d side = *model.unproject(edge) - cone.axis;
    const Vector2d around(side.dot(u), side.dot(v));
    const Vector3d row(-around.x() / around.norm(), -around.y() / around.norm(), -1);
    normal += row * row.transpose();
    squares += std::pow(curve.distance(outline.curve, edge), 2);
  }
  const double count = static_cast<double>(outline.edges.size());
  const double variance = squares / std::max(1.0, count - 3);
  const double perRadian = std::sqrt(std::abs(model.pixelsPerRadian(cone.axis).determinant()));
  // Where much of the outline does not show, what passes for the rest may be a shadow's edge.
  const double radiusPixels = perRadian * cone.angularRadius.radians();
  const double bias =
      std::hypot(kOutlineBiasPixels, kUnseenBias * (1 - cone.coverage) * radiusPixels);
  cone.covariance =
      (variance * normal.inverse() + bias * bias * Matrix3d::Identity()) / (perRadian * perRadian);
  return cone;
}

Image<std::uint8_t> ballMask(const BallCircle& circle, int width, int height) {
  Image<std::uint8_t> mask(width, height, 1);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      mask(x, y) = (Vector2d(x + 0.5, y + 0.5) - circle.centre).norm() < 0.98 * circle.radiusPixels;
    }
  }
  return mask;
}

Image<std::uint8_t> ballMask(const BallCone& cone, const CameraModel& model) {
  Image<std::uint8_t> mask(model.width(), model.height(), 1);
  const double least = std::cos(0.98 * cone.angularRadius.radians());
  for (int y = 0; y < mask.height(); ++y) {
    for (int x = 0; x < mask.width(); ++x) {
      const auto ray = model.unproject({x + 0.5, y + 0.5});
      mask(x, y) = ray && ray->dot(cone.axis) > least;
    }
  }
  return mask;
}

void lowerTo(RadianceImage& minimum, const RadianceImage& image) {
  if (minimum.empty()) {
    minimum = image;
    return;
  }
  for (std::size_t i = 0; i < minimum.size(); ++i) {
    minimum.data()[i] = std::min(minimum.data()[i], image.data()[i]);
  }
}

Result<Highlight> findHighlight(const RadianceImage& image, const RadianceImage& ambient,
                                const Image<std::uint8_t>& mask) {
  if (image.channels() != 3 || mask.width() != image.width() || mask.height() != image.height() ||
      (!ambient.empty() && !ambient.sameShape(image))) {
    return failure(ErrorCode::kInvalidArgument,
                   "mirror ball: picture, ambient picture and ball differ in size");
  }
  // The strongest channel: a coloured lamp is as bright as a white one.
  const int width = image.width();
  const int height = image.height();
  Image<float> excess(width, height, 1);
  float peak = 0;
  double area = 0;
  double sum = 0;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (!mask(x, y)) continue;
      float value = 0;
      for (int c = 0; c < 3; ++c) {
        value = std::max(value, image(x, y, c) - (ambient.empty() ? 0.0f : ambient(x, y, c)));
      }
      excess(x, y) = value;
      peak = std::max(peak, value);
      area += 1;
      sum += value;
    }
  }
  if (!(peak > kLeastHighlight) || peak < 4 * sum / std::max(area, 1.0)) {
    return failure(ErrorCode::kNotFound, "no highlight stands out on the ball");
  }

  // Spots above half of the peak.
  struct Spot {
    double weight = 0;
    Vector2d centre = Vector2d::Zero();
    Eigen::Matrix2d moments = Eigen::Matrix2d::Zero();
    int pixels = 0;    // of the core
    double flank = 0;  // sum and number of the pixels around it
    int around = 0;
    // How gently it fades away.
    double softness() const { return flank / std::max(around, 1); }

    void add(int x, int y, double w) {
      const Vector2d p(x + 0.5, y + 0.5);
      weight += w;
      centre += w * p;
      moments += w * p * p.transpose();
    }
  };
  std::vector<Spot> spots;
  const float threshold = 0.5f * peak;
  Image<std::uint8_t> done(width, height, 1);
  std::vector<std::pair<int, int>> stack;
  for (int y0 = 0; y0 < height; ++y0) {
    for (int x0 = 0; x0 < width; ++x0) {
      if (done(x0, y0) || excess(x0, y0) <= threshold) continue;
      Spot spot;
      stack.assign(1, {x0, y0});
      done(x0, y0) = 1;
      while (!stack.empty()) {
        const auto [x, y] = stack.back();
        stack.pop_back();
        spot.add(x, y, excess(x, y));
        ++spot.pixels;
        for (int dy = -1; dy <= 1; ++dy) {
          for (int dx = -1; dx <= 1; ++dx) {
            const int nx = x + dx;
            const int ny = y + dy;
            if (nx < 0 || ny < 0 || nx >= width || ny >= height || done(nx, ny)) continue;
            done(nx, ny) = 1;
            if (excess(nx, ny) > threshold) {
              stack.emplace_back(nx, ny);
            } else {
              spot.add(nx, ny, excess(nx, ny));  // its flank carries the fraction of a pixel
              spot.flank += excess(nx, ny);
              ++spot.around;
            }
          }
        }
      }
      spots.push_back(spot);
    }
  }
  std::sort(spots.begin(), spots.end(),
            [](const Spot& a, const Spot& b) { return a.weight > b.weight; });
  // The lamp itself is so bright that its image ends within a pixel; the sheen of a table that the
  // ball mirrors may be clipped as well, and larger, but fades away.
  constexpr int kLeastPixels = 3;
  constexpr double kSharper = 0.8;
  const auto sharpest =
      std::min_element(spots.begin(), spots.end(), [](const Spot& a, const Spot& b) {
        return std::pair(a.pixels < kLeastPixels, a.softness()) <
               std::pair(b.pixels < kLeastPixels, b.softness());
      });
  if (sharpest->pixels >= kLeastPixels &&
      sharpest->softness() < kSharper * spots.front().softness()) {
    const Spot lamp = *sharpest;
    std::erase_if(spots, [&](const Spot& s) { return lamp.softness() < kSharper * s.softness(); });
  }
  Spot& spot = spots.front();
  if (spot.pixels > 0.1 * area) {
    return failure(ErrorCode::kNotFound,
                   "the bright spot fills {:.0f} percent of the ball; it is no mirror, or the "
                   "picture is over-exposed",
                   100 * spot.pixels / area);
  }
  if (spots.size() > 1 && spots[1].weight > 0.5 * spot.weight) {
    return failure(ErrorCode::kNotFound,
                   "two highlights on the ball are nearly as strong; darken the room or subtract "
                   "the ambient picture");
  }
  spot.centre /= spot.weight;
  spot.moments = spot.moments / spot.weight - spot.centre * spot.centre.transpose();
  Highlight highlight;
  highlight.place.pixel = spot.centre;
  // A clipped spot tells little more than which n pixels it covers: 0.25 pixels for one, falling
  // with n^(3/4), the law of digital discs.
  highlight.place.covariance = spot.moments / 2500 + (0.0005 + 0.06 / std::pow(spot.pixels, 1.5)) *
                                                         Eigen::Matrix2d::Identity();
  highlight.areaPixels = spot.pixels;
  highlight.peak = peak;
  return highlight;
}

}  // namespace lightsketch
