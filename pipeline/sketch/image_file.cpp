#include "pipeline/sketch/image_file.h"

#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfDoubleAttribute.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfIO.h>
#include <OpenEXR/ImfInputFile.h>
#include <OpenEXR/ImfOutputFile.h>
#include <OpenEXR/ImfStandardAttributes.h>
#include <OpenEXR/ImfStringAttribute.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <exception>
#include <limits>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "capture/frame/file.h"
#include "capture/frame/srgb.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

constexpr float kLargestHalf = 65504.0f;
constexpr std::int64_t kMaxPixels = std::int64_t{1} << 28;
constexpr int kMaxSide = 1 << 16;
constexpr std::uint64_t kMaxFileBytes = std::uint64_t{4} << 30;

// OpenEXR's own file streams swallow a failed write in their destructor, so a full disk would go
// unnoticed; files are encoded in memory and written by us.
class MemoryOutput final : public Imf::OStream {
 public:
  MemoryOutput() : Imf::OStream("memory") {}
  void write(const char bytes[], int count) override {
    const auto n = static_cast<std::size_t>(count);
    if (position_ + n > content_.size()) content_.resize(position_ + n);
    std::memcpy(content_.data() + position_, bytes, n);
    position_ += n;
  }
  std::uint64_t tellp() override { return position_; }
  void seekp(std::uint64_t position) override { position_ = position; }
  std::string take() { return std::move(content_); }

 private:
  std::string content_;
  std::size_t position_ = 0;
};

class MemoryInput final : public Imf::IStream {
 public:
  explicit MemoryInput(std::string_view content) : Imf::IStream("memory"), content_(content) {}
  bool read(char bytes[], int count) override {
    const auto n = static_cast<std::size_t>(count);
    if (count < 0 || position_ > content_.size() || n > content_.size() - position_) {
      throw std::runtime_error("the file ends too early");
    }
    std::memcpy(bytes, content_.data() + position_, n);
    position_ += n;
    return position_ < content_.size();
  }
  std::uint64_t tellg() override { return position_; }
  void seekg(std::uint64_t position) override { position_ = position; }

 private:
  std::string_view content_;
  std::size_t position_ = 0;
};

// What a header may claim, checked by OpenEXR before it allocates anything. Tiles of real files
// have up to 512 pixels a side.
void limitOpenExr() {
  static const bool once = [] {
    Imf::Header::setMaxImageSize(kMaxSide, kMaxSide);
    Imf::Header::setMaxTileSize(2048, 2048);
    return true;
  }();
  (void)once;
}

// Whether so few bytes can hold so many pixels: a constant picture takes some forty bytes for 32
// rows, noise two bytes a pixel. Small pictures are let through, whatever they are.
bool plausible(std::int64_t pixels, std::size_t bytes) {
  constexpr std::int64_t kHarmless = std::int64_t{1} << 24;
  return pixels <= kHarmless || pixels / 16'384 <= static_cast<std::int64_t>(bytes);
}

Imf::Compression compressionOf(ExrOptions::Compression compression) {
  switch (compression) {
    case ExrOptions::Compression::kNone:
      return Imf::NO_COMPRESSION;
    case ExrOptions::Compression::kZip:
      return Imf::ZIP_COMPRESSION;
    case ExrOptions::Compression::kPiz:
      break;
  }
  return Imf::PIZ_COMPRESSION;
}

// Sample value of an integer image to linear light.
template <class Sample>
std::vector<float> decodingTable(TransferFunction transfer) {
  constexpr std::size_t kMax = std::numeric_limits<Sample>::max();
  std::vector<float> table(kMax + 1);
  for (std::size_t i = 0; i <= kMax; ++i) {
    const float encoded = static_cast<float>(i) / static_cast<float>(kMax);
    table[i] = transfer == TransferFunction::kSrgb ? srgbDecode(encoded) : encoded;
  }
  return table;
}

template <class Sample>
const std::vector<float>& decodingTableOnce(TransferFunction transfer) {
  static const std::vector<float> srgb = decodingTable<Sample>(TransferFunction::kSrgb);
  static const std::vector<float> linear = decodingTable<Sample>(TransferFunction::kLinear);
  return transfer == TransferFunction::kSrgb ? srgb : linear;
}

