#include "calibration/pose/pose_calibration.h"

namespace lightsketch {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Matrix6d = Eigen::Matrix<double, 6, 6>;

Matrix3d crossMatrix(const Vector3d& v) {
  Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

}  // namespace

CameraPose sceneCameraFromBall(const RigCamera& sceneCamera, const Vector3d& centre,
                               const Matrix3d& covariance) {
  CameraPose pose;
  pose.camera = sceneCamera.name;
  const Matrix3d rotation = Vector3d(1, -1, -1).asDiagonal();
  pose.sceneFromCamera.linear() = rotation;
  pose.sceneFromCamera.translation() = -(rotation * centre);
  pose.covariance.bottomRightCorner<3, 3>() = rotation * covariance * rotation.transpose();
  return pose;
}

CameraPose inSceneFrame(const CameraPose& sceneCamera, const CameraPose& inSceneCamera) {
  const Matrix3d rotation = sceneCamera.sceneFromCamera.linear();
  CameraPose pose;
  pose.camera = inSceneCamera.camera;
  pose.sceneFromCamera = sceneCamera.sceneFromCamera * inSceneCamera.sceneFromCamera;
  Matrix6d own = Matrix6d::Zero();
  own.topLeftCorner<3, 3>() = rotation;
  own.bottomRightCorner<3, 3>() = rotation;
  Matrix6d common = Matrix6d::Identity();
  common.bottomLeftCorner<3, 3>() =
      -crossMatrix(rotation * inSceneCamera.sceneFromCamera.translation());
  pose.covariance = own * inSceneCamera.covariance * own.transpose() +
                    common * sceneCamera.covariance * common.transpose();
  return pose;
}

}  // namespace lightsketch
