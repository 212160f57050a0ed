// Rows of the fault matrix: what goes wrong between a camera and us, over real loopback sockets.
// Every frame is a pattern that depends on its number, so that a wrong bit, place or time shows.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cmath>
#include <ctime>
#include <functional>
#include <future>
#include <map>
#include <mutex>
#include <ostream>

#include "capture/device/camera.h"
#include "capture/rig/gige_device.h"
#include "tests/capture/device/pattern_source.h"

namespace {
std::atomic<long> wallClockOffsetSeconds = 0;
}

// Stands before the C library's, for this program and the libraries that it loads: somebody sets
// the host's clock. Declared as there.
extern "C" int clock_gettime(clockid_t clock, struct timespec* time) noexcept {
  const long result = ::syscall(SYS_clock_gettime, clock, time);
  if (result == 0 && clock == CLOCK_REALTIME) time->tv_sec += wallClockOffsetSeconds;
  return static_cast<int>(result);
}

namespace lightsketch {
namespace {

using namespace std::chrono_literals;

constexpr int kWidth = 320, kHeight = 240;  // 105 packets of 1500 bytes
const Region kWhole{0, 0, kWidth, kHeight};

// A camera, what reads it, and what came of each frame.
class Trial {
 public:
  explicit Trial(GigeDeviceOptions options = {}, int address = 0, double framesPerSecond = 30)
      : source_(kWidth, kHeight, {PixelFormat::kBayerRG12}) {
    options_ = std::move(options);
    options_.address = ownAddress(address);
    options_.defaultFramesPerSecond = framesPerSecond;
    options_.defaultExposureSeconds = 0.004;
    plugIn();
  }
  ~Trial() { stop(); }

  void plugIn() {
    auto started = GigeDevice::start(source_, options_, startTime_);
    if (!started) ADD_FAILURE() << started.error().message;
    device = std::move(started).value();
  }
  bool start(std::function<void()> onEveryFrame = {}) {
    auto opened = openCamera("aravis:" + options_.address);
    if (!opened) {
      ADD_FAILURE() << opened.error().message;
      return false;
    }
    camera = std::move(*opened);
    next_ = 0;
    const auto started = camera->start(
        [this, onEveryFrame = std::move(onEveryFrame)](Frame&& frame) {
          take(frame);
          if (onEveryFrame) onEveryFrame();
        },
        [this](const Error& error) {
          const std::lock_guard lock(mutex_);
          ends_.push_back(error.message);
        });
    if (!started) ADD_FAILURE() << started.error().message;
    return started.has_value();
  }
  void stop() {
    if (camera) camera->stop();
  }
  bool waitFor(int frames, std::chrono::seconds limit = 60s) {
    return eventually([&] { return good() >= frames; }, limit);
  }
  bool waitForMore(int frames) { return waitFor(good() + frames); }
  int good() const { return good_; }
  int wrong() const { return wrong_; }
  std::uint64_t sent() const { return device->framesSent(); }
  std::vector<std::string> ends() const {
    const std::lock_guard lock(mutex_);
    return ends_;
  }
  double worstTimeError() const { return worstTimeError_; }
  // Frames that the camera was said to have sent and that were not handed on, whatever the reason.
  static std::uint64_t withheld(const StreamStatistics& s) {
    return s.incomplete + s.implausible + s.skipped + s.lost;
  }
  // Nothing wrong was handed on, and what was not handed on was counted.
  void expectOnlyRight(double timeTolerance = 0.01) {
    const StreamStatistics s = camera->statistics();
    EXPECT_EQ(wrong_, 0);
    EXPECT_LT(worstTimeError_, timeTolerance);
    EXPECT_EQ(s.delivered, static_cast<std::uint64_t>(good_ + wrong_));
    ::testing::Test::RecordProperty(
        "outcome", fmt::format("{} of {} frames, 0 wrong; {} damaged, {} doubted, {} lost", good(),
                               sent(), s.incomplete, s.implausible, s.lost));
  }

  std::unique_ptr<GigeDevice> device;
  std::unique_ptr<Camera> camera;

