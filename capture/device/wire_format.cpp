#include "capture/device/wire_format.h"

#include <algorithm>
#include <array>

namespace lightsketch {
namespace {

using Packing = WireFormat::Packing;

constexpr std::array<WireFormat, 22> kPacked{{
    {0x010C0004, "Mono10Packed", PixelFormat::kMono10, Packing::kPacked},
    {0x010C0006, "Mono12Packed", PixelFormat::kMono12, Packing::kPacked},
    {0x010C0026, "BayerGR10Packed", PixelFormat::kBayerGR10, Packing::kPacked},
    {0x010C0027, "BayerRG10Packed", PixelFormat::kBayerRG10, Packing::kPacked},
    {0x010C0028, "BayerGB10Packed", PixelFormat::kBayerGB10, Packing::kPacked},
    {0x010C0029, "BayerBG10Packed", PixelFormat::kBayerBG10, Packing::kPacked},
    {0x010C002A, "BayerGR12Packed", PixelFormat::kBayerGR12, Packing::kPacked},
    {0x010C002B, "BayerRG12Packed", PixelFormat::kBayerRG12, Packing::kPacked},
    {0x010C002C, "BayerGB12Packed", PixelFormat::kBayerGB12, Packing::kPacked},
    {0x010C002D, "BayerBG12Packed", PixelFormat::kBayerBG12, Packing::kPacked},
    {0x010A0046, "Mono10p", PixelFormat::kMono10, Packing::kP},
    {0x010C0047, "Mono12p", PixelFormat::kMono12, Packing::kP},
    {0x010E0104, "Mono14p", PixelFormat::kMono14, Packing::kP},
    {0x010A0052, "BayerBG10p", PixelFormat::kBayerBG10, Packing::kP},
    {0x010C0053, "BayerBG12p", PixelFormat::kBayerBG12, Packing::kP},
    {0x010A0054, "BayerGB10p", PixelFormat::kBayerGB10, Packing::kP},
    {0x010C0055, "BayerGB12p", PixelFormat::kBayerGB12, Packing::kP},
    {0x010A0056, "BayerGR10p", PixelFormat::kBayerGR10, Packing::kP},
    {0x010C0057, "BayerGR12p", PixelFormat::kBayerGR12, Packing::kP},
    {0x010A0058, "BayerRG10p", PixelFormat::kBayerRG10, Packing::kP},
    {0x010C0059, "BayerRG12p", PixelFormat::kBayerRG12, Packing::kP},
    {0x02180015, "BGR8", PixelFormat::kRgb8, Packing::kSwapped},
}};

WireFormat plain(PixelFormat format) {
  const PixelFormatInfo& info = pixelFormatInfo(format);
  return {info.pfncCode, info.name, format, Packing::kNone};
}

// Both directions of kPacked share where the low bits are: the first pixel's in the low half of
// the middle byte, the second's in its high half.
constexpr int kSecondShift = 4;

}  // namespace

std::size_t WireFormat::bytes(std::size_t pixels) const {
  const PixelFormatInfo& info = pixelFormatInfo(format);
  switch (packing) {
    case Packing::kPacked:
      return (pixels * 3 + 1) / 2;
    case Packing::kP:
      return (pixels * static_cast<std::size_t>(info.bits) + 7) / 8;
    default:
      return pixels * static_cast<std::size_t>(info.bytesPerPixel);
  }
}

std::optional<WireFormat> wireFormatFromCode(std::uint32_t pfncCode) {
  if (const auto format = pixelFormatFromCode(pfncCode)) return plain(*format);
  for (const WireFormat& packed : kPacked) {
    if (packed.code == pfncCode) return packed;
  }
  return std::nullopt;
}

std::vector<WireFormat> wireFormatsOf(PixelFormat format) {
  std::vector<WireFormat> all{plain(format)};
  std::copy_if(kPacked.begin(), kPacked.end(), std::back_inserter(all),
               [format](const WireFormat& packed) { return packed.format == format; });
  return all;
}

void unpackPixels(const WireFormat& format, std::span<const std::uint8_t> wire, std::size_t pixels,
                  std::vector<std::uint8_t>& out) {
  const auto bits = static_cast<unsigned>(pixelFormatInfo(format.format).bits);
  out.assign(wire.begin(), wire.end());
  if (format.packing == Packing::kNone) return;
  if (format.packing == Packing::kSwapped) {
    for (std::size_t i = 0; i + 2 < out.size(); i += 3) std::swap(out[i], out[i + 2]);
    return;
  }
  out.resize(2 * pixels);
  const auto put = [&](std::size_t pixel, std::uint32_t value) {
    out[2 * pixel] = static_cast<std::uint8_t>(value);
    out[2 * pixel + 1] = static_cast<std::uint8_t>(value >> 8);
  };
  const std::uint32_t lowMask = (1u << (bits - 8)) - 1;
  if (format.packing == Packing::kPacked) {
    for (std::size_t i = 0; i < pixels; ++i) {
      const std::uint8_t* group = wire.data() + i / 2 * 3;
      const bool second = i % 2 != 0;
      const std::uint32_t low = (second ? group[1] >> kSecondShift : group[1]) & lowMask;
      put(i, static_cast<std::uint32_t>(group[second ? 2 : 0]) << (bits - 8) | low);
    }
    return;
  }
  std::uint32_t pending = 0;
  unsigned count = 0;
  std::size_t next = 0;
  for (std::size_t i = 0; i < pixels; ++i) {
    for (; count < bits; count += 8) pending |= static_cast<std::uint32_t>(wire[next++]) << count;
    put(i, pending & ((1u << bits) - 1));
    pending >>= bits;
    count -= bits;
  }
}

std::vector<std::uint8_t> packPixels(const WireFormat& format,
                                     std::span<const std::uint8_t> frame) {
  std::vector<std::uint8_t> out(frame.begin(), frame.end());
  if (format.packing == Packing::kNone) return out;
  if (format.packing == Packing::kSwapped) {
    for (std::size_t i = 0; i + 2 < out.size(); i += 3) std::swap(out[i], out[i + 2]);
    return out;
  }
  const auto bits = static_cast<unsigned>(pixelFormatInfo(format.format).bits);
  const std::size_t pixels = frame.size() / 2;
  out.assign(format.bytes(pixels), 0);
  const auto value = [&](std::size_t pixel) {
    return static_cast<std::uint32_t>(frame[2 * pixel] | frame[2 * pixel + 1] << 8);
  };
  for (std::size_t i = 0; i < pixels; ++i) {
    if (format.packing == Packing::kPacked) {
      const bool second = i % 2 != 0;
      const std::uint32_t low = value(i) & ((1u << (bits - 8)) - 1);
      const std::size_t group = i / 2 * 3;
      if (second) {
        out[group + 2] = static_cast<std::uint8_t>(value(i) >> (bits - 8));
      } else {
        out[group] = static_cast<std::uint8_t>(value(i) >> (bits - 8));
      }
      out[group + 1] |= static_cast<std::uint8_t>(second ? low << kSecondShift : low);
      continue;
    }
    for (unsigned bit = 0; bit < bits; ++bit) {
      const std::size_t at = i * bits + bit;
      out[at / 8] |= static_cast<std::uint8_t>((value(i) >> bit & 1u) << (at % 8));
    }
  }
  return out;
}

std::uint16_t crc16(std::span<const std::uint8_t> bytes) {
  static const auto table = [] {
    std::array<std::uint16_t, 256> values{};
    for (unsigned i = 0; i < values.size(); ++i) {
      unsigned crc = i << 8;
      for (int bit = 0; bit < 8; ++bit) crc = crc << 1 ^ ((crc & 0x8000) != 0 ? 0x1021u : 0u);
      values[i] = static_cast<std::uint16_t>(crc);
    }
    return values;
  }();
  std::uint16_t crc = 0;
  for (const std::uint8_t byte : bytes) {
    crc = static_cast<std::uint16_t>(crc << 8 ^ table[static_cast<std::size_t>(crc >> 8 ^ byte)]);
  }
  return crc;
}

}  // namespace lightsketch
