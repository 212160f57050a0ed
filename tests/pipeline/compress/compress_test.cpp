#include "pipeline/compress/compress.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <memory>
#include <numbers>

#include "pipeline/compress/factorise.h"
#include "pipeline/compress/large_matrix.h"
#include "pipeline/illumination/illumination.h"
#include "pipeline/illumination/light_grid.h"
#include "pipeline/sketch/import.h"
#include "pipeline/sketch/light_stack.h"
#include "tests/pipeline/compress/test_sketch.h"

namespace lightsketch {
namespace {

using Eigen::Vector3d;
using Eigen::VectorXf;
using testing::freshFolder;
using testing::makeSketch;
using testing::psnrSrgb;
using testing::randomLights;
using testing::reconstruct;
using testing::renderBalls;
using testing::rmsDifference;

Sketch ballSketch(int width, int height, const std::vector<Vector3d>& lights) {
  return makeSketch(freshFolder("sketch"), width, height, lights,
                    [=](const Vector3d& light) { return renderBalls(width, height, light); });
}

RadianceImage readFrame(const Sketch& sketch, int id) {
  return LightStack::create(sketch, {id})->read(0).value();
}

VectorXf onlyLight(const RelightableModel& model, int i) {
  VectorXf s = VectorXf::Zero(3 * model.lightCount());
  s.segment(3 * i, 3).setOnes();
  return s;
}

VectorXf intensitiesAt(const RelightableModel& model, const Vector3d& direction) {
  const VectorXf w = interpolatorFor(model)->weights(direction).cast<float>();
  VectorXf s(3 * model.lightCount());
  for (Eigen::Index i = 0; i < w.size(); ++i) s.segment(3 * i, 3).setConstant(w[i]);
  return s;
}

CompressResult compressed(const Sketch& sketch, const CompressOptions& options) {
  SilentProgress progress;
  auto result = compress(sketch, options, progress);
  if (!result) throw std::runtime_error(result.error().message);
  return std::move(*result);
}

double largestDifference(const RadianceImage& a, const RadianceImage& b) {
  double largest = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    largest = std::max(largest, std::abs(double{a.data()[i]} - double{b.data()[i]}));
  }
  return largest;
}

// Radiances up to 1; sums of up to 120 float products of that size round to some 1e-6.
TEST(Compress, GivesItsInputBackAtFullRank) {
  const auto lights = randomLights(40, 1);
  const auto sketch = ballSketch(50, 37, lights);  // blocks reach beyond the picture
  for (const int blockSize : {8, 16}) {            // more columns than pixels, and fewer
    const auto [model, summary] = compressed(sketch, {.blockSize = blockSize,
                                                      .blockRank = 0,
                                                      .rank = 0,
                                                      .storage = Storage::kFloat32,
                                                      .densify = 0});
    EXPECT_EQ(model.lights, lights);
    double worst = 0;
    for (int i = 0; i < 40; ++i) {
      worst = std::max(
          worst, largestDifference(reconstruct(model, onlyLight(model, i)), readFrame(sketch, i)));
    }
    fmt::print("full rank, blocks of {}: largest error {:.1e}\n", blockSize, worst);
    EXPECT_LT(worst, 5e-6);
    EXPECT_NEAR(summary.stage1Energy, 1, 1e-6);
    EXPECT_NEAR(summary.stage2Energy, 1, 1e-6);
  }
}

TEST(Compress, RowsOfEAreOrthonormalInEveryBlock) {
  const auto sketch = ballSketch(50, 37, randomLights(30, 2));
  const auto model = factorsOf(
      compressed(sketch,
                 {.blockRank = 10, .rank = 60, .storage = Storage::kFloat32, .densify = 300})
          .model);
  for (int j = 0; j < model.layout.blocks(); ++j) {
    const auto from = model.blockOffset[static_cast<std::size_t>(j)];
    const auto rows = model.blockOffset[static_cast<std::size_t>(j) + 1] - from;
    const Eigen::MatrixXf E = model.E.middleRows(from, rows);
    // Single precision eigenvectors of 256 values.
    EXPECT_LT((E * E.transpose() - Eigen::MatrixXf::Identity(rows, rows)).cwiseAbs().maxCoeff(),
              1e-4f)
        << j;
  }
}

// b = 10, q = 200 of 900 columns and 1440 rows: the randomised second stage against the exact one,
// on shadows and highlights, in the pictures it is there for.
TEST(Compress, RandomisedSecondStageIsWithinAFewHundredthsOfADecibel) {
  const auto grid = LightGrid::create(300);
  const auto sketch = ballSketch(192, 192, grid->directions());
  SilentProgress progress;
  // Block rank 10 and full rank keep L = U V to rounding; both methods then start from the same L.
  auto model =
      compressed(sketch, {.blockRank = 10, .rank = 0, .storage = Storage::kFloat32, .densify = 0})
          .model;
  Factors factors = factorsOf(model);
  const RowMajorMatrixf L = factors.U * factors.V;
  double psnr[2] = {0, 0};
  double error[2] = {0, 0};
  const SecondStageMethod methods[] = {SecondStageMethod::kExact, SecondStageMethod::kRandomised};
  for (int k = 0; k < 2; ++k) {
    auto stage = factoriseAll(LargeMatrix(L), 200, methods[k], progress);
    ASSERT_TRUE(stage);
    factors.U = std::move(stage->U);
    factors.V = std::move(stage->V);
    setFactors(model, factors, Storage::kFloat32);
    for (int i = 0; i < 300; i += 10) {
      const auto picture = reconstruct(model, onlyLight(model, i));
      const auto truth = readFrame(sketch, i);
      psnr[k] += psnrSrgb(picture, truth) / 30;
      error[k] += std::pow(rmsDifference(picture, truth), 2) / 30;
    }
  }
  const double linear = 10 * std::log10(error[1] / error[0]);
  fmt::print(
      "b = 10, q = 200: sRGB PSNR {:.3f} dB exact, {:.3f} dB randomised; linear PSNR {:.3f} dB "
      "lower\n",
      psnr[0], psnr[1], linear);
  EXPECT_LT(std::abs(psnr[0] - psnr[1]), 0.05);
  EXPECT_LT(linear, 0.05);
}

// s = intensities of a constant map of radiance 1 (lamp irradiance 1): the picture is the captures
// weighted by their cells, and the cells add up to what the lights cover.
TEST(Compress, ConstantEnvironmentIsTheSumOfCapturesByCells) {
  const auto lights = randomLights(60, 3);
  const auto sketch = ballSketch(32, 32, lights);
  const auto model =
      compressed(sketch, {.blockRank = 0, .rank = 0, .storage = Storage::kFloat32, .densify = 0})
          .model;
  const auto intensities =
      intensitiesOf(RadianceImage(64, 32, 3, 1.0f), model.lights, {.lampIrradiance = 1});
  ASSERT_TRUE(intensities);
  VectorXf s(180);
  RadianceImage sum(32, 32, 3);
  double covered = 0;
  for (int i = 0; i < 60; ++i) {
    const double cell = model.solidAngles[static_cast<std::size_t>(i)];
    covered += cell;
    s.segment(3 * i, 3) = intensities->row(i).transpose();
    const auto frame = readFrame(sketch, i);
    for (std::size_t k = 0; k < sum.size(); ++k)
      sum.data()[k] += static_cast<float>(cell) * frame.data()[k];
  }
  // Sums reach 2 pi times the largest radiance; 60 float terms.
  EXPECT_LT(largestDifference(reconstruct(model, s), sum), 3e-5);
  fmt::print("covered solid angle {:.3f} of 2 pi = {:.3f}\n", covered, 2 * std::numbers::pi);
  EXPECT_GT(covered, 0.9 * 2 * std::numbers::pi);
  EXPECT_LE(covered, 2 * std::numbers::pi * (1 + 1e-9));
}

TEST(Compress, SuperpositionHolds) {
  const auto sketch = ballSketch(48, 48, randomLights(30, 4));
  const auto model = compressed(sketch, {}).model;
  const VectorXf a = intensitiesAt(model, Vector3d(0.5, 0.1, 0.8).normalized());
  const VectorXf b = intensitiesAt(model, Vector3d(-0.3, -0.4, 0.9).normalized());
  const auto both = reconstruct(model, a + b);
  auto sum = reconstruct(model, a);
  const auto other = reconstruct(model, b);
  for (std::size_t k = 0; k < sum.size(); ++k) sum.data()[k] += other.data()[k];
  EXPECT_LT(largestDifference(both, sum), 5e-6);  // float sums over 200 terms
}

// Shadows and highlights take fewer basis pictures as square roots.
TEST(Compress, ASingleLampModelShowsOneLampBetter) {
  const auto lights = randomLights(60, 5, 0.3);
  const auto sketch = ballSketch(64, 64, lights);
  CompressOptions options{.blockRank = 4, .rank = 20};
  const auto linear = compressed(sketch, options);
  options.singleLamp = true;
  const auto roots = compressed(sketch, options);
  EXPECT_FALSE(linear.model.singleLamp);
  EXPECT_TRUE(roots.model.singleLamp);
  double psnrLinear = 0;
  double psnrRoots = 0;
  for (const auto& light : lights) {
    const auto truth = renderBalls(64, 64, light);
    psnrLinear +=
        psnrSrgb(reconstruct(linear.model, intensitiesAt(linear.model, light)), truth) / 60;
    auto picture = reconstruct(roots.model, intensitiesAt(roots.model, light));
    for (float& value : picture.values()) value = std::pow(std::max(value, 0.0f), 2.0f);
    psnrRoots += psnrSrgb(picture, truth) / 60;
  }
  fmt::print("one lamp: {:.2f} dB from square roots, {:.2f} dB linear\n", psnrRoots, psnrLinear);
  EXPECT_GT(psnrRoots, psnrLinear + 1);
  // The model's own measure squares, too.
  EXPECT_NEAR(roots.summary.error->srgbPsnr, psnrRoots, 0.1);
}

// Unseen lights: a densified model of 60 captures against the truth that only a renderer has, and
// against interpolating the same captures in linear light.
TEST(Compress, DensifiedModelsPredictUnseenLights) {
  const auto lights = randomLights(60, 5, 0.3);
  const auto sketch = ballSketch(64, 64, lights);
  const auto densified = compressed(sketch, {.blockRank = 0, .rank = 0}).model;
  const auto direct = compressed(sketch, {.blockRank = 0, .rank = 0, .densify = 0}).model;
  EXPECT_GT(densified.lights.size(), 300u);
  double psnrDensified = 0;
  double psnrDirect = 0;
  const auto queries = randomLights(40, 6, 0.5);
  for (const auto& query : queries) {
    const auto truth = renderBalls(64, 64, query);
    psnrDensified += psnrSrgb(reconstruct(densified, intensitiesAt(densified, query)), truth) / 40;
    psnrDirect += psnrSrgb(reconstruct(direct, intensitiesAt(direct, query)), truth) / 40;
  }
  fmt::print("unseen lights: {:.2f} dB densified, {:.2f} dB straight from the captures\n",
             psnrDensified, psnrDirect);
  EXPECT_GT(psnrDensified, psnrDirect + 0.2);
}

TEST(Compress, SceneThatIgnoresTheLightStaysConstant) {
  const auto sketch = makeSketch(freshFolder("sketch"), 20, 20, randomLights(12, 7),
                                 [](const Vector3d&) { return RadianceImage(20, 20, 3, 0.25f); });
  const auto model = compressed(sketch, {.rank = 200}).model;
  for (const auto& query : randomLights(10, 8, -0.5)) {
    const auto picture = reconstruct(model, intensitiesAt(model, query));
    // Through the encoded domain and its table, and half scratch: 0.25 is exact in both.
    EXPECT_LT(largestDifference(picture, RadianceImage(20, 20, 3, 0.25f)), 1e-4);
  }
}

// A lens cap left on: a model nevertheless, through a file too.
TEST(Compress, BlackPicturesMakeAModelThatDrawsBlack) {
  const auto lights = randomLights(12, 7);
  const auto sketch = makeSketch(freshFolder("sketch"), 40, 24, lights,
                                 [](const Vector3d&) { return RadianceImage(40, 24, 3, 0.0f); });
  for (const int densify : {CompressOptions::kDensifyAuto, CompressOptions::kDensifyOff}) {
    for (CompressOptions options :
         {CompressOptions{}, CompressOptions{.quality = Quality::kArchive},
          CompressOptions{.budgetBytes = 1'000'000}, CompressOptions{.psnr = 40},
          CompressOptions{.blockRank = 10, .rank = 20}, CompressOptions{.blockRank = 0, .rank = 0},
          CompressOptions{.storage = Storage::kQ8}, CompressOptions{.singleLamp = true}}) {
      options.densify = densify;
      const auto [model, summary] = compressed(sketch, options);
      const auto path = freshFolder("model.lsd");
      ASSERT_TRUE(saveModel(model, path)) << summary.setting;
      const auto loaded = loadModel(path);
      ASSERT_TRUE(loaded) << summary.setting << ": " << loaded.error().message;
      EXPECT_EQ(largestDifference(reconstruct(*loaded, intensitiesAt(*loaded, lights[0])),
                                  RadianceImage(40, 24, 3, 0.0f)),
                0)
          << summary.setting;
      EXPECT_GE(summary.rows, 1);
      EXPECT_TRUE(std::isfinite(summary.ratioStage1) && std::isfinite(summary.ratio));
      EXPECT_DOUBLE_EQ(summary.error->srgbPsnr, 100) << summary.setting;
    }
  }
}

TEST(Compress, ResultDependsOnlyOnItsInput) {
  const auto sketch = ballSketch(64, 40, randomLights(30, 9));
  const CompressOptions options{.blockRank = 8, .rank = 20};
  const auto first = compressed(sketch, options).model;
  const auto second = compressed(sketch, options).model;
  EXPECT_EQ(factorsOf(first).E, factorsOf(second).E);
  EXPECT_EQ(factorsOf(first).U, factorsOf(second).U);
  EXPECT_EQ(factorsOf(first).V, factorsOf(second).V);
  EXPECT_EQ(first.notes, second.notes);
}

TEST(Compress, HoldsOutWhatItIsTold) {
  const auto sketch = ballSketch(16, 16, randomLights(20, 10));
  const auto [model, summary] = compressed(sketch, {.holdOutRule = "every:8:4"});
  EXPECT_EQ(model.holdOutRule, "every:8:4");
  EXPECT_EQ(model.heldOutIds, (std::vector<int>{4, 12}));
  EXPECT_EQ(model.capturedIds.size(), 18u);
  EXPECT_EQ(summary.captures, 18);
  EXPECT_EQ(summary.heldOut, 2);
}

// m = 6 blocks of p = 256, n = 40: by hand.
TEST(Compress, RatiosAreThoseOfThePaper) {
  const auto sketch = ballSketch(48, 32, randomLights(40, 11));
  const auto summary = compressed(sketch, {.blockRank = 10, .rank = 15, .densify = 0}).summary;
  EXPECT_EQ(summary.rows, 60);
  EXPECT_DOUBLE_EQ(summary.ratioStage1, 6.0 * 256 * 120 / (60 * 256 + 60 * 120));
  EXPECT_DOUBLE_EQ(summary.ratio, 6.0 * 256 * 120 / (60 * 256 + 60 * 15 + 15 * 120));
  // In memory the 60 rows of U fill two panels of 32.
  EXPECT_EQ(summary.modelBytes, 2u * (60 * 256 + 64 * 15 + 15 * 120));
  EXPECT_NE(summary.describe().find("eq. 5"), std::string::npos);
}

// So few captures are smoothed by default, and a shadow's edge moves: the bar is low.
TEST(Compress, WorksWithOneTwoAndThreeLights) {
  for (int n = 1; n <= 3; ++n) {
    const auto lights = randomLights(n, 12, 0.5);
    const auto sketch = ballSketch(20, 20, lights);
    for (const int densify : {CompressOptions::kDensifyAuto, CompressOptions::kDensifyOff}) {
      const auto model =
          compressed(sketch, {.storage = Storage::kFloat32, .densify = densify}).model;
      const auto picture = reconstruct(model, intensitiesAt(model, lights[0]));
      EXPECT_GT(psnrSrgb(picture, readFrame(sketch, 0)), 20) << n;
    }
  }
}

class CancelAfter final : public Progress {
 public:
  explicit CancelAfter(int updates) : left_(updates) {}
  void update(std::string_view, std::size_t, std::size_t) override { --left_; }
  void warn(std::string_view) override {}
  bool cancelled() const override { return left_ <= 0; }

