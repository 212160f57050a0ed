// The kernel's virtual video driver: two cameras with every raw format, and with faults to order.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <thread>

#include "capture/device/v4l2_camera.h"
#include "tests/vm/taken_frames.h"

namespace lightsketch {
namespace {

const std::string kNode = "/dev/video0";
const Region kSmall{0, 0, 320, 180};

class Vivid : public ::testing::Test {
 protected:
  static std::unique_ptr<Camera> open(const std::string& target = kNode) {
    auto camera = openV4l2Camera(target);
    EXPECT_TRUE(camera) << camera.error().message;
    if (!camera) return nullptr;
    // Eight bars: white, yellow, cyan, green, magenta, red, blue, black; nothing written on them.
    for (const auto& [name, value] :
         {std::pair{"test_pattern", 1}, std::pair{"osd_text_mode", 2}}) {
      const auto set = (*camera)->setFeature(name, value);
      EXPECT_TRUE(set) << set.error().message;
    }
    return std::move(*camera);
  }
  static CameraSettings configure(Camera& camera, std::optional<PixelFormat> format) {
    CameraSettings wanted;
    wanted.format = format;
    wanted.region = kSmall;
    wanted.framesPerSecond = 30;
    const auto settings = camera.configure(wanted);
    EXPECT_TRUE(settings) << settings.error().message;
    return settings.value_or(CameraSettings{});
  }
  // One that streams, in a format that is quick to make.
  std::unique_ptr<Camera> streaming() {
    auto camera = open();
    if (!camera) return nullptr;
    configure(*camera, PixelFormat::kMono8);
    const auto started = taken_.start(*camera);
    EXPECT_TRUE(started) << started.error().message;
    EXPECT_TRUE(taken_.waitForMore(2));
    return camera;
  }
  // That frames come, each the pattern's and in order.
  void expectFrames(Camera& camera) {
    ASSERT_TRUE(taken_.start(camera));
    EXPECT_TRUE(taken_.waitForMore(3));
    camera.stop();
  }
  void TearDown() override {
    const auto frames = taken_.frames();
    for (std::size_t i = 1; i < frames.size(); ++i) {
      EXPECT_GT(frames[i].metadata.id, frames[i - 1].metadata.id);
      EXPECT_GE(frames[i].metadata.arrival, frames[i].metadata.midExposure);
    }
  }

