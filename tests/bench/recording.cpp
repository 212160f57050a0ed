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
#include <vector>

#include "calibration/model/camera_model.h"
#include "calibration/model/rig_geometry.h"
#include "capture/session/recorder.h"

using namespace lightsketch;

namespace {

namespace fs = std::filesystem;

constexpr double kFramesPerSecond = 30;
const std::string kScene = "127.0.4.11";
const std::string kSource = "127.0.4.12";

template <class T>
T orStop(Result<T> result, const char* what) {
  if (result) return std::move(*result);
  fmt::print(stderr, "{}: {}\n", what, result.error().message);
  std::exit(1);
}

// `lightsketch rig`, until destruction.
class Rig {
 public:
  Rig(const fs::path& calibration, int frames) {
    child_ = ::fork();
    if (child_ != 0) return;
    const std::string prerendered = std::to_string(frames);
    const std::string rate = fmt::format("{}", kFramesPerSecond);
    std::freopen("/dev/null", "w", stdout);
    ::execl(LIGHTSKETCH_BINARY, LIGHTSKETCH_BINARY, "rig", "--prerendered", prerendered.c_str(),
            "--rate", rate.c_str(), "--scene-address", kScene.c_str(), "--source-address",
            kSource.c_str(), "--calibration", calibration.c_str(), nullptr);
    std::_Exit(127);
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
  fs::create_directories(folder);
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
    const auto scene = orStop(openCamera("aravis:" + kScene), "scene camera");
    const auto source = orStop(openCamera("aravis:" + kSource), "source camera");

    RecorderOptions options;
    options.directions = 1200;  // so fine that the lamp enters ten new cells a second
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
    const auto summary = orStop(record(*scene, std::array{SourceCamera{*source, model}}, geometry,
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
    line("processor seconds a second", fmt::format("{:.2f}", processor / seconds),
         "2 cores, the rig on the same");
  }
  fs::remove_all(folder);
  return 0;
}
