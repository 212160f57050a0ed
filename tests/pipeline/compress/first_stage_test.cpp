#include "pipeline/compress/first_stage.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>
#include <oneapi/tbb/task_arena.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <fstream>
#include <memory>
#include <mutex>
#include <string>

#include "pipeline/compress/factorise.h"
#include "tests/pipeline/compress/test_sketch.h"

namespace lightsketch {
namespace {

using Eigen::Index;
using Eigen::Vector3d;

// Smooth waves that move with the light, and a hard edge: no low rank, nothing to read.
LightStack waves(int width, int height, int lights) {
  const auto directions = testing::randomLights(lights, 5);
  return LightStack::of(width, height, directions, [=](int i) -> Result<RadianceImage> {
    const Vector3d& light = directions[static_cast<std::size_t>(i)];
    RadianceImage image(width, height, 3);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const double phase = (0.1 + 0.4 * light.x()) * x + (0.2 + 0.3 * light.y()) * y;
        const bool lit = light.x() * x + light.y() * y > 0.2 * width;
        for (int c = 0; c < 3; ++c)
          image(x, y, c) = static_cast<float>((1.1 + std::sin(phase + c)) * (lit ? 1 : 0.2));
      }
    }
    return image;
  });
}

struct Set {
  std::unique_ptr<const LightStack> stack;  // the densifier refers to it
  BlockLayout layout;
  std::filesystem::path folder;
  ScratchStack scratch;
  Densifier densifier;
};

Set makeSet(int width, int height, int lights, int blockSize, bool densify = false) {
  SilentProgress progress;
  auto stack = std::make_unique<const LightStack>(waves(width, height, lights));
  const BlockLayout layout{width, height, blockSize};
  const auto folder = testing::freshFolder("scratch");
  std::filesystem::create_directories(folder);
  ScratchStack scratch = ScratchStack::create(*stack, layout, folder, progress).value();
  CompressOptions options;
  if (!densify) options.densify = CompressOptions::kDensifyOff;
  Densifier densifier = Densifier::create(*stack, scratch, layout, options, progress).value();
  return {std::move(stack), layout, folder, std::move(scratch), std::move(densifier)};
}

Result<FirstStage> firstStageOf(const Set& set, const RankRule& rule, std::size_t memoryBytes,
                                Progress& progress) {
  return firstStage(set.scratch, set.densifier, set.layout, rule, memoryBytes, progress);
}

constexpr std::size_t kMuch = std::size_t{1} << 30;

// A = E^T L for one block, straight from the pictures.
Eigen::MatrixXf blockOf(const Set& set, int block) {
  const int size = set.layout.blockSize;
  Eigen::MatrixXf A = Eigen::MatrixXf::Zero(size * size, 3 * set.stack->size());
  for (int i = 0; i < set.stack->size(); ++i) {
    const RadianceImage image = set.stack->read(i).value();
    for (int k = 0; k < size * size; ++k) {
      const int x = block % set.layout.columns() * size + k % size;
      const int y = block / set.layout.columns() * size + k / size;
      if (x >= image.width() || y >= image.height()) continue;
      for (int c = 0; c < 3; ++c) A(k, 3 * i + c) = static_cast<float>(Eigen::half(image(x, y, c)));
    }
  }
  return A;
}

TEST(ScratchStack, GivesEveryBlockBackUnderEveryLight) {
  const Set set = makeSet(37, 29, 21, 8);  // blocks that stick out, and a last batch that is short
  std::vector<std::uint16_t> halfs(21 * set.scratch.blockValues());
  for (int block = 0; block < set.layout.blocks(); ++block) {
    ASSERT_TRUE(set.scratch.read(block, halfs.data()));
    const Eigen::MatrixXf A = blockOf(set, block);
    for (Index i = 0; i < A.size(); ++i) {
      // To the bit, but for what older processors round differently.
      ASSERT_NEAR(static_cast<float>(
                      Eigen::numext::bit_cast<Eigen::half>(halfs[static_cast<std::size_t>(i)])),
                  A.data()[i], 1e-3f);
    }
  }
}

TEST(ScratchStack, SaysSoWhereThereIsNoRoom) {
  SilentProgress progress;
  const auto result =
      ScratchStack::create(waves(64, 64, 8), {64, 64, 16}, "/nowhere/at/all", progress);
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kIo);
  EXPECT_NE(result.error().message.find("/nowhere/at/all"), std::string::npos);
}

