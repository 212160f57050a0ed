// The whole rig: two cameras that a program opens like any others, and the truth beside them.
#include "capture/rig/simulated_rig.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <mutex>
#include <thread>

#include "capture/device/camera.h"

namespace lightsketch {
namespace {

using Eigen::Vector3d;
using namespace std::chrono_literals;

SimulatedRigOptions optionsAt(const char* scene, const char* source) {
  SimulatedRigOptions options;
  options.sceneAddress = scene;
  options.sourceAddress = source;
  return options;
}

// The first `count` frames of a camera, within half a minute.
std::vector<Frame> collect(Camera& camera, std::size_t count) {
  std::mutex mutex;
  std::vector<Frame> frames;  // guarded by mutex
  EXPECT_TRUE(camera.start([&](Frame&& frame) {
    const std::lock_guard lock(mutex);
    frames.push_back(std::move(frame));
  }));
  for (int i = 0; i < 600; ++i) {
    std::this_thread::sleep_for(50ms);
    const std::lock_guard lock(mutex);
    if (frames.size() >= count) break;
  }
  camera.stop();
  return frames;
}

TEST(SimulatedRig, StreamsTheLampWhereTheTruthSaysIt) {
  const auto rig = SimulatedRig::start(optionsAt("127.0.77.11", "127.0.77.12"));
  ASSERT_TRUE(rig) << rig.error().message;
  auto camera = openCamera("aravis:127.0.77.12");
  ASSERT_TRUE(camera) << camera.error().message;
  CameraSettings settings;
  settings.exposureSeconds = 0.001;
  ASSERT_TRUE((*camera)->configure(settings));
  // Longer than the hand ever covers the lamp or stays away: some 4 s.
  const auto frames = collect(**camera, 45);
  ASSERT_GE(frames.size(), 45u);

  const auto model = (*rig)->calibratedSourceModel();
  int checked = 0;
  for (const Frame& frame : frames) {
    ASSERT_EQ(frame.width, 960);
    ASSERT_EQ(frame.format, PixelFormat::kMono8);
    const double t = toSeconds(frame.metadata.midExposure - (*rig)->startTime());
    const LampTruth truth = (*rig)->truthAt(t);
    if (!truth.visibleToSource) continue;
    const auto pixel = model->project(truth.directionInSource);
    ASSERT_TRUE(pixel);
    // Time is mapped from a clock that is 58 minutes off; were that wrong by 50 ms, a lamp at 30
    // degrees a second would be 8 px off, more than its radius.
    EXPECT_EQ(frame.sample(static_cast<int>(pixel->x()), static_cast<int>(pixel->y())), 255u);
    ++checked;
  }
  EXPECT_GT(checked, 3);
  EXPECT_GE((*rig)->framesSent(), 45u);
}

TEST(SimulatedRig, TruthAndGeometryAgree) {
  const auto rig = SimulatedRig::start(optionsAt("127.0.77.21", "127.0.77.22"));
  ASSERT_TRUE(rig) << rig.error().message;
  const RigGeometry geometry = (*rig)->geometry();
  ASSERT_EQ(geometry.sourceCameras.size(), 1u);
  EXPECT_EQ(geometry.sceneCamera.camera, "127.0.77.21");
  EXPECT_EQ(geometry.sourceCameras[0].camera, "127.0.77.22");
  const LampTruth truth = (*rig)->truthAt(0);
  const Vector3d expected =
      (geometry.sourceCameras[0].sceneFromCamera.inverse() * truth.lampInScene).normalized();
  EXPECT_LT((truth.directionInSource - expected).norm(), 1e-12);
  EXPECT_NEAR(truth.lampInScene.norm(), *geometry.lampRadiusMetres, 0.08);
  // The scene camera looks down at the subject from the viewer's side.
  const Eigen::Isometry3d& pose = geometry.sceneCamera.sceneFromCamera;
  EXPECT_GT(pose.translation().z(), 0.3);
  EXPECT_LT(pose.linear().col(2).z(), -0.7);
  EXPECT_LT(pose.linear().col(1).y(), 0);  // the picture's y runs down
}

TEST(SimulatedRig, LoopOfPrerenderedFramesRepeatsExactly) {
  SimulatedRigOptions options = optionsAt("127.0.77.31", "127.0.77.32");
  options.prerenderedFrames = 4;
  options.framesPerSecond = 20;
  const auto rig = SimulatedRig::start(options);
  ASSERT_TRUE(rig) << rig.error().message;
  auto camera = openCamera("aravis:127.0.77.31");
  ASSERT_TRUE(camera) << camera.error().message;
  const auto frames = collect(**camera, 16);
  ASSERT_GE(frames.size(), 16u);
  // Noise is baked in, so only the loop can make two frames equal; and it has four different ones.
  std::vector<std::vector<std::uint8_t>> different;
  for (const Frame& frame : frames) {
    if (std::find(different.begin(), different.end(), frame.bytes) == different.end()) {
      different.push_back(frame.bytes);
    }
  }
  EXPECT_LE(different.size(), 4u);
  EXPECT_GE(different.size(), 2u);
}

TEST(SimulatedRig, RefusesNonsense) {
  SimulatedRigOptions options;
  options.framesPerSecond = 0;
  const auto rig = SimulatedRig::start(options);
  ASSERT_FALSE(rig);
  EXPECT_EQ(rig.error().code, ErrorCode::kInvalidArgument);
  options = {};
  options.scene = "no_such_scene.json";
  const auto missing = SimulatedRig::start(options);
  ASSERT_FALSE(missing);
  EXPECT_NE(missing.error().message.find("no_such_scene.json"), std::string::npos);
}

TEST(SimulatedRig, BlackLevelsAreThoseOfTheFormats) {
  EXPECT_EQ(sceneBlackLevelCounts(PixelFormat::kBayerRG12), 64);
  EXPECT_EQ(sceneBlackLevelCounts(PixelFormat::kBayerRG16), 1024);
  EXPECT_EQ(sceneBlackLevelCounts(PixelFormat::kRgb8), 4);
}

}  // namespace
}  // namespace lightsketch
