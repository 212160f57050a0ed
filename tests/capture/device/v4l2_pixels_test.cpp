#include "capture/device/v4l2_pixels.h"

#include <gtest/gtest.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <opencv2/imgcodecs.hpp>

namespace lightsketch {
namespace {

V4l2Conversion conversionOf(std::uint32_t fourcc, PixelFormat format) {
  for (const V4l2Conversion& conversion : v4l2Conversions()) {
    if (conversion.fourcc == fourcc && conversion.format == format) return conversion;
  }
  ADD_FAILURE() << fourccName(fourcc) << " does not become " << pixelFormatInfo(format).name;
  return {};
}

TEST(V4l2Conversions, CoverEveryFormatAndPreferDeepLinearOnes) {
  const auto all = v4l2Conversions();
  std::string names;
  for (const V4l2Conversion& conversion : all) names += fourccName(conversion.fourcc) + " ";
  for (const char* name : {"YUYV", "MJPG", "GREY", "Y10 ", "Y12 ", "Y16 ", "NV12", "RGB3",  //
                           "RGGB", "GRBG", "GBRG", "BA81", "RG10", "BA10", "GB10", "BG10",  //
                           "RG12", "BA12", "GB12", "BG12", "RG14", "GR14", "GB14", "BG14",  //
                           "RG16", "GR16", "GB16", "BYR2"}) {
    EXPECT_NE(names.find(name), std::string::npos) << name;
  }
  int bits = 16;
  bool linear = true;
  for (const V4l2Conversion& conversion : all) {
    EXPECT_LE(pixelFormatInfo(conversion.format).bits, bits);
    EXPECT_TRUE(linear || !conversion.linear) << "linear formats come first";
    bits = pixelFormatInfo(conversion.format).bits;
    linear = conversion.linear;
  }
}

// The kernel spells a mosaic's first row in its names, as GenICam does.
TEST(V4l2Conversions, KeepAMosaicsOrder) {
  for (const auto& [fourcc, format] :
       {std::pair<std::uint32_t, PixelFormat>{V4L2_PIX_FMT_SRGGB12, PixelFormat::kBayerRG12},
        {V4L2_PIX_FMT_SGRBG10, PixelFormat::kBayerGR10},
        {V4L2_PIX_FMT_SGBRG16, PixelFormat::kBayerGB16},
        {V4L2_PIX_FMT_SBGGR8, PixelFormat::kBayerBG8},
        {V4L2_PIX_FMT_SBGGR16, PixelFormat::kBayerBG16},
        {V4L2_PIX_FMT_SGRBG14, PixelFormat::kBayerGR14}}) {
    EXPECT_TRUE(conversionOf(fourcc, format).isExact);
  }
}

TEST(UnpackV4l2, TakesDeepSamplesAsTheyAreAndPaddingOff) {
  // Two lines of three 12-bit samples in words, four bytes of padding a line.
  std::vector<std::uint8_t> bytes(20, 0xEE);
  const std::array<int, 6> samples{0, 1, 4095, 2748, 256, 255};
  for (int i = 0; i < 6; ++i) {
    const auto at = static_cast<std::size_t>(i / 3 * 10 + i % 3 * 2);
    bytes[at] = static_cast<std::uint8_t>(samples[static_cast<std::size_t>(i)] & 0xff);
    bytes[at + 1] = static_cast<std::uint8_t>(samples[static_cast<std::size_t>(i)] >> 8);
  }
  const auto conversion = conversionOf(V4L2_PIX_FMT_SGBRG12, PixelFormat::kBayerGB12);
  Frame frame;
  const auto done = unpackV4l2(conversion, {3, 2, 10}, bytes, frame);
  ASSERT_TRUE(done) << done.error().message;
  EXPECT_EQ(frame.format, PixelFormat::kBayerGB12);
  ASSERT_EQ(frame.bytes.size(), 12u);
  for (int i = 0; i < 6; ++i) {
    EXPECT_EQ(frame.sample(i % 3, i / 3),
              static_cast<unsigned>(samples[static_cast<std::size_t>(i)]));
  }
  // The last line may end with its last sample, but not before.
  EXPECT_TRUE(unpackV4l2(conversion, {3, 2, 10}, std::span(bytes).first(16), frame));
  const auto torn = unpackV4l2(conversion, {3, 2, 10}, std::span(bytes).first(15), frame);
  ASSERT_FALSE(torn);
  EXPECT_EQ(torn.error().code, ErrorCode::kCorrupt);
  EXPECT_FALSE(unpackV4l2(conversion, {3, 2, 5}, bytes, frame)) << "lines shorter than the picture";
}

struct Colour {
  double r, g, b;
};

// ITU-R BT.601-7 and BT.709-6, section 3: Y = kr R + kg G + kb B, Cb = (B - Y) / (2 (1 - kb)), in
// 8 bits as 219 Y + 16 and 224 C + 128, or 255 Y and 255 C + 128 in JPEG's full range.
std::array<std::uint8_t, 3> ycbcrOf(const Colour& c, bool bt709, bool full) {
  const double kr = bt709 ? 0.2126 : 0.299, kb = bt709 ? 0.0722 : 0.114;
  const double y = kr * c.r + (1 - kr - kb) * c.g + kb * c.b;
  const double cb = (c.b - y) / (2 * (1 - kb)), cr = (c.r - y) / (2 * (1 - kr));
  const auto code = [](double v) {
    return static_cast<std::uint8_t>(std::lround(std::clamp(v, 0.0, 255.0)));
  };
  if (full) return {code(255 * y), code(255 * cb + 128), code(255 * cr + 128)};
  return {code(219 * y + 16), code(224 * cb + 128), code(224 * cr + 128)};
}

// What rounding Y by half a count and C by half a count can do to R, G or B, plus its own rounding.
double tolerance(bool full) {
  return full ? 0.5 + 0.5 * 1.8556 + 0.5 : (0.5 + 0.5 * 1.8556) * 255 / 219 + 0.5;
}

TEST(UnpackV4l2, TurnsYcbcrToRgbByBothMatricesAndRanges) {
  // 2 x 2 pixels of one colour each time, so that chroma is everybody's.
  for (const bool bt709 : {false, true}) {
    for (const bool full : {false, true}) {
      for (int i = 0; i < 125; ++i) {
        const Colour colour{(i % 5) / 4.0, (i / 5 % 5) / 4.0, (i / 25) / 4.0};
        const auto [y, cb, cr] = ycbcrOf(colour, bt709, full);
        const std::vector<std::uint8_t> yuyv{y, cb, y, cr, y, cb, y, cr};
        const std::vector<std::uint8_t> nv12{y, y, y, y, cb, cr};
        for (const auto& [fourcc, stride, bytes] :
             {std::tuple{V4L2_PIX_FMT_YUYV, 4, yuyv}, {V4L2_PIX_FMT_NV12, 2, nv12}}) {
          Frame frame;
          ASSERT_TRUE(unpackV4l2(conversionOf(fourcc, PixelFormat::kRgb8),
                                 {2, 2, stride, bt709, full}, bytes, frame));
          for (int pixel = 0; pixel < 4; ++pixel) {
            const double wanted[] = {colour.r, colour.g, colour.b};
            for (int c = 0; c < 3; ++c) {
              EXPECT_NEAR(frame.sample(pixel % 2, pixel / 2, c), 255 * wanted[c], tolerance(full))
                  << fourccName(fourcc) << " colour " << i << " channel " << c;
            }
          }
          ASSERT_TRUE(unpackV4l2(conversionOf(fourcc, PixelFormat::kMono8),
                                 {2, 2, stride, bt709, full}, bytes, frame));
          EXPECT_EQ(frame.bytes, std::vector<std::uint8_t>(4, y));
        }
      }
    }
  }
}

// The pixels of a macropixel share their chroma and nobody else's; odd sizes end with half of one.
TEST(UnpackV4l2, SharesChromaAmongNeighboursOnly) {
  const auto red = ycbcrOf({1, 0, 0}, false, true), blue = ycbcrOf({0, 0, 1}, false, true);
  const std::vector<std::uint8_t> yuyv{red[0],  red[1],  red[0], red[2],
                                       blue[0], blue[1], 77,     blue[2]};
  // 3 x 3: red on the left, blue on the right and below.
  const std::vector<std::uint8_t> nv12{red[0],  red[0],  blue[0], 99,       //
                                       red[0],  red[0],  blue[0], 99,       //
                                       blue[0], blue[0], blue[0], 99,       //
                                       red[1],  red[2],  blue[1], blue[2],  //
                                       blue[1], blue[2], blue[1], blue[2]};
  Frame frame;
  ASSERT_TRUE(unpackV4l2(conversionOf(V4L2_PIX_FMT_YUYV, PixelFormat::kRgb8),
                         {3, 1, 8, false, true}, yuyv, frame));
  const auto isRed = [&](int x, int y) {
    EXPECT_NEAR(frame.sample(x, y, 0) + frame.sample(x, y, 2), 255, 4);
    return frame.sample(x, y, 0) > 250;
  };
  EXPECT_TRUE(isRed(0, 0) && isRed(1, 0) && !isRed(2, 0));
  ASSERT_TRUE(unpackV4l2(conversionOf(V4L2_PIX_FMT_NV12, PixelFormat::kRgb8),
                         {3, 3, 4, false, true}, nv12, frame));
  EXPECT_TRUE(isRed(0, 0) && isRed(1, 1) && !isRed(2, 1) && !isRed(0, 2) && !isRed(2, 2));
  EXPECT_FALSE(unpackV4l2(conversionOf(V4L2_PIX_FMT_NV12, PixelFormat::kRgb8),
                          {3, 3, 4, false, true}, std::span(nv12).first(19), frame));
}

class UnpackMjpg : public ::testing::Test {
 protected:
  static constexpr int kWidth = 64, kHeight = 48;
  static std::array<int, 3> colourAt(int x, int y) { return {2 * x + 60, 3 * y + 50, 200 - x - y}; }

