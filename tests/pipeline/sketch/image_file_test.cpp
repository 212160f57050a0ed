#include "pipeline/sketch/image_file.h"

#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfDoubleAttribute.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfInputFile.h>
#include <OpenEXR/ImfOutputFile.h>
#include <OpenEXR/ImfStandardAttributes.h>
#include <OpenEXR/ImfStringAttribute.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <opencv2/imgcodecs.hpp>

#include "tests/capture/frame/temporary_folder.h"
#include "tests/pipeline/sketch/samples.h"

namespace lightsketch {
namespace {

// IEC 61966-2-1 in double precision, written down once more.
double decodeSrgb(double e) {
  return e <= 0.04045 ? e / 12.92 : std::pow((e + 0.055) / 1.055, 2.4);
}

TEST(Exr, RoundTripIsExactForHalfValuesInEveryCompression) {
  const RadianceImage image = sampleImage(37, 19, 1);
  for (const auto compression : {ExrOptions::Compression::kNone, ExrOptions::Compression::kPiz,
                                 ExrOptions::Compression::kZip}) {
    ExrOptions options;
    options.compression = compression;
    const auto bytes = encodeExr(image, options).value();
    EXPECT_TRUE(sameValues(decodeExr(bytes, "a.exr").value(), image));
  }
}

TEST(Exr, KeepsNegativeSmallAndLargeValuesAndClipsAtTheLargestHalf) {
  RadianceImage image(2, 1, 3);
  const float values[6] = {-0.5f, 0.1f, 60000.0f, 1e9f, -1e9f, 6.1035156e-05f};
  std::copy(values, values + 6, image.data());
  const auto back = decodeExr(encodeExr(image).value(), "a.exr").value();
  EXPECT_EQ(back(0, 0, 0), -0.5f);
  EXPECT_NEAR(back(0, 0, 1), 0.1f, 0.1f / 2048);  // half has 11 significant bits
  EXPECT_EQ(back(0, 0, 2), 60000.0f);
  EXPECT_EQ(back(1, 0, 0), 65504.0f);
  EXPECT_EQ(back(1, 0, 1), -65504.0f);
  EXPECT_EQ(back(1, 0, 2), 6.1035156e-05f);
}

TEST(Exr, HeaderCarriesAttributesAndRec709Chromaticities) {
  const TemporaryFolder folder;
  ExrOptions options;
  options.attributes["origin"] = "image07.jpg";
  options.numbers["lightX"] = 0.1;
  ASSERT_TRUE(writeExr(folder / "a.exr", sampleImage(4, 3, 0), options));
  const Imf::InputFile file((folder / "a.exr").c_str());
  EXPECT_EQ(file.header().typedAttribute<Imf::StringAttribute>("origin").value(), "image07.jpg");
  EXPECT_EQ(file.header().typedAttribute<Imf::DoubleAttribute>("lightX").value(), 0.1);
  EXPECT_EQ(file.header().channels()["G"].type, Imf::HALF);
  ASSERT_TRUE(Imf::hasChromaticities(file.header()));
  EXPECT_EQ(Imf::chromaticities(file.header()).red.x, 0.64f);
  EXPECT_EQ(Imf::chromaticities(file.header()).white.y, 0.329f);
}

TEST(Exr, AGreyFloatImageWithAnOffsetWindowIsReadWhole) {
  const TemporaryFolder folder;
  std::vector<float> pixels(12);
  for (std::size_t i = 0; i < pixels.size(); ++i) pixels[i] = 0.1f * static_cast<float>(i);
  const Imath::Box2i window({-3, 5}, {0, 7});  // 4 x 3 pixels
  {
    Imf::Header header(Imath::Box2i({0, 0}, {9, 9}), window);
    header.channels().insert("Y", Imf::Channel(Imf::FLOAT));
    Imf::FrameBuffer buffer;
    buffer.insert("Y", Imf::Slice::Make(Imf::FLOAT, pixels.data(), window));
    Imf::OutputFile file((folder / "y.exr").c_str(), header);
    file.setFrameBuffer(buffer);
    file.writePixels(3);
  }
  const auto image = readImage(folder / "y.exr").value();
  ASSERT_EQ(image.width(), 4);
  ASSERT_EQ(image.height(), 3);
  for (std::size_t i = 0; i < image.size(); ++i) EXPECT_EQ(image.values()[i], pixels[i / 3]);
}

TEST(Exr, EveryTruncationIsRefused) {
  const auto bytes = encodeExr(sampleImage(16, 40, 2)).value();
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    const auto image = decodeExr(std::string_view(bytes).substr(0, size), "cut.exr");
    ASSERT_FALSE(image) << size << " of " << bytes.size();
    EXPECT_EQ(image.error().message.rfind("cut.exr: ", 0), 0u);
  }
}

TEST(Exr, FlippedBitsNeverDoMoreThanFail) {
  const auto bytes = encodeExr(sampleImage(16, 40, 2)).value();
  int refused = 0;
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    std::string damaged = bytes;
    damaged[i] = static_cast<char>(damaged[i] ^ (1 << (i % 8)));
    if (!decodeExr(damaged, "a.exr")) ++refused;
  }
  EXPECT_GT(refused, 50);  // the header, at least
}

