#include "pipeline/job/machine_limits.h"

#include <fcntl.h>
#include <tbb/info.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <barrier>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <limits>
#include <thread>
#include <vector>

#include "capture/frame/descriptor.h"
#include "capture/frame/file.h"
#include "pipeline/compress/factor_values.h"

// Compiled once for every instruction set; Highway picks one when the program runs.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "pipeline/job/machine_limits.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace lightsketch::HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

// The sum of `count` floats (a multiple of 4 x 64), read as four streams side by side: more than
// one lets the prefetchers run ahead in several pages.
float sumOf(const float* values, std::size_t count) {
  const hn::ScalableTag<float> d;
  const std::size_t quarter = count / 4;
  auto a = hn::Zero(d);
  auto b = hn::Zero(d);
  auto c = hn::Zero(d);
  auto e = hn::Zero(d);
  for (std::size_t i = 0; i < quarter; i += hn::Lanes(d)) {
    a = hn::Add(a, hn::Load(d, values + i));
    b = hn::Add(b, hn::Load(d, values + quarter + i));
    c = hn::Add(c, hn::Load(d, values + 2 * quarter + i));
    e = hn::Add(e, hn::Load(d, values + 3 * quarter + i));
  }
  return hn::GetLane(hn::SumOfLanes(d, hn::Add(hn::Add(a, b), hn::Add(c, e))));
}

// `rounds` times twelve fused multiply-adds that do not wait for each other: more than the latency
// of four cycles times two units that today's processors have. Returns how many operations.
double multiplyAdd(long rounds, float factor, float& result) {
  const hn::ScalableTag<float> d;
  const auto x = hn::Set(d, factor);
  auto a = hn::Iota(d, 0), b = hn::Iota(d, 1), c = hn::Iota(d, 2), e = hn::Iota(d, 3);
  auto f = hn::Iota(d, 4), g = hn::Iota(d, 5), h = hn::Iota(d, 6), i = hn::Iota(d, 7);
  auto j = hn::Iota(d, 8), k = hn::Iota(d, 9), l = hn::Iota(d, 10), m = hn::Iota(d, 11);
  for (long round = 0; round < rounds; ++round) {
    a = hn::MulAdd(a, x, x), b = hn::MulAdd(b, x, x), c = hn::MulAdd(c, x, x);
    e = hn::MulAdd(e, x, x), f = hn::MulAdd(f, x, x), g = hn::MulAdd(g, x, x);
    h = hn::MulAdd(h, x, x), i = hn::MulAdd(i, x, x), j = hn::MulAdd(j, x, x);
    k = hn::MulAdd(k, x, x), l = hn::MulAdd(l, x, x), m = hn::MulAdd(m, x, x);
  }
  const auto sum = hn::Add(
      hn::Add(hn::Add(a, b), hn::Add(c, e)),
      hn::Add(hn::Add(hn::Add(f, g), hn::Add(h, i)), hn::Add(hn::Add(j, k), hn::Add(l, m))));
  result = hn::GetLane(hn::SumOfLanes(d, sum));
  return 2.0 * 12.0 * static_cast<double>(hn::Lanes(d)) * static_cast<double>(rounds);
}

}  // namespace lightsketch::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lightsketch {
namespace {

HWY_EXPORT(sumOf);
HWY_EXPORT(multiplyAdd);

using Seconds = std::chrono::duration<double>;
using Clock = std::chrono::steady_clock;

// Keeps results alive that nobody asks for.
std::atomic<float> sink;

struct Timing {
  double seconds = std::numeric_limits<double>::infinity();
  int threads = 1;  // that took part
};

// The best of `repeats` runs of work(thread, threads) on `wanted` threads at once, or on as many as
// the system grants. `work` must not throw.
template <class Work>
Timing bestTiming(int wanted, int repeats, const Work& work) {
  Timing timing;  // written by thread 0 only; `threads` before the others pass the barrier
  std::barrier together(wanted);
  const auto run = [&](int thread) {
    for (int repeat = 0; repeat < repeats; ++repeat) {
      together.arrive_and_wait();
      const auto start = Clock::now();
      work(thread, timing.threads);
      together.arrive_and_wait();
      if (thread == 0)
        timing.seconds = std::min(timing.seconds, Seconds(Clock::now() - start).count());
    }
  };
  std::vector<std::jthread> others;
  others.reserve(static_cast<std::size_t>(wanted));
  try {
    for (; timing.threads < wanted; ++timing.threads) others.emplace_back(run, timing.threads);
  } catch (const std::exception&) {
    // Nobody waits at the barrier for threads that do not exist.
    for (int missing = timing.threads; missing < wanted; ++missing) together.arrive_and_drop();
  }
  run(0);
  others.clear();
  return timing;
}

}  // namespace

