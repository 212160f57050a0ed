// What is left of a damaged sketch, and that repairing it never makes things worse.
#include "pipeline/sketch/sketch_check.h"

#include <gtest/gtest.h>

#include <fstream>
#include <functional>
#include <random>

#include "capture/frame/file.h"
#include "pipeline/sketch/image_file.h"
#include "tests/capture/frame/temporary_folder.h"
#include "tests/faults/in_child.h"
#include "tests/pipeline/sketch/samples.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

constexpr int kWidth = 24;
constexpr int kHeight = 16;
constexpr int kFrames = 6;

RadianceImage image(int seed) { return sampleImage(kWidth, kHeight, seed); }

FrameRecord record(int i) {
  FrameRecord r = sampleRecord(i);
  r.gainDb = 0.5 * i;
  r.lampScale = {1.0 + 0.01 * i, 1, 0.9};
  r.midExposureSeconds = i / 30.0;
  return r;
}

// Kept in memory: a sketch of six frames with an edit, the way it was.
class FaultTornFiles : public testing::Test {
 protected:
  void SetUp() override {
    auto sketch = Sketch::create(folder(), sampleManifest(kWidth, kHeight)).value();
    for (int i = 0; i < kFrames; ++i) ASSERT_TRUE(sketch.append(record(i), image(i)));
    ASSERT_TRUE(sketch.drop(1, "sleeve"));
    ASSERT_TRUE(sketch.writeAmbient(image(99)));
    whole_ = contentOf(journal());
  }

  fs::path folder() const { return temporary_ / "s"; }
  fs::path journal() const { return folder() / "frames.jsonl"; }
  fs::path frame(int i) const { return folder() / fmt::format("frames/{:06}.exr", i); }

  SketchCheck check() {
    auto result = checkSketch(folder(), progress_);
    EXPECT_TRUE(result) << result.error().message;
    return result.value_or(SketchCheck{});
  }
  SketchCheck repair() {
    auto result = repairSketch(folder(), progress_);
    EXPECT_TRUE(result) << result.error().message;
    return result.value_or(SketchCheck{});
  }

  // All frames but those in `lost` are there with their light and picture; a writer goes on.
  void expectUsable(const std::set<int>& lost = {}) {
    EXPECT_TRUE(check().damage.empty());
    {
      const auto sketch = Sketch::open(folder());
      ASSERT_TRUE(sketch) << sketch.error().message;
      ASSERT_GE(static_cast<int>(sketch->frames().size()), kFrames);
      for (int i = 0; i < kFrames; ++i) {
        const FrameRecord& read = sketch->frames()[static_cast<std::size_t>(i)];
        if (lost.contains(i)) {
          EXPECT_TRUE(read.dropped) << i;
          continue;
        }
        EXPECT_EQ(read.light.direction, record(i).light.direction) << i;
        EXPECT_EQ(read.exposureSeconds, record(i).exposureSeconds) << i;
        EXPECT_EQ(read.gainDb, record(i).gainDb) << i;
        EXPECT_EQ(read.lampScale, record(i).lampScale) << i;
        EXPECT_EQ(read.midExposureSeconds, record(i).midExposureSeconds) << i;
        const auto picture = sketch->readFrame(i);
        ASSERT_TRUE(picture) << picture.error().message;
        EXPECT_TRUE(sameValues(*picture, image(i))) << i;
      }
    }
    auto writer = Sketch::openForAppend(folder());
    ASSERT_TRUE(writer) << writer.error().message;
    const auto id = writer->append(record(50), image(50));
    ASSERT_TRUE(id) << id.error().message;
    EXPECT_GE(*id, kFrames);
  }

  void startAgain() {
    fs::remove_all(folder());
    SetUp();
  }

  TemporaryFolder temporary_;
  RecordingProgress progress_;
  std::string whole_;
};

TEST_F(FaultTornFiles, AWholeSketchIsCleanAndNothingIsTouched) {
  const auto found = check();
  EXPECT_TRUE(found.damage.empty());
  EXPECT_TRUE(found.remarks.empty());
  EXPECT_EQ(found.frames, kFrames - 1);
  EXPECT_EQ(found.lines, kFrames + 2);
  EXPECT_TRUE(repair().damage.empty());
  EXPECT_EQ(contentOf(journal()), whole_);
  EXPECT_FALSE(fs::exists(folder() / "frames.jsonl.damaged"));
}

