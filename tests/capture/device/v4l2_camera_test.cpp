// What can be said without a camera; the rest runs in a virtual machine (tests/vm).
#include "capture/device/v4l2_camera.h"

#include <gtest/gtest.h>

#include <algorithm>

namespace lightsketch {
namespace {

TEST(OpenCamera, FindsV4l2CamerasByTheirScheme) {
  const auto absent = openCamera("v4l2:/dev/video-that-is-not");
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().code, ErrorCode::kNotFound);
  EXPECT_TRUE(absent.error().message.starts_with("v4l2:/dev/video-that-is-not: no such camera"))
      << absent.error().message;
  EXPECT_NE(openCamera("usb:1").error().message.find("v4l2:/dev/video0"), std::string::npos);
}

TEST(OpenCamera, RefusesNodesThatAreNoCameras) {
  const auto null = openCamera("v4l2:/dev/null?format=YUYV");
  ASSERT_FALSE(null);
  EXPECT_EQ(null.error().code, ErrorCode::kUnsupported);
  EXPECT_EQ(null.error().message,
            "v4l2:/dev/null: sends no pictures; 'lightsketch cameras' lists what does");
}

// Offers what it is made with, and nothing else.
class PickyCamera final : public Camera {
 public:
  explicit PickyCamera(std::vector<PixelFormat> offered) : offered_(std::move(offered)) {}
  const CameraInfo& info() const override { return info_; }
  Result<CameraSettings> configure(const CameraSettings& wanted) override {
    if (wanted.format && std::ranges::find(offered_, *wanted.format) == offered_.end()) {
      return failure(ErrorCode::kInvalidArgument, "not offered");
    }
    if (wanted.exposureSeconds.value_or(0) > 1) {
      return failure(ErrorCode::kInvalidArgument, "too long");
    }
    if (wanted.format) now_.format = wanted.format;
    if (!now_.format) now_.format = offered_.front();
    if (wanted.exposureSeconds) now_.exposureSeconds = wanted.exposureSeconds;
    return now_;
  }
  Result<void> start(FrameCallback, EndCallback) override { return {}; }
  void stop() override {}
  StreamStatistics statistics() const override { return {}; }
  bool hasFeature(const std::string&) const override { return false; }
  Result<void> setFeature(const std::string&, double) override { return {}; }

 private:
  const CameraInfo info_;
  const std::vector<PixelFormat> offered_;
  CameraSettings now_;
};

TEST(ConfigureNearest, TakesTheWantedFormatOrTheCamerasOwn) {
  using enum PixelFormat;
  const auto answer = [](std::vector<PixelFormat> offered, std::optional<PixelFormat> wanted,
                         bool grey = false) {
    PickyCamera camera(std::move(offered));
    CameraSettings settings;
    settings.format = wanted;
    settings.exposureSeconds = 0.5;
    const auto got = configureNearest(camera, settings, grey);
    EXPECT_EQ(got ? got->exposureSeconds : 0.5, 0.5);
    return got ? got->format : std::nullopt;
  };
  EXPECT_EQ(answer({kMono8, kBayerRG12}, kBayerRG12), kBayerRG12);
  EXPECT_EQ(answer({kBayerGR10, kMono8}, kBayerRG12), kBayerGR10);
  EXPECT_EQ(answer({kBayerGR10, kMono8}, std::nullopt), kBayerGR10);
  // Who looks for a lamp wants grey, of any depth.
  EXPECT_EQ(answer({kRgb8, kMono8}, std::nullopt, true), kMono8);
  EXPECT_EQ(answer({kMono12, kMono8}, std::nullopt, true), kMono12);
  EXPECT_EQ(answer({kRgb8}, std::nullopt, true), std::nullopt);
  // What else is wrong is not hidden.
  PickyCamera camera({kMono8});
  CameraSettings tooLong;
  tooLong.format = kBayerRG12;
  tooLong.exposureSeconds = 2;
  EXPECT_EQ(configureNearest(camera, tooLong).error().message, "too long");
}

}  // namespace
}  // namespace lightsketch
