#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <future>
#include <memory>
#include <mutex>
#include <set>
#include <thread>

#include "pipeline/job/jobs.h"
#include "tests/capture/frame/temporary_folder.h"
#include "tests/capture/session/fake_rig.h"

namespace lightsketch {
namespace {

// A camera of a FakeRig that somebody else owns.
class Borrowed final : public Camera {
 public:
  Borrowed(std::shared_ptr<FakeRig> rig, bool scene)
      : rig_(std::move(rig)), camera_(scene ? rig_->scene() : rig_->source()) {}
  ~Borrowed() override { camera_.stop(); }
  const CameraInfo& info() const override { return camera_.info(); }
  Result<CameraSettings> configure(const CameraSettings& s) override {
    return camera_.configure(s);
  }
  Result<void> start(FrameCallback onFrame, EndCallback onEnd) override {
    return camera_.start(std::move(onFrame), std::move(onEnd));
  }
  void stop() override { camera_.stop(); }
  StreamStatistics statistics() const override { return camera_.statistics(); }
  bool hasFeature(const std::string& name) const override { return camera_.hasFeature(name); }
  Result<void> setFeature(const std::string& name, double value) override {
    return camera_.setFeature(name, value);
  }

 private:
  std::shared_ptr<FakeRig> rig_;
  Camera& camera_;
};

class Warnings final : public Progress {
 public:
  void update(std::string_view, std::size_t, std::size_t) override {}
  void warn(std::string_view message) override {
    const std::lock_guard lock(mutex_);
    said_.emplace_back(message);
  }
  bool cancelled() const override { return false; }
  std::vector<std::string> said() const {
    const std::lock_guard lock(mutex_);
    return said_;
  }

 private:
  mutable std::mutex mutex_;  // Guards said_.
  std::vector<std::string> said_;
};

class RecordJobTest : public testing::Test {
 protected:
  std::filesystem::path path(const char* name) const { return folder_ / name; }
  RecordJob job(const std::shared_ptr<FakeRig>& rig) {
    RecordJob job;
    job.sceneCamera = "fake:scene";
    job.sourceCameras = {"fake:source"};
    job.cameraModels = {path("source.json")};
    job.rigGeometry = path("rig.json");
    job.sketch = path("sketch");
    EXPECT_TRUE(saveCameraModel(*rig->model(), path("source.json")));
    EXPECT_TRUE(saveRigGeometry(rig->geometry(), path("rig.json")));
    job.recorder.directions = 64;
    job.recorder.coverageGoal = 0.3;
    job.recorder.ambientSeconds = 0.3;
    job.recorder.sceneExposureSeconds = FakeRig::kExposureSeconds;
    return job;
  }
  static CameraOpener opener(std::shared_ptr<FakeRig> rig) {
    return [rig](const std::string& address) -> Result<std::unique_ptr<Camera>> {
      return std::make_unique<Borrowed>(rig, address == "fake:scene");
    };
  }

