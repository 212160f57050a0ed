#include "pipeline/relight/relighter.h"

#include <gtest/gtest.h>

#include <hwy/highway.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <random>
#include <span>
#include <vector>

#include "capture/frame/srgb.h"

namespace lightsketch {
namespace {

enum class Numbers { kFloat32, kFloat16, kQ8, kInt16 };
constexpr Numbers kAllNumbers[] = {Numbers::kFloat32, Numbers::kFloat16, Numbers::kQ8,
                                   Numbers::kInt16};

void makeIntegers(StoredFactor& factor, ElementType type, std::size_t scales,
                  std::mt19937& random) {
  std::uniform_int_distribution<int> number(-100, 100);
  std::uniform_real_distribution<float> scale(0.005f, 0.02f);
  factor.values = FactorValues(type, factor.values.count());
  for (std::size_t i = 0; i < factor.values.count(); ++i) {
    factor.values.set(i, static_cast<float>(number(random)));
  }
  factor.scale.resize(scales);
  for (float& value : factor.scale) value = scale(random);
}

// Random factors with 0 to 4 rows per block.
RelightableModel randomModel(int width, int height, int blockSize, int lights, int rank, int seed,
                             Numbers numbers = Numbers::kFloat32) {
  std::mt19937 random(static_cast<unsigned>(seed));
  std::normal_distribution<float> normal;
  Factors factors;
  factors.layout = {width, height, blockSize};
  factors.blockOffset = {0};
  for (int j = 0; j < factors.layout.blocks(); ++j) {
    factors.blockOffset.push_back(factors.blockOffset.back() + static_cast<int>(random() % 5));
  }
  const auto fill = [&](RowMajorMatrixf& m, Eigen::Index rows, Eigen::Index cols) {
    m = RowMajorMatrixf::NullaryExpr(rows, cols, [&] { return normal(random); });
  };
  fill(factors.E, factors.blockOffset.back(), factors.layout.pixelsPerBlock());
  fill(factors.U, factors.blockOffset.back(), rank);
  fill(factors.V, rank, 3 * lights);
  RelightableModel model;
  model.lights.assign(static_cast<std::size_t>(lights), Eigen::Vector3d::UnitZ());
  model.solidAngles.assign(static_cast<std::size_t>(lights), 1.0);
  setFactors(model, factors,
             numbers == Numbers::kFloat32 ? Storage::kFloat32
             : numbers == Numbers::kQ8    ? Storage::kQ8
                                          : Storage::kFloat16);
  if (numbers == Numbers::kInt16) {
    model.storage = Storage::kPacked;
    makeIntegers(model.E, ElementType::kInt16, static_cast<std::size_t>(model.rows()), random);
    makeIntegers(model.U, ElementType::kInt16, static_cast<std::size_t>(rank), random);
    makeIntegers(model.V, ElementType::kInt16, static_cast<std::size_t>(rank), random);
  }
  return model;
}

LightIntensities randomIntensities(int lights, int seed, int on) {
  std::mt19937 random(static_cast<unsigned>(seed));
  std::normal_distribution<float> normal;
  LightIntensities s = LightIntensities::Zero(lights, 3);
  for (int i = 0; i < on; ++i) {
    for (int c = 0; c < 3; ++c) s((i * 7) % lights, c) = normal(random);
  }
  return s;
}

using Picture = std::vector<double>;  // rows of RGB

// E^T (U (V s)) by its definition in doubles, with a share of the bases.
Picture reference(const RelightableModel& model, const LightIntensities& s, double share = 1) {
  const Factors factors = factorsOf(model);
  const auto kept = [&](double count) {
    return static_cast<Eigen::Index>(std::ceil(share * count - 1e-4));
  };
  const Eigen::Index q = kept(model.rank);
  Eigen::MatrixXd v = Eigen::MatrixXd::Zero(q, 3);
  for (Eigen::Index k = 0; k < q; ++k) {
    for (Eigen::Index i = 0; i < s.rows(); ++i) {
      for (Eigen::Index c = 0; c < 3; ++c) {
        v(k, c) += double{factors.V(k, 3 * i + c)} * double{s(i, c)};
      }
    }
  }
  const Eigen::MatrixXd l = factors.U.cast<double>().leftCols(q) * v;
  const BlockLayout& layout = model.layout;
  Picture picture;
  for (int y = 0; y < layout.height; ++y) {
    for (int x = 0; x < layout.width; ++x) {
      const auto j =
          static_cast<std::size_t>(y / layout.blockSize * layout.columns() + x / layout.blockSize);
      const int pixel = y % layout.blockSize * layout.blockSize + x % layout.blockSize;
      const Eigen::Index first = model.blockOffset[j];
      const Eigen::Index rows = kept(static_cast<double>(model.blockOffset[j + 1] - first));
      for (int c = 0; c < 3; ++c) {
        double sum = 0;
        for (Eigen::Index row = first; row < first + rows; ++row) {
          sum += double{factors.E(row, pixel)} * l(row, c);
        }
        picture.push_back(sum);
      }
    }
  }
  return picture;
}

// Float sums of some hundred terms: a few units of 6e-8 each, relative to the largest value.
constexpr double kRounding = 2e-6;

void expectSame(std::span<const float> drawn, const Picture& truth) {
  ASSERT_EQ(drawn.size(), truth.size());
  double largest = 0;
  double worst = 0;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    largest = std::max(largest, std::abs(truth[i]));
    worst = std::max(worst, std::abs(truth[i] - double{drawn[i]}));
    ASSERT_FALSE(std::isnan(drawn[i]));
  }
  ASSERT_GT(largest, 1);
  EXPECT_LT(worst, kRounding * largest);
}

void expectReference(const RelightableModel& model, const LightIntensities& s) {
  const auto picture = relight(model, s);
  ASSERT_TRUE(picture) << picture.error().message;
  ASSERT_EQ(picture->width(), model.layout.width);
  ASSERT_EQ(picture->height(), model.layout.height);
  ASSERT_EQ(picture->channels(), 3);
  expectSame(picture->values(), reference(model, s));
}

Relighter relighterOf(RelightableModel model) {
  auto relighter = Relighter::create(std::make_shared<RelightableModel>(std::move(model)));
  if (!relighter) throw std::logic_error(relighter.error().message);
  return *std::move(relighter);
}

RadianceImage pictureOf(const Relighter& relighter, const RenderOptions& options = {},
                        float fill = 0) {
  const BlockLayout& layout = relighter.model().layout;
  RadianceImage picture(layout.width, layout.height, 3, fill);
  relighter.render(picture, options);
  return picture;
}

// Runs what it is given once for each instruction set that this machine has.
class Relight : public testing::Test {
 protected:
  template <class Function>
  void onEveryTarget(const Function& function) {
    for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
      SCOPED_TRACE(hwy::TargetName(target));
      hwy::GetChosenTarget().Update(target);
      function();
    }
  }
  void TearDown() override { hwy::GetChosenTarget().DeInit(); }
};

