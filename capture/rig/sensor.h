// From light to counts: photon noise, read noise, gain, black level, saturation.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "capture/frame/frame.h"
#include "capture/frame/pixel_format.h"

namespace lightsketch {

struct Sensor {
  double fullWellElectrons;  // what a saturated pixel holds at gain 0
  double readNoiseElectrons;
};
// A machine-vision sensor of good quality, and a plainer one behind the fisheye.
inline constexpr Sensor kSceneSensor{10500, 4};
inline constexpr Sensor kSourceSensor{8000, 14};

// The pedestal that darkness reads as: 4 counts of 255, 64 of 4095, 1024 of 65535.
int blackLevelCounts(PixelFormat format);

// Variance in counts^2 of a sample whose light alone would fill `signal` of the full well. Without
// the quantisation's 1/12.
double noiseVariance(const Sensor& sensor, PixelFormat format, double signal, double gainDb);

// What an 8-bit format's counts above black mean: proportional to light, or the sRGB curve of it.
enum class EightBitResponse { kLinear, kSrgb };
// Light as a fraction of the full well at gain 0, for counts of a format.
double signalOfCounts(EightBitResponse response, PixelFormat format, double counts);

// `signal`: light as a fraction of the full well, one value per sample. Writes each as the format's
// sample, little endian, to `bytes` (same number of samples). `noiseSeed` decides the noise.
void readOut(const Sensor& sensor, PixelFormat format, double gainDb, std::uint64_t noiseSeed,
             std::span<const float> signal, std::uint8_t* bytes,
             EightBitResponse response = EightBitResponse::kLinear);

// What is wrong with a camera; nothing by default.
struct SensorFlaws {
  double vignetting = 0;    // share of the light that is lost in the corners of the picture
  double prnu = 0;          // rms of the pixels' gains
  double fixedPattern = 0;  // rms of the pixels' offsets, as a share of the full well
  double darkCurrent = 0;   // full wells per second, in a pixel that is not hot
  int hotPixels = 0;        // they leak 0.3 to 30 full wells per second
  EightBitResponse eightBitResponse = EightBitResponse::kLinear;
};

// A sensor's pixels with their flaws. Immutable, so thread-safe.
class FlawedPixels {
 public:
  FlawedPixels(int width, int height, const SensorFlaws& flaws, std::uint64_t seed);

  // Light as the pixels of `region` collect it: `signal` has `channels` samples per pixel.
  void collect(const Region& region, int channels, double exposureSeconds,
               std::span<float> signal) const;
  const std::vector<Eigen::Vector2i>& hotPixels() const { return hot_; }
  // Of the lens, at a place in the picture: 1 in its middle.
  double falloff(const Eigen::Vector2d& pixel) const;
  EightBitResponse response() const { return flaws_.eightBitResponse; }

 private:
  SensorFlaws flaws_;
  int width_, height_;
  bool flawless_;
  std::vector<float> gain_, offset_, leak_;  // per pixel; empty if flawless
  std::vector<Eigen::Vector2i> hot_;
};

}  // namespace lightsketch