TEST(Exr, RefusesAWindowTooLargeToAllocate) {
  auto bytes = encodeExr(sampleImage(4, 4, 0)).value();
  const auto window = bytes.find(std::string("dataWindow\0box2i\0", 17));
  ASSERT_NE(window, std::string::npos);
  const std::int32_t huge = 60'000;
  std::memcpy(bytes.data() + window + 17 + 4 + 8, &huge, 4);
  std::memcpy(bytes.data() + window + 17 + 4 + 12, &huge, 4);
  EXPECT_FALSE(decodeExr(bytes, "a.exr"));
}

TEST(ReadImage, Png8IsDecodedFromSrgbExactly) {
  const TemporaryFolder folder;
  Image<std::uint8_t> image(256, 1, 3);
  for (int x = 0; x < 256; ++x) {
    for (int c = 0; c < 3; ++c) image(x, 0, c) = static_cast<std::uint8_t>((x + 50 * c) % 256);
  }
  ASSERT_TRUE(writePng(folder / "a.png", image));
  const auto srgb = readImage(folder / "a.png").value();
  const auto linear = readImage(folder / "a.png", TransferFunction::kLinear).value();
  for (int x = 0; x < 256; ++x) {
    for (int c = 0; c < 3; ++c) {
      const double encoded = image(x, 0, c) / 255.0;
      // Float arithmetic: a few ulps of 1.
      EXPECT_NEAR(srgb(x, 0, c), decodeSrgb(encoded), 5e-7);
      EXPECT_NEAR(linear(x, 0, c), encoded, 1e-7);
    }
  }
}

TEST(ReadImage, Png16RoundTripsEveryValueThroughLinearLight) {
  const TemporaryFolder folder;
  Image<std::uint16_t> image(256, 256, 3);
  for (int y = 0; y < 256; ++y) {
    for (int x = 0; x < 256; ++x) {
      for (int c = 0; c < 3; ++c) {
        image(x, y, c) = static_cast<std::uint16_t>(256 * y + x + 1000 * c);
      }
    }
  }
  ASSERT_TRUE(writePng(folder / "a.png", image));
  const auto linear = readImage(folder / "a.png", TransferFunction::kLinear).value();
  for (std::size_t i = 0; i < image.size(); ++i) {
    ASSERT_EQ(linear.values()[i], static_cast<float>(image.values()[i]) / 65535.0f);
  }
  const auto back = toSrgb16(readImage(folder / "a.png").value());
  for (std::size_t i = 0; i < image.size(); ++i) {
    ASSERT_EQ(back.values()[i], image.values()[i]);
  }
}

