#include "tests/fuzz/mutate.h"

#include <algorithm>
#include <cstdlib>

namespace lightsketch::fuzz {
namespace {

std::size_t below(std::size_t end, std::mt19937& random) { return end == 0 ? 0 : random() % end; }

}  // namespace

std::string mutated(std::span<const std::string> seeds, std::span<const std::string> words,
                    std::mt19937& random) {
  constexpr std::size_t kLargest = 1 << 14;
  constexpr const char* kNumbers[] = {"0",
                                      "-1",
                                      "1e999",
                                      "-0.0",
                                      "nan",
                                      "1e-320",
                                      "65536",
                                      "1e30",
                                      "4294967296",
                                      "-2147483649",
                                      "1e",
                                      "0x10",
                                      "18446744073709551616"};
  std::string text = seeds[below(seeds.size(), random)];
  for (std::size_t changes = 1 + below(4, random); changes > 0; --changes) {
    const std::size_t at = below(text.size() + 1, random);
    const std::size_t length = std::min(text.size() - at, 1 + below(16, random));
    switch (below(8, random)) {
      case 0:
        if (at < text.size()) text[at] = static_cast<char>(text[at] ^ (1 << below(8, random)));
        break;
      case 1:
        if (at < text.size()) text[at] = static_cast<char>(random());
        break;
      case 2:
        text.erase(at, length);
        break;
      case 3:
        text.insert(at, text.substr(at, length));
        break;
      case 4:
        text.insert(at, words[below(words.size(), random)]);
        break;
      case 5: {  // a number in place of one
        const auto digit = text.find_first_of("0123456789", at);
        if (digit == text.npos) break;
        const auto end = text.find_first_not_of("0123456789.eE+-", digit);
        text.replace(digit, std::min(end, text.size()) - digit,
                     kNumbers[below(std::size(kNumbers), random)]);
        break;
      }
      case 6: {
        const std::string& other = seeds[below(seeds.size(), random)];
        const std::size_t from = below(other.size() + 1, random);
        text.replace(at, length, other.substr(from, below(64, random)));
        break;
      }
      default:
        text.resize(at);
    }
  }
  text.resize(std::min(text.size(), kLargest));
  return text;
}

std::string unescaped(const std::string& dictionaryLine) {
  const auto first = dictionaryLine.find('"');
  const auto last = dictionaryLine.rfind('"');
  std::string word;
  if (first == last) return word;
  for (std::size_t i = first + 1; i < last; ++i) {
    if (dictionaryLine[i] != '\\') {
      word += dictionaryLine[i];
    } else if (dictionaryLine[i + 1] == 'x') {
      word += static_cast<char>(std::strtol(dictionaryLine.substr(i + 2, 2).c_str(), nullptr, 16));
      i += 3;
    } else {
      word += dictionaryLine[++i];
    }
  }
  return word;
}

}  // namespace lightsketch::fuzz
