#include "pipeline/job/calibrate_jobs.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <tuple>
#include <utility>

#include "calibration/lens/board_detection.h"
#include "calibration/lens/board_print.h"
#include "calibration/lens/camera_formats.h"
#include "calibration/lens/lens_report.h"
#include "calibration/lens/mrcal_check.h"
#include "calibration/pose/ball_sketch.h"
#include "calibration/pose/board_pose.h"
#include "calibration/pose/check_directions.h"
#include "calibration/pose/relight_sketch.h"
#include "capture/device/camera.h"
#include "capture/frame/file.h"
#include "pipeline/sketch/sketch.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

std::string line(std::string_view what, const std::string& value) {
  return fmt::format("{:<18} {}\n", what, value);
}

// Views of a board and the size of the pictures.
struct Views {
  std::vector<BoardDetection> pictures;
  int width = 0;
  int height = 0;

  std::vector<BoardView> views() const {
    std::vector<BoardView> found;
    for (const BoardDetection& picture : pictures) {
      if (!picture.view.corners.empty()) found.push_back(picture.view);
    }
    return found;
  }
};

Result<std::vector<fs::path>> filesIn(std::span<const fs::path> given) {
  std::vector<fs::path> files;
  for (const fs::path& path : given) {
    std::error_code error;
    if (fs::is_directory(path, error)) {
      ASSIGN_OR_RETURN(const auto inside, imagesInFolder(path));
      files.insert(files.end(), inside.begin(), inside.end());
    } else {
      files.push_back(path);
    }
  }
  return files;
}

