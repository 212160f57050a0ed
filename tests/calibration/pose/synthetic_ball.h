// A mirror ball, its lamp and its cameras, made without the code under test: the mirror point by
// Fermat's principle, pictures by following rays.
#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <memory>
#include <numbers>
#include <random>
#include <vector>

#include "calibration/model/camera_model.h"
#include "calibration/model/rig_geometry.h"
#include "capture/frame/image.h"

namespace lightsketch {

// Tangent law by its series: a perspective lens to 1e-5 of the focal length within 20 degrees.
inline std::shared_ptr<const CameraModel> perspectiveCamera(double focal = 900) {
  FisheyeParameters p;
  p.width = 640;
  p.height = 480;
  p.fx = p.fy = focal;
  p.cx = 322;
  p.cy = 239;
  p.k = {1.0 / 3, 2.0 / 15, 17.0 / 315, 62.0 / 2835, 1382.0 / 155925, 21844.0 / 6081075};
  p.maxFieldAngle = Angle::degrees(35);
  return FisheyeModel::create(p).value();
}

inline std::shared_ptr<const CameraModel> sourceFisheye() {
  FisheyeParameters p;
  p.width = p.height = 960;
  p.fx = 345;
  p.fy = 344;
  p.cx = 483;
  p.cy = 477;
  p.k = {-0.02, 0.004, -0.003, 0.0004, 0, 0};
  p.p = {0.0008, -0.0005};
  p.maxFieldAngle = Angle::degrees(95);
  return FisheyeModel::create(p).value();
}

// One metre in front of the subject, square on it.
inline CameraPose sceneCameraPose() {
  CameraPose pose;
  pose.camera = "scene";
  pose.sceneFromCamera.linear() = Eigen::Vector3d(1, -1, -1).asDiagonal();
  pose.sceneFromCamera.translation() = Eigen::Vector3d(0, 0, 1);
  return pose;
}

// Beside the subject, looking roughly to the viewer.
inline CameraPose sourceCameraPose(const Eigen::Vector3d& place, const Eigen::Vector3d& turn) {
  CameraPose pose;
  pose.camera = "source";
  const Eigen::Matrix3d facing = Eigen::Vector3d(-1, -1, 1).asDiagonal();
  pose.sceneFromCamera.linear() =
      Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix() * facing;
  pose.sceneFromCamera.translation() = place;
  return pose;
}

// Where light from the lamp to the eye touches the ball: the shortest way (Fermat), found by
// shrinking steps on the sphere.
inline Eigen::Vector3d fermatPoint(const Eigen::Vector3d& eye, const Eigen::Vector3d& lamp,
                                   const Eigen::Vector3d& centre, double radius) {
  const auto length = [&](const Eigen::Vector3d& n) {
    const Eigen::Vector3d m = centre + radius * n;
    return (eye - m).norm() + (lamp - m).norm();
  };
  Eigen::Vector3d n = ((eye - centre).normalized() + (lamp - centre).normalized()).normalized();
  double best = length(n);
  for (double step = 0.2; step > 1e-10;) {
    const Eigen::Vector3d u = n.unitOrthogonal();
    const Eigen::Vector3d v = n.cross(u);
    bool moved = false;
    for (int i = 0; i < 8; ++i) {
      const double phi = std::numbers::pi * i / 4;
      const Eigen::Vector3d to = (n + step * (std::cos(phi) * u + std::sin(phi) * v)).normalized();
      if (const double there = length(to); there < best) {
        best = there;
        n = to;
        moved = true;
      }
    }
    if (!moved) step /= 2;
  }
  return centre + radius * n;
}

// Lamps in front of the subject, 0.6 to 1.5 m away, at least 15 degrees above its plane.
inline Eigen::Vector3d randomLamp(std::mt19937& random) {
  std::uniform_real_distribution<double> uniform(0, 1);
  const double z = 0.26 + 0.72 * uniform(random);
  const double phi = 2 * std::numbers::pi * uniform(random);
  const double r = std::sqrt(1 - z * z);
  return (0.6 + 0.9 * uniform(random)) * Eigen::Vector3d(r * std::cos(phi), r * std::sin(phi), z);
}

inline double degreesBetween(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b)) * 180 / std::numbers::pi;
}