// OpenCV's grey, grey+alpha, BGR or BGRA to RGB.
template <class Sample, class Convert>
RadianceImage toRgb(const cv::Mat& mat, const Convert& convert) {
  RadianceImage image(mat.cols, mat.rows, 3);
  const int channels = mat.channels();
  const bool colour = channels >= 3;
  for (int y = 0; y < mat.rows; ++y) {
    const Sample* in = mat.ptr<Sample>(y);
    float* out = image.row(y).data();
    for (int x = 0; x < mat.cols; ++x, in += channels, out += 3) {
      for (int c = 0; c < 3; ++c) out[c] = convert(in[colour ? 2 - c : 0]);
    }
  }
  return image;
}

// libjpeg fills what is missing with grey and says so on standard error only; libpng prints too.
// Both formats end in a mark that compressed data cannot contain.
bool isTruncated(std::string_view bytes) {
  if (bytes.starts_with("\xFF\xD8\xFF")) {
    const auto end = bytes.rfind("\xFF\xD9");
    const auto scan = bytes.rfind("\xFF\xDA");
    return end == bytes.npos || (scan != bytes.npos && scan > end);
  }
  if (bytes.starts_with("\x89PNG")) return bytes.rfind("IEND") == bytes.npos;
  return false;
}

bool isExr(std::string_view bytes) { return bytes.starts_with("\x76\x2f\x31\x01"); }

template <class Sample>
Result<std::string> encodePngOf(const Image<Sample>& image, int depth) {
  if (image.empty() || (image.channels() != 1 && image.channels() != 3)) {
    return failure(ErrorCode::kInvalidArgument, "a PNG needs 1 or 3 channels, not {} of {} x {}",
                   image.channels(), image.width(), image.height());
  }
  cv::Mat mat(image.height(), image.width(), CV_MAKETYPE(depth, image.channels()));
  for (int y = 0; y < image.height(); ++y) {
    const auto in = image.row(y);
    Sample* out = mat.ptr<Sample>(y);
    if (image.channels() == 1) {
      std::copy(in.begin(), in.end(), out);
    } else {
      for (std::size_t x = 0; x < in.size(); x += 3) {
        for (std::size_t c = 0; c < 3; ++c) out[x + c] = in[x + 2 - c];
      }
    }
  }
  try {
    std::vector<unsigned char> bytes;
    if (!cv::imencode(".png", mat, bytes)) {
      return failure(ErrorCode::kIo, "cannot encode a PNG of {} x {} pixels", image.width(),
                     image.height());
    }
    return std::string(bytes.begin(), bytes.end());
  } catch (const std::exception& error) {
    return failure(ErrorCode::kIo, "cannot encode a PNG of {} x {} pixels: {}", image.width(),
                   image.height(), error.what());
  }
}

Result<RadianceImage> decodeWithOpenCv(const std::string& bytes, TransferFunction transfer,
                                       const std::string& where) {
  if (bytes.empty()) return failure(ErrorCode::kCorrupt, "{}: the file is empty", where);
  if (isTruncated(bytes)) {
    return failure(ErrorCode::kCorrupt, "{}: the image is cut short; copy the file again", where);
  }
  if (bytes.size() > static_cast<std::size_t>(std::numeric_limits<int>::max())) {
    return failure(ErrorCode::kUnsupported, "{}: too large for an image", where);
  }
  const cv::Mat encoded(1, static_cast<int>(bytes.size()), CV_8UC1,
                        const_cast<char*>(bytes.data()));
  const cv::Mat mat = cv::imdecode(encoded, cv::IMREAD_UNCHANGED);
  if (mat.empty()) {
    return failure(ErrorCode::kCorrupt,
                   "{}: damaged or not an image (JPEG, PNG, TIFF, HDR and EXR are read)", where);
  }
  if (mat.cols > kMaxSide || mat.rows > kMaxSide) {
    return failure(ErrorCode::kUnsupported, "{}: {} x {} pixels are more than a camera makes",
                   where, mat.cols, mat.rows);
  }
  switch (mat.depth()) {
    case CV_8U: {
      const auto& table = decodingTableOnce<std::uint8_t>(transfer);
      return toRgb<std::uint8_t>(mat, [&](std::uint8_t v) { return table[v]; });
    }
    case CV_16U: {
      const auto& table = decodingTableOnce<std::uint16_t>(transfer);
      return toRgb<std::uint16_t>(mat, [&](std::uint16_t v) { return table[v]; });
    }
    case CV_32F:
      return toRgb<float>(mat, [](float v) { return v; });
    case CV_64F:
      return toRgb<double>(mat, [](double v) { return static_cast<float>(v); });
    default:
      return failure(ErrorCode::kUnsupported,
                     "{}: samples are neither 8 nor 16 bit nor floating point", where);
  }
}

}  // namespace

