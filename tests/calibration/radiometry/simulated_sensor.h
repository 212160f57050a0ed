// A sensor made of its physics alone, harsher than a good camera: photons, read noise, fixed
// pattern, hot pixels, vignetting, pedestal, response, rounding. Shares no code with what it tests.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <random>

#include "capture/frame/frame.h"

namespace lightsketch {

struct SimulatedSensor {
  PixelFormat format = PixelFormat::kRgb8;
  int width = 192;
  int height = 192;
  double fullWell = 15'000;  // electrons at saturation
  double readNoise = 8;      // electrons
  double pedestal = 0;       // counts
  double prnu = 0;           // relative scatter of the samples' sensitivity
  double hotShare = 0;       // of the pixels: their dark current fills a tenth to all of the well
  double vignetting = 0;     // loss in the corners
  // Light (1 fills the well) to signal (1 is full scale); none: linear.
  std::function<double(double)> response;

  using Scene = std::function<double(int x, int y, int colour)>;  // wells per second

  double sensitivity(int x, int y) const {
    const double u = (x + 0.5) / width - 0.5;
    const double v = (y + 0.5) / height - 0.5;
    return 1 - vignetting * (u * u + v * v) / 0.5;
  }
  bool hot(int x, int y) const { return fixedPattern(x, y, 77) < hotShare; }

  Frame expose(const Scene& scene, double seconds, unsigned seed) const {
    const PixelFormatInfo& info = pixelFormatInfo(format);
    const double top = (1 << info.bits) - 1;
    std::mt19937 random(seed);
    std::normal_distribution<double> normal;
    Frame frame;
    frame.format = format;
    frame.width = width;
    frame.height = height;
    frame.metadata.id = seed;
    frame.metadata.exposureSeconds = seconds;
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        for (int s = 0; s < info.channels; ++s) {
          const int colour = info.isBayer ? y % 2 + x % 2 : s;
          // Two uniform numbers make a triangle of sigma 0.41.
          const double pattern =
              (fixedPattern(x, y, 1 + s) + fixedPattern(x, y, 11 + s) - 1) / 0.41;
          double mean = scene(x, y, colour) * seconds * sensitivity(x, y) * (1 + prnu * pattern);
          if (hot(x, y)) mean += 0.1 + 0.9 * fixedPattern(x, y, 99);
          mean = std::clamp(mean, 0.0, 4.0) * fullWell;
          double electrons = readNoise * normal(random);
          if (mean > 0)
            electrons += static_cast<double>(std::poisson_distribution<long>(mean)(random));
          const double light = electrons / fullWell;
          const double signal = response ? response(std::clamp(light, 0.0, 1.0)) : light;
          const auto count = static_cast<int>(
              std::clamp(std::round(pedestal + (top - pedestal) * signal), 0.0, top));
          frame.bytes.push_back(static_cast<std::uint8_t>(count & 255));
          if (info.bits > 8) frame.bytes.push_back(static_cast<std::uint8_t>(count >> 8));
        }
      }
    }
    return frame;
  }

  // A number in 0..1 that belongs to the place.
  static double fixedPattern(int x, int y, int which) {
    std::uint32_t h = static_cast<std::uint32_t>(x) * 73856093u ^
                      static_cast<std::uint32_t>(y) * 19349663u ^
                      static_cast<std::uint32_t>(which) * 83492791u;
    h = (h ^ (h >> 16)) * 0x45d9f3bu;
    h = (h ^ (h >> 16)) * 0x45d9f3bu;
    return static_cast<double>(h ^ (h >> 16)) / 4294967296.0;
  }
};

// IEC 61966-2-1 in double, both ways.
inline double srgbSignal(double light) {
  return light <= 0.0031308 ? 12.92 * light : 1.055 * std::pow(light, 1 / 2.4) - 0.055;
}
inline double srgbLight(double signal) {
  return signal <= 0.04045 ? signal / 12.92 : std::pow((signal + 0.055) / 1.055, 2.4);
}

// Four decades from left to right with soft waves: wells per second, brightest 10.
inline double fourDecades(const SimulatedSensor& sensor, int x, int y) {
  return std::pow(10.0, -3.0 + 4.0 * x / (sensor.width - 1)) * (0.7 + 0.3 * std::sin(0.05 * y));
}

}  // namespace lightsketch
