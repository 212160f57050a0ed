#include "pipeline/compress/rate_distortion.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <Eigen/QR>
#include <cmath>
#include <random>

#include "pipeline/compress/compress.h"
#include "tests/pipeline/compress/test_sketch.h"

namespace lightsketch {
namespace {

using Eigen::Index;
using Eigen::MatrixXf;
using testing::freshFolder;
using testing::makeSketch;
using testing::psnrSrgb;
using testing::randomLights;
using testing::reconstruct;
using testing::renderBalls;

MatrixXf orthonormalRows(Index rows, Index columns, std::mt19937& random) {
  std::normal_distribution<float> normal;
  const MatrixXf drawn = MatrixXf::NullaryExpr(columns, rows, [&] { return normal(random); });
  return (Eigen::HouseholderQR<MatrixXf>(drawn).householderQ() * MatrixXf::Identity(columns, rows))
      .transpose();
}

// Twelve blocks of 8 x 8 pixels, five basis pictures each, 20 lights, rank 12; all of it random.
struct Known {
  Known() {
    std::mt19937 random(7);
    std::normal_distribution<float> normal;
    factors.layout = {32, 24, 8};
    for (Index j = 0; j <= 12; ++j) factors.blockOffset.push_back(5 * j);
    factors.E.resize(60, 64);
    for (Index j = 0; j < 12; ++j) factors.E.middleRows(5 * j, 5) = orthonormalRows(5, 64, random);
    factors.U = RowMajorMatrixf::NullaryExpr(60, 12, [&] { return normal(random); });
    factors.V = orthonormalRows(12, 60, random);
  }
  RateDistortion stages() const {
    std::vector<double> energy;
    for (Index r = 0; r < factors.U.rows(); ++r)
      energy.push_back(factors.U.row(r).cast<double>().squaredNorm());
    return {factors.layout, factors.blockOffset, factors.E, energy, factors.U, factors.V};
  }
  double distortion(const PackedCode& code) const {
    RelightableModel model;
    model.lights = randomLights(20, 1);
    setPacked(model, std::make_shared<const PackedCode>(code));
    return distortion(factorsOf(model));
  }
  double distortion(const Factors& decoded) const {
    double sum = 0;
    for (std::size_t j = 0; j < 12; ++j) {
      const auto block = [j](const Factors& f) {
        const auto from = f.blockOffset[j];
        const auto rows = f.blockOffset[j + 1] - from;
        return MatrixXf(f.E.middleRows(from, rows).transpose() *
                        (f.U.middleRows(from, rows) * f.V));
      };
      sum += static_cast<double>((block(factors) - block(decoded)).squaredNorm());
    }
    return sum;
  }
  Factors factors;
};

TEST(PackedCode, DctIsOrthonormalAndStartsWithTheMean) {
  const RowMajorMatrixf dct = dctMatrix(8);
  EXPECT_LT((dct * dct.transpose() - MatrixXf::Identity(64, 64)).cwiseAbs().maxCoeff(), 1e-6f);
  EXPECT_LT((dct.row(0).array() - 0.125f).abs().maxCoeff(), 1e-6f);
  // Then the two of one half-wave: horizontal before vertical.
  EXPECT_NEAR(dct(1, 0), dct(1, 8), 1e-6);
  EXPECT_NEAR(dct(2, 0), dct(2, 1), 1e-6);
}

TEST(PackedCode, SignsUnfold) {
  for (int value = -32767; value <= 32767; ++value) ASSERT_EQ(unfoldSign(foldSign(value)), value);
  EXPECT_EQ(foldSign(-1), 1);
  EXPECT_EQ(foldSign(1), 2);
}

// The definition of noise. Rounding with a dead zone of 0.2 makes 1/12 + 0.04 of a step's square
// where numbers are large, and steps are rounded to quarters of an octave; fitting again takes some
// back.
TEST(RateDistortion, EveryNumberAddsTheNoise) {
  const Known known;
  const auto stages = known.stages();
  const double numbers = 60 * 64 + 60 * 12 + 0.5 * 12 * 60;
  for (const double noise : {1e-5, 1e-4}) {
    const double each = known.distortion(*stages.encode(noise)) / numbers;
    fmt::print("noise {:.0e}: {:.2e} per number\n", noise, each);
    EXPECT_GT(each, 0.6 * noise);
    EXPECT_LT(each, 1.7 * noise);
  }
}

// E's numbers of strong rows are rounded more finely, by the square root of their energy.
TEST(RateDistortion, StepsBuyTheSameEverywhere) {
  const Known known;
  const auto code = known.stages().encode(1e-4);
  ASSERT_EQ(code->rows(), 60u);
  const auto order = packedRowOrder(code->blockOffset);
  for (std::size_t i = 0; i < code->rows(); ++i) {
    const double energy =
        static_cast<double>(known.factors.U.row(static_cast<Index>(order[i])).squaredNorm());
    const double noise = std::pow(code->stepE[i], 2) / 12 * energy;
    EXPECT_NEAR(std::log2(noise / 1e-4), 0, 0.26) << i;  // an eighth of an octave of the step
  }
  for (const float step : code->stepU) EXPECT_NEAR(step, std::sqrt(12e-4f), 1e-6f);
}

TEST(RateDistortion, WhatIsNotWorthItsBitsIsDropped) {
  const Known known;
  const auto stages = known.stages();
  const auto fine = stages.encode(1e-5);
  const auto coarse = stages.encode(0.05);
  EXPECT_EQ(fine->rank, 12);
  EXPECT_LT(coarse->rank, 12);
  EXPECT_LT(coarse->rows(), fine->rows());
  const auto nothing = stages.encode(1e6);
  EXPECT_EQ(nothing->rows(), 1u);  // of zeros
  EXPECT_NEAR(known.distortion(*nothing), known.factors.U.cast<double>().squaredNorm(), 1e-2);
}

// Of a quantity that falls smoothly: within the window, from either side, in few trials.
TEST(RateDistortion, SearchEndsInTheWindow) {
  for (const double start : {1e-6, 1e-3, 2.0}) {
    int trials = 0;
    const auto bytes = [&](double noise) -> Result<double> {
      ++trials;
      return 20 - 0.7 * std::log2(noise) + 0.01 * std::pow(std::log2(noise), 2);
    };
    const auto found = noiseFor({29.98, 30, 0.5, false}, start, 1e-6, 8, bytes);
    ASSERT_TRUE(found);
    const double reached = bytes(*found).value();
    EXPECT_GE(reached, 29.98);
    EXPECT_LE(reached, 30);
    EXPECT_LE(trials, 9);
  }
}

// Where the quantity jumps across the window: to the side that was asked for.
TEST(RateDistortion, SearchEndsAtTheEdgeOfAJump) {
  const auto jump = [](double noise) -> Result<double> { return noise < 0.3 ? 40 : 20; };
  const double above = noiseFor({29.9, 30, 0.5, false}, 1e-6, 1e-6, 8, jump).value();
  EXPECT_GE(above, 0.3);
  EXPECT_LE(above, 0.3 * std::exp2(1.0 / 32));
  const double below = noiseFor({29.9, 30, 0.5, true}, 1e-6, 1e-6, 8, jump).value();
  EXPECT_LT(below, 0.3);
  EXPECT_GE(below, 0.3 * std::exp2(-1.0 / 32));
}

TEST(RateDistortion, SearchEndsAtItsBounds) {
  const auto much = [](double) -> Result<double> { return 40; };
  const auto little = [](double) -> Result<double> { return 10; };
  EXPECT_NEAR(noiseFor({29, 30, 1, true}, 0.1, 1e-6, 8, much).value(), 8, 1e-9);
  // To the last bit: who searches on with finer stages asks whether the noise is the finest.
  for (const double finest : {1e-6, 3.3e-5, 0.7e-3, 1.0 / 3})
    EXPECT_EQ(noiseFor({29, 30, 1, true}, 0.4, finest, 8, little).value(), finest);
}

class Targets : public ::testing::Test {
 protected:
  Targets()
      : sketch_(
            makeSketch(freshFolder("sketch"), 120, 90, randomLights(40, 3),
                       [](const Eigen::Vector3d& light) { return renderBalls(120, 90, light); })) {}
  CompressResult made(CompressOptions options) const {
    options.densify = CompressOptions::kDensifyOff;
    SilentProgress progress;
    auto result = compress(sketch_, options, progress);
    if (!result) throw std::runtime_error(result.error().message);
    return std::move(*result);
  }
  std::size_t saved(const RelightableModel& model) const {
    const auto path = freshFolder("saved.lsd");
    if (auto done = saveModel(model, path); !done) throw std::runtime_error(done.error().message);
    return std::filesystem::file_size(path);
  }
  Sketch sketch_;
};

TEST_F(Targets, QualitiesRiseInBytesAndDecibels) {
  double bytes = 0;
  double psnr = 0;
  for (const Quality quality : {Quality::kSmall, Quality::kStandard, Quality::kArchive}) {
    const auto [model, summary] = made({.quality = quality});
    EXPECT_GT(static_cast<double>(saved(model)), 1.15 * bytes) << nameOf(quality);
    EXPECT_GT(summary.error->srgbPsnr, psnr + 0.5) << nameOf(quality);
    bytes = static_cast<double>(saved(model));
    psnr = summary.error->srgbPsnr;
  }
}

TEST_F(Targets, BudgetIsKeptAndUsed) {
  for (const std::uint64_t budget : {20'000u, 60'000u}) {
    const auto bytes = saved(made({.budgetBytes = budget}).model);
    EXPECT_LE(bytes, budget);
    EXPECT_GE(static_cast<double>(bytes), 0.98 * static_cast<double>(budget));
  }
  SilentProgress progress;
  const auto tooLittle = compress(sketch_, {.budgetBytes = 2000}, progress);
  ASSERT_FALSE(tooLittle);
  EXPECT_NE(tooLittle.error().message.find("smallest"), std::string::npos);
}

// One lit block of 300: a row's worth of noise is far above the picture's mean energy.
TEST(Budget, IsKeptWhereAllTheEnergyIsInOneBlock) {
  const auto lights = randomLights(40, 3);
  const auto lit = [](const Eigen::Vector3d& light) {
    RadianceImage picture(320, 240, 3);
    const RadianceImage balls = renderBalls(16, 16, light);
    for (int y = 0; y < 16; ++y) {
      for (int x = 0; x < 16; ++x) {
        for (int c = 0; c < 3; ++c) picture(160 + x, 112 + y, c) = balls(x, y, c);
      }
    }
    return picture;
  };
  const Sketch sketch = makeSketch(freshFolder("sketch"), 320, 240, lights, lit);
  SilentProgress progress;
  const auto small = [&](std::uint64_t budget) {
    return compress(sketch, {.budgetBytes = budget, .densify = CompressOptions::kDensifyOff},
                    progress);
  };
  const auto tooLittle = small(100);
  ASSERT_FALSE(tooLittle);
  const std::string words = tooLittle.error().message;
  EXPECT_NE(words.find("smallest"), std::string::npos);
  const auto least = std::stoull(words.substr(words.find("takes ") + 6));
  double first = 0;
  double psnr = 0;
  for (const std::uint64_t budget : {least + 64, least + 500, least + 1500, least + 4000}) {
    const auto made = small(budget);
    ASSERT_TRUE(made) << budget << ": " << made.error().message;
    const auto path = freshFolder("saved.lsd");
    ASSERT_TRUE(saveModel(made->model, path));
    EXPECT_LE(std::filesystem::file_size(path), budget);
    fmt::print("{} bytes: {:.2f} dB, {} rows\n", budget, made->summary.error->srgbPsnr,
               made->summary.rows);
    // Two searches may end a little apart on one and the same step of so small a file.
    EXPECT_GE(made->summary.error->srgbPsnr, psnr - 0.01);
    psnr = made->summary.error->srgbPsnr;
    if (first == 0) first = psnr;
  }
  EXPECT_GT(psnr, first + 5);
}

// A tenth of a decibel is what the search is content with, a 256th of an octave of noise at most
// another.
TEST_F(Targets, PsnrIsKeptAndNotExceededMuch) {
  const auto [model, summary] = made({.psnr = 36});
  EXPECT_GE(summary.error->srgbPsnr, 36);
  EXPECT_LT(summary.error->srgbPsnr, 36.25);
  SilentProgress progress;
  const auto tooMuch = compress(sketch_, {.psnr = 99}, progress);
  ASSERT_FALSE(tooMuch);
  EXPECT_NE(tooMuch.error().message.find("reaches"), std::string::npos);
}

TEST_F(Targets, MeasuredErrorIsThatOfTheModelAsLoaded) {
  const auto [model, summary] = made({});
  const auto path = freshFolder("loaded.lsd");
  ASSERT_TRUE(saveModel(model, path));
  const auto loaded = loadModel(path);
  ASSERT_TRUE(loaded);
  EXPECT_EQ(loaded->notes.at("error").at("srgbPsnr").get<double>(), summary.error->srgbPsnr);
  ASSERT_EQ(summary.error->pictures, 40);
  double psnr = 0;
  for (int i = 0; i < 40; ++i) {
    Eigen::VectorXf s = Eigen::VectorXf::Zero(120);
    s.segment(3 * i, 3).setOnes();
    psnr += psnrSrgb(reconstruct(*loaded, s), LightStack::create(sketch_, {i})->read(0).value());
  }
  EXPECT_NEAR(summary.error->srgbPsnr, psnr / 40, 0.002);  // pixels that rounding turns over
}

}  // namespace
}  // namespace lightsketch
