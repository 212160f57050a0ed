// The encodings that cameras send. Names and codes are GenICam's (PFNC 2.1).
#pragma once

#include <cstdint>
#include <optional>
#include <string_view>

namespace lightsketch {

enum class PixelFormat {
  kMono8,
  kMono10,  // 10 to 16 bit: little endian in 16-bit words, value in the low bits
  kMono12,
  kMono14,
  kMono16,
  kBayerRG8,  // first row R G R G..., second row G B G B...
  kBayerRG10,
  kBayerRG12,
  kBayerRG14,
  kBayerRG16,
  kBayerGR8,
  kBayerGR10,
  kBayerGR12,
  kBayerGR14,
  kBayerGR16,
  kBayerGB8,
  kBayerGB10,
  kBayerGB12,
  kBayerGB14,
  kBayerGB16,
  kBayerBG8,
  kBayerBG10,
  kBayerBG12,
  kBayerBG14,
  kBayerBG16,
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
  int redX = 0;  // where the mosaic's cell of 2 x 2 has red; blue is diagonally opposite
  int redY = 0;
};

const PixelFormatInfo& pixelFormatInfo(PixelFormat format);
std::optional<PixelFormat> pixelFormatFromName(std::string_view genicamName);
std::optional<PixelFormat> pixelFormatFromCode(std::uint32_t pfncCode);

}  // namespace lightsketch
