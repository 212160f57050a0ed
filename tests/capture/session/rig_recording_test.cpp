// The true loop: two simulated cameras over GVSP, the tracker, the recorder and its guide. Truth
// comes by the rig's side channel.
//
// LIGHTSKETCH_RIG_SECONDS and LIGHTSKETCH_RIG_SEED make the same into a measurement.
#include <gtest/gtest.h>
#include <unistd.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <string>
#include <vector>

#include "capture/rig/simulated_rig.h"
#include "capture/session/recorder.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

double degreesBetween(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return Angle::radians(std::atan2(a.cross(b).norm(), a.dot(b))).degrees();
}

double percentile(std::vector<double> values, double p) {
  std::sort(values.begin(), values.end());
  return values.empty()
             ? 1e9
             : values[static_cast<std::size_t>(p * static_cast<double>(values.size() - 1))];
}

double setting(const char* name, double otherwise) {
  const char* text = std::getenv(name);
  return text == nullptr ? otherwise : std::atof(text);
}

void print(const char* what, const std::vector<double>& errors) {
  std::printf("%s: n %zu, median %.3f, p95 %.3f, max %.3f deg\n", what, errors.size(),
              percentile(errors, 0.5), percentile(errors, 0.95), percentile(errors, 1));
}

TEST(RigRecording, DirectionsAreTrueAndNoReflectionIsEverAccepted) {
  SimulatedRigOptions rigOptions;
  rigOptions.sceneAddress = "127.0.3.11";
  rigOptions.sourceAddress = "127.0.3.12";
  rigOptions.seed = static_cast<std::uint32_t>(setting("LIGHTSKETCH_RIG_SEED", 1));
  const auto rig = SimulatedRig::start(rigOptions);
  ASSERT_TRUE(rig) << rig.error().message;
  const auto scene = openCamera("aravis:" + rigOptions.sceneAddress);
  ASSERT_TRUE(scene) << scene.error().message;
  const auto source = openCamera("aravis:" + rigOptions.sourceAddress);
  ASSERT_TRUE(source) << source.error().message;

  const fs::path folder =
      fs::temp_directory_path() / fmt::format("lightsketch-rig-recording-{}", ::getpid());
  fs::remove_all(folder);
  RecorderOptions options;
  options.timeLimitSeconds = setting("LIGHTSKETCH_RIG_SECONDS", 25);
  options.sceneBlackLevel = sceneBlackLevelCounts(options.sceneFormat);
  std::vector<double> tracked;
  int hiddenButSeen = 0;
  std::map<std::string, int> troubles;
  TimePoint last{};
  SilentProgress progress;
  const auto summary = record(
      **scene, std::array{SourceCamera{**source, (*rig)->calibratedSourceModel()}},
      (*rig)->geometry(), folder, options, progress, {}, [&](const RecorderState& state) {
        if (!state.lampTrouble.empty()) ++troubles[state.lampTrouble];
        if (!state.lamp || state.lamp->time == last) return;
        last = state.lamp->time;
        const double t = toSeconds(last - (*rig)->startTime());
        const LampTruth truth = (*rig)->truthAt(t);
        const double error = degreesBetween(state.lamp->directionInSource, truth.directionInSource);
        tracked.push_back(error);
        if (!truth.lit || (!truth.visibleToSource && error > 1)) ++hiddenButSeen;
        if (error > 0.5) {
          std::printf("  at %.2f s: %.2f deg, pixel %.0f %.0f, flux %.1f, confidence %.2f, %s\n", t,
                      error, state.lamp->pixel.x(), state.lamp->pixel.y(), state.lamp->flux,
                      state.lamp->confidence, truth.visibleToSource ? "visible" : "hidden");
        }
      });
  ASSERT_TRUE(summary) << summary.error().message;
  std::printf("%s", summary->describe().c_str());

  const auto sketch = Sketch::open(folder);
  ASSERT_TRUE(sketch) << sketch.error().message;
  std::vector<double> recorded, atSubject, late;
  for (const FrameRecord& frame : sketch->frames()) {
    const TimePoint time = summary->timeZero + fromSeconds(frame.midExposureSeconds);
    const LampTruth truth = (*rig)->truthAt(toSeconds(time - (*rig)->startTime()));
    const auto direction = (*rig)->calibratedSourceModel()->unproject(frame.lampPixels.at(0).pixel);
    ASSERT_TRUE(direction);
    recorded.push_back(degreesBetween(*direction, truth.directionInSource));
    // Along the lamp's path: how much of the error is a matter of time.
    const double t = toSeconds(time - (*rig)->startTime());
    const Eigen::Vector3d speed = ((*rig)->truthAt(t + 0.01).directionInSource -
                                   (*rig)->truthAt(t - 0.01).directionInSource) /
                                  0.02;
    late.push_back((*direction - truth.directionInSource).dot(speed) / speed.squaredNorm());
    atSubject.push_back(degreesBetween(frame.light.direction, truth.lampInScene));
  }
  fs::remove_all(folder);
  print("tracked, at the source camera", tracked);
  print("recorded frames, at the source camera", recorded);
  print("recorded frames, at the subject", atSubject);
  std::printf("time of the recorded directions: median %.1f ms late\n",
              1e3 * percentile(late, 0.5));
  for (const auto& [reason, count] : troubles) {
    std::printf("lamp not tracked: %s: %d\n", reason.c_str(), count);
  }
  std::printf("directions a second: %.2f\n", summary->recorded / summary->seconds);

  ASSERT_GT(tracked.size(), 50u);
  EXPECT_GT(summary->recorded, 20);
  EXPECT_LE(percentile(tracked, 0.5), 0.15);
  EXPECT_LE(percentile(tracked, 0.95), 0.5);
  // Between source frames: the hand trembles by 0.11 degrees rms per axis at 9.5 Hz, which 12
  // frames a second cannot follow, and turns at up to 450 degrees a second squared.
  EXPECT_LE(percentile(recorded, 0.5), 0.25);
  EXPECT_LE(percentile(recorded, 0.95), 0.6);
  // A reflection or a light of the room is many degrees away; the lamp's own disc is two wide.
  EXPECT_LT(percentile(tracked, 1), 1.5);
  EXPECT_LT(percentile(recorded, 1), 3);
  EXPECT_EQ(hiddenButSeen, 0);
}

}  // namespace
}  // namespace lightsketch
