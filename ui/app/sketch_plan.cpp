#include "ui/app/sketch_plan.h"

#include <Eigen/Geometry>
#include <cmath>
#include <memory>
#include <numbers>

#include "calibration/model/camera_model.h"
#include "calibration/model/rig_geometry.h"
#include "capture/frame/direction.h"
#include "capture/session/coverage.h"
#include "pipeline/sketch/sketch.h"

namespace lightsketch {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kOutline = 120;  // corners of the field's outline

// The outermost pixel of an azimuth that the calibration covers.
std::optional<Vector2d> edgeOfField(const CameraModel& model, double azimuth) {
  const auto at = [&](double theta) {
    return Vector3d(std::sin(theta) * std::cos(azimuth), std::sin(theta) * std::sin(azimuth),
                    std::cos(theta));
  };
  double inside = 0;
  double outside = model.maxFieldAngle().radians();
  if (model.covers(at(outside)) && model.project(at(outside))) return model.project(at(outside));
  for (int i = 0; i < 12; ++i) {
    const double middle = 0.5 * (inside + outside);
    (model.covers(at(middle)) && model.project(at(middle)) ? inside : outside) = middle;
  }
  return model.project(at(inside));
}

Result<void> planDirections(const SketchWish& wish, SketchPlan& plan) {
  plan.directions = wish.directions;
  plan.wholeSphere = wish.wholeSphere;
  std::optional<Sketch> sketch;
  if (std::filesystem::exists(wish.folder / "sketch.json")) {
    ASSIGN_OR_RETURN(sketch, Sketch::open(wish.folder));
    plan.exists = sketch->manifest().directions > 0;
  }
  if (plan.exists) {
    plan.directions = sketch->manifest().directions;
    plan.wholeSphere = sketch->manifest().fullSphere;
  }
  ASSIGN_OR_RETURN(plan.grid, LightGrid::create(plan.directions,
                                                plan.wholeSphere ? LightGrid::Domain::kSphere
                                                                 : LightGrid::Domain::kHemisphere));
  Coverage coverage(*plan.grid);
  if (plan.exists) {
    for (const int id : sketch->activeFrames()) {
      const Vector3d& light = sketch->frames()[static_cast<std::size_t>(id)].light.direction;
      plan.frames.emplace_back(id, light);
      coverage.add(light);
    }
  }
  for (int i = 0; i < plan.grid->size(); ++i) plan.captured.push_back(coverage.captured(i));
  plan.capturedCount = coverage.capturedCount();
  return {};
}

Result<void> planPicture(const SketchWish& wish, SketchPlan& plan) {
  if (wish.sourceModel.empty() || !std::filesystem::exists(wish.sourceModel)) return {};
  ASSIGN_OR_RETURN(const auto model, loadCameraModel(wish.sourceModel));
  Eigen::Isometry3d sceneFromSource = uprightAtSubject();
  std::optional<double> distance;
  if (!wish.rigGeometry.empty() && std::filesystem::exists(wish.rigGeometry)) {
    ASSIGN_OR_RETURN(const RigGeometry rig, loadRigGeometry(wish.rigGeometry));
    if (!rig.sourceCameras.empty()) sceneFromSource = rig.sourceCameras.front().sceneFromCamera;
    distance = rig.lampRadiusMetres;
  }
  plan.sourceWidth = model->width();
  plan.sourceHeight = model->height();
  plan.flipLeftRight = sceneFromSource.linear()(0, 0) < 0;
  plan.flipUpsideDown = sceneFromSource.linear()(1, 1) > 0;
  const Eigen::Isometry3d sourceFromScene = sceneFromSource.inverse();
  for (const Vector3d& direction : plan.grid->directions()) {
    // A lamp of unknown distance counts as far away.
    const Vector3d seen = distance ? Vector3d(sourceFromScene * (*distance * direction))
                                   : Vector3d(sourceFromScene.linear() * direction);
    plan.pixels.push_back(model->covers(seen)
                              ? (distance ? model->projectPoint(seen) : model->project(seen))
                              : std::nullopt);
  }
  for (int i = 0; i < kOutline; ++i) {
    if (const auto edge = edgeOfField(*model, 2 * std::numbers::pi * i / kOutline)) {
      plan.field.push_back(*edge);
    }
  }
  return {};
}

}  // namespace

std::vector<int> SketchPlan::framesWithin(const Vector3d& centre, double radius) const {
  std::vector<int> ids;
  for (const auto& [id, light] : frames) {
    if (angleBetween(light, centre).radians() <= radius) ids.push_back(id);
  }
  return ids;
}

Result<SketchPlan> planSketch(const SketchWish& wish) {
  SketchPlan plan;
  RETURN_IF_ERROR(planDirections(wish, plan));
  RETURN_IF_ERROR(planPicture(wish, plan));
  return plan;
}

}  // namespace lightsketch
