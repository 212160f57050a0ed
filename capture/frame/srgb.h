// The sRGB transfer function, IEC 61966-2-1. Odd-symmetric below 0 and continued above 1, so that
// it is invertible over all radiances and can serve as the perceptual ("encoded") domain of HDR.
#pragma once

#include <cmath>
#include <cstdint>

namespace lightsketch {

inline float srgbEncode(float linear) {
  const float a = std::fabs(linear);
  const float e = a <= 0.0031308f ? 12.92f * a : 1.055f * std::pow(a, 1.0f / 2.4f) - 0.055f;
  return std::copysign(e, linear);
}

inline float srgbDecode(float encoded) {
  const float a = std::fabs(encoded);
  const float l = a <= 0.04045f ? a / 12.92f : std::pow((a + 0.055f) / 1.055f, 2.4f);
  return std::copysign(l, encoded);
}

// Rounded and clipped to 0..255; not a number gives 0.
inline std::uint8_t srgbEncode8(float linear) {
  const float e = 255.0f * srgbEncode(linear) + 0.5f;
  return e > 0.5f ? (e >= 255.0f ? std::uint8_t{255} : static_cast<std::uint8_t>(e))
                  : std::uint8_t{0};
}

// Luminance weights of linear Rec. 709 / sRGB primaries, ITU-R BT.709.
inline constexpr float kRec709Luma[3] = {0.2126f, 0.7152f, 0.0722f};

}  // namespace lightsketch