Result<RadianceImage> readImage(const fs::path& path, TransferFunction transfer) {
  ASSIGN_OR_RETURN(const auto bytes, readFile(path, kMaxFileBytes));
  if (isExr(bytes)) return decodeExr(bytes, path.string());
  try {
    return decodeWithOpenCv(bytes, transfer, path.string());
  } catch (const std::exception& error) {
    return failure(ErrorCode::kCorrupt, "{}: cannot be decoded: {}", path.string(), error.what());
  }
}

Result<std::string> encodeExr(const RadianceImage& image, const ExrOptions& options) {
  if (image.empty() || image.channels() != 3) {
    return failure(ErrorCode::kInvalidArgument, "an EXR needs 3 channels, not {} of {} x {}",
                   image.channels(), image.width(), image.height());
  }
  try {
    Imf::Header header(image.width(), image.height());
    header.compression() = compressionOf(options.compression);
    Imf::addChromaticities(header, Imf::Chromaticities());  // the default is Rec. 709
    for (const auto& [name, text] : options.attributes) {
      header.insert(name, Imf::StringAttribute(text));
    }
    for (const auto& [name, number] : options.numbers) {
      header.insert(name, Imf::DoubleAttribute(number));
    }

    std::vector<half> pixels(image.size());
    std::transform(image.values().begin(), image.values().end(), pixels.begin(), [](float value) {
      return half(std::clamp(value, -kLargestHalf, kLargestHalf));
    });
    Imf::FrameBuffer buffer;
    const std::size_t pixelBytes = 3 * sizeof(half);
    const std::array<const char*, 3> names{"R", "G", "B"};
    for (std::size_t c = 0; c < 3; ++c) {
      header.channels().insert(names[c], Imf::Channel(Imf::HALF));
      buffer.insert(names[c],
                    Imf::Slice(Imf::HALF, reinterpret_cast<char*>(pixels.data() + c), pixelBytes,
                               pixelBytes * static_cast<std::size_t>(image.width())));
    }
    MemoryOutput stream;
    {
      Imf::OutputFile file(stream, header, 0);
      file.setFrameBuffer(buffer);
      file.writePixels(image.height());
    }
    return stream.take();
  } catch (const std::exception& error) {
    return failure(ErrorCode::kIo, "cannot encode an EXR of {} x {} pixels: {}", image.width(),
                   image.height(), error.what());
  }
}

