#include "pipeline/compress/model.h"

#include <gtest/gtest.h>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <random>

#include "capture/frame/file.h"
#include "pipeline/compress/packed_code.h"
#include "tests/pipeline/compress/test_sketch.h"

namespace lightsketch {
namespace {

using testing::freshFolder;
using testing::randomLights;

// Six blocks, one of them without a basis picture; every number another.
RelightableModel someModel(Storage storage) {
  std::mt19937 random(1);
  std::normal_distribution<float> normal;
  const auto drawn = [&](Eigen::Index rows, Eigen::Index columns) {
    return RowMajorMatrixf(
        RowMajorMatrixf::NullaryExpr(rows, columns, [&] { return normal(random); }));
  };
  RelightableModel model;
  model.lights = randomLights(20, 2);
  model.solidAngles.assign(20, 0.25);
  Factors factors{
      {40, 25, 16}, {0, 3, 6, 6, 28, 35, 36}, drawn(36, 256), drawn(36, 7), drawn(7, 3 * 20)};
  factors.E(0, 0) = 0.249999f;  // rounds up into the next power of two
  factors.E(0, 1) = 1e-5f;      // subnormal as a half
  if (storage != Storage::kPacked) {
    setFactors(model, factors, storage);
  } else {
    auto code = std::make_shared<PackedCode>();
    code->layout = factors.layout;
    code->blockOffset = factors.blockOffset;
    code->rank = 7;
    code->lights = 20;
    const auto integers = [&](std::size_t count) {
      PackedCode::Numbers values(count);
      for (auto& value : values) value = foldSign(static_cast<int>(20 * normal(random)));
      return values;
    };
    const auto steps = [&](std::size_t count) {
      std::vector<float> values(count);
      for (auto& value : values) value = 0.001f + std::abs(normal(random));
      return values;
    };
    code->E = integers(256 * 36);
    code->U = integers(7 * 36);
    code->V = integers(3 * 7 * 20);
    code->stepE = steps(36);
    code->stepU = steps(7);
    code->stepV = steps(7);
    setPacked(model, std::move(code));
  }
  model.singleLamp = true;
  model.interpolation = {InterpolationSettings::Kernel::kCubic, 2, 1e-3, 0.5};
  model.holdOutRule = "every:8:4";
  model.heldOutIds = {4, 12};
  model.capturedIds = {0, 1, 2};
  model.capturedDirections = randomLights(3, 3);
  model.sketch = "büste";
  model.software = "lightsketch test";
  model.notes = {{"ratio", 12.5}};
  return model;
}

constexpr Storage kStorages[] = {Storage::kFloat32, Storage::kFloat16, Storage::kQ8,
                                 Storage::kPacked};

bool same(const StoredFactor& a, const StoredFactor& b) {
  return a.values.type() == b.values.type() && a.values.bytes() == b.values.bytes() &&
         std::memcmp(a.values.data(), b.values.data(), a.values.bytes()) == 0 && a.scale == b.scale;
}

// Directions are kept as floats.
double farthest(const std::vector<Eigen::Vector3d>& a, const std::vector<Eigen::Vector3d>& b) {
  double result = a.size() == b.size() ? 0 : 2;
  for (std::size_t i = 0; i < std::min(a.size(), b.size()); ++i)
    result = std::max(result, (a[i] - b[i]).norm());
  return result;
}

std::string bytesOf(const std::filesystem::path& path) { return *readFile(path); }

void write(const std::filesystem::path& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary) << bytes;
}

TEST(Model, KeepsItsNumbersAsWellAsTheirStorageCan) {
  const Factors truth = factorsOf(someModel(Storage::kFloat32));
  EXPECT_EQ(truth.blockOffset, (std::vector<std::int64_t>{0, 3, 6, 6, 28, 35, 36}));
  for (const Storage storage : {Storage::kFloat16, Storage::kQ8}) {
    const Factors kept = factorsOf(someModel(storage));
    // Half floats carry 11 bits; below 6e-5 their step is 6e-8.
    const float half = std::ldexp(1.0f, -11);
    const auto worst = [half](const RowMajorMatrixf& a, const RowMajorMatrixf& b) {
      return ((a - b).cwiseAbs() - half * a.cwiseAbs()).maxCoeff();
    };
    EXPECT_LE(worst(truth.U, kept.U), 1e-7f);
    EXPECT_LE(worst(truth.V, kept.V), 1e-7f);
    if (storage == Storage::kFloat16) {
      EXPECT_LE(worst(truth.E, kept.E), 1e-7f);
    } else {
      // Half a step of 1 / 127 of the row's largest, and rounding.
      for (Eigen::Index r = 0; r < truth.E.rows(); ++r) {
        EXPECT_LE((truth.E - kept.E).row(r).cwiseAbs().maxCoeff(),
                  0.5001f / 127 * truth.E.row(r).cwiseAbs().maxCoeff());
      }
    }
  }
}

TEST(Model, ComesBackFromAFileAsItWas) {
  for (const Storage storage : kStorages) {
    const auto path = freshFolder("model.lsd");
    const auto model = someModel(storage);
    const auto saved = saveModel(model, path);
    ASSERT_TRUE(saved) << saved.error().message;
    EXPECT_EQ(std::filesystem::file_size(path), *savedBytes(model));
    // What is not the factors: bookkeeping, scales and directions, 6 kB.
    EXPECT_LT(std::filesystem::file_size(path), model.factorBytes() + 6000) << nameOf(storage);
    const auto loaded = loadModel(path);
    ASSERT_TRUE(loaded) << loaded.error().message;
    EXPECT_TRUE(same(loaded->E, model.E)) << nameOf(storage);
    EXPECT_TRUE(same(loaded->U, model.U)) << nameOf(storage);
    EXPECT_TRUE(same(loaded->V, model.V)) << nameOf(storage);
    EXPECT_EQ(loaded->storage, storage);
    EXPECT_TRUE(loaded->singleLamp);
    EXPECT_EQ(loaded->rank, 7);
    EXPECT_EQ(loaded->layout.width, 40);
    EXPECT_EQ(loaded->layout.height, 25);
    EXPECT_EQ(loaded->layout.blockSize, 16);
    EXPECT_EQ(loaded->blockOffset, model.blockOffset);
    EXPECT_LT(farthest(loaded->lights, model.lights), 1e-7);
    EXPECT_EQ(loaded->solidAngles, model.solidAngles);  // 0.25 is a float
    EXPECT_EQ(loaded->interpolation.kernel, model.interpolation.kernel);
    EXPECT_EQ(loaded->interpolation.trendDegree, 2);
    EXPECT_EQ(loaded->interpolation.nugget, 1e-3);
    EXPECT_EQ(loaded->interpolation.outsideClamp, 0.5);
    EXPECT_EQ(loaded->holdOutRule, model.holdOutRule);
    EXPECT_EQ(loaded->heldOutIds, model.heldOutIds);
    EXPECT_EQ(loaded->capturedIds, model.capturedIds);
    EXPECT_LT(farthest(loaded->capturedDirections, model.capturedDirections), 1e-7);
    EXPECT_EQ(loaded->sketch, model.sketch);
    EXPECT_EQ(loaded->software, model.software);
    EXPECT_EQ(loaded->notes, model.notes);
  }
}

// Factors larger than one piece of the checksum, so that pieces begin and end inside them.
TEST(Model, LargeFactorsComeBackThroughSeveralPieces) {
  RelightableModel model = someModel(Storage::kQ8);
  std::mt19937 random(5);
  std::normal_distribution<float> normal;
  const Eigen::Index rows = 24000;
  Factors factors{{6400, 16, 16}, {}, RowMajorMatrixf(rows, 256), RowMajorMatrixf(rows, 7), {}};
  for (int j = 0; j <= 400; ++j) factors.blockOffset.push_back(60 * j);
  factors.E = factors.E.NullaryExpr(rows, 256, [&] { return normal(random); });
  factors.U = factors.U.NullaryExpr(rows, 7, [&] { return normal(random); });
  factors.V = RowMajorMatrixf::NullaryExpr(7, 60, [&] { return normal(random); });
  setFactors(model, factors, Storage::kQ8);
  const auto path = freshFolder("model.lsd");
  ASSERT_TRUE(saveModel(model, path));
  const auto loaded = loadModel(path);
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_TRUE(same(loaded->E, model.E));
  EXPECT_TRUE(same(loaded->U, model.U));
  EXPECT_TRUE(same(loaded->V, model.V));
}

// Written by the program that knew version 1 only; the numbers were read from it with h5dump.
TEST(Model, FilesOfVersion1AreRead) {
  const auto loaded = loadModel(LIGHTSKETCH_SOURCE_DIR "/tests/pipeline/compress/version1.lsd");
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_EQ(loaded->layout.width, 20);
  EXPECT_EQ(loaded->lightCount(), 6);
  EXPECT_EQ(loaded->storage, Storage::kFloat16);
  EXPECT_EQ(loaded->blockOffset, (std::vector<std::int64_t>{0, 3, 6, 9, 12, 15, 18}));
  const Factors factors = factorsOf(*loaded);
  EXPECT_NEAR(factors.E(12, 20), -0.185547f, 1e-6);  // as printed
  EXPECT_NEAR(factors.U(3, 2), -0.366211f, 1e-6);    // as printed
  EXPECT_NEAR(factors.V(4, 17), -0.161011f, 1e-6);   // as printed
}

TEST(Model, WithNothingHeldOutComesBackToo) {
  const auto path = freshFolder("model.lsd");
  auto model = someModel(Storage::kFloat32);
  model.heldOutIds.clear();
  model.holdOutRule.clear();
  ASSERT_TRUE(saveModel(model, path));
  const auto loaded = loadModel(path);
  ASSERT_TRUE(loaded) << loaded.error().message;
  EXPECT_TRUE(loaded->heldOutIds.empty());
  EXPECT_EQ(loaded->holdOutRule, "");
}

TEST(Model, DamageIsSeenBeforeTheFileIsUsed) {
  const auto path = freshFolder("model.lsd");
  for (const Storage storage : kStorages) {
    ASSERT_TRUE(saveModel(someModel(storage), path));
    const std::string whole = bytesOf(path);
    const auto expectRefused = [&](const std::string& bytes, const std::string& what) {
      write(path, bytes);
      const auto loaded = loadModel(path);
      ASSERT_FALSE(loaded) << what;
      EXPECT_EQ(loaded.error().code, ErrorCode::kCorrupt) << what;
      EXPECT_NE(loaded.error().message.find("model.lsd"), std::string::npos);
      EXPECT_EQ(loaded.error().message.find('\n'), std::string::npos);
    };
    for (const std::size_t length :
         {std::size_t{0}, std::size_t{10}, std::size_t{1000}, std::size_t{1024}, std::size_t{1500},
          whole.size() / 2, whole.size() - 1}) {
      expectRefused(whole.substr(0, length), "cut to " + std::to_string(length));
    }
    expectRefused(whole + "x", "one byte more");
    std::mt19937 random(4);
    for (int k = 0; k < 40; ++k) {
      const std::size_t at =
          k < 4 ? static_cast<std::size_t>(10 * k) : 1024 + random() % (whole.size() - 1024);
      std::string flipped = whole;
      flipped[at] = static_cast<char>(flipped[at] ^ (1 << random() % 8));
      write(path, flipped);
      EXPECT_FALSE(loadModel(path)) << "byte " << at;
    }
  }
}

TEST(Model, OtherFilesAreRefusedInWords) {
  const auto path = freshFolder("model.lsd");
  EXPECT_EQ(loadModel(path).error().code, ErrorCode::kNotFound);
  write(path, "P6 2 2 255 ............");
  EXPECT_EQ(loadModel(path).error().code, ErrorCode::kCorrupt);
  ASSERT_TRUE(saveModel(someModel(Storage::kFloat16), path));
  std::string newer = bytesOf(path);
  newer[std::string("lightsketch-model ").size()] = '9';
  write(path, newer);
  const auto refused = loadModel(path);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kUnsupported);
  EXPECT_NE(refused.error().message.find("newer"), std::string::npos);
}

TEST(Model, IsNotSavedWhereItDoesNotFitOrCannotBe) {
  auto model = someModel(Storage::kFloat32);
  EXPECT_EQ(saveModel(model, "/nowhere/at/all/model.lsd").error().code, ErrorCode::kNotFound);
  model.solidAngles.pop_back();
  const auto path = freshFolder("model.lsd");
  EXPECT_EQ(saveModel(model, path).error().code, ErrorCode::kInvalidArgument);
  EXPECT_FALSE(std::filesystem::exists(path));
}

}  // namespace
}  // namespace lightsketch
