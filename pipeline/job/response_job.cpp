// `lightsketch calibrate response`.
#include <algorithm>
#include <cmath>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <utility>

#include "calibration/radiometry/response_calibration.h"
#include "calibration/radiometry/response_file.h"
#include "capture/device/camera.h"
#include "capture/rig/rig_program.h"
#include "pipeline/job/calibrate_jobs.h"

namespace lightsketch {
namespace {

constexpr double kPatienceSeconds = 5;  // for a frame, beyond its exposure

// A camera that delivers frames of the exposure that was asked for.
class BracketCamera {
 public:
  explicit BracketCamera(Camera& camera) : camera_(camera) {}
  ~BracketCamera() { camera_.stop(); }
  BracketCamera(const BracketCamera&) = delete;
  BracketCamera& operator=(const BracketCamera&) = delete;

  // Appends `count` frames exposed for `seconds`, from now on.
  Result<void> take(double seconds, int count, std::stop_token stop, std::vector<Frame>& frames) {
    // Stopped in between: the frame rate that a long exposure allows would make short ones slow.
    camera_.stop();
    CameraSettings wanted;
    wanted.exposureSeconds = seconds;
    wanted.framesPerSecond = std::min(10.0, 0.8 / seconds);
    ASSIGN_OR_RETURN(const CameraSettings settings, camera_.configure(wanted));
    {
      const std::lock_guard lock(mutex_);
      frames_.clear();
    }
    RETURN_IF_ERROR(camera_.start(
        [this](Frame&& frame) {
          {
            const std::lock_guard lock(mutex_);
            frames_.push_back(std::move(frame));
          }
          arrived_.notify_one();
        },
        [this](const Error& error) {
          {
            const std::lock_guard lock(mutex_);
            end_ = error;
          }
          arrived_.notify_one();
        }));
    const double exposure = settings.exposureSeconds.value_or(seconds);
    const TimePoint since = Clock::now();
    TimePoint last = since;
    while (count > 0) {
      std::unique_lock lock(mutex_);
      arrived_.wait_for(lock, std::chrono::milliseconds(50),
                        [&] { return !frames_.empty() || end_.has_value(); });
      if (stop.stop_requested()) return failure(ErrorCode::kCancelled, "cancelled");
      if (end_) return tl::unexpected<Error>(*end_);
      if (toSeconds(Clock::now() - last) > kPatienceSeconds + 3 * exposure) {
        return failure(ErrorCode::kDevice,
                       "camera {} sent no frame of {} s; choose exposures that it can do",
                       camera_.info().address, exposure);
      }
      for (Frame& frame : std::exchange(frames_, {})) {
        const bool fits = std::abs(frame.metadata.exposureSeconds / exposure - 1) < 1e-3 &&
                          frame.metadata.midExposure - fromSeconds(exposure / 2) > since;
        if (!fits || count == 0) continue;
        frames.push_back(std::move(frame));
        --count;
        last = Clock::now();
      }
    }
    return {};
  }

