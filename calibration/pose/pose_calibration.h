// What a calibration of poses gives, and its way into the scene frame.
#pragma once

#include <Eigen/Geometry>
#include <string>
#include <vector>

#include "calibration/model/camera_model.h"
#include "calibration/model/rig_geometry.h"

namespace lightsketch {

// One camera of a rig: its name as in the journal, and its lens.
struct RigCamera {
  std::string name;
  const CameraModel* model = nullptr;
};

// One moment or one pair of pictures.
struct PoseEvidence {
  std::string name;
  std::string rejected;       // why it was left out; empty if it was used
  double residualSigmas = 0;  // rms of its residuals, in their own sigmas
};

struct PoseCalibration {
  // Scene camera and source cameras in the scene frame, each with its own covariance; what their
  // errors have in common is not kept.
  RigGeometry rig;
  std::vector<PoseEvidence> evidence;
  int used = 0;
  // Rms of all residuals in their expected sigmas: 1 if the expectations were right. The
  // covariances are already multiplied by its square where it is above 1.
  double residualSigmas = 0;
  double residualPixels = 0;  // rms distance between observed and predicted, all pictures
  std::vector<std::string> warnings;
};

// The scene camera in the scene frame where a mirror ball stands at the subject: origin in its
// centre, z against the camera's optical axis, x right, y up.
CameraPose sceneCameraFromBall(const RigCamera& sceneCamera, const Eigen::Vector3d& centreInCamera,
                               const Eigen::Matrix3d& centreCovariance);

// A pose in the scene camera's frame into the scene frame, both uncertain and independent.
CameraPose inSceneFrame(const CameraPose& sceneCamera, const CameraPose& inSceneCamera);

}  // namespace lightsketch
