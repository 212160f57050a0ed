#include "capture/rig/sensor.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <random>
#include <vector>

#include "capture/frame/vectorise.h"
#include "capture/rig/noise.h"

namespace lightsketch {
namespace {

static_assert(std::endian::native == std::endian::little);

// Gaussian deviates drawn once; every stretch of samples reads them from a place of its own, which
// is some thirty times faster than drawing afresh.
constexpr std::size_t kTableSize = 1 << 16;
constexpr std::size_t kStretch = 256;
const std::vector<float>& gaussianTable() {
  static const std::vector<float> table = [] {
    std::vector<float> values(kTableSize + kStretch);
    std::mt19937 random(20040811);
    std::normal_distribution<float> normal;
    for (auto& v : values) v = normal(random);
    return values;
  }();
  return table;
}

struct Conversion {
  float black, scale, top;  // counts
  float shot, read;         // variance = shot * signal + read, in fractions^2
};

LIGHTSKETCH_VECTORISED
void convert(const Conversion& c, const float* signal, const float* gaussian, std::size_t count,
             std::int32_t* counts) {
  for (std::size_t i = 0; i < count; ++i) {
    const float s = std::max(signal[i], 0.0f);
    const float noisy = s + std::sqrt(c.shot * s + c.read) * gaussian[i];
    counts[i] = static_cast<std::int32_t>(
        std::min(std::max(c.black + c.scale * noisy + 0.5f, 0.0f), c.top));
  }
}

}  // namespace

int blackLevelCounts(PixelFormat format) { return 1 << (pixelFormatInfo(format).bits - 6); }

double noiseVariance(const Sensor& sensor, PixelFormat format, double signal, double gainDb) {
  const double top = (1 << pixelFormatInfo(format).bits) - 1;
  const double countsPerElectron =
      std::pow(10, gainDb / 20) * (top - blackLevelCounts(format)) / sensor.fullWellElectrons;
  return countsPerElectron * countsPerElectron *
         (signal * sensor.fullWellElectrons +
          sensor.readNoiseElectrons * sensor.readNoiseElectrons);
}

void readOut(const Sensor& sensor, PixelFormat format, double gainDb, std::uint64_t noiseSeed,
             std::span<const float> signal, std::uint8_t* bytes) {
  const PixelFormatInfo& info = pixelFormatInfo(format);
  const int black = blackLevelCounts(format);
  const auto top = static_cast<float>((1 << info.bits) - 1);
  Conversion c;
  c.black = static_cast<float>(black);
  c.scale = static_cast<float>(std::pow(10, gainDb / 20)) * (top - c.black);
  c.top = top;
  c.shot = static_cast<float>(1 / sensor.fullWellElectrons);
  c.read = static_cast<float>(std::pow(sensor.readNoiseElectrons / sensor.fullWellElectrons, 2));

  const auto& table = gaussianTable();
  std::int32_t counts[kStretch];
  for (std::size_t start = 0; start < signal.size(); start += kStretch) {
    const std::size_t count = std::min(kStretch, signal.size() - start);
    const std::size_t place = hash64(noiseSeed + start) % kTableSize;
    convert(c, signal.data() + start, table.data() + place, count, counts);
    if (info.bits <= 8) {
      for (std::size_t i = 0; i < count; ++i)
        bytes[start + i] = static_cast<std::uint8_t>(counts[i]);
    } else {
      for (std::size_t i = 0; i < count; ++i) {
        const auto value = static_cast<std::uint16_t>(counts[i]);
        std::memcpy(bytes + 2 * (start + i), &value, 2);
      }
    }
  }
}

}  // namespace lightsketch