Result<Views> viewsInSketch(const fs::path& folder, const BoardGeometry& board,
                            Progress& progress) {
  ASSIGN_OR_RETURN(const auto sketch, Sketch::open(folder));
  Views result;
  result.width = sketch.manifest().width;
  result.height = sketch.manifest().height;
  const auto ids = sketch.activeFrames();
  for (std::size_t i = 0; i < ids.size(); ++i) {
    if (progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
    progress.update("looking for boards", i, ids.size());
    ASSIGN_OR_RETURN(const auto image, sketch.readFrame(ids[i]));
    ASSIGN_OR_RETURN(auto found, detectBoard(image, board));
    found.view.name = sketch.frames()[static_cast<std::size_t>(ids[i])].file;
    result.pictures.push_back(std::move(found));
  }
  return result;
}

Views viewsOfCamera(const LiveViews& live, std::size_t camera) {
  Views views;
  std::tie(views.width, views.height) = live.sizes[camera];
  for (const BoardSighting& sighting : live.sightings) {
    if (sighting.views[camera]) views.pictures.push_back({*sighting.views[camera], {}});
  }
  return views;
}

Result<std::vector<std::unique_ptr<Camera>>> openAll(std::span<const std::string> addresses,
                                                     const CameraOpener& open) {
  std::vector<std::unique_ptr<Camera>> cameras;
  for (const std::string& address : addresses) {
    ASSIGN_OR_RETURN(auto camera, open(address));
    cameras.push_back(std::move(camera));
  }
  return cameras;
}

std::vector<Camera*> pointersTo(const std::vector<std::unique_ptr<Camera>>& cameras) {
  std::vector<Camera*> pointers;
  for (const auto& camera : cameras) pointers.push_back(camera.get());
  return pointers;
}

Json toJson(const SplitHalf& split) {
  Json byAngle = Json::array();
  for (const Angle angle : split.byFieldAngle) {
    byAngle.push_back(std::isfinite(angle.radians()) ? Json(angle.degrees()) : Json());
  }
  return {{"splits", split.splits},
          {"rmsDegrees", split.rms.degrees()},
          {"largestDegrees", split.largest.degrees()},
          {"predictedDegrees", split.predicted.degrees()},
          {"byFieldAngleDegrees", byAngle}};
}

// The covered field's narrowest and widest azimuth.
std::pair<Angle, Angle> coveredField(const FisheyeModel& model) {
  const auto& field = model.uncertainty().coveredField;
  if (field.empty()) return {model.maxFieldAngle(), model.maxFieldAngle()};
  const auto [low, high] = std::minmax_element(field.begin(), field.end());
  return {*low, *high};
}

JobResult describeLens(const LensCalibration& lens, const Views& views) {
  Json without = Json::array();
  for (const BoardDetection& picture : views.pictures) {
    if (!picture.view.corners.empty()) continue;
    without.push_back({{"picture", picture.view.name}, {"reason", picture.reason}});
  }
  const std::size_t found = views.pictures.size() - without.size();
  const auto [narrow, wide] = coveredField(*lens.model);
  const int thrownOut = static_cast<int>(std::count_if(
      lens.views.begin(), lens.views.end(), [](const auto& v) { return !v.rejected.empty(); }));
  int rejected = 0;
  for (const ViewResult& view : lens.views) {
    for (const CornerResidual& corner : view.corners) rejected += corner.rejected.empty() ? 0 : 1;
  }
  std::string text = line(
      "model", fmt::format("{}, f = {:.2f} x {:.2f} px, centre ({:.2f}, {:.2f})",
                           describe(lens.family), lens.model->values().fx, lens.model->values().fy,
                           lens.model->values().cx, lens.model->values().cy));
  text +=
      line("boards", fmt::format("{} of {} pictures; {} views and {} corners used, {} views and {} "
                                 "corners thrown out",
                                 found, views.pictures.size(), lens.viewsUsed, lens.cornersUsed,
                                 thrownOut, rejected));
  if (!without.empty()) {
    std::map<std::string, int> reasons;
    for (const Json& picture : without) ++reasons[picture["reason"].get<std::string>()];
    const auto most =
        std::max_element(reasons.begin(), reasons.end(),
                         [](const auto& a, const auto& b) { return a.second < b.second; });
    text += line("no board",
                 fmt::format("in {} pictures; most often: {}", without.size(), most->first));
    if (2 * without.size() > views.pictures.size()) {
      text +=
          line("warning", "most pictures show no board; check --board, --corners and --dictionary");
    }
  }
  text += line("covered field", fmt::format("{:.1f} to {:.1f} degrees off axis, by azimuth",
                                            narrow.degrees(), wide.degrees()));
  if (lens.splitHalf.splits > 0) {
    text += line("split halves",
                 fmt::format("differ by {:.4f} degrees rms ({:.4f} predicted), at most {:.4f}",
                             lens.splitHalf.rms.degrees(), lens.splitHalf.predicted.degrees(),
                             lens.splitHalf.largest.degrees()));
  }
  text += line("residual", fmt::format("{:.3f} px rms; says little about the edge of the field",
                                       lens.residualPixels));
  for (const std::string& warning : lens.warnings) text += line("warning", warning);
  for (const std::string& advice : lens.advice) text += line("next", advice);
  Json trials = Json::array();
  for (const FamilyTrial& trial : lens.trials) {
    trials.push_back({{"family", describe(trial.family)},
                      {"heldOutPixels", trial.heldOutPixels},
                      {"splitHalfDegrees", trial.splitHalf.degrees()},
                      {"chosen", trial.chosen}});
  }
  return {text,
          {{"family", describe(lens.family)},
           {"picturesWithBoard", found},
           {"picturesWithout", without},
           {"viewsUsed", lens.viewsUsed},
           {"cornersUsed", lens.cornersUsed},
           {"cornersThrownOut", rejected},
           {"residualPixels", lens.residualPixels},
           {"warpMetres", lightsketch::toJson(Eigen::VectorXd(lens.warpMetres))},
           {"splitHalf", toJson(lens.splitHalf)},
           {"trials", trials},
           {"coveredFieldDegrees", {narrow.degrees(), wide.degrees()}},
           {"warnings", lens.warnings},
           {"advice", lens.advice},
           {"solveSeconds", lens.solveSeconds}}};
}

// Report and camera file of a lens.
Result<JobResult> keepLens(const LensCalibration& lens, const Views& views,
                           const BoardGeometry& board, bool crossCheck, const fs::path& out,
                           const fs::path& report) {
  JobResult result = describeLens(lens, views);
  std::optional<MrcalCheck> check;
  if (crossCheck) {
    ASSIGN_OR_RETURN(check, checkWithMrcal(lens, board));
    result.text +=
        line("mrcal", fmt::format("its splined lens differs by {:.4f} degrees rms, at most {:.4f}",
                                  check->rms.degrees(), check->largest.degrees()));
    result.figures["mrcal"] = {{"lens", check->lens},
                               {"rmsDegrees", check->rms.degrees()},
                               {"largestDegrees", check->largest.degrees()},
                               {"residualPixels", check->residualPixels}};
  }
  RETURN_IF_ERROR(saveCameraModel(*lens.model, out));
  if (!report.empty()) {
    RETURN_IF_ERROR(
        writeLensReport({out.filename().string(), lens, views.pictures, check, kSoftware}, report));
  }
  return result;
}

struct Export {
  CameraFormat format;
  fs::path file;
};

// "FORMAT=FILE" each.
Result<std::vector<Export>> parseExports(std::span<const std::string> wishes) {
  std::vector<Export> exports;
  for (const std::string& wish : wishes) {
    const auto split = wish.find('=');
    if (split == std::string::npos || split + 1 == wish.size()) {
      return failure(ErrorCode::kInvalidArgument,
                     "'{}': expected FORMAT=FILE, such as mrcal=source.cameramodel", wish);
    }
    ASSIGN_OR_RETURN(const auto format, cameraFormatFromName(wish.substr(0, split)));
    exports.push_back({format, wish.substr(split + 1)});
  }
  return exports;
}

Result<void> exportTo(const CameraModel& model, const Export& wish, JobResult& result) {
  const auto& [format, file] = wish;
  ASSIGN_OR_RETURN(const CameraConversion conversion, exportCameraModel(model, format, file));
  result.text += line("exported", fmt::format("{}: {}", file.string(), conversion.text));
  result.figures["exports"].push_back({{"file", file.string()},
                                       {"refit", conversion.refit},
                                       {"largestErrorDegrees", conversion.largestError.degrees()},
                                       {"lostFieldDegrees", conversion.lostField.degrees()}});
  return {};
}

Json toJson(const PoseCalibration& pose) {
  Json evidence = Json::array();
  for (const PoseEvidence& e : pose.evidence) {
    evidence.push_back(
        {{"name", e.name}, {"rejected", e.rejected}, {"residualSigmas", e.residualSigmas}});
  }
  return {{"rig", rigGeometryToJson(pose.rig)},
          {"used", pose.used},
          {"residualSigmas", pose.residualSigmas},
          {"residualPixels", pose.residualPixels},
          {"warnings", pose.warnings},
          {"evidence", evidence}};
}

std::string describePose(const PoseCalibration& pose) {
  std::string text =
      line("moments",
           fmt::format("{} of {} used, residuals {:.2f} px, {:.2f} of what was expected", pose.used,
                       pose.evidence.size(), pose.residualPixels, pose.residualSigmas));
  for (const CameraPose& camera : pose.rig.sourceCameras) {
    const Eigen::Vector3d t = camera.sceneFromCamera.translation();
    const auto c = camera.covariance.diagonal();
    text += line("source camera",
                 fmt::format("{} at ({:.4f}, {:.4f}, {:.4f}) m +- {:.1f} mm, turned +- {:.3f} "
                             "degrees",
                             camera.camera, t.x(), t.y(), t.z(), 1e3 * std::sqrt(c.tail<3>().sum()),
                             Angle::radians(std::sqrt(c.head<3>().sum())).degrees()));
  }
  for (const PoseEvidence& e : pose.evidence) {
    if (!e.rejected.empty()) text += line("left out", e.name + ": " + e.rejected);
  }
  for (const std::string& warning : pose.warnings) text += line("warning", warning);
  return text;
}

Result<std::vector<std::shared_ptr<const CameraModel>>> loadModels(
    std::span<const fs::path> paths) {
  std::vector<std::shared_ptr<const CameraModel>> models;
  for (const fs::path& path : paths) {
    ASSIGN_OR_RETURN(auto imported, loadAnyCameraModel(path));
    models.push_back(std::move(imported.model));
  }
  return models;
}

}  // namespace

