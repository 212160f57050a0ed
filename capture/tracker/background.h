// What the source camera sees without the lamp.
#pragma once

#include <cstdint>
#include <deque>
#include <vector>

#include "capture/frame/frame.h"
#include "capture/frame/image.h"
#include "capture/frame/result.h"

namespace lightsketch {

// Counts of any mono format on one scale.
inline constexpr int kFullScale = 4080;

// Black subtracted, brought to 0..kFullScale. Fails for colour formats and torn frames.
Result<Image<std::uint16_t>> normalisedCounts(const Frame& frame, double blackLevel);

// Static lights and noise, learnt from frames and slowly adapted. Not thread-safe.
class Background {
 public:
  // The last 16 frames are kept.
  void learn(Image<std::uint16_t> counts);
  int learned() const { return static_cast<int>(frames_.size()); }
  // Ends learning: a low quantile over the frames, so that a lamp that was on and moving is not in
  // it.
  void finish();
  bool ready() const { return !level_.empty(); }

  const Image<std::uint16_t>& level() const { return level_; }
  // One sigma of a pixel's noise, counts, over the dark part of the picture.
  double noise() const { return noise_; }
  // Whether a light of the room's own is at this pixel: nearly saturated, or flickering.
  bool isStaticLight(int x, int y) const {
    return level_(x, y) > kFullScale * 4 / 5 || flicker_(x, y) != 0;
  }
  // Moves an eighth of the rows towards the frame, outside the regions given: down by at most 1/255
  // of the full scale, up by an eighth of that. What the lamp throws on walls and ceiling comes and
  // goes; were it learnt as fast as it is forgotten, the lamp would look dimmer wherever it had
  // been.
  void adapt(const Image<std::uint16_t>& counts, const std::vector<Region>& except);

 private:
  std::deque<Image<std::uint16_t>> frames_;
  Image<std::uint16_t> level_;
  Image<std::uint8_t> flicker_;
  double noise_ = 0;
  int phase_ = 0;
};

}  // namespace lightsketch
