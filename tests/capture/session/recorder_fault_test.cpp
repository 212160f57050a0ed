// Rows of the fault matrix that a whole recording meets: a slow disk, a clock set back.
#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <functional>

#include "capture/session/recorder.h"
#include "pipeline/sketch/sketch_check.h"
#include "tests/capture/frame/temporary_folder.h"
#include "tests/capture/session/fake_rig.h"
#include "tests/faults/fault_calls.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

// Records a fifth of the directions; `during` is called with every state.
RecorderSummary recordWhile(const fs::path& folder,
                            const std::function<void(const RecorderState&)>& during) {
  FakeRig rig(true);
  RecorderOptions options;
  options.directions = 64;
  options.coverageGoal = 0.2;
  options.ambientSeconds = 0.3;
  options.sceneExposureSeconds = FakeRig::kExposureSeconds;
  options.timeLimitSeconds = 60;
  SilentProgress progress;
  auto summary =
      record(rig.scene(), std::array{SourceCamera{rig.source(), rig.model()}}, rig.geometry(),
             folder, options, progress, {}, [&](const RecorderState& state) { during(state); });
  EXPECT_TRUE(summary) << summary.error().message;
  return summary.value_or(RecorderSummary{});
}

// None is lost, none is damaged, and each picture carries the x of its own light.
void expectEveryFrameRight(const fs::path& folder, int recorded) {
  SilentProgress progress;
  const auto check = checkSketch(folder, progress);
  ASSERT_TRUE(check) << check.error().message;
  EXPECT_TRUE(check->damage.empty());
  EXPECT_EQ(check->frames, recorded);
  const auto sketch = Sketch::open(folder).value();
  double before = -1e9;
  for (const FrameRecord& frame : sketch.frames()) {
    const auto radiance = sketch.readFrame(frame.id).value();
    const double x = (radiance(3, 3, 0) * 255 - 90) / 60;
    EXPECT_NEAR(x, frame.light.direction.x(), 0.03) << frame.id;  // as in recorder_test
    EXPECT_GT(frame.midExposureSeconds, before);
    before = frame.midExposureSeconds;
  }
}

TEST(FaultSlowDisk, DelaysARecordingAndMixesNothingUp) {
  const TemporaryFolder temporary;
  faultDelay(25'000);  // some 0.2 s a frame, of which sixty come a second
  const auto summary = recordWhile(temporary / "s", [](const RecorderState&) {});
  faultDisarm();
  EXPECT_EQ(summary.ended, "coverage goal reached");
  ASSERT_GE(summary.recorded, 12);
  expectEveryFrameRight(temporary / "s", summary.recorded);
}

TEST(FaultClockSetBack, ChangesNothingInARecording) {
  const TemporaryFolder temporary;
  const auto now = [] { return std::chrono::system_clock::now(); };
  const auto begin = now();
  int hours = 0;
  const auto summary = recordWhile(temporary / "s", [&](const RecorderState& state) {
    if (state.judged) faultClock(-3600 * ++hours);
  });
  EXPECT_LT(now(), begin) << "the clock was not set back at all";
  faultDisarm();
  EXPECT_EQ(summary.ended, "coverage goal reached");
  ASSERT_GE(summary.recorded, 12);
  expectEveryFrameRight(temporary / "s", summary.recorded);
}

}  // namespace
}  // namespace lightsketch
