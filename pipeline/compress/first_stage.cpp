#include "pipeline/compress/first_stage.h"

#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <memory>
#include <mutex>
#include <numeric>
#include <optional>
#include <utility>

#include "pipeline/compress/factorise.h"

namespace lightsketch {
namespace {

namespace tbb = oneapi::tbb;

constexpr const char* kStage = "first stage";

// Which of a block's pixels the picture has.
std::unique_ptr<bool[]> inPicture(const BlockLayout& layout, int block, int& pixels) {
  const int size = layout.blockSize;
  const int left = block % layout.columns() * size;
  const int top = block / layout.columns() * size;
  auto inside = std::make_unique<bool[]>(static_cast<std::size_t>(layout.pixelsPerBlock()));
  pixels = 0;
  for (int y = 0; y < size; ++y) {
    for (int x = 0; x < size; ++x) {
      const bool here = left + x < layout.width && top + y < layout.height;
      inside[static_cast<std::size_t>(y * size + x)] = here;
      pixels += here ? 1 : 0;
    }
  }
  return inside;
}

// What one thread needs for one block; kept from block to block.
struct Workspace {
  Densifier::Workspace densifier;
  std::vector<float> columns;  // N x 3 x p
};

struct BlockResult {
  RowMajorMatrixf E;
  RowMajorMatrixf L;
  std::vector<double> rowEnergy;
};

}  // namespace

Result<FirstStage> firstStage(const ScratchStack& scratch, const Densifier& densifier,
                              const BlockLayout& layout, const RankRule& rule,
                              std::size_t memoryBytes, Progress& progress) {
  const auto images = static_cast<std::size_t>(scratch.images());
  const std::size_t values = scratch.blockValues();
  const auto p = static_cast<std::size_t>(layout.pixelsPerBlock());
  const std::size_t count = 3 * densifier.lights().size();
  const SingleThreadedBlas singleThreaded;

  // Half of the memory for the strip, the rest for the threads' workspaces.
  const std::size_t perBlock = images * values * sizeof(std::uint16_t);
  const int columnsAtOnce = static_cast<int>(std::clamp<std::size_t>(
      memoryBytes / 2 / perBlock, 1, static_cast<std::size_t>(layout.columns())));

  tbb::enumerable_thread_specific<Workspace> workspaces;
  std::vector<BlockResult> blocks(static_cast<std::size_t>(layout.blocks()));
  std::vector<double> energies(blocks.size(), 0.0);
  std::atomic<std::size_t> done = 0;
  std::mutex mutex;  // guards the first failure
  std::optional<Error> error;
  std::vector<std::uint16_t> halfs;
  progress.update(kStage, 0, energies.size());
  for (int row = 0; row < layout.rows(); ++row) {
    for (int first = 0; first < layout.columns(); first += columnsAtOnce) {
      const int wide = std::min(columnsAtOnce, layout.columns() - first);
      RETURN_IF_ERROR(scratch.read(row, first, wide, halfs));
      tbb::parallel_for(0, wide, [&](int k) {
        if (progress.cancelled()) return;
        const int block = row * layout.columns() + first + k;
        Workspace& work = workspaces.local();
        const auto made = densifier.columns(
            block, halfs.data() + static_cast<std::size_t>(k) * values,
            static_cast<std::size_t>(wide) * values, work.densifier, work.columns);
        if (!made) {
          const std::scoped_lock lock(mutex);
          if (!error) error = made.error();
          return;
        }
        double energy = 0;
        for (std::size_t i = 0; i < work.columns.size(); i += values) {
          energy +=
              static_cast<double>(Eigen::Map<const Eigen::VectorXf>(
                                      work.columns.data() + i, static_cast<Eigen::Index>(values))
                                      .squaredNorm());
        }
        energies[static_cast<std::size_t>(block)] = energy;
        int pixels = 0;
        const auto inside = inPicture(layout, block, pixels);
        auto b = static_cast<int>(std::min<std::size_t>(static_cast<std::size_t>(pixels), count));
        if (rule.most > 0) b = std::min(b, rule.most);
        BlockResult& result = blocks[static_cast<std::size_t>(block)];
        result.E.resize(b, static_cast<Eigen::Index>(p));
        result.L.resize(b, static_cast<Eigen::Index>(count));
        factoriseBlock(work.columns, {inside.get(), p}, b, result.E.data(), result.L.data());
        for (int i = 0; i < b; ++i)
          result.rowEnergy.push_back(result.L.row(i).cast<double>().squaredNorm());
        if (rule.threshold > 0) {
          const auto kept = std::count_if(result.rowEnergy.begin(), result.rowEnergy.end(),
                                          [&](double e) { return e > rule.threshold; });
          result.E.conservativeResize(kept, Eigen::NoChange);
          result.L.conservativeResize(kept, Eigen::NoChange);
          result.rowEnergy.resize(static_cast<std::size_t>(kept));
        }
        progress.update(kStage, ++done, energies.size());
      });
      if (progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
      if (error) return tl::unexpected<Error>(std::move(*error));
    }
  }
  FirstStage stage;
  stage.energy = std::accumulate(energies.begin(), energies.end(), 0.0);
  stage.blockOffset.push_back(0);
  for (const auto& block : blocks)
    stage.blockOffset.push_back(stage.blockOffset.back() + block.E.rows());
  stage.E.resize(stage.blockOffset.back(), static_cast<Eigen::Index>(p));
  stage.L.resize(stage.blockOffset.back(), static_cast<Eigen::Index>(count));
  for (std::size_t j = 0; j < blocks.size(); ++j) {
    stage.E.middleRows(stage.blockOffset[j], blocks[j].E.rows()) = blocks[j].E;
    stage.L.middleRows(stage.blockOffset[j], blocks[j].L.rows()) = blocks[j].L;
    stage.rowEnergy.insert(stage.rowEnergy.end(), blocks[j].rowEnergy.begin(),
                           blocks[j].rowEnergy.end());
    blocks[j] = {};
  }
  return stage;
}

}  // namespace lightsketch
