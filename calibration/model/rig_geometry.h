// Where the cameras, the subject and the display stand. Scene frame: metres, origin on the subject,
// x right, y up, z towards the viewer. Stored as rig.json.
#pragma once

#include <Eigen/Geometry>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "capture/frame/json.h"
#include "capture/frame/result.h"

namespace lightsketch {

// sceneFromCamera maps points in the camera frame (x right, y down, z forward) to the scene frame.
struct CameraPose {
  std::string camera;  // address or serial, as in the journal
  Eigen::Isometry3d sceneFromCamera = Eigen::Isometry3d::Identity();
  // One sigma, of (rotation vector w, translation dt), radians and metres, scene frame, applied on
  // the left: exp(w) R, t + dt. Zero where unknown.
  Eigen::Matrix<double, 6, 6> covariance = Eigen::Matrix<double, 6, 6>::Zero();
};

struct RigGeometry {
  CameraPose sceneCamera;
  std::vector<CameraPose> sourceCameras;
  Eigen::Isometry3d sceneFromDisplay = Eigen::Isometry3d::Identity();
  // Distance from the subject at which the lamp is held, if the operator keeps to one. Turns the
  // direction at the source camera into the direction at the subject.
  std::optional<double> lampRadiusMetres;
};

// Where a source camera is taken to be that nothing is known of: at the subject, looking at the
// viewer, its picture's top up. Its x points left in the scene frame.
Eigen::Isometry3d uprightAtSubject();

// JSON, "format": "lightsketch-rig", "formatVersion": 1; a pose is {"rotation": [9, row-major],
// "translationMetres": [3]}, with "covariance": [36] where known. Refuses rotations that are not
// orthonormal to 1e-6.
Result<RigGeometry> loadRigGeometry(const std::filesystem::path& path);
Result<RigGeometry> rigGeometryFromJson(const Json& json, std::string_view where);
Json rigGeometryToJson(const RigGeometry& rig);
Result<void> saveRigGeometry(const RigGeometry& rig, const std::filesystem::path& path);

}  // namespace lightsketch
