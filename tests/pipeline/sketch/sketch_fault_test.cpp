// Rows of the fault matrix: whatever the disk does, what a sketch has acknowledged is there, and
// what it has not is not half there.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <cerrno>
#include <iostream>
#include <vector>

#include "pipeline/sketch/sketch.h"
#include "pipeline/sketch/sketch_check.h"
#include "tests/capture/frame/temporary_folder.h"
#include "tests/faults/in_child.h"
#include "tests/pipeline/sketch/samples.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

constexpr int kWidth = 24;
constexpr int kHeight = 16;

RadianceImage image(int seed) { return sampleImage(kWidth, kHeight, seed); }

// Every acknowledged frame is whole; at most one more is there, whole as well.
void expectAcknowledged(const fs::path& folder, int acknowledged) {
  const auto sketch = Sketch::open(folder);
  ASSERT_TRUE(sketch) << sketch.error().message;
  ASSERT_GE(static_cast<int>(sketch->frames().size()), acknowledged);
  ASSERT_LE(static_cast<int>(sketch->frames().size()), acknowledged + 1);
  for (const FrameRecord& record : sketch->frames()) {
    const auto picture = sketch->readFrame(record.id);
    ASSERT_TRUE(picture) << picture.error().message;
    EXPECT_TRUE(sameValues(*picture, image(record.id)));
    EXPECT_EQ(record.light.direction, sampleDirection(record.id));
  }
}

// And recording goes on.
void expectGoesOn(const fs::path& folder) {
  auto writer = Sketch::openForAppend(folder);
  ASSERT_TRUE(writer) << writer.error().message;
  const int next = static_cast<int>(writer->frames().size());
  ASSERT_EQ(writer->append(sampleRecord(next), image(next)).value_or(-1), next);
  SilentProgress progress;
  const auto check = checkSketch(folder, progress);
  ASSERT_TRUE(check) << check.error().message;
  EXPECT_TRUE(check->damage.empty()) << check->damage.front().what;
}

TEST(FaultKilled, AtEverySystemCallOfRecordingLosesNoAcknowledgedFrame) {
  const TemporaryFolder temporary;
  const fs::path folder = temporary / "s";
  int killed = 0;
  for (int call = 1;; ++call) {
    fs::remove_all(folder);
    {
      auto sketch = Sketch::create(folder, sampleManifest(kWidth, kHeight)).value();
      ASSERT_TRUE(sketch.append(sampleRecord(0), image(0)));
    }
    int ends[2];
    ASSERT_EQ(::pipe(ends), 0);
    const auto outcome = dieAtCall(call, [&] {
      auto sketch = Sketch::openForAppend(folder);
      for (int i = 1; sketch && i < 4; ++i) {
        if (!sketch->append(sampleRecord(i), image(i))) ::_exit(1);
        if (::write(ends[1], "x", 1) != 1) ::_exit(1);
        if (i == 2 && (!sketch->drop(0, "sleeve") || !sketch->restore(0))) ::_exit(1);
        if (i == 3 && !sketch->writeAmbient(image(9))) ::_exit(1);
      }
    });
    ::close(ends[1]);
    int acknowledged = 1;
    for (char told = 0; ::read(ends[0], &told, 1) == 1;) ++acknowledged;
    ::close(ends[0]);
    ASSERT_NE(outcome, CallOutcome::kBroken) << "call " << call;
    ASSERT_NO_FATAL_FAILURE(expectAcknowledged(folder, acknowledged)) << "call " << call;
    ASSERT_NO_FATAL_FAILURE(expectGoesOn(folder)) << "call " << call;
    if (outcome == CallOutcome::kFinished) break;
    ++killed;
  }
  EXPECT_GT(killed, 20);  // open, write, fsync, rename, fsync, write, fdatasync a frame
  std::cout << "recording killed at each of its " << killed << " writing system calls\n";
}

TEST(FaultKilled, AtEverySystemCallOfCreatingLeavesASketchOrNone) {
  const TemporaryFolder temporary;
  const fs::path folder = temporary / "s";
  RigGeometry rig;
  rig.sourceCameras.push_back({"source", Eigen::Isometry3d::Identity()});
  int killed = 0;
  for (int call = 1;; ++call) {
    const auto outcome = dieAtCall(
        call, [&] { (void)Sketch::create(folder, sampleManifest(kWidth, kHeight), rig); });
    ASSERT_NE(outcome, CallOutcome::kBroken);
    if (fs::exists(folder)) {
      ASSERT_NO_FATAL_FAILURE(expectAcknowledged(folder, 0)) << "call " << call;
      EXPECT_TRUE(Sketch::open(folder).value().rig());
      ASSERT_NO_FATAL_FAILURE(expectGoesOn(folder)) << "call " << call;
    }
    fs::remove_all(folder);
    if (outcome == CallOutcome::kFinished) break;
    ++killed;
  }
  EXPECT_GT(killed, 8);
}