TEST_F(Relight, IsTheProductOfItsFactorsInEveryStorageOnEveryTarget) {
  onEveryTarget([] {
    for (const Numbers numbers : kAllNumbers) {
      SCOPED_TRACE(static_cast<int>(numbers));
      expectReference(randomModel(96, 64, 16, 24, 19, 1, numbers), randomIntensities(24, 2, 24));
    }
  });
}

TEST_F(Relight, AnyBlockSizeAndAnyPictureSize) {
  onEveryTarget([] {
    int seed = 100;
    for (const int size : {2, 3, 5, 8, 12, 15, 16, 17, 31, 32, 48, 63, 64}) {
      for (const Numbers numbers : kAllNumbers) {
        ++seed;
        SCOPED_TRACE(testing::Message() << size << ", numbers " << static_cast<int>(numbers));
        expectReference(randomModel(3 * size - 1, 2 * size + 1, size, 9, 7, seed, numbers),
                        randomIntensities(9, seed, 9));
      }
    }
    expectReference(randomModel(3, 2, 16, 5, 3, 5), randomIntensities(5, 6, 5));
    expectReference(randomModel(300, 200, 4, 5, 1, 10), randomIntensities(5, 6, 5));
  });
}

TEST_F(Relight, ManyRowsInABlock) {
  RelightableModel model = randomModel(40, 24, 16, 6, 40, 20, Numbers::kFloat16);
  Factors factors;
  factors.layout = model.layout;
  factors.blockOffset = {0, 0, 256, 256, 300, 300, 301};
  factors.E = RowMajorMatrixf::Random(301, 256);
  factors.U = RowMajorMatrixf::Random(301, 40);
  factors.V = RowMajorMatrixf::Random(40, 18);
  setFactors(model, factors, Storage::kQ8);
  onEveryTarget([&] { expectReference(model, randomIntensities(6, 21, 6)); });
}

