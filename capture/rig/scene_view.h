// What the scene camera sees: the still life, traced with the lamp where the hand holds it, or what
// another program puts in its place.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "capture/frame/image.h"
#include "capture/rig/gige_device.h"
#include "capture/rig/lamp_motion.h"
#include "capture/rig/play.h"
#include "capture/rig/room.h"
#include "capture/rig/sensor.h"
#include "capture/rig/still_life.h"

namespace lightsketch {

// 640 x 480 pixels. The view never changes, so first hits, materials and ambient light are computed
// once; a frame costs the shadow rays and the shading. One thread calls expose() and render().
class SceneView final : public FrameSource {
 public:
  static constexpr int kWidth = 640;
  static constexpr int kHeight = 480;
  // Fraction of the full well that radiance 1 fills in one second: 0.65 in 0.02 s.
  static constexpr double kSignalPerSecond = 32.5;

  // `motion` and `play` must outlive the view. No play: the lamp's program for ever. What stands on
  // the table is prepared when it is first shown, the first program's at once.
  SceneView(std::shared_ptr<const StillLife> stillLife, const Room& room, LampMotion& motion,
            std::uint32_t seed, const Play* play = nullptr, const SensorFlaws& flaws = {});
  ~SceneView() override;

  int sensorWidth() const override { return kWidth; }
  int sensorHeight() const override { return kHeight; }
  std::vector<PixelFormat> formats() const override {
    return {PixelFormat::kBayerRG12, PixelFormat::kBayerRG16, PixelFormat::kRgb8};
  }
  // RGB8 is linear too, unless its response is said to be another: three counts to a pixel.
  void expose(const ExposureRequest& request, std::vector<std::uint8_t>& bytes) override;

  // Noise-free radiance (1: a white matte surface facing the lamp at 0.9 m), for an exposure of
  // `exposureSeconds` around `timeSeconds`. Valid until the next call.
  const RadianceImage& render(double timeSeconds, double exposureSeconds);

  // Of the picture, a pinhole's.
  double focalLengthPixels() const;
  const FlawedPixels& pixels() const;

 private:
  struct Tableau;
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace lightsketch
