#include "capture/device/replay_camera.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <condition_variable>
#include <cstdlib>
#include <fstream>
#include <mutex>
#include <optional>
#include <sstream>

#include "capture/device/camera.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

class Replay : public ::testing::Test {
 protected:
  Replay() {
    std::string name = (fs::temp_directory_path() / "replay-XXXXXX").string();
    root_ = ::mkdtemp(name.data());
  }
  ~Replay() override { fs::remove_all(root_); }

  fs::path folder() const { return root_ / "stream"; }
  std::string journal() const {
    std::ifstream in(folder() / "frames.jsonl");
    std::stringstream text;
    text << in.rdbuf();
    return text.str();
  }
  void setJournal(const std::string& text) const {
    std::ofstream(folder() / "frames.jsonl") << text;
  }
  void keep(const std::vector<Frame>& frames) const {
    auto writer = ReplayWriter::create(folder(), {"", "vendor", "model", "serial"});
    ASSERT_TRUE(writer) << writer.error().message;
    for (const Frame& frame : frames) {
      const auto written = writer->write(frame);
      ASSERT_TRUE(written) << written.error().message;
    }
  }

  fs::path root_;
};

// 50 frames/s, every sample different from its neighbours, extremes included.
Frame makeFrame(PixelFormat format, int number) {
  Frame frame;
  frame.format = format;
  frame.width = 21;
  frame.height = 13;
  const PixelFormatInfo& info = pixelFormatInfo(format);
  const unsigned max = (1u << info.bits) - 1;
  const unsigned values = static_cast<unsigned>(frame.width * frame.height * info.channels);
  for (unsigned i = 0; i < values; ++i) {
    const unsigned value = i == 0 ? max : (i * 2654435761u + static_cast<unsigned>(number)) & max;
    frame.bytes.push_back(static_cast<std::uint8_t>(value));
    if (info.bits > 8) frame.bytes.push_back(static_cast<std::uint8_t>(value >> 8));
  }
  frame.metadata.id = 65530u + static_cast<unsigned>(number);
  frame.metadata.deviceTimeNs = 1'234'567'890'123 + number * 20'000'000;
  frame.metadata.midExposure = TimePoint(std::chrono::milliseconds(987'654'321 + 20 * number));
  frame.metadata.timeUncertainty = std::chrono::microseconds(35);
  frame.metadata.exposureSeconds = 0.0125;
  frame.metadata.gainDb = 3.5;
  return frame;
}

struct Played {
  std::vector<Frame> frames;
  std::optional<Error> end;
};

Played play(const std::string& address) {
  Played played;
  auto camera = openCamera(address);
  EXPECT_TRUE(camera) << camera.error().message;
  if (!camera) return played;
  std::mutex mutex;
  std::condition_variable ended;
  const auto started =
      (*camera)->start([&](Frame&& frame) { played.frames.push_back(std::move(frame)); },
                       [&](const Error& error) {
                         const std::lock_guard lock(mutex);
                         played.end = error;
                         ended.notify_all();
                       });
  EXPECT_TRUE(started) << started.error().message;
  std::unique_lock lock(mutex);
  ended.wait_for(lock, std::chrono::seconds(20), [&] { return played.end.has_value(); });
  lock.unlock();
  (*camera)->stop();
  EXPECT_EQ((*camera)->statistics().delivered, played.frames.size());
  return played;
}

TEST_F(Replay, EveryFormatComesBackBitForBitWithItsMetadata) {
  for (const PixelFormat format :
       {PixelFormat::kMono8, PixelFormat::kMono10, PixelFormat::kMono12, PixelFormat::kMono16,
        PixelFormat::kBayerRG8, PixelFormat::kBayerRG12, PixelFormat::kBayerRG16,
        PixelFormat::kRgb8}) {
    SCOPED_TRACE(pixelFormatInfo(format).name);
    fs::remove_all(folder());
    keep({makeFrame(format, 0), makeFrame(format, 1), makeFrame(format, 2)});
    const Played played = play("replay:" + folder().string() + "?rate=0");
    ASSERT_EQ(played.frames.size(), 3u);
    ASSERT_TRUE(played.end);
    EXPECT_EQ(played.end->code, ErrorCode::kCancelled);
    for (int i = 0; i < 3; ++i) {
      const Frame& frame = played.frames[static_cast<std::size_t>(i)];
      const Frame original = makeFrame(format, i);
      EXPECT_EQ(frame.bytes, original.bytes);
      EXPECT_EQ(frame.width, original.width);
      EXPECT_EQ(frame.height, original.height);
      EXPECT_EQ(frame.format, original.format);
      EXPECT_EQ(frame.metadata.id, original.metadata.id);
      EXPECT_EQ(frame.metadata.deviceTimeNs, original.metadata.deviceTimeNs);
      EXPECT_EQ(frame.metadata.exposureSeconds, original.metadata.exposureSeconds);
      EXPECT_EQ(frame.metadata.gainDb, original.metadata.gainDb);
      EXPECT_EQ(frame.metadata.timeUncertainty, original.metadata.timeUncertainty);
      // Seconds as a double hold a million seconds to a nanosecond.
      EXPECT_LE(std::abs((frame.metadata.midExposure - original.metadata.midExposure).count()), 1);
    }
  }
}