TEST_F(Relight, AModelWithoutBasesIsBlack) {
  RelightableModel model = randomModel(40, 24, 16, 6, 5, 22);
  Factors factors = factorsOf(model);
  factors.blockOffset.assign(factors.blockOffset.size(), 0);
  factors.E.resize(0, 256);
  factors.U.resize(0, 5);
  setFactors(model, factors, Storage::kQ8);
  onEveryTarget([&] {
    const auto picture = relight(model, LightIntensities::Ones(6, 3));
    ASSERT_TRUE(picture);
    for (const float value : picture->values()) ASSERT_EQ(value, 0);
  });
}

TEST_F(Relight, AFewLampsAmongManyGiveTheSameAsTheFullSum) {
  onEveryTarget([] {
    expectReference(randomModel(16, 16, 8, 1000, 40, 9), randomIntensities(1000, 10, 3));
    expectReference(randomModel(16, 16, 8, 1000, 40, 9, Numbers::kFloat16),
                    randomIntensities(1000, 10, 1000));
  });
}

TEST_F(Relight, EachColourOfLightFeedsItsOwnChannel) {
  const RelightableModel model = randomModel(16, 16, 8, 10, 6, 11);
  LightIntensities red = LightIntensities::Zero(10, 3);
  red(4, 0) = 1;
  const auto picture = relight(model, red);
  ASSERT_TRUE(picture);
  float redSum = 0, otherSum = 0;
  for (int y = 0; y < 16; ++y) {
    for (int x = 0; x < 16; ++x) {
      redSum += std::abs((*picture)(x, y, 0));
      otherSum += std::abs((*picture)(x, y, 1)) + std::abs((*picture)(x, y, 2));
    }
  }
  EXPECT_GT(redSum, 1);
  EXPECT_EQ(otherSum, 0);
}

TEST_F(Relight, SumOfTwoLightsIsTheSumOfTheTwoPictures) {
  const RelightableModel model = randomModel(64, 48, 16, 60, 30, 12);
  const LightIntensities s1 = randomIntensities(60, 13, 2);
  const LightIntensities s2 = randomIntensities(60, 14, 60);
  const auto a = relight(model, s1);
  const auto b = relight(model, s2);
  const auto both = relight(model, s1 + s2);
  ASSERT_TRUE(a && b && both);
  float largest = 0, worst = 0;
  for (std::size_t i = 0; i < both->size(); ++i) {
    largest = std::max(largest, std::abs(both->data()[i]));
    worst = std::max(worst, std::abs(both->data()[i] - a->data()[i] - b->data()[i]));
  }
  ASSERT_GT(largest, 1);
  EXPECT_LT(worst, 4e-6f * largest);  // rounding of three float pictures
}

TEST_F(Relight, NoLightIsBlack) {
  const auto picture = relight(randomModel(16, 16, 8, 4, 3, 15), LightIntensities::Zero(4, 3));
  ASSERT_TRUE(picture);
  for (const float value : picture->values()) EXPECT_EQ(value, 0);
}