TEST_F(FaultTornFiles, AFlippedBitOfTheJournalIsPutRightExactly) {
  std::mt19937 random(7);
  for (int trial = 0; trial < 25; ++trial) {
    std::string text = whole_;
    std::size_t at = random() % (text.size() - 1);
    // A newline gained or lost makes two damaged lines, or one; see the next test.
    const auto flipped = static_cast<char>(text[at] ^ (1 << (random() % 5)));
    if (text[at] == '\n' || flipped == '\n') continue;
    text[at] = flipped;
    writeContent(journal(), text);
    const auto found = check();
    ASSERT_EQ(found.damage.size(), 1u);
    EXPECT_EQ(found.damage[0].file, "frames.jsonl");
    EXPECT_GT(found.damage[0].line, 0);
    EXPECT_EQ(contentOf(journal()), text) << "check changes nothing";
    EXPECT_FALSE(Sketch::open(folder()));
    ASSERT_EQ(repair().damage.size(), 1u);
    EXPECT_TRUE(contentOf(journal()).starts_with(whole_));
    EXPECT_EQ(contentOf(folder() / "frames.jsonl.damaged"), text);
    fs::remove(folder() / "frames.jsonl.damaged");
  }
}

TEST_F(FaultTornFiles, JournalWithBlocksZeroedOrCutOutKeepsEveryWholeFrame) {
  std::mt19937 random(11);
  for (int trial = 0; trial < 20; ++trial) {
    const std::size_t length = trial % 3 == 0 ? 512 : 1 + random() % 2000;
    const std::size_t at = random() % whole_.size();
    std::string text = whole_;
    if (trial % 2 == 0)
      std::fill_n(text.begin() + static_cast<std::ptrdiff_t>(at),
                  std::min(length, text.size() - at), '\0');
    else
      text.erase(at, length);
    writeContent(journal(), text);
    repair();
    ASSERT_NO_FATAL_FAILURE(expectUsable()) << "trial " << trial << " at " << at;
    startAgain();
  }
}

TEST_F(FaultTornFiles, JournalCutAnywhereKeepsEveryWholeFrame) {
  for (std::size_t size = 0; size < whole_.size(); size += 193) {
    writeContent(journal(), whole_.substr(0, size));
    repair();
    ASSERT_NO_FATAL_FAILURE(expectUsable()) << size;
    startAgain();
  }
}

TEST_F(FaultTornFiles, AWriterRefusesToRemovePicturesWhoseLinesAreLost) {
  const std::size_t third = whole_.find('\n', whole_.find('\n', whole_.find('\n') + 1) + 1) + 1;
  writeContent(journal(), whole_.substr(0, third));
  const auto writer = Sketch::openForAppend(folder());
  ASSERT_FALSE(writer);
  EXPECT_NE(writer.error().message.find("--repair"), std::string::npos) << writer.error().message;
  for (int i = 0; i < kFrames; ++i) EXPECT_TRUE(fs::exists(frame(i))) << i;
}

TEST_F(FaultTornFiles, PicturesCutOrZeroedAreDroppedByAnEventAndTheOthersStay) {
  const std::string good = contentOf(frame(3));
  for (std::size_t size = 0; size < good.size(); size += 211) {
    std::string bad = good.substr(0, size);
    if (size % 2 == 1) bad += std::string(good.size() - size, '\0');
    writeContent(frame(3), bad);
    const auto found = check();
    ASSERT_EQ(found.damage.size(), 1u) << size;
    EXPECT_EQ(found.damage[0].file, "frames/000003.exr");
    EXPECT_EQ(found.frames, kFrames - 2);
    repair();
    EXPECT_TRUE(contentOf(journal()).starts_with(whole_)) << "only an event was added";
    ASSERT_NO_FATAL_FAILURE(expectUsable({3})) << size;
    startAgain();
  }
}

TEST_F(FaultTornFiles, ADroppedFrameComesBackWithACopyOfItsPicture) {
  const std::string good = contentOf(frame(2));
  fs::remove(frame(2));
  repair();
  EXPECT_TRUE(Sketch::open(folder()).value().frames()[2].dropped);
  writeContent(frame(2), good);
  ASSERT_TRUE(Sketch::openForAppend(folder()).value().restore(2));
  expectUsable();
}

TEST_F(FaultTornFiles, WithoutItsJournalASketchIsMadeFromThePictures) {
  fs::remove(journal());
  EXPECT_EQ(repair().recovered, kFrames);
  expectUsable();
}

TEST_F(FaultTornFiles, ALineAndItsPictureLostLeaveADroppedFrame) {
  std::string text = whole_;
  const std::size_t second = text.find('\n') + 1;
  text.erase(second, text.find('\n', second) + 1 - second);
  writeContent(journal(), text);
  writeContent(frame(1), "nothing");
  repair();
  expectUsable({1});
}

TEST_F(FaultTornFiles, TheManifestIsMadeAnewAndWhatIsReplacedStaysBeside) {
  for (const std::string& bad :
       {std::string(), std::string("{\"format\""), std::string(600, '\0')}) {
    writeContent(folder() / "sketch.json", bad);
    EXPECT_EQ(check().damage.size(), 1u);
    repair();
    EXPECT_EQ(contentOf(folder() / "sketch.json.damaged"), bad);
    expectUsable();
    startAgain();
  }
  fs::remove(folder() / "sketch.json");
  repair();
  expectUsable();
}

