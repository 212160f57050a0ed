#include "pipeline/compress/scratch_stack.h"

#include <fcntl.h>
#include <oneapi/tbb/parallel_for.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "capture/frame/file.h"

namespace lightsketch {
namespace {

// Reads or writes all of a range; the errno of what failed, 0 if nothing did.
template <class Function, class Byte>
int transferAll(Function function, int fd, Byte* bytes, std::size_t count, off_t at) {
  while (count > 0) {
    const ssize_t done = function(fd, bytes, count, at);
    if (done < 0 && errno == EINTR) continue;
    if (done < 0) return errno;
    if (done == 0) return EIO;
    bytes += done;
    at += done;
    count -= static_cast<std::size_t>(done);
  }
  return 0;
}

}  // namespace

Result<ScratchStack> ScratchStack::create(const LightStack& stack, const BlockLayout& layout,
                                          const std::filesystem::path& folder, Progress& progress) {
  std::string name = (folder / "lightsketch-XXXXXX").string();
  const int fd = ::mkostemp(name.data(), O_CLOEXEC);
  if (fd < 0) {
    return failure(ErrorCode::kIo, "{}: cannot write a scratch file: {}", folder.string(),
                   systemMessage(errno));
  }
  ::unlink(name.c_str());
  ScratchStack scratch(fd, layout, stack.size());

  std::mutex mutex;  // guards the first failure
  std::optional<Error> error;
  std::atomic<bool> failed = false;
  std::atomic<std::size_t> done = 0;
  const auto total = static_cast<std::size_t>(stack.size());
  progress.update("reading images", 0, total);
  oneapi::tbb::parallel_for(0, stack.size(), [&](int i) {
    if (failed || progress.cancelled()) return;
    Result<void> result;
    if (auto image = stack.read(i); !image) {
      result = tl::unexpected<Error>(std::move(image).error());
    } else {
      result = scratch.write(i, *image, folder);
    }
    if (result) {
      progress.update("reading images", ++done, total);
      return;
    }
    const std::scoped_lock lock(mutex);
    if (!failed.exchange(true)) error = std::move(result).error();
  });
  if (error) return tl::unexpected<Error>(std::move(*error));
  if (progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
  return scratch;
}

ScratchStack::ScratchStack(ScratchStack&& other) noexcept
    : fd_(std::exchange(other.fd_, -1)), layout_(other.layout_), images_(other.images_) {}

ScratchStack::~ScratchStack() {
  if (fd_ >= 0) ::close(fd_);
}

std::int64_t ScratchStack::offsetOf(int blockRow, int image, int column) const {
  const std::int64_t block =
      (static_cast<std::int64_t>(blockRow) * images_ + image) * layout_.columns() + column;
  return block * static_cast<std::int64_t>(blockValues() * sizeof(std::uint16_t));
}

Result<void> ScratchStack::write(int image, const RadianceImage& radiance,
                                 const std::filesystem::path& folder) const {
  const int size = layout_.blockSize;
  std::vector<std::uint16_t> halfs(static_cast<std::size_t>(layout_.columns()) * blockValues());
  for (int row = 0; row < layout_.rows(); ++row) {
    std::fill(halfs.begin(), halfs.end(), std::uint16_t{0});
    for (int y = row * size; y < std::min((row + 1) * size, layout_.height); ++y) {
      for (int x = 0; x < layout_.width; ++x) {
        const auto pixel = static_cast<std::size_t>((y - row * size) * size + x % size);
        for (int c = 0; c < 3; ++c) {
          const float value = std::clamp(radiance(x, y, c), -65504.0f, 65504.0f);
          halfs[static_cast<std::size_t>(x / size) * blockValues() +
                static_cast<std::size_t>(c) * static_cast<std::size_t>(layout_.pixelsPerBlock()) +
                pixel] = Eigen::numext::bit_cast<std::uint16_t>(Eigen::half(value));
        }
      }
    }
    const int error = transferAll(::pwrite, fd_, reinterpret_cast<const char*>(halfs.data()),
                                  halfs.size() * sizeof(std::uint16_t), offsetOf(row, image, 0));
    if (error != 0) {
      return failure(ErrorCode::kIo,
                     "{}: cannot keep the decoded images here: {}; make room or set TMPDIR",
                     folder.string(), systemMessage(error));
    }
  }
  return {};
}

Result<void> ScratchStack::read(int blockRow, int firstColumn, int columns,
                                std::vector<std::uint16_t>& halfs) const {
  const std::size_t perImage = static_cast<std::size_t>(columns) * blockValues();
  halfs.resize(static_cast<std::size_t>(images_) * perImage);
  for (int i = 0; i < images_; ++i) {
    const int error =
        transferAll(::pread, fd_,
                    reinterpret_cast<char*>(halfs.data() + static_cast<std::size_t>(i) * perImage),
                    perImage * sizeof(std::uint16_t), offsetOf(blockRow, i, firstColumn));
    if (error != 0)
      return failure(ErrorCode::kIo, "cannot read the scratch file back: {}", systemMessage(error));
  }
  return {};
}

}  // namespace lightsketch
