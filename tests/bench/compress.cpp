// The paper's job: 4096 lights, 640 x 480 in colour, b = 10, q = 200, against what this machine's
// arithmetic and memory allow, measured in the same run, on a scene with cast shadows and
// highlights.
#include <fmt/core.h>
#include <stdlib.h>
#include <time.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <numeric>
#include <optional>
#include <string>
#include <thread>

#include "capture/frame/time.h"
#include "pipeline/compress/factorise.h"
#include "pipeline/compress/first_stage.h"
#include "pipeline/job/machine_limits.h"
#include "tests/bench/synthetic_set.h"

namespace lightsketch {
namespace {

constexpr std::size_t kMemory = 1'500'000'000;

double secondsSince(TimePoint start) { return toSeconds(Clock::now() - start); }

// Of all threads, divided by the cores: what the work takes where nothing else runs, as long as all
// cores are busy.
double processorSeconds() {
  timespec time{};
  ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
  return (static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec)) /
         std::max(1u, std::thread::hardware_concurrency());
}

// Largest resident set since the last reset, GB.
double peakResident() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (line.rfind("VmHWM:", 0) == 0) return std::stod(line.substr(6)) * 1024e-9;
  }
  return 0;
}
void resetPeak() { std::ofstream("/proc/self/clear_refs") << "5"; }

template <class T>
T orExit(Result<T> result) {
  if (!result) {
    fmt::print(stderr, "bench_compress: {}\n", result.error().message);
    std::exit(1);
  }
  return std::move(*result);
}

// The same numbers again: a stage eats its L.
LargeMatrix copyOf(const LargeMatrix& L) {
  LargeMatrix copy(static_cast<std::size_t>(L.cols()), static_cast<std::size_t>(L.rows()),
                   std::size_t{1} << 40, {});
  orExit(copy.append(L.data(), static_cast<std::size_t>(L.rows())).map([] { return 0; }));
  return copy;
}

struct Figures {
  double scratch = 0;  // seconds: pictures computed and written
  double stage1 = 0;   // seconds, the best of the runs
  double stage2 = 0;
  double processor = 0;  // both, see processorSeconds
  double peak = 0;       // GB, of both stages
  double energy = 0;
  double kept1 = 0;  // energies
  SecondStage second;
  FirstStage first;  // of the last run, without L
  std::optional<LargeMatrix> L;
};

Figures measure(int width, int height, int side, int b, int q, int runs, bool keepL) {
  SilentProgress progress;
  Figures figures;
  const SyntheticScene scene(width, height);
  const LightStack stack = syntheticStack(scene, hemisphereDirections(side));
  const BlockLayout layout{width, height, 16};
  TimePoint start = Clock::now();
  const ScratchStack scratch =
      orExit(ScratchStack::create(stack, layout, std::filesystem::temp_directory_path(), progress));
  figures.scratch = secondsSince(start);
  CompressOptions options;
  options.densify = CompressOptions::kDensifyOff;
  const Densifier densifier = orExit(Densifier::create(stack, scratch, layout, options, progress));
  figures.stage1 = figures.stage2 = figures.processor = 1e9;
  for (int run = 0; run < runs; ++run) {
    resetPeak();
    double processor = processorSeconds();
    start = Clock::now();
    figures.first = orExit(firstStage(scratch, densifier, layout, {.most = b}, kMemory, progress));
    figures.stage1 = std::min(figures.stage1, secondsSince(start));
    processor = processorSeconds() - processor;
    if (keepL && run + 1 == runs) figures.L = copyOf(figures.first.L);
    start = Clock::now();
    processor -= processorSeconds();
    figures.second =
        orExit(factoriseAll(std::move(figures.first.L), q, SecondStageMethod::kAuto, progress));
    figures.stage2 = std::min(figures.stage2, secondsSince(start));
    figures.processor = std::min(figures.processor, processor + processorSeconds());
    if (run == 0) figures.peak = peakResident();
  }
  figures.energy = figures.first.energy;
  figures.kept1 =
      std::accumulate(figures.first.rowEnergy.begin(), figures.first.rowEnergy.end(), 0.0);
  return figures;
}