TEST_F(FaultTornFiles, AmbientPictureRigAndCalibrationAreSetAside) {
  writeContent(folder() / "ambient.exr", "x");
  writeContent(folder() / "rig.json", "{");
  writeContent(folder() / "calibration/lens.json", "{\"format\": \"lightsketch-camera\"}");
  EXPECT_EQ(check().damage.size(), 3u);
  EXPECT_FALSE(Sketch::open(folder()));
  repair();
  for (const char* name : {"ambient.exr", "rig.json", "calibration/lens.json"}) {
    EXPECT_FALSE(fs::exists(folder() / name)) << name;
    EXPECT_TRUE(fs::exists((folder() / name).string() + ".damaged")) << name;
  }
  expectUsable();
}

TEST_F(FaultTornFiles, WhatAKillLeavesIsNoDamage) {
  writeContent(journal(), whole_ + "{\"event\":\"fra");
  writeContent(frame(kFrames), contentOf(frame(0)));
  const auto found = check();
  EXPECT_TRUE(found.damage.empty());
  EXPECT_EQ(found.remarks.size(), 1u);
  expectUsable();
}

TEST_F(FaultTornFiles, ANewerSketchIsLeftAlone) {
  std::string manifest = contentOf(folder() / "sketch.json");
  manifest.replace(manifest.find("\"formatVersion\": 1"), 18, "\"formatVersion\": 2");
  writeContent(folder() / "sketch.json", manifest);
  const auto refused = repairSketch(folder(), progress_);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kUnsupported);
  EXPECT_EQ(contentOf(folder() / "sketch.json"), manifest);
}

// --- Links ---------------------------------------------------------------------------------------

TEST_F(FaultTornFiles, LinksLeadNowhere) {
  const fs::path outside = temporary_ / "outside";
  fs::create_directory(outside);
  writeContent(outside / "000077.exr", contentOf(frame(0)));
  const auto expectRefused = [&](const char* name) {
    for (const auto& open : {Sketch::open, Sketch::openForAppend}) {
      const auto sketch = open(folder());
      ASSERT_FALSE(sketch) << name;
      EXPECT_NE(sketch.error().message.find(name), std::string::npos) << sketch.error().message;
    }
    EXPECT_FALSE(repairSketch(folder(), progress_)) << name;
    EXPECT_TRUE(fs::exists(outside / "000077.exr")) << name;
    startAgain();
  };
  // A writer of a sketch whose frames/ led elsewhere would clear away the pictures there.
  fs::rename(folder() / "frames", outside / "frames");
  fs::create_directory_symlink(outside, folder() / "frames");
  expectRefused("frames");
  for (const char* name : {"sketch.json", "frames.jsonl", "ambient.exr", "lock"}) {
    fs::rename(folder() / name, outside / name);
    fs::create_symlink(outside / name, folder() / name);
    const std::string before = contentOf(outside / name);
    expectRefused(name);
    EXPECT_EQ(contentOf(outside / name), before);
  }
  fs::rename(frame(2), outside / "2.exr");
  fs::create_symlink(outside / "2.exr", frame(2));
  EXPECT_FALSE(Sketch::open(folder()).value().readFrame(2));
  repair();
  EXPECT_TRUE(fs::exists(outside / "2.exr"));
  expectUsable({2});
}

// --- Repair, killed ------------------------------------------------------------------------------

TEST_F(FaultTornFiles, RepairKilledAtAnySystemCallCanBeRepeated) {
  const auto damage = [&] {
    std::string text = whole_;
    std::fill_n(text.begin() + static_cast<std::ptrdiff_t>(text.size() / 3), 300, '\0');
    writeContent(journal(), text);
    writeContent(frame(5), "x");
    writeContent(folder() / "sketch.json", "{");
    writeContent(folder() / "rig.json", "{");
  };
  damage();
  const fs::path damagedCopy = temporary_ / "damaged";
  fs::copy(folder(), damagedCopy, fs::copy_options::recursive);
  int killed = 0;
  for (int call = 1;; ++call) {
    const auto end = dieAtCall(call, [&] {
      SilentProgress silent;
      (void)repairSketch(folder(), silent);
    });
    ASSERT_NE(end, CallOutcome::kBroken);
    repair();
    ASSERT_NO_FATAL_FAILURE(expectUsable({5})) << "killed before call " << call;
    fs::remove_all(folder());
    fs::copy(damagedCopy, folder(), fs::copy_options::recursive);
    if (end == CallOutcome::kFinished) break;
    ++killed;
  }
  EXPECT_GT(killed, 15);
  std::cout << "repair killed before each of its " << killed << " writing system calls\n";
}

}  // namespace
}  // namespace lightsketch
