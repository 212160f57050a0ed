// Pixels as GenICam cameras send them, packed ones included, and as frames hold them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "capture/frame/pixel_format.h"

namespace lightsketch {

// What a format code on the wire means. Names and codes are PFNC 2.1's.
struct WireFormat {
  enum class Packing {
    kNone,     // as in a Frame
    kPacked,   // "Mono12Packed": two pixels in three bytes, their high eight bits outside (GigE
               // Vision 1.2, section 26)
    kP,        // "Mono12p": pixels follow each other bit by bit, lowest first
    kSwapped,  // "BGR8"
  };
  std::uint32_t code = 0;
  std::string_view name;
  PixelFormat format = PixelFormat::kMono8;
  Packing packing = Packing::kNone;

  // Bytes of so many pixels; a packed picture ends with a whole byte.
  std::size_t bytes(std::size_t pixels) const;
};

std::optional<WireFormat> wireFormatFromCode(std::uint32_t pfncCode);
// All ways to send a format; the plain one first.
std::vector<WireFormat> wireFormatsOf(PixelFormat format);

// `out` gets the pixels as a Frame holds them; `wire` has WireFormat::bytes(pixels).
void unpackPixels(const WireFormat& format, std::span<const std::uint8_t> wire, std::size_t pixels,
                  std::vector<std::uint8_t>& out);
// The inverse.
std::vector<std::uint8_t> packPixels(const WireFormat& format, std::span<const std::uint8_t> frame);

// Basler's PayloadCRC16: CRC-16/XMODEM (polynomial 0x1021, initially 0).
std::uint16_t crc16(std::span<const std::uint8_t> bytes);

}  // namespace lightsketch