 private:
  Camera& camera_;
  std::mutex mutex_;  // Guards frames_ and end_.
  std::condition_variable arrived_;
  std::vector<Frame> frames_;
  std::optional<Error> end_;
};

struct Pictures {
  std::vector<std::vector<Frame>> brackets;
  std::vector<Frame> dark;
  std::vector<Frame> diffuser;
};

Result<Pictures> takeLive(const ResponseJob& job, Progress& progress, const std::stop_token& stop) {
  if (!(job.shortestSeconds > 0 && job.longestSeconds > 2 * job.shortestSeconds)) {
    return failure(ErrorCode::kInvalidArgument,
                   "calibrate response: the longest exposure ({} s) must be more than twice the "
                   "shortest ({} s)",
                   job.longestSeconds, job.shortestSeconds);
  }
  ASSIGN_OR_RETURN(const auto camera, job.open(job.camera));
  const bool rig = camera->hasFeature("RigProgram");
  const auto prepare = [&](RigProgram program, const char* wish) -> Result<void> {
    if (rig) return camera->setFeature("RigProgram", static_cast<double>(program));
    if (job.ask && job.ask(wish)) return {};
    return failure(ErrorCode::kCancelled, "calibrate response: given up");
  };
  if (job.format) {
    CameraSettings wanted;
    wanted.format = job.format;
    ASSIGN_OR_RETURN(const CameraSettings settings, camera->configure(wanted));
    if (settings.format != job.format) {
      return failure(ErrorCode::kInvalidArgument, "camera {} does not send {}", job.camera,
                     pixelFormatInfo(*job.format).name);
    }
  }
  BracketCamera live(*camera);
  if (rig) {
    RETURN_IF_ERROR(camera->setFeature("RigProgram", static_cast<double>(RigProgram::kStill)));
  }

  const int steps =
      1 + static_cast<int>(std::ceil(std::log2(job.longestSeconds / job.shortestSeconds)));
  std::vector<double> exposures;
  for (int i = 0; i < steps; ++i) {
    exposures.push_back(job.shortestSeconds *
                        std::pow(job.longestSeconds / job.shortestSeconds, i / (steps - 1.0)));
  }
  const auto total = static_cast<std::size_t>(steps);
  Pictures pictures;
  pictures.brackets.emplace_back();
  for (std::size_t i = 0; i < total; ++i) {
    progress.update("bracket", i, total);
    RETURN_IF_ERROR(live.take(exposures[i], job.framesPerExposure, stop, pictures.brackets[0]));
  }
  if (job.takeDark) {
    RETURN_IF_ERROR(prepare(RigProgram::kDark, "Cover the lens"));
    progress.update("dark frames", 0, 1);
    RETURN_IF_ERROR(live.take(job.longestSeconds, 4 * job.framesPerExposure, stop, pictures.dark));
  }
  if (job.takeDiffuser) {
    RETURN_IF_ERROR(prepare(RigProgram::kDiffuser, "Hold an even white diffuser before the lens"));
    // The exposure at which the diffuser is half as bright as the sensor can take.
    for (std::size_t i = exposures.size(); i-- > 0;) {
      std::vector<Frame> probe;
      RETURN_IF_ERROR(live.take(exposures[i], 1, stop, probe));
      const Frame& frame = probe.front();
      const auto& info = pixelFormatInfo(frame.format);
      const auto full = static_cast<double>((1u << info.bits) - 1);
      std::vector<double> values;
      for (int y = 0; y < frame.height; y += 7) {
        for (int x = 0; x < frame.width; x += 7) values.push_back(frame.sample(x, y) / full);
      }
      const auto high = values.begin() + static_cast<std::ptrdiff_t>(99 * values.size() / 100);
      std::nth_element(values.begin(), high, values.end());
      if (*high > 0.85 && i > 0) continue;
      progress.update("diffuser", 0, 1);
      RETURN_IF_ERROR(live.take(exposures[i], 4 * job.framesPerExposure, stop, pictures.diffuser));
      break;
    }
  }
  return pictures;
}

Result<Pictures> readFolders(const ResponseJob& job) {
  Pictures pictures;
  for (const auto& folder : job.brackets) {
    ASSIGN_OR_RETURN(auto frames, readBracketFolder(folder));
    pictures.brackets.push_back(std::move(frames));
  }
  if (!job.dark.empty()) {
    ASSIGN_OR_RETURN(pictures.dark, readBracketFolder(job.dark));
  }
  if (!job.diffuser.empty()) {
    ASSIGN_OR_RETURN(pictures.diffuser, readBracketFolder(job.diffuser));
  }
  return pictures;
}

}  // namespace

Result<JobResult> responseJob(const ResponseJob& job, Progress& progress, std::stop_token stop) {
  if (job.brackets.empty() == job.camera.empty()) {
    return failure(ErrorCode::kInvalidArgument,
                   "calibrate response: give folders of brackets, or --camera");
  }
  ASSIGN_OR_RETURN(const Pictures pictures,
                   job.camera.empty() ? readFolders(job) : takeLive(job, progress, stop));
  ResponseInput input;
  for (const auto& bracket : pictures.brackets) input.brackets.emplace_back(bracket);
  input.darkFrames = pictures.dark;
  input.flatFrames = pictures.diffuser;
  ASSIGN_OR_RETURN(const ResponseCalibration calibration, calibrateResponse(input, {}, &progress));
  JobResult result{calibration.summary.text(calibration.sensor), Json::object()};
  if (!job.report.empty()) {
    RETURN_IF_ERROR(writeResponseReport(calibration, job.report));
    result.text += fmt::format("report: {}\n", (job.report / "index.html").string());
  }
  RETURN_IF_ERROR(saveResponse(calibration, job.out));
  result.figures = {{"out", job.out.string()},
                    {"linear", calibration.summary.linear},
                    {"hotPixels", calibration.sensor.hotPixels.size()},
                    {"places", calibration.summary.places},
                    {"sensor", sensorModelToJson(calibration.sensor)}};
  return result;
}

}  // namespace lightsketch