Result<JobResult> printBoardJob(const PrintBoardJob& job) {
  BoardPrintOptions options;
  options.paper = job.paper;
  options.dpi = job.dpi;
  Result<void> printed;
  if (job.paper == "auto") {
    for (const char* paper : {"A4", "A3", "A2"}) {
      options.paper = paper;
      printed = printBoard(job.board, options, job.out);
      if (printed) break;
    }
  } else {
    printed = printBoard(job.board, options, job.out);
  }
  if (!printed) return tl::unexpected<Error>(printed.error());
  return JobResult{
      fmt::format(
          "{} ({}): print at 100 %, then measure the bar of 100 mm; if it is not 100 mm long, "
          "give the square's measured side to `calibrate lens`\n",
          job.out.string(), options.paper),
      {{"file", job.out.string()}}};
}

Result<JobResult> lensJob(const LensJob& job, Progress& progress, std::stop_token stop,
                          const std::function<void(const LiveViewState&)>& onState) {
  const int sources =
      (job.images.empty() ? 0 : 1) + (job.sketch.empty() ? 0 : 1) + (job.camera.empty() ? 0 : 1);
  if (sources != 1) {
    return failure(ErrorCode::kInvalidArgument,
                   "calibrate lens: give pictures, or --sketch, or --camera (one of them)");
  }
  ASSIGN_OR_RETURN(const auto exports, parseExports(job.exports));
  Views views;
  if (!job.images.empty()) {
    ASSIGN_OR_RETURN(const auto files, filesIn(job.images));
    ASSIGN_OR_RETURN(BoardSearch search, detectBoards(files, job.board, {}, progress));
    views = {std::move(search.pictures), search.width, search.height};
  } else if (!job.sketch.empty()) {
    ASSIGN_OR_RETURN(views, viewsInSketch(job.sketch, job.board, progress));
  } else {
    ASSIGN_OR_RETURN(const auto camera, job.open(job.camera));
    LiveViewOptions options;
    options.board = job.board;
    options.wanted = job.views;
    options.timeLimitSeconds = job.timeLimitSeconds;
    options.keep = fs::path(job.out).replace_extension("views");
    Camera* const cameras[] = {camera.get()};
    ASSIGN_OR_RETURN(const LiveViews live,
                     collectLiveViews(cameras, options, progress, std::move(stop), onState));
    views = viewsOfCamera(live, 0);
  }
  const std::vector<BoardView> found = views.views();
  if (found.empty() && !views.pictures.empty()) {
    return failure(ErrorCode::kNotFound,
                   "calibrate lens: none of {} pictures shows the board ({}: {}); check --board, "
                   "--corners and --dictionary",
                   views.pictures.size(), views.pictures.front().view.name,
                   views.pictures.front().reason);
  }
  ASSIGN_OR_RETURN(const LensCalibration lens, calibrateLens(found, job.board, views.width,
                                                             views.height, job.options, progress));
  ASSIGN_OR_RETURN(JobResult result,
                   keepLens(lens, views, job.board, job.crossCheck, job.out, job.report));
  result.text = line("camera file", job.out.string()) + result.text;
  if (!job.report.empty()) result.text += line("report", job.report.string());
  for (const Export& wish : exports) RETURN_IF_ERROR(exportTo(*lens.model, wish, result));
  return result;
}

