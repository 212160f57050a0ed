// Entry points that take any bytes: what a file, a folder or a datagram from elsewhere could hold.
// A target returns whatever it was given; it aborts where a parser breaks its own promise. Run by
// libFuzzer (fuzz_main.cpp) and, over a stored corpus and fixed mutations of it, by CTest.
#pragma once

#include <cstdint>
#include <span>
#include <string_view>

namespace lightsketch::fuzz {

struct Target {
  std::string_view name;                // also its folder in corpus/
  bool (*run)(std::string_view input);  // whether the parser accepted it
  bool container = false;  // the input says what a well-formed HDF5 or EXR file is to hold
};

std::span<const Target> targets();
// Null if there is none of that name.
const Target* findTarget(std::string_view name);

// Containers (containers.cpp): the bytes are choices, none of them gives a good file.
bool runModel(std::string_view input);
bool runExr(std::string_view input);

// Aborts, so that libFuzzer and CTest see it.
void demand(bool holds, const char* what);

}  // namespace lightsketch::fuzz
