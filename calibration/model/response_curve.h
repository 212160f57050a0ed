// What a count of a camera's sample stands for: linear exposure, and back.
#pragma once

#include <string_view>
#include <vector>

#include "capture/frame/json.h"
#include "capture/frame/pixel_format.h"
#include "capture/frame/result.h"

namespace lightsketch {

// Colours that a format tells apart: 1 (mono) or 3 (RGB and Bayer).
int colourChannels(PixelFormat format);
// Colour of a sample; `sample` counts within the pixel (RGB), Bayer sites go by their place.
inline int sampleColour(const PixelFormatInfo& info, int x, int y, int sample) {
  return info.isBayer ? ((x ^ info.redX) & 1) + ((y ^ info.redY) & 1) : sample;
}

// Per colour a strictly increasing function: exposure 0 is no light, 1 the count at which the
// sensor saturates. Counts below black give negative exposures, so that means stay unbiased.
// Piecewise linear between nodes evenly spaced over 0..maxCount, continued straight beyond; a
// linear sensor has two nodes. Immutable, so thread-safe.
class ResponseCurve {
 public:
  // Linear, 8 bits, no black level.
  ResponseCurve() = default;
  // exposure = (count - black) / (saturation - black), a black level per colour.
  static Result<ResponseCurve> linear(const std::vector<double>& blackCounts, double maxCount,
                                      double saturationCount);
  // exposure[colour][i] at count i maxCount / (n - 1); scaled here to 1 at saturation.
  static Result<ResponseCurve> tabulated(std::vector<std::vector<double>> exposure, double maxCount,
                                         double saturationCount);
  static Result<ResponseCurve> fromJson(const Json& json, std::string_view where);
  Json toJson() const;

  int colours() const { return static_cast<int>(exposure_.size()); }
  bool isLinear() const { return exposure_.front().size() == 2; }
  double maxCount() const { return maxCount_; }
  double saturationCount() const { return saturationCount_; }

  double exposure(double count, int colour) const;
  // d(exposure) / d(count).
  double slope(double count, int colour) const;
  // Inverse of exposure().
  double count(double exposure, int colour) const;
  double blackCount(int colour) const { return count(0, colour); }

 private:
  std::size_t segment(double position) const;

  std::vector<std::vector<double>> exposure_{{0, 1}};
  double maxCount_ = 255;
  double saturationCount_ = 255;
};

}  // namespace lightsketch