TEST_F(Relight, RefusesLightsAndFactorsThatDoNotFit) {
  const RelightableModel good = randomModel(16, 16, 8, 4, 3, 16);
  const LightIntensities s = LightIntensities::Ones(4, 3);
  ASSERT_TRUE(relight(good, s));

  const auto wrongLights = relight(good, LightIntensities::Ones(5, 3));
  ASSERT_FALSE(wrongLights);
  EXPECT_EQ(wrongLights.error().message,
            "relight: 5 light intensities given, the model has 4 lights");
  EXPECT_FALSE(relighterOf(good).setLight(LightIntensities::Ones(5, 3)));

  const auto refuses = [&](auto change) {
    RelightableModel bad = good;
    change(bad);
    const auto result = relight(bad, s);
    return !result && result.error().code == ErrorCode::kInvalidArgument &&
           !Relighter::create(std::make_shared<RelightableModel>(bad));
  };
  const auto shorter = [](StoredFactor& factor) {
    factor.values = FactorValues(factor.values.type(), factor.values.count() - 1);
  };
  EXPECT_TRUE(refuses([](auto& m) { m.layout.width = 0; }));
  EXPECT_TRUE(refuses([](auto& m) { m.layout.width = 17; }));
  EXPECT_TRUE(refuses([](auto& m) { m.layout.blockSize = 0; }));
  EXPECT_TRUE(refuses([](auto& m) { m.blockOffset.pop_back(); }));
  EXPECT_TRUE(refuses([](auto& m) { m.blockOffset.clear(); }));
  EXPECT_TRUE(refuses([](auto& m) { m.blockOffset[1] = -1; }));
  EXPECT_TRUE(refuses([](auto& m) { m.blockOffset.back() += 1; }));
  EXPECT_TRUE(refuses([](auto& m) { m.rank += 1; }));
  EXPECT_TRUE(refuses([&](auto& m) { shorter(m.U); }));
  EXPECT_TRUE(refuses([&](auto& m) { shorter(m.E); }));
  EXPECT_TRUE(refuses([&](auto& m) { shorter(m.V); }));
  EXPECT_TRUE(refuses([](auto& m) { m.E.scale.push_back(1); }));
}

using Relighting = Relight;

TEST_F(Relighting, ExposureIsAFactorAndAShareUsesTheFirstBases) {
  onEveryTarget([] {
    for (const Numbers numbers : kAllNumbers) {
      Relighter relighter = relighterOf(randomModel(50, 40, 16, 9, 23, 30, numbers));
      const LightIntensities s = randomIntensities(9, 31, 9);
      ASSERT_TRUE(relighter.setLight(s));
      for (const float share : {1.0f, 0.5f, 0.3f, 0.01f}) {
        SCOPED_TRACE(share);
        RenderOptions options;
        options.share = share;
        options.exposure = 3;
        Picture truth = reference(relighter.model(), s, double{share});
        for (double& value : truth) value *= 3;
        expectSame(pictureOf(relighter, options).values(), truth);
      }
    }
  });
}

// What it holds are square roots: negative ones are black, and exposure is a factor on the square.
TEST_F(Relighting, ASingleLampModelIsSquared) {
  onEveryTarget([] {
    RelightableModel model = randomModel(50, 40, 16, 9, 23, 32);
    model.singleLamp = true;
    Relighter relighter = relighterOf(std::move(model));
    const LightIntensities s = randomIntensities(9, 33, 9);
    ASSERT_TRUE(relighter.setLight(s));
    Picture truth = reference(relighter.model(), s);
    for (double& value : truth) value = 3 * std::pow(std::max(value, 0.0), 2);
    RenderOptions options;
    options.exposure = 3;
    expectSame(pictureOf(relighter, options).values(), truth);
  });
}