TEST_F(Replay, RealTimeKeepsTheRecordedSpacing) {
  std::vector<Frame> frames;
  for (int i = 0; i < 6; ++i) frames.push_back(makeFrame(PixelFormat::kMono8, i));
  keep(frames);
  const Played played = play("replay:" + folder().string());
  ASSERT_EQ(played.frames.size(), frames.size());
  // No frame before its time; how much later it comes is the machine's business.
  for (std::size_t i = 1; i < frames.size(); ++i) {
    EXPECT_GE(played.frames[i].metadata.arrival - played.frames[0].metadata.arrival,
              std::chrono::milliseconds(20) * static_cast<int>(i) - std::chrono::milliseconds(15));
  }
}

TEST_F(Replay, TellsItsSettingsAndItsCamera) {
  std::vector<Frame> frames;
  for (int i = 0; i < 3; ++i) frames.push_back(makeFrame(PixelFormat::kBayerRG12, i));
  keep(frames);
  auto camera = openCamera("replay:" + folder().string());
  ASSERT_TRUE(camera) << camera.error().message;
  EXPECT_EQ((*camera)->info().model, "model");
  CameraSettings wish;
  wish.exposureSeconds = 1;
  const auto settings = (*camera)->configure(wish);
  ASSERT_TRUE(settings);
  EXPECT_EQ(settings->format, PixelFormat::kBayerRG12);
  EXPECT_EQ(settings->region, (Region{0, 0, 21, 13}));
  EXPECT_EQ(settings->exposureSeconds, 0.0125);
  EXPECT_EQ(settings->gainDb, 3.5);
  EXPECT_NEAR(*settings->framesPerSecond, 50, 1e-6);
  EXPECT_FALSE((*camera)->hasFeature("GuideX"));
}

TEST_F(Replay, StopsInTheMiddle) {
  std::vector<Frame> frames;
  for (int i = 0; i < 3; ++i) frames.push_back(makeFrame(PixelFormat::kMono8, i));
  frames[2].metadata.midExposure += std::chrono::hours(1);
  keep(frames);
  auto camera = openCamera("replay:" + folder().string());
  ASSERT_TRUE(camera);
  std::mutex mutex;
  std::condition_variable came;
  int count = 0;
  bool ended = false;
  ASSERT_TRUE((*camera)->start(
      [&](Frame&&) {
        const std::lock_guard lock(mutex);
        ++count;
        came.notify_all();
      },
      [&](const Error&) { ended = true; }));
  {
    std::unique_lock lock(mutex);
    ASSERT_TRUE(came.wait_for(lock, std::chrono::seconds(20), [&] { return count == 2; }));
  }
  (*camera)->stop();
  EXPECT_EQ(count, 2);
  EXPECT_FALSE(ended);
}