 private:
  std::atomic<int> left_;
};

TEST(Compress, StopsWhenAsked) {
  const auto sketch = ballSketch(64, 64, randomLights(20, 13));
  for (const int updates : {1, 10, 30, 40}) {  // reading, first stage, second stage
    CancelAfter progress(updates);
    const auto result = compress(sketch, {}, progress);
    ASSERT_FALSE(result) << updates;
    EXPECT_EQ(result.error().code, ErrorCode::kCancelled);
  }
}

TEST(Compress, RefusesNonsenseInWords) {
  const auto sketch = ballSketch(16, 16, randomLights(3, 14));
  SilentProgress progress;
  for (const CompressOptions& options :
       {CompressOptions{.blockSize = 1}, CompressOptions{.blockRank = -1},
        CompressOptions{.rank = -1}, CompressOptions{.holdOutRule = "some"},
        CompressOptions{.densify = 3},
        CompressOptions{.densify = CompressOptions::kDensifyOff,
        .surface = std::make_shared<const SurfacePoints>(16, 16, 3)},
        CompressOptions{.quality = Quality::kSmall, .budgetBytes = 10000},
        CompressOptions{.psnr = 40, .rank = 20}, CompressOptions{.psnr = -1},
        CompressOptions{.storage = Storage::kPacked}}) {
    const auto result = compress(sketch, options, progress);
    ASSERT_FALSE(result);
    EXPECT_EQ(result.error().code, ErrorCode::kInvalidArgument);
  }
  const auto result = compress(sketch, {.scratchFolder = "/nowhere"}, progress);
  ASSERT_FALSE(result);
  EXPECT_NE(result.error().message.find("/nowhere"), std::string::npos);
}

// A real set, with every eighth light held out. Interpolation in the encoded domain without any
// compression gives 32.5 dB; the best basis of RelightLab on all six such sets 29.2.
TEST(Compress, PredictsHeldOutLightsOfARealSet) {
  const std::filesystem::path folder = LIGHTSKETCH_SOURCE_DIR "/../shared/data/rti/realrti_item8";
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << folder << " is not here";
  SilentProgress progress;
  const auto path = freshFolder("sketch");
  ImportOptions import;
  import.folder = folder;
  import.out = path;
  ASSERT_TRUE(importSet(import, progress));
  const auto sketch = Sketch::open(path);
  ASSERT_TRUE(sketch);
  const auto [model, summary] =
      compressed(*sketch, {.blockRank = 32, .rank = 300, .holdOutRule = "every:8:4"});
  double psnr = 0;
  for (const int id : model.heldOutIds) {
    const auto& direction = sketch->frames()[static_cast<std::size_t>(id)].light.direction;
    psnr += psnrSrgb(reconstruct(model, intensitiesAt(model, direction)), readFrame(*sketch, id)) /
            static_cast<double>(model.heldOutIds.size());
  }
  fmt::print("RealRTI item 8, {} held out: {:.2f} dB\n{}", model.heldOutIds.size(), psnr,
             summary.describe());
  EXPECT_GT(psnr, 32.2);
}

}  // namespace
}  // namespace lightsketch