namespace {

std::uint32_t littleEndian(std::string_view bytes, std::size_t at) {
  std::uint32_t value = 0;
  for (std::size_t i = 4; i-- > 0;) value = value << 8 | static_cast<std::uint8_t>(bytes[at + i]);
  return value;
}

// Whether an attribute's value fills the bytes that it claims. OpenEXR reads what its type asks for
// and goes on from there, so that after any other it takes pixels for attributes.
bool fills(std::string_view type, std::string_view value) {
  constexpr std::pair<std::string_view, std::size_t> kSizes[] = {{"box2i", 16},
                                                                 {"box2f", 16},
                                                                 {"chromaticities", 32},
                                                                 {"compression", 1},
                                                                 {"deepImageState", 1},
                                                                 {"double", 8},
                                                                 {"envmap", 1},
                                                                 {"float", 4},
                                                                 {"int", 4},
                                                                 {"keycode", 28},
                                                                 {"lineOrder", 1},
                                                                 {"m33f", 36},
                                                                 {"m33d", 72},
                                                                 {"m44f", 64},
                                                                 {"m44d", 128},
                                                                 {"rational", 8},
                                                                 {"tiledesc", 9},
                                                                 {"timecode", 8},
                                                                 {"v2i", 8},
                                                                 {"v2f", 8},
                                                                 {"v2d", 16},
                                                                 {"v3i", 12},
                                                                 {"v3f", 12},
                                                                 {"v3d", 24}};
  for (const auto& [name, size] : kSizes) {
    if (type == name) return value.size() == size;
  }
  if (type == "floatvector") return value.size() % 4 == 0;
  if (type == "preview") {
    return value.size() >= 8 && (value.size() - 8) % 4 == 0 &&
           std::uint64_t{littleEndian(value, 0)} * littleEndian(value, 4) == (value.size() - 8) / 4;
  }
  if (type == "stringvector") {
    std::size_t at = 0;
    while (value.size() - at >= 4 && littleEndian(value, at) <= value.size() - at - 4) {
      at += 4 + littleEndian(value, at);
    }
    return at == value.size();
  }
  if (type == "chlist") {
    constexpr std::size_t kChannel = 16;  // after its name
    std::size_t at = 0;
    for (std::size_t end; (end = value.find('\0', at)) != std::string_view::npos;) {
      if (end == at) return end + 1 == value.size();
      at = end + 1 + kChannel;
    }
    return false;
  }
  return true;  // "string" and what OpenEXR does not know are as long as they say
}

// OpenEXR allocates what an attribute of the header claims to hold before it reads it: throws where
// one claims more than the file has left, or other than its type has.
void checkHeader(std::string_view bytes) {
  constexpr std::size_t kVersionEnd = 8;
  const bool severalParts = bytes.size() > 5 && (bytes[5] & 0x10) != 0;
  const std::runtime_error tooShort("the header ends too early");
  const auto skipName = [&](std::size_t at) {
    const std::size_t end = bytes.find('\0', at);
    if (end == std::string_view::npos) throw tooShort;
    return end + 1;
  };
  for (std::size_t at = kVersionEnd;;) {
    const std::size_t afterName = skipName(at);
    if (afterName == at + 1) {  // the end of a part's attributes
      if (!severalParts || skipName(afterName) == afterName + 1) return;
      at = afterName;
      continue;
    }
    const std::size_t afterType = skipName(afterName);
    const std::size_t value = afterType + 4;
    if (value > bytes.size()) throw tooShort;
    const std::uint32_t claimed = littleEndian(bytes, afterType);
    if (claimed > bytes.size() - value) throw tooShort;
    const std::string_view type = bytes.substr(afterName, afterType - 1 - afterName);
    if (!fills(type, bytes.substr(value, claimed))) {
      throw std::runtime_error(
          fmt::format("an attribute of the header is not of the size of a {}", type));
    }
    at = value + claimed;
  }
}

}  // namespace

