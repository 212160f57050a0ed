#include "tests/bench/peers.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <random>

#include "tests/bench/synthetic_set.h"

namespace lightsketch {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr int kWidth = 12;
constexpr int kHeight = 8;

using Shading = std::function<double(int x, int y, int channel, const Vector3d& light)>;

LightStack stackOf(const Shading& shading, const std::vector<Vector3d>& lights) {
  return LightStack::of(kWidth, kHeight, lights, [=](int i) -> Result<RadianceImage> {
    RadianceImage picture(kWidth, kHeight, 3);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        for (int c = 0; c < 3; ++c) {
          picture(x, y, c) =
              static_cast<float>(shading(x, y, c, lights[static_cast<std::size_t>(i)]));
        }
      }
    }
    return picture;
  });
}

// Matte, each pixel another slope and each channel another colour; dark sides are negative.
double lambert(int x, int y, int channel, const Vector3d& light) {
  const Vector3d normal = Vector3d(0.1 * x - 0.5, 0.1 * y - 0.4, 1).normalized();
  return (0.3 + 0.2 * channel) * normal.dot(light);
}

// Linear PSNR under lights between those that were fitted.
double unseenPsnr(const LightBasis& basis, const Shading& shading) {
  const LightBasis bases[] = {basis};
  const auto peers = fitBases(stackOf(shading, hemisphereDirections(12)), bases);
  EXPECT_TRUE(peers.has_value());
  return measureQuality(peers->front(), stackOf(shading, hemisphereDirections(12, 1)))->linearPsnr;
}

// Half floats round by 2^-12 of a value, rms less than that: 72 dB below coefficients of 1; some
// coefficients add up and are larger than the pictures.
constexpr double kHalfFloatPsnr = 60;

TEST(Peers, SphericalHarmonicsHoldALambertianScene) {
  EXPECT_GT(unseenPsnr(sphericalHarmonics(3), lambert), kHalfFloatPsnr);
  EXPECT_GT(unseenPsnr(sphericalHarmonics(4), lambert), kHalfFloatPsnr);
  EXPECT_GT(unseenPsnr(sphericalHarmonics(5), lambert), kHalfFloatPsnr);
}

TEST(Peers, PolynomialTexturesHoldTheirOwnPolynomialAndNoOther) {
  const auto quadratic = [](int x, int y, int channel, const Vector3d& l) {
    return 0.2 + 0.02 * x * l.x() * l.y() + 0.03 * y * l.y() * l.y() - 0.1 * channel * l.x();
  };
  const auto cubic = [](int x, int, int, const Vector3d& l) {
    return 0.1 * x * std::pow(l.x(), 3);
  };
  EXPECT_GT(unseenPsnr(polynomialTexture(), quadratic), kHalfFloatPsnr);
  EXPECT_LT(unseenPsnr(polynomialTexture(), cubic), 40);
}

TEST(Peers, MoreHarmonicsHoldMore) {
  // A highlight of ten degrees or so.
  const auto highlight = [](int x, int y, int, const Vector3d& l) {
    return std::pow(std::max(0.0, Vector3d(0.1 * x - 0.5, 0.1 * y - 0.4, 1).normalized().dot(l)),
                    20);
  };
  EXPECT_GT(unseenPsnr(sphericalHarmonics(5), highlight),
            2 + unseenPsnr(sphericalHarmonics(3), highlight));
  EXPECT_GT(unseenPsnr(hemisphericalHarmonics(4), highlight),
            2 + unseenPsnr(hemisphericalHarmonics(2), highlight));
}

// The mean of f f^T over z from `lowest` to 1 and all azimuths, times the solid angle.
MatrixXd innerProducts(const LightBasis& basis, double lowest) {
  constexpr int kSteps = 400;  // midpoint rule in z and azimuth: 1e-4 for smooth functions
  MatrixXd sum = MatrixXd::Zero(basis.size, basis.size);
  for (int i = 0; i < kSteps; ++i) {
    const double z = lowest + (1 - lowest) * (i + 0.5) / kSteps;
    for (int j = 0; j < 40; ++j) {
      const double azimuth = 2 * M_PI * (j + 0.5) / 40;
      const double level = std::sqrt(1 - z * z);
      const VectorXd f = basis.at({level * std::cos(azimuth), level * std::sin(azimuth), z});
      sum += f * f.transpose();
    }
  }
  return sum * (2 * M_PI * (1 - lowest)) / (40.0 * kSteps);
}

TEST(Peers, HarmonicsAreOrthonormalOverTheSphereAndOverTheHemisphere) {
  EXPECT_LT(
      (innerProducts(sphericalHarmonics(5), -1) - MatrixXd::Identity(25, 25)).cwiseAbs().maxCoeff(),
      1e-3);
  EXPECT_LT((innerProducts(hemisphericalHarmonics(4), 0) - MatrixXd::Identity(16, 16))
                .cwiseAbs()
                .maxCoeff(),
            1e-3);
}