TEST(FirstStage, ShowsEveryBlockToWhoWaits) {
  const Set set = makeSet(37, 29, 21, 8);  // blocks that stick out of the picture
  constexpr int kLight = 13;
  RadianceImage shown(37, 29, 3);
  std::mutex mutex;
  CompressWatch watch;
  watch.light = set.densifier.lights()[kLight];
  watch.onBlock = [&](int left, int top, const RadianceImage& block) {
    const std::scoped_lock lock(mutex);
    for (int y = 0; y < block.height(); ++y)
      std::ranges::copy(block.row(y), &shown(left, top + y, 0));
  };
  SilentProgress progress;
  ASSERT_TRUE(
      firstStage(set.scratch, set.densifier, set.layout, {.most = 0}, kMuch, progress, watch));
  // At full rank a block is its captures, as half floats.
  const RadianceImage truth = set.stack->read(kLight).value();
  for (std::size_t i = 0; i < truth.size(); ++i)
    ASSERT_NEAR(shown.data()[i], truth.data()[i], 2e-3f);
}

TEST(FirstStage, IsTheBestOfItsRankInEveryBlock) {
  SilentProgress progress;
  const Set set = makeSet(70, 40, 60, 16);
  const FirstStage stage = firstStageOf(set, {.most = 6}, kMuch, progress).value();
  ASSERT_EQ(stage.L.rows(), stage.blockOffset.back());
  double energy = 0;
  for (int block = 0; block < set.layout.blocks(); ++block) {
    const auto at = stage.blockOffset[static_cast<std::size_t>(block)];
    const auto b = stage.blockOffset[static_cast<std::size_t>(block) + 1] - at;
    ASSERT_EQ(b, 6);
    const Eigen::MatrixXd A = blockOf(set, block).cast<double>();
    const Eigen::VectorXd energies =
        Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(A * A.transpose()).eigenvalues().reverse();
    const Eigen::MatrixXd E = stage.E.middleRows(at, b).cast<double>();
    const Eigen::MatrixXd L = stage.L.matrix().middleRows(at, b).cast<double>();
    const double best = energies.tail(energies.size() - b).sum();
    EXPECT_NEAR((A - E.transpose() * L).squaredNorm(), best, 5e-4 * best + 1e-6 * A.squaredNorm());
    EXPECT_LT((E * E.transpose() - Eigen::MatrixXd::Identity(b, b)).cwiseAbs().maxCoeff(), 1e-5);
    for (Index k = 0; k < b; ++k) {
      const double own = stage.rowEnergy[static_cast<std::size_t>(at + k)];
      EXPECT_NEAR(own, L.row(k).squaredNorm(), 1e-6 * own);
    }
    energy += A.squaredNorm();
  }
  EXPECT_NEAR(stage.energy, energy, 1e-6 * energy);
}

bool same(const FirstStage& a, const FirstStage& b) {
  return a.blockOffset == b.blockOffset && a.E == b.E && a.L.matrix() == b.L.matrix() &&
         a.rowEnergy == b.rowEnergy && a.energy == b.energy;
}

TEST(FirstStage, DoesNotDependOnCoresOrMemory) {
  SilentProgress progress;
  const oneapi::tbb::global_control many(oneapi::tbb::global_control::max_allowed_parallelism, 5);
  for (const bool densify : {false, true}) {
    const Set set = makeSet(96, 80, 40, 16, densify);
    for (const RankRule& rule : {RankRule{.most = 5}, RankRule{.most = 40, .threshold = 3}}) {
      const auto with = [&](int cores, std::size_t memoryBytes) {
        return oneapi::tbb::task_arena(cores).execute(
            [&] { return firstStageOf(set, rule, memoryBytes, progress).value(); });
      };
      const FirstStage one = with(1, kMuch);
      EXPECT_TRUE(same(one, with(5, kMuch)));
      const FirstStage little = with(3, 1 << 16);
      EXPECT_TRUE(little.L.inFile());
      EXPECT_TRUE(same(one, little));
    }
  }
}

TEST(SecondStage, DoesNotDependOnCoresOrOnWhereLIs) {
  SilentProgress progress;
  const oneapi::tbb::global_control many(oneapi::tbb::global_control::max_allowed_parallelism, 5);
  const Set set = makeSet(160, 128, 120, 16);
  const auto with = [&](int cores, std::size_t memoryBytes) {
    return oneapi::tbb::task_arena(cores).execute([&] {
      FirstStage first = firstStageOf(set, {.most = 8}, memoryBytes, progress).value();
      EXPECT_EQ(first.L.inFile(), memoryBytes < kMuch);
      return factoriseAll(std::move(first.L), 20, SecondStageMethod::kAuto, progress).value();
    });
  };
  const SecondStage one = with(1, kMuch);
  EXPECT_FALSE(one.exact);
  for (const SecondStage& other : {with(5, kMuch), with(2, 1 << 18)}) {
    EXPECT_EQ(one.U, other.U);
    EXPECT_EQ(one.V, other.V);
  }
}

