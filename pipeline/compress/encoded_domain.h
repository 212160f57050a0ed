// The two domains in which captured pictures are interpolated between lights. Both spread the dark
// values; values are relative to a white. Internal to this folder.
#pragma once

#include <cstddef>

namespace lightsketch {

enum class EncodedDomain {
  kSrgb,  // srgbEncode
  kLog,   // log(1 + x / kLogFloor): light from one lamp is a product of shading and albedo
};
inline constexpr int kEncodedDomains = 2;
inline constexpr float kLogFloor = 0.003f;

float encodeValue(EncodedDomain domain, float linear);

// In place, log-encoded to sRGB-encoded.
void srgbFromLog(float* values, std::size_t count);

// A prediction in one domain, n values, and how much of it is wanted.
struct DomainPrediction {
  const float* values = nullptr;
  float share = 0;
  float largest = 0;  // greater ones are taken for this
};
// The mixture in linear light times `white`, into `linear` (which may be either's values):
// square roots are mixed, which weighs errors about as the eye does. A share of 0 is not read.
void mixDomains(const DomainPrediction& srgb, const DomainPrediction& log, std::size_t count,
                float white, float* linear);

}  // namespace lightsketch