TEST_F(Relighting, IncrementsGiveWhatAFreshStartGives) {
  onEveryTarget([] {
    constexpr int kLights = 600;
    const auto model = std::make_shared<RelightableModel>(
        randomModel(40, 40, 16, kLights, 50, 32, Numbers::kFloat16));
    auto relighter = Relighter::create(model);
    ASSERT_TRUE(relighter);
    LightIntensities s = LightIntensities::Zero(kLights, 3);
    std::mt19937 random(33);
    std::normal_distribution<float> normal;
    for (int step = 0; step < 60; ++step) {
      // One light, a few, all; on and off.
      const int changed = step % 20 == 19 ? kLights : step % 3 == 0 ? 1 : 5;
      for (int k = 0; k < changed; ++k) {
        const auto light = static_cast<Eigen::Index>(random() % kLights);
        for (int c = 0; c < 3; ++c) s(light, c) = random() % 4 == 0 ? 0 : normal(random);
      }
      ASSERT_TRUE(relighter->setLight(s));
      if (step % 7 != 0 && step != 59) continue;
      expectSame(pictureOf(*relighter).values(), reference(*model, s));
    }
    ASSERT_TRUE(relighter->setLight(LightIntensities::Zero(kLights, 3)));
    const RadianceImage dark = pictureOf(*relighter);
    for (const float value : dark.values()) ASSERT_EQ(value, 0);
  });
}

TEST_F(Relighting, AGlaringLightLeavesNothingBehind) {
  // 1e14 in doubles is known to 0.01: taking the light away again as a difference would leave that.
  Relighter relighter = relighterOf(randomModel(40, 40, 16, 20, 12, 34));
  LightIntensities s = randomIntensities(20, 35, 20);
  const LightIntensities quiet = s;
  for (const float glare :
       {1e14f, std::numeric_limits<float>::infinity(), std::numeric_limits<float>::quiet_NaN()}) {
    ASSERT_TRUE(relighter.setLight(quiet));
    s = quiet;
    s.row(3).setConstant(glare);
    ASSERT_TRUE(relighter.setLight(s));
    s.row(5).setConstant(2);
    ASSERT_TRUE(relighter.setLight(s));
    ASSERT_TRUE(relighter.setLight(quiet));
    expectSame(pictureOf(relighter).values(), reference(relighter.model(), quiet));
  }
}

// Reads 16 bits as a half float, by its definition.
double halfAt(const std::byte* at) {
  std::uint16_t bits;
  std::memcpy(&bits, at, 2);
  const int exponent = bits >> 10 & 31;
  const double fraction = (bits & 1023) / 1024.0;
  const double size = exponent == 0    ? std::ldexp(fraction, -14)
                      : exponent == 31 ? std::numeric_limits<double>::infinity()
                                       : std::ldexp(1 + fraction, exponent - 15);
  return bits >> 15 ? -size : size;
}

TEST_F(Relighting, HalvesAreTheFloatsToElevenBits) {
  onEveryTarget([] {
    for (const int blockSize : {16, 7}) {
      Relighter relighter = relighterOf(randomModel(50, 33, blockSize, 9, 23, 36));
      ASSERT_TRUE(relighter.setLight(randomIntensities(9, 37, 9)));
      for (const float exposure : {1.0f, 1e5f}) {
        RenderOptions options;
        options.exposure = exposure;
        const RadianceImage floats = pictureOf(relighter, options);
        for (const int channels : {3, 4}) {
          const std::size_t pixelBytes = static_cast<std::size_t>(channels) * 2;
          const std::size_t stride = 50 * pixelBytes + 6;
          std::vector<std::byte> halves(33 * stride, std::byte{0x55});
          relighter.renderHalf(halves, stride, channels, options);
          bool clamped = false;
          for (std::size_t y = 0; y < 33; ++y) {
            for (std::size_t x = 0; x < 50; ++x) {
              const std::byte* const pixel = halves.data() + y * stride + x * pixelBytes;
              for (std::size_t c = 0; c < 3; ++c) {
                const double exact = double{floats.row(static_cast<int>(y))[3 * x + c]};
                const double held = std::clamp(exact, -65504.0, 65504.0);
                clamped = clamped || held != exact;
                // The last of 11 bits, 2^-24 where halves are subnormal: machines without an
                // instruction for it cut instead of rounding.
                ASSERT_NEAR(halfAt(pixel + 2 * c), held,
                            std::max(std::abs(held) * 0x1p-10, 0x1p-24));
              }
              if (channels == 4) {
                ASSERT_EQ(halfAt(pixel + 6), 1);
              }
            }
            // What is between the lines stays as it was.
            for (std::size_t i = 50 * pixelBytes; i < stride; ++i) {
              ASSERT_EQ(halves[y * stride + i], std::byte{0x55});
            }
          }
          EXPECT_EQ(clamped, exposure > 1);
        }
      }
    }
  });
}