  UnpackMjpg() {
    cv::Mat picture(kHeight, kWidth, CV_8UC3);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const auto [r, g, b] = colourAt(x, y);
        picture.at<cv::Vec3b>(y, x) =
            cv::Vec3b(static_cast<std::uint8_t>(b), static_cast<std::uint8_t>(g),
                      static_cast<std::uint8_t>(r));
      }
    }
    cv::imencode(".jpg", picture, jpeg_, {cv::IMWRITE_JPEG_QUALITY, 95});
  }
  Result<void> unpack(PixelFormat format, std::span<const std::uint8_t> bytes, int width = kWidth) {
    return unpackV4l2(conversionOf(V4L2_PIX_FMT_MJPEG, format), {width, kHeight, 0}, bytes, frame_);
  }

  std::vector<std::uint8_t> jpeg_;
  Frame frame_;
};

TEST_F(UnpackMjpg, DecodesColourAndGrey) {
  ASSERT_TRUE(unpack(PixelFormat::kRgb8, jpeg_));
  const Frame colour = frame_;
  ASSERT_TRUE(unpack(PixelFormat::kMono8, jpeg_));
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const auto rgb = colourAt(x, y);
      // A smooth picture at quality 95: quantisation steps of a few counts.
      for (int c = 0; c < 3; ++c) {
        EXPECT_NEAR(colour.sample(x, y, c), rgb[static_cast<std::size_t>(c)], 5) << x << " " << y;
      }
      EXPECT_NEAR(frame_.sample(x, y), 0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2], 3);
    }
  }
}