// Megabytes of /proc/self/status; VmHWM is the largest since it was last reset.
double statusMegabytes(const std::string& key) {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (line.rfind(key, 0) == 0) return std::stod(line.substr(key.size() + 1)) / 1024;
  }
  return 0;
}

// False where the system does not let a process do so.
bool resetPeak() {
  return static_cast<bool>(std::ofstream("/proc/self/clear_refs") << "5" << std::flush);
}

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
constexpr bool kSanitized = true;
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer) || \
    __has_feature(memory_sanitizer)
constexpr bool kSanitized = true;
#else
constexpr bool kSanitized = false;
#endif
#else
constexpr bool kSanitized = false;
#endif

// L is 50 MB, the captures 100: without the file the peak would be half as high again.
TEST(FirstStage, StaysInItsMemory) {
  if (kSanitized) GTEST_SKIP() << "sanitizers take memory of their own";
  if (!resetPeak()) GTEST_SKIP() << "/proc/self/clear_refs cannot be written";
  SilentProgress progress;
  const Set set = makeSet(128, 128, 1024, 16);
  constexpr std::size_t kMemory = 16 << 20;
  ASSERT_TRUE(resetPeak());
  const double before = statusMegabytes("VmRSS:");
  FirstStage first = firstStageOf(set, {.most = 64}, kMemory, progress).value();
  EXPECT_EQ(first.L.rows(), 64 * 64);
  const auto second = factoriseAll(std::move(first.L), 32, SecondStageMethod::kAuto, progress);
  ASSERT_TRUE(second);
  const double peak = statusMegabytes("VmHWM:") - before;
  // E and U, V, their doubles in stage 2: 5 MB; a strip of L being read: 25 MB. BLAS and TBB: some.
  EXPECT_LT(peak, 16 + 5 + 25 + 10);
}

// Cancels after so many reports of a stage.
class Impatient final : public Progress {
 public:
  Impatient(std::string stage, std::size_t after) : stage_(std::move(stage)), left_(after) {}
  void update(std::string_view stage, std::size_t, std::size_t) override {
    if (stage == stage_ && left_-- == 0) cancelled_ = true;
  }
  void warn(std::string_view) override {}
  bool cancelled() const override { return cancelled_; }

 private:
  std::string stage_;
  std::atomic<std::size_t> left_;
  std::atomic<bool> cancelled_ = false;
};

std::ptrdiff_t openFiles() {
  return std::distance(std::filesystem::directory_iterator("/proc/self/fd"), {});
}

TEST(Cancelling, EndsEveryStageAndLeavesNothing) {
  const auto before = openFiles();
  {
    const Set set = makeSet(96, 96, 200, 16);
    const auto withScratch = openFiles();
    Impatient reading("reading images", 3);
    const auto scratch = ScratchStack::create(*set.stack, set.layout, set.folder, reading);
    ASSERT_FALSE(scratch);
    EXPECT_EQ(scratch.error().code, ErrorCode::kCancelled);
    for (const std::size_t after : {0u, 1u, 17u}) {
      Impatient first("first stage", after);
      const auto stage = firstStageOf(set, {.most = 5}, 1 << 16, first);  // L goes to a file
      ASSERT_FALSE(stage);
      EXPECT_EQ(stage.error().code, ErrorCode::kCancelled);
    }
    for (const std::size_t after : {0u, 1u, 3u}) {
      SilentProgress progress;
      Impatient second("second stage", after);
      FirstStage stage = firstStageOf(set, {.most = 5}, 1 << 16, progress).value();
      const auto result =
          factoriseAll(std::move(stage.L), 10, SecondStageMethod::kRandomised, second);
      ASSERT_FALSE(result);
      EXPECT_EQ(result.error().code, ErrorCode::kCancelled);
    }
    EXPECT_EQ(openFiles(), withScratch);
    EXPECT_TRUE(std::filesystem::is_empty(set.folder));
  }
  EXPECT_EQ(openFiles(), before);
}

}  // namespace
}  // namespace lightsketch
