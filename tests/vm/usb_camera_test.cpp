// The real uvcvideo driver on a USB camera that this process plays.
#include "tests/vm/usb_camera.h"

#include <gtest/gtest.h>

#include <fstream>

#include "capture/device/v4l2_camera.h"
#include "tests/vm/taken_frames.h"

namespace lightsketch {
namespace {

// What bounds a call to a camera that is gone; without a bound these took five seconds and more.
constexpr double kBoundSeconds = 4;

class UsbCameras : public ::testing::Test {
 protected:
  void SetUp() override {
    const auto node = device_.plug();
    ASSERT_TRUE(node) << "no device node";
    node_ = *node;
  }

  std::unique_ptr<Camera> open(const std::string& format = "") const {
    auto camera = openV4l2Camera(node_ + (format.empty() ? "" : "?format=" + format));
    EXPECT_TRUE(camera) << camera.error().message;
    return camera ? std::move(*camera) : nullptr;
  }
  // Small and quick, exposed by hand.
  static CameraSettings wanted() {
    CameraSettings wanted;
    wanted.region = Region{0, 0, 320, 240};
    wanted.framesPerSecond = 15;
    wanted.exposureSeconds = 0.02;
    wanted.gainDb = 0;
    return wanted;
  }
  std::unique_ptr<Camera> streaming(const std::string& format = "") {
    auto camera = open(format);
    if (!camera) return nullptr;
    const auto settings = camera->configure(wanted());
    EXPECT_TRUE(settings) << settings.error().message;
    const auto started = taken_.start(*camera);
    EXPECT_TRUE(started) << started.error().message;
    EXPECT_TRUE(taken_.waitForMore(2));
    return camera;
  }
  // Every frame that was handed on is the one that its number says, and was exposed as it says.
  void TearDown() override {
    const auto frames = taken_.frames();
    for (std::size_t i = 0; i < frames.size(); ++i) {
      const UsbCamera::Stamp stamp = UsbCamera::read(frames[i]);
      const UsbCamera::Stamp first = UsbCamera::read(frames[0]);
      EXPECT_EQ((stamp.number - first.number) % UsbCamera::kNumbers,
                frames[i].metadata.id - frames[0].metadata.id);
      // JPEG and BT.601's short range cost a count or two.
      const int level = UsbCamera::levelOf(frames[i].metadata.exposureSeconds, 0);
      const int shown =
          frames[i].format == PixelFormat::kRgb8 && !fullRange_ ? (level - 16) * 255 / 219 : level;
      EXPECT_NEAR(stamp.level, shown, 3) << "frame " << i;
    }
  }

