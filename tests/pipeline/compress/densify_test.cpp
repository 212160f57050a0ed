#include "pipeline/compress/densify.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "capture/frame/srgb.h"
#include "pipeline/compress/encoded_domain.h"
#include "tests/pipeline/compress/test_sketch.h"

namespace lightsketch {
namespace {

using Eigen::Vector3d;
using testing::randomLights;

constexpr int kWidth = 64;
constexpr int kHeight = 32;
using Shade = std::function<float(int x, int y, int channel, const Vector3d& light)>;

RadianceImage picture(const Shade& shade, const Vector3d& light) {
  RadianceImage image(kWidth, kHeight, 3);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      for (int c = 0; c < 3; ++c) image(x, y, c) = shade(x, y, c, light);
    }
  }
  return image;
}

struct Densified {
  std::vector<Vector3d> lights;
  std::vector<RadianceImage> pictures;
  std::string description;
};

Densified densify(const std::vector<Vector3d>& captured, const Shade& shade, int nodes = 300) {
  const LightStack stack = LightStack::of(kWidth, kHeight, captured, [&](int i) {
    return Result<RadianceImage>(picture(shade, captured[static_cast<std::size_t>(i)]));
  });
  const BlockLayout layout{kWidth, kHeight, 16};
  SilentProgress progress;
  const ScratchStack scratch =
      ScratchStack::create(stack, layout, std::filesystem::temp_directory_path(), progress).value();
  const CompressOptions options{.densify = nodes};
  const Densifier densifier = Densifier::create(stack, scratch, layout, options, progress).value();
  Densified result{densifier.lights(), {}, densifier.description()};
  for (std::size_t i = 0; i < result.lights.size(); ++i)
    result.pictures.emplace_back(kWidth, kHeight, 3);
  const std::size_t values = scratch.blockValues();
  std::vector<std::uint16_t> halfs(captured.size() * values);
  Densifier::Workspace workspace;
  std::vector<float> columns;
  for (int block = 0; block < layout.blocks(); ++block) {
    EXPECT_TRUE(scratch.read(block, halfs.data()));
    EXPECT_TRUE(densifier.columns(block, halfs.data(), values, workspace, columns));
    for (std::size_t v = 0; v < columns.size(); ++v) {
      const int pixel = static_cast<int>(v % 256);
      result.pictures[v / values](block % layout.columns() * 16 + pixel % 16,
                                  block / layout.columns() * 16 + pixel / 16,
                                  static_cast<int>(v / 256 % 3)) = columns[v];
    }
  }
  return result;
}

// Root mean square error of the sRGB-encoded pictures, left and right half, over the lights for
// which `counts` holds.
std::array<double, 2> errors(const Densified& densified, const Shade& truth,
                             const std::function<bool(const Vector3d&)>& counts) {
  std::array<double, 2> sum{};
  double count = 0;
  for (std::size_t i = 0; i < densified.lights.size(); ++i) {
    if (!counts(densified.lights[i])) continue;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const double e = srgbEncode(densified.pictures[i](x, y, 1)) -
                         srgbEncode(truth(x, y, 1, densified.lights[i]));
        sum[x < kWidth / 2 ? 0 : 1] += e * e;
      }
    }
    count += kWidth / 2.0 * kHeight;
  }
  return {std::sqrt(sum[0] / count), std::sqrt(sum[1] / count)};
}

Vector3d normalAt(int x, int y) {
  return Vector3d(0.5 * std::sin(0.5 * x), 0.4 * std::cos(0.4 * y + 0.2 * x), 1).normalized();
}

float matte(int x, int y, int c, const Vector3d& light) {
  return static_cast<float>((0.3 + 0.2 * c) * std::max(0.0, normalAt(x, y).dot(light)));
}

float halfGlossy(int x, int y, int c, const Vector3d& light) {
  if (x < kWidth / 2) return matte(x, y, c, light);
  const Vector3d half = (light + Vector3d::UnitZ()).normalized();
  const double highlight = std::pow(std::max(0.0, normalAt(x, y).dot(half)), 30);
  return 0.1f * matte(x, y, c, light) + static_cast<float>(0.6 * highlight);
}

TEST(Densifier, BlocksOfTheirOwnMixtureBeatOneSettingForThePicture) {
  const auto captured = randomLights(50, 3, 0.2);
  const auto hull = DirectionInterpolator::create(captured, {}).value();
  const auto inside = [&](const Vector3d& light) { return hull.insideHull(light); };
  const Densified ours = densify(captured, halfGlossy);

  // One setting for all, chosen by leave-one-out in the encoded domain.
  Eigen::MatrixXf samples(50, kWidth * kHeight);
  for (int i = 0; i < 50; ++i) {
    for (int k = 0; k < kWidth * kHeight; ++k) {
      samples(i, k) =
          srgbEncode(halfGlossy(k % kWidth, k / kWidth, 1, captured[static_cast<std::size_t>(i)]));
    }
  }
  const auto single =
      DirectionInterpolator::create(captured, chooseInterpolation(captured, samples).value())
          .value();
  Densified one{ours.lights, {}, {}};
  for (const Vector3d& light : ours.lights) {
    const Eigen::RowVectorXf encoded = single.weights(light).cast<float>().transpose() * samples;
    one.pictures.push_back(picture(
        [&](int x, int y, int, const Vector3d&) {
          return srgbDecode(std::max(0.0f, encoded[y * kWidth + x]));
        },
        light));
  }
  const auto mixed = errors(ours, halfGlossy, inside);
  const auto alone = errors(one, halfGlossy, inside);
  EXPECT_LT(mixed[0], 0.9 * alone[0]) << ours.description;  // the matte half
  EXPECT_LT(mixed[1], 0.9 * alone[1]) << ours.description;  // the glossy one
}

