#include "calibration/pose/relight_sketch.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>

#include "calibration/model/lamp_position.h"
#include "calibration/pose/ball_sketch.h"
#include "capture/frame/direction.h"
#include "capture/frame/file.h"
#include "capture/frame/median.h"

namespace lightsketch {
namespace {

using Eigen::Vector3d;

// Below this a matte surface's own roughness and a nearby light decide.
constexpr double kLeastPatchCosine = 0.2;
constexpr float kSaturated = 0.98f;

struct Relit {
  int id = 0;
  LightDirection light;
  std::optional<std::array<double, 3>> power;  // radiance / cos * d^2
};

Result<const CameraPose*> poseOf(const RigGeometry& rig, const std::string& camera) {
  for (const auto& pose : rig.sourceCameras) {
    if (pose.camera == camera) return &pose;
  }
  // A rig written for one camera need not name it.
  if (rig.sourceCameras.size() == 1 && rig.sourceCameras.front().camera.empty()) {
    return &rig.sourceCameras.front();
  }
  return failure(ErrorCode::kInvalidArgument,
                 "the rig has no pose for source camera '{}'; calibrate its pose, or name it so in "
                 "rig.json",
                 camera);
}

// The patch's mean above the ambient light, by what geometry says it should be; nothing where it
// tells nothing.
std::optional<std::array<double, 3>> lampPower(const RadianceImage& image,
                                               const std::optional<RadianceImage>& ambient,
                                               const ReferencePatch& patch, const Vector3d& lamp) {
  const Vector3d to = lamp - patch.position;
  const double cosine = to.normalized().dot(patch.normal.normalized());
  if (cosine < kLeastPatchCosine) return std::nullopt;
  std::array<double, 3> sum{};
  for (int y = patch.y; y < patch.y + patch.height; ++y) {
    for (int x = patch.x; x < patch.x + patch.width; ++x) {
      for (int c = 0; c < 3; ++c) {
        const float value = image(x, y, c);
        if (value >= kSaturated) return std::nullopt;
        sum[static_cast<std::size_t>(c)] += value - (ambient ? (*ambient)(x, y, c) : 0.0f);
      }
    }
  }
  for (double& value : sum) {
    value *= to.squaredNorm() / cosine / (static_cast<double>(patch.width) * patch.height);
    if (!(value > 0)) return std::nullopt;
  }
  return sum;
}

// The line of sight to the lamp that each frame's highlight means; frames without one lack it.
Result<std::map<int, LampRay>> raysFromBall(const Sketch& sketch, const ReferenceBall& reference,
                                            Progress& progress) {
  const CheckCamera& camera = reference.camera;
  const std::vector<int> ids = sketch.activeFrames();
  ASSIGN_OR_RETURN(const SketchOverview overview, overviewOf(sketch, ids, progress));
  ASSIGN_OR_RETURN(const BallCone cone, outlineOf(overview, *camera.model, reference.hint));
  ASSIGN_OR_RETURN(const MirrorBall ball,
                   ballFromOutline(camera.pose, *camera.model, cone, camera.ballRadiusMetres));
  const Image<std::uint8_t> mask = ballMask(cone, *camera.model);
  std::map<int, LampRay> rays;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    if (progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
    progress.update("looking for highlights", i, ids.size());
    ASSIGN_OR_RETURN(const auto image, sketch.readFrame(ids[i]));
    const auto highlight = findHighlight(image, overview.minimum, mask);
    if (!highlight) continue;
    const auto ray = rayFromHighlight(camera.pose, *camera.model, ball, highlight->place);
    if (ray) rays[ids[i]] = *ray;
  }
  return rays;
}

}  // namespace

Result<void> RelightSketchOptions::validate() const {
  const auto positive = [](double value) { return value > 0 && std::isfinite(value); };
  if ((lampRadiusMetres && !positive(*lampRadiusMetres)) ||
      (referenceMetres && !positive(*referenceMetres)) || !(radiusError >= 0)) {
    return failure(ErrorCode::kInvalidArgument,
                   "relight: the lamp's distances must be positive, their error not negative");
  }
  if (patch && (patch->width < 1 || patch->height < 1 || !(patch->normal.norm() > 0))) {
    return failure(ErrorCode::kInvalidArgument,
                   "relight: the reference patch must have an area and a normal");
  }
  return {};
}

std::string RelightSummary::describe() const {
  return fmt::format(
      "{} frames relit ({} triangulated, {} of them with a mirror ball), {} refused; directions "
      "changed by {:.2f} "
      "degrees "
      "(median), {:.2f} at most, and are known to {:.2f}; lamp scale 1 at {:.2f} m",
      relit, triangulated, byBall, refused.size(), medianChange.degrees(), largestChange.degrees(),
      medianSigma.degrees(), referenceMetres);
}

Result<RelightSummary> relightSketch(
    Sketch& sketch, const std::map<std::string, std::shared_ptr<const CameraModel>>& models,
    const RigGeometry& rig, const RelightSketchOptions& options, Progress& progress) {
  RETURN_IF_ERROR(options.validate());
  const std::string where = sketch.folder().string();
  if (options.patch) {
    const auto& patch = *options.patch;
    if (patch.x < 0 || patch.y < 0 || patch.x + patch.width > sketch.manifest().width ||
        patch.y + patch.height > sketch.manifest().height) {
      return failure(ErrorCode::kInvalidArgument,
                     "relight: the reference patch lies outside the pictures of {} x {} pixels",
                     sketch.manifest().width, sketch.manifest().height);
    }
  }

  std::map<int, LampRay> byBall;
  if (options.ball) {
    ASSIGN_OR_RETURN(byBall, raysFromBall(sketch, *options.ball, progress));
  }

  // Everything is known before anything is written.
  RelightSummary summary;
  struct Single {
    int id;
    LampRay ray;
  };
  std::vector<Single> singles;
  std::vector<Relit> lights;
  std::vector<double> distances;
  bool anyPixels = false;
  for (const FrameRecord& frame : sketch.frames()) {
    if (frame.lampPixels.empty()) continue;
    anyPixels = true;
    std::vector<LampRay> rays;
    std::string reason;
    for (const LampPixel& lamp : frame.lampPixels) {
      const auto model = models.find(lamp.camera);
      if (model == models.end()) {
        return failure(ErrorCode::kInvalidArgument,
                       "{}: frame {} was seen by source camera '{}', which has no camera model; "
                       "give one",
                       where, frame.id, lamp.camera);
      }
      ASSIGN_OR_RETURN(const CameraPose* pose, poseOf(rig, lamp.camera));
      const auto ray = lampRay(*pose, *model->second, lamp.pixel, lamp.covariance);
      if (!ray) {
        reason = ray.error().message;
      } else if (!model->second->covers(*model->second->unproject(lamp.pixel))) {
        reason = fmt::format("the lamp lies outside the field that the calibration of '{}' covers",
                             lamp.camera);
      } else {
        rays.push_back(*ray);
      }
    }
    const auto onBall = byBall.find(frame.id);
    const bool withBall = rays.size() == 1 && onBall != byBall.end();
    if (withBall) rays.push_back(onBall->second);
    if (rays.empty()) {
      summary.refused.push_back({frame.id, reason});
    } else if (rays.size() == 1) {
      singles.push_back({frame.id, rays.front()});
    } else if (const auto lamp = triangulateLamp(rays); !lamp) {
      // Along the baseline, a distance still helps.
      if (lamp.error().code == ErrorCode::kNotFound) {
        singles.push_back({frame.id, rays.front()});
      } else {
        summary.refused.push_back({frame.id, lamp.error().message});
      }
    } else if (lamp->probability < options.leastProbability) {
      summary.refused.push_back(
          {frame.id, fmt::format("the cameras saw different lights (their lines of sight miss "
                                 "each other by {:.1f} sigmas)",
                                 std::sqrt(lamp->chiSquare / lamp->degreesOfFreedom))});
    } else {
      lights.push_back({frame.id, lightDirectionOf(*lamp), {}});
      distances.push_back(lamp->position.norm());
      summary.byBall += withBall ? 1 : 0;
    }
  }
  if (!anyPixels) {
    return failure(ErrorCode::kInvalidArgument,
                   "{}: no frame has lamp pixels (an imported set?); there is nothing to compute "
                   "directions from",
                   where);
  }
  summary.triangulated = static_cast<int>(lights.size());

  if (!singles.empty()) {
    std::optional<double> radius =
        options.lampRadiusMetres ? options.lampRadiusMetres : rig.lampRadiusMetres;
    double sigma = radius ? *radius * options.radiusError : 0;
    if (!radius && !distances.empty()) {
      radius = median(distances);
      std::vector<double> off;
      for (const double distance : distances) off.push_back(std::abs(distance - *radius));
      sigma = 1.48 * median(off);  // of a normal distribution, from the median deviation
    }
    if (!radius) {
      return failure(
          ErrorCode::kInvalidArgument,
          "{}: only one source camera saw the lamp, so its distance is unknown; give the "
          "distance from the subject at which it was held",
          where);
    }
    for (const Single& single : singles) {
      const auto lamp = lampAtRadius(single.ray, *radius, sigma);
      if (!lamp) {
        summary.refused.push_back({single.id, lamp.error().message});
        continue;
      }
      lights.push_back({single.id, lightDirectionOf(*lamp), {}});
      distances.push_back(lamp->position.norm());
    }
  }
  if (lights.empty()) {
    return failure(ErrorCode::kInvalidArgument, "{}: no frame can be relit: {}", where,
                   summary.refused.front().reason);
  }
  std::sort(lights.begin(), lights.end(),
            [](const Relit& a, const Relit& b) { return a.id < b.id; });
  std::sort(summary.refused.begin(), summary.refused.end(),
            [](const auto& a, const auto& b) { return a.id < b.id; });
  summary.referenceMetres = options.referenceMetres.value_or(median(distances));

  std::array<double, 3> medianPower{1, 1, 1};
  if (options.patch) {
    std::optional<RadianceImage> ambient;
    if (!sketch.manifest().ambientSubtracted) {
      ASSIGN_OR_RETURN(ambient, sketch.readAmbient());
    }
    std::array<std::vector<double>, 3> powers;
    std::size_t active = 0;
    for (Relit& relit : lights) {
      if (progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
      if (sketch.frames()[static_cast<std::size_t>(relit.id)].dropped) continue;
      progress.update("measuring the lamp's power", ++active, lights.size());
      ASSIGN_OR_RETURN(const auto image, sketch.readFrame(relit.id));
      relit.power = lampPower(image, ambient, *options.patch, *relit.light.position);
      if (!relit.power) {
        ++summary.withoutPower;
        continue;
      }
      for (std::size_t c = 0; c < 3; ++c) powers[c].push_back((*relit.power)[c]);
    }
    if (2 * powers[0].size() < active || powers[0].empty()) {
      return failure(
          ErrorCode::kInvalidArgument,
          "relight: the reference patch is dark, saturated or lit too flatly in {} of {} "
          "frames; choose a matte surface that faces the lamp",
          active - powers[0].size(), active);
    }
    for (std::size_t c = 0; c < 3; ++c) medianPower[c] = median(powers[c]);
  }

  Json calibration = {{"rig", rigGeometryToJson(rig)}};
  for (const auto& [name, model] : models) calibration["models"][name] = cameraModelToJson(*model);
  summary.calibrationId = checksum(calibration.dump());

  std::vector<double> changes;
  std::vector<double> sigmas;
  for (const Relit& relit : lights) {
    if (progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
    const Vector3d before = sketch.frames()[static_cast<std::size_t>(relit.id)].light.direction;
    const double fallOff = lampFallOff(relit.light.position->norm(), summary.referenceMetres);
    std::array<double, 3> scale{fallOff, fallOff, fallOff};
    if (relit.power) {
      for (std::size_t c = 0; c < 3; ++c) scale[c] *= (*relit.power)[c] / medianPower[c];
    }
    RETURN_IF_ERROR(sketch.relight(relit.id, relit.light, summary.calibrationId, scale));
    const Vector3d& now = relit.light.direction;
    changes.push_back(angleBetween(before, now).radians());
    sigmas.push_back(std::sqrt(relit.light.covariance.trace() / 2));
    ++summary.relit;
    progress.update("relighting", static_cast<std::size_t>(summary.relit), lights.size());
  }
  summary.medianChange = Angle::radians(median(changes));
  summary.largestChange = Angle::radians(*std::max_element(changes.begin(), changes.end()));
  summary.medianSigma = Angle::radians(median(sigmas));
  return summary;
}

}  // namespace lightsketch
