#include "capture/frame/srgb.h"

#include <gtest/gtest.h>

#include <limits>

namespace lightsketch {
namespace {

TEST(Srgb, AgreesWithTheStandard) {
  // IEC 61966-2-1: 18 percent grey encodes to 0.4613561; 0.5 decodes to 0.2140411.
  EXPECT_NEAR(srgbEncode(0.18f), 0.4613561f, 1e-6f);
  EXPECT_NEAR(srgbDecode(0.5f), 0.2140411f, 1e-6f);
  EXPECT_FLOAT_EQ(srgbEncode(1.0f), 1.0f);
  EXPECT_EQ(srgbEncode8(0.18f), 118);
}

TEST(Srgb, EveryByteSurvivesDecodingAndEncoding) {
  for (int value = 0; value < 256; ++value) {
    EXPECT_EQ(srgbEncode8(srgbDecode(static_cast<float>(value) / 255.0f)), value);
  }
}

TEST(Srgb, IsInvertibleBeyondOneAndBelowZero) {
  for (const float value : {-3.0f, -0.001f, 0.0f, 0.002f, 1.5f, 40.0f}) {
    // Two powf calls of half an ulp each, amplified by the exponent 2.4.
    EXPECT_NEAR(srgbDecode(srgbEncode(value)), value, 2e-6f * (1 + std::fabs(value)));
  }
}

TEST(Srgb, BytesAreClipped) {
  EXPECT_EQ(srgbEncode8(-1.0f), 0);
  EXPECT_EQ(srgbEncode8(9.0f), 255);
  EXPECT_EQ(srgbEncode8(std::numeric_limits<float>::infinity()), 255);
  EXPECT_EQ(srgbEncode8(std::numeric_limits<float>::quiet_NaN()), 0);
}

}  // namespace
}  // namespace lightsketch
