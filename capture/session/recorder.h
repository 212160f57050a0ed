// Records a sketch: pairs the two streams, tracks the lamp, accepts or refuses each scene frame and
// says why, and knows where to hold the lamp next.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
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
#include "capture/frame/angle.h"
#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "capture/frame/time.h"
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
  // If the scene camera offers it; otherwise what it sends, with a warning.
  PixelFormat sceneFormat = PixelFormat::kBayerRG12;
};

struct RecorderSummary {
  std::string ended;        // why, for the user: "coverage goal reached", or how a camera was lost
  bool cameraLost = false;  // that is why it ended
  int reconnections = 0;    // times that lost cameras were found again and gone on with
  int recorded = 0;         // frames on disk, of this recording, without those undone
  int resumedFrom = 0;      // frames that the sketch held before
  int offered = 0;          // scene frames that were judged
  int captured = 0;         // directions, with those of before
  int directions = 0;       // wanted
  double coverage = 0;      // captured / directions
  double seconds = 0;
  TimePoint timeZero;  // what this recording's midExposureSeconds count from
  std::map<Refusal, int> refusals;
  std::uint64_t droppedByQueues = 0;  // frames the program could not keep up with
  StreamStatistics scene;
  std::vector<StreamStatistics> sources;
  std::string describe() const;  // a few lines
};

// What was decided about one scene frame.
struct JudgedFrame {
  Refusal refusal = Refusal::kNone;
  std::optional<Eigen::Vector3d> direction;  // of the light, where it is known
  TimePoint arrival;                         // when the frame's last byte was here
  TimePoint decided;
};

// Told to whoever guides the person: where to go next, what has become of the last frame. Called
// for every scene frame and, where none comes, every 100 ms; always from one thread at a time.
struct RecorderState {
  bool lampWantedOff = false;  // the ambient frame is being taken
  std::optional<Eigen::Vector3d> nextDirection;
  std::optional<Eigen::Vector3d> lampDirection;  // where it is now, scene frame
  Angle directionSigma;                          // its one sigma along the worst axis
  std::optional<LampObservation> lamp;           // the same as a source camera saw it,
  int lampCamera = 0;                            // and which
  std::string lampTrouble;                       // why it is not seen now; empty if it is
  Refusal lastRefusal = Refusal::kNone;
  std::optional<JudgedFrame> judged;  // by this very call; nothing if it was made for other reasons
  std::map<Refusal, int> refusals;    // so far
  int recorded = 0;
  double coverage = 0;
  bool paused = false;
  // The wanted directions, and which of them are captured: accepted, and on their way to the disk
  // if not there yet. Never null; the latter is another object whenever it has changed.
  std::shared_ptr<const std::vector<Eigen::Vector3d>> grid;
  std::shared_ptr<const std::vector<bool>> captured;
  // Empty, or "the scene camera was lost: ...; trying again in 4 s".
  std::string waitingFor;
  // The links, twice a second.
  StreamStatistics scene;
  std::vector<StreamStatistics> sources;
  std::uint64_t droppedByQueues = 0;  // frames the program could not keep up with
  double pairingErrorSeconds = 0;     // the last paired frame's time to its nearest source frame
};

// What the person may want meanwhile. Thread-safe, every call returns at once; what it asks for is
// done by the thread that owns the sketch, as journal events, and RecorderState follows. One for
// each recording, also where that goes on with other cameras in the same sketch (then it hands on
// what is to be undone, the ambient light and the lights of the room that were learnt).
class RecorderControl {
 public:
  RecorderControl();
  ~RecorderControl();
  RecorderControl(const RecorderControl&) = delete;
  RecorderControl& operator=(const RecorderControl&) = delete;

  // While paused scene frames are let go; lamp, guide and state go on.
  void pause(bool paused);
  // Takes back the latest frame that this recording kept, or the latest dropRegion() where that
  // came later. Called again, it goes further back; at the beginning it does nothing.
  void undo();
  // Drops all frames of the sketch, those of earlier recordings included, whose direction is within
  // `radius` of `centre`. Their cells are open again.
  void dropRegion(const Eigen::Vector3d& centre, Angle radius, std::string reason);

  struct State;
  State& state() { return *state_; }  // record()'s

 private:
  std::unique_ptr<State> state_;
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
// Fails if the cameras, the models and the sketch do not fit, or if a write fails (whole frames
// stay).
Result<RecorderSummary> record(Camera& sceneCamera, std::span<const SourceCamera> sources,
                               const RigGeometry& rig, const std::filesystem::path& sketchFolder,
                               const RecorderOptions& options, Progress& progress,
                               std::stop_token stop = {},
                               std::function<void(const RecorderState&)> onState = {},
                               RecorderControl* control = nullptr);

}  // namespace lightsketch