Result<JobResult> rigCalibrationJob(const RigCalibrationJob& job, Progress& progress,
                                    std::stop_token stop,
                                    const std::function<void(const LiveViewState&)>& onState) {
  if (job.sceneFrom.empty() && !job.ask) {
    return failure(ErrorCode::kInvalidArgument,
                   "calibrate rig: say where the scene frame is, with --scene-from RIG.json");
  }
  std::optional<RigGeometry> former;
  if (!job.sceneFrom.empty()) {
    ASSIGN_OR_RETURN(former, loadRigGeometry(job.sceneFrom));
  }
  ASSIGN_OR_RETURN(auto folder, PendingFolder::create(job.out));
  std::vector<std::string> addresses{job.sceneCamera};
  addresses.insert(addresses.end(), job.sourceCameras.begin(), job.sourceCameras.end());
  ASSIGN_OR_RETURN(const auto cameras, openAll(addresses, job.open));
  LiveViewOptions options;
  options.board = job.board;
  options.wanted = job.views;
  options.timeLimitSeconds = job.timeLimitSeconds;
  options.keep = job.out.string() + ".views";
  const auto pointers = pointersTo(cameras);
  ASSIGN_OR_RETURN(const LiveViews live,
                   collectLiveViews(pointers, options, progress, stop, onState));
  std::optional<BoardView> flat;
  if (!former) {
    if (!job.ask("Lay the board flat at the subject, face up, and leave it there")) {
      return failure(ErrorCode::kCancelled, "calibrate rig: given up");
    }
    options.wanted = 1;
    options.keep += "/flat";
    constexpr double kFlatSeconds = 20;
    options.timeLimitSeconds = kFlatSeconds;
    ASSIGN_OR_RETURN(const LiveViews last,
                     collectLiveViews(std::span(pointers).first(1), options, progress, stop));
    if (last.sightings.empty()) {
      return failure(ErrorCode::kNotFound,
                     "calibrate rig: the scene camera does not see the board lying still at the "
                     "subject; the pictures taken so far are in {}.views",
                     job.out.string());
    }
    flat = last.sightings.front().views.front();
  }

  JobResult result;
  std::vector<LensCalibration> lenses;
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const Views views = viewsOfCamera(live, i);
    const std::string name = i == 0 ? "scene" : fmt::format("source-{}", i);
    auto lens =
        calibrateLens(views.views(), job.board, views.width, views.height, job.options, progress);
    if (!lens) {
      return failure(lens.error().code, "camera {}: {}", addresses[i], lens.error().message);
    }
    ASSIGN_OR_RETURN(const JobResult one,
                     keepLens(*lens, views, job.board, false, folder.path() / (name + ".json"),
                              folder.path() / (name + ".html")));
    result.text +=
        fmt::format("{}: {}\n{}\n", addresses[i], (job.out / (name + ".json")).string(), one.text);
    result.figures[name] = one.figures;
    lenses.push_back(std::move(*lens));
  }

  const RigCamera scene{addresses[0], lenses[0].model.get()};
  std::vector<RigCamera> sources;
  for (std::size_t i = 1; i < lenses.size(); ++i) {
    sources.push_back({addresses[i], lenses[i].model.get()});
  }
  CameraPose scenePose;
  if (flat) {
    ASSIGN_OR_RETURN(scenePose,
                     sceneCameraFromFlatBoard(scene, *flat, job.board, lenses[0].warpMetres));
  } else {
    scenePose = former->sceneCamera;
  }
  std::vector<BoardMoment> moments;
  for (const BoardSighting& sighting : live.sightings) {
    if (!sighting.views[0]) continue;
    BoardMoment moment{sighting.name, *sighting.views[0], {}};
    moment.sources.assign(sighting.views.begin() + 1, sighting.views.end());
    moments.push_back(std::move(moment));
  }
  BoardPoseOptions poseOptions;
  poseOptions.board = job.board;
  poseOptions.warpMetres = lenses[0].warpMetres;
  ASSIGN_OR_RETURN(PoseCalibration pose,
                   poseFromBoards(scene, sources, scenePose, moments, poseOptions, progress));
  RETURN_IF_ERROR(saveRigGeometry(pose.rig, folder.path() / "rig.json"));
  result.text += describePose(pose);
  result.figures["pose"] = toJson(pose);
  RETURN_IF_ERROR(writeJsonFile(folder.path() / "calibration.json", result.figures));
  RETURN_IF_ERROR(folder.commit());
  return result;
}

