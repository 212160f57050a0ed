#include "calibration/pose/check_directions.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "calibration/pose/ball_sketch.h"
#include "capture/frame/direction.h"

namespace lightsketch {
namespace {

using Eigen::Vector3d;

}  // namespace

Result<DirectionCheck> checkDirections(const Sketch& sketch, const std::optional<BallHint>& hint,
                                       const std::optional<CheckCamera>& camera,
                                       Progress& progress) {
  const std::vector<int> ids = sketch.activeFrames();
  if (ids.size() < 3) {
    return failure(ErrorCode::kInvalidArgument,
                   "{}: a check by a mirror ball needs at least 3 frames, {} are there",
                   sketch.folder().string(), ids.size());
  }
  if (camera && !(camera->ballRadiusMetres > 0)) {
    return failure(
        ErrorCode::kInvalidArgument,
        "mirror ball: its radius is missing; measure its diameter and give half of it in "
        "metres");
  }

  ASSIGN_OR_RETURN(const SketchOverview overview, overviewOf(sketch, ids, progress));
  std::optional<BallCircle> circle;
  std::optional<MirrorBall> ball;
  Image<std::uint8_t> mask;
  if (camera) {
    ASSIGN_OR_RETURN(const auto cone, findBallCone(overview.mean, *camera->model, hint));
    ASSIGN_OR_RETURN(ball,
                     ballFromOutline(camera->pose, *camera->model, cone, camera->ballRadiusMetres));
    mask = ballMask(cone, *camera->model);
  } else {
    ASSIGN_OR_RETURN(circle, findBallCircle(overview.mean, hint));
    mask = ballMask(*circle, overview.mean.width(), overview.mean.height());
  }

  DirectionCheck check;
  std::vector<Angle> differences;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    if (progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
    progress.update("checking directions", i, ids.size());
    ASSIGN_OR_RETURN(const auto image, sketch.readFrame(ids[i]));
    check.frames.push_back({});
    auto& frame = check.frames.back();
    frame.id = ids[i];
    const auto highlight = findHighlight(image, overview.minimum, mask);
    if (!highlight) {
      frame.skipped = highlight.error().message;
      continue;
    }
    const LightDirection& light = sketch.frames()[static_cast<std::size_t>(ids[i])].light;
    Vector3d claimed = light.direction;
    if (camera) {
      const auto ray = rayFromHighlight(camera->pose, *camera->model, *ball, highlight->place);
      if (!ray) {
        frame.skipped = ray.error().message;
        continue;
      }
      frame.direction = ray->direction;
      if (light.position) claimed = (*light.position - ray->origin).normalized();
    } else {
      const auto direction = directionFromHighlight(*circle, highlight->place.pixel);
      if (!direction) {
        frame.skipped = "the highlight lies outside the ball's outline";
        continue;
      }
      frame.direction = *direction;
    }
    frame.difference = angleBetween(frame.direction, claimed);
    differences.push_back(frame.difference);
  }
  check.checked = static_cast<int>(differences.size());
  if (differences.empty()) {
    return failure(ErrorCode::kNotFound,
                   "{}: no frame shows the lamp on the mirror ball ({}); check the ball's place",
                   sketch.folder().string(), check.frames.front().skipped);
  }
  std::sort(differences.begin(), differences.end());
  check.median = differences[differences.size() / 2];
  check.percentile95 = differences[std::min(differences.size() - 1, differences.size() * 95 / 100)];
  return check;
}

}  // namespace lightsketch
