// The stored corpus and fixed mutations of it through the fuzzers' entry points, so that every test
// run feeds the parsers hostile input without clang. A crash or a broken promise ends the program.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <ostream>
#include <random>
#include <string>
#include <vector>

#include "tests/fuzz/mutate.h"
#include "tests/fuzz/targets.h"

namespace lightsketch::fuzz {

// How GoogleTest names it.
static void PrintTo(const Target& target, std::ostream* out) { *out << target.name; }

namespace {

namespace fs = std::filesystem;

const fs::path kFolder = fs::path(LIGHTSKETCH_SOURCE_DIR) / "tests/fuzz";

std::vector<std::string> corpusOf(std::string_view target) {
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(kFolder / "corpus" / target))
    files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  std::vector<std::string> seeds;
  for (const fs::path& file : files) {
    std::ifstream stream(file, std::ios::binary);
    seeds.emplace_back(std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>());
  }
  return seeds;
}

std::vector<std::string> dictionary() {
  std::vector<std::string> words;
  std::ifstream file(kFolder / "words.dict");
  for (std::string line; std::getline(file, line);) {
    if (!line.empty() && line[0] != '#') words.push_back(unescaped(line));
  }
  return words;
}

class FuzzCorpus : public testing::TestWithParam<Target> {};

TEST_P(FuzzCorpus, AndItsMutationsBreakNothing) {
  const Target& target = GetParam();
  const auto seeds = corpusOf(target.name);
  const auto words = dictionary();
  ASSERT_FALSE(seeds.empty()) << target.name;
  ASSERT_FALSE(words.empty());
  std::size_t accepted = 0;
  for (const std::string& seed : seeds) accepted += target.run(seed);
  EXPECT_GT(accepted, 0u) << "no seed of " << target.name << " gets past its first check";
  const int count = target.name == "camera_conversion" ? 20 : target.container ? 1000 : 4000;
  std::mt19937 random(20040611);
  for (int i = 0; i < count; ++i) {
    const std::string input = mutated(seeds, words, random);
    target.run(input);
  }
}

INSTANTIATE_TEST_SUITE_P(, FuzzCorpus, testing::ValuesIn(targets().begin(), targets().end()),
                         [](const auto& target) { return std::string(target.param.name); });

TEST(FuzzTargets, EveryCorpusFolderIsATarget) {
  for (const auto& entry : fs::directory_iterator(kFolder / "corpus")) {
    EXPECT_NE(findTarget(entry.path().filename().string()), nullptr) << entry.path();
  }
}

}  // namespace
}  // namespace lightsketch::fuzz
