#include "capture/session/recorder.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <set>
#include <thread>

#include "capture/session/bounded_queue.h"
#include "pipeline/sketch/image_file.h"
#include "tests/capture/session/fake_rig.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

class Recorder : public testing::Test {
 protected:
  Recorder() {
    folder_ = fs::temp_directory_path() /
              fmt::format("lightsketch-recorder-{}-{}", ::getpid(),
                          testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::remove_all(folder_);
    options_.directions = 64;
    options_.coverageGoal = 0.9;
    options_.ambientSeconds = 0.3;
    options_.sceneExposureSeconds = FakeRig::kExposureSeconds;
    options_.timeLimitSeconds = 60;  // a safety net: no test waits for it
  }
  ~Recorder() override { fs::remove_all(folder_); }

  Result<RecorderSummary> run(FakeRig& rig,
                              std::function<void(const RecorderState&)> onState = {}) {
    return record(rig.scene(), std::array{SourceCamera{rig.source(), rig.model()}}, rig.geometry(),
                  folder_, options_, progress_, stop_.get_token(), std::move(onState), &control_);
  }
  // Stops the recording once so many scene frames were judged, then says why they were refused.
  std::map<Refusal, int> refusalsAfter(FakeRig& rig, int frames,
                                       std::optional<Eigen::Vector3d> holdAt = {}) {
    stop_ = {};
    fs::remove_all(folder_);
    int judged = 0;
    auto summary = run(rig, [&](const RecorderState& state) {
      if (holdAt) rig.send(!state.lampWantedOff, *holdAt);
      if (state.judged && ++judged > frames) stop_.request_stop();
    });
    EXPECT_TRUE(summary) << summary.error().message;
    return summary ? summary->refusals : std::map<Refusal, int>{};
  }

  fs::path folder_;
  RecorderOptions options_;
  SilentProgress progress_;
  RecorderControl control_;
  std::stop_source stop_;
};

TEST_F(Recorder, MergesABracketWhileTheLampIsHeldStill) {
  FakeRig rig(true);
  options_.bracket = {1, 0.25, 1 / 16.0};
  options_.framesPerSecond = 60;
  options_.coverageGoal = 0.15;
  const auto summary = run(rig);
  ASSERT_TRUE(summary) << summary.error().message;
  EXPECT_EQ(summary->ended, "coverage goal reached");
  EXPECT_GT(summary->refusals.at(Refusal::kBracketing), summary->recorded);
  const auto sketch = Sketch::open(folder_).value();
  ASSERT_GE(sketch.frames().size(), 8u);
  for (const FrameRecord& frame : sketch.frames()) {
    const auto image = sketch.readFrame(frame.id).value();
    const double lamp = FakeRig::lampCounts(frame.light.direction) / 255;
    const double ambient = FakeRig::kAmbientCounts / 255;
    // One count of the longest exposure that does not saturate; the lamp creeps while it is held.
    EXPECT_NEAR(image(5, 5, 0), lamp, 2.0 / 255);
    EXPECT_NEAR(image(0, 0, 0), FakeRig::kHighlight * (lamp + ambient) - ambient, 20.0 / 255);
    EXPECT_GT(image(0, 0, 0), 1.5);  // far beyond saturation of one frame
    EXPECT_EQ(frame.gates["bracket"].size(), 3u);
  }
  // The source camera's: the room to a fraction of a count, the lamp beyond saturation.
  const auto room = readImage(folder_ / "room-1.exr");
  ASSERT_TRUE(room) << room.error().message;
  EXPECT_NEAR((*room)(2, 2, 0), 12.0 / 255, 0.1 / 255);
  EXPECT_GT(*std::max_element(room->values().begin(), room->values().end()), 4.0f);
}

TEST_F(Recorder, CapturesTheWantedDirectionsWithTheirTrueLight) {
  FakeRig rig(true);
  const auto summary = run(rig);
  ASSERT_TRUE(summary) << summary.error().message;
  EXPECT_EQ(summary->ended, "coverage goal reached");
  EXPECT_GE(summary->coverage, 0.9);
  EXPECT_GE(summary->recorded, 58);
  EXPECT_NE(summary->describe().find("58 of 64 directions"), std::string::npos)
      << summary->describe();

  const auto sketch = Sketch::open(folder_);
  ASSERT_TRUE(sketch) << sketch.error().message;
  EXPECT_EQ(static_cast<int>(sketch->frames().size()), summary->recorded);
  EXPECT_TRUE(sketch->manifest().ambientSubtracted);
  EXPECT_TRUE(fs::exists(folder_ / "calibration" / (sketch->frames()[0].calibrationId + ".json")));
  const auto ambient = sketch->readAmbient();
  ASSERT_TRUE(ambient && *ambient);
  // Half floats keep three digits.
  EXPECT_NEAR((**ambient)(5, 5, 1), FakeRig::kAmbientCounts / 255, 1e-4);

  std::set<int> cells;
  double squared = 0;
  for (const FrameRecord& frame : sketch->frames()) {
    EXPECT_TRUE(cells.insert(frame.gates.at("cell").get<int>()).second);
    EXPECT_NEAR(frame.light.position.value().norm(), FakeRig::kLampRadius, 1e-6);
    EXPECT_GT(frame.light.covariance.trace(), 0);
    EXPECT_EQ(frame.lampPixels.at(0).camera, "fake:source");
    // Each picture carries the x of the true direction: the light beside it must be that of its own
    // time. A frame's shift at 120 degrees a second would be 0.035; counts are rounded to 1/60.
    const auto radiance = sketch->readFrame(frame.id);
    ASSERT_TRUE(radiance);
    const double x = ((*radiance)(3, 3, 0) * 255 - 90) / 60;
    EXPECT_NEAR(x, frame.light.direction.x(), 0.03) << frame.id;
    squared += std::pow(x - frame.light.direction.x(), 2);
  }
  // Rounding alone gives 1/60/sqrt(12) = 0.005; the lamp's pixel is 0.8 degrees wide.
  EXPECT_LT(std::sqrt(squared / static_cast<double>(sketch->frames().size())), 0.01);
}

TEST_F(Recorder, KeepsTheRawCountsOnRequest) {
  options_.keepRaw = true;
  FakeRig rig(true);
  ASSERT_TRUE(run(rig));
  const auto sketch = Sketch::open(folder_);
  ASSERT_TRUE(sketch);
  ASSERT_FALSE(sketch->frames().empty());
  for (const FrameRecord& frame : sketch->frames()) {
    const auto raw = readImage(folder_ / "frames" / fmt::format("{:06}.raw.png", frame.id),
                               TransferFunction::kLinear);
    ASSERT_TRUE(raw) << raw.error().message;
    const auto radiance = sketch->readFrame(frame.id);
    ASSERT_TRUE(radiance);
    // Half floats keep three digits.
    EXPECT_NEAR((*raw)(3, 3, 0) - FakeRig::kAmbientCounts / 255, (*radiance)(3, 3, 0), 1e-3);
  }
}

TEST_F(Recorder, GoesOnWhereItStopped) {
  FakeRig rig(true);
  int first = 0;
  {
    const auto summary = run(rig, [&](const RecorderState& state) {
      if (state.recorded >= 20) stop_.request_stop();
    });
    ASSERT_TRUE(summary) << summary.error().message;
    EXPECT_EQ(summary->ended, "stopped");
    first = summary->recorded;
    EXPECT_GE(first, 20);
    EXPECT_LT(first, 58);
  }
  stop_ = {};
  const auto summary = run(rig);
  ASSERT_TRUE(summary) << summary.error().message;
  EXPECT_EQ(summary->resumedFrom, first);
  const auto sketch = Sketch::open(folder_);
  ASSERT_TRUE(sketch);
  EXPECT_EQ(static_cast<int>(sketch->frames().size()), first + summary->recorded);
  // One frame a direction, over both runs; times go on.
  const auto grid = LightGrid::create(64).value();
  std::set<int> cells;
  double last = -1;
  for (const FrameRecord& frame : sketch->frames()) {
    EXPECT_TRUE(cells.insert(grid.nearest(frame.light.direction)).second);
    EXPECT_GT(frame.midExposureSeconds, last);
    last = frame.midExposureSeconds;
  }
  // Complete now: a third run has nothing to do and says so.
  const auto third = run(rig);
  ASSERT_TRUE(third);
  EXPECT_EQ(third->recorded, 0);
  EXPECT_NE(third->ended.find("before"), std::string::npos);
}

TEST_F(Recorder, RefusesASketchThatDoesNotFit) {
  FakeRig rig(true);
  stop_.request_stop();
  ASSERT_TRUE(run(rig));
  options_.directions = 100;
  auto other = run(rig);
  ASSERT_FALSE(other);
  EXPECT_NE(other.error().message.find("64 directions"), std::string::npos);
  options_.directions = 64;
  rig.sceneWidth = 16;
  other = run(rig);
  ASSERT_FALSE(other);
  EXPECT_NE(other.error().message.find("32 x 24"), std::string::npos);
  EXPECT_EQ(other.error().code, ErrorCode::kInvalidArgument);
}

TEST_F(Recorder, SaysWhyFramesAreRefused) {
  {
    FakeRig rig(true);
    rig.lampVisible = false;
    EXPECT_GT(refusalsAfter(rig, 30)[Refusal::kLampNotSeen], 20);
  }
  {
    FakeRig rig(true);
    options_.maxLampMotion = Angle::degrees(1e-4);
    EXPECT_GT(refusalsAfter(rig, 60)[Refusal::kLampTooFast], 15);
    options_.maxLampMotion = Angle::degrees(1);
  }
  {
    FakeRig rig(true);
    rig.saturate = true;
    EXPECT_GT(refusalsAfter(rig, 60)[Refusal::kSaturated], 15);
  }
  {
    FakeRig rig(false);
    EXPECT_GT(refusalsAfter(rig, 40, Eigen::Vector3d::UnitZ())[Refusal::kNotNew], 15);
  }
  {
    FakeRig rig(true);
    options_.maxPairingSeconds = 1e-3;
    EXPECT_GT(refusalsAfter(rig, 10)[Refusal::kUnpaired], 8);
    options_.maxPairingSeconds = 0.15;
  }
  {
    FakeRig rig(false);
    options_.directions = 10000;  // half a spacing is 0.8 degrees
    const Eigen::Vector3d below(-1, 0, -std::tan(Angle::degrees(1.1).radians()));
    EXPECT_GT(refusalsAfter(rig, 120, below)[Refusal::kOutsideGrid], 10);
  }
}

TEST_F(Recorder, WorksWithAPersonWhoReadsTheScreen) {
  FakeRig rig(false);  // no guide features: the test is the person
  bool askedForDarkness = false;
  const auto summary = run(rig, [&](const RecorderState& state) {
    askedForDarkness = askedForDarkness || state.lampWantedOff;
    rig.send(!state.lampWantedOff, state.nextDirection.value_or(Eigen::Vector3d::UnitZ()));
  });
  ASSERT_TRUE(summary) << summary.error().message;
  EXPECT_TRUE(askedForDarkness);
  EXPECT_EQ(summary->ended, "coverage goal reached");
  // The lamp was on in the first frames; the ambient picture is from after it went off.
  const auto sketch = Sketch::open(folder_);
  ASSERT_TRUE(sketch);
  EXPECT_NEAR((*sketch->readAmbient().value())(0, 0, 0), FakeRig::kAmbientCounts / 255, 1e-3);
}

TEST_F(Recorder, ALostCameraEndsTheRecordingWithEverythingOnDisk) {
  FakeRig rig(true);
  rig.sceneFramesUntilLoss = 200;
  const auto summary = run(rig);
  ASSERT_TRUE(summary) << summary.error().message;
  EXPECT_NE(summary->ended.find("control lost"), std::string::npos);
  EXPECT_GT(summary->recorded, 3);
  const auto sketch = Sketch::open(folder_);
  ASSERT_TRUE(sketch);
  EXPECT_EQ(static_cast<int>(sketch->frames().size()), summary->recorded);
  for (const FrameRecord& frame : sketch->frames()) EXPECT_TRUE(sketch->readFrame(frame.id));
}

TEST_F(Recorder, SaysThatACameraWasLostBeforeAnythingWasRecorded) {
  FakeRig rig(true);
  rig.sceneFramesUntilLoss = 3;
  const auto summary = run(rig);
  ASSERT_TRUE(summary) << summary.error().message;
  EXPECT_TRUE(summary->cameraLost);
  EXPECT_EQ(summary->recorded, 0);
}

TEST_F(Recorder, GoesOnWithOtherCamerasWithoutAskingForDarknessAgain) {
  options_.coverageGoal = 0.3;
  {
    FakeRig rig(true);
    rig.sceneFramesUntilLoss = 150;
    const auto summary = run(rig);
    ASSERT_TRUE(summary) << summary.error().message;
    ASSERT_TRUE(summary->cameraLost);
    ASSERT_GT(summary->recorded, 3);
    ASSERT_LT(summary->recorded, 18);
  }
  FakeRig other(true);
  bool asked = false;
  const auto summary =
      run(other, [&](const RecorderState& state) { asked = asked || state.lampWantedOff; });
  ASSERT_TRUE(summary) << summary.error().message;
  EXPECT_EQ(summary->ended, "coverage goal reached");
  EXPECT_FALSE(asked);
  // The later frames are without the ambient light, too, and times go on.
  const auto sketch = Sketch::open(folder_).value();
  double last = -1;
  for (const FrameRecord& frame : sketch.frames()) {
    const double lamp = FakeRig::lampCounts(frame.light.direction) / 255;
    EXPECT_NEAR(sketch.readFrame(frame.id).value()(5, 5, 0), lamp, 0.03 * 60 / 255 + 0.5 / 255);
    EXPECT_GT(frame.midExposureSeconds, last);
    last = frame.midExposureSeconds;
  }
}

TEST_F(Recorder, TellsWhatBecomesOfEveryFrame) {
  options_.coverageGoal = 0.3;
  FakeRig rig(true);
  int judged = 0, kept = 0;
  std::shared_ptr<const std::vector<bool>> captured;
  int replaced = 0;
  RecorderState last;
  const auto summary = run(rig, [&](const RecorderState& state) {
    if (captured != state.captured) {
      if (captured) {
        EXPECT_NE(*captured, *state.captured);
      }
      captured = state.captured;
      ++replaced;
    }
    last = state;
    if (!state.judged) return;
    ++judged;
    EXPECT_GE(state.judged->decided, state.judged->arrival);
    EXPECT_EQ(state.judged->refusal, state.lastRefusal);
    if (state.judged->refusal != Refusal::kNone) return;
    ++kept;
    // The dot is there at once.
    ASSERT_TRUE(state.judged->direction);
    const auto grid = LightGrid::create(64).value();
    EXPECT_TRUE(
        (*state.captured)[static_cast<std::size_t>(grid.nearest(*state.judged->direction))]);
  });
  ASSERT_TRUE(summary) << summary.error().message;
  EXPECT_EQ(judged, summary->offered);
  EXPECT_EQ(kept, summary->recorded);
  EXPECT_EQ(replaced, kept + 1);
  EXPECT_EQ(last.grid->size(), 64u);
  EXPECT_EQ(last.refusals, summary->refusals);
  EXPECT_EQ(std::count(captured->begin(), captured->end(), true), summary->captured);
  EXPECT_EQ(last.scene.delivered, summary->scene.delivered);
  EXPECT_EQ(last.sources.size(), 1u);
  EXPECT_GT(last.directionSigma.degrees(), 0);
  // Half the interval of 60 frames a second at most.
  EXPECT_LT(last.pairingErrorSeconds, 0.009);
}

TEST_F(Recorder, ReportsWhereNoFrameComes) {
  FakeRig rig(true);
  rig.sceneSilent = true;
  int calls = 0;
  const auto summary = run(rig, [&](const RecorderState&) {
    if (++calls == 12) stop_.request_stop();
  });
  ASSERT_TRUE(summary) << summary.error().message;
  EXPECT_GE(calls, 12);
  EXPECT_EQ(summary->offered, 0);
}

TEST_F(Recorder, KeepsNothingWhilePaused) {
  options_.coverageGoal = 0.25;
  FakeRig rig(true);
  int paused = 0;
  std::optional<int> recorded;
  const auto summary = run(rig, [&](const RecorderState& state) {
    if (state.recorded >= 5 && paused == 0) control_.pause(true);
    if (!state.paused) return;
    EXPECT_FALSE(state.judged);
    // What was accepted before is on disk a moment later; the lamp is followed on.
    if (++paused == 30) recorded = state.recorded;
    if (paused == 60) {
      EXPECT_EQ(state.recorded, recorded);
      EXPECT_TRUE(state.lampDirection);
      control_.pause(false);
    }
  });
  ASSERT_TRUE(summary) << summary.error().message;
  EXPECT_GE(paused, 60);
  EXPECT_EQ(summary->ended, "coverage goal reached");
}

TEST_F(Recorder, UndoTakesBackFramesAndRegionsTheLatestFirst) {
  options_.coverageGoal = 0.5;
  FakeRig rig(true);
  const Eigen::Vector3d centre = Eigen::Vector3d::UnitZ();
  const Angle radius = Angle::degrees(50);
  const auto within = [&](const FrameRecord& frame) {
    return frame.light.direction.dot(centre) >= std::cos(radius.radians());
  };
  // Recorded, paused, region dropped, taken back, and three frames more: each step waits until the
  // state says that it was done.
  int step = 0, before = 0, active = 0;
  const auto summary = run(rig, [&](const RecorderState& state) {
    const auto covered = std::count(state.captured->begin(), state.captured->end(), true);
    switch (step) {
      case 0:
        if (state.recorded < 20) return;
        control_.pause(true);
        ++step;
        return;
      case 1:
        if (!state.paused || covered != state.recorded) return;
        before = state.recorded;
        control_.dropRegion(centre, radius, "cat");
        ++step;
        return;
      case 2:
        if (state.recorded == before || covered != state.recorded) return;
        EXPECT_LT(state.recorded, before - 2);
        active = state.recorded;
        control_.undo();
        ++step;
        return;
      case 3:
        if (covered == active) return;
        if (covered != before) return;
        EXPECT_EQ(state.recorded, before);
        for (int i = 0; i < 3; ++i) control_.undo();
        ++step;
        return;
      case 4:
        if (state.recorded > before - 3 || covered > before - 3) return;
        EXPECT_EQ(state.recorded, before - 3);
        control_.dropRegion(centre, radius, "cat");
        stop_.request_stop();  // what was asked for before is done
        ++step;
        return;
      default:
        return;
    }
  });
  ASSERT_TRUE(summary) << summary.error().message;
  ASSERT_EQ(step, 5);
  const auto sketch = Sketch::open(folder_).value();
  ASSERT_EQ(static_cast<int>(sketch.frames().size()), before);
  for (const FrameRecord& frame : sketch.frames()) {
    const bool undone = frame.id >= before - 3;
    EXPECT_EQ(frame.dropped, undone || within(frame)) << frame.id;
    if (frame.dropped && !undone) {
      EXPECT_EQ(frame.dropReason, "cat");
    }
  }
  EXPECT_EQ(summary->recorded, static_cast<int>(sketch.activeFrames().size()));
  EXPECT_EQ(summary->captured, summary->recorded);

  // Shot again: its cells are open.
  stop_ = {};
  control_.pause(false);
  const auto again = run(rig);
  ASSERT_TRUE(again) << again.error().message;
  EXPECT_EQ(again->ended, "coverage goal reached");
  EXPECT_EQ(Sketch::open(folder_)->activeFrames().size(),
            static_cast<std::size_t>(summary->recorded + again->recorded));
}

TEST_F(Recorder, AFailingDiskStopsItAndLeavesWholeFrames) {
  FakeRig rig(true);
  const fs::path away = folder_.string() + "-away";
  fs::remove_all(away);
  bool moved = false;
  const auto summary = run(rig, [&](const RecorderState& state) {
    if (moved || state.recorded < 5) return;
    fs::rename(folder_ / "frames", away);  // as if the disk had gone
    moved = true;
  });
  ASSERT_FALSE(summary);
  EXPECT_TRUE(moved);
  fs::rename(away, folder_ / "frames");
  const auto sketch = Sketch::open(folder_);
  ASSERT_TRUE(sketch) << sketch.error().message;
  EXPECT_GE(sketch->frames().size(), 5u);
  for (const FrameRecord& frame : sketch->frames()) EXPECT_TRUE(sketch->readFrame(frame.id));
}

TEST_F(Recorder, RefusesNonsenseBeforeTouchingTheDisk) {
  FakeRig rig(true);
  options_.coverageGoal = 1.5;
  EXPECT_EQ(run(rig).error().code, ErrorCode::kInvalidArgument);
  options_.coverageGoal = 0.9;
  options_.directions = 3;
  EXPECT_FALSE(run(rig));
  EXPECT_FALSE(fs::exists(folder_));
}

TEST(BoundedQueue, RefusesAndCountsWhatDoesNotFit) {
  BoundedQueue<int> queue(2);
  EXPECT_TRUE(queue.push(1));
  EXPECT_TRUE(queue.push(2));
  EXPECT_FALSE(queue.push(3));
  EXPECT_EQ(queue.refused(), 1u);
  EXPECT_EQ(queue.pop(), 1);
  queue.close();
  EXPECT_EQ(queue.pop(), 2);
  EXPECT_FALSE(queue.pop());
  EXPECT_FALSE(queue.push(4));
  EXPECT_EQ(queue.refused(), 1u);  // closed is not full
}

}  // namespace
}  // namespace lightsketch
