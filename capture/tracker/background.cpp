#include "capture/tracker/background.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>

namespace lightsketch {
namespace {

constexpr std::size_t kLearningFrames = 16;
constexpr int kAdaptInterleave = 8;
constexpr int kAdaptDown = 16;
constexpr int kAdaptUp = 2;

}  // namespace

Result<Image<std::uint16_t>> normalisedCounts(const Frame& frame, double blackLevel) {
  const PixelFormatInfo& info = pixelFormatInfo(frame.format);
  if (info.isBayer || info.channels != 1) {
    return failure(ErrorCode::kUnsupported,
                   "source frame {}: {} is a colour format; set the source camera to Mono8 or "
                   "Mono12",
                   frame.metadata.id, info.name);
  }
  Image<std::uint16_t> counts(frame.width, frame.height, 1);
  if (frame.bytes.size() != counts.size() * static_cast<std::size_t>(info.bytesPerPixel)) {
    return failure(ErrorCode::kCorrupt, "source frame {}: {} bytes for {} x {} {}",
                   frame.metadata.id, frame.bytes.size(), frame.width, frame.height, info.name);
  }
  const double maximum = (1 << info.bits) - 1;
  const auto black = static_cast<float>(std::clamp(blackLevel, 0.0, maximum / 2));
  const float scale = static_cast<float>(kFullScale) / (static_cast<float>(maximum) - black);
  const std::uint8_t* in = frame.bytes.data();
  std::uint16_t* out = counts.data();
  const auto convert = [&](int sample) {
    return static_cast<std::uint16_t>(
        static_cast<int>(std::max(0.0f, (static_cast<float>(sample) - black) * scale + 0.5f)));
  };
  if (info.bits <= 8) {
    for (std::size_t i = 0; i < counts.size(); ++i) out[i] = convert(in[i]);
  } else {
    for (std::size_t i = 0; i < counts.size(); ++i) {
      out[i] = convert(in[2 * i] | (in[2 * i + 1] << 8));
    }
  }
  return counts;
}

void Background::learn(Image<std::uint16_t> counts) {
  if (ready()) {  // told to learn anew
    level_ = {};
    frames_.clear();
  }
  frames_.push_back(std::move(counts));
  if (frames_.size() > kLearningFrames) frames_.pop_front();
}

void Background::finish() {
  const std::size_t n = frames_.size();
  const Image<std::uint16_t>& first = frames_.front();
  level_ = Image<std::uint16_t>(first.width(), first.height(), 1);
  flicker_ = Image<std::uint8_t>(first.width(), first.height(), 1);

  // Noise from the differences of successive frames: the mean absolute difference of Gaussian noise
  // is 2 sigma / sqrt(pi). Large ones are moving lights, not noise.
  double sum = 0, count = 0;
  for (std::size_t f = 1; f < n; ++f) {
    for (std::size_t i = f; i < first.size(); i += 31) {
      const int difference = std::abs(int{frames_[f].data()[i]} - int{frames_[f - 1].data()[i]});
      if (difference > kFullScale / 16) continue;
      sum += difference;
      count += 1;
    }
  }
  const double quantisation = kFullScale / 255.0 / std::sqrt(12.0);
  noise_ = std::max(quantisation, count > 0 ? sum / count * std::sqrt(M_PI) / 2 : 0.0);

  // The mean of the samples near the lower third of each pixel's samples.
  const int near = static_cast<int>(std::lround(5 * noise_)) + kFullScale / 64;
  constexpr int kFlicker = kFullScale / 4;
  std::array<std::uint16_t, kLearningFrames> samples{};
  for (std::size_t i = 0; i < first.size(); ++i) {
    for (std::size_t f = 0; f < n; ++f) samples[f] = frames_[f].data()[i];
    const auto [low, high] = std::minmax_element(samples.begin(), samples.begin() + n);
    int reference = *low;
    if (*high - *low > near) {
      auto sorted = samples;
      std::nth_element(sorted.begin(), sorted.begin() + n / 3, sorted.begin() + n);
      reference = sorted[n / 3];
      // A lamp passes a pixel once; what rises there again and again is a light of the room.
      int rises = 0;
      for (std::size_t f = 1; f < n; ++f) rises += samples[f] - samples[f - 1] > kFlicker ? 1 : 0;
      flicker_.data()[i] = rises >= 2 ? 1 : 0;
    }
    int total = 0, used = 0;
    for (std::size_t f = 0; f < n; ++f) {
      if (std::abs(samples[f] - reference) > near) continue;
      total += samples[f];
      ++used;
    }
    level_.data()[i] = static_cast<std::uint16_t>(total / used);
  }
  frames_.clear();
}

void Background::adapt(const Image<std::uint16_t>& counts, const std::vector<Region>& except) {
  for (int y = phase_; y < counts.height(); y += kAdaptInterleave) {
    std::uint16_t* level = level_.row(y).data();
    const std::uint16_t* now = counts.row(y).data();
    const auto advance = [&](int from, int to) {
      for (int x = from; x < to; ++x) {
        const int step = std::clamp((now[x] - level[x]) / 4, -kAdaptDown, kAdaptUp);
        level[x] = static_cast<std::uint16_t>(level[x] + step);
      }
    };
    // Spare the rows' parts inside the regions, which may overlap.
    std::vector<std::pair<int, int>> spared;
    for (const Region& r : except) {
      if (y >= r.y && y < r.y + r.height) spared.emplace_back(r.x, r.x + r.width);
    }
    std::sort(spared.begin(), spared.end());
    int x = 0;
    for (const auto& [from, to] : spared) {
      advance(x, std::max(x, from));
      x = std::max(x, to);
    }
    advance(x, counts.width());
  }
  phase_ = (phase_ + 1) % kAdaptInterleave;
}

}  // namespace lightsketch
