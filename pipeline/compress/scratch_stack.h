// The images of a stack, decoded once, waiting on disk in the order in which blocks are worked on.
// Internal to this folder.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <vector>

#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/compress/model.h"
#include "pipeline/sketch/light_stack.h"

namespace lightsketch {

// Half floats in an unlinked file, so that nothing is left behind whatever happens. Order: row of
// blocks, image, block, channel, pixel; pixels beyond the picture are zero.
class ScratchStack {
 public:
  // Reads all images of `stack`, in parallel.
  static Result<ScratchStack> create(const LightStack& stack, const BlockLayout& layout,
                                     const std::filesystem::path& folder, Progress& progress);
  ScratchStack(ScratchStack&& other) noexcept;
  ScratchStack& operator=(ScratchStack&&) = delete;
  ~ScratchStack();

  int images() const { return images_; }
  // Halfs of one block of one image: 3 p.
  std::size_t blockValues() const { return 3 * static_cast<std::size_t>(layout_.pixelsPerBlock()); }
  // Blocks firstColumn to firstColumn + columns of a row of blocks, of all images: images x columns
  // x 3 x p. Thread-safe.
  Result<void> read(int blockRow, int firstColumn, int columns,
                    std::vector<std::uint16_t>& halfs) const;

 private:
  ScratchStack(int fd, const BlockLayout& layout, int images)
      : fd_(fd), layout_(layout), images_(images) {}
  Result<void> write(int image, const RadianceImage& radiance,
                     const std::filesystem::path& folder) const;
  std::int64_t offsetOf(int blockRow, int image, int column) const;

  int fd_ = -1;
  BlockLayout layout_;
  int images_ = 0;
};

}  // namespace lightsketch