TEST_F(Relighting, EightBitsAreWithinALevelOfExactSrgb) {
  onEveryTarget([] {
    // One basis whose pixels go through every brightness, in steps of a 60th of a level at most,
    // from below black to above white.
    constexpr int kWidth = 256, kHeight = 128;
    RelightableModel model = randomModel(kWidth, kHeight, 16, 1, 1, 38);
    Factors factors;
    factors.layout = model.layout;
    const Eigen::Index blocks = factors.layout.blocks();
    for (Eigen::Index j = 0; j <= blocks; ++j) factors.blockOffset.push_back(j);
    factors.E.resize(blocks, 256);
    const double count = static_cast<double>(blocks * 256);
    for (Eigen::Index i = 0; i < blocks * 256; ++i) {
      const double level = -0.01 + 1.03 * static_cast<double>(i) / count;
      factors.E.data()[i] = srgbDecode(static_cast<float>(level));
    }
    factors.E.data()[0] = -1e30f;
    factors.E.data()[1] = 1e30f;
    factors.U = RowMajorMatrixf::Ones(blocks, 1);
    factors.V = RowMajorMatrixf::Ones(1, 3);
    setFactors(model, factors, Storage::kFloat32);
    Relighter relighter = relighterOf(model);
    ASSERT_TRUE(relighter.setLight(LightIntensities::Ones(1, 3)));

    const RadianceImage floats = pictureOf(relighter);
    // Aligned and not, with room between the lines and not.
    for (const std::size_t offset : {0, 4, 64}) {
      const std::size_t stride = kWidth * 4 + offset;
      FactorValues memory(ElementType::kInt8, kHeight * stride + offset);
      std::fill(memory.data(), memory.data() + memory.bytes(), std::byte{0x55});
      const std::span<std::byte> pixels(memory.data() + offset, kHeight * stride);
      relighter.renderBgra8(pixels, stride);
      std::size_t off = 0;
      for (std::size_t y = 0; y < kHeight; ++y) {
        for (std::size_t x = 0; x < kWidth; ++x) {
          const std::byte* const pixel = pixels.data() + y * stride + 4 * x;
          for (std::size_t c = 0; c < 3; ++c) {
            const int exact = srgbEncode8(floats.row(static_cast<int>(y))[3 * x + c]);
            const int drawn = static_cast<int>(pixel[2 - c]);
            ASSERT_LE(std::abs(drawn - exact), 1) << exact;
            off += drawn != exact ? 1 : 0;
          }
          ASSERT_EQ(pixel[3], std::byte{255});
        }
        for (std::size_t i = kWidth * 4; i < stride; ++i) {
          ASSERT_EQ(pixels[y * stride + i], std::byte{0x55});
        }
      }
      // The approximation is 0.12 levels off at most, with square roots of 12 bits 0.3.
      EXPECT_LT(static_cast<double>(off), 0.3 * kWidth * kHeight * 3);
    }
  });
}

TEST_F(Relighting, ColoursGoToTheirBytes) {
  onEveryTarget([] {
    for (const int width : {32, 31}) {
      RelightableModel model = randomModel(width, 16, 16, 1, 1, 39);
      Factors factors;
      factors.layout = model.layout;
      factors.blockOffset = {0, 1, 2};
      factors.E = RowMajorMatrixf::Ones(2, 256);
      factors.U = RowMajorMatrixf::Ones(2, 1);
      factors.V.resize(1, 3);
      factors.V << 1.0f, 0.2158605f, 0.0f;  // levels 255, 128 and 0
      setFactors(model, factors, Storage::kFloat32);
      Relighter relighter = relighterOf(model);
      ASSERT_TRUE(relighter.setLight(LightIntensities::Ones(1, 3)));
      const auto bytes = static_cast<std::size_t>(width) * 4;
      std::vector<std::byte> pixels(16 * bytes);
      relighter.renderBgra8(pixels, bytes);
      for (std::size_t i = 0; i < pixels.size(); i += 4) {
        ASSERT_EQ(pixels[i], std::byte{0});
        ASSERT_NEAR(static_cast<int>(pixels[i + 1]), 128, 1);
        ASSERT_EQ(pixels[i + 2], std::byte{255});
        ASSERT_EQ(pixels[i + 3], std::byte{255});
      }
    }
  });
}

