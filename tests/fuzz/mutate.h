// Small changes as a fuzzer makes them, but the same ones every time.
#pragma once

#include <random>
#include <span>
#include <string>

namespace lightsketch::fuzz {

// One of `seeds`, changed at a few places: bits, bytes, runs of bytes, numbers, keywords of the
// formats, pieces of the other seeds.
std::string mutated(std::span<const std::string> seeds, std::span<const std::string> words,
                    std::mt19937& random);

// The strings of a libFuzzer dictionary: name="text with \xAB and \\ and \"".
std::string unescaped(const std::string& dictionaryLine);

}  // namespace lightsketch::fuzz
