// A mirror ball in a finished sketch says independently where the lamp was in every frame.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "calibration/pose/ball_detection.h"
#include "calibration/pose/mirror_ball.h"
#include "capture/frame/angle.h"
#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/sketch/sketch.h"

namespace lightsketch {

// The camera that took the sketch; without one the picture counts as orthographic.
struct CheckCamera {
  const CameraModel* model = nullptr;
  CameraPose pose;
  double ballRadiusMetres = 0;
};

struct DirectionCheck {
  struct Frame {
    int id = 0;
    Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  // from the ball to the lamp, by the ball
    Angle difference;     // to where the journal says that the lamp is, seen from the ball
    std::string skipped;  // why it could not be checked; empty if it was
  };
  std::vector<Frame> frames;  // the active ones
  int checked = 0;
  Angle median;  // over those checked
  Angle percentile95;
};

// With a camera, the ball is placed by its outline and the lamp's position, where the journal has
// one, is looked at from the ball; else both directions count as those of a distant lamp. What no
// lamp lights in any frame counts as ambient. Fails where the ball is not found or no frame can be
// checked.
Result<DirectionCheck> checkDirections(const Sketch& sketch, const std::optional<BallHint>& hint,
                                       const std::optional<CheckCamera>& camera,
                                       Progress& progress);

}  // namespace lightsketch
