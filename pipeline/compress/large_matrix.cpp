#include "pipeline/compress/large_matrix.h"

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdint>
#include <limits>
#include <new>
#include <stdexcept>
#include <utility>

#include "capture/frame/file.h"
#include "pipeline/compress/scratch_file.h"

namespace lightsketch {

Pages::Pages(std::size_t bytes) : size_(std::max<std::size_t>(bytes, 1)) {
  void* mapped = ::mmap(nullptr, size_, PROT_READ | PROT_WRITE,
                        MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
  if (mapped == MAP_FAILED) throw std::bad_alloc();
  data_ = mapped;
  ::madvise(data_, size_, MADV_HUGEPAGE);  // where it fails pages are small, no more
}

Pages::Pages(Pages&& other) noexcept
    : data_(std::exchange(other.data_, nullptr)), size_(std::exchange(other.size_, 0)) {}

Pages& Pages::operator=(Pages&& other) noexcept {
  std::swap(data_, other.data_);
  std::swap(size_, other.size_);
  return *this;
}

Pages::~Pages() {
  if (data_) ::munmap(data_, size_);
}

LargeMatrix::LargeMatrix(std::size_t columns, std::size_t mostRows, std::size_t memoryBytes,
                         std::filesystem::path folder)
    : pages_(columns * mostRows * sizeof(float)),
      columns_(columns),
      memoryBytes_(memoryBytes),
      folder_(std::move(folder)) {}

LargeMatrix::LargeMatrix(const RowMajorMatrixf& matrix)
    : LargeMatrix(static_cast<std::size_t>(matrix.cols()), static_cast<std::size_t>(matrix.rows()),
                  std::numeric_limits<std::size_t>::max(), {}) {
  std::copy_n(matrix.data(), matrix.size(), static_cast<float*>(pages_.data()));
  rows_ = static_cast<std::size_t>(matrix.rows());
}

Result<void> LargeMatrix::append(const float* rows, std::size_t count) {
  const std::size_t needed = (rows_ + count) * columns_ * sizeof(float);
  if (needed > pages_.size()) throw std::logic_error("more rows than a large matrix was made for");
  if (!inFile() && needed > memoryBytes_) RETURN_IF_ERROR(moveToFile());
  if (inFile()) {
    RETURN_IF_ERROR(write(rows, count, rows_));
  } else {
    std::copy_n(rows, count * columns_, static_cast<float*>(pages_.data()) + rows_ * columns_);
  }
  rows_ += count;
  return {};
}

Result<void> LargeMatrix::moveToFile() {
  ASSIGN_OR_RETURN(file_, openScratchFile(folder_));
  RETURN_IF_ERROR(write(data(), rows_, 0));
  if (::ftruncate(file_.get(), static_cast<off_t>(pages_.size())) != 0 ||
      ::mmap(pages_.data(), pages_.size(), PROT_READ, MAP_SHARED | MAP_FIXED, file_.get(), 0) ==
          MAP_FAILED) {
    return failure(ErrorCode::kIo, "{}: cannot keep the first stage here: {}", folder_.string(),
                   systemMessage(errno));
  }
  return {};
}

Result<void> LargeMatrix::write(const float* rows, std::size_t count, std::size_t at) {
  const std::size_t row = columns_ * sizeof(float);
  if (const int error =
          writeAll(file_.get(), rows, count * row, static_cast<std::int64_t>(at * row))) {
    return failure(ErrorCode::kIo,
                   "{}: cannot keep the first stage here: {}; make room or set TMPDIR",
                   folder_.string(), systemMessage(error));
  }
  return {};
}

void LargeMatrix::release(std::size_t first, std::size_t count) const {
  if (!inFile()) return;
  // Whole pages only; what is left of the others is little.
  const auto page = static_cast<std::size_t>(::sysconf(_SC_PAGESIZE));
  const std::size_t row = columns_ * sizeof(float);
  const std::size_t begin = (first * row + page - 1) / page * page;
  const std::size_t end = (first + count) * row / page * page;
  if (end > begin) ::madvise(static_cast<char*>(pages_.data()) + begin, end - begin, MADV_DONTNEED);
}

}  // namespace lightsketch
