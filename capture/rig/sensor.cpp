#include "capture/rig/sensor.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstring>
#include <random>
#include <vector>

#include "capture/frame/srgb.h"
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

// The same through the sRGB curve, from a table fine enough for its steep foot.
void convertSrgb(const Conversion& c, const float* signal, const float* gaussian, std::size_t count,
                 std::int32_t* counts) {
  constexpr int kSteps = 1 << 15;
  static const std::vector<float> curve = [] {
    std::vector<float> values(kSteps + 1);
    for (int i = 0; i <= kSteps; ++i) {
      values[static_cast<std::size_t>(i)] = srgbEncode(static_cast<float>(i) / kSteps);
    }
    return values;
  }();
  const float range = c.top - c.black, gain = c.scale / range;
  for (std::size_t i = 0; i < count; ++i) {
    const float s = std::max(signal[i], 0.0f);
    const float noisy = std::min(gain * (s + std::sqrt(c.shot * s + c.read) * gaussian[i]), 1.0f);
    const float encoded = noisy <= 0 ? srgbEncode(std::max(noisy, -0.01f))
                                     : curve[static_cast<std::size_t>(noisy * kSteps + 0.5f)];
    counts[i] = static_cast<std::int32_t>(std::max(c.black + range * encoded + 0.5f, 0.0f));
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

double signalOfCounts(EightBitResponse response, PixelFormat format, double counts) {
  const int bits = pixelFormatInfo(format).bits;
  const double black = blackLevelCounts(format), top = (1 << bits) - 1;
  const double share = (counts - black) / (top - black);
  if (bits > 8 || response == EightBitResponse::kLinear) return share;
  return srgbDecode(static_cast<float>(share));
}

void readOut(const Sensor& sensor, PixelFormat format, double gainDb, std::uint64_t noiseSeed,
             std::span<const float> signal, std::uint8_t* bytes, EightBitResponse response) {
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
    const bool srgb = info.bits <= 8 && response == EightBitResponse::kSrgb;
    (srgb ? convertSrgb : convert)(c, signal.data() + start, table.data() + place, count, counts);
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

FlawedPixels::FlawedPixels(int width, int height, const SensorFlaws& flaws, std::uint64_t seed)
    : flaws_(flaws),
      width_(width),
      height_(height),
      flawless_(flaws.vignetting == 0 && flaws.prnu == 0 && flaws.fixedPattern == 0 &&
                flaws.darkCurrent == 0 && flaws.hotPixels == 0) {
  if (flawless_) return;
  const auto count = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  std::mt19937_64 random(hash64(seed));
  std::normal_distribution<double> normal;
  gain_.resize(count);
  offset_.resize(count);
  leak_.assign(count, static_cast<float>(flaws.darkCurrent));
  for (std::size_t i = 0; i < count; ++i) {
    const double x = static_cast<double>(i % static_cast<std::size_t>(width)) + 0.5;
    const double y = static_cast<double>(i / static_cast<std::size_t>(width)) + 0.5;
    gain_[i] = static_cast<float>(falloff({x, y}) * (1 + flaws.prnu * normal(random)));
    offset_[i] = static_cast<float>(flaws.fixedPattern * normal(random));
  }
  std::uniform_int_distribution<int> column(0, width - 1), row(0, height - 1);
  std::uniform_real_distribution<double> decade(std::log(0.3), std::log(30.0));
  for (int i = 0; i < flaws.hotPixels; ++i) {
    hot_.emplace_back(column(random), row(random));
    leak_[static_cast<std::size_t>(hot_.back().y() * width + hot_.back().x())] =
        static_cast<float>(std::exp(decade(random)));
  }
}

double FlawedPixels::falloff(const Eigen::Vector2d& pixel) const {
  const Eigen::Vector2d centre(0.5 * width_, 0.5 * height_);
  const double r2 = (pixel - centre).squaredNorm() / centre.squaredNorm();
  return 1 - flaws_.vignetting * (0.7 * r2 + 0.3 * r2 * r2);
}

void FlawedPixels::collect(const Region& region, int channels, double exposureSeconds,
                           std::span<float> signal) const {
  if (flawless_) return;
  std::size_t sample = 0;
  for (int y = region.y; y < region.y + region.height; ++y) {
    for (int x = region.x; x < region.x + region.width; ++x) {
      const auto i = static_cast<std::size_t>(y * width_ + x);
      const float more = offset_[i] + leak_[i] * static_cast<float>(exposureSeconds);
      for (int c = 0; c < channels; ++c, ++sample) {
        signal[sample] = gain_[i] * signal[sample] + more;
      }
    }
  }
}

}  // namespace lightsketch
