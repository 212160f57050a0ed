// What the source camera sees through its fisheye: a room with bright lights in it, the lamp with
// its glare and its mirror images, and the hand that holds it.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "capture/rig/fisheye_lens.h"
#include "capture/rig/gige_device.h"
#include "capture/rig/lamp_motion.h"
#include "capture/rig/play.h"
#include "capture/rig/room.h"
#include "capture/rig/sensor.h"
#include "capture/rig/still_life.h"

namespace lightsketch {

// Which of the two source cameras, and where it sits: beside the picture, a hand's breadth from the
// subject, tilted some degrees and a little twisted, because nobody mounts a camera exactly. The
// second is 0.3 m from the first.
struct SourceSeat {
  FisheyeLensShape lens;
  Eigen::Isometry3d sceneFromCamera;
};
SourceSeat firstSourceSeat();
SourceSeat secondSourceSeat();

// 960 x 960 mono. Everything that stands still is rendered once; a frame costs the lamp, its glare
// and reflections, the light it throws on the walls, the arm, and the noise. One thread calls
// expose(), guide() and render().
class SourceView final : public FrameSource {
 public:
  static constexpr int kSize = FisheyeLens::kSize;
  // Fraction of the full well that radiance 1 fills in one second: saturated at 0.4 in 1 ms.
  static constexpr double kSignalPerSecond = 2500;

  // `motion` and `play` must outlive the view. `onGuide` is told what the program shows the person.
  // No play: the lamp's program for ever.
  SourceView(std::shared_ptr<const StillLife> stillLife, const Room& room, LampMotion& motion,
             std::uint32_t seed, std::function<void(const Guide&)> onGuide = {},
             const Play* play = nullptr, const SourceSeat& seat = firstSourceSeat(),
             const SensorFlaws& flaws = {});
  ~SourceView() override;

  int sensorWidth() const override { return kSize; }
  int sensorHeight() const override { return kSize; }
  std::vector<PixelFormat> formats() const override {
    return {PixelFormat::kMono8, PixelFormat::kMono12};
  }
  void expose(const ExposureRequest& request, std::vector<std::uint8_t>& bytes) override;
  void guide(const Guide& guide) override;

  // Noise-free image-plane radiance of an exposure around `timeSeconds`, kSize x kSize, row by row.
  // Valid until the next call.
  const std::vector<float>& render(double timeSeconds, double exposureSeconds);

  // Where the camera sits. Thread-safe.
  const Eigen::Isometry3d& sceneFromCamera() const;
  const FisheyeLens& lens() const;
  const FlawedPixels& pixels() const;
  // Relative illumination through the lens, beside the sensor's flaws.
  double falloff(const Eigen::Vector2d& pixel) const;
  // Nothing is between the camera and the lamp, which is lit and inside the field. Thread-safe.
  bool seesLamp(const LampState& lamp, RigProgram program = RigProgram::kLamp) const;

 private:
  struct Tableau;
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace lightsketch
