#include "capture/frame/frame.h"

namespace lightsketch {

std::uint32_t Frame::sample(int x, int y, int channel) const {
  const PixelFormatInfo& info = pixelFormatInfo(format);
  const std::size_t pixel =
      static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
  const std::size_t offset =
      pixel * static_cast<std::size_t>(info.bytesPerPixel) + static_cast<std::size_t>(channel);
  if (info.bits <= 8) return bytes[offset];
  return static_cast<std::uint32_t>(bytes[offset] | (bytes[offset + 1] << 8));
}

}  // namespace lightsketch
