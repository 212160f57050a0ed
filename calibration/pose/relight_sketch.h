// A new calibration for a finished sketch: lights from the stored lamp pixels.
#pragma once

#include <Eigen/Core>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "calibration/model/camera_model.h"
#include "calibration/model/rig_geometry.h"
#include "calibration/pose/check_directions.h"
#include "capture/frame/angle.h"
#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/sketch/sketch.h"

namespace lightsketch {

// A matte surface in the scene, lit by nothing but the lamp: what it returns tells the lamp's power
// in every frame.
struct ReferencePatch {
  int x = 0;  // rectangle in the scene picture, pixels
  int y = 0;
  int width = 0;
  int height = 0;
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();   // scene frame
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  // metres
};

// A mirror ball in the pictures: a second line of sight where one source camera saw the lamp.
struct ReferenceBall {
  CheckCamera camera;  // the scene camera: lens, pose, the ball's radius
  std::optional<BallHint> hint;  // to a few percent of the radius, see outlineOf()
};

struct RelightSketchOptions {
  // Distance of the lamp for frames that one camera saw; else the rig's, else the median of the
  // frames that two cameras saw, with their scatter as its error.
  std::optional<double> lampRadiusMetres;
  double radiusError = 0.1;  // one sigma of a given distance, relative
  // Lines of sight that miss each other worse than this by chance saw different lights.
  double leastProbability = 1e-4;
  // Distance at which lampScale is 1; else the frames' median.
  std::optional<double> referenceMetres;
  std::optional<ReferencePatch> patch;
  std::optional<ReferenceBall> ball;
  Result<void> validate() const;
};

struct RelightSummary {
  struct Refused {
    int id = 0;
    std::string reason;
  };
  int relit = 0;
  int triangulated = 0;  // of them; the others by a distance
  int byBall = 0;        // of the triangulated ones, by one source camera and the mirror ball
  double referenceMetres = 0;
  Angle medianChange;  // of the direction at the subject
  Angle largestChange;
  Angle medianSigma;     // of the new directions, rms of both axes
  int withoutPower = 0;  // frames whose patch was in shadow, saturated or lit too flatly
  std::vector<Refused> refused;
  std::string calibrationId;
  std::string describe() const;  // one line
};

// `models` by camera name, as in the journal and in `rig`. Every frame with lamp pixels, dropped
// ones included, gets a light with position, covariance and a lampScale of power (reference / d)^2;
// frames whose light cannot be told keep theirs and are listed. Fails before anything is written
// for cameras that have no model or pose, and where no frame can be relit.
Result<RelightSummary> relightSketch(
    Sketch& sketch, const std::map<std::string, std::shared_ptr<const CameraModel>>& models,
    const RigGeometry& rig, const RelightSketchOptions& options, Progress& progress);

}  // namespace lightsketch
