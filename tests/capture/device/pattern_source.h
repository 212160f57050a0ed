// Pictures that say of themselves which frame they are, so that a received one can be checked to
// the last bit.
#pragma once

#include <unistd.h>

#include <chrono>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "capture/rig/gige_device.h"

namespace lightsketch {

// Value number `i` of frame `index` is a hash of both, cut to the format's bits; the first two
// values are the index itself.
inline std::vector<std::uint8_t> patternBytes(std::uint64_t index, PixelFormat format,
                                              const Region& region) {
  const PixelFormatInfo& info = pixelFormatInfo(format);
  const auto step = static_cast<std::size_t>(info.bits <= 8 ? 1 : 2);
  const auto bits = static_cast<unsigned>(info.bits);
  std::vector<std::uint8_t> bytes(static_cast<std::size_t>(region.width) *
                                  static_cast<std::size_t>(region.height) *
                                  static_cast<std::size_t>(info.bytesPerPixel));
  auto hash = static_cast<std::uint32_t>(index * 2654435761u + static_cast<unsigned>(region.x) +
                                         31u * static_cast<unsigned>(region.y) + 1u);
  for (std::size_t i = 0; i < bytes.size() / step; ++i) {
    hash ^= hash << 13;
    hash ^= hash >> 17;
    hash ^= hash << 5;
    std::uint64_t value = hash;
    if (i < 2) value = index >> (i * bits);
    value &= (1u << bits) - 1;
    bytes[i * step] = static_cast<std::uint8_t>(value);
    if (step == 2) bytes[i * step + 1] = static_cast<std::uint8_t>(value >> 8);
  }
  return bytes;
}

inline std::uint64_t indexOf(const Frame& frame) {
  const auto bits = static_cast<unsigned>(pixelFormatInfo(frame.format).bits);
  const bool rgb = pixelFormatInfo(frame.format).channels == 3;
  return frame.sample(0, 0, 0) | (rgb ? frame.sample(0, 0, 1) : frame.sample(1, 0)) << bits;
}

class PatternSource : public FrameSource {
 public:
  PatternSource(int width, int height, std::vector<PixelFormat> formats)
      : width_(width), height_(height), formats_(std::move(formats)) {}

  int sensorWidth() const override { return width_; }
  int sensorHeight() const override { return height_; }
  std::vector<PixelFormat> formats() const override { return formats_; }
  void expose(const ExposureRequest& request, std::vector<std::uint8_t>& bytes) override {
    bytes = patternBytes(request.index, request.format, request.region);
    std::unique_lock lock(mutex_);
    requests_[request.index] = request;
    lock.unlock();
    const std::lock_guard wait(gate_);
  }
  void guide(const Guide& guide) override {
    const std::lock_guard lock(mutex_);
    guide_ = guide;
  }

  // What frame `index` was exposed with: the truth.
  ExposureRequest request(std::uint64_t index) const {
    const std::lock_guard lock(mutex_);
    return requests_.at(index);
  }
  std::size_t exposed() const {
    const std::lock_guard lock(mutex_);
    return requests_.size();
  }
  std::optional<Guide> lastGuide() const {
    const std::lock_guard lock(mutex_);
    return guide_;
  }
  // expose() does not return while this is held.
  std::mutex& gate() { return gate_; }

 private:
  const int width_;
  const int height_;
  const std::vector<PixelFormat> formats_;
  std::mutex gate_;
  mutable std::mutex mutex_;  // Guards requests_ and guide_.
  std::map<std::uint64_t, ExposureRequest> requests_;
  std::optional<Guide> guide_;
};

// A loopback address of this process alone, so that tests run side by side.
inline std::string ownAddress(int number) {
  const int process = ::getpid();
  return fmt::format("127.{}.{}.{}", 20 + number, process >> 8 & 0xff, process & 0xff);
}

// Waits for what another thread brings about; the limit only ends a failed test.
template <class Condition>
bool eventually(Condition condition, std::chrono::seconds limit = std::chrono::seconds(20)) {
  const auto end = std::chrono::steady_clock::now() + limit;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return true;
}

}  // namespace lightsketch
