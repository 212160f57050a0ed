#include "pipeline/sketch/lp.h"

#include <gtest/gtest.h>

#include "tests/capture/frame/temporary_folder.h"
#include "tests/pipeline/sketch/samples.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

class LightLists : public testing::Test {
 protected:
  void touch(const std::string& name) {
    fs::create_directories((temporary_ / name).parent_path());
    writeContent(temporary_ / name, "");
  }
  Result<LightList> read(const std::string& lpText) {
    writeContent(temporary_ / "dirs.lp", lpText);
    progress_.warnings.clear();
    return readLightList(temporary_.path(), std::nullopt, std::nullopt, progress_);
  }
  // The complaint must name file and line.
  void expectRefused(const std::string& lpText, int line, const std::string& what) {
    const auto list = read(lpText);
    ASSERT_FALSE(list) << lpText;
    const auto start = (temporary_ / "dirs.lp").string() + ": line " + std::to_string(line) + ": ";
    EXPECT_EQ(list.error().message.rfind(start, 0), 0u) << list.error().message;
    EXPECT_NE(list.error().message.find(what), std::string::npos) << list.error().message;
    EXPECT_EQ(list.error().message.find('\n'), std::string::npos);
  }

  TemporaryFolder temporary_;
  RecordingProgress progress_;
};

TEST_F(LightLists, ReadsNamesAndVectors) {
  touch("a.png");
  touch("b.png");
  const auto list = read("2\na.png 0 0 1\nb.png 0.6 -8e-1 0\n").value();
  ASSERT_EQ(list.entries.size(), 2u);
  EXPECT_EQ(list.entries[0].name, "a.png");
  EXPECT_EQ(list.entries[1].file, temporary_ / "b.png");
  EXPECT_LT((list.entries[1].direction - Eigen::Vector3d(0.6, -0.8, 0)).norm(), 1e-12);
  EXPECT_FALSE(list.entries[1].intensity);
  EXPECT_FALSE(list.diligent);
  EXPECT_TRUE(progress_.warnings.empty());
}

TEST_F(LightLists, ToleratesBomCrlfTabsBlankLinesAndSpaces) {
  touch("a.png");
  touch("b.png");
  const auto list =
      read("\xEF\xBB\xBF 2  \r\n\r\n  a.png\t0  0 +1 \r\nb.png 1 0 0\r\n\r\n   \r\n\n").value();
  ASSERT_EQ(list.entries.size(), 2u);
  EXPECT_EQ(list.entries[0].direction, Eigen::Vector3d::UnitZ());
  EXPECT_TRUE(progress_.warnings.empty());
}

TEST_F(LightLists, NormalisesAndWarnsOnceWithCountAndWorst) {
  touch("a.png");
  touch("b.png");
  touch("c.png");
  const auto list = read("3\na.png 0 0 2\nb.png 0 0.9 0\nc.png 0.6 0 0.8002\n").value();
  EXPECT_EQ(list.entries[0].direction, Eigen::Vector3d::UnitZ());
  EXPECT_EQ(list.entries[1].direction, Eigen::Vector3d::UnitY());
  EXPECT_NEAR(list.entries[2].direction.norm(), 1, 1e-15);
  ASSERT_EQ(progress_.warnings.size(), 1u);
  EXPECT_NE(progress_.warnings[0].find("2 light directions"), std::string::npos);
  EXPECT_NE(progress_.warnings[0].find("worst has 2)"), std::string::npos);
}

TEST_F(LightLists, WarnsAboutAWrongCount) {
  touch("a.png");
  EXPECT_EQ(read("7\na.png 0 0 1\n").value().entries.size(), 1u);
  ASSERT_EQ(progress_.warnings.size(), 1u);
  EXPECT_NE(progress_.warnings[0].find("says 7 lights and lists 1"), std::string::npos);
}

