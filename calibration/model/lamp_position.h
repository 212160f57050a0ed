// Where the lamp is, from rays of cameras that see it. Scene frame: metres, origin on the subject.
#pragma once

#include <Eigen/Core>
#include <span>

#include "calibration/model/camera_model.h"
#include "calibration/model/rig_geometry.h"
#include "capture/frame/result.h"

namespace lightsketch {

// A line of sight to the lamp; covariances are one-sigma and to first order.
struct LampRay {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();           // unit vector towards the lamp
  Eigen::Matrix3d directionCovariance = Eigen::Matrix3d::Zero();  // rank 2, radians^2
  Eigen::Matrix3d originCovariance = Eigen::Matrix3d::Zero();     // metres^2
  Eigen::Matrix3d originDirectionCovariance = Eigen::Matrix3d::Zero();  // E[origin direction^T]
};

// The ray that a lamp's pixel stands for: uncertain by the pixel, by the lens (directionCovariance)
// and by the pose. Fails with kInvalidArgument outside the valid field. With an identity pose the
// ray is in the camera's own frame.
Result<LampRay> lampRay(const CameraPose& pose, const CameraModel& model,
                        const Eigen::Vector2d& pixel, const Eigen::Matrix2d& pixelCovariance);

// The same for a direction and a point of its ray in the camera's frame; `covariance` (rank 2,
// radians^2) holds all but the pose's.
LampRay lampRay(const CameraPose& pose, const Eigen::Vector3d& origin,
                const Eigen::Vector3d& direction, const Eigen::Matrix3d& covariance);

struct LampPosition {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  // How badly the rays miss each other, in their own sigmas; 0 of 0 degrees of freedom where
  // nothing is left over.
  double chiSquare = 0;
  int degreesOfFreedom = 0;
  // That rays of one light miss each other at least so badly by chance. Small (below 1e-4): they
  // saw different lights, or the calibration is off.
  double probability = 1;
};

// The point that rays of two or more cameras most probably mean: maximum likelihood over the
// angles, by Gauss-Newton. Fails with kNotFound for rays so parallel that the distance is unknown to
// within a half, with kInvalidArgument for fewer than two rays, rays without covariance, and rays
// that meet behind a camera.
Result<LampPosition> triangulateLamp(std::span<const LampRay> rays);

// The point of the ray at a distance from the subject; one sigma of that distance goes into the
// covariance. Fails where the camera itself is further away.
Result<LampPosition> lampAtRadius(const LampRay& ray, double radiusMetres,
                                  double radiusSigmaMetres);

// A point lamp's irradiance against the same lamp at the reference distance: 1/d^2.
double lampFallOff(double distanceMetres, double referenceMetres);

}  // namespace lightsketch