  TemporaryFolder folder_;
  Warnings progress_;
  std::stop_source stop_;
};

TEST_F(RecordJobTest, GoesOnInTheSameSketchWhenALostCameraIsBack) {
  const auto first = std::make_shared<FakeRig>(true);
  const auto second = std::make_shared<FakeRig>(true);
  first->sceneFramesUntilLoss = 150;
  RecordJob job = this->job(first);
  job.reconnectSeconds = 60;
  const auto opened = std::make_shared<std::atomic<int>>(0);
  job.open = [opened, first = opener(first), second = opener(second)](
                 const std::string& address) -> Result<std::unique_ptr<Camera>> {
    const int attempt = (*opened)++;
    if (attempt < 2) return first(address);
    if (attempt == 2) return failure(ErrorCode::kNotFound, "no camera answers there");
    return second(address);
  };
  std::set<std::string> waits;
  int largest = 0;
  std::size_t judged = 0;
  bool asked = false;
  const auto result = recordJob(job, progress_, stop_.get_token(), [&](const RecorderState& state) {
    if (!state.waitingFor.empty()) waits.insert(state.waitingFor);
    if (state.judged) ++judged;
    if (*opened > 3) asked = asked || state.lampWantedOff;
    EXPECT_GE(state.recorded, largest);  // frames stay
    largest = std::max(largest, state.recorded);
  });
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_EQ(result->figures["reconnections"], 1);
  EXPECT_EQ(result->figures["offered"], judged);
  EXPECT_GE(result->figures["recorded"], 20);
  EXPECT_FALSE(asked);
  ASSERT_FALSE(waits.empty());
  EXPECT_TRUE(std::any_of(waits.begin(), waits.end(), [](const std::string& text) {
    return text.find("the scene camera was lost: fake:scene: control lost; trying again in 1 s") !=
           std::string::npos;
  })) << *waits.begin();
  const auto said = progress_.said();
  EXPECT_EQ(std::count_if(said.begin(), said.end(),
                          [](const auto& s) { return s.find("was lost") != std::string::npos; }),
            1);
  const auto sketch = Sketch::open(job.sketch);
  ASSERT_TRUE(sketch) << sketch.error().message;
  EXPECT_EQ(result->figures["recorded"], sketch->frames().size());
  for (const FrameRecord& frame : sketch->frames()) EXPECT_TRUE(sketch->readFrame(frame.id));
}

TEST_F(RecordJobTest, WithoutReconnectALossEndsIt) {
  const auto rig = std::make_shared<FakeRig>(true);
  rig->sceneFramesUntilLoss = 3;
  RecordJob job = this->job(rig);
  job.open = opener(rig);
  const auto result = recordJob(job, progress_, stop_.get_token());
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kDevice);
  EXPECT_NE(result.error().message.find("nothing was recorded"), std::string::npos);
}

TEST_F(RecordJobTest, GivesUpWhenTheCameraStaysAway) {
  const auto rig = std::make_shared<FakeRig>(true);
  rig->sceneFramesUntilLoss = 150;
  RecordJob job = this->job(rig);
  job.reconnectSeconds = 1;
  const auto opened = std::make_shared<std::atomic<int>>(0);
  job.open = [opened,
              first = opener(rig)](const std::string& address) -> Result<std::unique_ptr<Camera>> {
    if ((*opened)++ < 2) return first(address);
    return failure(ErrorCode::kNotFound, "no camera answers there");
  };
  const auto result = recordJob(job, progress_, stop_.get_token());
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_NE(result->text.find("was lost"), std::string::npos) << result->text;
  EXPECT_GT(result->figures["recorded"], 3);
}

TEST_F(RecordJobTest, StopDoesNotWaitForACameraThatIsBeingOpened) {
  const auto rig = std::make_shared<FakeRig>(true);
  rig->sceneFramesUntilLoss = 150;
  RecordJob job = this->job(rig);
  job.reconnectSeconds = 60;
  const auto opened = std::make_shared<std::atomic<int>>(0);
  auto release = std::make_shared<std::promise<void>>();
  job.open = [opened, first = opener(rig), released = release->get_future().share()](
                 const std::string& address) -> Result<std::unique_ptr<Camera>> {
    if ((*opened)++ < 2) return first(address);
    released.wait();
    return failure(ErrorCode::kNotFound, "no camera answers there");
  };
  const auto result = recordJob(job, progress_, stop_.get_token(), [&](const RecorderState& state) {
    if (!state.waitingFor.empty() && *opened > 2) stop_.request_stop();
  });
  // Here at all: the opener still waits.
  release->set_value();
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_NE(result->text.find("stopped"), std::string::npos) << result->text;
  EXPECT_GT(result->figures["recorded"], 3);
}

TEST_F(RecordJobTest, SurvivesTheSimulatedRigGoingAway) {
  SimulatedRigOptions options;
  options.sceneAddress = "127.0.5.11";
  options.sourceAddress = "127.0.5.12";
  auto rig = SimulatedRig::start(options);
  ASSERT_TRUE(rig) << rig.error().message;
  RecordJob job;
  job.sceneCamera = "aravis:" + options.sceneAddress;
  job.sourceCameras = {"aravis:" + options.sourceAddress};
  job.cameraModels = {path("source.json")};
  job.rigGeometry = path("rig.json");
  job.sketch = path("sketch");
  job.reconnectSeconds = 120;
  job.recorder.ambientSeconds = 0.5;
  job.recorder.sceneBlackLevel = sceneBlackLevelCounts(job.recorder.sceneFormat);
  ASSERT_TRUE(saveCameraModel(*(*rig)->calibratedSourceModel(), path("source.json")));
  ASSERT_TRUE(saveRigGeometry((*rig)->geometry(), path("rig.json")));
  std::atomic<int> recorded = 0;
  std::atomic<bool> waiting = false;
  int before = -1;
  std::jthread power([&](const std::stop_token& end) {
    const auto until = [&](const auto& condition) {
      while (!condition() && !end.stop_requested()) {
        std::this_thread::sleep_for(std::chrono::milliseconds(20));
      }
    };
    until([&] { return recorded >= 5; });
    rig->reset();
    until([&] { return waiting.load(); });
    before = recorded;
    rig = SimulatedRig::start(options);
    until([&] { return recorded >= before + 5; });
    stop_.request_stop();
  });
  const auto result = recordJob(job, progress_, stop_.get_token(), [&](const RecorderState& state) {
    recorded = state.recorded;
    if (!state.waitingFor.empty()) waiting = true;
  });
  power.request_stop();
  power.join();
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_GE(result->figures["reconnections"], 1);
  EXPECT_GE(result->figures["recorded"], before + 5);
  const auto sketch = Sketch::open(job.sketch);
  ASSERT_TRUE(sketch) << sketch.error().message;
  EXPECT_EQ(result->figures["recorded"], sketch->frames().size());
}

}  // namespace
}  // namespace lightsketch
