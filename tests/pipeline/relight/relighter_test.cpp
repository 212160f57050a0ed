#include "pipeline/relight/relighter.h"

#include <gtest/gtest.h>

#include <random>

namespace lightsketch {
namespace {

// Random factors with a varying rank per block.
RelightableModel randomModel(int width, int height, int blockSize, int lights, int rank, int seed) {
  std::mt19937 random(static_cast<unsigned>(seed));
  std::normal_distribution<float> normal;
  RelightableModel model;
  model.layout = {width, height, blockSize};
  model.blockOffset = {0};
  for (int j = 0; j < model.layout.blocks(); ++j) {
    model.blockOffset.push_back(model.blockOffset.back() + static_cast<int>(random() % 5));
  }
  const auto fill = [&](RowMajorMatrixf& m, Eigen::Index rows, Eigen::Index cols) {
    m = RowMajorMatrixf::NullaryExpr(rows, cols, [&] { return normal(random); });
  };
  fill(model.E, model.blockOffset.back(), model.layout.pixelsPerBlock());
  fill(model.U, model.blockOffset.back(), rank);
  fill(model.V, rank, 3 * lights);
  model.lights.assign(static_cast<std::size_t>(lights), Eigen::Vector3d::UnitZ());
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

// E^T (U (V s)) by its definition, pixel by pixel in double.
double reference(const RelightableModel& model, const LightIntensities& s, int x, int y, int c) {
  const BlockLayout& layout = model.layout;
  const int j = y / layout.blockSize * layout.columns() + x / layout.blockSize;
  const int pixel = y % layout.blockSize * layout.blockSize + x % layout.blockSize;
  double sum = 0;
  for (auto row = model.blockOffset[static_cast<std::size_t>(j)];
       row < model.blockOffset[static_cast<std::size_t>(j) + 1]; ++row) {
    for (int k = 0; k < model.rank(); ++k) {
      for (int i = 0; i < model.lightCount(); ++i) {
        sum += double{model.E(row, pixel)} * double{model.U(row, k)} *
               double{model.V(k, 3 * i + c)} * double{s(i, c)};
      }
    }
  }
  return sum;
}

void expectReference(const RelightableModel& model, const LightIntensities& s) {
  const auto picture = relight(model, s);
  ASSERT_TRUE(picture) << picture.error().message;
  ASSERT_EQ(picture->width(), model.layout.width);
  ASSERT_EQ(picture->height(), model.layout.height);
  ASSERT_EQ(picture->channels(), 3);
  double largest = 0;
  double worst = 0;
  for (int y = 0; y < picture->height(); ++y) {
    for (int x = 0; x < picture->width(); ++x) {
      for (int c = 0; c < 3; ++c) {
        const double truth = reference(model, s, x, y, c);
        largest = std::max(largest, std::abs(truth));
        worst = std::max(worst, std::abs(truth - double{(*picture)(x, y, c)}));
      }
    }
  }
  ASSERT_GT(largest, 1);
  EXPECT_LT(worst, 2e-6 * largest);  // float sums of some hundred terms: a few units of 6e-8 each
}

TEST(Relight, IsTheProductOfItsFactors) {
  expectReference(randomModel(32, 16, 8, 24, 19, 1), randomIntensities(24, 2, 24));
}

TEST(Relight, CropsPaddedBlocksAtTheRim) {
  expectReference(randomModel(21, 13, 8, 9, 7, 3), randomIntensities(9, 4, 9));
  expectReference(randomModel(3, 2, 16, 5, 3, 5), randomIntensities(5, 6, 5));
  expectReference(randomModel(11, 7, 5, 5, 6, 7), randomIntensities(5, 8, 5));
}

TEST(Relight, AFewLampsAmongManyGiveTheSameAsTheFullSum) {
  expectReference(randomModel(16, 16, 8, 100, 40, 9), randomIntensities(100, 10, 3));
}

TEST(Relight, EachColourOfLightFeedsItsOwnChannel) {
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

TEST(Relight, SumOfTwoLightsIsTheSumOfTheTwoPictures) {
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

TEST(Relight, NoLightIsBlack) {
  const auto picture = relight(randomModel(16, 16, 8, 4, 3, 15), LightIntensities::Zero(4, 3));
  ASSERT_TRUE(picture);
  for (const float value : picture->values()) EXPECT_EQ(value, 0);
}

TEST(Relight, RefusesLightsAndFactorsThatDoNotFit) {
  const RelightableModel good = randomModel(16, 16, 8, 4, 3, 16);
  const LightIntensities s = LightIntensities::Ones(4, 3);
  ASSERT_TRUE(relight(good, s));

  const auto wrongLights = relight(good, LightIntensities::Ones(5, 3));
  ASSERT_FALSE(wrongLights);
  EXPECT_EQ(wrongLights.error().message,
            "relight: 5 light intensities given, the model has 4 lights");

  const auto refuses = [&](auto change) {
    RelightableModel bad = good;
    change(bad);
    const auto result = relight(bad, s);
    return !result && result.error().code == ErrorCode::kInvalidArgument;
  };
  EXPECT_TRUE(refuses([](auto& m) { m.layout.width = 0; }));
  EXPECT_TRUE(refuses([](auto& m) { m.layout.width = 17; }));
  EXPECT_TRUE(refuses([](auto& m) { m.layout.blockSize = 0; }));
  EXPECT_TRUE(refuses([](auto& m) { m.blockOffset.pop_back(); }));
  EXPECT_TRUE(refuses([](auto& m) { m.blockOffset.clear(); }));
  EXPECT_TRUE(refuses([](auto& m) { m.blockOffset[1] = -1; }));
  EXPECT_TRUE(refuses([](auto& m) { m.blockOffset.back() += 1; }));
  EXPECT_TRUE(refuses([](auto& m) { m.U.conservativeResize(m.U.rows() - 1, m.U.cols()); }));
  EXPECT_TRUE(refuses([](auto& m) { m.U.conservativeResize(m.U.rows(), m.U.cols() + 1); }));
  EXPECT_TRUE(refuses([](auto& m) { m.E.conservativeResize(m.E.rows(), 63); }));
}

}  // namespace
}  // namespace lightsketch
