// Enforces who may include whom, from the include lines alone.
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <regex>
#include <set>
#include <string>

namespace {

namespace fs = std::filesystem;

// Each folder's rank: it may include folders of a lower rank and itself, never its neighbours.
const std::map<std::string, int> kRank = {
    {"capture/frame", 0},
    {"calibration/model", 1},
    {"pipeline/sketch", 2},
    {"capture/device", 3},
    {"capture/tracker", 3},
    {"calibration/lens", 3},
    {"calibration/radiometry", 3},
    {"pipeline/hdr", 3},
    {"pipeline/illumination", 3},
    {"capture/rig", 4},
    {"calibration/pose", 4},
    {"capture/session", 4},
    {"pipeline/compress", 4},
    {"pipeline/relight", 5},
    {"pipeline/panorama", 5},
    {"pipeline/validate", 6},
    {"pipeline/job", 7},
    {"ui/cli", 8},
    {"ui/app", 8},
};

std::string folderOf(const std::string& file) {
  const auto first = file.find('/');
  const auto second = file.find('/', first + 1);
  return second == std::string::npos ? std::string() : file.substr(0, second);
}

// Problems of one include line; empty if it is fine.
std::string problemOf(const std::string& includingFile, const std::string& included) {
  const std::string from = folderOf(includingFile);
  const std::string to = folderOf(included);
  if (!kRank.contains(from))
    return includingFile + ": lies in a folder that the rule does not know";
  static const std::regex qt(R"(^(Q[A-Za-z]+|Qt[A-Za-z]+/.*)$)");
  if (std::regex_match(included, qt))
    return from == "ui/app" ? "" : includingFile + ": Qt outside ui/app";
  if (!kRank.contains(to)) return "";  // a library's header
  if (to == from || kRank.at(to) < kRank.at(from)) return "";
  return includingFile + ": may not include " + included;
}

TEST(IncludeRule, HoldsInEveryFile) {
  const fs::path root = LIGHTSKETCH_SOURCE_DIR;
  static const std::regex includeLine(R"rx(^\s*#\s*include\s*[<"]([^>"]+)[>"])rx");
  int files = 0;
  for (const char* top : {"capture", "calibration", "pipeline", "ui"}) {
    for (const auto& entry : fs::recursive_directory_iterator(root / top)) {
      if (entry.path().extension() != ".h" && entry.path().extension() != ".cpp") continue;
      ++files;
      const std::string name = fs::relative(entry.path(), root).generic_string();
      std::ifstream stream(entry.path());
      for (std::string line; std::getline(stream, line);) {
        std::smatch match;
        if (std::regex_search(line, match, includeLine)) {
          EXPECT_EQ(problemOf(name, match[1]), "");
        }
      }
    }
  }
  EXPECT_GT(files, 30);
}

TEST(IncludeRule, CatchesBackwardSidewaysAndQt) {
  EXPECT_NE(problemOf("capture/frame/a.h", "calibration/model/camera_model.h"), "");
  EXPECT_NE(problemOf("capture/tracker/a.h", "capture/device/camera.h"), "");
  EXPECT_NE(problemOf("pipeline/job/a.h", "QWidget"), "");
  EXPECT_NE(problemOf("pipeline/elsewhere/a.h", "vector"), "");
  EXPECT_EQ(problemOf("pipeline/job/a.h", "pipeline/validate/report.h"), "");
  EXPECT_EQ(problemOf("ui/app/a.h", "QWidget"), "");
}

}  // namespace
