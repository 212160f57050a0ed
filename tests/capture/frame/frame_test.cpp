#include "capture/frame/frame.h"

#include <gtest/gtest.h>

#include "capture/frame/angle.h"
#include "capture/frame/image.h"

namespace lightsketch {
namespace {

TEST(Frame, ReadsSamplesOfEveryWidth) {
  Frame frame;
  frame.width = 2;
  frame.height = 2;
  frame.bytes = {1, 2, 3, 4};
  EXPECT_EQ(frame.sample(0, 1), 3u);
  frame.format = PixelFormat::kBayerRG12;
  frame.bytes = {0x01, 0x0A, 0x02, 0x0B, 0x03, 0x0C, 0xFF, 0x0F};
  EXPECT_EQ(frame.sample(0, 0), 0xA01u);
  EXPECT_EQ(frame.sample(1, 1), 4095u);
  frame.format = PixelFormat::kRgb8;
  frame.bytes = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11};
  EXPECT_EQ(frame.sample(1, 1, 2), 11u);
}

TEST(PixelFormat, NamesAndCodesAreGenICams) {
  EXPECT_EQ(pixelFormatFromName("BayerRG12"), PixelFormat::kBayerRG12);
  EXPECT_EQ(pixelFormatFromName("YUV422"), std::nullopt);
  EXPECT_EQ(pixelFormatFromCode(0x01080001), PixelFormat::kMono8);
  EXPECT_EQ(pixelFormatFromCode(0x02180014), PixelFormat::kRgb8);
  // PFNC: bits 16 to 23 of a code are the bits a pixel takes on the wire.
  for (int i = 0; i <= static_cast<int>(PixelFormat::kRgb8); ++i) {
    const auto& info = pixelFormatInfo(static_cast<PixelFormat>(i));
    EXPECT_EQ(static_cast<int>(info.format), i);
    EXPECT_EQ(static_cast<int>((info.pfncCode >> 16) & 0xFF), 8 * info.bytesPerPixel) << info.name;
    EXPECT_EQ(pixelFormatFromName(info.name), info.format);
    EXPECT_EQ(pixelFormatFromCode(info.pfncCode), info.format);
    // A mosaic's name spells its first row.
    if (info.isBayer) {
      const std::string expected =
          info.redY == 0 ? (info.redX == 0 ? "RG" : "GR") : (info.redX == 0 ? "GB" : "BG");
      EXPECT_EQ(info.name, "Bayer" + expected + std::to_string(info.bits));
    }
  }
}

TEST(Image, IsRowMajorWithInterleavedChannels) {
  Image<float> image(3, 2, 2);
  image(2, 1, 1) = 7;
  EXPECT_EQ(image.values()[11], 7);
  EXPECT_EQ(image.row(1)[5], 7);
  EXPECT_THROW(Image<float>(-1, 2, 3), std::logic_error);
}

TEST(Angle, ConvertsBetweenUnits) {
  EXPECT_DOUBLE_EQ(Angle::degrees(180).radians(), std::numbers::pi);
  EXPECT_LT(Angle::radians(1.5), Angle::degrees(90));
}

}  // namespace
}  // namespace lightsketch
