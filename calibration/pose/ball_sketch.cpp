#include "calibration/pose/ball_sketch.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <mutex>
#include <optional>

namespace lightsketch {
namespace {

// Ambient light and outline are known well enough from so many frames.
constexpr std::size_t kOverviewFrames = 48;

// A hint drawn around the ball by eye is off by about this share of the radius,
constexpr double kHintError = 0.03;
// and an outline further from it than this is something that the ball mirrors, or a shadow.
constexpr double kHintReach = 0.08;

}  // namespace

Result<BallCone> outlineOf(const SketchOverview& overview, const CameraModel& model,
                           const std::optional<BallHint>& hint) {
  auto found = findBallCone(overview.mean, model, hint);
  if (!hint) return found;
  const double r = hint->radiusPixels;
  const auto axis = model.unproject(hint->centre);
  const auto side = model.unproject(hint->centre + Eigen::Vector2d(r, 0));
  if (!(r >= 3) || !axis || !side) return found;  // says what is wrong with the hint
  const double perRadian = r / std::acos(std::clamp(axis->dot(*side), -1.0, 1.0));
  if (found &&
      std::acos(std::clamp(axis->dot(found->axis), -1.0, 1.0)) * perRadian < kHintReach * r &&
      std::abs(found->angularRadius.radians() * perRadian - r) < kHintReach * r) {
    return found;
  }
  BallCone cone;
  cone.axis = *axis;
  cone.angularRadius = Angle::radians(r / perRadian);
  cone.covariance = std::pow(kHintError * r / perRadian, 2) * Eigen::Matrix3d::Identity();
  return cone;
}

Result<SketchOverview> overviewOf(const Sketch& sketch, std::span<const int> ids,
                                  Progress& progress) {
  SketchOverview overview;
  const std::size_t stride = (ids.size() + kOverviewFrames - 1) / kOverviewFrames;
  std::size_t count = 0;
  for (std::size_t i = 0; i < ids.size(); i += stride) {
    if (progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
    ASSIGN_OR_RETURN(const auto image, sketch.readFrame(ids[i]));
    lowerTo(overview.minimum, image);
    if (overview.mean.empty()) {
      overview.mean = RadianceImage(image.width(), image.height(), image.channels());
    }
    for (std::size_t k = 0; k < image.size(); ++k) {
      overview.mean.data()[k] += std::min(image.data()[k], 1.0f);
    }
    ++count;
    progress.update("looking for the ball", i + 1, ids.size());
  }
  for (float& value : overview.mean.values()) value /= static_cast<float>(count);
  return overview;
}

Result<BallSketch> ballsInSketch(const Sketch& sketch, const RigCamera& sceneCamera,
                                 std::span<const RigCamera> sourceCameras,
                                 std::span<const BallHint> hints,
                                 std::span<const double> radiiMetres, Progress& progress) {
  const std::vector<int> ids = sketch.activeFrames();
  const std::size_t balls = std::max<std::size_t>(hints.size(), 1);
  if (radiiMetres.size() != balls) {
    return failure(ErrorCode::kInvalidArgument,
                   "{} mirror ball(s), but {} radii; give each ball's radius in metres", balls,
                   radiiMetres.size());
  }
  if (ids.empty()) {
    return failure(ErrorCode::kInvalidArgument, "{}: holds no frames", sketch.folder().string());
  }
  if (sceneCamera.model->width() != sketch.manifest().width ||
      sceneCamera.model->height() != sketch.manifest().height) {
    return failure(ErrorCode::kInvalidArgument,
                   "{}: frames of {} x {}, but the scene camera's model is for {} x {}",
                   sketch.folder().string(), sketch.manifest().width, sketch.manifest().height,
                   sceneCamera.model->width(), sceneCamera.model->height());
  }
  ASSIGN_OR_RETURN(const SketchOverview overview, overviewOf(sketch, ids, progress));
  BallSketch result;
  result.setup.sceneCamera = sceneCamera;
  result.setup.sourceCameras.assign(sourceCameras.begin(), sourceCameras.end());
  result.setup.radiiMetres.assign(radiiMetres.begin(), radiiMetres.end());
  std::vector<Image<std::uint8_t>> masks;
  for (std::size_t b = 0; b < balls; ++b) {
    const auto hint = hints.empty() ? std::nullopt : std::optional(hints[b]);
    ASSIGN_OR_RETURN(const BallCone cone, outlineOf(overview, *sceneCamera.model, hint));
    result.setup.outlines.push_back(cone);
    masks.push_back(ballMask(cone, *sceneCamera.model));
  }

  result.moments.resize(ids.size());
  std::mutex mutex;  // guards the first failure
  std::optional<Error> error;
  std::atomic<std::size_t> done = 0;
  oneapi::tbb::parallel_for(std::size_t{0}, ids.size(), [&](std::size_t i) {
    if (progress.cancelled()) return;
    const FrameRecord& record = sketch.frames()[static_cast<std::size_t>(ids[i])];
    const auto image = sketch.readFrame(ids[i]);
    if (!image) {
      const std::lock_guard lock(mutex);
      if (!error) error = image.error();
      return;
    }
    BallMoment& moment = result.moments[i];
    moment.name = record.file;
    for (const auto& mask : masks) {
      const auto highlight = findHighlight(*image, overview.minimum, mask);
      moment.highlights.push_back(highlight ? std::optional(highlight->place) : std::nullopt);
    }
    for (const RigCamera& camera : sourceCameras) {
      const auto seen =
          std::find_if(record.lampPixels.begin(), record.lampPixels.end(),
                       [&](const LampPixel& lamp) { return lamp.camera == camera.name; });
      moment.lamps.push_back(seen == record.lampPixels.end()
                                 ? std::nullopt
                                 : std::optional(PixelMeasurement{seen->pixel, seen->covariance}));
    }
    progress.update("looking for highlights", ++done, ids.size());
  });
  if (error) return tl::unexpected<Error>(std::move(*error));
  if (progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
  return result;
}

}  // namespace lightsketch