TEST_F(LightLists, SkipsMissingAndRepeatedImagesWithAWarning) {
  touch("a.png");
  const auto list = read("3\nno.png 0 0 1\na.png 1 0 0\na.png 0 1 0\n").value();
  ASSERT_EQ(list.entries.size(), 1u);
  EXPECT_EQ(list.entries[0].direction, Eigen::Vector3d::UnitX());
  EXPECT_EQ(list.skipped, 2);
  ASSERT_EQ(progress_.warnings.size(), 2u);
  EXPECT_NE(progress_.warnings[0].find("line 2: no.png does not exist"), std::string::npos);
  EXPECT_NE(progress_.warnings[1].find("line 4: a.png is listed twice; kept line 3"),
            std::string::npos);
  const auto none = read("1\nno.png 0 0 1\n");
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().code, ErrorCode::kNotFound);
}

TEST_F(LightLists, FindsImagesUnderOtherPeoplesPaths) {
  touch("a.png");
  touch("sub/b.png");
  touch("my photo 1.png");
  const auto list = read(
                        "3\nC:\\Users\\me\\rti set\\a.png 0 0 1\nsub\\b.png 1 0 0\n"
                        "my photo 1.png 0 1 0\n")
                        .value();
  ASSERT_EQ(list.entries.size(), 3u);
  EXPECT_EQ(list.entries[0].file, temporary_ / "a.png");
  EXPECT_EQ(list.entries[1].file, temporary_ / "sub/b.png");
  EXPECT_EQ(list.entries[1].name, "sub/b.png");
  EXPECT_EQ(list.entries[2].name, "my photo 1.png");
  EXPECT_TRUE(progress_.warnings.empty());
}

TEST_F(LightLists, RefusesNonsenseWithFileAndLine) {
  touch("a.png");
  expectRefused("a.png 0 0 1\n", 1, "number of lights");
  expectRefused("-1\na.png 0 0 1\n", 1, "number of lights");
  expectRefused("1\n\na.png 0 zero 1\n", 3, "not a number: 'zero'");
  expectRefused("1\na.png 0 0 nan\n", 2, "not a number: 'nan'");
  expectRefused("1\na.png 0 inf 0\n", 2, "not a number: 'inf'");
  expectRefused("1\na.png 0 0 1e999\n", 2, "not a number");
  expectRefused("1\na.png 0 0 1,5\n", 2, "not a number: '1,5'");
  expectRefused("1\na.png 0 0 0\n", 2, "length 0");
  expectRefused("1\na.png 0 1\n", 2, "not a number: 'a.png'");
  expectRefused("1\n0 0 1\n", 2, "an image's name");
  expectRefused("1\na.png\n", 2, "not a number");
  expectRefused(
      "1\na.png 0 0 \x01"
      "7\n",
      2, "'?7'");
  EXPECT_FALSE(read(""));
  EXPECT_FALSE(read("\n \n"));
}

TEST_F(LightLists, EveryTruncationIsReadOrRefusedNeverWrong) {
  touch("a.png");
  touch("b.png");
  const std::string text = "2\na.png 0.6 0 0.8\nb.png 0 1 0\n";
  for (std::size_t size = 0; size < text.size(); ++size) {
    const auto list = read(text.substr(0, size));
    if (!list) continue;
    // What is left of a number can still be a number; the count then tells, or the length does.
    EXPECT_TRUE(list->entries.size() == 2 || !progress_.warnings.empty()) << size;
  }
}

