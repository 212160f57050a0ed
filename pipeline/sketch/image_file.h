// Image files in and out. OpenEXR through OpenEXR, the rest through OpenCV.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>

#include "capture/frame/image.h"
#include "capture/frame/result.h"

namespace lightsketch {

enum class TransferFunction { kSrgb, kLinear };

// JPEG, PNG (8, 16 bit), TIFF (8, 16 bit, float), Radiance HDR or EXR, by content, as linear RGB.
// Integer samples are scaled to 0..1 and decoded by `transfer`; HDR, float TIFF and EXR are linear
// always. Grey becomes RGB, alpha is dropped. Orientation tags are ignored (they would rotate
// single frames). Refuses truncated files. Thread-safe.
Result<RadianceImage> readImage(const std::filesystem::path& path,
                                TransferFunction transfer = TransferFunction::kSrgb);

struct ExrOptions {
  enum class Compression { kNone, kPiz, kZip };
  Compression compression = Compression::kPiz;
  std::map<std::string, std::string> attributes;  // text attributes in the header
  std::map<std::string, double> numbers;          // double attributes in the header
};

// Half RGB (values beyond 65504 clip there), Rec. 709 chromaticities in the header. Atomic.
Result<void> writeExr(const std::filesystem::path& path, const RadianceImage& image,
                      const ExrOptions& options = {});
// The same as bytes and back; `where` is the file for messages. The reader takes RGB or Y channels
// of any type and refuses images larger than a camera makes before it allocates.
Result<std::string> encodeExr(const RadianceImage& image, const ExrOptions& options = {});
Result<RadianceImage> decodeExr(std::string_view bytes, std::string_view where);
// The texts and numbers that encodeExr() put into the header, and any others of these kinds.
Result<ExrOptions> readExrHeader(std::string_view bytes, std::string_view where);

// 8-bit PNG, sRGB-encoded from linear RGB, clipped. Atomic.
Result<void> writePng(const std::filesystem::path& path, const RadianceImage& image);
// 8- or 16-bit values as they are, 1 or 3 channels (RGB).
Result<void> writePng(const std::filesystem::path& path, const Image<std::uint8_t>& image);
Result<void> writePng(const std::filesystem::path& path, const Image<std::uint16_t>& image);
// The same as the bytes of a PNG file, for embedding.
Result<std::string> encodePng(const Image<std::uint8_t>& image);
// Linear RGB to 8- and 16-bit sRGB, clipped.
Image<std::uint8_t> toSrgb8(const RadianceImage& image, float exposure = 1.0f);
Image<std::uint16_t> toSrgb16(const RadianceImage& image);

}  // namespace lightsketch
