// Lamps so near that every part of the subject sees them from another side and at another distance.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <span>

#include "calibration/model/camera_model.h"
#include "capture/frame/image.h"
#include "capture/frame/result.h"

namespace lightsketch {

// The subject's surface as the scene camera sees it: h x w x 3, the point of each pixel, metres,
// scene frame.
using SurfacePoints = Image<float>;

// A flat subject: where each pixel's ray meets the plane z = `height`. Fails if the camera does not
// look at that plane everywhere.
Result<SurfacePoints> flatSurface(const CameraModel& sceneCamera,
                                  const Eigen::Isometry3d& sceneFromCamera, double height = 0);
// A subject of given depth: distances along the scene camera's optical axis, metres, one channel,
// of the picture's size.
Result<SurfacePoints> surfaceFromDepth(const CameraModel& sceneCamera,
                                       const Eigen::Isometry3d& sceneFromCamera,
                                       const Image<float>& depth);

// By how much a surface at `point` is lit more strongly by a lamp at `lamp` than a surface at the
// origin: |lamp|^2 / |lamp - point|^2.
double nearFactor(const Eigen::Vector3d& lamp, const Eigen::Vector3d& point);

}  // namespace lightsketch
