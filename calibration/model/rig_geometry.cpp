#include "calibration/model/rig_geometry.h"

#include <Eigen/LU>

namespace lightsketch {
namespace {

constexpr std::string_view kFormat = "lightsketch-rig";
constexpr int kFormatVersion = 1;

Json poseToJson(const Eigen::Isometry3d& pose) {
  const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rotation = pose.linear();
  return {{"rotation", toJson(Eigen::Map<const Eigen::VectorXd>(rotation.data(), 9))},
          {"translationMetres", toJson(pose.translation())}};
}

Result<Eigen::Isometry3d> poseFromJson(const Json& json, std::string_view where) {
  ASSIGN_OR_RETURN(const auto rotation, jsonVector(json, "rotation", 9, where));
  ASSIGN_OR_RETURN(const auto translation, jsonVector(json, "translationMetres", 3, where));
  const Eigen::Matrix3d matrix =
      Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(rotation.data());
  if (!(matrix * matrix.transpose()).isIdentity(1e-6) || matrix.determinant() < 0) {
    return failure(ErrorCode::kCorrupt, "{}: field 'rotation' is not a rotation matrix", where);
  }
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.linear() = matrix;
  pose.translation() = translation;
  return pose;
}

Json cameraToJson(const CameraPose& camera) {
  Json json = poseToJson(camera.sceneFromCamera);
  json["camera"] = camera.camera;
  if (!camera.covariance.isZero(0)) {
    json["covariance"] = toJson(Eigen::Map<const Eigen::VectorXd>(camera.covariance.data(), 36));
  }
  return json;
}

Result<CameraPose> cameraFromJson(const Json& json, std::string_view where) {
  CameraPose camera;
  ASSIGN_OR_RETURN(camera.camera, jsonString(json, "camera", where));
  ASSIGN_OR_RETURN(camera.sceneFromCamera, poseFromJson(json, where));
  if (json.contains("covariance")) {
    ASSIGN_OR_RETURN(const auto values, jsonVector(json, "covariance", 36, where));
    camera.covariance = Eigen::Map<const Eigen::Matrix<double, 6, 6>>(values.data());
    if (!camera.covariance.isApprox(camera.covariance.transpose(), 1e-6) ||
        !(camera.covariance.diagonal().minCoeff() >= 0)) {
      return failure(ErrorCode::kCorrupt, "{}: field 'covariance' is not a covariance matrix",
                     where);
    }
  }
  return camera;
}

}  // namespace

Eigen::Isometry3d uprightAtSubject() {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.linear() = Eigen::Vector3d(-1, -1, 1).asDiagonal();
  return pose;
}

Json rigGeometryToJson(const RigGeometry& rig) {
  Json sources = Json::array();
  for (const auto& camera : rig.sourceCameras) sources.push_back(cameraToJson(camera));
  Json json = {{"format", kFormat},
               {"formatVersion", kFormatVersion},
               {"sceneCamera", cameraToJson(rig.sceneCamera)},
               {"sourceCameras", sources},
               {"display", poseToJson(rig.sceneFromDisplay)}};
  if (rig.lampRadiusMetres) json["lampRadiusMetres"] = *rig.lampRadiusMetres;
  return json;
}

Result<RigGeometry> rigGeometryFromJson(const Json& json, std::string_view where) {
  RETURN_IF_ERROR(checkFormat(json, kFormat, kFormatVersion, where));
  RigGeometry rig;
  ASSIGN_OR_RETURN(const Json* scene, jsonMember(json, "sceneCamera", where));
  ASSIGN_OR_RETURN(rig.sceneCamera, cameraFromJson(*scene, where));
  ASSIGN_OR_RETURN(const Json* sources, jsonMember(json, "sourceCameras", where));
  if (!sources->is_array() || sources->empty()) {
    return failure(ErrorCode::kCorrupt, "{}: field 'sourceCameras' must list at least one camera",
                   where);
  }
  for (const Json& source : *sources) {
    ASSIGN_OR_RETURN(auto camera, cameraFromJson(source, where));
    rig.sourceCameras.push_back(std::move(camera));
  }
  if (json.contains("display")) {
    ASSIGN_OR_RETURN(rig.sceneFromDisplay, poseFromJson(json["display"], where));
  }
  if (json.contains("lampRadiusMetres")) {
    ASSIGN_OR_RETURN(const double radius, jsonNumber(json, "lampRadiusMetres", where));
    if (radius <= 0) {
      return failure(ErrorCode::kCorrupt, "{}: field 'lampRadiusMetres' must be positive", where);
    }
    rig.lampRadiusMetres = radius;
  }
  return rig;
}

Result<RigGeometry> loadRigGeometry(const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const auto json, readJsonFile(path));
  return rigGeometryFromJson(json, path.string());
}

Result<void> saveRigGeometry(const RigGeometry& rig, const std::filesystem::path& path) {
  return writeJsonFile(path, rigGeometryToJson(rig));
}

}  // namespace lightsketch
