#include "pipeline/compress/near_light.h"

#include <cmath>
#include <functional>

namespace lightsketch {
namespace {

using Eigen::Vector3d;

// `along`: how far from its ray's origin along the ray, both in camera coordinates, each pixel's
// point lies.
Result<SurfacePoints> surfaceAlong(
    const CameraModel& camera, const Eigen::Isometry3d& sceneFromCamera,
    const std::function<double(const Vector3d& origin, const Vector3d& ray, int x, int y)>& along) {
  SurfacePoints points(camera.width(), camera.height(), 3);
  for (int y = 0; y < camera.height(); ++y) {
    for (int x = 0; x < camera.width(); ++x) {
      const auto ray = camera.unproject({x + 0.5, y + 0.5});
      const Vector3d origin = ray ? camera.rayOrigin(*ray) : Vector3d::Zero();
      const double distance = ray ? along(origin, *ray, x, y) : 0;
      if (!(distance > 0) || !std::isfinite(distance)) {
        return failure(ErrorCode::kInvalidArgument,
                       "near light: pixel ({}, {}) of the scene camera does not see the subject's "
                       "surface; check the scene camera's model and pose, and the depth",
                       x, y);
      }
      const Vector3d point = sceneFromCamera * (origin + distance * *ray);
      for (int c = 0; c < 3; ++c) points(x, y, c) = static_cast<float>(point[c]);
    }
  }
  return points;
}

}  // namespace

Result<SurfacePoints> flatSurface(const CameraModel& camera,
                                  const Eigen::Isometry3d& sceneFromCamera, double height) {
  return surfaceAlong(
      camera, sceneFromCamera, [&](const Vector3d& origin, const Vector3d& ray, int, int) {
        return (height - (sceneFromCamera * origin).z()) / (sceneFromCamera.linear() * ray).z();
      });
}

Result<SurfacePoints> surfaceFromDepth(const CameraModel& camera,
                                       const Eigen::Isometry3d& sceneFromCamera,
                                       const Image<float>& depth) {
  if (depth.width() != camera.width() || depth.height() != camera.height() || depth.empty()) {
    return failure(ErrorCode::kInvalidArgument,
                   "near light: the depth is {} x {}, the scene camera {} x {}", depth.width(),
                   depth.height(), camera.width(), camera.height());
  }
  return surfaceAlong(camera, sceneFromCamera,
                      [&](const Vector3d& origin, const Vector3d& ray, int x, int y) {
                        return (static_cast<double>(depth(x, y)) - origin.z()) / ray.z();
                      });
}

double nearFactor(const Vector3d& lamp, const Vector3d& point) {
  return lamp.squaredNorm() / (lamp - point).squaredNorm();
}

}  // namespace lightsketch
