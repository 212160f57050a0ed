// What the Sketch page shows before and beside a recording: the wanted directions, those that a
// sketch has already, and where all of them lie in the source camera's picture.
#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <optional>
#include <utility>
#include <vector>

#include "capture/frame/result.h"
#include "pipeline/illumination/light_grid.h"

namespace lightsketch {

struct SketchWish {
  std::filesystem::path folder;  // gone on with if it holds a sketch
  int directions = 300;          // else, or for imported ones, these are wanted
  bool wholeSphere = false;
  std::filesystem::path sourceModel;  // empty or not there: no pixels
  std::filesystem::path rigGeometry;  // empty: the source camera stands upright at the subject
};

struct SketchPlan {
  bool exists = false;  // the folder holds a recorded sketch, whose directions these are
  int directions = 0;
  bool wholeSphere = false;
  std::optional<LightGrid> grid;
  std::vector<bool> captured;  // per direction of the grid
  int capturedCount = 0;
  std::vector<std::pair<int, Eigen::Vector3d>> frames;  // ids and lights of those not dropped

  // Per direction of the grid; nothing where the source camera does not see it.
  std::vector<std::optional<Eigen::Vector2d>> pixels;
  // Closed outline of the field that the calibration covers, pixels.
  std::vector<Eigen::Vector2d> field;
  int sourceWidth = 0;  // 0: no model
  int sourceHeight = 0;
  // So that what is right and up for the person is right and up in the source camera's picture.
  bool flipLeftRight = true;
  bool flipUpsideDown = false;

  // Frames not dropped whose light is within `radius` (radians) of `centre`.
  std::vector<int> framesWithin(const Eigen::Vector3d& centre, double radius) const;
};

// Reads files and takes a while; not for the UI thread. Fails if a sketch, a model or a rig that is
// there cannot be read.
Result<SketchPlan> planSketch(const SketchWish& wish);

}  // namespace lightsketch
