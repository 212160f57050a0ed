// Cameras, the simulated rig, recording.
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <future>
#include <set>
#include <span>
#include <thread>
#include <utility>

#include "calibration/lens/camera_formats.h"
#include "calibration/radiometry/response_file.h"
#include "capture/device/camera.h"
#include "pipeline/job/detachable_camera.h"
#include "pipeline/job/jobs.h"
#include "pipeline/job/record_on.h"

namespace lightsketch {
namespace {

using namespace std::chrono_literals;

constexpr auto kFirstPause = 500ms;
constexpr Duration kLongestPause = 8s;
constexpr auto kTick = 100ms;  // between reports while cameras are waited for

using Cameras = std::vector<std::unique_ptr<Camera>>;  // the scene camera first

Result<Cameras> openAll(const std::vector<std::string>& addresses, const CameraOpener& open) {
  Cameras cameras;
  for (const std::string& address : addresses) {
    ASSIGN_OR_RETURN(auto camera, open(address));
    cameras.push_back(makeDetachable(std::move(camera)));
  }
  return cameras;
}

// Of the parts of one recording.
StreamStatistics sum(const StreamStatistics& a, const StreamStatistics& b) {
  return {a.delivered + b.delivered,
          a.incomplete + b.incomplete,
          a.skipped + b.skipped,
          a.lost + b.lost,
          a.underruns + b.underruns,
          a.packetsReceived + b.packetsReceived,
          a.packetsMissing + b.packetsMissing,
          a.packetsResent + b.packetsResent,
          std::max(a.packetBytes, b.packetBytes),
          std::max(a.socketBuffer, b.socketBuffer),
          a.implausible + b.implausible};
}

// Recorder summaries and states name these alike.
template <class Counts, class Before>
void addCounts(Counts& counts, const Before& before) {
  counts.recorded += before.recorded;
  for (const auto& [refusal, count] : before.refusals) counts.refusals[refusal] += count;
  counts.droppedByQueues += before.droppedByQueues;
  counts.scene = sum(counts.scene, before.scene);
  counts.sources.resize(std::max(counts.sources.size(), before.sources.size()));
  for (std::size_t i = 0; i < before.sources.size(); ++i) {
    counts.sources[i] = sum(counts.sources[i], before.sources[i]);
  }
}

// One sketch, recorded from cameras that may have to be opened again in between.
class Reconnecting {
 public:
  Reconnecting(const RecordJob& job, std::span<const std::shared_ptr<const CameraModel>> models,
               const RigGeometry& geometry, const RecorderOptions& options, Progress& progress,
               std::stop_token stop, const std::function<void(const RecorderState&)>& onState)
      : job_(job),
        models_(models),
        geometry_(geometry),
        options_(options),
        progress_(progress),
        stop_(std::move(stop)),
        onState_(onState),
        control_(job.control == nullptr ? own_ : *job.control) {}

  Result<RecorderSummary> run() {
    const TimePoint start = Clock::now();
    ASSIGN_OR_RETURN(RecorderSummary total, recordOnce());
    while (total.cameraLost && job_.reconnectSeconds > 0) {
      auto next = reconnect(total);
      if (!next) return tl::unexpected(next.error());
      if (!*next) break;
      total = std::move(**next);
    }
    total.seconds = toSeconds(Clock::now() - start);
    if (total.cameraLost && total.recorded + total.resumedFrom == 0) {
      return failure(ErrorCode::kDevice, "{}; nothing was recorded", total.ended);
    }
    return total;
  }

 private:
  bool stopped() const { return stop_.stop_requested() || progress_.cancelled(); }

  // Waits for so long, telling about it; false if it is to end.
  bool pause(Duration duration) {
    const TimePoint until = Clock::now() + duration;
    while (Clock::now() < until && !stopped()) {
      if (onState_ && last_.grid) onState_(last_);
      std::this_thread::sleep_for(std::min<Duration>(kTick, until - Clock::now()));
    }
    return !stopped();
  }

  // Opening a camera that is not there takes seconds, which nobody has to wait for.
  Result<Cameras> openCameras() {
    std::vector<std::string> addresses{job_.sceneCamera};
    addresses.insert(addresses.end(), job_.sourceCameras.begin(), job_.sourceCameras.end());
    auto promise = std::make_shared<std::promise<Result<Cameras>>>();
    auto opened = promise->get_future();
    std::thread([promise, addresses, open = job_.open] {
      promise->set_value(openAll(addresses, open));
    }).detach();
    while (opened.wait_for(0s) != std::future_status::ready) {
      if (!pause(10ms)) return failure(ErrorCode::kCancelled, "stopped while opening the cameras");
    }
    return opened.get();
  }