namespace {

Result<PoseCalibration> poseByBoards(const PoseJob& job, const RigCamera& scene,
                                     std::span<const RigCamera> sources, Progress& progress) {
  if (job.sourceImages.size() != sources.size()) {
    return failure(ErrorCode::kInvalidArgument,
                   "calibrate pose: {} --source-images for {} --source-model",
                   job.sourceImages.size(), sources.size());
  }
  std::vector<BoardSearch> searches;
  std::vector<fs::path> folders{job.sceneImages};
  folders.insert(folders.end(), job.sourceImages.begin(), job.sourceImages.end());
  for (const fs::path& folder : folders) {
    ASSIGN_OR_RETURN(const auto files, imagesInFolder(folder));
    ASSIGN_OR_RETURN(auto search, detectBoards(files, job.board, {}, progress));
    searches.push_back(std::move(search));
    if (searches.back().pictures.size() != searches.front().pictures.size()) {
      return failure(ErrorCode::kInvalidArgument,
                     "{}: {} pictures, but {} in {}; pictures are paired in the order of their "
                     "names",
                     folder.string(), searches.back().pictures.size(),
                     searches.front().pictures.size(), folders.front().string());
    }
  }
  std::vector<BoardMoment> moments;
  const BoardView* flat = nullptr;
  for (std::size_t i = 0; i < searches[0].pictures.size(); ++i) {
    const BoardView& seen = searches[0].pictures[i].view;
    if (seen.name == job.flatView || fs::path(seen.name).stem() == job.flatView) flat = &seen;
    if (seen.corners.empty()) continue;
    BoardMoment moment{seen.name, seen, {}};
    for (std::size_t s = 1; s < searches.size(); ++s) {
      const BoardView& view = searches[s].pictures[i].view;
      moment.sources.push_back(view.corners.empty() ? std::nullopt : std::optional(view));
    }
    moments.push_back(std::move(moment));
  }
  CameraPose scenePose;
  if (!job.sceneFrom.empty()) {
    ASSIGN_OR_RETURN(const RigGeometry rig, loadRigGeometry(job.sceneFrom));
    scenePose = rig.sceneCamera;
  } else if (flat && !flat->corners.empty()) {
    ASSIGN_OR_RETURN(scenePose, sceneCameraFromFlatBoard(scene, *flat, job.board, {0, 0}));
  } else {
    return failure(ErrorCode::kInvalidArgument,
                   "calibrate pose: say where the scene frame is: --flat NAME of a picture in {} "
                   "in which the board lies flat at the subject, or --scene-from RIG.json",
                   job.sceneImages.string());
  }
  BoardPoseOptions options;
  options.board = job.board;
  return poseFromBoards(scene, sources, scenePose, moments, options, progress);
}

Result<PoseCalibration> poseByBalls(const PoseJob& job, const Sketch& sketch,
                                    const RigCamera& scene, std::span<const RigCamera> sources,
                                    Progress& progress) {
  std::vector<BallHint> hints;
  for (const auto& ball : job.balls) hints.push_back({{ball[0], ball[1]}, ball[2]});
  ASSIGN_OR_RETURN(BallSketch balls,
                   ballsInSketch(sketch, scene, sources, hints, job.ballRadiiMetres, progress));
  if (!job.sceneFrom.empty()) {
    ASSIGN_OR_RETURN(const RigGeometry rig, loadRigGeometry(job.sceneFrom));
    balls.setup.sceneCameraPose = rig.sceneCamera;
  }
  constexpr double kRulerSigmaMetres = 0.002;
  constexpr double kLampDistanceError = 0.1;
  for (const double metres : job.sourceDistancesMetres) {
    balls.setup.sourceDistances.push_back(MeasuredLength{metres, kRulerSigmaMetres});
  }
  if (job.lampDistanceMetres) {
    balls.setup.lampDistance = {*job.lampDistanceMetres,
                                kLampDistanceError * *job.lampDistanceMetres};
  }
  ASSIGN_OR_RETURN(BallPoseCalibration calibration,
                   poseFromMirrorBalls(balls.setup, balls.moments));
  return std::move(calibration.pose);
}

}  // namespace

