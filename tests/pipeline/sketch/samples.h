// Small images and sketches with known content.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "capture/frame/progress.h"
#include "pipeline/sketch/sketch.h"

namespace lightsketch {

// Values that half floats hold exactly and that tell frames, pixels and channels apart.
inline RadianceImage sampleImage(int width, int height, int seed) {
  RadianceImage image(width, height, 3);
  unsigned state = 12345u + static_cast<unsigned>(seed) * 7919u;
  for (float& value : image.values()) {
    state = state * 1664525u + 1013904223u;
    value = static_cast<float>(state >> 22) / 1024.0f;
  }
  return image;
}

// Not inlined: what a compiler computes beforehand may differ in the last bit.
[[gnu::noinline]] inline Eigen::Vector3d sampleDirection(int i) {
  const double z = 0.05 + 0.9 * std::fmod(0.618 * i, 1.0);
  const double r = std::sqrt(1 - z * z);
  return {r * std::cos(2.4 * i), r * std::sin(2.4 * i), z};
}

inline FrameRecord sampleRecord(int i) {
  FrameRecord record;
  record.light.direction = sampleDirection(i);
  record.exposureSeconds = 0.02;
  return record;
}

inline SketchManifest sampleManifest(int width, int height) {
  SketchManifest manifest;
  manifest.width = width;
  manifest.height = height;
  manifest.directions = 300;
  manifest.software = "test 1";
  manifest.cameras = {{{"role", "scene"}, {"model", "none"}}};
  return manifest;
}

inline bool sameValues(const RadianceImage& a, const RadianceImage& b) {
  return a.sameShape(b) && std::equal(a.values().begin(), a.values().end(), b.values().begin());
}

// Keeps the warnings; asks to stop after so many updates.
class RecordingProgress final : public Progress {
 public:
  explicit RecordingProgress(int cancelAfter = -1) : cancelAfter_(cancelAfter) {}
  void update(std::string_view, std::size_t, std::size_t) override { ++updates_; }
  void warn(std::string_view message) override { warnings.emplace_back(message); }
  bool cancelled() const override { return cancelAfter_ >= 0 && updates_ >= cancelAfter_; }

  std::vector<std::string> warnings;

 private:
  int cancelAfter_;
  int updates_ = 0;
};

}  // namespace lightsketch