TEST_F(Relighting, OnlyBlocksThatAreVisibleAreWritten) {
  for (const int blockSize : {16, 10}) {
    Relighter relighter = relighterOf(randomModel(150, 90, blockSize, 9, 23, 40));
    ASSERT_TRUE(relighter.setLight(randomIntensities(9, 41, 9)));
    const RadianceImage whole = pictureOf(relighter);
    const PixelRectangle rectangles[] = {{0, 0, 150, 90},
                                         {0, 0, 1, 1},
                                         {149, 89, 1, 1},
                                         {33, 17, 40, 30},
                                         {16, 16, 16, 16},
                                         {-50, -50, 70, 70},
                                         {140, 80, 99, 99},
                                         {-10, 40, 500, 1},
                                         {50, 50, 0, 10},
                                         {50, 50, 10, -5},
                                         {150, 0, 10, 10},
                                         {-20, 0, 20, 90},
                                         {2147483647, 0, 5, 5},
                                         {-2147483647, 0, 2147483647, 90},
                                         {3, 5, 2147483647, 2147483647}};
    for (const PixelRectangle& visible : rectangles) {
      SCOPED_TRACE(testing::Message() << visible.x << ' ' << visible.y << ' ' << visible.width
                                      << ' ' << visible.height);
      RenderOptions options;
      options.visible = visible;
      const RadianceImage part = pictureOf(relighter, options, -77);
      const auto touches = [&](int pixel, std::int64_t from, std::int64_t extent, int limit) {
        const std::int64_t block = pixel / blockSize * blockSize;
        return block < std::min<std::int64_t>(from + extent, limit) &&
               std::max<std::int64_t>(from, 0) < block + blockSize && extent > 0 && from < limit &&
               from + extent > 0;
      };
      for (int y = 0; y < 90; ++y) {
        for (int x = 0; x < 150; ++x) {
          const bool drawn = touches(x, visible.x, visible.width, 150) &&
                             touches(y, visible.y, visible.height, 90);
          for (int c = 0; c < 3; ++c) {
            // To the bit: however the picture is cut, a block is summed in the same order.
            ASSERT_EQ(part(x, y, c), drawn ? whole(x, y, c) : -77) << x << ' ' << y;
          }
        }
      }
    }
  }
}

TEST_F(Relighting, WhatDoesNotFitIsAMistakeOfTheCaller) {
  Relighter relighter = relighterOf(randomModel(32, 16, 16, 4, 3, 42));
  std::vector<std::byte> pixels(32 * 16 * 4);
  EXPECT_NO_THROW(relighter.renderBgra8(pixels, 128));
  EXPECT_THROW(relighter.renderBgra8(pixels, 124), std::logic_error);
  EXPECT_THROW(relighter.renderBgra8(pixels, 132), std::logic_error);
  EXPECT_THROW(relighter.renderBgra8(std::span(pixels).subspan(1), 126), std::logic_error);
  EXPECT_THROW(relighter.renderHalf(pixels, 256, 4), std::logic_error);
  EXPECT_THROW(relighter.renderHalf(pixels, 192, 2), std::logic_error);
  RadianceImage wrong(16, 32, 3);
  EXPECT_THROW(relighter.render(wrong), std::logic_error);
  for (const float share : {0.0f, -1.0f, 1.5f, std::numeric_limits<float>::quiet_NaN()}) {
    RenderOptions options;
    options.share = share;
    EXPECT_THROW(relighter.renderBgra8(pixels, 128, options), std::logic_error);
  }
}

}  // namespace
}  // namespace lightsketch
