#include "synthetic_room.h"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace lightsketch {
namespace {

constexpr int kSize = 960;
constexpr double kLampRadiusMetres = 0.02;
constexpr double kLampRadiance = 30;  // in units of saturation

}  // namespace

SyntheticRoom::SyntheticRoom(std::uint32_t seed, PixelFormat format)
    : format_(format),
      random_(seed),
      room_(kSize * kSize),
      canvas_(kSize * kSize),
      noise_(3 * kSize * kSize) {
  FisheyeParameters lens;
  lens.width = lens.height = kSize;
  lens.fx = lens.fy = 296;
  lens.cx = 481.3;
  lens.cy = 478.9;
  lens.k = {0.012, -0.006, 0.001, 0};
  lens.maxFieldAngle = Angle::degrees(92.5);
  model_ = FisheyeModel::create(lens).value();

  // Table to the side and below: y is down. A picture's glass in front.
  mirrors.push_back({{0, -1, 0}, 0.25, 1e9, Eigen::Vector3d::Zero()});
  mirrors.push_back({Eigen::Vector3d(0.3, 0, -1).normalized(), 1.6, 0.4, {-0.5, -0.3, 1.5}});
  ceilingLamps_ = {Eigen::Vector3d(0.3, -0.9, 0.4).normalized(),
                   Eigen::Vector3d(-0.5, -0.7, 0.5).normalized()};
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      const bool window = x > 600 && x < 700 && y > 250 && y < 340;
      room_[static_cast<std::size_t>(y * kSize + x)] =
          window ? 0.55f
                 : 0.05f + 0.03f * static_cast<float>(std::sin(x * 0.01) * std::cos(y * 0.013));
    }
  }
  std::normal_distribution<float> gauss(0, 1);
  for (float& n : noise_) n = gauss(random_);
}

// A disc with an edge one pixel soft and, around it, the halo that blooming and stray light in the
// lens give: a Moffat tail whose size does not depend on the light and whose height does.
void SyntheticRoom::addDisc(const Eigen::Vector3d& direction, double radius, double radiance,
                            double covered, double coverAngle) {
  const auto centre = model_->project(direction);
  if (!centre) return;
  const Eigen::Matrix2d jacobian = model_->pixelsPerRadian(direction);
  const Eigen::Matrix2d inverse = jacobian.inverse();
  const double scale = std::sqrt(std::abs(jacobian.determinant()));
  const double visible = 1 - covered;
  // The visible part's centroid, roughly: the hidden side is cut off.
  const Eigen::Vector2d side(std::cos(coverAngle), std::sin(coverAngle));
  const Eigen::Vector2d shift = side * covered * radius * scale;
  const double area = M_PI * radius * radius * scale * scale * visible;
  const int reach = 70;
  for (int y = std::max(0, static_cast<int>(centre->y()) - reach);
       y < std::min(kSize, static_cast<int>(centre->y()) + reach); ++y) {
    for (int x = std::max(0, static_cast<int>(centre->x()) - reach);
         x < std::min(kSize, static_cast<int>(centre->x()) + reach); ++x) {
      const Eigen::Vector2d p(x + 0.5 - centre->x(), y + 0.5 - centre->y());
      const double inside = std::clamp((radius - (inverse * p).norm()) * scale + 0.5, 0.0, 1.0);
      const double open =
          std::clamp(p.dot(side) - (2 * covered - 1) * radius * scale + 0.5, 0.0, 1.0);
      const double r2 = (p - shift).squaredNorm();
      const double fall = 1 + r2 / 9;
      const double halo = 0.02 * area / (fall * std::sqrt(fall)) / (2 * M_PI * 9);
      canvas_[static_cast<std::size_t>(y * kSize + x)] +=
          static_cast<float>(radiance * (inside * (covered > 0 ? open : 1) + halo));
    }
  }
}

std::vector<std::pair<Eigen::Vector3d, double>> SyntheticRoom::reflections(
    const Eigen::Vector3d& lamp) const {
  std::vector<std::pair<Eigen::Vector3d, double>> result;
  for (const Mirror& mirror : mirrors) {
    const double height = lamp.dot(mirror.normal) + mirror.distance;
    const Eigen::Vector3d image = lamp - 2 * height * mirror.normal;
    const Eigen::Vector3d ray = image.normalized();
    const double cosine = -ray.dot(mirror.normal);
    double reflectance = 0;
    if (height > 0 && cosine > 0) {
      const Eigen::Vector3d hit = ray * mirror.distance / cosine;
      // Schlick 1994 for glass or varnish.
      if ((hit - mirror.centre).norm() < mirror.extent) {
        reflectance = 0.04 + 0.96 * std::pow(1 - cosine, 5);
      }
    }
    result.emplace_back(image, reflectance);
  }
  return result;
}

Frame SyntheticRoom::draw(double time, const LampPicture& picture) {
  canvas_ = room_;
  std::uniform_real_distribution<double> uniform(0, 1);
  for (const Eigen::Vector3d& lamp : ceilingLamps_) {
    addDisc(lamp, 0.04, 6 * (1 + flicker * (uniform(random_) - 0.5)), 0, 0);
  }
  if (picture.lit) {
    const auto size = [](const Eigen::Vector3d& p) { return kLampRadiusMetres / p.norm(); };
    const double radiance = kLampRadiance * picture.power;
    if (picture.covered < 1) {
      addDisc(picture.lamp.normalized(), size(picture.lamp), radiance, picture.covered,
              picture.coverAngle);
    }
    // The hand hides the lamp from the camera, not from the mirrors.
    for (const auto& [image, reflectance] : reflections(picture.lamp)) {
      if (reflectance > 0) addDisc(image.normalized(), size(image), reflectance * radiance, 0, 0);
    }
  }

  Frame frame;
  frame.format = format_;
  frame.width = frame.height = kSize;
  frame.metadata.midExposure = TimePoint(fromSeconds(time));
  frame.metadata.exposureSeconds = 0.001;
  const PixelFormatInfo& info = pixelFormatInfo(format_);
  const float maximum = static_cast<float>((1 << info.bits) - 1);
  frame.bytes.resize(canvas_.size() * static_cast<std::size_t>(info.bytesPerPixel));
  const std::size_t start =
      std::uniform_int_distribution<std::size_t>(0, noise_.size() - canvas_.size())(random_);
  for (std::size_t i = 0; i < canvas_.size(); ++i) {
    // Read noise of 0.4 percent and shot noise of a 10,000-electron pixel.
    const float sigma = std::sqrt(1.6e-5f + 1e-4f * std::min(1.0f, canvas_[i]));
    const float value = std::clamp(canvas_[i] + sigma * noise_[start + i], 0.0f, 1.0f);
    const int count = static_cast<int>(value * maximum + 0.5f);
    if (info.bits <= 8) {
      frame.bytes[i] = static_cast<std::uint8_t>(count);
    } else {
      frame.bytes[2 * i] = static_cast<std::uint8_t>(count & 255);
      frame.bytes[2 * i + 1] = static_cast<std::uint8_t>(count >> 8);
    }
  }
  return frame;
}

}  // namespace lightsketch
