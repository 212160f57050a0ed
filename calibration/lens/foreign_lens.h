// Camera files of other calibrators, read as projections. Internal to this folder. Their pixels
// have the centre of the top-left pixel at (0, 0); those of this header are ours.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "calibration/lens/mrcal_spline.h"
#include "calibration/model/camera_model.h"
#include "capture/frame/angle.h"
#include "capture/frame/result.h"

namespace lightsketch {

// Our own writers note the valid field under this key. Readers of the other formats skip it.
inline constexpr const char* kFieldKey = "lightsketch_max_field_angle_degrees";

// A lens read from a file: a projection, and the parameters if it is one that we hold as it is.
struct ForeignLens {
  std::string kind;  // for the user: "OpenCV fisheye"
  int width = 0;
  int height = 0;
  ProjectDirection project;
  std::optional<FisheyeParameters> same;
  std::optional<Angle> field;
  std::vector<Eigen::Vector2d> validRegion;
  std::string remark;
};

// OpenCV or ROS YAML, a Kalibr camchain, an mrcal .cameramodel; told apart by content. Fails with
// file, field and reason.
Result<ForeignLens> parseForeignLens(const std::string& text, const std::string& where);

// Our lens equation as a projection.
ProjectDirection fisheyeProjection(const FisheyeParameters& parameters);
// Usenko, Demmel, Cremers 2018, eq. 40 to 45; parameters fx, fy, cx, cy (theirs), xi, alpha.
std::optional<Eigen::Vector2d> doubleSphere(const double* parameters, const Eigen::Vector3d& v);

}  // namespace lightsketch
