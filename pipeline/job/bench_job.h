// Measures this machine and the engine on it, everything in one run.
#pragma once

#include <filesystem>

#include "pipeline/job/jobs.h"

namespace lightsketch {

struct BenchJob {
  bool quick = false;          // small pictures and few lights: whether all works, no figures
  std::filesystem::path plot;  // SVG of how time and memory grow; empty: none
};
// Compressing, drawing and loading, each beside the limit that this machine sets it. Takes about
// three minutes, 4 GB of memory and 8 GB in the system's temporary folder, where nothing is left.
Result<JobResult> benchJob(const BenchJob& job, Progress& progress);

}  // namespace lightsketch
