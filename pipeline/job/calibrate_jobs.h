// `lightsketch calibrate ...`: the lens, the poses, the response, and what follows from them for
// sketches that are recorded already.
#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <optional>
#include <stop_token>
#include <string>
#include <vector>

#include "calibration/lens/board.h"
#include "calibration/lens/lens_calibration.h"
#include "capture/frame/progress.h"
#include "pipeline/job/jobs.h"
#include "pipeline/job/live_views.h"

namespace lightsketch {

// Prints a board at true scale; the format goes by the file's ending: .pdf, .svg, .png.
struct PrintBoardJob {
  BoardGeometry board;
  std::string paper = "auto";  // the smallest of A4, A3, A2 that it fits on
  double dpi = 300;            // of a PNG
  std::filesystem::path out;
};
Result<JobResult> printBoardJob(const PrintBoardJob& job);

// A camera's lens from pictures of a board: of exactly one of files, a sketch and a live camera.
struct LensJob {
  std::vector<std::filesystem::path> images;  // files and folders
  std::filesystem::path sketch;
  std::string camera;
  CameraOpener open = openCamera;
  int views = 40;  // of a live camera
  double timeLimitSeconds = 180;
  BoardGeometry board;
  LensCalibrationOptions options;
  bool crossCheck = false;           // against mrcal's splined model
  std::filesystem::path out;         // camera file
  std::filesystem::path report;      // a new folder with the HTML report; empty: none
  std::vector<std::string> exports;  // "mrcal=FILE", "opencv=FILE", "kalibr=FILE"
};
Result<JobResult> lensJob(const LensJob& job, Progress& progress, std::stop_token stop,
                          const std::function<void(const LiveViewState&)>& onState = {});

// Everything at once from one board waved before all cameras: every lens, and the poses.
struct RigCalibrationJob {
  std::string sceneCamera;
  std::vector<std::string> sourceCameras;
  CameraOpener open = openCamera;
  int views = 40;
  double timeLimitSeconds = 240;
  BoardGeometry board;
  LensCalibrationOptions options;
  // Where the scene frame is: of a rig.json whose scene camera pose is kept or, without one, the
  // board lying flat at the subject, its centre the origin. `ask` tells the person to lay it there
  // and comes back when it lies; false: give up.
  std::filesystem::path sceneFrom;
  std::function<bool(const std::string&)> ask;
  std::filesystem::path out;  // a new folder: scene.json, source-N.json, rig.json, an HTML report
                              // of each lens; and OUT.views, the pictures
};
Result<JobResult> rigCalibrationJob(const RigCalibrationJob& job, Progress& progress,
                                    std::stop_token stop,
                                    const std::function<void(const LiveViewState&)>& onState = {});

// Poses of source cameras in the scene frame, from a board in pairs of pictures or from a sketch
// in which the lamp was waved over a mirror ball at the subject.
struct PoseJob {
  std::filesystem::path sceneModel;
  std::vector<std::filesystem::path> sourceModels;
  // By a board: folders of pictures, the same names or the same order in each.
  std::filesystem::path sceneImages;
  std::vector<std::filesystem::path> sourceImages;
  BoardGeometry board;
  std::string flatView;  // the picture in which the board lies flat at the subject
  // By mirror balls.
  std::filesystem::path sketch;
  std::vector<std::array<double, 3>> balls;  // rough outline x, y, radius in pixels; none: found
  std::vector<double> ballRadiiMetres;
  // What fixes the scale, which one small ball hardly does: by source camera, how far it stands
  // from the first ball's centre (a ruler's 2 mm are taken as one sigma), or the lamp's distance
  // from the ball (a tenth). None: an arm's length.
  std::vector<double> sourceDistancesMetres;
  std::optional<double> lampDistanceMetres;
  std::filesystem::path sceneFrom;  // rig.json whose scene camera pose is kept
  std::filesystem::path out;        // rig.json
};
Result<JobResult> poseJob(const PoseJob& job, Progress& progress);

// New calibrations for a finished sketch: directions, positions and fall-off from the stored lamp
// pixels, as journal events.
struct ApplyCalibrationJob {
  std::filesystem::path sketch;
  std::vector<std::filesystem::path> sourceModels;  // one for all, or one per source camera
  std::filesystem::path rigGeometry;                // empty: the sketch's own
  std::optional<double> lampRadiusMetres;
  std::optional<std::array<int, 4>> patch;  // matte reference: x, y, width, height
  // A mirror ball in the pictures, for frames that one source camera saw: rough outline (none:
  // found), radius and the scene camera's model.
  std::optional<std::array<double, 3>> ball;
  double ballRadiusMetres = 0;  // 0: no ball
  std::filesystem::path sceneModel;
};
Result<JobResult> applyCalibrationJob(const ApplyCalibrationJob& job, Progress& progress);

// An independent check of every direction of a sketch by a mirror ball in its pictures.
struct CheckDirectionsJob {
  std::filesystem::path sketch;
  std::optional<std::array<double, 3>> ball;  // rough outline
  std::filesystem::path sceneModel;           // empty: orthographic
  double ballRadiusMetres = 0;                // needed with a scene model
};
Result<JobResult> checkDirectionsJob(const CheckDirectionsJob& job, Progress& progress);

// Response, noise, dark frame, hot pixels and flat field, from brackets of still scenes.
struct ResponseJob {
  // Folders of pictures with their exposure times in a text file (readBracketFolder).
  std::vector<std::filesystem::path> brackets;
  std::filesystem::path dark;      // with the lens covered
  std::filesystem::path diffuser;  // of an even diffuser
  // Or: a live camera, bracketed by this program from the shortest to the longest exposure.
  std::string camera;
  CameraOpener open = openCamera;
  std::optional<PixelFormat> format;  // that the camera is to send
  double shortestSeconds = 0.0005;
  double longestSeconds = 0.5;
  int framesPerExposure = 4;
  bool takeDark = false;      // also with the lens covered, once `ask` has come back
  bool takeDiffuser = false;  // also of an even diffuser
  // Asks the person to do something and waits for it; false: give up. A camera with the feature
  // RigProgram (the simulated rig) is told instead.
  std::function<bool(const std::string&)> ask;
  std::filesystem::path out;
  std::filesystem::path report;
};
Result<JobResult> responseJob(const ResponseJob& job, Progress& progress, std::stop_token stop);

// From one program's camera file to another's.
struct ConvertCameraJob {
  std::filesystem::path in;
  std::vector<std::string> exports;  // "lightsketch=FILE", "mrcal=FILE", ...
};
Result<JobResult> convertCameraJob(const ConvertCameraJob& job);

}  // namespace lightsketch
