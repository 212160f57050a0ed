#include "capture/device/wire_format.h"

#include <gtest/gtest.h>

#include <random>

namespace lightsketch {
namespace {

using Bytes = std::vector<std::uint8_t>;

Bytes words(std::initializer_list<int> values) {
  Bytes bytes;
  for (const int value : values) {
    bytes.push_back(static_cast<std::uint8_t>(value));
    bytes.push_back(static_cast<std::uint8_t>(value >> 8));
  }
  return bytes;
}

WireFormat wire(std::uint32_t code) { return wireFormatFromCode(code).value(); }

Bytes unpacked(const WireFormat& format, const Bytes& bytes, std::size_t pixels) {
  Bytes out;
  unpackPixels(format, bytes, pixels, out);
  return out;
}

// By hand from the layouts of GigE Vision 1.2, section 26, and of PFNC 2.1.
TEST(WireFormat, PackedPixelsLieAsTheStandardsSay) {
  EXPECT_EQ(unpacked(wire(0x010C0006), {0xAB, 0x3C, 0x12}, 2), words({0xABC, 0x123}));
  EXPECT_EQ(unpacked(wire(0x010C0004), {0xFF, 0x12, 0x80}, 2), words({0x3FE, 0x201}));
  EXPECT_EQ(unpacked(wire(0x010C0047), {0xBC, 0x3A, 0x12}, 2), words({0xABC, 0x123}));
  EXPECT_EQ(unpacked(wire(0x010A0046), {0x01, 0x08, 0x30, 0x00, 0x01}, 4), words({1, 2, 3, 4}));
  EXPECT_EQ(unpacked(wire(0x02180015), {1, 2, 3, 4, 5, 6}, 2), (Bytes{3, 2, 1, 6, 5, 4}));
}

TEST(WireFormat, UnpackingInvertsPackingInEveryFormat) {
  std::mt19937 random(1);
  for (const PixelFormat format :
       {PixelFormat::kMono8, PixelFormat::kMono10, PixelFormat::kMono12, PixelFormat::kMono14,
        PixelFormat::kMono16, PixelFormat::kBayerRG10, PixelFormat::kBayerGR10,
        PixelFormat::kBayerGB12, PixelFormat::kBayerBG12, PixelFormat::kBayerRG12,
        PixelFormat::kRgb8}) {
    const PixelFormatInfo& info = pixelFormatInfo(format);
    for (const std::size_t pixels : {std::size_t{1}, std::size_t{2}, std::size_t{639 * 3}}) {
      Bytes frame(pixels * static_cast<std::size_t>(info.bytesPerPixel));
      for (std::size_t i = 0; i < frame.size(); ++i) {
        const unsigned mask = info.bits > 8 && i % 2 != 0 ? (1u << (info.bits - 8)) - 1 : 0xff;
        frame[i] = static_cast<std::uint8_t>(random() & mask);
      }
      for (const WireFormat& way : wireFormatsOf(format)) {
        SCOPED_TRACE(way.name);
        const Bytes packed = packPixels(way, frame);
        EXPECT_EQ(packed.size(), way.bytes(pixels));
        EXPECT_EQ(unpacked(way, packed, pixels), frame);
        EXPECT_EQ(wire(way.code).name, way.name);
        // The code says how many bits a pixel takes on the wire.
        EXPECT_EQ((pixels * (way.code >> 16 & 0xff) + 7) / 8, packed.size());
      }
    }
  }
}

// The catalogue of CRC algorithms gives this check value for CRC-16/XMODEM.
TEST(WireFormat, ChecksumIsTheCataloguesOne) {
  constexpr std::uint8_t kCheck[] = {'1', '2', '3', '4', '5', '6', '7', '8', '9'};
  EXPECT_EQ(crc16(kCheck), 0x31C3);
}

}  // namespace
}  // namespace lightsketch