// A call that fails once (a medium's error) and one that keeps failing until there is room again.
void recordWithErrors(int error, bool once) {
  const TemporaryFolder temporary;
  const fs::path folder = temporary / "s";
  for (int call = 1;; ++call) {
    fs::remove_all(folder);
    auto sketch = Sketch::create(folder, sampleManifest(kWidth, kHeight)).value();
    ASSERT_TRUE(sketch.append(sampleRecord(0), image(0)));
    int acknowledged = 1;
    faultArm(call, once ? -error : error);
    for (int attempt = 0; attempt < 3; ++attempt) {
      const auto id = sketch.append(sampleRecord(acknowledged), image(acknowledged));
      if (id) {
        EXPECT_EQ(*id, acknowledged);
        ++acknowledged;
      } else {
        EXPECT_NE(id.error().message.find(folder.string()), std::string::npos)
            << id.error().message;
      }
    }
    const int calls = faultCalls();
    faultDisarm();
    // Unless the journal could not even be cut back, the same writer goes on.
    if (const auto id = sketch.append(sampleRecord(acknowledged), image(acknowledged))) {
      EXPECT_EQ(*id, acknowledged);
      ++acknowledged;
    }
    sketch = Sketch::open(folder).value();  // gives the lock back
    ASSERT_NO_FATAL_FAILURE(expectAcknowledged(folder, acknowledged)) << "call " << call;
    ASSERT_NO_FATAL_FAILURE(expectGoesOn(folder)) << "call " << call;
    if (calls < call) break;
  }
}

TEST(FaultDiskFull, AtAnySystemCallLosesNoAcknowledgedFrame) { recordWithErrors(ENOSPC, false); }
TEST(FaultMediumError, AtAnySystemCallLosesNoAcknowledgedFrame) { recordWithErrors(EIO, true); }
TEST(FaultReadOnly, BecomingSoAtAnySystemCallLosesNoAcknowledgedFrame) {
  recordWithErrors(EROFS, false);
}

TEST(FaultFileHandles, RunningOutIsSaidAndRecordingGoesOnAfterwards) {
  const TemporaryFolder temporary;
  const fs::path folder = temporary / "s";
  auto sketch = Sketch::create(folder, sampleManifest(kWidth, kHeight)).value();
  ASSERT_TRUE(sketch.append(sampleRecord(0), image(0)));
  // Take all that there are.
  rlimit before{};
  ::getrlimit(RLIMIT_NOFILE, &before);
  const rlimit few{64, before.rlim_max};
  ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &few), 0);
  std::vector<int> taken;
  for (int fd = ::open("/dev/null", O_RDONLY); fd >= 0; fd = ::open("/dev/null", O_RDONLY))
    taken.push_back(fd);
  const auto refused = sketch.append(sampleRecord(1), image(1));
  const auto reader = Sketch::open(folder);
  SilentProgress progress;
  const auto check = checkSketch(folder, progress);
  const auto repaired = repairSketch(folder, progress);
  // One handle is enough for the picture, none is left for its folder's sync.
  ::close(taken.back());
  taken.pop_back();
  const auto withOne = sketch.append(sampleRecord(1), image(1));
  for (const int fd : taken) ::close(fd);
  ::setrlimit(RLIMIT_NOFILE, &before);
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().message.find("Too many open files"), std::string::npos)
      << refused.error().message;
  ASSERT_FALSE(reader);
  // A check that cannot read says so, and calls nothing damaged.
  EXPECT_FALSE(check);
  EXPECT_FALSE(repaired);
  const int acknowledged = withOne ? 2 : 1;
  ASSERT_EQ(sketch.append(sampleRecord(acknowledged), image(acknowledged)).value_or(-1),
            acknowledged);
  sketch = Sketch::open(folder).value();
  expectAcknowledged(folder, acknowledged + 1);
  expectGoesOn(folder);
}

TEST(FaultSlowDisk, DelaysAcknowledgementsAndNothingElse) {
  const TemporaryFolder temporary;
  const fs::path folder = temporary / "s";
  auto sketch = Sketch::create(folder, sampleManifest(kWidth, kHeight)).value();
  faultDelay(20'000);
  for (int i = 0; i < 5; ++i) ASSERT_EQ(sketch.append(sampleRecord(i), image(i)).value_or(-1), i);
  faultDisarm();
  sketch = Sketch::open(folder).value();
  expectAcknowledged(folder, 5);
  expectGoesOn(folder);
}

}  // namespace
}  // namespace lightsketch
