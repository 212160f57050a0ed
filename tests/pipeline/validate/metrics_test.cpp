#include "pipeline/validate/metrics.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace lightsketch {
namespace {

Image<std::uint8_t> noise(int width, int height, unsigned seed) {
  std::mt19937 random(seed);
  Image<std::uint8_t> picture(width, height, 3);
  for (auto& value : picture.values()) value = static_cast<std::uint8_t>(random() % 256);
  return picture;
}

// Eq. 13 of Wang et al. window by window with the two-dimensional Gaussian and centred moments.
double referenceSsim(const Image<std::uint8_t>& a, const Image<std::uint8_t>& b) {
  const auto luma = [](const Image<std::uint8_t>& p, int x, int y) {
    return 0.2126 * p(x, y, 0) + 0.7152 * p(x, y, 1) + 0.0722 * p(x, y, 2);
  };
  double total = 0;
  int windows = 0;
  for (int y0 = 5; y0 + 5 < a.height(); ++y0) {
    for (int x0 = 5; x0 + 5 < a.width(); ++x0) {
      double norm = 0, ma = 0, mb = 0, va = 0, vb = 0, cov = 0;
      const auto each = [&](auto visit) {
        for (int dy = -5; dy <= 5; ++dy) {
          for (int dx = -5; dx <= 5; ++dx) {
            visit(std::exp(-(dx * dx + dy * dy) / 4.5), luma(a, x0 + dx, y0 + dy),
                  luma(b, x0 + dx, y0 + dy));
          }
        }
      };
      each([&](double w, double va_, double vb_) { norm += w, ma += w * va_, mb += w * vb_; });
      ma /= norm;
      mb /= norm;
      each([&](double w, double la, double lb) {
        va += w / norm * (la - ma) * (la - ma);
        vb += w / norm * (lb - mb) * (lb - mb);
        cov += w / norm * (la - ma) * (lb - mb);
      });
      total += (2 * ma * mb + 6.5025) * (2 * cov + 58.5225) /
               ((ma * ma + mb * mb + 6.5025) * (va + vb + 58.5225));
      ++windows;
    }
  }
  return total / windows;
}

TEST(Psnr, OfAKnownErrorIsTheFormula) {
  Image<std::uint8_t> truth(10, 10, 3, 100);
  Image<std::uint8_t> picture(10, 10, 3, 105);
  EXPECT_NEAR(psnr8(picture, truth), 20 * std::log10(255.0 / 5), 1e-12);
  // One sample of 300 off by 30: mean square 3.
  picture = truth;
  picture(3, 4, 1) = 70;
  EXPECT_NEAR(psnr8(picture, truth), 10 * std::log10(255.0 * 255 / 3), 1e-12);
  EXPECT_EQ(psnr8(picture, truth), psnr8(truth, picture));
  // Black against white is the worst there is.
  EXPECT_NEAR(psnr8(Image<std::uint8_t>(4, 4, 3, 0), Image<std::uint8_t>(4, 4, 3, 255)), 0, 1e-12);
}

TEST(Psnr, OfIdenticalPicturesIsTheCap) {
  EXPECT_EQ(psnr8(noise(20, 10, 1), noise(20, 10, 1)), kPsnrCap);
}

TEST(Ssim, AgreesWithItsDefinitionWindowByWindow) {
  const auto truth = noise(23, 17, 2);
  auto picture = truth;
  std::mt19937 random(3);
  for (auto& value : picture.values()) {
    value = static_cast<std::uint8_t>(
        std::clamp(int{value} + static_cast<int>(random() % 81) - 40, 0, 255));
  }
  const auto value = ssim8(picture, truth);
  ASSERT_TRUE(value);
  EXPECT_GT(*value, 0.8);
  EXPECT_LT(*value, 0.99);
  EXPECT_NEAR(*value, referenceSsim(picture, truth), 1e-9);
  EXPECT_NEAR(ssim8(noise(30, 12, 4), noise(30, 12, 5)).value(),
              referenceSsim(noise(30, 12, 4), noise(30, 12, 5)), 1e-9);
}

TEST(Ssim, OfFlatPicturesIsTheLuminanceTermAlone) {
  // No variance: (2 ab + C1) / (a^2 + b^2 + C1), C1 = (0.01 255)^2 = 6.5025.
  const Image<std::uint8_t> a(12, 12, 3, 100);
  const Image<std::uint8_t> b(12, 12, 3, 150);
  EXPECT_NEAR(ssim8(a, b).value(),
              (2 * 100.0 * 150 + 6.5025) / (100.0 * 100 + 150.0 * 150 + 6.5025), 1e-9);
}

TEST(Ssim, OfIdenticalPicturesIsOneAndOfTinyOnesUnknown) {
  EXPECT_NEAR(ssim8(noise(16, 11, 6), noise(16, 11, 6)).value(), 1, 1e-12);
  EXPECT_FALSE(ssim8(noise(10, 20, 7), noise(10, 20, 7)));
}

TEST(LinearError, OfAScaledPictureIsTheScale) {
  RadianceImage truth(8, 8, 3);
  for (std::size_t i = 0; i < truth.size(); ++i) truth.data()[i] = 0.01f * static_cast<float>(i);
  RadianceImage picture = truth;
  for (float& value : picture.values()) value *= 1.1f;
  EXPECT_NEAR(linearError(picture, truth).relative, 0.1, 1e-6);  // 1.1f is 1.1 to 2e-8
}

TEST(LinearError, PsnrCountsAgainstTheExposedPeak) {
  const RadianceImage truth(4, 4, 3, 0.5f);
  const RadianceImage picture(4, 4, 3, 0.25f);
  EXPECT_NEAR(linearError(picture, truth).psnr, 20 * std::log10(4.0), 1e-9);
  EXPECT_NEAR(linearError(picture, truth, 2).psnr, 20 * std::log10(2.0), 1e-9);
}

TEST(LinearError, OfBlackIsZeroOrInfinite) {
  const RadianceImage black(4, 4, 3, 0.0f);
  EXPECT_EQ(linearError(black, black).relative, 0);
  EXPECT_EQ(linearError(black, black).psnr, kPsnrCap);
  EXPECT_TRUE(std::isinf(linearError(RadianceImage(4, 4, 3, 0.1f), black).relative));
}

TEST(Metrics, RefusePicturesOfDifferentShape) {
  EXPECT_THROW(psnr8(noise(4, 4, 1), noise(4, 5, 1)), std::logic_error);
  EXPECT_THROW(linearError(RadianceImage(4, 4, 3), RadianceImage(4, 4, 1)), std::logic_error);
  EXPECT_THROW(psnr8({}, {}), std::logic_error);
}

}  // namespace
}  // namespace lightsketch
