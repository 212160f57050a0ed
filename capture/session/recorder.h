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
#include <span>
#include <stop_token>
#include <string>
#include <vector>

#include "calibration/model/camera_model.h"
#include "calibration/model/rig_geometry.h"
#include "calibration/model/sensor_model.h"
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
  kLampNotSeen,        // lost, covered or ambiguous at the frame's time
  kLampTooFast,        // it moved more than allowed during the exposure
  kSaturated,          // too many saturated pixels in the scene frame
  kNotNew,             // the direction's cell is captured already
  kUnpaired,           // no source frames close enough in time on both sides
  kOutsideGrid,        // below the hemisphere that is wanted
  kBeyondCalibration,  // where no board was when the lens was calibrated
  kUncertain,          // the light's direction at the subject is not known well enough
  kBracketing,         // part of a bracket that is being taken
};
std::string describe(Refusal refusal);  // "lamp too fast"

struct RecorderOptions {
  int directions = 300;
  bool fullSphere = false;
  double coverageGoal = 0.95;
  std::optional<double> timeLimitSeconds;
  Angle maxLampMotion = Angle::degrees(1.0);  // during one scene exposure
  double maxSaturatedFraction = 0.02;
  double maxPairingSeconds = 0.15;  // source frames further away than this do not pair
  // One sigma of the light's direction at the subject, along its worst axis.
  Angle maxDirectionSigma = Angle::degrees(1.0);
  // For recordings that poses are to be found from: each frame's direction is that of the first
  // camera that sees the lamp, taken as far away; every steady frame is kept, wherever its
  // direction lies.
  bool posesUnknown = false;
  // At the start, with the lamp off: the ambient light is averaged over this time, counted from
  // when the scene is at its darkest, and the tracker learns the lights of the room. 0: no such
  // phase.
  double ambientSeconds = 1.5;
  // Several exposures for each direction, as factors of sceneExposureSeconds, merged to one frame;
  // the lamp has to be held still for them. Empty: one exposure a frame. The longest must fit into
  // the frame interval. With a bracket each source camera also takes one when it starts: room-N.exr
  // in the sketch, lamp and room in linear radiance, 1.0 saturation at sourceExposureSeconds.
  std::vector<double> bracket;
  bool keepRaw = false;         // the sensor's counts beside each frame, frames/000123.raw.png
  bool subtractAmbient = true;  // else kept beside the frames
  double sceneExposureSeconds = 0.02;
  double sourceExposureSeconds = 0.001;
  double sceneGainDb = 0;
  double sourceGainDb = 0;
  double sceneBlackLevel = 0;  // counts of the format
  // The scene camera's response, noise, dark frame, hot pixels and flat field (`calibrate
  // response`); without it the sensor is taken to be linear with sceneBlackLevel.
  std::shared_ptr<const SensorModel> sceneSensor;
  double sourceBlackLevel = 0;
  double framesPerSecond = 12;
  PixelFormat sceneFormat = PixelFormat::kBayerRG12;
};

struct RecorderSummary {
  std::string ended;    // why, for the user: "coverage goal reached", or how a camera was lost
  int recorded = 0;     // frames on disk, of this recording
  int resumedFrom = 0;  // frames that the sketch held before
  int offered = 0;      // scene frames that were judged
  int captured = 0;     // directions, with those of before
  int directions = 0;   // wanted
  double coverage = 0;  // captured / directions
  double seconds = 0;
  TimePoint timeZero;  // what this recording's midExposureSeconds count from
  std::map<Refusal, int> refusals;
  std::uint64_t droppedByQueues = 0;  // frames the program could not keep up with
  StreamStatistics scene;
  std::vector<StreamStatistics> sources;
  std::string describe() const;  // a few lines
};

// Told to whoever guides the person: where to go next. Called from the recorder's thread.
struct RecorderState {
  bool lampWantedOff = false;  // the ambient frame is being taken
  std::optional<Eigen::Vector3d> nextDirection;
  std::optional<Eigen::Vector3d> lampDirection;  // where it is now, scene frame
  std::optional<LampObservation> lamp;           // the same as a source camera saw it,
  int lampCamera = 0;                            // and which
  std::string lampTrouble;                       // why it is not seen now; empty if it is
  Refusal lastRefusal = Refusal::kNone;
  int recorded = 0;
  double coverage = 0;
};

// A source camera and its lens.
struct SourceCamera {
  Camera& camera;
  std::shared_ptr<const CameraModel> model;
};

// Blocks until the coverage goal, the time limit, the end of a camera, `stop` or a cancelled
// `progress`; all of these leave every accepted frame on disk and return the summary. The sketch is
// created, or gone on with if it exists and fits (size, grid; whether ambient light is subtracted
// and the reference exposure are taken over from it). Radiance 1.0 is saturation at the scene
// exposure and gain of the start.
//
// Cameras with the features GuideMode, GuideX/Y/Z (the simulated rig) are told where to go; for
// others the lamp is expected to be off for the first `ambientSeconds`
// (RecorderState::lampWantedOff says so) and then to follow RecorderState::nextDirection.
//
// `rig.sourceCameras` are the poses of `sources`, in their order. Where two or more see the lamp,
// its position is triangulated; where one does, it is taken to be on the sphere of lampRadiusMetres
// about the subject, or far away if there is none. With a known position, lampScale holds the
// fall-off against the reference distance (lampRadiusMetres, else 1 m).
//
// Fails if the cameras, the models and the sketch do not fit, if a write fails (whole frames stay),
// or if a camera is lost before any frame was recorded.
Result<RecorderSummary> record(Camera& sceneCamera, std::span<const SourceCamera> sources,
                               const RigGeometry& rig, const std::filesystem::path& sketchFolder,
                               const RecorderOptions& options, Progress& progress,
                               std::stop_token stop = {},
                               std::function<void(const RecorderState&)> onState = {});

}  // namespace lightsketch
