// The Aravis camera against GigE Vision devices of our own, over real loopback sockets.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <future>
#include <mutex>

#include "capture/device/camera.h"
#include "capture/device/gvcp_probe.h"
#include "capture/device/wire_format.h"
#include "capture/rig/gige_device.h"
#include "tests/capture/device/pattern_source.h"

namespace lightsketch {
namespace {

const std::string kScene = ownAddress(0);
const std::string kSource = ownAddress(1);

const std::vector<PixelFormat> kSceneFormats = {PixelFormat::kBayerRG12, PixelFormat::kBayerRG16,
                                                PixelFormat::kRgb8, PixelFormat::kMono8};

// A camera that is really there.
struct Rig {
  explicit Rig(GigeDeviceOptions options, int width = 640, int height = 480,
               std::vector<PixelFormat> formats = kSceneFormats)
      : source(width, height, std::move(formats)) {
    auto started = GigeDevice::start(source, options, startTime);
    if (!started) ADD_FAILURE() << started.error().message;
    device = std::move(started).value();
  }

  PatternSource source;
  TimePoint startTime = Clock::now();
  std::unique_ptr<GigeDevice> device;
};

GigeDeviceOptions at(const std::string& address, double framesPerSecond = 30) {
  GigeDeviceOptions options;
  options.address = address;
  options.defaultFramesPerSecond = framesPerSecond;
  options.defaultExposureSeconds = 0.004;
  return options;
}

std::unique_ptr<Camera> open(const std::string& address) {
  auto camera = openCamera("aravis:" + address);
  if (!camera) {
    ADD_FAILURE() << camera.error().message;
    return nullptr;
  }
  return std::move(*camera);
}

// Keeps what a camera sends.
class Inbox {
 public:
  FrameCallback onFrame() {
    return [this](Frame&& frame) {
      const std::lock_guard lock(mutex_);
      frames_.push_back(std::move(frame));
    };
  }
  EndCallback onEnd() {
    return [this](const Error& error) {
      const std::lock_guard lock(mutex_);
      ends_.push_back(error);
    };
  }
  std::size_t count() const {
    const std::lock_guard lock(mutex_);
    return frames_.size();
  }
  std::vector<Error> ends() const {
    const std::lock_guard lock(mutex_);
    return ends_;
  }
  bool waitFor(std::size_t frames) const {
    return eventually([&] { return count() >= frames; });
  }
  std::vector<Frame> take() {
    const std::lock_guard lock(mutex_);
    return std::exchange(frames_, {});
  }

