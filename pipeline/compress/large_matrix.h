// Memory that neither malloc's zeroing nor small pages slow down, and matrices that may not fit
// into it. Internal to this folder.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <filesystem>

#include "capture/frame/descriptor.h"
#include "capture/frame/result.h"
#include "pipeline/compress/model.h"

namespace lightsketch {

// Zeros on huge pages where the system has them; only what is touched takes room. Throws
// std::bad_alloc.
class Pages {
 public:
  Pages() = default;
  explicit Pages(std::size_t bytes);
  Pages(Pages&& other) noexcept;
  Pages& operator=(Pages&& other) noexcept;
  ~Pages();

  void* data() const { return data_; }
  std::size_t size() const { return size_; }

 private:
  void* data_ = nullptr;
  std::size_t size_ = 0;
};

// A row-major matrix that grows row by row: in memory while it is small, beyond `memoryBytes` in an
// unlinked file in `folder`, mapped. Appending is for one thread, reading for many.
class LargeMatrix {
 public:
  LargeMatrix() = default;
  LargeMatrix(std::size_t columns, std::size_t mostRows, std::size_t memoryBytes,
              std::filesystem::path folder);
  explicit LargeMatrix(const RowMajorMatrixf& matrix);

  // Fails with kIo if the file cannot grow.
  Result<void> append(const float* rows, std::size_t count);

  Eigen::Index rows() const { return static_cast<Eigen::Index>(rows_); }
  Eigen::Index cols() const { return static_cast<Eigen::Index>(columns_); }
  const float* data() const { return static_cast<const float*>(pages_.data()); }
  Eigen::Map<const RowMajorMatrixf> matrix() const { return {data(), rows(), cols()}; }
  bool inFile() const { return static_cast<bool>(file_); }
  // These rows will not be read soon: they leave memory if they are in the file too.
  void release(std::size_t first, std::size_t count) const;

 private:
  Result<void> moveToFile();
  Result<void> write(const float* rows, std::size_t count, std::size_t at);

  Pages pages_;
  std::size_t rows_ = 0;
  std::size_t columns_ = 0;
  std::size_t memoryBytes_ = 0;
  std::filesystem::path folder_;
  Descriptor file_;
};

}  // namespace lightsketch
