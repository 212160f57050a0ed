// Runs the built program as a script would, in a folder of its own.
#pragma once

#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

namespace lightsketch {

namespace fs = std::filesystem;

struct Outcome {
  int exitCode = -1;
  std::string out;
  std::string error;
};

inline std::string slurp(const fs::path& path) {
  std::ifstream stream(path, std::ios::binary);
  std::ostringstream text;
  text << stream.rdbuf();
  return text.str();
}

// Every entry below a folder, hidden ones included.
inline std::vector<std::string> entriesBelow(const fs::path& folder) {
  std::vector<std::string> names;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    names.push_back(fs::relative(entry.path(), folder).string());
  }
  std::sort(names.begin(), names.end());
  return names;
}

class ProgramTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (fs::temp_directory_path() / "lightsketch-cli-XXXXXX").string();
    ASSERT_NE(::mkdtemp(pattern.data()), nullptr);
    folder_ = pattern;
  }
  void TearDown() override { fs::remove_all(folder_); }

  fs::path path(const std::string& name) const { return folder_ / name; }

  // Runs the program; `fileSizeLimit` in bytes makes larger writes fail as on a full disk.
  Outcome run(const std::vector<std::string>& arguments,
              rlim_t fileSizeLimit = RLIM_INFINITY) const {
    const fs::path out = fs::temp_directory_path() / (folder_.filename().string() + ".out");
    const fs::path error = fs::temp_directory_path() / (folder_.filename().string() + ".err");
    const pid_t child = ::fork();
    if (child == 0) {
      if (!std::freopen(out.c_str(), "w", stdout) || !std::freopen(error.c_str(), "w", stderr)) {
        std::_Exit(126);
      }
      const rlimit limit{fileSizeLimit, fileSizeLimit};
      ::setrlimit(RLIMIT_FSIZE, &limit);
      std::vector<char*> argv{const_cast<char*>(LIGHTSKETCH_BINARY)};
      for (const auto& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
      argv.push_back(nullptr);
      ::execv(LIGHTSKETCH_BINARY, argv.data());
      std::_Exit(127);
    }
    int status = 0;
    ::waitpid(child, &status, 0);
    Outcome outcome;
    outcome.exitCode = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
    outcome.out = slurp(out);
    outcome.error = slurp(error);
    fs::remove(out);
    fs::remove(error);
    return outcome;
  }

  // Exit code 1, one line that mentions `what`, and nothing new in the folder.
  void expectRefusal(const std::vector<std::string>& arguments, const std::string& what,
                     rlim_t fileSizeLimit = RLIM_INFINITY) const {
    const auto before = entriesBelow(folder_);
    const Outcome outcome = run(arguments, fileSizeLimit);
    EXPECT_EQ(outcome.exitCode, 1) << outcome.out << outcome.error;
    EXPECT_EQ(outcome.out, "");
    EXPECT_EQ(std::count(outcome.error.begin(), outcome.error.end(), '\n'), 1) << outcome.error;
    EXPECT_NE(outcome.error.find(what), std::string::npos) << outcome.error;
    EXPECT_EQ(entriesBelow(folder_), before);
  }

  fs::path folder_;
};

}  // namespace lightsketch
