#include "capture/frame/pixel_format.h"

#include <array>
#include <stdexcept>

namespace lightsketch {
namespace {

constexpr std::array<PixelFormatInfo, 26> kFormats{{
    {PixelFormat::kMono8, "Mono8", 0x01080001, 1, 8, 1, false},
    {PixelFormat::kMono10, "Mono10", 0x01100003, 2, 10, 1, false},
    {PixelFormat::kMono12, "Mono12", 0x01100005, 2, 12, 1, false},
    {PixelFormat::kMono14, "Mono14", 0x01100025, 2, 14, 1, false},
    {PixelFormat::kMono16, "Mono16", 0x01100007, 2, 16, 1, false},
    {PixelFormat::kBayerRG8, "BayerRG8", 0x01080009, 1, 8, 1, true, 0, 0},
    {PixelFormat::kBayerRG10, "BayerRG10", 0x0110000D, 2, 10, 1, true, 0, 0},
    {PixelFormat::kBayerRG12, "BayerRG12", 0x01100011, 2, 12, 1, true, 0, 0},
    {PixelFormat::kBayerRG14, "BayerRG14", 0x0110010A, 2, 14, 1, true, 0, 0},
    {PixelFormat::kBayerRG16, "BayerRG16", 0x0110002F, 2, 16, 1, true, 0, 0},
    {PixelFormat::kBayerGR8, "BayerGR8", 0x01080008, 1, 8, 1, true, 1, 0},
    {PixelFormat::kBayerGR10, "BayerGR10", 0x0110000C, 2, 10, 1, true, 1, 0},
    {PixelFormat::kBayerGR12, "BayerGR12", 0x01100010, 2, 12, 1, true, 1, 0},
    {PixelFormat::kBayerGR14, "BayerGR14", 0x01100109, 2, 14, 1, true, 1, 0},
    {PixelFormat::kBayerGR16, "BayerGR16", 0x0110002E, 2, 16, 1, true, 1, 0},
    {PixelFormat::kBayerGB8, "BayerGB8", 0x0108000A, 1, 8, 1, true, 0, 1},
    {PixelFormat::kBayerGB10, "BayerGB10", 0x0110000E, 2, 10, 1, true, 0, 1},
    {PixelFormat::kBayerGB12, "BayerGB12", 0x01100012, 2, 12, 1, true, 0, 1},
    {PixelFormat::kBayerGB14, "BayerGB14", 0x0110010B, 2, 14, 1, true, 0, 1},
    {PixelFormat::kBayerGB16, "BayerGB16", 0x01100030, 2, 16, 1, true, 0, 1},
    {PixelFormat::kBayerBG8, "BayerBG8", 0x0108000B, 1, 8, 1, true, 1, 1},
    {PixelFormat::kBayerBG10, "BayerBG10", 0x0110000F, 2, 10, 1, true, 1, 1},
    {PixelFormat::kBayerBG12, "BayerBG12", 0x01100013, 2, 12, 1, true, 1, 1},
    {PixelFormat::kBayerBG14, "BayerBG14", 0x0110010C, 2, 14, 1, true, 1, 1},
    {PixelFormat::kBayerBG16, "BayerBG16", 0x01100031, 2, 16, 1, true, 1, 1},
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
