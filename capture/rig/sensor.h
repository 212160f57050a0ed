// From light to counts: photon noise, read noise, gain, black level, saturation.
#pragma once

#include <cstdint>
#include <span>

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

// `signal`: light as a fraction of the full well, one value per sample. Writes each as the format's
// sample, little endian, to `bytes` (same number of samples). `noiseSeed` decides the noise.
void readOut(const Sensor& sensor, PixelFormat format, double gainDb, std::uint64_t noiseSeed,
             std::span<const float> signal, std::uint8_t* bytes);

}  // namespace lightsketch