  Result<RecorderSummary> recordOnce() {
    ASSIGN_OR_RETURN(const Cameras cameras, openCameras());
    last_.waitingFor.clear();
    for (const auto& camera : cameras) {
      if (!job_.trigger.empty()) {
        CameraSettings wish;
        wish.trigger = job_.trigger;
        if (auto set = camera->configure(wish); !set) return tl::unexpected(set.error());
      }
      for (const std::string& note : camera->notes()) {
        if (said_.insert(note).second) progress_.warn(note);
      }
    }
    std::vector<SourceCamera> sources;
    for (std::size_t i = 1; i < cameras.size(); ++i) {
      sources.push_back({*cameras[i], models_[i - 1]});
    }
    return record(
        *cameras[0], sources, geometry_, job_.sketch, options_, progress_, stop_,
        [this](const RecorderState& state) {
          last_ = state;
          addCounts(last_, before_);
          if (onState_) onState_(last_);
        },
        &control_);
  }

  // The recording with the part that followed, or nothing if the cameras did not come back.
  Result<std::optional<RecorderSummary>> reconnect(const RecorderSummary& before) {
    progress_.warn(before.ended + "; waiting for it");
    before_ = before;
    last_.judged.reset();
    last_.lampDirection.reset();
    last_.lamp.reset();
    // One that comes back and sends nothing is still lost.
    if (before.scene.delivered > deliveredBefore_) lostSince_ = Clock::now();
    deliveredBefore_ = before.scene.delivered;
    const TimePoint giveUp = lostSince_ + fromSeconds(job_.reconnectSeconds);
    for (Duration wait = kFirstPause;; wait = std::min(2 * wait, kLongestPause)) {
      const TimePoint next = Clock::now() + wait;
      if (next > giveUp) return std::nullopt;
      for (Duration left = wait; left > Duration(0); left = next - Clock::now()) {
        last_.waitingFor =
            fmt::format("{}; trying again in {:.0f} s", before.ended, std::ceil(toSeconds(left)));
        if (!pause(std::min<Duration>(left, kTick))) return ended(before);
      }
      last_.waitingFor = before.ended + "; trying again";
      const TimePoint started = Clock::now();
      if (options_.timeLimitSeconds) {
        *options_.timeLimitSeconds -= toSeconds(started - limitFrom_);
        limitFrom_ = started;
        if (*options_.timeLimitSeconds <= 0) return std::nullopt;
      }
      auto part = recordOnce();
      if (!part && part.error().code == ErrorCode::kCancelled) return ended(before);
      if (!part &&
          (part.error().code == ErrorCode::kDevice || part.error().code == ErrorCode::kNotFound)) {
        continue;
      }
      if (!part) return tl::unexpected(part.error());
      addCounts(*part, before);
      part->offered += before.offered;
      part->resumedFrom = before.resumedFrom;
      part->reconnections = before.reconnections + 1;
      part->timeZero = before.timeZero;
      return *part;
    }
  }

  static RecorderSummary ended(RecorderSummary summary) {
    summary.ended = "stopped";
    summary.cameraLost = false;
    return summary;
  }

  const RecordJob& job_;
  const std::span<const std::shared_ptr<const CameraModel>> models_;
  const RigGeometry& geometry_;
  RecorderOptions options_;
  Progress& progress_;
  const std::stop_token stop_;
  const std::function<void(const RecorderState&)>& onState_;
  RecorderControl own_;
  RecorderControl& control_;
  std::set<std::string> said_;  // of the cameras' notes
  RecorderSummary before_;      // of the parts so far
  RecorderState last_;
  TimePoint lostSince_ = Clock::now();
  std::uint64_t deliveredBefore_ = 0;
  TimePoint limitFrom_ = Clock::now();
};

Result<RecorderSummary> recordFrom(const RecordJob& job,
                                   std::span<const std::shared_ptr<const CameraModel>> models,
                                   RigGeometry geometry, Progress& progress, std::stop_token stop,
                                   const std::function<void(const RecorderState&)>& onState) {
  if (job.lampRadiusMetres) geometry.lampRadiusMetres = job.lampRadiusMetres;
  RecorderOptions options = job.recorder;
  if (!job.sceneResponse.empty()) {
    ASSIGN_OR_RETURN(auto sensor, loadResponse(job.sceneResponse));
    options.sceneFormat = sensor.format;
    options.sceneSensor = std::make_shared<const SensorModel>(std::move(sensor));
  }
  return Reconnecting(job, models, geometry, options, progress, std::move(stop), onState).run();
}

JobResult resultOf(const RecordJob& job, const RecorderSummary& summary) {
  Json refusals = Json::object();
  for (const auto& [refusal, count] : summary.refusals) refusals[describe(refusal)] = count;
  const auto linkToJson = [](const StreamStatistics& link) {
    return Json{{"delivered", link.delivered},
                {"incomplete", link.incomplete},
                {"implausible", link.implausible},
                {"skipped", link.skipped},
                {"lost", link.lost},
                {"packetsReceived", link.packetsReceived},
                {"packetsMissing", link.packetsMissing},
                {"packetsResent", link.packetsResent},
                {"packetBytes", link.packetBytes},
                {"socketBuffer", link.socketBuffer}};
  };
  Json sources = Json::array();
  for (const StreamStatistics& link : summary.sources) sources.push_back(linkToJson(link));
  return {fmt::format("{}: {}", job.sketch.string(), summary.describe()),
          {{"recorded", summary.recorded},
           {"reconnections", summary.reconnections},
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
