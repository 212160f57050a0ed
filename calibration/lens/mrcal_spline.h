// mrcal's splined stereographic lens as a value, without mrcal's headers. Internal to this folder.
// mrcal's pixels have the centre of the top-left pixel at (0, 0); those of this header are ours.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "calibration/model/camera_model.h"
#include "capture/frame/angle.h"
#include "capture/frame/result.h"

namespace lightsketch {

using ProjectDirection = std::function<std::optional<Eigen::Vector2d>(const Eigen::Vector3d&)>;

struct SplinedLens {
  int width = 0;
  int height = 0;
  int knots = 30;  // each way; cubic
  int fieldDegrees = 200;
  std::vector<double> values;  // fx, fy, cx, cy, then the knots, as mrcal has them

  std::string name() const;  // "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_..."
  Eigen::Vector2d project(const Eigen::Vector3d& direction) const;
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& pixel) const;
};

// The spline nearest to a projection over the directions up to `field` off axis. The core stays a
// plain stereographic lens of the same centre and focal length, so the fit is linear in the knots.
Result<SplinedLens> fitSpline(const ProjectDirection& project, int width, int height, Angle field,
                              int knots);

// The text of a .cameramodel file, every digit kept. `validRegion`: a polygon in our pixels, or
// empty; `note` becomes a comment.
std::string cameraModelText(const SplinedLens& lens,
                            const std::vector<Eigen::Vector2d>& validRegion,
                            const std::string& note);

// Where a lens' covered field ends, in the picture; empty if it does not say.
std::vector<Eigen::Vector2d> coveredPolygon(const FisheyeModel& model);

// Any lens that mrcal reads, as a projection.
struct MrcalLens {
  std::string name;
  int width = 0;
  int height = 0;
  ProjectDirection project;                  // our pixels
  std::vector<Eigen::Vector2d> validRegion;  // our pixels; empty: none said
};
Result<MrcalLens> parseCameraModel(const std::string& text, const std::string& where);

// Directions spread evenly over the cap up to `field` off the axis (Fibonacci spiral; Gonzalez
// 2010), the axis and the rim among them.
std::vector<Eigen::Vector3d> capDirections(Angle field, int count);

}  // namespace lightsketch
