// The response of the simulated rig's own 8-bit camera, sRGB-like, with vignetting and hot pixels,
// bracketed live through the job and compared with what the rig really does.
#include <fmt/format.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <vector>

#include "calibration/radiometry/response_file.h"
#include "capture/rig/simulated_rig.h"
#include "pipeline/job/calibrate_jobs.h"

using namespace lightsketch;
namespace fs = std::filesystem;

namespace {

template <class T>
T orStop(Result<T> result, const char* what) {
  if (result) return std::move(*result);
  fmt::print(stderr, "response: {}: {}\n", what, result.error().message);
  std::exit(1);
}

}  // namespace

int main() {
  const fs::path out = fs::temp_directory_path() / "lightsketch-bench-response";
  fs::remove_all(out);
  fs::create_directories(out);
  SimulatedRigOptions options;
  options.program = RigProgram::kStill;
  options.sceneFlaws.eightBitResponse = EightBitResponse::kSrgb;
  options.sceneFlaws.vignetting = 0.3;
  options.sceneFlaws.hotPixels = 200;
  const auto rig = orStop(SimulatedRig::start(options), "rig");

  ResponseJob job;
  job.camera = "aravis:" + options.sceneAddress;
  job.format = PixelFormat::kRgb8;
  job.shortestSeconds = 0.002;
  job.longestSeconds = 1.0;
  job.takeDark = true;
  job.takeDiffuser = true;
  job.out = out / "scene.json";
  job.report = out / "report";
  SilentProgress progress;
  fmt::print("{}\n", orStop(responseJob(job, progress, {}), "calibrate").text);
  const SensorModel sensor = orStop(loadResponse(job.out), "load");

  // Relative error of the exposure per colour, the common factor taken off.
  for (int colour = 0; colour < sensor.response.colours(); ++colour) {
    std::vector<double> logs;
    for (int count = 20; count <= 235; ++count) {
      logs.push_back(std::log(sensor.response.exposure(count, colour) /
                              rig->trueSceneSignal(PixelFormat::kRgb8, count)));
    }
    double mean = 0, squares = 0;
    for (const double value : logs) mean += value / static_cast<double>(logs.size());
    for (const double value : logs) squares += (value - mean) * (value - mean);
    fmt::print("colour {}: {:.2f} percent rms over counts 20 to 235 (bar 0.5)\n", colour,
               100 * std::sqrt(squares / static_cast<double>(logs.size())));
  }

  int found = 0;
  const auto hot = rig->sceneHotPixels();
  for (const auto& pixel : hot) {
    for (const PixelPosition& mine : sensor.hotPixels) {
      found += mine.x == pixel.x() && mine.y == pixel.y() ? 1 : 0;
    }
  }
  fmt::print("hot pixels: {} of {} found, {} listed\n", found, hot.size(), sensor.hotPixels.size());

  if (sensor.flatField) {
    double worst = 0;
    const double centre =
        sensor.flatField->sensitivity(0.5, 0.5, 1) / rig->sceneFalloff({320, 240});
    for (double y = 20; y < 480; y += 40) {
      for (double x = 20; x < 640; x += 40) {
        const double mine = sensor.flatField->sensitivity(x / 640, y / 480, 1) / centre;
        worst = std::max(worst, std::abs(mine / rig->sceneFalloff({x, y}) - 1));
      }
    }
    fmt::print("vignetting: largest difference {:.2f} percent\n", 100 * worst);
  }
  fs::remove_all(out);
}