 private:
  mutable std::mutex mutex_;  // Guards the following.
  std::vector<Frame> frames_;
  std::vector<Error> ends_;
};

void expectBitExact(const std::vector<Frame>& frames, const Rig& rig) {
  for (const Frame& frame : frames) {
    const std::uint64_t index = indexOf(frame);
    const ExposureRequest request = rig.source.request(index);
    EXPECT_EQ(frame.format, request.format);
    EXPECT_EQ(frame.width, request.region.width);
    EXPECT_EQ(frame.height, request.region.height);
    EXPECT_EQ(frame.bytes, patternBytes(index, request.format, request.region)) << index;
  }
}

double timeError(const Frame& frame, const Rig& rig) {
  const double truth = rig.source.request(indexOf(frame)).timeSeconds;
  return toSeconds(frame.metadata.midExposure - rig.startTime) - truth;
}

void expectTrueTimes(const std::vector<Frame>& frames, const Rig& rig) {
  double worst = 0, worstSigma = 0;
  for (const Frame& frame : frames) {
    const double error = std::abs(timeError(frame, rig));
    const double sigma = toSeconds(frame.metadata.timeUncertainty);
    EXPECT_LT(error, 1e-3);
    // The latch fell within the round trip, which is +- 1.7 sigma.
    EXPECT_LT(error, 4 * sigma);
    worst = std::max(worst, error);
    worstSigma = std::max(worstSigma, sigma);
  }
  fmt::print(
      "measured: {} frames, largest error of mid-exposure {:.0f} us, largest sigma {:.0f} us\n",
      frames.size(), 1e6 * worst, 1e6 * worstSigma);
}

TEST(AravisCamera, FramesArriveBitExactInEveryFormat) {
  Rig rig(at(kScene));
  const auto camera = open(kScene);
  ASSERT_TRUE(camera);
  EXPECT_EQ(camera->info().vendor, "lightsketch");
  EXPECT_EQ(camera->info().model, "SimulatedScene");
  EXPECT_EQ(camera->info().serial, "SIM-1");
  for (const PixelFormat format : kSceneFormats) {
    SCOPED_TRACE(pixelFormatInfo(format).name);
    CameraSettings wish;
    wish.format = format;
    const auto settings = camera->configure(wish);
    ASSERT_TRUE(settings) << settings.error().message;
    EXPECT_EQ(settings->format, format);
    EXPECT_EQ(settings->region, (Region{0, 0, 640, 480}));
    EXPECT_NEAR(*settings->framesPerSecond, 30, 1e-9);
    Inbox inbox;
    ASSERT_TRUE(camera->start(inbox.onFrame(), inbox.onEnd()));
    EXPECT_TRUE(inbox.waitFor(5));
    camera->stop();
    const auto frames = inbox.take();
    ASSERT_GE(frames.size(), 5u);
    EXPECT_EQ(frames.front().format, format);
    expectBitExact(frames, rig);
    EXPECT_TRUE(inbox.ends().empty());
  }
}

TEST(AravisCamera, TwoCamerasAtOnceLoseNothing) {
  Rig scene(at(kScene));
  Rig source(at(kSource), 960, 960, {PixelFormat::kMono8});
  const std::array rigs = {&scene, &source};
  const std::array cameras = {open(kScene), open(kSource)};
  std::array<Inbox, 2> inboxes;
  for (std::size_t i = 0; i < 2; ++i) {
    ASSERT_TRUE(cameras[i]);
    ASSERT_TRUE(cameras[i]->start(inboxes[i].onFrame(), inboxes[i].onEnd()));
  }
  for (const Inbox& inbox : inboxes) EXPECT_TRUE(inbox.waitFor(70));
  for (std::size_t i = 0; i < 2; ++i) {
    cameras[i]->stop();
    const StreamStatistics statistics = cameras[i]->statistics();
    const auto frames = inboxes[i].take();
    fmt::print(
        "measured: {:.2f} frames/s, {} packets, {} sent again, {} missing\n",
        static_cast<double>(frames.size() - 1) /
            toSeconds(frames.back().metadata.midExposure - frames.front().metadata.midExposure),
        statistics.packetsReceived, statistics.packetsResent, statistics.packetsMissing);
    EXPECT_EQ(statistics.delivered, frames.size());
    EXPECT_EQ(statistics.lost, 0u);
    EXPECT_EQ(statistics.incomplete, 0u);
    EXPECT_EQ(statistics.underruns, 0u);
    EXPECT_EQ(statistics.packetsMissing, 0u);
    EXPECT_EQ(statistics.skipped, 1u);  // the warm-up frame
    for (std::size_t k = 1; k < frames.size(); ++k) {
      EXPECT_EQ(frames[k].metadata.id, frames[k - 1].metadata.id + 1);
    }
    expectBitExact(frames, *rigs[i]);
  }
}

TEST(AravisCamera, LostPacketsAreSentAgain) {
  GigeDeviceOptions options = at(kScene);
  options.faults.loss = 0.01;
  Rig rig(options);
  const auto camera = open(kScene);
  ASSERT_TRUE(camera);
  Inbox inbox;
  ASSERT_TRUE(camera->start(inbox.onFrame(), inbox.onEnd()));
  EXPECT_TRUE(inbox.waitFor(40));
  camera->stop();
  const StreamStatistics statistics = camera->statistics();
  EXPECT_EQ(statistics.incomplete, 0u);
  EXPECT_EQ(statistics.lost, 0u);
  // 454 packets a frame, 40 frames, 1 percent of them: 180 on average.
  EXPECT_GT(statistics.packetsResent, 90u);
  fmt::print("measured: {} of {} packets sent again\n", statistics.packetsResent,
             statistics.packetsReceived);
  expectBitExact(inbox.take(), rig);
}

TEST(AravisCamera, ExposureAndGainAreHonouredAndLabelled) {
  Rig rig(at(kScene, 60), 320, 240);
  const auto camera = open(kScene);
  ASSERT_TRUE(camera);
  Inbox inbox;
  ASSERT_TRUE(camera->start(inbox.onFrame(), inbox.onEnd()));
  const std::array exposures = {0.004, 0.008, 0.0005, 0.012, 0.002};
  for (std::size_t i = 0; i < exposures.size(); ++i) {
    CameraSettings wish;
    wish.exposureSeconds = exposures[i];
    wish.gainDb = 3.0 * static_cast<double>(i);
    const auto settings = camera->configure(wish);
    ASSERT_TRUE(settings) << settings.error().message;
    EXPECT_NEAR(*settings->exposureSeconds, exposures[i], 1e-9);
    EXPECT_NEAR(*settings->gainDb, *wish.gainDb, 1e-9);
    ASSERT_TRUE(inbox.waitFor(inbox.count() + 8));
  }
  camera->stop();
  const auto frames = inbox.take();
  for (const double exposure : exposures) {
    EXPECT_TRUE(std::any_of(frames.begin(), frames.end(), [&](const Frame& frame) {
      return std::abs(frame.metadata.exposureSeconds - exposure) < 1e-9;
    })) << exposure;
  }
  for (const Frame& frame : frames) {
    const ExposureRequest truth = rig.source.request(indexOf(frame));
    EXPECT_NEAR(frame.metadata.exposureSeconds, truth.exposureSeconds, 1e-9);
    EXPECT_NEAR(frame.metadata.gainDb, truth.gainDb, 1e-9);
  }
  expectTrueTimes(frames, rig);
}

TEST(AravisCamera, ChunksConfirmTheExposureSoThatNoFrameIsSkipped) {
  GigeDeviceOptions options = at(kScene, 60);
  options.chunks = true;
  Rig rig(options, 320, 240);
  const auto camera = open(kScene);
  ASSERT_TRUE(camera);
  Inbox inbox;
  ASSERT_TRUE(camera->start(inbox.onFrame(), inbox.onEnd()));
  for (const double exposure : {0.004, 0.008, 0.0005, 0.012}) {
    CameraSettings wish;
    wish.exposureSeconds = exposure;
    wish.gainDb = 1e3 * exposure;
    ASSERT_TRUE(camera->configure(wish));
    ASSERT_TRUE(inbox.waitFor(inbox.count() + 5));
  }
  camera->stop();
  EXPECT_EQ(camera->statistics().skipped, 1u);  // the first frame; without chunks some more
  EXPECT_EQ(camera->statistics().implausible, 0u);
  const auto frames = inbox.take();
  expectBitExact(frames, rig);
  for (const Frame& frame : frames) {
    const ExposureRequest truth = rig.source.request(indexOf(frame));
    EXPECT_NEAR(frame.metadata.exposureSeconds, truth.exposureSeconds, 1e-9);
    EXPECT_NEAR(frame.metadata.gainDb, truth.gainDb, 1e-9);
  }
}

TEST(AravisCamera, PackedFormatsAreUnpacked) {
  for (const PixelFormat format :
       {PixelFormat::kMono10, PixelFormat::kMono12, PixelFormat::kBayerGB10,
        PixelFormat::kBayerBG12, PixelFormat::kRgb8}) {
    for (const WireFormat& wire : wireFormatsOf(format)) {
      SCOPED_TRACE(wire.name);
      GigeDeviceOptions options = at(kScene, 60);
      options.onlyFormat = wire.code;
      Rig rig(options, 64, 48, {format});
      const auto camera = open(kScene);
      ASSERT_TRUE(camera);
      CameraSettings wish;
      wish.format = format;
      const auto settings = camera->configure(wish);
      ASSERT_TRUE(settings) << settings.error().message;
      EXPECT_EQ(settings->format, format);
      Inbox inbox;
      ASSERT_TRUE(camera->start(inbox.onFrame(), inbox.onEnd()));
      EXPECT_TRUE(inbox.waitFor(3));
      camera->stop();
      expectBitExact(inbox.take(), rig);
    }
  }
}

TEST(AravisCamera, TriggersStartSingleExposures) {
  Rig rig(at(kScene), 64, 48);
  const auto camera = open(kScene);
  ASSERT_TRUE(camera);
  for (const std::string source : {"Software", "Line1"}) {
    SCOPED_TRACE(source);
    CameraSettings wish;
    wish.trigger = source;
    const auto settings = camera->configure(wish);
    ASSERT_TRUE(settings) << settings.error().message;
    EXPECT_EQ(settings->trigger, source);
    Inbox inbox;
    ASSERT_TRUE(camera->start(inbox.onFrame(), inbox.onEnd()));
    const std::size_t before = rig.source.exposed();
    for (std::size_t i = 1; i <= 4; ++i) {
      if (source == "Line1") {
        rig.device->pulse();
      } else {
        ASSERT_TRUE(camera->setFeature("TriggerSoftware", 1));
      }
      ASSERT_TRUE(eventually([&] { return rig.source.exposed() == before + i; }));
    }
    EXPECT_TRUE(inbox.waitFor(3));  // the first frame of a stream is dropped
    camera->stop();
    EXPECT_EQ(rig.source.exposed(), before + 4);
    expectTrueTimes(inbox.take(), rig);
  }
  CameraSettings wish;
  wish.trigger = "Line7";
  const auto refused = camera->configure(wish);
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().message.find("Line1"), std::string::npos) << refused.error().message;
  wish.trigger = "";
  ASSERT_TRUE(camera->configure(wish));
  Inbox inbox;
  ASSERT_TRUE(camera->start(inbox.onFrame(), inbox.onEnd()));
  EXPECT_TRUE(inbox.waitFor(3));
}

TEST(AravisCamera, PacketSizeIsWhatTheNetworkTakesAndTheSocketBufferWhatTheSystemGives) {
  for (const int mtu : {1500, 9000}) {
    GigeDeviceOptions options = at(kScene);
    options.mtu = mtu;
    Rig rig(options);
    const auto camera = open(kScene);
    ASSERT_TRUE(camera);
    Inbox inbox;
    ASSERT_TRUE(camera->start(inbox.onFrame(), inbox.onEnd()));
    EXPECT_TRUE(inbox.waitFor(3));
    camera->stop();
    const StreamStatistics statistics = camera->statistics();
    EXPECT_LE(statistics.packetBytes, mtu);
    EXPECT_GT(statistics.packetBytes, mtu - 100);
    const bool capped = statistics.socketBuffer < 4u << 20;
    EXPECT_GT(statistics.socketBuffer, 0u);
    EXPECT_EQ(camera->notes().size(), capped ? 1u : 0u);
    if (capped) {
      EXPECT_NE(camera->notes()[0].find("rmem_max"), std::string::npos);
    }
    expectBitExact(inbox.take(), rig);
  }
}

TEST(AravisCamera, SettingsOutOfRangeAreRefusedWithTheLimits) {
  Rig rig(at(kScene), 320, 240);
  const auto camera = open(kScene);
  ASSERT_TRUE(camera);
  const auto refusal = [&](const CameraSettings& wish) {
    const auto settings = camera->configure(wish);
    if (settings) return std::string();
    EXPECT_EQ(settings.error().code, ErrorCode::kInvalidArgument);
    return settings.error().message;
  };
  CameraSettings wish;
  wish.exposureSeconds = 100;
  EXPECT_NE(refusal(wish).find("outside the camera's 1e-05 to 10 s"), std::string::npos)
      << refusal(wish);
  wish = {};
  wish.gainDb = NAN;
  EXPECT_NE(refusal(wish).find("0 to 48 dB"), std::string::npos) << refusal(wish);
  wish = {};
  wish.framesPerSecond = 1e5;
  EXPECT_NE(refusal(wish).find("0.1 to 1000"), std::string::npos) << refusal(wish);
  wish = {};
  wish.region = Region{300, 0, 40, 40};
  EXPECT_NE(refusal(wish).find("320x240"), std::string::npos) << refusal(wish);
  wish = {};
  wish.format = PixelFormat::kMono16;
  EXPECT_NE(refusal(wish).find("BayerRG12, BayerRG16, RGB8, Mono8"), std::string::npos)
      << refusal(wish);
  // Nothing of it has changed the camera.
  const auto settings = camera->configure({});
  ASSERT_TRUE(settings);
  EXPECT_EQ(settings->region, (Region{0, 0, 320, 240}));
  EXPECT_EQ(settings->format, PixelFormat::kBayerRG12);
  EXPECT_NEAR(*settings->exposureSeconds, 0.004, 1e-9);
}

TEST(AravisCamera, RegionIsRead) {
  Rig rig(at(kScene));
  const auto camera = open(kScene);
  ASSERT_TRUE(camera);
  CameraSettings wish;
  for (const Region& region :
       {Region{100, 64, 200, 150}, Region{438, 300, 202, 180}, Region{0, 0, 640, 480}}) {
    wish.region = region;
    const auto settings = camera->configure(wish);
    ASSERT_TRUE(settings) << settings.error().message;
    EXPECT_EQ(settings->region, region);
    Inbox inbox;
    ASSERT_TRUE(camera->start(inbox.onFrame(), inbox.onEnd()));
    EXPECT_TRUE(inbox.waitFor(3));
    EXPECT_FALSE(camera->configure(wish));  // not while streaming
    camera->stop();
    const auto frames = inbox.take();
    ASSERT_FALSE(frames.empty());
    EXPECT_EQ(rig.source.request(indexOf(frames.back())).region, region);
    expectBitExact(frames, rig);
  }
}

TEST(AravisCamera, FrameIdsGoOnWhereTheDevicesWrap) {
  GigeDeviceOptions options = at(kScene, 60);
  options.firstFrameId = 65530;
  Rig rig(options, 64, 48);
  const auto camera = open(kScene);
  ASSERT_TRUE(camera);
  Inbox inbox;
  ASSERT_TRUE(camera->start(inbox.onFrame(), inbox.onEnd()));
  EXPECT_TRUE(inbox.waitFor(15));
  camera->stop();
  EXPECT_EQ(camera->statistics().lost, 0u);
  for (const Frame& frame : inbox.take()) {
    EXPECT_EQ(frame.metadata.id, 65530 + indexOf(frame));
  }
}

TEST(AravisCamera, DeviceClockIsMappedToTheHosts) {
  GigeDeviceOptions options = at(kScene);
  options.clockOffsetSeconds = 12345.678;
  options.clockDriftPpm = 50;
  Rig rig(options, 320, 240);
  const auto camera = open(kScene);
  ASSERT_TRUE(camera);
  Inbox inbox;
  ASSERT_TRUE(camera->start(inbox.onFrame(), inbox.onEnd()));
  EXPECT_TRUE(inbox.waitFor(90));
  camera->stop();
  const auto frames = inbox.take();
  expectTrueTimes(frames, rig);
  // The device's own time is handed on as it is.
  const double start = toSeconds(frames.front().metadata.midExposure.time_since_epoch()) - 0.002;
  EXPECT_NEAR(1e-9 * static_cast<double>(frames.front().metadata.deviceTimeNs), start + 12345.678,
              2e-3);
}

TEST(AravisCamera, WithoutALatchArrivalsMapTheClock) {
  GigeDeviceOptions options = at(kScene);
  options.clockOffsetSeconds = 5000;
  options.clockDriftPpm = -50;
  options.timestampLatch = false;
  Rig rig(options, 320, 240);
  const auto camera = open(kScene);
  ASSERT_TRUE(camera);
  Inbox inbox;
  ASSERT_TRUE(camera->start(inbox.onFrame(), inbox.onEnd()));
  EXPECT_TRUE(inbox.waitFor(60));
  camera->stop();
  // The mapping admits to 2 ms; a busy machine may add some to single arrivals.
  std::vector<double> errors;
  for (const Frame& frame : inbox.take()) errors.push_back(std::abs(timeError(frame, rig)));
  std::sort(errors.begin(), errors.end());
  fmt::print("measured: median error of mid-exposure {:.0f} us, largest {:.0f} us\n",
             1e6 * errors[errors.size() / 2], 1e6 * errors.back());
  EXPECT_LT(errors[errors.size() / 2], 10e-3);
}

TEST(AravisCamera, SlowExposuresDelayNoAnswer) {
  Rig rig(at(kScene), 64, 48);
  const auto camera = open(kScene);
  ASSERT_TRUE(camera);
  Inbox inbox;
  std::unique_lock gate(rig.source.gate());
  ASSERT_TRUE(camera->start(inbox.onFrame(), inbox.onEnd()));
  ASSERT_TRUE(eventually([&] { return rig.source.exposed() == 1; }));
  // The frame thread hangs for longer than the heartbeat's 3 s, yet registers are read and control
  // is kept.
  const TimePoint begin = Clock::now();
  while (Clock::now() - begin < std::chrono::milliseconds(3500)) {
    EXPECT_TRUE(camera->configure({}));
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  gate.unlock();
  EXPECT_TRUE(inbox.waitFor(5));
  camera->stop();
  EXPECT_TRUE(inbox.ends().empty());
  expectTrueTimes(inbox.take(), rig);
}

TEST(AravisCamera, GuideReachesTheSource) {
  Rig rig(at(kScene), 64, 48);
  const auto camera = open(kScene);
  ASSERT_TRUE(camera);
  EXPECT_TRUE(camera->hasFeature("GuideMode"));
  EXPECT_FALSE(camera->hasFeature("NoSuchFeature"));
  EXPECT_FALSE(camera->setFeature("NoSuchFeature", 1));
  EXPECT_TRUE(camera->setFeature("GuideX", 0.6));
  EXPECT_TRUE(camera->setFeature("GuideY", -0.48));
  EXPECT_TRUE(camera->setFeature("GuideZ", 0.64));
  EXPECT_FALSE(rig.source.lastGuide());  // only the mode sends it off
  EXPECT_TRUE(camera->setFeature("GuideMode", 2));
  ASSERT_TRUE(eventually([&] { return rig.source.lastGuide().has_value(); }));
  const Guide guide = *rig.source.lastGuide();
  EXPECT_EQ(guide.mode, Guide::Mode::kFollow);
  EXPECT_EQ(guide.target, Eigen::Vector3d(0.6, -0.48, 0.64));
}

TEST(AravisCamera, AbsentCameraIsReportedWithWhatWasTriedAndWhatIsThere) {
  ::testing::internal::CaptureStderr();
  ::testing::internal::CaptureStdout();
  const auto camera = openCamera("aravis:" + ownAddress(2));
  const std::string printed =
      ::testing::internal::GetCapturedStderr() + ::testing::internal::GetCapturedStdout();
  ASSERT_FALSE(camera);
  EXPECT_EQ(camera.error().code, ErrorCode::kNotFound);
  EXPECT_NE(camera.error().message.find(ownAddress(2)), std::string::npos);
  EXPECT_NE(camera.error().message.find("connected"), std::string::npos) << camera.error().message;
  EXPECT_EQ(camera.error().message.find('\n'), std::string::npos);
  EXPECT_EQ(printed, "");
  EXPECT_FALSE(openCamera("aravis:No-Such-Camera"));
}

TEST(AravisCamera, SecondControllerIsRefusedUntilTheFirstLetsGo) {
  Rig rig(at(kScene), 64, 48);
  auto first = open(kScene);
  ASSERT_TRUE(first);
  ::testing::internal::CaptureStderr();
  const auto second = openCamera("aravis:" + kScene);
  EXPECT_EQ(::testing::internal::GetCapturedStderr(), "");
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().code, ErrorCode::kDevice);
  EXPECT_NE(second.error().message.find("another program controls"), std::string::npos)
      << second.error().message;
  EXPECT_TRUE(first->configure({}));  // the first has not noticed
  first.reset();
  EXPECT_TRUE(openCamera("aravis:" + kScene));
}

TEST(AravisCamera, LostDeviceEndsTheStreamOnceAndStopReturns) {
  ::testing::internal::CaptureStderr();
  auto rig = std::make_unique<Rig>(at(kScene), 64, 48);
  auto camera = open(kScene);
  ASSERT_TRUE(camera);
  Inbox inbox;
  ASSERT_TRUE(camera->start(inbox.onFrame(), inbox.onEnd()));
  ASSERT_TRUE(inbox.waitFor(3));
  rig->device.reset();
  ASSERT_TRUE(eventually([&] { return !inbox.ends().empty(); }));
  EXPECT_FALSE(camera->configure({}));
  auto closing = std::async(std::launch::async, [&] { camera.reset(); });
  // Aravis alone would block for 7.5 s.
  EXPECT_EQ(closing.wait_for(std::chrono::seconds(4)), std::future_status::ready);
  closing.wait();
  ASSERT_EQ(inbox.ends().size(), 1u);
  EXPECT_EQ(inbox.ends()[0].code, ErrorCode::kDevice);
  EXPECT_NE(inbox.ends()[0].message.find(kScene), std::string::npos);
  EXPECT_EQ(::testing::internal::GetCapturedStderr(), "");
}

TEST(AravisCamera, StopOfACameraThatJustDiedReturns) {
  auto rig = std::make_unique<Rig>(at(kScene), 64, 48);
  auto camera = open(kScene);
  ASSERT_TRUE(camera);
  Inbox inbox;
  ASSERT_TRUE(camera->start(inbox.onFrame(), inbox.onEnd()));
  ASSERT_TRUE(inbox.waitFor(3));
  rig->device.reset();
  auto closing = std::async(std::launch::async, [&] { camera->stop(); });
  EXPECT_EQ(closing.wait_for(std::chrono::seconds(10)), std::future_status::ready);
  closing.wait();
  EXPECT_TRUE(inbox.ends().empty());
  camera.reset();
  // The same address serves again.
  Rig again(at(kScene), 64, 48);
  EXPECT_TRUE(openCamera("aravis:" + kScene));
}

TEST(ListCameras, FindsARigOnItsDefaultAddress) {
  PatternSource source(64, 48, {PixelFormat::kMono8});
  GigeDeviceOptions options;
  options.address = "127.0.0.11";
  // If somebody else's rig has the address, that one is to be found.
  const auto device = GigeDevice::start(source, options, Clock::now());
  const auto cameras = listCameras();
  ASSERT_TRUE(cameras);
  const auto found = std::find_if(cameras->begin(), cameras->end(), [](const CameraInfo& info) {
    return info.address == "aravis:127.0.0.11";
  });
  ASSERT_NE(found, cameras->end());
  EXPECT_FALSE(found->model.empty());
}

}  // namespace
}  // namespace lightsketch
