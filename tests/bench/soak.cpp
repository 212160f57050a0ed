// Records from the simulated rig for as long as it is told to, while something goes wrong every few
// seconds: on the wire, with the cameras' clocks, with the cameras themselves, with the recording
// process. Every frame that was acknowledged must be in its sketch, be the one that was sent, to
// the last bit, and have been taken when the journal says; memory and handles must not grow.
//
//   bench_soak [--minutes M] [--seed S]    (a sketch takes two minutes: growth needs twelve)
#include <dirent.h>
#include <fmt/format.h>
#include <malloc.h>
#include <poll.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <random>
#include <set>
#include <sstream>
#include <string>
#include <thread>

#include "calibration/model/camera_model.h"
#include "calibration/model/rig_geometry.h"
#include "capture/rig/simulated_rig.h"
#include "pipeline/job/jobs.h"
#include "pipeline/sketch/sketch.h"

using namespace lightsketch;

namespace {

namespace fs = std::filesystem;
using namespace std::chrono_literals;

const std::string kScene = "127.0.8.11";
const std::string kSource = "127.0.8.12";
constexpr double kFramesPerSecond = 8;  // slower ones do not pair
constexpr double kSessionSeconds = 120;
constexpr double kTimeTolerance = 0.005;  // beside three times the uncertainty that a frame admits

// --- What a process holds ------------------------------------------------------------------------

struct Load {
  double seconds = 0;
  double megabytes = 0;
  int handles = 0;
  int threads = 0;
};

int entries(const std::string& folder) {
  int count = 0;
  if (DIR* const directory = ::opendir(folder.c_str())) {
    while (::readdir(directory) != nullptr) ++count;
    ::closedir(directory);
  }
  return count - 2;
}

Load loadOf(pid_t process, double seconds) {
  const std::string proc = fmt::format("/proc/{}", process);
  std::ifstream statm(proc + "/statm");
  double pages = 0, resident = 0;
  statm >> pages >> resident;
  return {seconds, resident * static_cast<double>(::sysconf(_SC_PAGESIZE)) / 1e6,
          entries(proc + "/fd"), entries(proc + "/task")};
}

// --- The recording process -----------------------------------------------------------------------

// One sketch after the other, until it is told to stop. Says on `out` what it has acknowledged.
[[noreturn]] void recordForever(const fs::path& folder, int out) {
  static std::stop_source stop;
  ::signal(SIGTERM, [](int) { stop.request_stop(); });
  const auto say = [out](const std::string& line) {
    if (::write(out, line.data(), line.size()) < 0) ::_exit(1);
  };
  SilentProgress progress;
  for (int session = 0; !stop.stop_requested(); ++session) {
    RecordJob job;
    job.sceneCamera = "aravis:" + kScene;
    job.sourceCameras = {"aravis:" + kSource};
    job.cameraModels = {folder / "source.json"};
    job.rigGeometry = folder / "rig.json";
    job.sketch = folder / std::to_string(session);
    job.reconnectSeconds = 600;
    job.recorder.keepRaw = true;
    job.recorder.framesPerSecond = kFramesPerSecond;
    job.recorder.ambientSeconds = 0.5;
    job.recorder.timeLimitSeconds = kSessionSeconds;
    job.recorder.sceneBlackLevel = sceneBlackLevelCounts(job.recorder.sceneFormat);
    int acknowledged = 0;
    const auto result = recordJob(job, progress, stop.get_token(), [&](const RecorderState& state) {
      if (state.recorded <= acknowledged) return;
      acknowledged = state.recorded;
      say(fmt::format("ack {} {}\n", session, acknowledged));
    });
    if (result) {
      const Json& f = result->figures;
      int refused = 0;
      for (const auto& refusal : f["refusals"].items()) refused += refusal.value().get<int>();
      // With the cameras closed and free memory given back the same is held after every sketch.
      ::malloc_trim(0);
      const Load rest = loadOf(::getpid(), 0);
      say(fmt::format("done {} {:.9f} {} {} {} {} {} {} {} {}\n", session,
                      f["timeZeroSeconds"].get<double>(), f["recorded"].get<int>(),
                      f["offered"].get<int>(), refused, f["scene"]["lost"].get<int>(),
                      f["scene"]["incomplete"].get<int>() + f["scene"]["implausible"].get<int>(),
                      rest.megabytes, rest.handles, rest.threads));
    } else {  // the cameras were away when it began
      say(fmt::format("failed {} {}\n", session, result.error().message));
      std::this_thread::sleep_for(1s);
    }
  }
  ::_exit(0);
}

// --- What is known of it -------------------------------------------------------------------------

struct Totals {
  int sessions = 0, failedStarts = 0;
  long offered = 0, recorded = 0, refused = 0, lost = 0, damaged = 0;
  long missing = 0;  // acknowledged, but not there
  long wrong = 0;    // there, but not what was sent
  double worstTimeError = 0;
};

// Everything that a finished session left.
void check(const fs::path& folder, int acknowledged, double timeZero, double rigZero,
           Totals& totals) {
  const auto wrong = [&](const std::string& what) {
    ++totals.wrong;
    if (totals.wrong <= 20) fmt::print("{}: {}\n", folder.filename().string(), what);
  };
  const auto sketch = Sketch::open(folder);
  if (!sketch) {
    totals.missing += acknowledged;
    return wrong(sketch.error().message);
  }
  const auto count = static_cast<int>(sketch->frames().size());
  totals.missing += std::max(0, acknowledged - count);
  std::set<double> times;
  for (const FrameRecord& frame : sketch->frames()) {
    if (const auto image = sketch->readFrame(frame.id); !image) {
      wrong(image.error().message);
      continue;
    }
    const auto path = folder / "frames" / fmt::format("{:06}.raw.png", frame.id);
    const cv::Mat raw = cv::imread(path.string(), cv::IMREAD_UNCHANGED);
    if (raw.empty() || !raw.isContinuous()) {
      wrong("cannot read " + path.string());
      continue;
    }
    const auto stamp = readStamp({raw.data, raw.total() * raw.elemSize()}, PixelFormat::kBayerRG12);
    if (!stamp) {
      wrong(path.string() + " is not as it was sent");
      continue;
    }
    const double error = timeZero + frame.midExposureSeconds - rigZero - stamp->timeSeconds;
    totals.worstTimeError = std::max(totals.worstTimeError, std::abs(error));
    const double sigma = frame.gates.at("timeUncertaintySeconds").get<double>();
    if (std::abs(error) > kTimeTolerance + 3 * sigma)
      wrong(fmt::format("frame {} is {} s off and admits {}", frame.id, error, sigma));
    if (!times.insert(stamp->timeSeconds).second) wrong(fmt::format("frame {} twice", frame.id));
  }
}

// --- What goes wrong -----------------------------------------------------------------------------

struct Trouble {
  std::string name;
  double longestSeconds;
  GigeFaults faults;
  enum Kind { kWire, kUnplug, kStop } kind = kWire;
};

std::vector<Trouble> troubles() {
  std::vector<Trouble> all;
  const auto add = [&](const char* name, double seconds, auto set) {
    Trouble trouble{name, seconds, {}};
    set(trouble.faults);
    all.push_back(trouble);
  };
  add("1 % of packets lost", 4, [](GigeFaults& f) { f.loss = 0.01; });
  add("5 % of packets lost", 4, [](GigeFaults& f) { f.loss = 0.05; });
  add("5 % lost, none sent again", 3, [](GigeFaults& f) {
    f.loss = 0.05;
    f.resend = false;
  });
  add("duplicates", 4, [](GigeFaults& f) { f.duplicated = 0.05; });
  add("reordering", 4, [](GigeFaults& f) { f.reordered = 0.05; });
  add("headers damaged", 3, [](GigeFaults& f) { f.corruptedHeader = 0.002; });
  add("lengths damaged", 3, [](GigeFaults& f) { f.corruptedLength = 0.002; });
  add("sender stalls", 4, [](GigeFaults& f) {
    f.stalled = 0.3;
    f.stallSeconds = 0.3;
  });
  add("camera frozen", 6, [](GigeFaults& f) { f.frozen = true; });
  add("camera silent", 9, [](GigeFaults& f) { f.silent = true; });
  add("times zero", 4, [](GigeFaults& f) { f.zeroTimestamps = true; });
  add("times of another epoch", 4, [](GigeFaults& f) { f.frameClockSeconds = 1e6; });
  add("clock set", 4, [](GigeFaults& f) { f.deviceClockSeconds = 700; });
  all.push_back({"camera unplugged", 6, {}, Trouble::kUnplug});
  all.push_back({"our process stopped", 3, {}, Trouble::kStop});
  return all;
}

double median(std::vector<double> values) {
  if (values.empty()) return 0;
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

bool line(const char* what, const std::string& figure, const char* bar = "", bool good = true) {
  fmt::print("{:<46} {:>14}   {}{}\n", what, figure, bar, good ? "" : "   MISSED");
  return good;
}

}  // namespace

int main(int argc, char** argv) {
  double minutes = 30;
  unsigned seed = 1;
  for (int i = 1; i < argc; i += 2) {
    const std::string_view option = argv[i];
    const double value = i + 1 < argc ? std::atof(argv[i + 1]) : 0;
    if (option == "--minutes" && value > 0) {
      minutes = value;
    } else if (option == "--seed" && value > 0) {
      seed = static_cast<unsigned>(value);
    } else {
      fmt::print(stderr, "usage: bench_soak [--minutes M] [--seed S]\n");
      return 2;
    }
  }
  const fs::path folder = fs::temp_directory_path() / fmt::format("bench-soak-{}", ::getpid());
  fs::create_directories(folder);
  std::array<int, 2> begin{}, words{};  // the rig is there; what was recorded
  if (::pipe(begin.data()) != 0 || ::pipe(words.data()) != 0) return 1;
  const pid_t recorder = ::fork();  // before there is any thread
  if (recorder == 0) {
    ::close(begin[1]);
    ::close(words[0]);
    char go = 0;
    if (::read(begin[0], &go, 1) != 1) ::_exit(1);
    recordForever(folder, words[1]);
  }
  ::close(words[1]);
  SimulatedRigOptions options;
  options.sceneAddress = kScene;
  options.sourceAddress = kSource;
  options.framesPerSecond = kFramesPerSecond;
  options.seed = seed;
  options.stampFrames = true;
  const auto rig = SimulatedRig::start(options);
  if (!rig || !saveCameraModel(*(*rig)->calibratedSourceModel(), folder / "source.json") ||
      !saveRigGeometry((*rig)->geometry(), folder / "rig.json")) {
    fmt::print(stderr, "soak: the rig did not start: {}\n", rig ? "" : rig.error().message);
    ::kill(recorder, SIGKILL);
    return 1;
  }
  if (::write(begin[1], "g", 1) != 1) return 1;
  const double rigZero = toSeconds((*rig)->startTime().time_since_epoch());

  const TimePoint start = Clock::now();
  const auto since = [&] { return toSeconds(Clock::now() - start); };
  Totals totals;
  std::vector<Load> rests;  // after every sketch
  std::map<int, int> acknowledged;
  std::string pending;
  const auto listen = [&](int milliseconds) {
    pollfd event{words[0], POLLIN, 0};
    if (::poll(&event, 1, milliseconds) <= 0) return true;
    std::array<char, 4096> buffer;
    const ssize_t size = ::read(words[0], buffer.data(), buffer.size());
    if (size <= 0) return false;
    pending.append(buffer.data(), static_cast<std::size_t>(size));
    for (std::size_t end; (end = pending.find('\n')) != std::string::npos;) {
      std::istringstream said(pending.substr(0, end));
      pending.erase(0, end + 1);
      std::string what;
      int session = 0;
      said >> what >> session;
      if (what == "ack") said >> acknowledged[session];
      if (what == "failed") ++totals.failedStarts;
      if (what != "done") continue;
      double timeZero = 0;
      long recorded = 0, offered = 0, refused = 0, lost = 0, damaged = 0;
      said >> timeZero >> recorded >> offered >> refused >> lost >> damaged;
      Load rest{since()};
      said >> rest.megabytes >> rest.handles >> rest.threads;
      rests.push_back(rest);
      ++totals.sessions;
      totals.recorded += recorded;
      totals.offered += offered;
      totals.refused += refused;
      totals.lost += lost;
      totals.damaged += damaged;
      const fs::path sketch = folder / std::to_string(session);
      check(sketch, acknowledged[session], timeZero, rigZero, totals);
      fs::remove_all(sketch);
    }
    return true;
  };

  std::mt19937 random(seed);
  const auto uniform = [&](double from, double to) {
    return std::uniform_real_distribution<double>(from, to)(random);
  };
  const std::vector<Trouble> kinds = troubles();
  std::map<std::string, int> happened;
  double nextLoad = 60;
  bool alive = true;
  const auto pass = [&](double seconds) {
    const double until = since() + seconds;
    while (alive && since() < until) {
      alive = listen(50) && ::waitpid(recorder, nullptr, WNOHANG) == 0;
      if (since() < nextLoad) continue;
      const Load load = loadOf(recorder, since());
      nextLoad += 60;
      fmt::print(
          "{:5.1f} min: {:.1f} MB, {} handles, {} threads; {} recorded in {} sketches, {} "
          "missing, {} wrong\n",
          since() / 60, load.megabytes, load.handles, load.threads, totals.recorded,
          totals.sessions, totals.missing, totals.wrong);
      std::fflush(stdout);
    }
  };
  while (alive && since() < 60 * minutes) {
    pass(uniform(2, 5));
    const Trouble& trouble =
        kinds[std::uniform_int_distribution<std::size_t>(0, kinds.size() - 1)(random)];
    const std::size_t camera = random() % 2;
    const double seconds = uniform(0.3, trouble.longestSeconds);
    ++happened[trouble.name];
    switch (trouble.kind) {
      case Trouble::kWire:
        (*rig)->setFaults(camera, trouble.faults);
        pass(seconds);
        (*rig)->setFaults(camera, {});
        break;
      case Trouble::kUnplug:
        (*rig)->unplug(camera);
        pass(seconds);
        if (const auto back = (*rig)->plugIn(camera); !back) {
          fmt::print(stderr, "soak: {}\n", back.error().message);
          alive = false;
        }
        break;
      case Trouble::kStop:
        ::kill(recorder, SIGSTOP);
        pass(seconds);
        ::kill(recorder, SIGCONT);
        break;
    }
  }
  const bool survived = alive;
  ::kill(recorder, SIGTERM);
  while (listen(20000) && !(pending.empty() && ::waitpid(recorder, nullptr, WNOHANG) != 0)) {
  }
  fs::remove_all(folder);

  // After a sixth of the time everything has been in use once.
  const double warm = 10 * minutes;
  const auto typical = [&](double from, double to, auto member) {
    std::vector<double> values;
    for (const Load& load : rests) {
      if (load.seconds >= from && load.seconds < to) {
        values.push_back(static_cast<double>(load.*member));
      }
    }
    return median(values);
  };
  const double end = since();
  const double third = (end - warm) / 3;
  const auto growth = [&](auto member) {
    return std::pair{typical(warm, warm + third, member), typical(end - third, end + 1, member)};
  };
  const auto memory = growth(&Load::megabytes);
  const auto handles = growth(&Load::handles);
  const auto threads = growth(&Load::threads);

  for (const auto& [name, count] : happened) line(name.c_str(), fmt::format("{} times", count));
  fmt::print("\n");
  line("frames offered (scene camera, judged)", fmt::format("{}", totals.offered));
  line("frames recorded", fmt::format("{} in {} sketches", totals.recorded, totals.sessions));
  line("frames refused", fmt::format("{}", totals.refused));
  line("frames lost on the way", fmt::format("{}", totals.lost));
  line("frames that came damaged", fmt::format("{}", totals.damaged));
  line("sketches that could not be begun", fmt::format("{}", totals.failedStarts),
       "a camera was away just then");
  bool good = line("recording process survived", survived ? "yes" : "no", "bar: yes", survived);
  good &= line("acknowledged frames missing", fmt::format("{}", totals.missing), "bar: 0",
               totals.missing == 0);
  good &= line("frames that are not what was sent", fmt::format("{}", totals.wrong), "bar: 0",
               totals.wrong == 0 && totals.recorded > 0);
  line("largest error of a frame's time", fmt::format("{:.2f} ms", 1e3 * totals.worstTimeError),
       "wrong beyond 5 ms and 3 sigma of what the frame admits");
  good &= line("memory between sketches, first third to last",
               fmt::format("{:.1f} -> {:.1f} MB", memory.first, memory.second),
               fmt::format("{:+.1f} %, bar: 5", 100 * (memory.second / memory.first - 1)).c_str(),
               memory.first > 0 && memory.second <= 1.05 * memory.first);
  good &=
      line("open handles, the same", fmt::format("{:.0f} -> {:.0f}", handles.first, handles.second),
           "bar: no growth", handles.second <= handles.first);
  good &= line("threads, the same", fmt::format("{:.0f} -> {:.0f}", threads.first, threads.second),
               "bar: no growth", threads.second <= threads.first);
  return good ? 0 : 1;
}
