// Every command as a call with options, progress and cancel: what both front ends run. A job checks
// its options, does the work, leaves whole files or none, and says what came out.
#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "capture/frame/json.h"
#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "capture/rig/simulated_rig.h"
#include "capture/session/recorder.h"
#include "pipeline/compress/compress.h"
#include "pipeline/illumination/illumination.h"
#include "pipeline/sketch/import.h"

namespace lightsketch {

// Name and version, as files say who wrote them.
inline const std::string kSoftware = std::string("lightsketch ") + LIGHTSKETCH_VERSION;

struct JobResult {
  std::string text;  // for people, some lines
  Json figures;      // the same and more for programs
};

// What is connected.
Result<JobResult> listCamerasJob();

// Runs the simulated rig until `stop`. `onReady` gets the text that says where it is. With
// `calibrationFolder` the camera model and rig.json that a calibration would have found go there.
struct RigJob {
  SimulatedRigOptions rig;
  std::filesystem::path calibrationFolder;
};
Result<JobResult> rigJob(const RigJob& job, const std::function<void(const std::string&)>& onReady,
                         std::stop_token stop);

// Records a sketch. With neither camera named, the simulated rig is started and recorded. Fails if
// a camera is lost before any frame was recorded; lost later, the recording ends, unless
// `reconnectSeconds` says for how long it is to be tried again.
struct RecordJob {
  std::string sceneCamera;
  std::vector<std::string> sourceCameras;
  std::vector<std::filesystem::path> cameraModels;  // of the source cameras, in their order
  std::filesystem::path rigGeometry;  // empty: the one source camera stands upright at the subject
  std::optional<double> lampRadiusMetres;  // in place of the rig's
  std::filesystem::path sceneResponse;     // of `calibrate response`; empty: a linear sensor
  std::filesystem::path sketch;
  RecorderOptions recorder;
  SimulatedRigOptions simulatedRig;
  // Lost cameras are opened again, after 0.5 s, 1 s, ... 8 s, for at most so long at a stretch, and
  // the sketch is gone on with. 0: the recording ends.
  double reconnectSeconds = 0;
  // What starts the exposures of all cameras, such as "Line1"; empty: they run freely.
  std::string trigger;
  // Called on a thread of its own; an attempt that `stop` did not want to wait for may still be in
  // it when recordJob has returned, so what it captures must be its own.
  CameraOpener open = openCamera;
  RecorderControl* control = nullptr;  // outlives the job; may be null
};
Result<JobResult> recordJob(const RecordJob& job, Progress& progress, std::stop_token stop,
                            const std::function<void(const RecorderState&)>& onState = {});

Result<JobResult> importJob(const ImportOptions& job, Progress& progress);

struct ExportJob {
  std::filesystem::path sketch;
  std::string format = "lp";
  ExportLpOptions lp;
  std::filesystem::path out;
};
Result<JobResult> exportJob(const ExportJob& job, Progress& progress);

struct CompressJob {
  std::filesystem::path sketch;
  std::filesystem::path out;
  CompressOptions options;
  // For lamps too near to count as far away: "flat", or an EXR of depths along the scene camera's
  // axis in metres. Empty: far. Needs the scene camera's model and the sketch's rig.json.
  std::string nearLight;
  std::filesystem::path sceneModel;
};
Result<JobResult> compressJob(const CompressJob& job, Progress& progress);

// Exactly one kind of light: lamps, a lights file or an environment map.
struct RelightJob {
  std::filesystem::path model;
  std::vector<DirectionalLamp> lamps;
  std::filesystem::path lightsFile;
  std::filesystem::path environment;
  EnvironmentOptions environmentOptions;
  double exposure = 1;        // factor before the display transform of a PNG
  std::filesystem::path out;  // .exr: linear, .png: sRGB
};
Result<JobResult> relightJob(const RelightJob& job);

// Without a model, one is made with `compress` (its hold-out rule is replaced by this one) and left
// in the report's folder.
struct ValidateJob {
  std::filesystem::path sketch;
  std::string holdOutRule;  // empty: the model's, else cells:8:4 for free-hand sets of many frames
                            // and every:8:4 for others
  std::filesystem::path model;
  CompressOptions compress;
  std::filesystem::path environment;  // for the superposition check; empty: a built-in sky
  std::filesystem::path report;
};
Result<JobResult> validateJob(const ValidateJob& job, Progress& progress);

// Looks for frames in somebody's shadow, with a brightness of their own or a wrong direction
// (checkFrames). Changes the sketch only with `apply`, by journal events: drops, and corrections
// where gain or direction alone explain the fault.
struct CullJob {
  std::filesystem::path sketch;
  std::filesystem::path report;  // folder for index.html and cull.json; empty: none
  bool apply = false;            // needs a report, which keeps what undoes it
  std::filesystem::path undo;  // cull.json of an earlier apply: takes all of it back, nothing else
};
Result<JobResult> cullJob(const CullJob& job, Progress& progress);

// Frames out of a sketch by hand, and back in. Pictures stay on disk.
struct DropJob {
  std::filesystem::path sketch;
  std::vector<int> ids;
  std::string reason;  // restoring needs none
};
Result<JobResult> dropJob(const DropJob& job);
Result<JobResult> restoreJob(const DropJob& job);

// What a file is: a sketch, a model, a camera model, an image.
Result<JobResult> infoJob(const std::filesystem::path& file);

// The whole job on the simulated rig: record, compress, relight, validate.
struct DemoJob {
  std::filesystem::path out = "out";
  int directions = 280;
  SimulatedRigOptions rig;
};
Result<JobResult> demoJob(const DemoJob& job, Progress& progress, std::stop_token stop);

}  // namespace lightsketch
