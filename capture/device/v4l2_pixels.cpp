#include "capture/device/v4l2_pixels.h"

#include <linux/videodev2.h>
#include <turbojpeg.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <memory>

namespace lightsketch {
namespace {

using enum PixelFormat;

constexpr std::array<V4l2Conversion, 32> kConversions{{
    {V4L2_PIX_FMT_SRGGB16, kBayerRG16, true, true}, {V4L2_PIX_FMT_SGRBG16, kBayerGR16, true, true},
    {V4L2_PIX_FMT_SGBRG16, kBayerGB16, true, true}, {V4L2_PIX_FMT_SBGGR16, kBayerBG16, true, true},
    {V4L2_PIX_FMT_Y16, kMono16, true, true},        {V4L2_PIX_FMT_SRGGB14, kBayerRG14, true, true},
    {V4L2_PIX_FMT_SGRBG14, kBayerGR14, true, true}, {V4L2_PIX_FMT_SGBRG14, kBayerGB14, true, true},
    {V4L2_PIX_FMT_SBGGR14, kBayerBG14, true, true}, {V4L2_PIX_FMT_Y14, kMono14, true, true},
    {V4L2_PIX_FMT_SRGGB12, kBayerRG12, true, true}, {V4L2_PIX_FMT_SGRBG12, kBayerGR12, true, true},
    {V4L2_PIX_FMT_SGBRG12, kBayerGB12, true, true}, {V4L2_PIX_FMT_SBGGR12, kBayerBG12, true, true},
    {V4L2_PIX_FMT_Y12, kMono12, true, true},        {V4L2_PIX_FMT_SRGGB10, kBayerRG10, true, true},
    {V4L2_PIX_FMT_SGRBG10, kBayerGR10, true, true}, {V4L2_PIX_FMT_SGBRG10, kBayerGB10, true, true},
    {V4L2_PIX_FMT_SBGGR10, kBayerBG10, true, true}, {V4L2_PIX_FMT_Y10, kMono10, true, true},
    {V4L2_PIX_FMT_SRGGB8, kBayerRG8, true, true},   {V4L2_PIX_FMT_SGRBG8, kBayerGR8, true, true},
    {V4L2_PIX_FMT_SGBRG8, kBayerGB8, true, true},   {V4L2_PIX_FMT_SBGGR8, kBayerBG8, true, true},
    {V4L2_PIX_FMT_RGB24, kRgb8, false, true},       {V4L2_PIX_FMT_YUYV, kRgb8, false, false},
    {V4L2_PIX_FMT_NV12, kRgb8, false, false},       {V4L2_PIX_FMT_MJPEG, kRgb8, false, false},
    {V4L2_PIX_FMT_GREY, kMono8, false, true},       {V4L2_PIX_FMT_YUYV, kMono8, false, true},
    {V4L2_PIX_FMT_NV12, kMono8, false, true},       {V4L2_PIX_FMT_MJPEG, kMono8, false, false},
}};

std::size_t index(int value) { return static_cast<std::size_t>(value); }

// Y'CbCr of 8 bits to R'G'B', Rec. ITU-R BT.601 and BT.709: R' = Y' + 2 (1 - kr) Cr and so on, with
// Y' in 0..1 and Cb, Cr in -1/2..1/2.
class YcbcrMatrix {
 public:
  explicit YcbcrMatrix(const V4l2Layout& layout) {
    const float kr = layout.isBt709 ? 0.2126f : 0.299f;
    const float kb = layout.isBt709 ? 0.0722f : 0.114f;
    const float kg = 1 - kr - kb;
    const float chroma = layout.fullRange ? 1.0f : 255.0f / 224.0f;
    black_ = layout.fullRange ? 0.0f : 16.0f;
    luma_ = layout.fullRange ? 1.0f : 255.0f / 219.0f;
    redFromCr_ = 2 * (1 - kr) * chroma;
    blueFromCb_ = 2 * (1 - kb) * chroma;
    greenFromCr_ = -kr / kg * redFromCr_;
    greenFromCb_ = -kb / kg * blueFromCb_;
  }
  void toRgb(std::uint8_t y, std::uint8_t cb, std::uint8_t cr, std::uint8_t* rgb) const {
    const float l = luma_ * (static_cast<float>(y) - black_) + 0.5f;
    const float b = static_cast<float>(cb) - 128;
    const float r = static_cast<float>(cr) - 128;
    const auto code = [](float v) { return static_cast<std::uint8_t>(std::clamp(v, 0.f, 255.f)); };
    rgb[0] = code(l + redFromCr_ * r);
    rgb[1] = code(l + greenFromCb_ * b + greenFromCr_ * r);
    rgb[2] = code(l + blueFromCb_ * b);
  }

