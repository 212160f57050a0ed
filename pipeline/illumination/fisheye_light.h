// The room's own light on a model: what a calibrated fisheye camera beside the subject sees, as
// intensities of the model's lights.
#pragma once

#include <Eigen/Geometry>
#include <memory>
#include <span>

#include "calibration/model/camera_model.h"
#include "calibration/model/sensor_model.h"
#include "capture/frame/frame.h"
#include "capture/frame/result.h"
#include "pipeline/illumination/illumination.h"

namespace lightsketch {

struct FisheyeLightOptions {
  // As EnvironmentOptions: the irradiance that stands for the captured lamp.
  double lampIrradiance = 3.14159265358979323846;
  CellOptions cells = {};
  // What is known of the camera: response, black level, flat field, hot pixels. Without it the
  // sensor is taken to be linear with `blackLevel` counts.
  std::shared_ptr<const SensorModel> sensor = nullptr;
  double blackLevel = 0;
};

// Each light gets the radiance integrated over the part of its cell that the camera sees. The room
// is taken to be far away: what stands at arm's length is seen from the camera, not from the
// subject. Prepared once for a camera's place and a model's lights; immutable, thread-safe.
class FisheyeLight {
 public:
  static Result<FisheyeLight> create(const CameraModel& camera,
                                     const Eigen::Isometry3d& sceneFromCamera,
                                     std::span<const Eigen::Vector3d> lights,
                                     const FisheyeLightOptions& options = {});

  // `radianceAtSaturation`: what a saturated sample of this frame stands for. A constant times
  // referenceScale() (pipeline/hdr/linearise.h) keeps the light when the camera changes its
  // exposure. Mono cameras light white. Fails where the frame is not the camera's.
  Result<void> intensities(const Frame& frame, double radianceAtSaturation,
                           LightIntensities& out) const;

  // Steradians of the lights' cells that the camera sees, per light, and all of them: what a sky of
  // radiance 1 under lampIrradiance 1 gives.
  std::span<const double> solidAngles() const;
  double coveredSolidAngle() const;

 private:
  struct Tables;
  std::shared_ptr<const Tables> tables_;
};

}  // namespace lightsketch
