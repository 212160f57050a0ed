// Whether the recorder keeps up: scene camera 640 x 480 colour and source camera 960 x 960 mono at
// 30 frames a second over GigE Vision, up to ten kept frames a second. The simulated rig runs as a
// program of its own and serves frames rendered beforehand.
//
//   bench_recording [--quick]
#include <fmt/format.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <string_view>
#include <thread>
#include <type_traits>
#include <vector>

#include "calibration/model/camera_model.h"
#include "calibration/model/rig_geometry.h"
#include "capture/rig/simulated_rig.h"
#include "capture/session/recorder.h"

using namespace lightsketch;

namespace {

namespace fs = std::filesystem;

constexpr double kFramesPerSecond = 30;
const std::string kScene = "127.0.4.11";
const std::string kSource = "127.0.4.12";

template <class T>
T orStop(Result<T> result, const char* what) {
  if constexpr (std::is_void_v<T>) {
    if (result) return;
  } else if (result) {
    return std::move(*result);
  }
  fmt::print(stderr, "{}: {}\n", what, result.error().message);
  std::exit(1);
}

// The simulated rig in a process of its own, until destruction.
class Rig {
 public:
  Rig(const fs::path& calibration, int frames) {
    child_ = ::fork();
    if (child_ != 0) return;
    SimulatedRigOptions options;
    options.sceneAddress = kScene;
    options.sourceAddress = kSource;
    options.framesPerSecond = kFramesPerSecond;
    options.prerenderedFrames = frames;
    const auto rig = orStop(SimulatedRig::start(options), "simulated rig");
    orStop(saveCameraModel(*rig->calibratedSourceModel(), calibration / "source.json"), "model");
    orStop(saveRigGeometry(rig->geometry(), calibration / "rig.json"), "geometry");
    while (true) ::pause();
  }
  ~Rig() {
    ::kill(child_, SIGTERM);
    ::waitpid(child_, nullptr, 0);
  }
  Rig(const Rig&) = delete;
  Rig& operator=(const Rig&) = delete;
  bool runs() const { return ::waitpid(child_, nullptr, WNOHANG) == 0; }

 private:
  pid_t child_ = -1;
};

// A camera whose frames' times are written down.
class Tap final : public Camera {
 public:
  explicit Tap(std::unique_ptr<Camera> camera) : camera_(std::move(camera)) {}
  const CameraInfo& info() const override { return camera_->info(); }
  Result<CameraSettings> configure(const CameraSettings& settings) override {
    return camera_->configure(settings);
  }
  Result<void> start(FrameCallback onFrame, EndCallback onEnd) override {
    return camera_->start(
        [this, onFrame = std::move(onFrame)](Frame&& frame) {
          middleAndArrival.emplace_back(frame.metadata.midExposure, frame.metadata.arrival);
          onFrame(std::move(frame));
        },
        std::move(onEnd));
  }
  void stop() override { camera_->stop(); }
  StreamStatistics statistics() const override { return camera_->statistics(); }
  bool hasFeature(const std::string& name) const override { return camera_->hasFeature(name); }
  Result<void> setFeature(const std::string& name, double value) override {
    return camera_->setFeature(name, value);
  }

  // Once stopped: written on the camera's own thread.
  std::vector<std::pair<TimePoint, TimePoint>> middleAndArrival;

 private:
  std::unique_ptr<Camera> camera_;
};

// How long after a scene frame the source frame arrives that it is paired with: nobody decides
// sooner. Milliseconds, of all scene frames that arrived from `begin` on.
std::vector<double> partnerDelays(const Tap& scene, const Tap& source, TimePoint begin) {
  std::vector<double> delays;
  for (const auto& [middle, arrival] : scene.middleAndArrival) {
    if (arrival < begin) continue;
    const auto partner =
        std::find_if(source.middleAndArrival.begin(), source.middleAndArrival.end(),
                     [&, time = middle](const auto& other) { return other.first >= time; });
    if (partner == source.middleAndArrival.end()) continue;
    delays.push_back(std::max(0.0, 1e3 * toSeconds(partner->second - arrival)));
  }
  return delays;
}

double processorSeconds() {
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

double percentile(std::vector<double> values, double p) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(p * static_cast<double>(values.size() - 1))];
}

