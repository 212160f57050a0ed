// A mirror ball as an instrument: where it stands by its outline, and where a lamp is by its
// highlight. Camera frame: x right, y down, z forward.
#pragma once

#include <Eigen/Core>
#include <optional>

#include "calibration/model/camera_model.h"
#include "calibration/model/lamp_position.h"
#include "calibration/model/rig_geometry.h"
#include "capture/frame/angle.h"
#include "capture/frame/result.h"

namespace lightsketch {

// A place in a picture with its one-sigma covariance, pixels^2.
struct PixelMeasurement {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Zero();
};

// A ball's outline in an orthographic picture.
struct BallCircle {
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double radiusPixels = 0;
  double coverage = 0;  // fraction of the outline on which an edge was found
};

// A ball's outline in a camera's picture: the rays that graze a sphere form a circular cone, which
// a perspective camera shows as an ellipse and a fisheye as something else.
struct BallCone {
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();  // towards the centre, unit, camera frame
  Angle angularRadius;
  // One sigma of (axis along axis.unitOrthogonal(), along axis x that, angular radius), radians^2.
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  double coverage = 0;
};

struct MirrorBall {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  // metres
  double radiusMetres = 0;
  Eigen::Matrix3d centreCovariance = Eigen::Matrix3d::Zero();
};

// Where a ball of known radius stands, scene frame. The pose's own error is left out: it moves
// camera and ball together. Fails where the radius is missing.
Result<MirrorBall> ballFromOutline(const CameraPose& pose, const CameraModel& model,
                                   const BallCone& cone, double radiusMetres);

// Direction of a distant lamp by its highlight in an orthographic picture, scene frame (x right, y
// up, z towards the viewer): l = 2 (n . v) n - v. Nothing outside the circle.
std::optional<Eigen::Vector3d> directionFromHighlight(const BallCircle& circle,
                                                      const Eigen::Vector2d& highlight);

// The line of sight from the ball to the lamp that a highlight means, scene frame; uncertain by the
// highlight's pixel and the ball's centre. Fails where the highlight lies outside the ball.
Result<LampRay> rayFromHighlight(const CameraPose& pose, const CameraModel& model,
                                 const MirrorBall& ball, const PixelMeasurement& highlight);

// The unit normal at which a ball around the origin shows `eye` the lamp: angle in equals angle
// out (Alhazen's problem), by bracketed Newton in the plane of the three. Both outside the ball.
Eigen::Vector3d mirrorNormal(const Eigen::Vector3d& eye, const Eigen::Vector3d& lamp,
                             double radiusMetres);

}  // namespace lightsketch