 private:
  void take(const Frame& frame) {
    const std::uint64_t index = indexOf(frame);
    bool right = index < source_.exposed() && frame.width == kWidth && frame.height == kHeight &&
                 frame.bytes == patternBytes(index, PixelFormat::kBayerRG12, kWhole);
    if (right) {
      const double truth = source_.request(index).timeSeconds;
      const double error = toSeconds(frame.metadata.midExposure - startTime_) - truth;
      worstTimeError_ = std::max(worstTimeError_.load(), std::abs(error));
      if (index < next_) right = false;  // out of order, or twice
      next_ = index + 1;
    }
    ++(right ? good_ : wrong_);
  }

  PatternSource source_;
  GigeDeviceOptions options_;
  const TimePoint startTime_ = Clock::now();
  std::uint64_t next_ = 0;  // the camera's thread's
  std::atomic<int> good_ = 0, wrong_ = 0;
  std::atomic<double> worstTimeError_ = 0;
  mutable std::mutex mutex_;  // Guards ends_.
  std::vector<std::string> ends_;
};

void injected(const std::string& what) { ::testing::Test::RecordProperty("injected", what); }
void outcome(const std::string& what) { ::testing::Test::RecordProperty("outcome", what); }

// --- On the wire ---------------------------------------------------------------------------------

struct Loss {
  double share;
  int frames;
};
void PrintTo(const Loss& loss, std::ostream* out) { *out << 100 * loss.share << " %"; }
class FaultLoss : public ::testing::TestWithParam<Loss> {};

TEST_P(FaultLoss, WithResendEveryFrameIsComplete) {
  injected(fmt::format("{} % of packets lost, resend", 100 * GetParam().share));
  GigeDeviceOptions options;
  options.faults.loss = GetParam().share;
  Trial trial(options, 0, 60);
  ASSERT_TRUE(trial.start());
  EXPECT_TRUE(trial.waitFor(GetParam().frames));
  const StreamStatistics s = trial.camera->statistics();  // without the one that stopping cuts off
  trial.stop();
  trial.expectOnlyRight();
  EXPECT_EQ(s.incomplete, 0u);
  EXPECT_EQ(s.lost, 0u);
  EXPECT_EQ(s.implausible, 0u);
  // A third of what is expected: chance is far from that.
  EXPECT_GT(s.packetsResent, 105 * GetParam().frames * GetParam().share / 3);
}

TEST_P(FaultLoss, WithoutResendOnlyWholeFramesPass) {
  injected(fmt::format("{} % of packets lost, no resend", 100 * GetParam().share));
  GigeDeviceOptions options;
  options.faults.loss = GetParam().share;
  options.faults.resend = false;
  Trial trial(options, 0, 60);
  ASSERT_TRUE(trial.start());
  EXPECT_TRUE(eventually([&] { return trial.sent() >= 300; }));
  trial.stop();
  trial.expectOnlyRight();
  // (1 - p)^107 of them, give or take five sigma.
  const double expected = 300 * std::pow(1 - GetParam().share, 107);
  EXPECT_NEAR(trial.good(), expected, 5 * std::sqrt(expected * (1 - expected / 300)) + 5);
  const StreamStatistics s = trial.camera->statistics();
  // An incomplete frame is given up after 0.4 s: those of the last 0.4 s at 60 a second are told by
  // nobody, and the first frame is not counted.
  EXPECT_NEAR(static_cast<double>(s.delivered + Trial::withheld(s)),
              static_cast<double>(trial.sent()), 30);
}

INSTANTIATE_TEST_SUITE_P(FaultWire, FaultLoss,
                         ::testing::Values(Loss{0.001, 300}, Loss{0.01, 1000}, Loss{0.05, 300}),
                         [](const auto& tested) {
                           return fmt::format("PerMille{}", std::lround(1000 * tested.param.share));
                         });

// Streams so many frames while the wire is like that, and as many after it is well again.
void runThrough(const std::string& what, const GigeFaults& faults, std::uint64_t frames,
                bool chunks = false, int atLeast = 1) {
  injected(what);
  GigeDeviceOptions options;
  options.faults = faults;
  options.chunks = chunks;
  Trial trial(options);
  ASSERT_TRUE(trial.start());
  EXPECT_TRUE(eventually([&] { return trial.sent() >= frames; }, 60s));
  EXPECT_GE(trial.good(), atLeast);
  trial.device->setFaults({});
  EXPECT_TRUE(trial.waitForMore(30));
  trial.stop();
  EXPECT_TRUE(trial.ends().empty());
  trial.expectOnlyRight();
}

TEST(FaultWire, DuplicatesChangeNothing) {
  GigeFaults faults;
  faults.duplicated = 0.05;
  runThrough("5 % of packets twice", faults, 120, false, 110);
}

TEST(FaultWire, ReorderedPacketsAreSorted) {
  GigeFaults faults;
  faults.reordered = 0.05;
  runThrough("5 % of packets out of order", faults, 120, false, 80);
}

TEST(FaultWire, DamagedHeadersSpoilNothingThatIsAccepted) {
  GigeFaults faults;
  faults.corruptedHeader = 0.002;
  runThrough("a bit of 0.2 % of headers and leaders flipped", faults, 240);
}

TEST(FaultWire, DamagedLengthsSpoilNothingThatIsAccepted) {
  GigeFaults faults;
  faults.corruptedLength = 0.002;
  runThrough("0.2 % of packets too short or too long", faults, 240);
}

TEST(FaultWire, DamagedPicturesAreFoundByTheChecksum) {
  GigeFaults faults;
  faults.corruptedPayload = 0.005;
  runThrough("a bit of 0.5 % of payloads flipped, CRC chunk", faults, 180, true);
}

TEST(FaultWire, ManyDamagedHeadersAreFoundByTheChecksum) {
  GigeFaults faults;
  faults.corruptedHeader = 0.01;
  runThrough("a bit of 1 % of headers flipped, CRC chunk", faults, 180, true, 0);
}

TEST(FaultWire, StallingSenderCostsSingleFrames) {
  GigeFaults faults;
  faults.stalled = 0.3;
  faults.stallSeconds = 0.15;
  runThrough("sender stalls 0.15 s within 30 % of frames", faults, 60, false, 20);
}

TEST(FaultWire, LongStallsCostSingleFrames) {
  GigeFaults faults;
  faults.stalled = 0.2;
  faults.stallSeconds = 0.6;
  runThrough("sender stalls 0.6 s within 20 % of frames", faults, 30);
}

TEST(FaultWire, FrameNumbersWrapUnderLoss) {
  injected("frame ids wrap from 65535 to 1, 1 % loss");
  GigeDeviceOptions options;
  options.firstFrameId = 65500;
  options.faults.loss = 0.01;
  Trial trial(options, 0, 60);
  ASSERT_TRUE(trial.start());
  EXPECT_TRUE(trial.waitFor(100));
  trial.stop();
  trial.expectOnlyRight();
  EXPECT_EQ(trial.camera->statistics().lost, 0u);
}

TEST(FaultWire, TwoCamerasOnOneSlowLinkLoseFramesButGetNoneWrong) {
  injected("two cameras of 9.5 MB/s on a link of 12 MB/s");
  GigeDeviceOptions options;
  options.link = std::make_shared<SlowLink>(12e6, 64e3);
  Trial first(options, 0, 60), second(options, 1, 60);
  ASSERT_TRUE(first.start());
  ASSERT_TRUE(second.start());
  EXPECT_TRUE(eventually([&] { return first.sent() >= 300 && second.sent() >= 300; }));
  first.stop();
  second.stop();
  for (Trial* const trial : {&first, &second}) {
    trial->expectOnlyRight();
    EXPECT_TRUE(trial->ends().empty());
  }
  EXPECT_GT(first.good() + second.good(), 0);
  EXPECT_LT(static_cast<std::uint64_t>(first.good() + second.good()),
            first.sent() + second.sent() - 10);
  outcome(fmt::format("{} and {} of 300 frames, 0 wrong, the rest counted", first.good(),
                      second.good()));
}

// --- Clocks --------------------------------------------------------------------------------------

// Frames that only their arrival tells the time of are as late as this program on a busy machine.
constexpr double kArrivalTolerance = 0.1;

void runWithClock(const std::string& what, const GigeFaults& faults, double timeTolerance,
                  bool latch = true) {
  injected(what);
  GigeDeviceOptions options;
  options.timestampLatch = latch;
  Trial trial(options);
  ASSERT_TRUE(trial.start());
  EXPECT_TRUE(trial.waitFor(20));
  trial.device->setFaults(faults);
  EXPECT_TRUE(trial.waitForMore(60));
  trial.device->setFaults({});
  EXPECT_TRUE(trial.waitForMore(30));
  trial.stop();
  trial.expectOnlyRight(timeTolerance);
  const StreamStatistics s = trial.camera->statistics();
  outcome(fmt::format("{} frames timed within {:.1f} ms, {} withheld", trial.good(),
                      1e3 * trial.worstTimeError(), s.implausible));
}

TEST(FaultClock, ZeroTimesAreReplacedByArrivals) {
  GigeFaults faults;
  faults.zeroTimestamps = true;
  runWithClock("frames' times are zero", faults, kArrivalTolerance);
}

TEST(FaultClock, TimesOfAnotherEpochAreMappedByArrivals) {
  GigeFaults faults;
  faults.frameClockSeconds = 1.7e9;
  runWithClock("frames' times of another epoch than the clock", faults, kArrivalTolerance);
}

TEST(FaultClock, SettingTheCamerasClockIsNoticed) {
  GigeFaults faults;
  faults.deviceClockSeconds = 700;
  runWithClock("camera's clock set 700 s ahead and back", faults, 0.01);
}

TEST(FaultClock, SmallStepsOfTheCamerasClockAreNoticed) {
  GigeFaults faults;
  faults.deviceClockSeconds = -0.4;
  runWithClock("camera's clock set 0.4 s back and ahead", faults, 0.01);
}

TEST(FaultClock, WithoutALatchSettingTheClockIsNoticed) {
  GigeFaults faults;
  faults.deviceClockSeconds = -5;
  runWithClock("clock that cannot be latched set 5 s back", faults, kArrivalTolerance, false);
}

TEST(FaultClock, JumpingTimesCostFramesButNoneIsWrong) {
  injected("clock jumps by seconds ten times");
  Trial trial;
  ASSERT_TRUE(trial.start());
  for (int i = 0; i < 10; ++i) {
    GigeFaults faults;
    faults.deviceClockSeconds = (i % 2 == 0 ? 1 : -1) * (1 + 3.7 * i);
    trial.device->setFaults(faults);
    std::this_thread::sleep_for(300ms);
  }
  EXPECT_TRUE(trial.waitForMore(30));
  trial.stop();
  trial.expectOnlyRight();
}

TEST(FaultClock, SettingTheHostsClockChangesNothing) {
  injected("host's clock set back an hour, and ahead a day");
  for (const bool latch : {true, false}) {
    GigeDeviceOptions options;
    options.timestampLatch = latch;
    Trial trial(options);
    ASSERT_TRUE(trial.start());
    for (const long offset : {-3600L, 86400L, 0L}) {
      EXPECT_TRUE(trial.waitForMore(20));
      wallClockOffsetSeconds = offset;
    }
    EXPECT_TRUE(trial.waitForMore(20));
    trial.stop();
    trial.expectOnlyRight(latch ? 0.01 : kArrivalTolerance);
    EXPECT_EQ(trial.camera->statistics().implausible, 0u);
  }
}

TEST(FaultClock, AClockThatStartsToFollowOthersIsMappedAllTheSame) {
  injected("PTP locks and steps the camera's clock by decades");
  GigeDeviceOptions options;
  options.ptp = true;
  options.clockOffsetSeconds = 5;
  Trial trial(options);
  ASSERT_TRUE(trial.start());
  EXPECT_TRUE(trial.waitFor(60));
  trial.stop();
  trial.expectOnlyRight();
}

// --- Cameras and programs ------------------------------------------------------------------------

TEST(FaultCamera, KilledEndsTheStreamOnceAndIsFoundWhenItIsBack) {
  injected("camera unplugged, and back");
  Trial trial;
  ASSERT_TRUE(trial.start());
  EXPECT_TRUE(trial.waitFor(10));
  trial.device.reset();
  EXPECT_TRUE(eventually([&] { return !trial.ends().empty(); }));
  EXPECT_EQ(trial.ends().size(), 1u);
  EXPECT_NE(trial.ends()[0].find("does not answer"), std::string::npos) << trial.ends()[0];
  trial.plugIn();
  ASSERT_TRUE(trial.start());  // in the place of the dead one, which closes by itself
  EXPECT_TRUE(trial.waitForMore(20));
  EXPECT_EQ(trial.wrong(), 0);
  outcome("ended once in words, opened again, frames right");
}

TEST(FaultCamera, FrozenEndsTheStream) {
  injected("camera frozen: neither answers nor sends");
  Trial trial;
  ASSERT_TRUE(trial.start());
  EXPECT_TRUE(trial.waitFor(10));
  GigeFaults faults;
  faults.frozen = true;
  trial.device->setFaults(faults);
  EXPECT_TRUE(eventually([&] { return !trial.ends().empty(); }));
  EXPECT_FALSE(trial.camera->configure({}));
  auto closing = std::async(std::launch::async, [&] { trial.camera.reset(); });
  EXPECT_EQ(closing.wait_for(4s), std::future_status::ready);  // Aravis alone: 7.5 s
  EXPECT_EQ(trial.wrong(), 0);
  outcome("ended in words, closed without waiting");
}

TEST(FaultCamera, SilentEndsTheStream) {
  injected("camera answers but sends no more frames");
  Trial trial;
  ASSERT_TRUE(trial.start());
  EXPECT_TRUE(trial.waitFor(10));
  GigeFaults faults;
  faults.silent = true;
  trial.device->setFaults(faults);
  EXPECT_TRUE(eventually([&] { return !trial.ends().empty(); }));
  EXPECT_NE(trial.ends()[0].find("sends no frames"), std::string::npos) << trial.ends()[0];
  outcome("ended in words after six seconds");
}

TEST(FaultCamera, ShortFreezeIsSurvived) {
  injected("camera frozen for one second");
  Trial trial;
  ASSERT_TRUE(trial.start());
  EXPECT_TRUE(trial.waitFor(10));
  GigeFaults faults;
  faults.frozen = true;
  trial.device->setFaults(faults);
  std::this_thread::sleep_for(1s);
  trial.device->setFaults({});
  EXPECT_TRUE(trial.waitForMore(30));
  EXPECT_TRUE(trial.ends().empty());
  trial.stop();
  trial.expectOnlyRight();
}

TEST(FaultCamera, SecondControllerIsRefusedAndDisturbsNothing) {
  injected("second program opens the camera");
  Trial trial;
  ASSERT_TRUE(trial.start());
  EXPECT_TRUE(trial.waitFor(10));
  const auto second = openCamera("aravis:" + ownAddress(0));
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().code, ErrorCode::kDevice);
  EXPECT_NE(second.error().message.find("another program controls"), std::string::npos);
  EXPECT_TRUE(trial.waitForMore(20));
  trial.stop();
  EXPECT_EQ(trial.camera->statistics().lost, 0u);
  EXPECT_EQ(trial.wrong(), 0);
  outcome("refused in words, the first lost no frame");
}

TEST(FaultHost, KilledProgramIsRestartedWithinTheHeartbeat) {
  injected("own process killed, started again at once");
  std::array<int, 2> go{}, streams{};
  ASSERT_EQ(::pipe(go.data()), 0);
  ASSERT_EQ(::pipe(streams.data()), 0);
  const std::string address = "aravis:" + ownAddress(0);
  const pid_t child = ::fork();  // before this process has threads
  if (child == 0) {
    char byte = 0;
    if (::read(go[0], &byte, 1) != 1) ::_exit(1);
    const auto camera = openCamera(address);
    if (!camera) ::_exit(2);
    (void)(*camera)->start([&](Frame&&) {
      if (::write(streams[1], "f", 1) != 1) ::_exit(3);
    });
    while (true) ::pause();
  }
  Trial trial;
  char byte = 0;
  ASSERT_EQ(::write(go[1], "g", 1), 1);
  ASSERT_EQ(::read(streams[0], &byte, 1), 1);
  ::kill(child, SIGKILL);
  ::waitpid(child, nullptr, 0);
  // The camera still believes in the one that was killed, for three seconds.
  ASSERT_TRUE(trial.start());
  EXPECT_TRUE(trial.waitFor(20));
  trial.stop();
  EXPECT_EQ(trial.wrong(), 0);
  for (const int end : {go[0], go[1], streams[0], streams[1]}) ::close(end);
  outcome("opening waits until the camera is free, frames right");
}

TEST(FaultHost, SlowConsumerLosesFramesButGetsNoneWrong) {
  injected("callback takes 0.2 s, camera sends every 33 ms");
  Trial trial;
  ASSERT_TRUE(trial.start([] { std::this_thread::sleep_for(200ms); }));
  EXPECT_TRUE(eventually([&] { return trial.sent() >= 120; }));
  trial.stop();
  trial.expectOnlyRight();
  EXPECT_GT(trial.good(), 5);
}

}  // namespace
}  // namespace lightsketch
