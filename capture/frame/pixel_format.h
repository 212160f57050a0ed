// The encodings that cameras send. Names and codes are GenICam's (PFNC 2.1).
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

namespace lightsketch {

enum class PixelFormat {
  kMono8,
  kMono10,  // 10, 12 and 16 bit: little endian in 16-bit words, value in the low bits
  kMono12,
  kMono16,
  kBayerRG8,  // first row R G R G..., second row G B G B...
  kBayerRG12,
  kBayerRG16,
  kRgb8,
};

struct PixelFormatInfo {
  PixelFormat format;
  std::string_view name;  // "BayerRG12"
  std::uint32_t pfncCode;
  int bytesPerPixel;
  int bits;      // significant bits per sample; the largest value is 2^bits - 1
  int channels;  // samples per pixel
  bool isBayer;
};

const PixelFormatInfo& pixelFormatInfo(PixelFormat format);
std::optional<PixelFormat> pixelFormatFromName(std::string_view genicamName);
std::optional<PixelFormat> pixelFormatFromCode(std::uint32_t pfncCode);

}  // namespace lightsketch