struct Work {
  double gram = 0;  // operations
  double projection = 0;
  double second = 0;
  double bytes = 0;  // of the captures
  double limit(double flops, double bandwidth) const {
    return (gram + projection + second) / flops + 2 * bytes / bandwidth;
  }
};

Work workOf(int width, int height, int lights, int b, const SecondStage& second) {
  const double m = std::ceil(width / 16.0) * std::ceil(height / 16.0);
  const double p = 256;
  const double columns = 3.0 * lights;
  return {.gram = m * p * (p + 1) * columns,
          .projection = 2 * m * b * p * columns,
          .second = 2 * m * b * columns * second.width * second.passes,
          .bytes = 2 * m * p * columns};
}

double decibels(double lost, double energy) { return 10 * std::log10(energy / lost); }

void paperJob(bool exact) {
  constexpr int kWidth = 640;
  constexpr int kHeight = 480;
  constexpr int kSide = 64;
  constexpr int kRank = 10;
  constexpr int kQ = 200;
  fmt::print("{} lights, {} x {}, colour, half floats in warm cache, b = {}, q = {}\n",
             kSide * kSide, kWidth, kHeight, kRank, kQ);
  Figures figures = measure(kWidth, kHeight, kSide, kRank, kQ, 3, exact);
  const double flops = fmaPeak();
  const double bandwidth = readBandwidth();
  const Work work = workOf(kWidth, kHeight, kSide * kSide, kRank, figures.second);
  const double limit = work.limit(flops, bandwidth);
  const double seconds = figures.stage1 + figures.stage2;
  fmt::print("machine         {:.0f} GFLOP/s multiply-add, {:.1f} GB/s read\n", flops / 1e9,
             bandwidth / 1e9);
  fmt::print("pictures        computed, decoded and written in {:.1f} s\n", figures.scratch);
  fmt::print("first stage     {:.2f} s; limit {:.2f} Gram + {:.2f} projection + {:.2f} two reads\n",
             figures.stage1, work.gram / flops, work.projection / flops,
             2 * work.bytes / bandwidth);
  fmt::print("second stage    {:.2f} s; limit {:.2f} ({} passes of {} columns)\n", figures.stage2,
             work.second / flops, figures.second.passes, figures.second.width);
  fmt::print("both            {:.2f} s, limit {:.2f} s: {:.2f} of the limit (bar 0.5, aim 0.7)\n",
             seconds, limit, limit / seconds);
  fmt::print("processor       {:.2f} s a core: {:.2f} of the limit, were nothing else running\n",
             figures.processor, limit / figures.processor);
  fmt::print("peak resident   {:.2f} GB (bar 1.5)\n", figures.peak);
  fmt::print(
      "kept            {:.4f} dB after the first stage, {:.4f} dB after the second alone\n",
      decibels(figures.energy - figures.kept1, figures.energy),
      decibels(figures.second.totalEnergy - figures.second.keptEnergy, figures.second.totalEnergy));
  if (!exact) return;
  SilentProgress progress;
  const TimePoint start = Clock::now();
  const SecondStage best =
      orExit(factoriseAll(std::move(*figures.L), kQ, SecondStageMethod::kExact, progress));
  const double exactSeconds = secondsSince(start);
  fmt::print(
      "exact           {:.1f} s: {:.0f} times slower (bar 20), {:.4f} dB better (bar 0.03)\n",
      exactSeconds, exactSeconds / figures.stage2,
      decibels(best.totalEnergy - best.keptEnergy, best.totalEnergy) -
          decibels(figures.second.totalEnergy - figures.second.keptEnergy,
                   figures.second.totalEnergy));
}

}  // namespace
}  // namespace lightsketch

int main(int argc, char** argv) {
  const std::string what = argc > 1 ? argv[1] : "";
  if (what.empty() || what == "quick") {
    lightsketch::paperJob(what.empty());
  } else {
    fmt::print(stderr, "bench_compress [quick]   quick: without the exact second stage\n");
    return 2;
  }
  return 0;
}
