// Light that changes every frame: what a turn of an environment map, a frame of the room's camera
// and a lamp cost on one core, for the paper's 4096 lights, beside reading the same data once.

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <limits>
#include <numbers>
#include <numeric>
#include <random>
#include <string>

#include "pipeline/illumination/fisheye_light.h"
#include "pipeline/illumination/light_grid.h"
#include "pipeline/illumination/soft_lamps.h"
#include "pipeline/illumination/turnable_environment.h"

namespace {

using namespace lightsketch;
using Eigen::Vector3d;
using Clock = std::chrono::steady_clock;

template <class Function>
double bestMilliseconds(const Function& function) {
  double best = std::numeric_limits<double>::infinity();
  const auto start = Clock::now();
  while (Clock::now() - start < std::chrono::milliseconds(600)) {
    const auto before = Clock::now();
    function();
    best = std::min(best, std::chrono::duration<double, std::milli>(Clock::now() - before).count());
  }
  return best;
}

void row(const char* what, double measured, double bar, const char* limitName, double limit) {
  std::printf("%-52s %9.3f ms  bar %5.1f  %-24s %9.3f  ratio %6.2f\n", what, measured, bar,
              limitName, limit, measured / limit);
}

}  // namespace

int main() {
  const auto grid = LightGrid::create(4096);
  const auto& lights = grid->directions();
  std::mt19937 random(7);
  LightIntensities out;
  double sink = 0;

  RadianceImage map(1024, 512, 3);
  std::lognormal_distribution<float> radiance(0, 1);
  for (float& value : map.values()) value = radiance(random);
  auto before = Clock::now();
  const auto environment = TurnableEnvironment::create(map, lights);
  const double prepared = std::chrono::duration<double>(Clock::now() - before).count();
  double yaw = 0;
  const double turn = bestMilliseconds([&] { environment->intensities(yaw += 1.7, out); });
  const double readMap =
      bestMilliseconds([&] { sink += std::accumulate(map.data(), map.data() + map.size(), 0.0f); });
  before = Clock::now();
  const auto whole = intensitiesOf(map, lights);
  const double integrated =
      std::chrono::duration<double, std::milli>(Clock::now() - before).count();
  row("environment 1024 x 512 turned, 4096 lights", turn, 3, "adding the map's floats", readMap);
  row("  against integrating it anew", turn, 3, "intensitiesOf", integrated);
  std::printf("%-52s %9.3f s\n", "  prepared in", prepared);

  FisheyeParameters parameters;
  parameters.width = parameters.height = 960;
  parameters.fx = parameters.fy = 480 / Angle::degrees(95).radians();
  parameters.cx = parameters.cy = 480;
  parameters.maxFieldAngle = Angle::degrees(95);
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.linear() = Vector3d(-1, -1, 1).asDiagonal();
  for (const auto format : {PixelFormat::kMono8, PixelFormat::kMono12, PixelFormat::kBayerRG8}) {
    Frame frame;
    frame.format = format;
    frame.width = frame.height = 960;
    frame.bytes.resize(static_cast<std::size_t>(960 * 960 * pixelFormatInfo(format).bytesPerPixel));
    for (auto& byte : frame.bytes) byte = static_cast<std::uint8_t>(random() & 15);
    before = Clock::now();
    const auto room = FisheyeLight::create(**FisheyeModel::create(parameters), pose, lights);
    const double ready = std::chrono::duration<double>(Clock::now() - before).count();
    const double lit = bestMilliseconds([&] { (void)room->intensities(frame, 1, out); });
    const double readFrame = bestMilliseconds(
        [&] { sink += std::accumulate(frame.bytes.begin(), frame.bytes.end(), 0u); });
    const std::string name =
        fmt::format("room camera 960 x 960 {}, 4096 lights", pixelFormatInfo(format).name);
    row(name.c_str(), lit, 4, "adding the frame's bytes", readFrame);
    std::printf("%-52s %9.3f s\n", "  prepared in", ready);
  }

  const auto interpolator = DirectionInterpolator::create(lights, {});
  const auto lamps = SoftLamps::create(lights, *interpolator);
  LightIntensities sum = LightIntensities::Zero(4096, 3);
  const double point = bestMilliseconds([&] {
    sink += interpolator->weights(Vector3d(0.6, std::sin(yaw += 0.1), 1).normalized())[0];
  });
  for (const double radius : {0.0, 2.2, 10.0, 40.0}) {
    const double soft = bestMilliseconds([&] {
      yaw += 0.1;
      lamps->add(
          {Vector3d(0.6, std::sin(yaw), 1).normalized(), Vector3d::Ones(), Angle::degrees(radius)},
          sum);
    });
    const std::string name = fmt::format("lamp of {:g} degrees radius, 4096 lights", radius);
    row(name.c_str(), soft, 1, "a point lamp's weights", point);
  }
  return sink == 0.12345 ? 1 : 0;
}
