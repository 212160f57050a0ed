// What is left when the program, the disk or the rights give out while a sketch is written.
#include <gtest/gtest.h>
#include <sched.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <functional>
#include <iostream>
#include <map>
#include <random>
#include <thread>

#include "pipeline/sketch/sketch.h"
#include "tests/capture/frame/temporary_folder.h"
#include "tests/pipeline/sketch/samples.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

constexpr int kWidth = 48;
constexpr int kHeight = 32;

RadianceImage image(int seed) { return sampleImage(kWidth, kHeight, seed); }

struct Acknowledgement {
  int id;
  int seed;
};

// Appends for ever, telling of every frame it was told is safe.
[[noreturn]] void recordUntilKilled(const fs::path& folder, int pipe, int run) {
  auto sketch = Sketch::openForAppend(folder);
  if (!sketch) ::_exit(3);
  for (int i = 0;; ++i) {
    const int seed = 1000 * run + i;
    const auto id = sketch->append(sampleRecord(seed), image(seed));
    if (!id) ::_exit(4);
    const Acknowledgement told{*id, seed};
    if (::write(pipe, &told, sizeof told) != sizeof told) ::_exit(5);
  }
}

TEST(FaultKilled, AtTwentyRandomMomentsLosesNoAcknowledgedFrame) {
  const TemporaryFolder temporary;
  const fs::path folder = temporary / "s";
  ASSERT_TRUE(Sketch::create(folder, sampleManifest(kWidth, kHeight)));
  std::map<int, int> acknowledged;  // id to seed
  std::mt19937 random(20240611);
  int unacknowledged = 0;
  for (int run = 0; run < 20; ++run) {
    int ends[2];
    ASSERT_EQ(::pipe(ends), 0);
    const pid_t child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) recordUntilKilled(folder, ends[1], run);
    ::close(ends[1]);
    // A random number of frames later, or before the sketch is open, at any point of a frame.
    const auto hear = [&] {
      Acknowledgement told{};
      if (::read(ends[0], &told, sizeof told) != sizeof told) return false;
      EXPECT_TRUE(acknowledged.emplace(told.id, told.seed).second) << "twice: " << told.id;
      return true;
    };
    for (int wait = std::uniform_int_distribution(0, 20)(random); wait > 0; --wait) {
      ASSERT_TRUE(hear());
    }
    std::this_thread::sleep_for(
        std::chrono::microseconds(std::uniform_int_distribution(0, 15'000)(random)));
    ASSERT_EQ(::kill(child, SIGKILL), 0);
    int status = 0;
    ::waitpid(child, &status, 0);
    ASSERT_TRUE(WIFSIGNALED(status)) << "run " << run << " exited " << WEXITSTATUS(status);
    while (hear()) {
    }
    ::close(ends[0]);

    const auto sketch = Sketch::open(folder);
    ASSERT_TRUE(sketch) << "run " << run << ": " << sketch.error().message;
    // Recorded, but killed before it could say so: at most one a run, whole all the same.
    ASSERT_GE(sketch->frames().size(), acknowledged.size());
    ASSERT_LE(sketch->frames().size(), acknowledged.size() + static_cast<std::size_t>(run) + 1);
    unacknowledged = static_cast<int>(sketch->frames().size() - acknowledged.size());
  }
  const auto sketch = Sketch::open(folder).value();
  for (const auto& record : sketch.frames()) {
    const auto read = sketch.readFrame(record.id);
    ASSERT_TRUE(read) << read.error().message;
    const auto told = acknowledged.find(record.id);
    if (told == acknowledged.end()) continue;
    EXPECT_EQ(record.light.direction, sampleDirection(told->second));
    EXPECT_TRUE(sameValues(*read, image(told->second))) << record.id;
  }
  EXPECT_GT(acknowledged.size(), 20u);
  std::cout << "20 kills: " << acknowledged.size() << " frames acknowledged, all there and intact; "
            << unacknowledged << " more were whole but not yet acknowledged\n";

  auto writer = Sketch::openForAppend(folder).value();
  EXPECT_EQ(writer.append(sampleRecord(0), image(0)).value(),
            static_cast<int>(sketch.frames().size()));
}

// Appends until it fails, then checks that nothing was lost and, given room, that it goes on.
// Returns what is wrong, empty if nothing.
std::string fillUp(const fs::path& folder, const std::function<void()>& makeRoom) {
  auto sketch = Sketch::create(folder, sampleManifest(kWidth, kHeight));
  if (!sketch) return "create: " + sketch.error().message;
  int count = 0;
  std::string complaint;
  for (; count < 1000; ++count) {
    const auto id = sketch->append(sampleRecord(count), image(count));
    if (!id) {
      complaint = id.error().message;
      break;
    }
  }
  if (complaint.empty() || count < 3)
    return "expected it to fill up, wrote " + std::to_string(count);
  if (complaint.find(folder.string()) == complaint.npos) return "no file named: " + complaint;

  const auto check = [&](int frames) -> std::string {
    const auto reader = Sketch::open(folder);
    if (!reader) return "reopen: " + reader.error().message;
    if (static_cast<int>(reader->frames().size()) != frames) return "frames lost or made up";
    for (int i = 0; i < frames; ++i) {
      const auto read = reader->readFrame(i);
      if (!read) return read.error().message;
      if (!sameValues(*read, image(i))) return "frame changed";
    }
    if (entriesIn(folder / "frames") != frames) return "a partial file is left in frames/";
    if (contentOf(folder / "frames.jsonl").back() != '\n') return "half a line is left";
    return "";
  };
  if (auto problem = check(count); !problem.empty()) return "full: " + problem;
  makeRoom();
  const auto id = sketch->append(sampleRecord(count), image(count));
  if (!id) return "with room again: " + id.error().message;
  if (*id != count) return "id was not reused";
  return check(count + 1);
}

TEST(FaultDiskFull, AFileSizeLimitInTheMiddleOfAJournalLineIsTakenBack) {
  const TemporaryFolder temporary;
  rlimit before{};
  ::getrlimit(RLIMIT_FSIZE, &before);
  const auto handler = std::signal(SIGXFSZ, SIG_IGN);
  // Larger than any image here, so it is the journal that hits the limit, within a line.
  const rlimit tight{16'000, before.rlim_max};
  ASSERT_EQ(::setrlimit(RLIMIT_FSIZE, &tight), 0);
  const auto problem = fillUp(temporary / "s", [&] { ::setrlimit(RLIMIT_FSIZE, &before); });
  ::setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, handler);
  EXPECT_EQ(problem, "");
}

void writeText(const char* path, const std::string& text) { std::ofstream(path) << text; }

TEST(FaultDiskFull, AFullFileSystemLosesNothing) {
  const TemporaryFolder temporary;
  const fs::path mountPoint = temporary / "small";
  fs::create_directory(mountPoint);
  int ends[2];
  ASSERT_EQ(::pipe(ends), 0);
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    // A name space of its own, so that anybody may mount and nobody else sees it.
    const auto user = ::getuid();
    const auto group = ::getgid();
    if (::unshare(CLONE_NEWUSER | CLONE_NEWNS) != 0) ::_exit(77);
    writeText("/proc/self/setgroups", "deny");
    writeText("/proc/self/uid_map", "0 " + std::to_string(user) + " 1");
    writeText("/proc/self/gid_map", "0 " + std::to_string(group) + " 1");
    if (::mount("tmpfs", mountPoint.c_str(), "tmpfs", 0, "size=300k") != 0) ::_exit(77);
    writeContent(mountPoint / "ballast", std::string(60'000, 'x'));
    const std::string problem =
        fillUp(mountPoint / "s", [&] { fs::remove(mountPoint / "ballast"); });
    if (::write(ends[1], problem.data(), problem.size()) < 0) ::_exit(1);
    ::_exit(0);
  }
  ::close(ends[1]);
  std::string problem(4096, '\0');
  const ssize_t size = ::read(ends[0], problem.data(), problem.size());
  problem.resize(size > 0 ? static_cast<std::size_t>(size) : 0);
  ::close(ends[0]);
  int status = 0;
  ::waitpid(child, &status, 0);
  if (WIFEXITED(status) && WEXITSTATUS(status) == 77) {
    GTEST_SKIP() << "mounting a small file system is not allowed here";
  }
  EXPECT_EQ(status, 0);
  EXPECT_EQ(problem, "");
}

TEST(FaultReadOnly, AFolderWithoutRightsIsRefusedForWritingAndReadable) {
  if (::geteuid() == 0) GTEST_SKIP() << "root may write everywhere";
  const TemporaryFolder temporary;
  const fs::path folder = temporary / "s";
  {
    auto sketch = Sketch::create(folder, sampleManifest(kWidth, kHeight)).value();
    ASSERT_TRUE(sketch.append(sampleRecord(0), image(0)));
  }
  fs::remove(folder / "lock");
  fs::permissions(folder, fs::perms::owner_read | fs::perms::owner_exec);
  const auto writer = Sketch::openForAppend(folder);
  const auto reader = Sketch::open(folder);
  const auto created = Sketch::create(folder / "inner", sampleManifest(kWidth, kHeight));
  fs::permissions(folder, fs::perms::owner_all);
  ASSERT_FALSE(writer);
  EXPECT_NE(writer.error().message.find("Permission denied"), std::string::npos);
  EXPECT_FALSE(created);
  ASSERT_TRUE(reader);
  EXPECT_TRUE(reader->readFrame(0));
}

}  // namespace
}  // namespace lightsketch
