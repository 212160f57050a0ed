// What this machine can do, measured when asked: the limits that benchmarks divide by.
#pragma once

#include <filesystem>

#include "capture/frame/result.h"

namespace lightsketch {

// kFull takes about a second each; kQuick far less, on a busy machine too, and says no more than
// that it works.
enum class LimitEffort { kFull, kQuick };

// Each uses all cores (unless it says so) and returns the best of many short runs, so that what
// else runs on the machine counts as little as possible. Where the system refuses a thread, the
// others measure without it. Throw std::bad_alloc.

// Bytes a second of reading from main memory: 512 MiB on huge pages (kQuick: 32 MiB, which a cache
// may hold), several streams a core.
double readBandwidth(LimitEffort effort = LimitEffort::kFull);

// Single-precision operations a second, a fused multiply-add counting as two: independent
// accumulators in registers, in the widest vectors of this processor.
double fmaPeak(LimitEffort effort = LimitEffort::kFull);

// Bytes a second of pread from the page cache into memory that is already mapped, in pieces of
// 1 MiB. Fails if the file cannot be read.
struct FileReadRate {
  double oneThread = 0;
  double allThreads = 0;
};
Result<FileReadRate> warmFileRead(const std::filesystem::path& file,
                                  LimitEffort effort = LimitEffort::kFull);

}  // namespace lightsketch