// Blue, green, red as OpenCV stores them.
const cv::Vec3b kPixel8(10, 120, 250);

TEST(ReadImage, GreyBecomesRgbAndAlphaIsDropped) {
  const TemporaryFolder folder;
  cv::imwrite((folder / "grey.png").string(), cv::Mat(2, 3, CV_8UC1, cv::Scalar(120)));
  const auto grey = readImage(folder / "grey.png", TransferFunction::kLinear).value();
  ASSERT_EQ(grey.channels(), 3);
  EXPECT_EQ(grey.width(), 3);
  for (const float value : grey.values()) EXPECT_FLOAT_EQ(value, 120 / 255.0f);

  cv::imwrite((folder / "rgba.png").string(),
              cv::Mat(2, 3, CV_8UC4, cv::Scalar(kPixel8[0], kPixel8[1], kPixel8[2], 40)));
  const auto rgba = readImage(folder / "rgba.png", TransferFunction::kLinear).value();
  EXPECT_FLOAT_EQ(rgba(1, 1, 0), 250 / 255.0f);
  EXPECT_FLOAT_EQ(rgba(1, 1, 1), 120 / 255.0f);
  EXPECT_FLOAT_EQ(rgba(1, 1, 2), 10 / 255.0f);

  cv::imwrite((folder / "grey16.png").string(), cv::Mat(2, 3, CV_16UC1, cv::Scalar(12345)));
  EXPECT_FLOAT_EQ(readImage(folder / "grey16.png", TransferFunction::kLinear).value()(0, 0, 2),
                  12345 / 65535.0f);
}

TEST(ReadImage, TiffOf8And16BitAndFloat) {
  const TemporaryFolder folder;
  const auto file = (folder / "a.tiff").string();
  cv::imwrite(file, cv::Mat(2, 2, CV_8UC3, cv::Scalar(kPixel8[0], kPixel8[1], kPixel8[2])));
  EXPECT_NEAR(readImage(file).value()(1, 0, 0), decodeSrgb(250 / 255.0), 5e-7);
  cv::imwrite(file, cv::Mat(2, 2, CV_16UC3, cv::Scalar(1, 40000, 65535)));
  EXPECT_FLOAT_EQ(readImage(file, TransferFunction::kLinear).value()(1, 1, 1), 40000 / 65535.0f);
  EXPECT_FLOAT_EQ(readImage(file, TransferFunction::kLinear).value()(1, 1, 0), 1);
  cv::imwrite(file, cv::Mat(2, 2, CV_32FC3, cv::Scalar(0.25, 3.5, 0.1)),
              {cv::IMWRITE_TIFF_COMPRESSION, 1});  // none; else OpenCV writes lossy LogLuv
  const auto image = readImage(file).value();      // float is linear whatever the option says
  EXPECT_EQ(image(0, 0, 0), 0.1f);
  EXPECT_EQ(image(0, 0, 1), 3.5f);
  EXPECT_EQ(image(0, 0, 2), 0.25f);
}

TEST(ReadImage, RadianceHdrIsLinear) {
  const TemporaryFolder folder;
  const auto file = (folder / "a.hdr").string();
  // Mantissa and shared exponent hold these exactly.
  cv::imwrite(file, cv::Mat(9, 9, CV_32FC3, cv::Scalar(0.25, 0.5, 1.5)));
  const auto image = readImage(file).value();
  EXPECT_EQ(image(3, 3, 0), 1.5f);
  EXPECT_EQ(image(3, 3, 1), 0.5f);
  EXPECT_EQ(image(3, 3, 2), 0.25f);
}

TEST(ReadImage, ExrIsRecognisedByContentAndLinear) {
  const TemporaryFolder folder;
  const RadianceImage image = sampleImage(5, 4, 3);
  ASSERT_TRUE(writeExr(folder / "no_suffix", image));
  EXPECT_TRUE(sameValues(readImage(folder / "no_suffix").value(), image));
}

