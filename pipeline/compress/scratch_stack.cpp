#include "pipeline/compress/scratch_stack.h"

#include <fcntl.h>
#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/task_arena.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <mutex>
#include <optional>
#include <utility>

#include "capture/frame/file.h"
#include "pipeline/compress/kernels.h"
#include "pipeline/compress/large_matrix.h"
#include "pipeline/compress/scratch_file.h"

namespace lightsketch {

Result<ScratchStack> ScratchStack::create(const LightStack& stack, const BlockLayout& layout,
                                          const std::filesystem::path& folder, Progress& progress,
                                          std::size_t memoryBytes) {
  ASSIGN_OR_RETURN(Descriptor file, openScratchFile(folder));
  ScratchStack scratch(std::move(file), layout, stack.size(), folder);
  // A disk too small is better known before hours of decoding than after.
  const std::int64_t bytes = scratch.offsetOf(layout.blocks(), 0);
  if (bytes > 0 && ::fallocate(scratch.file_.get(), 0, 0, bytes) != 0 && errno != EOPNOTSUPP) {
    return failure(ErrorCode::kIo, "{}: no room for the decoded images ({} MB): {}; set TMPDIR",
                   folder.string(), bytes / 1'000'000, systemMessage(errno));
  }

  // Several images at once: their blocks are written side by side in one piece.
  constexpr int kImagesAtOnce = 16;
  const int cores = oneapi::tbb::this_task_arena::max_concurrency();
  const std::size_t perImage =
      static_cast<std::size_t>(layout.blocks()) * scratch.blockValues() * sizeof(std::uint16_t);
  const int atOnce = static_cast<int>(std::clamp<std::size_t>(
      memoryBytes / (perImage * static_cast<std::size_t>(cores)), 1,
      static_cast<std::size_t>(std::clamp(stack.size() / (4 * cores), 1, kImagesAtOnce))));
  std::mutex mutex;  // guards the first failure
  std::optional<Error> error;
  std::atomic<bool> failed = false;
  std::atomic<std::size_t> done = 0;
  const auto total = static_cast<std::size_t>(stack.size());
  progress.update("reading images", 0, total);
  oneapi::tbb::parallel_for(0, (stack.size() + atOnce - 1) / atOnce, [&](int batch) {
    if (failed || progress.cancelled()) return;
    const int first = batch * atOnce;
    const int count = std::min(atOnce, stack.size() - first);
    Result<void> result = scratch.write(stack, first, count, progress, done);
    if (result) return;
    const std::scoped_lock lock(mutex);
    if (!failed.exchange(true)) error = std::move(result).error();
  });
  if (error) return tl::unexpected<Error>(std::move(*error));
  if (progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
  return scratch;
}

std::int64_t ScratchStack::offsetOf(int block, int image) const {
  return (static_cast<std::int64_t>(block) * images_ + image) *
         static_cast<std::int64_t>(blockValues() * sizeof(std::uint16_t));
}

Result<void> ScratchStack::write(const LightStack& stack, int firstImage, int count,
                                 Progress& progress, std::atomic<std::size_t>& done) const {
  const auto size = static_cast<std::size_t>(layout_.blockSize);
  const auto width = static_cast<std::size_t>(layout_.width);
  const auto blocks = static_cast<std::size_t>(layout_.blocks());
  const auto columns = static_cast<std::size_t>(layout_.columns());
  const auto images = static_cast<std::size_t>(count);
  const Pages pages(blocks * images * blockValues() * sizeof(std::uint16_t));
  auto* const halfs = static_cast<std::uint16_t*>(pages.data());
  std::vector<std::uint16_t> row(3 * width);
  for (std::size_t i = 0; i < images; ++i) {
    if (progress.cancelled()) return {};
    ASSIGN_OR_RETURN(const RadianceImage image, stack.read(firstImage + static_cast<int>(i)));
    for (std::size_t y = 0; y < static_cast<std::size_t>(layout_.height); ++y) {
      planarHalfs(image.row(static_cast<int>(y)).data(), width, row.data());
      for (std::size_t x = 0; x < width; x += size) {
        const std::size_t block = y / size * columns + x / size;
        std::uint16_t* target = halfs + (block * images + i) * blockValues() + y % size * size;
        for (std::size_t c = 0; c < 3; ++c) {
          std::memcpy(target + c * size * size, row.data() + c * width + x,
                      std::min(size, width - x) * sizeof(std::uint16_t));
        }
      }
    }
    progress.update("reading images", ++done, static_cast<std::size_t>(images_));
  }
  for (std::size_t block = 0; block < blocks; ++block) {
    const std::size_t values = images * blockValues();
    if (const int error =
            writeAll(file_.get(), halfs + block * values, values * sizeof(std::uint16_t),
                     offsetOf(static_cast<int>(block), firstImage))) {
      return failure(ErrorCode::kIo,
                     "{}: cannot keep the decoded images here: {}; make room or set TMPDIR",
                     folder_.string(), systemMessage(error));
    }
  }
  return {};
}

Result<void> ScratchStack::read(int block, std::uint16_t* halfs) const {
  const std::size_t bytes = static_cast<std::size_t>(offsetOf(1, 0));
  if (const int error = readAll(file_.get(), halfs, bytes, offsetOf(block, 0)))
    return failure(ErrorCode::kIo, "cannot read the scratch file back: {}", systemMessage(error));
  return {};
}

}  // namespace lightsketch
