#include "pipeline/compress/first_stage.h"

#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/task_arena.h>

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <exception>
#include <map>
#include <memory>
#include <mutex>
#include <numeric>
#include <optional>
#include <utility>

#include "pipeline/compress/kernels.h"
#include "pipeline/compress/lapack.h"

namespace lightsketch {
namespace {

constexpr const char* kStage = "first stage";

// Which of a block's pixels the picture has.
std::unique_ptr<bool[]> inPicture(const BlockLayout& layout, int block) {
  const int size = layout.blockSize;
  const int left = block % layout.columns() * size;
  const int top = block / layout.columns() * size;
  auto inside = std::make_unique<bool[]>(static_cast<std::size_t>(layout.pixelsPerBlock()));
  for (int y = 0; y < size; ++y) {
    for (int x = 0; x < size; ++x)
      inside[static_cast<std::size_t>(y * size + x)] =
          left + x < layout.width && top + y < layout.height;
  }
  return inside;
}

double energyOf(std::span<const float> values) {
  // Sums of some values in single precision, of these in double.
  constexpr std::size_t kRun = 1024;
  double energy = 0;
  for (std::size_t at = 0; at < values.size(); at += kRun) {
    const auto count = static_cast<Eigen::Index>(std::min(kRun, values.size() - at));
    energy += static_cast<double>(
        Eigen::Map<const Eigen::VectorXf>(values.data() + at, count).squaredNorm());
  }
  return energy;
}

float valueOf(float value) { return value; }
float valueOf(std::uint16_t half) {
  return static_cast<float>(Eigen::numext::bit_cast<Eigen::half>(half));
}

template <class Value>
BlockFactors factorise(std::span<const Value> columns, std::span<const bool> inside,
                       const RankRule& rule) {
  const std::size_t p = inside.size();
  const std::size_t count = columns.size() / p;
  const auto rows = static_cast<Eigen::Index>(p);
  const auto pixels = static_cast<int>(std::count(inside.begin(), inside.end(), true));
  const auto fullRank = static_cast<int>(std::min(static_cast<std::size_t>(pixels), count));
  RankRule bounded = rule;
  bounded.most = rule.most > 0 ? std::min(rule.most, fullRank) : fullRank;
  BlockFactors block;
  if (bounded.most == pixels && rule.threshold <= 0) {
    // Full rank: any orthonormal basis is exact; this one needs no arithmetic and packs to nothing.
    block.E.setZero(pixels, rows);
    Eigen::Index row = 0;
    for (Eigen::Index k = 0; k < rows; ++k) {
      if (inside[static_cast<std::size_t>(k)]) block.E(row++, k) = 1;
    }
  } else if (bounded.most == fullRank && rule.threshold <= 0) {
    // A basis of few columns. In single precision a Gram matrix hides singular values below 3e-4 of
    // the largest, which matters only here, where all are wanted.
    Eigen::MatrixXd wide(rows, static_cast<Eigen::Index>(count));
    std::transform(columns.begin(), columns.end(), wide.data(),
                   [](Value value) { return static_cast<double>(valueOf(value)); });
    Eigen::MatrixXd gram = Eigen::MatrixXd::Zero(rows, rows);
    addGram(wide, gram);
    block.energy = gram.trace();
    Eigen::VectorXd values;
    Eigen::MatrixXd vectors;
    largestEigen(gram, bounded.most, values, vectors);
    block.E = vectors.transpose().cast<float>();
  } else {
    RowMajorMatrixf gram(rows, rows);
    gramOfColumns(columns.data(), count, p, gram.data());
    block.energy = gram.diagonal().template cast<double>().sum();
    block.E = leadingEigenvectors(gram, inside, bounded);
  }
  block.L.resize(block.E.rows(), static_cast<Eigen::Index>(count));
  projectColumns(columns.data(), count, p, block.E.data(), static_cast<std::size_t>(block.E.rows()),
                 block.L.data());
  for (Eigen::Index r = 0; r < block.L.rows(); ++r)
    block.rowEnergy.push_back(energyOf({block.L.row(r).data(), count}));
  if (bounded.most == pixels && rule.threshold <= 0)
    block.energy = std::accumulate(block.rowEnergy.begin(), block.rowEnergy.end(), 0.0);
  return block;
}

// Takes blocks in any order and puts them into the result in theirs.
class InOrder {
 public:
  InOrder(FirstStage& stage, std::size_t blocks, std::size_t ahead) : stage_(stage), ahead_(ahead) {
    stage_.blockOffset.reserve(blocks + 1);
    stage_.blockOffset.push_back(0);
  }

