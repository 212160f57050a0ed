// Views of a calibration board from running cameras.
#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <stop_token>
#include <string>
#include <utility>
#include <vector>

#include "calibration/lens/board_detection.h"
#include "calibration/lens/view_collector.h"
#include "capture/device/camera.h"
#include "capture/frame/progress.h"
#include "capture/frame/result.h"

namespace lightsketch {

// The board held still at one place, as each camera saw it; nothing where it was not seen.
struct BoardSighting {
  std::string name;  // "view-007"
  std::vector<std::optional<BoardView>> views;
};

struct LiveViewOptions {
  BoardGeometry board;
  int wanted = 40;  // per camera; the collection ends when all have them
  double timeLimitSeconds = 180;
  double framesPerSecond = 8;
  std::filesystem::path keep;  // pictures of the views go here, camera-N/NAME.png
};

struct LiveViews {
  std::vector<BoardSighting> sightings;
  std::vector<std::pair<int, int>> sizes;  // of the pictures, width and height, per camera
  std::vector<int> counts;                 // views per camera
};

// What the person with the board is told: per camera what its last picture was good for.
struct LiveViewState {
  std::vector<ViewVerdict> verdicts;
  std::vector<int> counts;
  int wanted = 0;
  std::vector<std::pair<int, int>> sizes;  // of the pictures, width and height
  // The board's corners as found in the last picture, pixels; empty where no board was.
  std::vector<std::vector<Eigen::Vector2d>> corners;
  // Those of all views kept so far, which is where the field is covered. Never null; another object
  // whenever views were added.
  std::vector<std::shared_ptr<const std::vector<Eigen::Vector2d>>> kept;
};

// Streams all cameras and keeps a sighting whenever the board stands still somewhere that is new to
// a camera. Blocks until all cameras have what is wanted or the time limit, and returns what there
// is. `stop` or a cancelled `progress` end it with kCancelled; kept pictures stay.
Result<LiveViews> collectLiveViews(std::span<Camera* const> cameras, const LiveViewOptions& options,
                                   Progress& progress, std::stop_token stop,
                                   const std::function<void(const LiveViewState&)>& onState = {});

}  // namespace lightsketch