  TakenFrames taken_;
};

class VividFault : public Vivid {
 protected:
  // Its row in the fault matrix.
  static void say(const std::string& injected, const std::string& outcome) {
    RecordProperty("injected", injected);
    RecordProperty("outcome", outcome);
  }
};

// Of full scale, in a bar of the pattern.
double barValue(int bar, int channel) {
  const int colours[] = {0b111, 0b110, 0b011, 0b010, 0b101, 0b100, 0b001, 0b000};
  return colours[bar] >> (2 - channel) & 1;
}

// `fromYcbcr`: grey is the luma of a YCbCr format.
void expectBars(const Frame& frame, bool fromYcbcr = false) {
  const PixelFormatInfo& info = pixelFormatInfo(frame.format);
  const double full = (1 << info.bits) - 1;
  for (int bar = 0; bar < 8; ++bar) {
    const int x0 = (2 * bar + 1) * frame.width / 16 & ~1;  // its middle, where chroma is its own
    for (int k = 0; k < 4; ++k) {
      const int x = x0 + k % 2, y = frame.height / 2 + k / 2;
      for (int c = 0; c < info.channels; ++c) {
        double expected = 0, tolerance = 0;
        if (info.isBayer || info.channels == 3) {
          const int dx = (x ^ info.redX) & 1, dy = (y ^ info.redY) & 1;
          expected = barValue(bar, info.isBayer ? dx + dy : c);
          // The driver makes 8 bits and shifts them up: 255 << 2 of 1023. YCbCr in the short range
          // of 8 bits holds a colour to within a chroma step: 2 * 1.77 * 255 / 224 counts.
          tolerance = info.isBayer ? 0.004 : 4.1 / 255;
        } else {
          // Rec. 601 in its short range, 16 to 235; or what the driver takes for grey, Rec. 709,
          // in 8 bits shifted up. Two counts of 8 bits.
          const double r = barValue(bar, 0), g = barValue(bar, 1), b = barValue(bar, 2);
          expected = fromYcbcr ? (16 + 219 * (0.299 * r + 0.587 * g + 0.114 * b)) / 255
                               : 0.2126 * r + 0.7152 * g + 0.0722 * b;
          tolerance = 2.0 / 255 + 0.004;
        }
        EXPECT_NEAR(frame.sample(x, y, c) / full, expected, tolerance)
            << info.name << " bar " << bar << " pixel " << k << " channel " << c;
      }
    }
  }
}

TEST_F(Vivid, ListsBothCameras) {
  const auto cameras = listV4l2Cameras();
  ASSERT_EQ(cameras.size(), 2u);
  EXPECT_EQ(cameras[0].address, "v4l2:/dev/video0");
  EXPECT_EQ(cameras[1].address, "v4l2:/dev/video1");
  EXPECT_EQ(cameras[0].vendor, "vivid");
}

TEST_F(Vivid, OpensInItsDeepestLinearFormat) {
  const auto camera = open();
  ASSERT_TRUE(camera);
  const auto settings = camera->configure({});
  ASSERT_TRUE(settings) << settings.error().message;
  EXPECT_EQ(settings->format, PixelFormat::kBayerRG16);
  EXPECT_TRUE(camera->notes().empty()) << camera->notes().front();
}

TEST_F(Vivid, SendsEveryFormatAsItIsNamed) {
  const auto camera = open();
  ASSERT_TRUE(camera);
  using enum PixelFormat;
  for (const PixelFormat format :
       {kMono8,     kMono10,    kMono12,    kMono16,    kBayerRG8,  kBayerGR8,  kBayerGB8,
        kBayerBG8,  kBayerRG10, kBayerGR10, kBayerGB10, kBayerBG10, kBayerRG12, kBayerGR12,
        kBayerGB12, kBayerBG12, kBayerRG16, kBayerGR16, kBayerGB16, kBayerBG16, kRgb8}) {
    const CameraSettings settings = configure(*camera, format);
    EXPECT_EQ(settings.format, format);
    EXPECT_EQ(settings.region, kSmall);
    EXPECT_NEAR(settings.framesPerSecond.value_or(0), 30, 0.1);
    ASSERT_TRUE(taken_.start(*camera));
    ASSERT_TRUE(taken_.waitForMore(1)) << pixelFormatInfo(format).name;
    camera->stop();
    const Frame frame = taken_.frames().front();
    EXPECT_EQ(frame.format, format);
    EXPECT_EQ(frame.width, 320);
    EXPECT_EQ(frame.height, 180);
    expectBars(frame);
  }
}

TEST_F(Vivid, ConvertsFormatsOfTheDriverThatAreAskedFor) {
  for (const std::string fourcc : {"RGB3", "YUYV", "NV12", "GREY"}) {
    const auto camera = open(kNode + "?format=" + fourcc);
    ASSERT_TRUE(camera);
    for (const PixelFormat format : {PixelFormat::kRgb8, PixelFormat::kMono8}) {
      if (fourcc == (format == PixelFormat::kMono8 ? "RGB3" : "GREY")) {
        CameraSettings wanted;
        wanted.format = format;
        const auto refused = camera->configure(wanted);
        ASSERT_FALSE(refused);
        EXPECT_NE(refused.error().message.find("it offers"), std::string::npos);
        continue;
      }
      EXPECT_EQ(configure(*camera, format).format, format);
      ASSERT_FALSE(camera->notes().empty());
      EXPECT_NE(camera->notes().front().find("from " + fourcc), std::string::npos);
      ASSERT_TRUE(taken_.start(*camera));
      ASSERT_TRUE(taken_.waitForMore(1)) << fourcc;
      camera->stop();
      expectBars(taken_.frames().front(), fourcc == "YUYV" || fourcc == "NV12");
    }
  }
}

TEST_F(Vivid, SaysWhatItCannotDo) {
  const auto mjpg = openV4l2Camera(kNode + "?format=MJPG");
  ASSERT_FALSE(mjpg);
  EXPECT_EQ(mjpg.error().code, ErrorCode::kUnsupported);
  EXPECT_NE(mjpg.error().message.find("YUYV"), std::string::npos) << mjpg.error().message;
  EXPECT_EQ(openV4l2Camera("/dev/video7").error().code, ErrorCode::kNotFound);
  EXPECT_EQ(openV4l2Camera("/dev/null").error().code, ErrorCode::kUnsupported);

  const auto camera = open();
  ASSERT_TRUE(camera);
  const auto refusal = [&](const CameraSettings& wanted) {
    const auto answer = camera->configure(wanted);
    return answer ? std::string("done") : answer.error().message;
  };
  CameraSettings wanted;
  wanted.format = PixelFormat::kMono14;
  EXPECT_NE(refusal(wanted).find("BayerRG16, BayerGR16"), std::string::npos) << refusal(wanted);
  wanted = {};
  wanted.region = Region{0, 0, 321, 181};
  EXPECT_NE(refusal(wanted).find("320x180"), std::string::npos) << refusal(wanted);
  wanted.region = Region{8, 0, 320, 180};
  EXPECT_NE(refusal(wanted).find("x and y"), std::string::npos) << refusal(wanted);
  wanted = {};
  wanted.exposureSeconds = 0.01;
  EXPECT_NE(refusal(wanted).find("exposure"), std::string::npos) << refusal(wanted);
  wanted = {};
  wanted.trigger = "Software";
  EXPECT_NE(refusal(wanted).find("trigger"), std::string::npos) << refusal(wanted);
}

TEST_F(Vivid, TakesTheNearestFrameRateAndSaysSo) {
  const auto camera = open();
  ASSERT_TRUE(camera);
  for (const auto& [asked, made] : {std::pair{15.0, 15.0}, {25.0, 25.0}, {23.0, 0.0}}) {
    CameraSettings wanted;
    wanted.format = PixelFormat::kMono8;
    wanted.region = kSmall;
    wanted.framesPerSecond = asked;
    const auto settings = camera->configure(wanted);
    ASSERT_TRUE(settings) << settings.error().message;
    const double rate = settings->framesPerSecond.value_or(0);
    const auto notes = camera->notes();
    const bool said = std::ranges::any_of(notes, [](const std::string& note) {
      return note.find("23 frames/s were asked for") != std::string::npos;
    });
    if (made > 0) {
      EXPECT_NEAR(rate, made, 1e-3);
    } else {
      EXPECT_GT(std::abs(rate - asked), 0.23);
    }
    EXPECT_EQ(said, made == 0);
    ASSERT_TRUE(taken_.start(*camera));
    ASSERT_TRUE(taken_.waitForMore(8));
    camera->stop();
    // The driver stamps when it gets round to it, so a busy machine stretches some intervals; of
    // eight one is true to a timer tick (4 ms).
    const auto frames = taken_.frames();
    double least = 1;
    for (std::size_t k = 1; k < frames.size(); ++k) {
      const FrameMetadata &a = frames[k - 1].metadata, &b = frames[k].metadata;
      const double seconds = 1e-9 * static_cast<double>(b.deviceTimeNs - a.deviceTimeNs);
      least = std::min(least, std::abs(seconds - static_cast<double>(b.id - a.id) / rate));
    }
    EXPECT_LT(least, 0.004) << rate;
  }
}

TEST_F(Vivid, SetsControlsByNameWithinTheirRangeAndWithoutTheirAutomatic) {
  const auto camera = open();
  ASSERT_TRUE(camera);
  EXPECT_TRUE(camera->hasFeature("gain"));
  EXPECT_FALSE(camera->hasFeature("exposure_time_absolute"));
  // Read back inside; the automatic gain that is on at first would change it.
  const auto set = camera->setFeature("gain", 77);
  EXPECT_TRUE(set) << set.error().message;
  const auto beyond = camera->setFeature("gain", 300);
  ASSERT_FALSE(beyond);
  EXPECT_EQ(beyond.error().code, ErrorCode::kInvalidArgument);
  EXPECT_NE(beyond.error().message.find("0 to 255"), std::string::npos) << beyond.error().message;
  EXPECT_EQ(camera->setFeature("no_such_control", 1).error().code, ErrorCode::kNotFound);
  // A control takes effect: at saturation 0 the bars have no colour.
  ASSERT_TRUE(camera->setFeature("saturation", 0));
  configure(*camera, PixelFormat::kRgb8);
  ASSERT_TRUE(taken_.start(*camera));
  ASSERT_TRUE(taken_.waitForMore(1));
  camera->stop();
  const Frame frame = taken_.frames().front();
  for (int bar = 0; bar < 8; ++bar) {
    const int x = (2 * bar + 1) * frame.width / 16;
    EXPECT_NEAR(frame.sample(x, 90, 0), frame.sample(x, 90, 2), 4);
  }
  EXPECT_TRUE(camera->setFeature("saturation", 128));
}

TEST_F(Vivid, TwoCamerasStreamAtOnce) {
  const auto first = open();
  const auto second = open("/dev/video1");
  ASSERT_TRUE(first && second);
  configure(*first, PixelFormat::kMono8);
  configure(*second, PixelFormat::kMono12);
  TakenFrames other;
  ASSERT_TRUE(taken_.start(*first));
  ASSERT_TRUE(other.start(*second));
  EXPECT_TRUE(taken_.waitForMore(5));
  EXPECT_TRUE(other.waitForMore(5));
  first->stop();
  second->stop();
  EXPECT_EQ(taken_.frames().front().format, PixelFormat::kMono8);
  EXPECT_EQ(other.frames().front().format, PixelFormat::kMono12);
}

TEST_F(VividFault, RefusesASecondOpenerInOneLine) {
  say("V4L2: a second program opens the camera", "refused in one line; the first does not notice");
  const auto camera = streaming();
  ASSERT_TRUE(camera);
  const auto second = openV4l2Camera(kNode);
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().code, ErrorCode::kDevice);
  EXPECT_EQ(second.error().message,
            "v4l2:/dev/video0: another program uses this camera; close that");
  EXPECT_TRUE(taken_.waitForMore(2));  // the first does not notice
}

TEST_F(VividFault, CountsGapsOfTheSequenceAsLost) {
  say("V4L2: half of the buffers dropped", "gaps counted as lost, frames in order");
  const auto camera = streaming();
  ASSERT_TRUE(camera);
  ASSERT_TRUE(camera->setFeature("percentage_of_dropped_buffers", 50));
  ASSERT_TRUE(taken_.waitUntil([&](const auto&) { return camera->statistics().lost >= 5; }));
  ASSERT_TRUE(camera->setFeature("percentage_of_dropped_buffers", 0));
  ASSERT_TRUE(taken_.waitForMore(2));
  camera->stop();
  const auto frames = taken_.frames();
  const StreamStatistics s = camera->statistics();
  // Every number between the first that was handed on and the last is accounted for, but for what
  // came between the first frame, which is skipped, and that.
  const std::uint64_t span = frames.back().metadata.id - frames.front().metadata.id + 1;
  EXPECT_EQ(s.delivered, frames.size());
  EXPECT_GE(s.delivered + s.lost + s.incomplete, span);
  EXPECT_LE(s.delivered + s.lost + s.incomplete, span + 3);
  EXPECT_EQ(taken_.ends(), 0);
}

TEST_F(VividFault, CountsABufferWithTheErrorFlagAsIncomplete) {
  say("V4L2: buffer with the error flag", "counted as incomplete, not handed on");
  const auto camera = streaming();
  ASSERT_TRUE(camera);
  ASSERT_TRUE(camera->setFeature("inject_v4l2_buf_flag_error", 1));
  ASSERT_TRUE(taken_.waitUntil([&](const auto&) { return camera->statistics().incomplete == 1; }));
  EXPECT_TRUE(taken_.waitForMore(3));
  EXPECT_EQ(camera->statistics().incomplete, 1u);
  EXPECT_EQ(taken_.ends(), 0);
}

TEST_F(VividFault, GoesOnAfterARefusedBuffer) {
  say("V4L2: the driver refuses a buffer, 12 times", "offered again; the stream goes on");
  const auto camera = streaming();
  ASSERT_TRUE(camera);
  for (int i = 0; i < 12; ++i) {  // more than there are buffers: none may get lost
    ASSERT_TRUE(camera->setFeature("inject_vidioc_qbuf_error", 1));
    ASSERT_TRUE(taken_.waitForMore(2)) << i;
  }
  EXPECT_EQ(taken_.ends(), 0);
}

TEST_F(VividFault, FailsToStartInOneLineAndStartsTheNextTime) {
  say("V4L2: REQBUFS, QBUF, STREAMON fail at the start", "one line; the next start works");
  const auto camera = open();
  ASSERT_TRUE(camera);
  configure(*camera, PixelFormat::kMono8);
  for (const std::string fault : {"inject_vidioc_reqbufs_error", "inject_vidioc_qbuf_error",
                                  "inject_vidioc_streamon_error"}) {
    ASSERT_TRUE(camera->setFeature(fault, 1));
    const auto started = taken_.start(*camera);
    ASSERT_FALSE(started) << fault;
    EXPECT_EQ(started.error().code, ErrorCode::kDevice);
    EXPECT_TRUE(started.error().message.starts_with("v4l2:/dev/video0: cannot "))
        << started.error().message;
    expectFrames(*camera);
  }
}

TEST_F(VividFault, AFatalErrorEndsTheStreamOnceAndTheCameraOpensAgain) {
  say("V4L2: fatal streaming error (POLLERR, EIO)", "stream ends once; opens again");
  auto camera = streaming();
  ASSERT_TRUE(camera);
  ASSERT_TRUE(camera->setFeature("inject_fatal_streaming_error", 1));
  const auto end = taken_.waitForEnd();
  ASSERT_TRUE(end);
  EXPECT_EQ(end->code, ErrorCode::kDevice);
  EXPECT_EQ(end->message,
            "v4l2:/dev/video0: the driver reports that the camera or its link failed; plug it in "
            "again");
  camera->stop();
  EXPECT_EQ(taken_.ends(), 1);
  EXPECT_EQ(camera->configure({}).error().message,
            "v4l2:/dev/video0: the camera was lost; open it again");
  camera.reset();
  camera = streaming();
}

TEST_F(VividFault, ADisconnectedCameraEndsTheStreamOnceAndComesBack) {
  say("V4L2: camera disconnected (ENODEV)", "stream ends once; opens again");
  auto camera = streaming();
  ASSERT_TRUE(camera);
  ASSERT_TRUE(camera->setFeature("disconnect", 1));
  const auto end = taken_.waitForEnd();
  ASSERT_TRUE(end);
  EXPECT_EQ(end->code, ErrorCode::kDevice);
  EXPECT_EQ(end->message, "v4l2:/dev/video0: the camera is gone (unplugged or switched off)");
  camera->stop();
  EXPECT_EQ(taken_.ends(), 1);
  camera.reset();
  camera = streaming();
}

TEST_F(VividFault, NumbersGoOnWhereTheDriversWrap) {
  say("V4L2: sequence wraps at 2^32", "ids go on");
  const auto camera = open();
  ASSERT_TRUE(camera);
  configure(*camera, PixelFormat::kMono8);
  ASSERT_TRUE(camera->setFeature("wrap_sequence_number", 1));  // begins shortly before 2^32
  ASSERT_TRUE(taken_.start(*camera));
  constexpr std::uint64_t kWrap = std::uint64_t{1} << 32;
  ASSERT_TRUE(taken_.waitUntil(
      [](const auto& frames) { return !frames.empty() && frames.back().metadata.id > kWrap + 2; }));
  camera->stop();
  EXPECT_LT(taken_.frames().front().metadata.id, kWrap);
  EXPECT_LT(camera->statistics().lost, 100u);
  ASSERT_TRUE(camera->setFeature("wrap_sequence_number", 0));
}

TEST_F(VividFault, StampsOfAnotherEpochAreNotBelieved) {
  say("V4L2: stamps of another epoch", "time by arrival, with its sigma");
  const auto camera = open();
  ASSERT_TRUE(camera);
  configure(*camera, PixelFormat::kMono8);
  ASSERT_TRUE(camera->setFeature("wrap_timestamp", 1));  // stamps begin shortly before they wrap
  ASSERT_TRUE(taken_.start(*camera));
  ASSERT_TRUE(taken_.waitForMore(3));
  camera->stop();
  for (const Frame& frame : taken_.frames()) {
    const Duration age = frame.metadata.arrival - frame.metadata.midExposure;
    const double stampAge = toSeconds(frame.metadata.arrival.time_since_epoch()) -
                            1e-9 * static_cast<double>(frame.metadata.deviceTimeNs);
    EXPECT_GT(std::abs(stampAge), 10) << "the driver's stamp is sound: the test shows nothing";
    EXPECT_GE(age, Duration::zero());
    EXPECT_LT(toSeconds(age), 0.1);  // an exposure and half an interval of 1/30 s each
  }
  ASSERT_TRUE(camera->setFeature("wrap_timestamp", 0));
}

}  // namespace
}  // namespace lightsketch
