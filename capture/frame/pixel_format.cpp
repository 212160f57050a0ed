#include "capture/frame/pixel_format.h"

#include <array>
#include <stdexcept>

namespace lightsketch {
namespace {

constexpr std::array<PixelFormatInfo, 8> kFormats{{
    {PixelFormat::kMono8, "Mono8", 0x01080001, 1, 8, 1, false},
    {PixelFormat::kMono10, "Mono10", 0x01100003, 2, 10, 1, false},
    {PixelFormat::kMono12, "Mono12", 0x01100005, 2, 12, 1, false},
    {PixelFormat::kMono16, "Mono16", 0x01100007, 2, 16, 1, false},
    {PixelFormat::kBayerRG8, "BayerRG8", 0x01080009, 1, 8, 1, true},
    {PixelFormat::kBayerRG12, "BayerRG12", 0x01100011, 2, 12, 1, true},
    {PixelFormat::kBayerRG16, "BayerRG16", 0x0110002F, 2, 16, 1, true},
    {PixelFormat::kRgb8, "RGB8", 0x02180014, 3, 8, 3, false},
}};

}  // namespace

const PixelFormatInfo& pixelFormatInfo(PixelFormat format) {
  for (const auto& info : kFormats) {
    if (info.format == format) return info;
  }
  throw std::logic_error("unknown pixel format");
}

std::optional<PixelFormat> pixelFormatFromName(std::string_view genicamName) {
  for (const auto& info : kFormats) {
    if (info.name == genicamName) return info.format;
  }
  return std::nullopt;
}

std::optional<PixelFormat> pixelFormatFromCode(std::uint32_t pfncCode) {
  for (const auto& info : kFormats) {
    if (info.pfncCode == pfncCode) return info.format;
  }
  return std::nullopt;
}

}  // namespace lightsketch