// A picture of the ball before a wall with stripes, mirroring a dim room with a ceiling light, and
// the lamp if there is one: smaller than a pixel in the ball, so its spot is put where Fermat says
// (rays through ninths of a pixel would miss it).
class BallPicture {
 public:
  BallPicture(std::shared_ptr<const CameraModel> model, const CameraPose& pose,
              const Eigen::Vector3d& centre, double radius)
      : model_(std::move(model)), pose_(pose), centre_(centre), radius_(radius) {
    for (int y = 0; y < 3 * model_->height(); ++y) {
      for (int x = 0; x < 3 * model_->width(); ++x) {
        const auto ray = model_->unproject({(x + 0.5) / 3, (y + 0.5) / 3});
        rays_.push_back(ray ? Eigen::Vector3d(pose_.sceneFromCamera.linear() * *ray)
                            : Eigen::Vector3d(0, 0, 0));
      }
    }
  }

  // `noise`: one sigma, of radiance. The lens blurs by 0.7 pixels, the spot by 0.8; values clip at
  // 1 as a sensor's.
  RadianceImage render(const Eigen::Vector3d* lamp, double noise = 0, unsigned seed = 1,
                       bool ceilingLight = true) const {
    const int width = model_->width();
    const int height = model_->height();
    Image<float> sharp(width, height, 1);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        double sum = 0;
        for (int i = 0; i < 9; ++i) {
          const std::size_t index =
              static_cast<std::size_t>(3 * y + i / 3) * 3 * static_cast<std::size_t>(width) +
              static_cast<std::size_t>(3 * x + i % 3);
          sum += radiance(rays_[index], ceilingLight);
        }
        sharp(x, y) = static_cast<float>(sum / 9);
      }
    }
    const Image<float> blurred = blur(blur(sharp, 1, 0), 0, 1);
    Eigen::Vector2d spot = Eigen::Vector2d::Zero();
    if (lamp) {
      const Eigen::Vector3d point =
          fermatPoint(pose_.sceneFromCamera.translation(), *lamp, centre_, radius_);
      spot = model_->projectPoint(pose_.sceneFromCamera.inverse() * point).value();
    }
    std::mt19937 random(seed);
    std::normal_distribution<double> normal(0, noise);
    RadianceImage image(width, height, 3);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const double r2 = (Eigen::Vector2d(x + 0.5, y + 0.5) - spot).squaredNorm();
        const double value = blurred(x, y) + (lamp ? 10 * std::exp(-r2 / (2 * 0.8 * 0.8)) : 0.0) +
                             (noise > 0 ? normal(random) : 0.0);
        for (int c = 0; c < 3; ++c)
          image(x, y, c) = static_cast<float>(std::clamp(value, 0.0, 1.0));
      }
    }
    return image;
  }

 private:
  static Image<float> blur(const Image<float>& image, int dx, int dy) {
    Image<float> result(image.width(), image.height(), 1);
    for (int y = 0; y < image.height(); ++y) {
      for (int x = 0; x < image.width(); ++x) {
        double sum = 0;
        double weight = 0;
        for (int k = -3; k <= 3; ++k) {
          const int nx = std::clamp(x + k * dx, 0, image.width() - 1);
          const int ny = std::clamp(y + k * dy, 0, image.height() - 1);
          const double w = std::exp(-k * k / (2 * 0.7 * 0.7));
          sum += w * image(nx, ny);
          weight += w;
        }
        result(x, y) = static_cast<float>(sum / weight);
      }
    }
    return result;
  }

  double radiance(const Eigen::Vector3d& ray, bool ceiling) const {
    const Eigen::Vector3d eye = pose_.sceneFromCamera.translation();
    const Eigen::Vector3d to = centre_ - eye;
    const double along = to.dot(ray);
    const double inside = radius_ * radius_ - (to - along * ray).squaredNorm();
    if (inside < 0) {
      // Wall: broad stripes, brighter than what the ball mirrors of the room.
      const double across = ray.x() / std::max(1e-9, -ray.z());
      return 0.3 + 0.05 * std::sin(40 * across);
    }
    const Eigen::Vector3d point = eye + (along - std::sqrt(inside)) * ray;
    const Eigen::Vector3d n = (point - centre_) / radius_;
    const Eigen::Vector3d out = ray - 2 * ray.dot(n) * n;
    if (ceiling && out.dot(Eigen::Vector3d(0.3, 0.9, 0.3).normalized()) > 0.998) return 20;
    return 0.05 + 0.03 * out.y() + 0.02 * std::sin(7 * out.x());
  }

  std::shared_ptr<const CameraModel> model_;
  CameraPose pose_;
  Eigen::Vector3d centre_;
  double radius_;
  std::vector<Eigen::Vector3d> rays_;
};

}  // namespace lightsketch