double readBandwidth(LimitEffort effort) {
  const bool full = effort == LimitEffort::kFull;
  const auto wanted = static_cast<std::size_t>(tbb::info::default_concurrency());
  constexpr std::size_t kStep = 256;  // floats; what sumOf wants
  const std::size_t floats = std::size_t{1} << (full ? 27 : 23);
  const std::size_t perThread = std::max(floats / wanted / kStep, std::size_t{1}) * kStep;
  FactorValues memory(ElementType::kFloat32, perThread * wanted);
  float* const values = memory.as<float>().data();
  // Untouched memory would all be one page of zeros, in the cache.
  const auto partOf = [&](int thread) {
    return values + perThread * static_cast<std::size_t>(thread);
  };
  bestTiming(static_cast<int>(wanted), 1,
             [&](int thread, int) { std::fill_n(partOf(thread), perThread, 1.0f); });
  const Timing best = bestTiming(static_cast<int>(wanted), full ? 40 : 4, [&](int thread, int) {
    sink.store(HWY_DYNAMIC_DISPATCH(sumOf)(partOf(thread), perThread), std::memory_order_relaxed);
  });
  return static_cast<double>(perThread * sizeof(float)) * best.threads / best.seconds;
}

double fmaPeak(LimitEffort effort) {
  const bool full = effort == LimitEffort::kFull;
  volatile float factor = 0.5f;  // not known when compiled; converges to 1
  double operations = 0;
  const Timing best =
      bestTiming(tbb::info::default_concurrency(), full ? 60 : 4, [&](int thread, int) {
        float result = 0;
        const double count =
            HWY_DYNAMIC_DISPATCH(multiplyAdd)(full ? 2'000'000 : 200'000, factor, result);
        sink.store(result, std::memory_order_relaxed);
        if (thread == 0) operations = count;
      });
  return operations * best.threads / best.seconds;
}

Result<FileReadRate> warmFileRead(const std::filesystem::path& file, LimitEffort effort) {
  const Descriptor source(::open(file.c_str(), O_RDONLY | O_CLOEXEC));
  if (!source) {
    return failure(ErrorCode::kIo, "{}: cannot open: {}", file.string(), systemMessage(errno));
  }
  std::error_code error;
  const auto size = std::filesystem::file_size(file, error);
  FactorValues memory(ElementType::kInt8, static_cast<std::size_t>(error ? 0 : size));
  if (memory.count() > 0) std::memset(memory.data(), 1, memory.bytes());
  std::atomic<bool> torn = memory.count() == 0;
  const int repeats = effort == LimitEffort::kFull ? 12 : 3;
  const auto rate = [&](int wanted) {
    const Timing best = bestTiming(wanted, repeats, [&](int thread, int threads) {
      constexpr std::size_t kPiece = std::size_t{1} << 20;
      const auto step = kPiece * static_cast<std::size_t>(threads);
      for (std::size_t at = kPiece * static_cast<std::size_t>(thread); at < memory.bytes();
           at += step) {
        const std::size_t bytes = std::min(kPiece, memory.bytes() - at);
        if (::pread(source.get(), memory.data() + at, bytes, static_cast<off_t>(at)) !=
            static_cast<ssize_t>(bytes)) {
          torn = true;
        }
      }
    });
    return static_cast<double>(memory.bytes()) / best.seconds;
  };
  const FileReadRate result{rate(1), rate(tbb::info::default_concurrency())};
  if (torn) return failure(ErrorCode::kIo, "{}: cannot be read", file.string());
  return result;
}

}  // namespace lightsketch
#endif
