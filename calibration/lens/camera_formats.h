// Camera models of other calibrators, in and out: OpenCV, Kalibr, mrcal. Their pixels have the
// centre of the top-left pixel at (0, 0), ours at (0.5, 0.5): both ways shift the centre by half a
// pixel.
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <string_view>

#include "calibration/model/camera_model.h"
#include "capture/frame/angle.h"
#include "capture/frame/result.h"

namespace lightsketch {

enum class CameraFormat {
  kLightsketch,         // our JSON: everything kept
  kOpenCv,              // YAML for cv::fisheye: K, D(4)
  kKalibr,              // camchain YAML, pinhole-equi
  kKalibrDoubleSphere,  // camchain YAML, ds-none: fields beyond 90 degrees off axis
  kMrcal,               // .cameramodel, LENSMODEL_SPLINED_STEREOGRAPHIC
};
// "lightsketch", "opencv", "kalibr", "kalibr-ds", "mrcal". Fails with the names there are.
Result<CameraFormat> cameraFormatFromName(std::string_view name);
std::string_view cameraFormatName(CameraFormat format);

// What a conversion lost.
struct CameraConversion {
  bool refit = false;  // the target cannot hold the lens as it is
  Angle largestError;  // of any direction of the field that both have, far points
  Angle lostField;     // of the valid field, off axis
  std::string text;    // one line for the user
};

struct LoadedCamera {
  std::shared_ptr<const CameraModel> model;
  CameraConversion conversion;
};

// Any of the above, and what they also write: OpenCV's pinhole with 4 (named plumb_bob or radtan),
// 5, 8, 12 or 14 coefficients and cv::omnidir (xi), ROS camera_info, Kalibr's pinhole-equi,
// pinhole-radtan, omni-radtan, ds-none, eucm-none, every lens of mrcal but CAHVORE. Told apart by
// content. Where there are several cameras the first is taken, and the text says so. The valid
// field is what the picture holds, or what our own writer noted.
// Fails with file, field and reason.
Result<LoadedCamera> loadAnyCameraModel(const std::filesystem::path& path);

// Writes atomically. Fails, with nothing written, where the format cannot hold the lens at all.
Result<CameraConversion> exportCameraModel(const CameraModel& model, CameraFormat format,
                                           const std::filesystem::path& path);

}  // namespace lightsketch
