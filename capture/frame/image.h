// Images as values: row-major, y down, channels interleaved, centre of the top-left pixel at
// (0.5, 0.5).
#pragma once

#include <algorithm>
#include <cstddef>
#include <span>
#include <stdexcept>
#include <vector>

namespace lightsketch {

// Owns its pixels. `Image<float>` with three channels holds linear RGB radiance, scene-referred;
// 1.0 is saturation at the reference exposure.
template <class T>
class Image {
 public:
  Image() = default;
  Image(int width, int height, int channels, T fill = T{})
      : width_(width),
        height_(height),
        channels_(channels),
        pixels_(checkedSize(width, height, channels), fill) {}

  int width() const { return width_; }
  int height() const { return height_; }
  int channels() const { return channels_; }
  bool empty() const { return pixels_.empty(); }
  // Number of values: width * height * channels.
  std::size_t size() const { return pixels_.size(); }
  std::size_t rowSize() const {
    return static_cast<std::size_t>(width_) * static_cast<std::size_t>(channels_);
  }
  bool sameShape(const Image& other) const {
    return width_ == other.width_ && height_ == other.height_ && channels_ == other.channels_;
  }

  T* data() { return pixels_.data(); }
  const T* data() const { return pixels_.data(); }
  std::span<T> values() { return pixels_; }
  std::span<const T> values() const { return pixels_; }
  std::span<T> row(int y) {
    return {pixels_.data() + static_cast<std::size_t>(y) * rowSize(), rowSize()};
  }
  std::span<const T> row(int y) const {
    return {pixels_.data() + static_cast<std::size_t>(y) * rowSize(), rowSize()};
  }
  T& operator()(int x, int y, int channel = 0) { return pixels_[index(x, y, channel)]; }
  const T& operator()(int x, int y, int channel = 0) const { return pixels_[index(x, y, channel)]; }

 private:
  static std::size_t checkedSize(int width, int height, int channels) {
    if (width < 0 || height < 0 || channels < 0) throw std::logic_error("negative image size");
    return static_cast<std::size_t>(width) * static_cast<std::size_t>(height) *
           static_cast<std::size_t>(channels);
  }
  std::size_t index(int x, int y, int channel) const {
    return static_cast<std::size_t>(y) * rowSize() +
           static_cast<std::size_t>(x) * static_cast<std::size_t>(channels_) +
           static_cast<std::size_t>(channel);
  }

  int width_ = 0;
  int height_ = 0;
  int channels_ = 0;
  std::vector<T> pixels_;
};

// Linear RGB radiance (3 channels), scene-referred.
using RadianceImage = Image<float>;

}  // namespace lightsketch