Result<JobResult> poseJob(const PoseJob& job, Progress& progress) {
  if (job.sceneImages.empty() == job.sketch.empty()) {
    return failure(
        ErrorCode::kInvalidArgument,
        "calibrate pose: give --scene-images and --source-images of a board, or --sketch "
        "of a lamp waved over a mirror ball");
  }
  ASSIGN_OR_RETURN(const auto sceneModel, loadAnyCameraModel(job.sceneModel));
  ASSIGN_OR_RETURN(const auto sourceModels, loadModels(job.sourceModels));
  if (sourceModels.empty()) {
    return failure(ErrorCode::kInvalidArgument, "calibrate pose: --source-model is missing");
  }
  RigCamera scene{"scene", sceneModel.model.get()};
  std::vector<RigCamera> sources;
  for (std::size_t i = 0; i < sourceModels.size(); ++i) {
    sources.push_back({fmt::format("source-{}", i + 1), sourceModels[i].get()});
  }
  PoseCalibration pose;
  if (!job.sketch.empty()) {
    // The sketch names its cameras.
    ASSIGN_OR_RETURN(const auto sketch, Sketch::open(job.sketch));
    std::vector<std::string> names;
    for (const Json& camera : sketch.manifest().cameras) {
      const std::string where = (job.sketch / "sketch.json").string();
      ASSIGN_OR_RETURN(const auto role, jsonString(camera, "role", where));
      ASSIGN_OR_RETURN(const auto address, jsonString(camera, "address", where));
      if (role == "scene") scene.name = address;
      if (role == "source") names.push_back(address);
    }
    if (names.size() != sources.size()) {
      return failure(ErrorCode::kInvalidArgument,
                     "{}: was recorded with {} source camera(s), {} --source-model are given",
                     job.sketch.string(), names.size(), sources.size());
    }
    for (std::size_t i = 0; i < names.size(); ++i) sources[i].name = names[i];
    ASSIGN_OR_RETURN(pose, poseByBalls(job, sketch, scene, sources, progress));
  } else {
    ASSIGN_OR_RETURN(pose, poseByBoards(job, scene, sources, progress));
  }
  RETURN_IF_ERROR(saveRigGeometry(pose.rig, job.out));
  return JobResult{line("rig", job.out.string()) + describePose(pose), toJson(pose)};
}

