// What can be said without a camera; the rest runs in a virtual machine (tests/vm).
#include "capture/device/v4l2_camera.h"

#include <gtest/gtest.h>

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

}  // namespace
}  // namespace lightsketch