  // Waits until `block` is not too far ahead of what is in place, so that few blocks wait.
  void waitFor(std::size_t block) {
    std::unique_lock lock(mutex_);
    moved_.wait(lock, [&] { return failed_ || block < placed() + ahead_; });
  }

  void put(std::size_t block, BlockFactors factors) {
    const std::scoped_lock lock(mutex_);
    waiting_.emplace(block, std::move(factors));
    while (!failed_ && !waiting_.empty() && waiting_.begin()->first == placed()) {
      place(waiting_.begin()->second);
      waiting_.erase(waiting_.begin());
    }
    moved_.notify_all();
  }

  void fail(Error error) {
    const std::scoped_lock lock(mutex_);
    if (!failed_) error_ = std::move(error);
    failed_ = true;
    moved_.notify_all();
  }

  bool failed() const { return failed_; }
  // After the last block.
  std::optional<Error> error() { return std::move(error_); }

 private:
  std::size_t placed() const { return stage_.blockOffset.size() - 1; }

  void place(const BlockFactors& factors) {
    const Eigen::Index at = stage_.blockOffset.back();
    const Eigen::Index rows = factors.E.rows();
    if (at + rows > stage_.E.rows())
      stage_.E.conservativeResize(std::max(2 * stage_.E.rows(), at + rows), stage_.E.cols());
    stage_.E.middleRows(at, rows) = factors.E;
    stage_.rowEnergy.insert(stage_.rowEnergy.end(), factors.rowEnergy.begin(),
                            factors.rowEnergy.end());
    stage_.energy += factors.energy;
    if (auto result = stage_.L.append(factors.L.data(), static_cast<std::size_t>(rows)); !result) {
      error_ = std::move(result).error();
      failed_ = true;
    }
    stage_.blockOffset.push_back(at + rows);
  }

  std::mutex mutex_;  // guards all below
  std::condition_variable moved_;
  FirstStage& stage_;
  std::size_t ahead_;
  std::map<std::size_t, BlockFactors> waiting_;
  std::optional<Error> error_;
  std::atomic<bool> failed_ = false;
};

// One light of a block from its factors, the part that the picture has.
RadianceImage drawn(const BlockFactors& block, const BlockLayout& layout, int left, int top,
                    int light, bool squareRoots) {
  const int size = layout.blockSize;
  RadianceImage picture(std::min(size, layout.width - left), std::min(size, layout.height - top),
                        3);
  const RowMajorMatrixf pixels = block.E.transpose() * block.L.middleCols(3 * light, 3);
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      for (int c = 0; c < 3; ++c) {
        const float value = pixels(y * size + x, c);
        picture(x, y, c) = squareRoots ? value * value : value;
      }
    }
  }
  return picture;
}

}  // namespace

BlockFactors factoriseBlock(std::span<const std::uint16_t> columns, std::span<const bool> inside,
                            const RankRule& rule) {
  return factorise(columns, inside, rule);
}
BlockFactors factoriseBlock(std::span<const float> columns, std::span<const bool> inside,
                            const RankRule& rule) {
  return factorise(columns, inside, rule);
}

