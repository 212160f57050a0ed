// Records a sketch: pairs the two streams, tracks the lamp, accepts or refuses each scene frame and
// says why, and knows where to hold the lamp next.
#pragma once

#include <Eigen/Core>
#include <array>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>

#include "calibration/model/camera_model.h"
#include "calibration/model/rig_geometry.h"
#include "capture/device/camera.h"
#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "capture/session/coverage.h"
#include "capture/tracker/lamp_tracker.h"
#include "pipeline/sketch/sketch.h"

namespace lightsketch {

// Why a scene frame was not kept.
enum class Refusal {
  kNone,
  kLampNotSeen,     // lost, covered or ambiguous at the frame's time
  kLampTooFast,     // it moved more than allowed during the exposure
  kSaturated,       // too many saturated pixels in the scene frame
  kNotNew,          // the direction's cell is captured already
  kUnpaired,        // no source frames close enough in time on both sides
  kOutsideGrid,     // below the hemisphere that is wanted
};
std::string describe(Refusal refusal);  // "lamp too fast"

struct RecorderOptions {
  int directions = 300;
  bool fullSphere = false;
  double coverageGoal = 0.95;
  std::optional<double> timeLimitSeconds;
  Angle maxLampMotion = Angle::degrees(1.0);  // during one scene exposure
  double maxSaturatedFraction = 0.02;
  double maxPairingSeconds = 0.15;            // source frames further apart than this do not pair
  double ambientSeconds = 1.5;                // at the start, lamp off; 0: none
  bool subtractAmbient = true;                // else kept beside the frames
  double sceneExposureSeconds = 0.02;
  double sourceExposureSeconds = 0.001;
  double sceneGainDb = 0;
  double sourceGainDb = 0;
  double framesPerSecond = 12;
  PixelFormat sceneFormat = PixelFormat::kBayerRG12;
};

struct RecorderSummary {
  int recorded = 0;
  int offered = 0;  // scene frames that were judged
  double coverage = 0;
  double seconds = 0;
  std::map<Refusal, int> refusals;
  std::uint64_t droppedByQueues = 0;  // frames the program could not keep up with
  StreamStatistics scene;
  StreamStatistics source;
  std::string describe() const;  // a few lines
};

// Told to whoever guides the person: where to go next. Called from the recorder's thread.
struct RecorderState {
  bool lampWantedOff = false;  // the ambient frame is being taken
  std::optional<Eigen::Vector3d> nextDirection;
  std::optional<Eigen::Vector3d> lampDirection;  // where it is now, scene frame
  Refusal lastRefusal = Refusal::kNone;
  int recorded = 0;
  double coverage = 0;
};

// Blocks until the coverage goal, the time limit, the end of a camera or `stop`. The sketch is
// created, or gone on with if it exists and fits. Cameras with the features GuideMode, GuideX/Y/Z
// (the simulated rig) are told where to go.
Result<RecorderSummary> record(Camera& sceneCamera, Camera& sourceCamera,
                               std::shared_ptr<const CameraModel> sourceModel,
                               const RigGeometry& rig, const std::filesystem::path& sketchFolder,
                               const RecorderOptions& options, Progress& progress,
                               std::stop_token stop = {},
                               std::function<void(const RecorderState&)> onState = {});

}  // namespace lightsketch