TEST(Densifier, GoesOnBeyondTheHullAlongAKnownTrend) {
  // sRGB-encoded values linear in the direction: what a linear trend continues exactly.
  const auto captured = randomLights(40, 4, 0.5);
  const Shade linear = [](int x, int y, int, const Vector3d& light) {
    return srgbDecode(static_cast<float>(0.4 + 0.02 * (x % 7) + 0.2 * light.x() +
                                         0.1 * (y % 3) * light.y() + 0.1 * light.z()));
  };
  const auto hull = DirectionInterpolator::create(captured, {}).value();
  const Densified ours = densify(captured, linear);
  int outside = 0;
  for (const Vector3d& light : ours.lights) outside += hull.insideHull(light) ? 0 : 1;
  EXPECT_GT(outside, 10);
  // Halfs are good to 2^-11 of the value, the mixture nearly leaves out ways without that trend;
  // clamping to the hull would err by about 0.05.
  EXPECT_LT(errors(ours, linear, [&](const Vector3d& d) { return !hull.insideHull(d); })[0], 0.003);
}

TEST(Densifier, PicturesScaleWithTheLamp) {
  const auto captured = randomLights(30, 5, 0.2);
  const Densified plain = densify(captured, halfGlossy);
  const Densified bright = densify(captured, [](int x, int y, int c, const Vector3d& light) {
    return 8 * halfGlossy(x, y, c, light);
  });
  ASSERT_EQ(plain.pictures.size(), bright.pictures.size());
  for (std::size_t i = 0; i < plain.pictures.size(); ++i) {
    for (std::size_t v = 0; v < plain.pictures[i].size(); ++v) {
      // A power of two changes no half's digits but those of the very darkest.
      EXPECT_NEAR(bright.pictures[i].data()[v], 8 * plain.pictures[i].data()[v], 1e-3);
    }
  }
}

TEST(Densifier, WorksWithOneTwoAndThreeLights) {
  for (int n = 1; n <= 3; ++n) {
    const auto captured = randomLights(n, 6, 0.4);
    const Densified ours = densify(captured, matte);
    ASSERT_FALSE(ours.pictures.empty());
    for (const auto& image : ours.pictures) {
      for (const float value : image.values()) ASSERT_TRUE(value >= 0 && value <= 1);
    }
    if (n > 1) continue;
    // One light: its picture everywhere. 0.001: half floats.
    EXPECT_LT(
        errors(
            ours, [&](int x, int y, int c, const Vector3d&) { return matte(x, y, c, captured[0]); },
            [](const Vector3d&) { return true; })[0],
        1e-3);
  }
}

TEST(EncodedDomain, MixturesOfOneDomainDecodeExactly) {
  std::vector<float> linear(1003), srgb(1003), log(1003), out(1003);  // no whole vectors
  for (std::size_t i = 0; i < linear.size(); ++i) {
    linear[i] = std::pow(static_cast<float>(i) / 700.0f, 3.0f);
    srgb[i] = encodeValue(EncodedDomain::kSrgb, linear[i]);
    log[i] = encodeValue(EncodedDomain::kLog, linear[i]);
  }
  const auto check = [&](float s, float l) {
    mixDomains({srgb.data(), s, 10}, {log.data(), l, 10}, linear.size(), 2, out.data());
    for (std::size_t i = 0; i < linear.size(); ++i) {
      // Single precision through one logarithm and one exponential.
      EXPECT_NEAR(out[i], 2 * linear[i], 1e-5f * linear[i] + 1e-8f);
    }
  };
  check(1, 0);
  check(0, 1);
  check(0.3f, 0.7f);
  srgbFromLog(log.data(), log.size());
  for (std::size_t i = 0; i < log.size(); ++i) EXPECT_NEAR(log[i], srgb[i], 2e-6f);
}

TEST(EncodedDomain, MixturesKeepWithinBounds) {
  const float srgb[] = {-0.5f, 0.0f, 2.0f};
  float out[3];
  mixDomains({srgb, 1, 1}, {}, 3, 1, out);
  EXPECT_EQ(out[0], 0);
  EXPECT_EQ(out[1], 0);
  EXPECT_NEAR(out[2], 1, 1e-6f);
}

}  // namespace
}  // namespace lightsketch