TEST(ReadImage, JpegIsReadAndItsOrientationTagIgnored) {
  const TemporaryFolder folder;
  cv::Mat mat(16, 32, CV_8UC3, cv::Scalar(128, 128, 128));
  std::vector<unsigned char> bytes;
  cv::imencode(".jpg", mat, bytes);
  // An EXIF block that says: rotate by 90 degrees (orientation 6).
  const unsigned char exif[] = {0xFF, 0xE1, 0, 34, 'E', 'x', 'i', 'f', 0, 0,    'M', 'M',
                                0,    42,   0, 0,  0,   8,   0,   1,   1, 0x12, 0,   3,
                                0,    0,    0, 1,  0,   6,   0,   0,   0, 0,    0,   0};
  bytes.insert(bytes.begin() + 2, std::begin(exif), std::end(exif));
  writeContent(folder / "a.jpg", {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
  const auto image = readImage(folder / "a.jpg").value();
  EXPECT_EQ(image.width(), 32);
  EXPECT_EQ(image.height(), 16);
  EXPECT_NEAR(image(20, 10, 1), decodeSrgb(128 / 255.0), 1e-6);
}

TEST(ReadImage, TruncatedFilesAreRefusedByName) {
  const TemporaryFolder folder;
  const cv::Mat mat = [] {
    cv::Mat noise(64, 64, CV_8UC3);
    cv::RNG(7).fill(noise, cv::RNG::UNIFORM, 0, 256);
    return noise;
  }();
  for (const char* extension : {".jpg", ".png", ".tiff"}) {
    std::vector<unsigned char> bytes;
    cv::imencode(extension, mat, bytes);
    const auto file = folder / (std::string("cut") + extension);
    for (const std::size_t size :
         {std::size_t{0}, std::size_t{1}, std::size_t{20}, bytes.size() / 2, bytes.size() - 40}) {
      writeContent(file, {reinterpret_cast<const char*>(bytes.data()), size});
      const auto image = readImage(file);
      ASSERT_FALSE(image) << file << " " << size << " of " << bytes.size();
      EXPECT_NE(image.error().message.find(file.string()), std::string::npos);
    }
  }
}

TEST(ReadImage, RefusesWhatIsNoImage) {
  const TemporaryFolder folder;
  writeContent(folder / "a.png", "hello, this is not a picture\n");
  EXPECT_EQ(readImage(folder / "a.png").error().code, ErrorCode::kCorrupt);
  EXPECT_EQ(readImage(folder / "b.png").error().code, ErrorCode::kNotFound);
  EXPECT_EQ(readImage(folder.path()).error().code, ErrorCode::kInvalidArgument);
}

TEST(WritePng, EncodesLinearLightAsSrgb) {
  const TemporaryFolder folder;
  RadianceImage image(2, 1, 3);
  const float values[6] = {0.18f, 0, 1, 2, -1, 0.5f};
  std::copy(values, values + 6, image.data());
  ASSERT_TRUE(writePng(folder / "a.png", image));
  const cv::Mat mat = cv::imread((folder / "a.png").string(), cv::IMREAD_UNCHANGED);
  EXPECT_EQ(mat.at<cv::Vec3b>(0, 0), cv::Vec3b(255, 0, 118));
  EXPECT_EQ(mat.at<cv::Vec3b>(0, 1), cv::Vec3b(188, 0, 255));
  EXPECT_EQ(toSrgb8(image, 0.5f)(1, 0, 0), 255);
  EXPECT_EQ(toSrgb8(image, 0.5f)(0, 0, 2), 188);
  EXPECT_FALSE(encodePng(Image<std::uint8_t>(2, 2, 2)));
  EXPECT_FALSE(encodePng(Image<std::uint8_t>()));
  EXPECT_FALSE(encodeExr(RadianceImage()));
}

}  // namespace
}  // namespace lightsketch
