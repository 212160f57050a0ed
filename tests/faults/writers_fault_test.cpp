// Every command that writes, killed and failing at each of its system calls: what has its final
// name is whole.
#include <gtest/gtest.h>

#include <cerrno>
#include <cmath>
#include <functional>
#include <iostream>

#include "calibration/lens/camera_formats.h"
#include "capture/frame/json.h"
#include "pipeline/compress/model.h"
#include "pipeline/sketch/image_file.h"
#include "pipeline/sketch/sketch.h"
#include "pipeline/sketch/sketch_check.h"
#include "tests/faults/fault_calls.h"
#include "tests/ui/cli/program_test.h"

namespace lightsketch {
namespace {

class FaultWriters : public ProgramTest {
 protected:
  void SetUp() override {
    ProgramTest::SetUp();
    fs::create_directory(path("set"));
    std::ofstream lp(path("set") / "set.lp");
    lp << 6 << "\n";
    for (int i = 0; i < 6; ++i) {
      RadianceImage image(16, 12, 3, 0.1f + 0.1f * static_cast<float>(i));
      ASSERT_TRUE(writePng(path("set") / fmt::format("{}.png", i), image));
      lp << i << ".png " << 0.1 * i << " 0 " << std::sqrt(1 - 0.01 * i * i) << "\n";
    }
  }

  // Runs the program with a fault at `call`; returns its outcome and how many calls it made.
  std::pair<Outcome, int> runWithFault(const std::vector<std::string>& arguments, int call,
                                       int action) const {
    const fs::path count = fs::temp_directory_path() / (folder_.filename().string() + ".count");
    fs::remove(count);
    ::setenv("LD_PRELOAD", LIGHTSKETCH_FAULT_CALLS, 1);
    ::setenv("LIGHTSKETCH_FAULT", fmt::format("{} {} {}", call, action, count.string()).c_str(), 1);
    ::setenv("OPENBLAS_NUM_THREADS", "1", 1);
    const Outcome outcome = run(arguments);
    ::unsetenv("LD_PRELOAD");
    ::unsetenv("LIGHTSKETCH_FAULT");
    int calls = -1;
    std::ifstream(count) >> calls;
    fs::remove(count);
    return {outcome, calls};
  }

  // `isWhole` looks at what has the result's name; `clear` removes it.
  void expectWholeOrAbsent(const std::vector<std::string>& arguments, const fs::path& result,
                           const std::function<bool()>& isWhole, int most = 8) const {
    const auto [plain, calls] = runWithFault(arguments, 0, FAULT_KILL);
    ASSERT_EQ(plain.exitCode, 0) << plain.error;
    ASSERT_TRUE(isWhole());
    ASSERT_GT(calls, 3);
    // All of them, or as many spread evenly, the last ones in any case.
    const int step = std::max(1, calls / most);
    int runs = 0;
    int whole = 0;
    for (const int action : {FAULT_KILL, ENOSPC}) {
      for (int call = 1; call <= calls; call += call > calls - 5 ? 1 : step) {
        fs::remove_all(result);
        const auto [outcome, ignored] = runWithFault(arguments, call, action);
        ++runs;
        if (fs::exists(result)) {
          EXPECT_TRUE(isWhole()) << arguments[0] << ", call " << call << ", action " << action;
          ++whole;
        } else {
          EXPECT_NE(outcome.exitCode, 0) << arguments[0] << ", call " << call;
        }
        if (action == FAULT_KILL) continue;
        // A failure is said in one line, and takes away what it has begun.
        if (outcome.exitCode == 0) continue;
        EXPECT_EQ(outcome.exitCode, 1) << arguments[0] << ", call " << call;
        EXPECT_EQ(std::count(outcome.error.begin(), outcome.error.end(), '\n'), 1) << outcome.error;
      }
    }
    // And then it works, with whatever the killed ones have left.
    fs::remove_all(result);
    EXPECT_EQ(run(arguments).exitCode, 0);
    EXPECT_TRUE(isWhole());
    std::cout << arguments[0] << ": " << calls << " writing system calls, " << runs
              << " faults, result whole after " << whole << ", absent after " << runs - whole
              << "\n";
  }

  bool sketchIsWhole(const std::string& name, int frames) const {
    SilentProgress progress;
    const auto check = checkSketch(path(name), progress);
    return check && check->damage.empty() && check->frames == frames;
  }
  void importSet() const {
    ASSERT_EQ(run({"import", path("set"), "--out", path("s"), "--quiet"}).exitCode, 0);
  }
};

TEST_F(FaultWriters, Import) {
  expectWholeOrAbsent({"import", path("set"), "--out", path("s"), "--quiet"}, path("s"),
                      [&] { return sketchIsWhole("s", 6); });
}

TEST_F(FaultWriters, Export) {
  importSet();
  expectWholeOrAbsent(
      {"export", path("s"), "--images", "png8", "--out", path("e"), "--quiet"}, path("e"), [&] {
        const auto images = entriesBelow(path("e"));
        return slurp(path("e") / "dirs.lp").starts_with("6\n") && images.size() == 7 &&
               std::all_of(images.begin(), images.end(), [&](const std::string& name) {
                 return name == "dirs.lp" || readImage(path("e") / name).has_value();
               });
      });
}

TEST_F(FaultWriters, Model) {
  importSet();
  for (const std::vector<std::string>& how :
       {std::vector<std::string>{"--block-rank", "2", "--rank", "4"}, {"--quality", "small"}}) {
    std::vector<std::string> arguments = {"compress", path("s"), "--out", path("m.lsd"), "--quiet"};
    arguments.insert(arguments.end(), how.begin(), how.end());
    expectWholeOrAbsent(arguments, path("m.lsd"),
                        [&] { return loadModel(path("m.lsd")).has_value(); });
  }
}

TEST_F(FaultWriters, Picture) {
  importSet();
  ASSERT_EQ(run({"compress", path("s"), "--out", path("m.lsd"), "--quiet"}).exitCode, 0);
  for (const char* name : {"p.png", "p.exr"}) {
    expectWholeOrAbsent({"relight", path("m.lsd"), "--light", "0,0,1", "--out", path(name)},
                        path(name), [&] { return readImage(path(name)).has_value(); });
  }
}

TEST_F(FaultWriters, Report) {
  importSet();
  expectWholeOrAbsent(
      {"validate", path("s"), "--hold-out", "every:3:1", "--report", path("r"), "--quiet"},
      path("r") / "index.html",
      [&] { return slurp(path("r") / "index.html").find("</html>") != std::string::npos; }, 12);
}

TEST_F(FaultWriters, CameraModel) {
  std::ofstream(path("camera.json")) << R"({"format": "lightsketch-camera", "formatVersion": 1,
    "model": "kannala-brandt", "parameters": {"width": 960, "height": 960, "fx": 290, "fy": 290,
    "cx": 480, "cy": 480, "k": [0.01, 0, 0, 0], "p": [0, 0], "maxFieldAngleDegrees": 85}})";
  expectWholeOrAbsent(
      {"calibrate", "convert", path("camera.json"), "--to", "opencv=" + path("c.yml").string()},
      path("c.yml"), [&] { return loadAnyCameraModel(path("c.yml")).has_value(); });
}

TEST_F(FaultWriters, Figures) {
  importSet();
  expectWholeOrAbsent({"info", path("s"), "--json", path("i.json")}, path("i.json"),
                      [&] { return readJsonFile(path("i.json")).has_value(); });
}

}  // namespace
}  // namespace lightsketch