Result<JobResult> applyCalibrationJob(const ApplyCalibrationJob& job, Progress& progress) {
  ASSIGN_OR_RETURN(auto sketch, Sketch::openForAppend(job.sketch));
  RigGeometry rig;
  if (!job.rigGeometry.empty()) {
    ASSIGN_OR_RETURN(rig, loadRigGeometry(job.rigGeometry));
  } else if (sketch.rig()) {
    rig = *sketch.rig();
  } else {
    return failure(ErrorCode::kInvalidArgument, "{}: has no rig.json of its own; give --rig",
                   job.sketch.string());
  }
  ASSIGN_OR_RETURN(const auto models, loadModels(job.sourceModels));
  if (models.size() != 1 && models.size() != rig.sourceCameras.size()) {
    return failure(ErrorCode::kInvalidArgument,
                   "calibrate apply: {} --camera-model for {} source cameras", models.size(),
                   rig.sourceCameras.size());
  }
  std::map<std::string, std::shared_ptr<const CameraModel>> byName;
  for (std::size_t i = 0; i < rig.sourceCameras.size(); ++i) {
    byName[rig.sourceCameras[i].camera] = models[models.size() == 1 ? 0 : i];
  }
  RelightSketchOptions options;
  options.lampRadiusMetres = job.lampRadiusMetres;
  if (job.patch) {
    const auto [x, y, width, height] = *job.patch;
    options.patch = ReferencePatch{x, y, width, height};
  }
  std::shared_ptr<const CameraModel> sceneModel;
  if (job.ballRadiusMetres > 0) {
    if (job.sceneModel.empty()) {
      return failure(ErrorCode::kInvalidArgument,
                     "calibrate apply: a mirror ball needs --scene-model");
    }
    ASSIGN_OR_RETURN(auto loaded, loadAnyCameraModel(job.sceneModel));
    sceneModel = std::move(loaded.model);
    options.ball = ReferenceBall{{sceneModel.get(), rig.sceneCamera, job.ballRadiusMetres}, {}};
    if (job.ball) options.ball->hint = BallHint{{(*job.ball)[0], (*job.ball)[1]}, (*job.ball)[2]};
  }
  ASSIGN_OR_RETURN(const RelightSummary summary,
                   relightSketch(sketch, byName, rig, options, progress));
  std::string text = summary.describe() + "\n";
  for (const auto& refused : summary.refused) {
    text += line("kept as it was", fmt::format("frame {}: {}", refused.id, refused.reason));
  }
  return JobResult{text,
                   {{"relit", summary.relit},
                    {"triangulated", summary.triangulated},
                    {"byBall", summary.byBall},
                    {"referenceMetres", summary.referenceMetres},
                    {"medianChangeDegrees", summary.medianChange.degrees()},
                    {"largestChangeDegrees", summary.largestChange.degrees()},
                    {"medianSigmaDegrees", summary.medianSigma.degrees()},
                    {"refused", summary.refused.size()}}};
}