 private:
  float black_, luma_, redFromCr_, blueFromCb_, greenFromCr_, greenFromCb_;
};

// What a JPEG decoder would rather print, it tells here.
Result<void> decodeJpeg(const V4l2Layout& layout, std::span<const std::uint8_t> bytes,
                        Frame& frame) {
  const std::unique_ptr<void, int (*)(tjhandle)> decoder(tjInitDecompress(), tjDestroy);
  int width = 0, height = 0, subsampling = 0, colours = 0;
  const auto size = static_cast<unsigned long>(bytes.size());
  if (tjDecompressHeader3(decoder.get(), bytes.data(), size, &width, &height, &subsampling,
                          &colours) != 0 ||
      width != layout.width || height != layout.height) {
    return failure(ErrorCode::kCorrupt, "no JPEG of {} x {}", layout.width, layout.height);
  }
  // A warning stands for damaged data, which the decoder would paint over.
  const bool colour = frame.format == kRgb8;
  if (tjDecompress2(decoder.get(), bytes.data(), size, frame.bytes.data(), width,
                    width * (colour ? 3 : 1), height, colour ? TJPF_RGB : TJPF_GRAY, 0) != 0) {
    return failure(ErrorCode::kCorrupt, "damaged JPEG: {}", tjGetErrorStr2(decoder.get()));
  }
  return {};
}

// Lines of Y with Cb and Cr for two pixels: Y Cb Y Cr.
void unpackYuyv(const V4l2Layout& layout, const std::uint8_t* in, Frame& frame) {
  const YcbcrMatrix matrix(layout);
  std::uint8_t* out = frame.bytes.data();
  for (int y = 0; y < layout.height; ++y, in += layout.bytesPerLine) {
    for (int x = 0; x < layout.width; ++x) {
      if (frame.format == kMono8) {
        *out++ = in[2 * x];
      } else {
        const std::uint8_t* const pair = in + 2 * (x & ~1);
        matrix.toRgb(in[2 * x], pair[1], pair[3], out);
        out += 3;
      }
    }
  }
}

// A plane of Y, then one of Cb and Cr for 2 x 2 pixels.
void unpackNv12(const V4l2Layout& layout, const std::uint8_t* in, Frame& frame) {
  const YcbcrMatrix matrix(layout);
  const std::uint8_t* const chroma = in + index(layout.height) * index(layout.bytesPerLine);
  std::uint8_t* out = frame.bytes.data();
  for (int y = 0; y < layout.height; ++y) {
    const std::uint8_t* const luma = in + index(y) * index(layout.bytesPerLine);
    const std::uint8_t* const both = chroma + index(y / 2) * index(layout.bytesPerLine);
    for (int x = 0; x < layout.width; ++x) {
      if (frame.format == kMono8) {
        *out++ = luma[x];
      } else {
        matrix.toRgb(luma[x], both[x & ~1], both[(x & ~1) + 1], out);
        out += 3;
      }
    }
  }
}

}  // namespace

std::span<const V4l2Conversion> v4l2Conversions() { return kConversions; }

std::string fourccName(std::uint32_t fourcc) {
  std::string name;
  for (int shift = 0; shift < 32; shift += 8) {
    name += static_cast<char>(fourcc >> shift & 0x7f);
  }
  while (!name.empty() && name.back() == ' ') name.pop_back();
  return name;
}

Result<void> unpackV4l2(const V4l2Conversion& conversion, const V4l2Layout& layout,
                        std::span<const std::uint8_t> bytes, Frame& frame) {
  const PixelFormatInfo& info = pixelFormatInfo(conversion.format);
  const std::size_t width = index(layout.width);
  const std::size_t height = index(layout.height);
  frame.format = conversion.format;
  frame.width = layout.width;
  frame.height = layout.height;
  frame.bytes.resize(width * height * index(info.bytesPerPixel));
  if (conversion.fourcc == V4L2_PIX_FMT_MJPEG) {
    return decodeJpeg(layout, bytes, frame);
  }

  // The last line may end with its last pixel.
  const bool yuyv = conversion.fourcc == V4L2_PIX_FMT_YUYV;
  const bool nv12 = conversion.fourcc == V4L2_PIX_FMT_NV12;
  const std::size_t even = (width + 1) / 2 * 2;
  const std::size_t line = yuyv ? 2 * even : nv12 ? even : width * index(info.bytesPerPixel);
  const std::size_t lines = nv12 ? height + (height + 1) / 2 : height;
  const std::size_t stride = index(layout.bytesPerLine);
  const std::size_t needed = (lines - 1) * stride + line;
  if (stride < line || bytes.size() < needed) {
    return failure(ErrorCode::kCorrupt, "{} bytes where {} x {} {} needs {}", bytes.size(),
                   layout.width, layout.height, fourccName(conversion.fourcc), needed);
  }
  if (yuyv) {
    unpackYuyv(layout, bytes.data(), frame);
  } else if (nv12) {
    unpackNv12(layout, bytes.data(), frame);
  } else {
    for (std::size_t y = 0; y < height; ++y) {
      std::memcpy(frame.bytes.data() + y * line, bytes.data() + y * stride, line);
    }
  }
  return {};
}

}  // namespace lightsketch
