// How far a picture is from the truth.
#pragma once

#include <cstdint>
#include <optional>

#include "capture/frame/image.h"

namespace lightsketch {

// Peak signal-to-noise ratio in dB of 8-bit pictures, peak 255, all pixels and channels. Identical
// pictures have no noise; they and everything better count as kPsnrCap, so that means stay finite.
// Both pictures have the same shape and at least one value (std::logic_error otherwise; so below).
inline constexpr double kPsnrCap = 100;
double psnr8(const Image<std::uint8_t>& picture, const Image<std::uint8_t>& truth);

// Structural similarity of 8-bit RGB pictures: Wang, Bovik, Sheikh, Simoncelli 2004, eq. 13, mean
// over all 11 x 11 windows that lie inside, Gaussian of sigma 1.5, K1 = 0.01, K2 = 0.03, L = 255,
// on luma (BT.709 weights of the encoded values). Nothing if a side is shorter than 11 pixels.
std::optional<double> ssim8(const Image<std::uint8_t>& picture, const Image<std::uint8_t>& truth);

struct LinearError {
  double relative =
      0;            // rms error / rms truth; 0 for black that stays black, infinite if it does not
  double psnr = 0;  // dB against a peak of 1 / exposure, at most kPsnrCap
};
// In linear light, nothing clipped. `exposure` is the factor that a display would apply.
LinearError linearError(const RadianceImage& picture, const RadianceImage& truth,
                        double exposure = 1);

}  // namespace lightsketch
