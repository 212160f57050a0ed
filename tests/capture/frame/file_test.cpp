#include "capture/frame/file.h"

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <csignal>

#include "tests/capture/frame/temporary_folder.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

TEST(WriteFileAtomically, ReplacesTheContentAndLeavesNothingBeside) {
  const TemporaryFolder folder;
  ASSERT_TRUE(writeFileAtomically(folder / "a.txt", "first"));
  ASSERT_TRUE(writeFileAtomically(folder / "a.txt", "second"));
  EXPECT_EQ(contentOf(folder / "a.txt"), "second");
  EXPECT_EQ(entriesIn(folder.path()), 1);
}

TEST(WriteFileAtomically, KeepsTheOldContentWhenTheNewOneDoesNotFit) {
  const TemporaryFolder folder;
  ASSERT_TRUE(writeFileAtomically(folder / "a.txt", "old"));
  rlimit before{};
  ::getrlimit(RLIMIT_FSIZE, &before);
  const auto signal = std::signal(SIGXFSZ, SIG_IGN);
  const rlimit tight{1000, before.rlim_max};
  ::setrlimit(RLIMIT_FSIZE, &tight);
  const auto result = writeFileAtomically(folder / "a.txt", std::string(5000, 'x'));
  ::setrlimit(RLIMIT_FSIZE, &before);
  std::signal(SIGXFSZ, signal);
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kIo);
  EXPECT_NE(result.error().message.find("a.txt: cannot write: File too large"), std::string::npos)
      << result.error().message;
  EXPECT_EQ(contentOf(folder / "a.txt"), "old");
  EXPECT_EQ(entriesIn(folder.path()), 1);
}

TEST(WriteFileAtomically, NamesAFolderThatIsNotThere) {
  const TemporaryFolder folder;
  const auto result = writeFileAtomically(folder / "no" / "a.txt", "x");
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kNotFound);
}

TEST(ReadFile, ReturnsTheBytesAndRefusesFoldersAndTooMuch) {
  const TemporaryFolder folder;
  const std::string content("a\0b\nc", 5);
  writeContent(folder / "a", content);
  EXPECT_EQ(readFile(folder / "a").value(), content);
  EXPECT_EQ(readFile(folder / "a", 4).error().code, ErrorCode::kUnsupported);
  EXPECT_EQ(readFile(folder.path()).error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(readFile(folder / "b").error().code, ErrorCode::kNotFound);
}

TEST(PendingFile, AppearsOnCommitAndVanishesWithoutIt) {
  const TemporaryFolder folder;
  {
    PendingFile pending(folder / "model.lsd");
    EXPECT_EQ(pending.path().extension(), ".lsd");
    EXPECT_EQ(pending.path().parent_path(), folder.path());
    writeContent(pending.path(), "half");
    EXPECT_FALSE(fs::exists(folder / "model.lsd"));
  }
  EXPECT_EQ(entriesIn(folder.path()), 0);

  PendingFile pending(folder / "model.lsd");
  writeContent(pending.path(), "whole");
  ASSERT_TRUE(pending.commit());
  EXPECT_EQ(contentOf(folder / "model.lsd"), "whole");
  EXPECT_EQ(entriesIn(folder.path()), 1);
}

TEST(PendingFile, CommitFailsWhereNothingWasWritten) {
  const TemporaryFolder folder;
  PendingFile pending(folder / "a");
  EXPECT_FALSE(pending.commit());
}

TEST(PendingFolder, AppearsOnCommitAndVanishesWithoutIt) {
  const TemporaryFolder folder;
  {
    auto pending = PendingFolder::create(folder / "out");
    ASSERT_TRUE(pending);
    fs::create_directory(pending->path() / "inner");
    writeContent(pending->path() / "inner" / "a", "x");
    EXPECT_FALSE(fs::exists(folder / "out"));
  }
  EXPECT_EQ(entriesIn(folder.path()), 0);

  auto pending = PendingFolder::create(folder / "out");
  ASSERT_TRUE(pending);
  fs::create_directory(pending->path() / "inner");
  writeContent(pending->path() / "inner" / "a", "x");
  const PendingFolder moved = std::move(*pending);
  EXPECT_TRUE(fs::exists(moved.path()));
}

TEST(PendingFolder, CommitsOntoAnEmptyFolderWithTrailingSlash) {
  const TemporaryFolder folder;
  fs::create_directory(folder / "out");
  auto pending = PendingFolder::create(folder.path().string() + "/out/");
  ASSERT_TRUE(pending);
  writeContent(pending->path() / "a", "x");
  ASSERT_TRUE(pending->commit());
  EXPECT_EQ(contentOf(folder / "out/a"), "x");
  EXPECT_EQ(entriesIn(folder.path()), 1);
}

TEST(PendingFolder, CreatesTheFoldersAboveIt) {
  const TemporaryFolder folder;
  auto pending = PendingFolder::create(folder / "a/b/out");
  ASSERT_TRUE(pending);
  ASSERT_TRUE(pending->commit());
  EXPECT_TRUE(fs::is_directory(folder / "a/b/out"));
}

TEST(PendingFolder, RefusesWhatExistsAndWhatHasNoName) {
  const TemporaryFolder folder;
  fs::create_directory(folder / "full");
  writeContent(folder / "full/a", "x");
  writeContent(folder / "file", "x");
  EXPECT_FALSE(PendingFolder::create(folder / "full"));
  EXPECT_FALSE(PendingFolder::create(folder / "file"));
  EXPECT_FALSE(PendingFolder::create(folder / "file/out"));
  EXPECT_FALSE(PendingFolder::create("."));
  EXPECT_FALSE(PendingFolder::create(""));
  EXPECT_EQ(entriesIn(folder.path()), 2);
}

TEST(Checksum, IsXxh3AndTheSameForFileAndBytes) {
  // XXH3_64bits of nothing, seed 0: published in the xxHash test vectors.
  EXPECT_EQ(checksum(std::string_view()), "2d06800538d394c2");
  const TemporaryFolder folder;
  std::string content(3'000'001, 'a');  // more than one read buffer
  content[1'500'000] = 'b';
  writeContent(folder / "a", content);
  EXPECT_EQ(checksumOfFile(folder / "a").value(), checksum(content));
  content[1'500'000] = 'c';
  EXPECT_NE(checksumOfFile(folder / "a").value(), checksum(content));
  EXPECT_FALSE(checksumOfFile(folder / "b"));
}

}  // namespace
}  // namespace lightsketch
