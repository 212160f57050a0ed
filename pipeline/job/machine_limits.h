// What this machine can do, measured when asked: the limits that benchmarks divide by.
#pragma once

#include <filesystem>

#include "capture/frame/result.h"

namespace lightsketch {

// Each takes about a second, uses all cores (unless it says so) and returns the best of many short
// runs, so that what else runs on the machine counts as little as possible.

// Bytes a second of reading from main memory: 512 MiB on huge pages, several streams a core.
double readBandwidth();

// Single-precision operations a second, a fused multiply-add counting as two: independent
// accumulators in registers, in the widest vectors of this processor.
double fmaPeak();

// Bytes a second of pread from the page cache into memory that is already mapped, in pieces of
// 1 MiB. Fails if the file cannot be read.
struct FileReadRate {
  double oneThread = 0;
  double allThreads = 0;
};
Result<FileReadRate> warmFileRead(const std::filesystem::path& file);

}  // namespace lightsketch