TEST_F(UnpackMjpg, RefusesWhatIsDamagedOrOfAnotherSize) {
  for (const double part : {0.0, 0.01, 0.3, 0.6, 0.9}) {
    const auto size = static_cast<std::size_t>(part * static_cast<double>(jpeg_.size()));
    const auto cut = unpack(PixelFormat::kRgb8, std::span(jpeg_).first(size));
    ASSERT_FALSE(cut) << part;
    EXPECT_EQ(cut.error().code, ErrorCode::kCorrupt);
  }
  EXPECT_FALSE(unpack(PixelFormat::kRgb8, jpeg_, kWidth + 16));
  EXPECT_FALSE(unpack(PixelFormat::kRgb8, jpeg_, kWidth / 2));
  ASSERT_TRUE(unpack(PixelFormat::kRgb8, jpeg_));
}

// Webcams leave the standard Huffman tables out (segment 0xFFC4), which AVI allows.
TEST_F(UnpackMjpg, DecodesWithoutHuffmanTables) {
  std::vector<std::uint8_t> bare;
  for (std::size_t i = 0; i < jpeg_.size();) {
    const bool segment = i + 3 < jpeg_.size() && jpeg_[i] == 0xFF && jpeg_[i + 1] == 0xC4;
    if (!segment) {
      bare.push_back(jpeg_[i++]);
      continue;
    }
    i += 2 + static_cast<std::size_t>(jpeg_[i + 2] << 8 | jpeg_[i + 3]);
  }
  ASSERT_LT(bare.size() + 400, jpeg_.size());
  ASSERT_TRUE(unpack(PixelFormat::kRgb8, jpeg_));
  const auto whole = frame_.bytes;
  const auto done = unpack(PixelFormat::kRgb8, bare);
  ASSERT_TRUE(done) << done.error().message;
  EXPECT_EQ(frame_.bytes, whole);
}

}  // namespace
}  // namespace lightsketch