Result<RadianceImage> decodeExr(std::string_view bytes, std::string_view where) {
  try {
    limitOpenExr();
    checkHeader(bytes);
    MemoryInput stream(bytes);
    Imf::InputFile file(stream, 0);
    const auto& window = file.header().dataWindow();
    const std::int64_t width = std::int64_t{window.max.x} - window.min.x + 1;
    const std::int64_t height = std::int64_t{window.max.y} - window.min.y + 1;
    if (width < 1 || height < 1 || width > kMaxSide || height > kMaxSide ||
        width * height > kMaxPixels || !plausible(width * height, bytes.size())) {
      return failure(ErrorCode::kUnsupported,
                     "{}: claims {} x {} pixels, more than are read here or than {} bytes hold",
                     where, width, height, bytes.size());
    }
    const auto& channels = file.header().channels();
    const bool colour = channels.findChannel("R") != nullptr;
    const std::array<const char*, 3> names =
        colour ? std::array{"R", "G", "B"} : std::array{"Y", "Y", "Y"};
    for (const char* name : names) {
      const auto* channel = channels.findChannel(name);
      if (channel == nullptr || channel->xSampling != 1 || channel->ySampling != 1 ||
          channels.findChannel("RY") != nullptr) {
        return failure(ErrorCode::kUnsupported,
                       "{}: has no full-size channels R, G, B or Y alone; save it as RGB", where);
      }
    }

    RadianceImage image(static_cast<int>(width), static_cast<int>(height), 3);
    const std::ptrdiff_t pixelBytes = 3 * sizeof(float);
    const std::ptrdiff_t rowBytes = pixelBytes * width;
    char* const origin =
        reinterpret_cast<char*>(image.data()) - window.min.x * pixelBytes - window.min.y * rowBytes;
    Imf::FrameBuffer buffer;
    for (std::size_t c = 0; c < (colour ? 3 : 1); ++c) {
      buffer.insert(names[c], Imf::Slice(Imf::FLOAT, origin + c * sizeof(float),
                                         static_cast<std::size_t>(pixelBytes),
                                         static_cast<std::size_t>(rowBytes)));
    }
    file.setFrameBuffer(buffer);
    file.readPixels(window.min.y, window.max.y);
    if (!colour) {
      for (std::size_t i = 0; i < image.size(); i += 3) {
        image.data()[i + 1] = image.data()[i + 2] = image.data()[i];
      }
    }
    return image;
  } catch (const std::exception& error) {
    return failure(ErrorCode::kCorrupt, "{}: damaged or not an EXR: {}", where, error.what());
  }
}

Result<ExrOptions> readExrHeader(std::string_view bytes, std::string_view where) {
  try {
    limitOpenExr();
    checkHeader(bytes);
    MemoryInput stream(bytes);
    const Imf::InputFile file(stream, 0);
    ExrOptions found;
    for (auto it = file.header().begin(); it != file.header().end(); ++it) {
      if (const auto* text = dynamic_cast<const Imf::StringAttribute*>(&it.attribute()))
        found.attributes[it.name()] = text->value();
      if (const auto* number = dynamic_cast<const Imf::DoubleAttribute*>(&it.attribute()))
        found.numbers[it.name()] = number->value();
    }
    return found;
  } catch (const std::exception& error) {
    return failure(ErrorCode::kCorrupt, "{}: damaged or not an EXR: {}", where, error.what());
  }
}

Result<void> writeExr(const fs::path& path, const RadianceImage& image, const ExrOptions& options) {
  ASSIGN_OR_RETURN(const auto bytes, encodeExr(image, options));
  return writeFileAtomically(path, bytes);
}

Image<std::uint8_t> toSrgb8(const RadianceImage& image, float exposure) {
  Image<std::uint8_t> encoded(image.width(), image.height(), image.channels());
  std::transform(image.values().begin(), image.values().end(), encoded.values().begin(),
                 [exposure](float value) { return srgbEncode8(exposure * value); });
  return encoded;
}

Image<std::uint16_t> toSrgb16(const RadianceImage& image) {
  Image<std::uint16_t> encoded(image.width(), image.height(), image.channels());
  std::transform(image.values().begin(), image.values().end(), encoded.values().begin(),
                 [](float value) {
                   const float clipped = value > 0 ? std::min(value, 1.0f) : 0.0f;
                   return static_cast<std::uint16_t>(65535.0f * srgbEncode(clipped) + 0.5f);
                 });
  return encoded;
}

Result<std::string> encodePng(const Image<std::uint8_t>& image) {
  return encodePngOf(image, CV_8U);
}

Result<void> writePng(const fs::path& path, const RadianceImage& image) {
  return writePng(path, toSrgb8(image));
}

Result<void> writePng(const fs::path& path, const Image<std::uint8_t>& image) {
  ASSIGN_OR_RETURN(const auto bytes, encodePng(image));
  return writeFileAtomically(path, bytes);
}

Result<void> writePng(const fs::path& path, const Image<std::uint16_t>& image) {
  ASSIGN_OR_RETURN(const auto bytes, encodePngOf(image, CV_16U));
  return writeFileAtomically(path, bytes);
}

}  // namespace lightsketch