  UsbCamera device_;
  std::string node_;
  TakenFrames taken_;
  bool fullRange_ = false;  // of luma, as JPEG has it
};

class UsbCameraFault : public UsbCameras {
 protected:
  // Its row in the fault matrix.
  static void say(const std::string& injected, const std::string& outcome) {
    RecordProperty("injected", injected);
    RecordProperty("outcome", outcome);
  }
};

double secondsOf(const std::function<void()>& call) {
  const TimePoint start = Clock::now();
  call();
  return toSeconds(Clock::now() - start);
}

TEST_F(UsbCameras, IsListedByItsOwnName) {
  const auto cameras = listV4l2Cameras();
  ASSERT_EQ(cameras.size(), 1u);  // its second node carries metadata
  EXPECT_EQ(cameras[0].address, "v4l2:" + node_);
  EXPECT_EQ(cameras[0].vendor, "lightsketch");
  EXPECT_EQ(cameras[0].model, "Virtual webcam: Virtual webcam");
  EXPECT_EQ(cameras[0].serial, "0042");
}

TEST_F(UsbCameras, SendsYuyvAndMjpgInEverySize) {
  for (const std::string fourcc : {"YUYV", "MJPG"}) {
    const auto camera = open(fourcc);
    ASSERT_TRUE(camera);
    for (const auto& [width, height] : {std::pair{320, 240}, {640, 480}}) {
      for (const PixelFormat format : {PixelFormat::kRgb8, PixelFormat::kMono8}) {
        CameraSettings settings = wanted();
        settings.region = Region{0, 0, width, height};
        settings.format = format;
        const auto got = camera->configure(settings);
        ASSERT_TRUE(got) << got.error().message;
        EXPECT_EQ(got->format, format);
        EXPECT_EQ(got->region, settings.region);
        EXPECT_NEAR(got->framesPerSecond.value_or(0), 15, 0.01);
        ASSERT_TRUE(taken_.start(*camera));
        ASSERT_TRUE(taken_.waitForMore(2)) << fourcc;
        camera->stop();
        const Frame frame = taken_.frames().back();
        EXPECT_EQ(frame.width, width);
        EXPECT_EQ(frame.height, height);
        fullRange_ = fourcc == "MJPG";
        UsbCameras::TearDown();
      }
    }
  }
}

TEST_F(UsbCameras, ChoosesYuyvAndSaysWhatIsLostByIt) {
  const auto camera = open();
  ASSERT_TRUE(camera);
  EXPECT_EQ(camera->configure({})->format, PixelFormat::kRgb8);
  ASSERT_EQ(camera->notes().size(), 1u);
  EXPECT_NE(camera->notes()[0].find("RGB8 from YUYV: 8 bits made for the eye"), std::string::npos);
}

// As webcams have it: large pictures only in MJPG.
TEST_F(UsbCameras, TakesTheFormatThatHasTheSize) {
  const auto camera = open();
  ASSERT_TRUE(camera);
  for (const Region& region : {Region{0, 0, 800, 600}, Region{}}) {
    CameraSettings settings = wanted();
    settings.region = Region{0, 0, 320, 240};
    ASSERT_TRUE(camera->configure(settings));
    EXPECT_NE(camera->notes().at(0).find("from YUYV"), std::string::npos);
    settings.region = region;
    const auto got = camera->configure(settings);
    ASSERT_TRUE(got) << got.error().message;
    EXPECT_EQ(got->region, (Region{0, 0, 800, 600}));
    EXPECT_NE(camera->notes().at(0).find("from MJPG"), std::string::npos);
  }
  fullRange_ = true;
  ASSERT_TRUE(taken_.start(*camera));
  EXPECT_TRUE(taken_.waitForMore(2));
  camera->stop();
}

TEST_F(UsbCameras, SetsExposureGainAndWhiteBalanceWithTheirAutomaticsOff) {
  const auto camera = open();
  ASSERT_TRUE(camera);
  ASSERT_EQ(device_.control("exposure mode"), 8);
  ASSERT_EQ(device_.control("balance"), 1);
  CameraSettings settings = wanted();
  settings.exposureSeconds = 0.0123;
  const auto got = camera->configure(settings);
  ASSERT_TRUE(got) << got.error().message;
  EXPECT_DOUBLE_EQ(got->exposureSeconds.value_or(0), 0.0123);
  EXPECT_EQ(device_.control("exposure"), 123);
  EXPECT_EQ(device_.control("exposure mode"), 1);
  EXPECT_EQ(device_.control("exposure priority"), 0);
  EXPECT_EQ(device_.control("balance"), 0);
  EXPECT_EQ(device_.control("gain"), 0);
  const auto set = camera->setFeature("white_balance_temperature", 5200);
  EXPECT_TRUE(set) << set.error().message;
  EXPECT_EQ(device_.control("temperature"), 5200);
  EXPECT_TRUE(camera->setFeature("gain", 40));
  EXPECT_EQ(device_.control("gain"), 40);

  settings.exposureSeconds = 0.3;
  const auto beyond = camera->configure(settings);
  ASSERT_FALSE(beyond);
  EXPECT_NE(beyond.error().message.find("outside the camera's 0.0001 to 0.2 s"), std::string::npos)
      << beyond.error().message;
}

TEST_F(UsbCameras, FramesCarryTheExposureThatTheyWereTakenWith) {
  const auto camera = streaming();
  ASSERT_TRUE(camera);
  CameraSettings change;
  for (const double seconds : {0.05, 0.1, 0.02}) {
    change.exposureSeconds = seconds;
    const auto got = camera->configure(change);
    ASSERT_TRUE(got) << got.error().message;
    ASSERT_TRUE(taken_.waitUntil([&](const auto& frames) {
      return frames.back().metadata.exposureSeconds == got->exposureSeconds;
    }));
    EXPECT_TRUE(taken_.waitForMore(2));
  }
  camera->stop();
}

// By default the driver withholds broken frames, which leaves a gap in its numbers; with "nodrop"
// it hands them on and says so.
TEST_F(UsbCameraFault, ABrokenFrameIsCountedAndNotHandedOn) {
  say("USB camera: broken frame, cut frame", "counted, not handed on; stamps agree");
  for (const bool driverDrops : {true, false}) {
    std::ofstream("/sys/module/uvcvideo/parameters/nodrop")
        << (driverDrops ? "0" : "1") << std::flush;
    ASSERT_TRUE(device_.plug());
    for (const std::string fourcc : {"YUYV", "MJPG"}) {
      const auto camera = streaming(fourcc);
      ASSERT_TRUE(camera);
      fullRange_ = fourcc == "MJPG";
      const auto expect = [&](std::uint64_t lost, std::uint64_t incomplete) {
        EXPECT_TRUE(taken_.waitUntil([&](const auto&) {
          const StreamStatistics s = camera->statistics();
          return s.lost == lost && s.incomplete == incomplete;
        })) << fourcc
            << driverDrops;
      };
      device_.markNextFrameBroken();
      driverDrops ? expect(1, 0) : expect(0, 1);
      EXPECT_TRUE(taken_.waitForMore(1));
      // How long a JPEG should be the driver cannot know: its decoder finds it out.
      device_.cutNextFrame();
      if (driverDrops && fourcc == "YUYV") expect(2, 0);
      if (driverDrops && fourcc == "MJPG") expect(1, 1);
      if (!driverDrops) expect(0, 2);
      EXPECT_TRUE(taken_.waitForMore(3));
      EXPECT_EQ(camera->statistics().lost + camera->statistics().incomplete, 2u);
      EXPECT_EQ(taken_.ends(), 0);
      camera->stop();
      UsbCameras::TearDown();
    }
  }
  std::ofstream("/sys/module/uvcvideo/parameters/nodrop") << "0" << std::flush;
}

TEST_F(UsbCameraFault, UnpluggedEndsTheStreamAndComesBack) {
  say("USB camera unplugged and plugged in again", "stream ends once; opens again by its name");
  auto camera = streaming();
  ASSERT_TRUE(camera);
  device_.unplug();
  const auto end = taken_.waitForEnd();
  ASSERT_TRUE(end);
  EXPECT_EQ(end->code, ErrorCode::kDevice);
  EXPECT_EQ(end->message, "v4l2:" + node_ + ": the camera is gone (unplugged or switched off)");
  EXPECT_LT(secondsOf([&] {
              camera->stop();
              camera.reset();
            }),
            kBoundSeconds);
  EXPECT_EQ(taken_.ends(), 1);
  EXPECT_EQ(openV4l2Camera(node_).error().code, ErrorCode::kNotFound);

  const auto again = device_.plug();
  ASSERT_EQ(again, node_);  // under its old name, because nobody holds that any more
  camera = streaming();
}

// Still there and silent: nothing but time tells.
TEST_F(UsbCameraFault, SilenceEndsTheStreamAndItStartsAgain) {
  say("USB camera sends nothing any more", "stream ends after 3 s of silence; opens again");
  auto camera = streaming();
  ASSERT_TRUE(camera);
  device_.sendFrames(false);
  const auto end = taken_.waitForEnd();
  ASSERT_TRUE(end);
  EXPECT_NE(end->message.find("sends no frames any more"), std::string::npos) << end->message;
  camera.reset();
  device_.sendFrames(true);
  camera = streaming();
}

// It answers nothing at all: every call of the kernel's to it waits for five seconds.
TEST_F(UsbCameraFault, AFrozenCameraBlocksNobody) {
  say("USB camera frozen: answers nothing", "stop and close return; opens again once it is back");
  auto camera = streaming();
  ASSERT_TRUE(camera);
  device_.answer(false);
  EXPECT_LT(secondsOf([&] { camera->stop(); }), kBoundSeconds);
  EXPECT_LT(secondsOf([&] { camera.reset(); }), kBoundSeconds);
  device_.unplug();
  const auto again = device_.plug();
  ASSERT_TRUE(again);
  node_ = *again;
  camera = streaming();
}

}  // namespace
}  // namespace lightsketch
