// The images of a stack, decoded once, waiting on disk in the order in which blocks are worked on.
// Internal to this folder.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <utility>
#include <vector>

#include "capture/frame/descriptor.h"
#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/compress/model.h"
#include "pipeline/sketch/light_stack.h"

namespace lightsketch {

// Half floats in an unlinked file. Order: block, image, channel, pixel, so that a block under all
// lights is one read; pixels beyond the picture are zero.
class ScratchStack {
 public:
  // Reads all images of `stack`, in parallel, some at once for each core as far as `memoryBytes`
  // allows (at least one).
  static Result<ScratchStack> create(const LightStack& stack, const BlockLayout& layout,
                                     const std::filesystem::path& folder, Progress& progress,
                                     std::size_t memoryBytes = 200'000'000);
  int images() const { return images_; }
  const std::filesystem::path& folder() const { return folder_; }
  // Halfs of one block of one image: 3 p.
  std::size_t blockValues() const { return 3 * static_cast<std::size_t>(layout_.pixelsPerBlock()); }
  // One block of all images: images x 3 x p. Thread-safe.
  Result<void> read(int block, std::uint16_t* halfs) const;

 private:
  ScratchStack(Descriptor file, const BlockLayout& layout, int images, std::filesystem::path folder)
      : file_(std::move(file)), layout_(layout), images_(images), folder_(std::move(folder)) {}
  Result<void> write(const LightStack& stack, int firstImage, int count, Progress& progress,
                     std::atomic<std::size_t>& done) const;
  std::int64_t offsetOf(int block, int image) const;

  Descriptor file_;
  BlockLayout layout_;
  int images_ = 0;
  std::filesystem::path folder_;
};

}  // namespace lightsketch
