#include "pipeline/compress/model.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <random>

#include "capture/frame/file.h"
#include "tests/pipeline/compress/test_sketch.h"

namespace lightsketch {
namespace {

using testing::freshFolder;
using testing::randomLights;

RelightableModel someModel(Storage storage) {
  std::mt19937 random(1);
  std::normal_distribution<float> normal;
  const auto fill = [&](RowMajorMatrixf& matrix, Eigen::Index rows, Eigen::Index columns) {
    matrix = RowMajorMatrixf::NullaryExpr(rows, columns, [&] { return normal(random); });
  };
  RelightableModel model;
  model.layout = {40, 25, 16};
  model.blockOffset = {0, 3, 6, 8, 11, 14, 15};
  fill(model.E, 15, 256);
  fill(model.U, 15, 7);
  model.E(0, 0) = 0.249999f;  // rounds up into the next power of two
  model.E(0, 1) = 1e-5f;      // subnormal as a half
  fill(model.V, 7, 3 * 20);
  model.storage = storage;
  model.lights = randomLights(20, 2);
  model.solidAngles.assign(20, 0.25);
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

std::string bytesOf(const std::filesystem::path& path) { return *readFile(path); }

void write(const std::filesystem::path& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary) << bytes;
}

TEST(Model, ComesBackAsItWas) {
  for (const Storage storage : {Storage::kFloat32, Storage::kFloat16}) {
    const auto path = freshFolder("model.lsd");
    const auto model = someModel(storage);
    const auto saved = saveModel(model, path);
    ASSERT_TRUE(saved) << saved.error().message;
    EXPECT_LT(std::filesystem::file_size(path), 64u << 10);  // 6 kB of values and HDF5's own
    const auto loaded = loadModel(path);
    ASSERT_TRUE(loaded) << loaded.error().message;
    // Half floats carry 11 bits; below 6e-5 their step is 6e-8.
    const float tolerance = storage == Storage::kFloat32 ? 0.0f : std::ldexp(1.0f, -11);
    for (const auto& [a, b] :
         {std::pair(&model.E, &loaded->E), {&model.U, &loaded->U}, {&model.V, &loaded->V}}) {
      ASSERT_EQ(a->rows(), b->rows());
      ASSERT_EQ(a->cols(), b->cols());
      EXPECT_LE(((*a - *b).cwiseAbs() - tolerance * a->cwiseAbs()).maxCoeff(), 1e-7f);
    }
    EXPECT_EQ(loaded->storage, storage);
    EXPECT_EQ(loaded->layout.width, 40);
    EXPECT_EQ(loaded->layout.height, 25);
    EXPECT_EQ(loaded->layout.blockSize, 16);
    EXPECT_EQ(loaded->blockOffset, model.blockOffset);
    EXPECT_EQ(loaded->lights, model.lights);
    EXPECT_EQ(loaded->solidAngles, model.solidAngles);
    EXPECT_EQ(loaded->interpolation.kernel, model.interpolation.kernel);
    EXPECT_EQ(loaded->interpolation.trendDegree, 2);
    EXPECT_EQ(loaded->interpolation.nugget, 1e-3);
    EXPECT_EQ(loaded->interpolation.outsideClamp, 0.5);
    EXPECT_EQ(loaded->holdOutRule, model.holdOutRule);
    EXPECT_EQ(loaded->heldOutIds, model.heldOutIds);
    EXPECT_EQ(loaded->capturedIds, model.capturedIds);
    EXPECT_EQ(loaded->capturedDirections, model.capturedDirections);
    EXPECT_EQ(loaded->sketch, model.sketch);
    EXPECT_EQ(loaded->software, model.software);
    EXPECT_EQ(loaded->notes, model.notes);
  }
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
  ASSERT_TRUE(saveModel(someModel(Storage::kFloat32), path));
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
