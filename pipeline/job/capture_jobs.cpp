// Cameras, the simulated rig, recording.
#include <array>
#include <span>
#include <thread>
#include <utility>

#include "calibration/lens/camera_formats.h"
#include "calibration/radiometry/response_file.h"
#include "capture/device/camera.h"
#include "pipeline/job/jobs.h"
#include "pipeline/job/record_on.h"

namespace lightsketch {
namespace {

// A source camera at the subject that looks at the viewer, its picture's top up: its x points left
// in the scene frame.
Eigen::Isometry3d uprightAtSubject() {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.linear() = Eigen::Vector3d(-1, -1, 1).asDiagonal();
  return pose;
}

Result<RecorderSummary> recordFrom(const RecordJob& job,
                                   std::span<const std::shared_ptr<const CameraModel>> models,
                                   RigGeometry geometry, Progress& progress, std::stop_token stop,
                                   const std::function<void(const RecorderState&)>& onState) {
  if (job.lampRadiusMetres) geometry.lampRadiusMetres = job.lampRadiusMetres;
  ASSIGN_OR_RETURN(const auto scene, job.open(job.sceneCamera));
  std::vector<std::unique_ptr<Camera>> cameras;
  std::vector<SourceCamera> sources;
  for (std::size_t i = 0; i < job.sourceCameras.size(); ++i) {
    ASSIGN_OR_RETURN(auto camera, job.open(job.sourceCameras[i]));
    cameras.push_back(std::move(camera));
    sources.push_back({*cameras.back(), models[i]});
  }
  RecorderOptions options = job.recorder;
  if (!job.sceneResponse.empty()) {
    ASSIGN_OR_RETURN(auto sensor, loadResponse(job.sceneResponse));
    options.sceneFormat = sensor.format;
    options.sceneSensor = std::make_shared<const SensorModel>(std::move(sensor));
  }
  ASSIGN_OR_RETURN(auto summary, record(*scene, sources, geometry, job.sketch, options, progress,
                                        std::move(stop), onState, job.control));
  if (summary.cameraLost && summary.recorded + summary.resumedFrom == 0) {
    return failure(ErrorCode::kDevice, "{}; nothing was recorded", summary.ended);
  }
  return summary;
}

JobResult resultOf(const RecordJob& job, const RecorderSummary& summary) {
  Json refusals = Json::object();
  for (const auto& [refusal, count] : summary.refusals) refusals[describe(refusal)] = count;
  const auto linkToJson = [](const StreamStatistics& link) {
    return Json{{"delivered", link.delivered},
                {"incomplete", link.incomplete},
                {"lost", link.lost},
                {"packetsReceived", link.packetsReceived},
                {"packetsMissing", link.packetsMissing},
                {"packetsResent", link.packetsResent}};
  };
  Json sources = Json::array();
  for (const StreamStatistics& link : summary.sources) sources.push_back(linkToJson(link));
  return {fmt::format("{}: {}", job.sketch.string(), summary.describe()),
          {{"recorded", summary.recorded},
           {"offered", summary.offered},
           {"coverage", summary.coverage},
           {"seconds", summary.seconds},
           {"timeZeroSeconds", toSeconds(summary.timeZero.time_since_epoch())},
           {"refusals", refusals},
           {"droppedByQueues", summary.droppedByQueues},
           {"scene", linkToJson(summary.scene)},
           {"sources", sources}}};
}

}  // namespace

Result<JobResult> listCamerasJob() {
  ASSIGN_OR_RETURN(const auto cameras, listCameras());
  JobResult result;
  result.figures["cameras"] = Json::array();
  for (const CameraInfo& camera : cameras) {
    result.text += fmt::format("{}{:<24} {} {} ({})", result.text.empty() ? "" : "\n",
                               camera.address, camera.vendor, camera.model, camera.serial);
    result.figures["cameras"].push_back({{"address", camera.address},
                                         {"vendor", camera.vendor},
                                         {"model", camera.model},
                                         {"serial", camera.serial}});
  }
  if (cameras.empty()) {
    result.text =
        "no camera found; a GigE Vision camera must be in this computer's network, and "
        "`lightsketch "
        "rig` runs a simulated pair";
  }
  return result;
}

Result<JobResult> rigJob(const RigJob& job, const std::function<void(const std::string&)>& onReady,
                         std::stop_token stop) {
  ASSIGN_OR_RETURN(const auto rig, SimulatedRig::start(job.rig));
  std::string where = fmt::format("scene camera   aravis:{}\nsource camera  aravis:{}",
                                  job.rig.sceneAddress, job.rig.sourceAddress);
  if (!job.rig.secondSource.empty()) {
    where += fmt::format("\nsource camera  aravis:{}", job.rig.secondSource);
  }
  if (!job.calibrationFolder.empty()) {
    std::error_code error;
    std::filesystem::create_directories(job.calibrationFolder, error);
    for (std::size_t i = 0; i < rig->sourceCount(); ++i) {
      const auto model =
          job.calibrationFolder / (i == 0 ? "source.json" : fmt::format("source-{}.json", i + 1));
      RETURN_IF_ERROR(saveCameraModel(*rig->calibratedSourceModel(i), model));
      where += fmt::format("\ncamera model   {}", model.string());
    }
    const auto geometry = job.calibrationFolder / "rig.json";
    RETURN_IF_ERROR(saveRigGeometry(rig->geometry(), geometry));
    where += fmt::format("\nrig            {}", geometry.string());
  }
  onReady(where);
  while (!stop.stop_requested()) std::this_thread::sleep_for(std::chrono::milliseconds(100));
  return JobResult{fmt::format("stopped after {} frames", rig->framesSent()),
                   {{"framesSent", rig->framesSent()}}};
}

Result<RecorderSummary> recordOnRig(const RecordJob& job, const SimulatedRigOptions& options,
                                    const SimulatedRig& rig, Progress& progress,
                                    std::stop_token stop,
                                    const std::function<void(const RecorderState&)>& onState) {
  RecordJob onRig = job;
  onRig.sceneCamera = "aravis:" + options.sceneAddress;
  onRig.sourceCameras = {"aravis:" + options.sourceAddress};
  onRig.recorder.sceneBlackLevel = sceneBlackLevelCounts(job.recorder.sceneFormat);
  return recordFrom(onRig, std::array{rig.calibratedSourceModel()}, rig.geometry(), progress,
                    std::move(stop), onState);
}

Result<JobResult> recordJob(const RecordJob& job, Progress& progress, std::stop_token stop,
                            const std::function<void(const RecorderState&)>& onState) {
  if (job.sceneCamera.empty() != job.sourceCameras.empty()) {
    return failure(
        ErrorCode::kInvalidArgument,
        "record: name both cameras, --scene and --source, or neither for the simulated rig");
  }
  if (job.sceneCamera.empty()) {
    progress.warn("no camera named: recording the simulated rig");
    ASSIGN_OR_RETURN(const auto rig, SimulatedRig::start(job.simulatedRig));
    ASSIGN_OR_RETURN(const auto summary,
                     recordOnRig(job, job.simulatedRig, *rig, progress, std::move(stop), onState));
    return resultOf(job, summary);
  }
  if (job.cameraModels.size() != job.sourceCameras.size()) {
    return failure(ErrorCode::kInvalidArgument,
                   "record: {} source camera(s) and {} --camera-model(s); without its calibration "
                   "a source camera's pixels have no direction",
                   job.sourceCameras.size(), job.cameraModels.size());
  }
  std::vector<std::shared_ptr<const CameraModel>> models;
  for (const auto& path : job.cameraModels) {
    ASSIGN_OR_RETURN(auto loaded, loadAnyCameraModel(path));
    models.push_back(std::move(loaded.model));
  }
  RigGeometry geometry;
  if (!job.rigGeometry.empty()) {
    ASSIGN_OR_RETURN(geometry, loadRigGeometry(job.rigGeometry));
  } else if (job.sourceCameras.size() > 1 && !job.recorder.posesUnknown) {
    return failure(ErrorCode::kInvalidArgument,
                   "record: two source cameras need their poses, --rig; `lightsketch calibrate "
                   "pose` finds them");
  } else {
    geometry.sceneCamera.camera = job.sceneCamera;
    for (const std::string& address : job.sourceCameras) {
      geometry.sourceCameras.push_back({address, uprightAtSubject(), {}});
    }
  }
  ASSIGN_OR_RETURN(const auto summary,
                   recordFrom(job, models, geometry, progress, std::move(stop), onState));
  return resultOf(job, summary);
}

}  // namespace lightsketch