Result<JobResult> checkDirectionsJob(const CheckDirectionsJob& job, Progress& progress) {
  ASSIGN_OR_RETURN(const auto sketch, Sketch::open(job.sketch));
  std::optional<BallHint> hint;
  if (job.ball) hint = BallHint{{(*job.ball)[0], (*job.ball)[1]}, (*job.ball)[2]};
  std::optional<CheckCamera> camera;
  std::shared_ptr<const CameraModel> model;
  if (!job.sceneModel.empty()) {
    if (!sketch.rig()) {
      return failure(ErrorCode::kInvalidArgument,
                     "{}: has no rig.json that says where the scene camera stood; check without "
                     "--scene-model (orthographic)",
                     job.sketch.string());
    }
    ASSIGN_OR_RETURN(auto imported, loadAnyCameraModel(job.sceneModel));
    model = std::move(imported.model);
    camera = CheckCamera{model.get(), sketch.rig()->sceneCamera, job.ballRadiusMetres};
  }
  ASSIGN_OR_RETURN(const DirectionCheck check, checkDirections(sketch, hint, camera, progress));
  std::string text =
      line("frames checked", fmt::format("{} of {}", check.checked, check.frames.size()));
  text += line("difference", fmt::format("median {:.2f}, 95 % {:.2f} degrees between the journal "
                                         "and the mirror ball",
                                         check.median.degrees(), check.percentile95.degrees()));
  Json frames = Json::array();
  for (const auto& frame : check.frames) {
    frames.push_back({{"id", frame.id},
                      {"direction", lightsketch::toJson(Eigen::VectorXd(frame.direction))},
                      {"differenceDegrees", frame.difference.degrees()},
                      {"skipped", frame.skipped}});
  }
  return JobResult{text,
                   {{"checked", check.checked},
                    {"medianDegrees", check.median.degrees()},
                    {"p95Degrees", check.percentile95.degrees()},
                    {"frames", frames}}};
}

Result<JobResult> convertCameraJob(const ConvertCameraJob& job) {
  ASSIGN_OR_RETURN(const auto exports, parseExports(job.exports));
  ASSIGN_OR_RETURN(const auto imported, loadAnyCameraModel(job.in));
  JobResult result{line("read", fmt::format("{}: {}", job.in.string(), imported.conversion.text)),
                   {{"exports", Json::array()}}};
  for (const Export& wish : exports) RETURN_IF_ERROR(exportTo(*imported.model, wish, result));
  return result;
}

}  // namespace lightsketch