TEST(Peers, GlobalPcaHoldsPicturesOfItsRank) {
  const auto stack = stackOf(lambert, hemisphereDirections(8));  // rank 3: A = 96 x 3 times 3 x 192
  const std::uint64_t bytesPerRank = 4 * (kWidth * kHeight + 3 * 64);
  const auto peer = fitGlobalPca(stack, 3 * bytesPerRank + 1);
  ASSERT_TRUE(peer.has_value());
  EXPECT_EQ(peer->bytes, 3 * bytesPerRank);
  EXPECT_GT(measureQuality(*peer, stack)->linearPsnr, 100);  // single precision: 120 dB or more
  EXPECT_LT(measureQuality(*fitGlobalPca(stack, 2 * bytesPerRank), stack)->linearPsnr, 60);
  // Between lights, as good as the interpolation between them.
  EXPECT_GT(measureQuality(*peer, stackOf(lambert, hemisphereDirections(8, 1)))->linearPsnr, 50);
}

TEST(Peers, GlobalPcaIsAsGoodAsAnyFactorisationOfItsRank) {
  // Eckart and Young: the squared error is the sum of the squared singular values left out.
  const auto rough = [](int x, int y, int c, const Vector3d& l) {
    return std::max(0.0, std::sin(3 * l.x() * x + c) * std::cos(2 * l.y() * y)) * l.z();
  };
  const auto lights = hemisphereDirections(8);
  const auto stack = stackOf(rough, lights);
  MatrixXd all(kWidth * kHeight, 3 * 64);
  for (int i = 0; i < 64; ++i) {
    for (int p = 0; p < kWidth * kHeight; ++p) {
      for (int c = 0; c < 3; ++c) {
        all(p, 3 * i + c) = rough(p % kWidth, p / kWidth, c, lights[static_cast<std::size_t>(i)]);
      }
    }
  }
  constexpr int kRank = 20;
  const VectorXd values = Eigen::BDCSVD<MatrixXd>(all).singularValues();
  const double least =
      values.tail(values.size() - kRank).squaredNorm() / static_cast<double>(all.size());
  const auto peer = fitGlobalPca(stack, 4 * kRank * (kWidth * kHeight + 3 * 64));
  const double psnr = measureQuality(*peer, stack)->linearPsnr;
  EXPECT_LT(psnr, -10 * std::log10(least) + 1e-3);
  EXPECT_GT(psnr, -10 * std::log10(least) - 0.02);
}

TEST(Peers, QualityIsThatOfAKnownError) {
  const auto white = [](int, int, int, const Vector3d&) { return 1.0; };
  const Peer grey{"grey", 0, [](const Vector3d&) -> Result<RadianceImage> {
                    return RadianceImage(kWidth, kHeight, 3, 0.9f);
                  }};
  const auto quality = measureQuality(grey, stackOf(white, hemisphereDirections(3)));
  EXPECT_NEAR(quality->linearPsnr, 20, 1e-4);
  // sRGB of 0.9 is 0.9547, as 8 bits 243: 12 steps below white.
  EXPECT_NEAR(quality->srgbPsnr, 20 * std::log10(255.0 / 12), 1e-6);
}

// --- The synthetic set ------------------------------------------------------------------------

TEST(SyntheticSet, DirectionsDivideTheCapEvenly) {
  const auto directions = hemisphereDirections(16);
  const double lowest = std::cos(85 * M_PI / 180);
  ASSERT_EQ(directions.size(), 256u);
  Vector3d mean = Vector3d::Zero();
  for (const Vector3d& d : directions) {
    EXPECT_NEAR(d.norm(), 1, 1e-12);
    EXPECT_GE(d.z(), lowest);
    mean += d / 256;
  }
  // Square rings k = 0 to 7 of 4 (2 k + 1) cells lie at squared radii ((2 k + 1) / 16)^2, on
  // average 127 / 256, and z falls evenly with the squared radius.
  EXPECT_NEAR(mean.x(), 0, 1e-12);
  EXPECT_NEAR(mean.y(), 0, 1e-12);
  EXPECT_NEAR(mean.z(), 1 - (1 - lowest) * 127 / 256, 1e-12);
  EXPECT_EQ(hemisphereDirections(16, 1).size(), 225u);
}

TEST(SyntheticSet, HasShadowsHighlightsAndNothingUnlit) {
  const SyntheticScene scene(96, 72);
  const auto low = scene.picture(Vector3d(0.8, 0, 0.6));
  const auto high = scene.picture(Vector3d(0, 0, 1));
  int shadows = 0;
  int highlights = 0;
  for (std::size_t i = 0; i < low.size(); ++i) {
    EXPECT_GE(low.values()[i], 0);
    EXPECT_LE(low.values()[i], 4.5f);  // highlights are cut at 3
    if (high.values()[i] > 0.1f && low.values()[i] < 0.1f * high.values()[i]) ++shadows;
    if (low.values()[i] > 1.2f) ++highlights;
  }
  EXPECT_GT(shadows, 0.02 * static_cast<double>(low.size()));
  EXPECT_GT(highlights, 10);
  EXPECT_LT(highlights, 0.05 * static_cast<double>(low.size()));
}

}  // namespace
}  // namespace lightsketch
