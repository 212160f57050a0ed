// Recording from the command line while the rig is killed with its power, and comes back.
#include <signal.h>

#include <chrono>
#include <functional>
#include <thread>

#include "capture/frame/json.h"
#include "pipeline/sketch/sketch.h"
#include "tests/ui/cli/program_test.h"

namespace lightsketch {
namespace {

// The program in the background; killed at the latest on destruction.
class Background {
 public:
  explicit Background(const std::vector<std::string>& arguments) {
    child_ = ::fork();
    if (child_ != 0) return;
    std::vector<char*> argv{const_cast<char*>(LIGHTSKETCH_BINARY)};
    for (const auto& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
    argv.push_back(nullptr);
    if (std::freopen("/dev/null", "w", stdout) && std::freopen("/dev/null", "w", stderr)) {
      ::execv(LIGHTSKETCH_BINARY, argv.data());
    }
    std::_Exit(127);
  }
  ~Background() { end(SIGKILL); }
  Background(const Background&) = delete;
  Background& operator=(const Background&) = delete;
  // Exit code, or 128 and the signal.
  int end(int signal) {
    if (child_ <= 0) return -1;
    ::kill(child_, signal);
    int status = 0;
    ::waitpid(child_, &status, 0);
    child_ = -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }

 private:
  pid_t child_ = -1;
};

// A safety net: nothing takes so long.
bool waitUntil(const std::function<bool()>& condition) {
  for (int i = 0; i < 2400; ++i) {
    if (condition()) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  return false;
}

class RecordCommand : public ProgramTest {};

TEST_F(RecordCommand, GoesOnWhenAKilledRigIsBack) {
  const std::vector<std::string> rigCall{
      "rig",        "--scene-address", "127.0.6.11",        "--source-address",
      "127.0.6.12", "--calibration",   path("rig").string()};
  const auto frames = [&] {
    const auto sketch = Sketch::open(path("sketch"));
    return sketch ? sketch->frames().size() : 0;
  };
  auto rig = std::make_unique<Background>(rigCall);
  ASSERT_TRUE(waitUntil([&] { return fs::exists(path("rig") / "rig.json"); }));
  Background record({"record", "--scene", "aravis:127.0.6.11", "--source", "aravis:127.0.6.12",
                     "--camera-model", path("rig") / "source.json", "--rig",
                     path("rig") / "rig.json", "--out", path("sketch"), "--black-level", "64",
                     "--ambient-seconds", "0.5", "--reconnect", "100", "--json", path("r.json")});
  ASSERT_TRUE(waitUntil([&] { return frames() >= 5; }));
  rig->end(SIGKILL);
  const std::size_t before = frames();
  rig = std::make_unique<Background>(rigCall);
  ASSERT_TRUE(waitUntil([&] { return frames() >= before + 5; }));
  ASSERT_EQ(record.end(SIGINT), 0);
  const Json figures = readJsonFile(path("r.json")).value();
  EXPECT_GE(figures.at("reconnections"), 1);
  const auto sketch = Sketch::open(path("sketch")).value();
  EXPECT_EQ(figures.at("recorded"), sketch.frames().size());
  for (const FrameRecord& frame : sketch.frames()) EXPECT_TRUE(sketch.readFrame(frame.id));
}

}  // namespace
}  // namespace lightsketch