TEST_F(Replay, DamagedJournalIsRefusedWithFileAndLine) {
  keep({makeFrame(PixelFormat::kMono8, 0), makeFrame(PixelFormat::kMono8, 1)});
  const std::string good = journal();
  const auto lineThree = good.find('\n', good.find('\n') + 1) + 1;
  const std::string begin = good.substr(0, lineThree);
  const std::string last = good.substr(lineThree);
  const auto replaced = [&](const std::string& from, const std::string& to) {
    std::string text = last;
    const auto at = text.find(from);
    EXPECT_NE(at, std::string::npos) << from;
    return text.replace(at, from.size(), to);
  };
  for (const std::string& bad :
       {last.substr(0, last.size() / 2), std::string("[1, 2]\n"), std::string("\0\0\n", 3),
        replaced("\"Mono8\"", "\"Mono9\""), replaced("\"gainDb\":3.5", "\"gainDb\":\"3.5\""),
        replaced("000001.png", "000007.png"), replaced("000001.png", "../000001.png"),
        replaced("\"exposureSeconds\":0.0125", "\"exposureSeconds\":-1"),
        replaced("\"midExposureSeconds\":", "\"midExposureSeconds\":1e300, \"was\":"),
        replaced("\"id\":65531", "\"id\":-1")}) {
    setJournal(begin + bad);
    const auto camera = openCamera("replay:" + folder().string());
    ASSERT_FALSE(camera) << bad;
    EXPECT_NE(camera.error().message.find("frames.jsonl: line 3"), std::string::npos)
        << camera.error().message;
    EXPECT_EQ(camera.error().message.find('\n'), std::string::npos);
  }
}

TEST_F(Replay, ForeignNewerOrEmptyJournalIsRefused) {
  keep({makeFrame(PixelFormat::kMono8, 0)});
  const std::string good = journal();
  setJournal(good.substr(good.find('\n') + 1));
  EXPECT_FALSE(openCamera("replay:" + folder().string()));  // no header
  std::string newer = good;
  newer.replace(newer.find("\"formatVersion\":1"), 17, "\"formatVersion\":2");
  setJournal(newer);
  EXPECT_FALSE(openCamera("replay:" + folder().string()));
  setJournal(good.substr(0, good.find('\n') + 1));
  const auto empty = openCamera("replay:" + folder().string());
  ASSERT_FALSE(empty);
  EXPECT_NE(empty.error().message.find("no frame"), std::string::npos);
}

TEST_F(Replay, DamagedPictureEndsThePlayWithFileAndLine) {
  keep({makeFrame(PixelFormat::kBayerRG12, 0), makeFrame(PixelFormat::kBayerRG12, 1),
        makeFrame(PixelFormat::kBayerRG12, 2)});
  fs::resize_file(folder() / "000001.png", 40);
  ::testing::internal::CaptureStderr();
  const Played cut = play("replay:" + folder().string() + "?rate=0");
  EXPECT_EQ(::testing::internal::GetCapturedStderr(), "");
  EXPECT_EQ(cut.frames.size(), 1u);
  ASSERT_TRUE(cut.end);
  EXPECT_EQ(cut.end->code, ErrorCode::kCorrupt);
  EXPECT_NE(cut.end->message.find("line 3"), std::string::npos) << cut.end->message;
  EXPECT_NE(cut.end->message.find("000001.png"), std::string::npos) << cut.end->message;
}

TEST_F(Replay, PictureThatDoesNotFitItsFormatIsRefused) {
  keep({makeFrame(PixelFormat::kMono16, 0)});  // holds 65535
  std::string text = journal();
  text.replace(text.find("Mono16"), 6, "Mono12");
  setJournal(text);
  const auto tooLarge = openCamera("replay:" + folder().string());
  ASSERT_FALSE(tooLarge);
  EXPECT_NE(tooLarge.error().message.find("more than 12 bits"), std::string::npos)
      << tooLarge.error().message;
  text.replace(text.find("Mono12"), 6, "RGB8");
  setJournal(text);
  EXPECT_FALSE(openCamera("replay:" + folder().string()));
}

TEST_F(Replay, WriterRefusesAUsedFolderAndOneThatCannotBe) {
  keep({makeFrame(PixelFormat::kMono8, 0)});
  EXPECT_FALSE(ReplayWriter::create(folder(), {}));
  EXPECT_FALSE(ReplayWriter::create("/proc/none", {}));
}

TEST(OpenCamera, NamesItsMistakes) {
  for (const std::string address : {"", "replay", "replay:", "usb:1", "replay:/nowhere",
                                    "replay:/tmp?rate=x", "replay:/tmp?rate=-1"}) {
    const auto camera = openCamera(address);
    ASSERT_FALSE(camera) << address;
    EXPECT_FALSE(camera.error().message.empty());
  }
  EXPECT_EQ(openCamera("usb:1").error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(openCamera("replay:/nowhere").error().code, ErrorCode::kNotFound);
}

}  // namespace
}  // namespace lightsketch