void line(const char* what, const std::string& figure, const char* bar = "") {
  fmt::print("{:<44} {:>12}   {}\n", what, figure, bar);
}

}  // namespace

int main(int argc, char** argv) {
  const bool quick = argc > 1 && std::string_view(argv[1]) == "--quick";
  const int frames = quick ? 150 : 300;  // of the loop, in which every direction comes once
  const fs::path folder = fs::temp_directory_path() / fmt::format("bench-recording-{}", ::getpid());
  fs::create_directories(folder / "rig");
  {
    const Rig rig(folder / "rig", frames);
    while (!fs::exists(folder / "rig/rig.json")) {
      if (!rig.runs()) {
        fmt::print(stderr, "the simulated rig did not start\n");
        return 1;
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
    const auto model = orStop(loadCameraModel(folder / "rig/source.json"), "source.json");
    const auto geometry = orStop(loadRigGeometry(folder / "rig/rig.json"), "rig.json");
    Tap scene(orStop(openCamera("aravis:" + kScene), "scene camera"));
    Tap source(orStop(openCamera("aravis:" + kSource), "source camera"));

    RecorderOptions options;
    options.directions = 4000;  // so fine that the lamp enters ten new cells a second
    options.coverageGoal = 1;
    options.framesPerSecond = kFramesPerSecond;
    options.ambientSeconds = 0;  // the lamp of the loop is always on
    options.sceneBlackLevel = 64;
    options.maxLampMotion = Angle::degrees(5);
    SilentProgress progress;
    std::stop_source stop;
    std::vector<double> decided, keptDecided;
    std::map<std::string, int> troubles;
    std::optional<TimePoint> first;
    double processorBefore = 0;
    int kept = 0;
    double seconds = 0, processor = 0;
    const auto summary = orStop(record(scene, std::array{SourceCamera{source, model}}, geometry,
                                       folder / "sketch", options, progress, stop.get_token(),
                                       [&](const RecorderState& state) {
                                         if (!state.judged) return;
                                         const JudgedFrame& judged = *state.judged;
                                         if (!first) {
                                           first = judged.decided;
                                           processorBefore = processorSeconds();
                                         }
                                         const double ms =
                                             1e3 * toSeconds(judged.decided - judged.arrival);
                                         decided.push_back(ms);
                                         if (judged.refusal == Refusal::kNone) {
                                           keptDecided.push_back(ms);
                                           ++kept;
                                         }
                                         seconds = toSeconds(judged.decided - *first);
                                         processor = processorSeconds() - processorBefore;
                                         if (seconds > frames / kFramesPerSecond)
                                           stop.request_stop();
                                       }),
                                "record");
    fmt::print("{}\n", summary.describe());
    for (const auto& [why, count] : troubles) fmt::print("lamp not tracked: {}: {}\n", why, count);
    line("scene frames judged, a second",
         fmt::format("{:.1f}", static_cast<double>(decided.size() - 1) / seconds), "offered: 30");
    line("frames kept, a second", fmt::format("{:.1f}", kept / seconds), "bar: 10");
    line("frames dropped by the program", fmt::format("{}", summary.droppedByQueues), "bar: 0");
    line("frame's arrival to decision, median", fmt::format("{:.1f} ms", percentile(decided, 0.5)));
    line("frame's arrival to decision, 95th percentile",
         fmt::format("{:.1f} ms", percentile(decided, 0.95)), "bar: 25");
    line("the same of kept frames", fmt::format("{:.1f} ms", percentile(keptDecided, 0.95)),
         "bar: 25");
    const auto floor = partnerDelays(scene, source, *first);
    line("its source frame's arrival after it, median",
         fmt::format("{:.1f} ms", percentile(floor, 0.5)), "limit of the above");
    line("the same, 95th percentile", fmt::format("{:.1f} ms", percentile(floor, 0.95)),
         "limit of the above");
    line("processor seconds a second", fmt::format("{:.2f}", processor / seconds),
         "2 cores, the rig on the same");
  }
  fs::remove_all(folder);
  return 0;
}
