// One exposure as the camera sent it: encoded pixels and what is known about them.
#pragma once

#include <cstdint>
#include <vector>

#include "capture/frame/pixel_format.h"
#include "capture/frame/time.h"

namespace lightsketch {

struct Region {
  int x = 0;
  int y = 0;
  int width = 0;
  int height = 0;
  bool operator==(const Region&) const = default;
};

struct FrameMetadata {
  std::uint64_t id = 0;           // the device's frame counter, unwrapped; gaps are lost frames
  std::int64_t deviceTimeNs = 0;  // the device's own clock at the start of exposure
  TimePoint midExposure;          // mapped to the host's clock
  Duration timeUncertainty{0};    // one sigma of that mapping
  TimePoint arrival;              // when the last byte was here
  double exposureSeconds = 0;
  double gainDb = 0;
};

struct Frame {
  FrameMetadata metadata;
  PixelFormat format = PixelFormat::kMono8;
  int width = 0;
  int height = 0;
  std::vector<std::uint8_t> bytes;  // height * width * bytesPerPixel, no padding

  // Sample at a pixel as a number from 0 to 2^bits - 1.
  std::uint32_t sample(int x, int y, int channel = 0) const;
};

}  // namespace lightsketch