Result<FirstStage> firstStage(const ScratchStack& scratch, const Densifier& densifier,
                              const BlockLayout& layout, const RankRule& rule,
                              std::size_t memoryBytes, Progress& progress,
                              const CompressWatch& watch) {
  const auto images = static_cast<std::size_t>(scratch.images());
  const std::size_t values = scratch.blockValues();
  const auto p = static_cast<std::size_t>(layout.pixelsPerBlock());
  const auto blocks = static_cast<std::size_t>(layout.blocks());
  const std::size_t lights = densifier.lights().size();
  const std::size_t most = rule.most > 0 ? std::min(p, static_cast<std::size_t>(rule.most)) : p;
  const SingleThreadedBlas singleThreaded;

  // As many blocks at once as a quarter of the memory holds; each has its captures, perhaps its
  // interpolated pictures, its Gram matrix and its L twice, as some finished ones wait for others.
  const std::size_t perBlock =
      images * values * sizeof(std::uint16_t) +
      (densifier.active() ? (images + lights) * values * sizeof(float) : 0) +
      p * p * sizeof(float) + 2 * most * 3 * lights * sizeof(float);
  const auto cores = static_cast<std::size_t>(oneapi::tbb::this_task_arena::max_concurrency());
  const std::size_t workers =
      std::clamp<std::size_t>(memoryBytes / 4 / perBlock, 1, std::min(cores, blocks));

  FirstStage stage;
  stage.E.resize(0, static_cast<Eigen::Index>(p));
  stage.L = LargeMatrix(3 * lights, most * blocks, memoryBytes / 2, scratch.folder());
  InOrder inOrder(stage, blocks, 2 * workers);
  const auto watched = static_cast<int>(std::ranges::max_element(densifier.lights(), {},
                                                                 [&](const Eigen::Vector3d& light) {
                                                                   return light.dot(watch.light);
                                                                 }) -
                                        densifier.lights().begin());
  std::atomic<std::size_t> next = 0;
  std::atomic<std::size_t> done = 0;
  progress.update(kStage, 0, blocks);
  const auto factoriseBlocks = [&] {
    const Pages pages(images * values * sizeof(std::uint16_t));
    const std::span halfs(static_cast<std::uint16_t*>(pages.data()), images * values);
    Densifier::Workspace workspace;
    std::vector<float> columns;
    for (std::size_t block = next++; block < blocks; block = next++) {
      inOrder.waitFor(block);
      if (inOrder.failed()) return;
      if (progress.cancelled()) return inOrder.fail({ErrorCode::kCancelled, "cancelled"});
      const auto number = static_cast<int>(block);
      const auto inside = inPicture(layout, number);
      const std::span<const bool> pixels(inside.get(), p);
      Result<void> result = scratch.read(number, halfs.data());
      if (result && densifier.active())
        result = densifier.columns(number, halfs.data(), values, workspace, columns);
      if (!result) return inOrder.fail(std::move(result).error());
      BlockFactors factors =
          densifier.active() ? factoriseBlock(columns, pixels, rule)
                             : factoriseBlock(std::span<const std::uint16_t>(halfs), pixels, rule);
      if (watch.onBlock) {
        const int left = number % layout.columns() * layout.blockSize;
        const int top = number / layout.columns() * layout.blockSize;
        watch.onBlock(left, top,
                      drawn(factors, layout, left, top, watched, densifier.squareRoots()));
      }
      inOrder.put(block, std::move(factors));
      progress.update(kStage, ++done, blocks);
    }
  };
  oneapi::tbb::parallel_for(
      std::size_t{0}, workers,
      [&](std::size_t) {
        try {
          factoriseBlocks();
        } catch (...) {
          inOrder.fail({ErrorCode::kIo, "first stage failed"});  // nobody may wait for this block
          throw;
        }
      },
      oneapi::tbb::simple_partitioner());
  if (auto error = inOrder.error()) return tl::unexpected<Error>(std::move(*error));
  stage.E.conservativeResize(stage.blockOffset.back(), Eigen::NoChange);
  return stage;
}

}  // namespace lightsketch