TEST_F(LightLists, ChoosesTheList) {
  touch("a.png");
  writeContent(temporary_ / "x.lp", "1\na.png 1 0 0\n");
  writeContent(temporary_ / "y.lp", "1\na.png 0 1 0\n");
  const auto folder = temporary_.path();
  EXPECT_FALSE(readLightList(folder, std::nullopt, std::nullopt, progress_));
  EXPECT_EQ(readLightList(folder, folder / "y.lp", std::nullopt, progress_)->entries[0].direction,
            Eigen::Vector3d::UnitY());
  writeContent(temporary_ / "dirs.lp", "1\na.png 0 0 1\n");
  EXPECT_EQ(readLightList(folder, std::nullopt, std::nullopt, progress_)->entries[0].direction,
            Eigen::Vector3d::UnitZ());
  EXPECT_EQ(readLightList(folder / "no", std::nullopt, std::nullopt, progress_).error().code,
            ErrorCode::kNotFound);
  EXPECT_EQ(readLightList(folder, folder / "no.lp", std::nullopt, progress_).error().code,
            ErrorCode::kNotFound);
}

TEST_F(LightLists, ReadsDiligentFoldersWithTheirIntensities) {
  touch("001.png");
  touch("002.png");
  const auto folder = temporary_.path();
  const auto list = [&] { return readLightList(folder, std::nullopt, std::nullopt, progress_); };
  EXPECT_FALSE(list());
  writeContent(folder / "filenames.txt", "001.png\r\n002.png\r\n\r\n");
  writeContent(folder / "light_directions.txt", "0 0 1\n-0.6 0 0.8\n");
  ASSERT_TRUE(list());
  EXPECT_TRUE(list()->diligent);
  EXPECT_FALSE(list()->entries[0].intensity);
  writeContent(folder / "light_intensities.txt", "1 2 3\n4 5 6\n");
  EXPECT_EQ(list()->entries[1].intensity, (std::array<double, 3>{4, 5, 6}));
  EXPECT_EQ(list()->entries[1].direction.x(), -0.6);
  writeContent(folder / "light_intensities.txt", "1.5\n2\n");
  EXPECT_EQ(list()->entries[0].intensity, (std::array<double, 3>{1.5, 1.5, 1.5}));

  const auto complaint = [&](const char* file, const char* content) {
    const std::string before = contentOf(folder / file);
    writeContent(folder / file, content);
    const auto result = list();
    writeContent(folder / file, before);
    return result ? std::string("accepted") : result.error().message;
  };
  EXPECT_NE(complaint("light_intensities.txt", "1\n0\n").find("line 2"), std::string::npos);
  EXPECT_NE(complaint("light_intensities.txt", "1 2\n3 4\n").find("line 1"), std::string::npos);
  EXPECT_NE(complaint("light_intensities.txt", "1\n").find("has 1 rows"), std::string::npos);
  EXPECT_NE(complaint("light_directions.txt", "0 0 1\n0 0 x\n").find("line 2"), std::string::npos);
  EXPECT_NE(complaint("light_directions.txt", "0 0 1 5 6\n0 0 1\n").find("line 1"),
            std::string::npos);
  EXPECT_NE(complaint("filenames.txt", "001.png\n").find("names 1 images"), std::string::npos);
}

TEST_F(LightLists, IntensitiesOfAnLpFollowItsLinesEvenPastAMissingImage) {
  touch("b.png");
  writeContent(temporary_ / "dirs.lp", "2\na.png 0 0 1\nb.png 1 0 0\n");
  writeContent(temporary_ / "table.txt", "1\n2\n");
  const auto list =
      readLightList(temporary_.path(), std::nullopt, temporary_ / "table.txt", progress_).value();
  ASSERT_EQ(list.entries.size(), 1u);
  EXPECT_EQ(list.entries[0].intensity, (std::array<double, 3>{2, 2, 2}));
}

TEST_F(LightLists, FormattedListsReadBackExactly) {
  touch("a b.png");
  const Eigen::Vector3d direction = Eigen::Vector3d(1, -2, 3).normalized();
  const NamedDirection entry{"a b.png", direction};
  const auto list = read(formatLp({&entry, 1})).value();
  // Normalising once more may move the last bit.
  EXPECT_LT((list.entries[0].direction - direction).norm(), 1e-15);
}

}  // namespace
}  // namespace lightsketch
