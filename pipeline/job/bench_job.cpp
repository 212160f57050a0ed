#include "pipeline/job/bench_job.h"

#include <fcntl.h>
#include <hdf5.h>
#include <libdeflate.h>
#include <tbb/parallel_for.h>
#include <unistd.h>
#include <zlib.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <limits>
#include <memory>
#include <new>
#include <numbers>
#include <random>
#include <stdexcept>
#include <string_view>

#include "capture/frame/descriptor.h"
#include "capture/frame/srgb.h"
#include "pipeline/compress/factorise.h"
#include "pipeline/compress/first_stage.h"
#include "pipeline/compress/packed_code.h"
#include "pipeline/illumination/light_grid.h"
#include "pipeline/job/machine_limits.h"
#include "pipeline/relight/relighter.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

// The paper's setting.
constexpr int kBlockRank = 10;
constexpr int kRank = 200;

double secondsSince(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

// The quickest of as many runs as fit into `budget` seconds, at least three.
template <class Function>
double bestSeconds(double budget, const Function& function) {
  double best = std::numeric_limits<double>::infinity();
  const auto start = Clock::now();
  for (int run = 0; run < 3 || secondsSince(start) < budget; ++run) {
    const auto before = Clock::now();
    function();
    best = std::min(best, secondsSince(before));
  }
  return best;
}

// A file that is gone with the object.
class TemporaryFile {
 public:
  TemporaryFile()
      : path_(fs::temp_directory_path() / fmt::format("lightsketch-bench.{}.lsd", ::getpid())) {}
  ~TemporaryFile() {
    std::error_code ignored;
    fs::remove(path_, ignored);
  }
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;
  const fs::path& path() const { return path_; }

 private:
  fs::path path_;
};

// What all parts have in common: the limits, and where text and figures go.
struct Bench {
  const BenchJob& job;
  Progress& progress;
  double bandwidth = 0;  // bytes/s
  double peak = 0;       // FLOP/s
  std::string text = {};
  Json figures = Json::object();

  template <class... Args>
  void print(fmt::format_string<Args...> format, Args&&... args) {
    fmt::format_to(std::back_inserter(text), format, std::forward<Args>(args)...);
  }
  Result<void> step(std::string_view stage, std::size_t done, std::size_t total) {
    progress.update(stage, done, total);
    if (progress.cancelled()) return failure(ErrorCode::kCancelled, "bench: cancelled");
    return {};
  }
  // Full runs take this long for each figure that is the best of several.
  double budget() const { return job.quick ? 0 : 1.5; }
  LimitEffort effort() const { return job.quick ? LimitEffort::kQuick : LimitEffort::kFull; }
};

struct PictureSize {
  int width, height;
  std::string name() const { return fmt::format("{}x{}", width, height); }
};

// --- Drawing ----------------------------------------------------------------------------------

// Calls put(i) for i of count, each with another number of -1 to 1, most of them small.
template <class Put>
void randomNumbers(std::size_t count, const Put& put) {
  std::uint64_t state = 1;  // of a linear congruential generator (Knuth, MMIX)
  for (std::size_t i = 0; i < count; ++i) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    const auto number = static_cast<float>(static_cast<std::int32_t>(state >> 32)) / 2147483648.0f;
    put(i, number * number * number);
  }
}

// A model of random numbers. Its pictures show nothing, but take as long as any other's to draw;
// packed, its numbers fall with frequency and rank as those of a scene do.
std::shared_ptr<RelightableModel> randomModel(const PictureSize& size, int lights,
                                              Storage storage) {
  auto model = std::make_shared<RelightableModel>();
  model->lights.assign(static_cast<std::size_t>(lights), Eigen::Vector3d::UnitZ());
  model->solidAngles.assign(static_cast<std::size_t>(lights), 1.0 / lights);
  const BlockLayout layout{size.width, size.height, 16};
  std::vector<std::int64_t> blockOffset;
  for (std::int64_t j = 0; j <= layout.blocks(); ++j) blockOffset.push_back(j * kBlockRank);
  const auto rows = static_cast<std::size_t>(blockOffset.back());

  if (storage == Storage::kPacked) {
    auto code = std::make_shared<PackedCode>();
    code->layout = layout;
    code->blockOffset = blockOffset;
    code->rank = kRank;
    code->lights = lights;
    const auto fill = [](PackedCode::Numbers& numbers, std::size_t lines, std::size_t length,
                         float half) {
      numbers.resize(lines * length);
      randomNumbers(numbers.size(), [&](std::size_t i, float number) {
        const float range = 60 * half / (half + static_cast<float>(i / length));
        numbers[i] = foldSign(static_cast<int>(std::lround(range * number)));
      });
    };
    fill(code->E, static_cast<std::size_t>(layout.pixelsPerBlock()), rows, 6);
    fill(code->U, kRank, rows, 20);
    fill(code->V, 3 * kRank, static_cast<std::size_t>(lights), 60);
    code->stepE.assign(rows, 0.01f);
    code->stepU.assign(kRank, 0.1f);
    code->stepV.assign(kRank, 0.1f);
    setPacked(*model, std::move(code));
    return model;
  }

  model->layout = layout;
  model->blockOffset = std::move(blockOffset);
  model->rank = kRank;
  model->storage = storage;
  const auto fill = [](ElementType type, std::int64_t count) {
    StoredFactor factor{FactorValues(type, static_cast<std::size_t>(count)), {}};
    if (type == ElementType::kInt8) {
      const auto values = factor.values.as<std::int8_t>();
      randomNumbers(values.size(), [&](std::size_t i, float number) {
        values[i] = static_cast<std::int8_t>(127 * number);
      });
    } else {
      const auto values = factor.values.as<Eigen::half>();
      randomNumbers(values.size(),
                    [&](std::size_t i, float number) { values[i] = Eigen::half(number); });
    }
    return factor;
  };
  const bool q8 = storage == Storage::kQ8;
  model->E = fill(q8 ? ElementType::kInt8 : ElementType::kFloat16,
                  static_cast<std::int64_t>(rows) * layout.pixelsPerBlock());
  model->U = fill(ElementType::kFloat16, model->panels() * kRank * RelightableModel::kPanelRows);
  model->V = fill(ElementType::kFloat16, std::int64_t{3} * lights * kRank);
  if (q8) model->E.scale.assign(rows, 1.0f / 127);
  return model;
}

// 8-bit sRGB against the exact encoding of the same picture in floats: the largest difference.
int largestLevelError(const Relighter& relighter) {
  const auto& layout = relighter.model().layout;
  RadianceImage linear(layout.width, layout.height, 3);
  relighter.render(linear);
  const auto stride = static_cast<std::size_t>(layout.width) * 4;
  std::vector<std::byte> screen(stride * static_cast<std::size_t>(layout.height));
  relighter.renderBgra8(screen, stride);
  int worst = 0;
  for (std::size_t i = 0; i < linear.size(); ++i) {
    const int drawn = std::to_integer<int>(screen[i / 3 * 4 + 2 - i % 3]);
    worst = std::max(worst, std::abs(srgbEncode8(linear.values()[i]) - drawn));
  }
  return worst;
}

Result<void> benchRender(Bench& bench) {
  const std::vector<PictureSize> sizes =
      bench.job.quick ? std::vector<PictureSize>{{64, 48}, {160, 120}}
                      : std::vector<PictureSize>{{640, 480}, {1920, 1080}, {3840, 2160}};
  const int lights = bench.job.quick ? 64 : 4096;
  bench.print(
      "\nDraw: one picture to 8-bit sRGB, b {}, q {}\n{:<10} {:<4} {:>8} {:>9} {:>9} {:>10} {:>12} "
      "{:>7}\n",
      kBlockRank, kRank, "picture", "", "MB", "ms", "frames/s", "of memory", "of multiply",
      "levels");
  const Storage storages[] = {Storage::kFloat16, Storage::kQ8};
  std::size_t done = 0;
  for (const PictureSize& size : sizes) {
    for (const Storage storage : storages) {
      RETURN_IF_ERROR(bench.step("draw", done++, 2 * sizes.size()));
      const auto model = randomModel(size, lights, storage);
      ASSIGN_OR_RETURN(auto relighter, Relighter::create(model));
      LightIntensities intensities = LightIntensities::Zero(lights, 3);
      intensities.row(17).setConstant(0.05f);
      RETURN_IF_ERROR(relighter.setLight(intensities));
      const auto stride = static_cast<std::size_t>(size.width) * 4;
      FactorValues screen(ElementType::kInt8, stride * static_cast<std::size_t>(size.height));
      const std::span<std::byte> pixels(screen.data(), screen.bytes());
      const double seconds =
          bestSeconds(bench.budget(), [&] { relighter.renderBgra8(pixels, stride); });
      // What has to pass through memory, and what has to be computed: U v and E l, three channels.
      const double bytes =
          static_cast<double>(model->E.values.bytes() + model->U.values.bytes() + screen.bytes());
      const double operations =
          6.0 * static_cast<double>(model->rows()) * (kRank + model->layout.pixelsPerBlock());
      const double ofMemory = bytes / seconds / bench.bandwidth;
      const double ofPeak = operations / seconds / bench.peak;
      const int levels = largestLevelError(relighter);
      bench.print("{:<10} {:<4} {:>8.1f} {:>9.3f} {:>9.0f} {:>10.2f} {:>12.2f} {:>7}\n",
                  size.name(), nameOf(storage), bytes * 1e-6, seconds * 1e3, 1 / seconds, ofMemory,
                  ofPeak, levels);
      Json row = {{"picture", size.name()},
                  {"storage", nameOf(storage)},
                  {"bytes", bytes},
                  {"operations", operations},
                  {"seconds", seconds},
                  {"framesPerSecond", 1 / seconds},
                  {"ofMemoryBandwidth", ofMemory},
                  {"ofMultiplyAddPeak", ofPeak},
                  {"largestLevelError", levels}};
      if (size.width == sizes.front().width) {
        // One light of all, then all of them.
        row["oneLightSeconds"] = bestSeconds(bench.budget() / 4, [&] {
          intensities(19, 0) += 0.001f;
          (void)relighter.setLight(intensities);
        });
        row["allLightsSeconds"] = bestSeconds(bench.budget() / 4, [&] {
          intensities.array() += 0.001f;
          (void)relighter.setLight(intensities);
        });
      }
      bench.figures["render"].push_back(std::move(row));
    }
  }
  const Json& first = bench.figures["render"].front();
  bench.print("light changed, {}: one of {} in {:.2f} us, all in {:.1f} us\n", nameOf(storages[0]),
              lights, first["oneLightSeconds"].get<double>() * 1e6,
              first["allLightsSeconds"].get<double>() * 1e6);
  return {};
}

// --- Loading ----------------------------------------------------------------------------------

// Seconds to inflate the chunks of the model's factors on all cores, as they lie in the file.
struct InflateSeconds {
  double zlib = std::numeric_limits<double>::infinity();        // as libhdf5 does
  double libdeflate = std::numeric_limits<double>::infinity();  // as loadModel does
};

// Calls libhdf5 without the lock that model_file.cpp holds around it: a bench is the only job of
// its process, and no other thread of it is in libhdf5 here.
Result<InflateSeconds> inflateSeconds(const fs::path& path, double budget) {
  struct Chunk {
    std::vector<Bytef> deflated;
    std::size_t bytes;  // inflated
  };
  std::vector<Chunk> chunks;
  const hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDONLY, H5P_DEFAULT);
  if (file < 0) return failure(ErrorCode::kIo, "{}: cannot be opened as HDF5", path.string());
  for (const char* name : {"E", "U", "V"}) {
    const hid_t set = H5Dopen2(file, name, H5P_DEFAULT);
    if (set < 0) continue;
    const hid_t space = H5Dget_space(set);
    const hid_t type = H5Dget_type(set);
    const hid_t properties = H5Dget_create_plist(set);
    hsize_t shape[2] = {0, 0};
    H5Pget_chunk(properties, 2, shape);
    hsize_t count = 0;
    H5Dget_num_chunks(set, space, &count);
    for (hsize_t i = 0; i < count; ++i) {
      hsize_t place[2], size = 0;
      haddr_t address = 0;
      unsigned filters = 0;
      std::uint32_t mask = 0;
      if (H5Dget_chunk_info(set, space, i, place, &filters, &address, &size) < 0) continue;
      Chunk chunk{std::vector<Bytef>(size), shape[0] * shape[1] * H5Tget_size(type)};
      if (H5Dread_chunk(set, H5P_DEFAULT, place, &mask, chunk.deflated.data()) >= 0) {
        chunks.push_back(std::move(chunk));
      }
    }
    H5Pclose(properties);
    H5Tclose(type);
    H5Sclose(space);
    H5Dclose(set);
  }
  H5Fclose(file);
  if (chunks.empty()) {
    return failure(ErrorCode::kCorrupt, "{}: no compressed factors", path.string());
  }
  const auto seconds = [&](auto inflate) {
    return bestSeconds(budget, [&] {
      tbb::parallel_for(std::size_t{0}, chunks.size(), [&](std::size_t i) {
        static thread_local std::vector<Bytef> out;
        out.resize(std::max(out.size(), chunks[i].bytes));
        inflate(chunks[i], out.data());
      });
    });
  };
  return InflateSeconds{
      .zlib = seconds([](const Chunk& chunk, Bytef* out) {
        uLongf written = chunk.bytes;
        ::uncompress(out, &written, chunk.deflated.data(), chunk.deflated.size());
      }),
      .libdeflate = seconds([](const Chunk& chunk, Bytef* out) {
        static thread_local const std::unique_ptr<libdeflate_decompressor,
                                                  decltype(&libdeflate_free_decompressor)>
            inflater{libdeflate_alloc_decompressor(), libdeflate_free_decompressor};
        libdeflate_zlib_decompress(inflater.get(), chunk.deflated.data(), chunk.deflated.size(),
                                   out, chunk.bytes, nullptr);
      })};
}

// Seconds to read a file's bytes from warm cache into fresh memory, which whoever keeps them needs,
// on all cores and large pages.
double readSeconds(const fs::path& path, double budget) {
  const Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  const off_t size = ::lseek(file.get(), 0, SEEK_END);
  const double seconds = bestSeconds(budget, [&] {
    FactorValues memory(ElementType::kInt8, static_cast<std::size_t>(size));
    constexpr off_t kPiece = off_t{1} << 22;
    tbb::parallel_for(off_t{0}, (size + kPiece - 1) / kPiece, [&](off_t piece) {
      for (off_t at = piece * kPiece; at < std::min(size, (piece + 1) * kPiece);) {
        const auto count = static_cast<std::size_t>(std::min(size, (piece + 1) * kPiece) - at);
        const ssize_t read = ::pread(file.get(), memory.data() + at, count, at);
        if (read <= 0) return;
        at += read;
      }
    });
  });
  return seconds;
}

Result<void> benchLoad(Bench& bench) {
  const PictureSize size = bench.job.quick ? PictureSize{160, 120} : PictureSize{3840, 2160};
  const int lights = bench.job.quick ? 64 : 4096;
  bench.print(
      "\nLoad: a {} model from warm cache and draw its first picture\n{:<8} {:>8} {:>9} {:>9} "
      "{:>7}\n",
      size.name(), "", "file MB", "ms", "limit ms", "ratio");
  std::size_t done = 0;
  for (const Storage storage : {Storage::kQ8, Storage::kPacked}) {
    RETURN_IF_ERROR(bench.step("load", done++, 2));
    const bool packed = storage == Storage::kPacked;
    const TemporaryFile file;
    RETURN_IF_ERROR(saveModel(*randomModel(size, lights, storage), file.path()));
    const auto stride = static_cast<std::size_t>(size.width) * 4;
    FactorValues screen(ElementType::kInt8, stride * static_cast<std::size_t>(size.height));
    const std::span<std::byte> pixels(screen.data(), screen.bytes());
    LightIntensities intensities = LightIntensities::Zero(lights, 3);
    intensities.row(17).setConstant(0.05f);
    const auto loadAndDraw = [&]() -> Result<void> {
      ASSIGN_OR_RETURN(auto model, loadModel(file.path()));
      ASSIGN_OR_RETURN(
          auto relighter,
          Relighter::create(std::make_shared<const RelightableModel>(std::move(model))));
      RETURN_IF_ERROR(relighter.setLight(intensities));
      relighter.renderBgra8(pixels, stride);
      return {};
    };
    // By turns, so that both find the machine equally busy.
    constexpr int kTurns = 4;
    const double budget = 2 * bench.budget() / kTurns;
    Result<void> outcome;
    double seconds = std::numeric_limits<double>::infinity();
    double read = seconds;
    InflateSeconds inflate;
    for (int turn = 0; turn < kTurns; ++turn) {
      seconds = std::min(seconds, bestSeconds(budget, [&] { outcome = loadAndDraw(); }));
      RETURN_IF_ERROR(outcome);
      read = std::min(read, readSeconds(file.path(), budget));
      if (!packed) continue;
      ASSIGN_OR_RETURN(const InflateSeconds now, inflateSeconds(file.path(), budget / 2));
      inflate.zlib = std::min(inflate.zlib, now.zlib);
      inflate.libdeflate = std::min(inflate.libdeflate, now.libdeflate);
    }
    std::error_code error;
    const auto bytes = static_cast<double>(fs::file_size(file.path(), error));
    ASSIGN_OR_RETURN(const FileReadRate rate, warmFileRead(file.path(), bench.effort()));
    const double limit = packed ? std::min(inflate.zlib, inflate.libdeflate) : read;
    bench.print("{:<8} {:>8.1f} {:>9.1f} {:>9.1f} {:>7.2f}\n", nameOf(storage), bytes * 1e-6,
                seconds * 1e3, limit * 1e3, seconds / limit);
    if (packed) {
      bench.print("{:<8} inflating by zlib {:.1f} ms, by libdeflate {:.1f}\n", "",
                  inflate.zlib * 1e3, inflate.libdeflate * 1e3);
    }
    bench.figures["load"].push_back({{"picture", size.name()},
                                     {"storage", nameOf(storage)},
                                     {"fileBytes", bytes},
                                     {"seconds", seconds},
                                     {"limit", packed ? "inflate" : "read"},
                                     {"limitSeconds", limit},
                                     {"ratio", seconds / limit},
                                     {"inflateSecondsZlib", inflate.zlib},
                                     {"inflateSecondsLibdeflate", inflate.libdeflate},
                                     {"readBytesPerSecond", rate.allThreads},
                                     {"readBytesPerSecondOneThread", rate.oneThread}});
  }
  return {};
}

// --- Compressing ------------------------------------------------------------------------------

// Pictures that are cheap to compute: bumps, matte with a highlight, and each pixel in shadow from
// one side.
Result<LightStack> bumps(const PictureSize& size, int lights) {
  struct Pixels {
    std::vector<Eigen::Vector3f> normal, shade;
    std::vector<float> albedo;
  };
  const auto pixels = std::make_shared<Pixels>();
  for (int y = 0; y < size.height; ++y) {
    for (int x = 0; x < size.width; ++x) {
      const float u = 40 * static_cast<float>(x) / static_cast<float>(size.width);
      const float v = 30 * static_cast<float>(y) / static_cast<float>(size.height);
      const Eigen::Vector3f normal(std::sin(u + std::cos(v)), std::cos(0.7f * v - u), 1.5f);
      pixels->normal.push_back(normal.normalized());
      pixels->shade.emplace_back(std::cos(2.3f * u), std::sin(1.9f * v + u), 0.5f);
      pixels->albedo.push_back(0.5f + 0.4f * std::sin(5 * u) * std::sin(7 * v));
    }
  }
  // As many as asked for, of the next larger grid.
  ASSIGN_OR_RETURN(const LightGrid grid, LightGrid::create(std::max(lights, 64)));
  auto directions = grid.directions();
  directions.resize(static_cast<std::size_t>(lights));
  return LightStack::of(size.width, size.height, directions, [=](int i) -> Result<RadianceImage> {
    const Eigen::Vector3f light = directions[static_cast<std::size_t>(i)].cast<float>();
    RadianceImage picture(size.width, size.height, 3);
    float* out = picture.data();
    for (std::size_t p = 0; p < pixels->albedo.size(); ++p) {
      const float cosine = std::max(0.0f, pixels->normal[p].dot(light));
      const float c4 = cosine * cosine * cosine * cosine;
      const float highlight = 0.3f * c4 * c4 * c4 * c4;
      const float lit = pixels->shade[p].dot(light) > 0 ? 1.0f : 0.1f;
      *out++ = lit * (pixels->albedo[p] * cosine + highlight);
      *out++ = lit * ((1 - pixels->albedo[p]) * cosine + highlight);
      *out++ = lit * (0.5f * cosine + highlight);
    }
    return picture;
  });
}

// The most memory that the process has held since resetPeakMemory(), bytes; 0 where the system does
// not say.
double peakMemory() {
  std::ifstream status("/proc/self/status");
  for (std::string word; status >> word;) {
    double kibibytes = 0;
    if (word == "VmHWM:" && status >> kibibytes) return 1024 * kibibytes;
  }
  return 0;
}
void resetPeakMemory() { std::ofstream("/proc/self/clear_refs") << 5; }

// Both stages, from pictures that wait as half floats in warm cache.
struct Compression {
  double waitSeconds = 0;  // until they wait there: computed and written
  double stage1Seconds = 0;
  double stage2Seconds = 0;
  double memory = 0;
  // The arithmetic of the symmetric Gram matrices, the projections and the passes over L.
  double gram = 0, projection = 0, passes = 0;
  double bytes = 0;  // of the pictures
  SecondStage second;
  LargeMatrix L;  // if asked for

  double seconds() const { return stage1Seconds + stage2Seconds; }
  // Everything at the multiply-add peak, and the pictures read twice.
  double limit(const Bench& bench) const {
    return (gram + projection + passes) / bench.peak + 2 * bytes / bench.bandwidth;
  }
  double lostDecibels() const { return lostDecibels(second); }
  static double lostDecibels(const SecondStage& stage) {
    return 10 * std::log10(stage.totalEnergy / (stage.totalEnergy - stage.keptEnergy));
  }
};

// The quickest of `runs`, the memory of the first.
Result<Compression> compressed(Bench& bench, const PictureSize& size, int lights, int runs,
                               bool keepL) {
  ASSIGN_OR_RETURN(const LightStack stack, bumps(size, lights));
  const BlockLayout layout{size.width, size.height, 16};
  CompressOptions options;
  options.densify = CompressOptions::kDensifyOff;
  Compression result;
  auto start = Clock::now();
  ASSIGN_OR_RETURN(const ScratchStack scratch,
                   ScratchStack::create(stack, layout, fs::temp_directory_path(), bench.progress));
  result.waitSeconds = secondsSince(start);
  ASSIGN_OR_RETURN(const Densifier densifier,
                   Densifier::create(stack, scratch, layout, options, bench.progress));
  double best = std::numeric_limits<double>::infinity();
  for (int run = 0; run < runs; ++run) {
    resetPeakMemory();
    start = Clock::now();
    ASSIGN_OR_RETURN(FirstStage first, firstStage(scratch, densifier, layout, {.most = kBlockRank},
                                                  options.memoryLimitBytes, bench.progress));
    const double stage1 = secondsSince(start);
    if (keepL && run + 1 == runs) {
      result.L = LargeMatrix(static_cast<std::size_t>(first.L.cols()),
                             static_cast<std::size_t>(first.L.rows()),
                             std::numeric_limits<std::size_t>::max(), {});
      RETURN_IF_ERROR(result.L.append(first.L.data(), static_cast<std::size_t>(first.L.rows())));
    }
    start = Clock::now();
    const auto rank =
        static_cast<int>(std::min<Eigen::Index>({kRank, first.L.rows(), first.L.cols()}));
    ASSIGN_OR_RETURN(result.second, factoriseAll(std::move(first.L), rank, SecondStageMethod::kAuto,
                                                 bench.progress));
    const double stage2 = secondsSince(start);
    if (run == 0) result.memory = peakMemory();
    if (stage1 + stage2 < best) {
      best = stage1 + stage2;
      result.stage1Seconds = stage1;
      result.stage2Seconds = stage2;
    }
  }
  const double blocks = layout.blocks();
  const double p = layout.pixelsPerBlock();
  const double columns = 3.0 * lights;
  result.gram = blocks * p * (p + 1) * columns;
  result.projection = 2 * blocks * kBlockRank * p * columns;
  result.passes = 2 * blocks * kBlockRank * columns * result.second.width * result.second.passes;
  result.bytes = 2 * blocks * p * columns;
  return result;
}

// The paper's job.
Result<void> benchCompress(Bench& bench) {
  const PictureSize size = bench.job.quick ? PictureSize{160, 120} : PictureSize{640, 480};
  const int lights = bench.job.quick ? 256 : 4096;
  ASSIGN_OR_RETURN(Compression job, compressed(bench, size, lights, bench.job.quick ? 1 : 3, true));
  const double limit = job.limit(bench);
  auto start = Clock::now();
  ASSIGN_OR_RETURN(const SecondStage exact,
                   factoriseAll(std::move(job.L), static_cast<int>(job.second.V.rows()),
                                SecondStageMethod::kExact, bench.progress));
  const double exactSeconds = secondsSince(start);
  const double lost = Compression::lostDecibels(exact) - job.lostDecibels();
  bench.print(
      "\nCompress: {}, {} lights, b {}, q {}, from half floats in warm cache\n"
      "{:<13} {:>8.2f} s  limit {:.2f} s: Gram matrices {:.2f}, projection {:.2f}, two reads "
      "{:.2f}\n"
      "{:<13} {:>8.2f} s  limit {:.2f} s: {} passes of {} columns\n"
      "{:<13} {:>8.2f} s  limit {:.2f} s, {:.2f} of it\n"
      "{:<13} {:>8.2f} GB\n"
      "{:<13} {:>8.2f} s  for an exact second stage: {:.0f} times slower, {:.4f} dB better\n",
      size.name(), lights, kBlockRank, kRank, "first stage", job.stage1Seconds,
      (job.gram + job.projection) / bench.peak + 2 * job.bytes / bench.bandwidth,
      job.gram / bench.peak, job.projection / bench.peak, 2 * job.bytes / bench.bandwidth,
      "second stage", job.stage2Seconds, job.passes / bench.peak, job.second.passes,
      job.second.width, "both", job.seconds(), limit, limit / job.seconds(), "resident",
      job.memory * 1e-9, "exact", exactSeconds, exactSeconds / job.stage2Seconds, lost);
  bench.figures["compress"] = {{"picture", size.name()},
                               {"lights", lights},
                               {"waitSeconds", job.waitSeconds},
                               {"stage1Seconds", job.stage1Seconds},
                               {"stage2Seconds", job.stage2Seconds},
                               {"limitSeconds", limit},
                               {"ofLimit", limit / job.seconds()},
                               {"residentBytes", job.memory},
                               {"exactStage2Seconds", exactSeconds},
                               {"exactDecibelsBetter", lost}};
  return {};
}

// --- Growth -----------------------------------------------------------------------------------

struct GrowthPoint {
  double x;
  double seconds;
  double memory;
};

// Two curves in double-logarithmic axes, each beside the line of even growth.
std::string curve(const std::vector<GrowthPoint>& points, double left, const std::string& axis) {
  std::string svg;
  const double decades = 2;
  const auto x = [&](double value) {
    return left + 50 +
           270 * std::log10(value / points.front().x) /
               std::log10(points.back().x / points.front().x);
  };
  const auto y = [&](double ratio) { return 300 - 240 * std::log10(ratio) / decades; };
  const auto line = [&](auto value, const char* style) {
    svg += fmt::format("<path fill='none' {} d='", style);
    for (std::size_t i = 0; i < points.size(); ++i) {
      svg += fmt::format("{}{:.1f} {:.1f}", i == 0 ? 'M' : 'L', x(points[i].x),
                         y(value(points[i]) / value(points.front())));
    }
    svg += "'/>\n";
  };
  line([](const GrowthPoint& p) { return p.x; }, "stroke='#999' stroke-dasharray='4 4'");
  line([](const GrowthPoint& p) { return p.seconds; }, "stroke='#06c' stroke-width='2'");
  line([](const GrowthPoint& p) { return std::max(p.memory, 1.0); },
       "stroke='#c40' stroke-width='2'");
  for (const GrowthPoint& point : points) {
    svg += fmt::format("<text x='{:.1f}' y='330' text-anchor='middle'>{:g}</text>\n", x(point.x),
                       point.x);
  }
  for (int decade = 0; decade <= decades; ++decade) {
    svg += fmt::format(
        "<path d='M{:.1f} {:.1f}h270' stroke='#ddd'/><text x='{:.1f}' y='{:.1f}' "
        "text-anchor='end'>{}</text>\n",
        left + 50, y(std::pow(10, decade)), left + 44, y(std::pow(10, decade)) + 4,
        std::pow(10, decade));
  }
  svg += fmt::format("<text x='{:.1f}' y='352' text-anchor='middle'>{}</text>\n", left + 185, axis);
  const GrowthPoint& last = points.back();
  svg += fmt::format(
      "<text x='{0:.1f}' y='30' fill='#06c'>time, from {1:.2f} to {2:.2f} s</text>\n"
      "<text x='{0:.1f}' y='14' fill='#777'>times the first; dashed: even growth</text>\n"
      "<text x='{0:.1f}' y='46' fill='#c40'>memory, from {3:.0f} to {4:.0f} MB</text>\n",
      left + 60, points.front().seconds, last.seconds, points.front().memory * 1e-6,
      last.memory * 1e-6);
  return svg;
}

Result<void> benchGrowth(Bench& bench) {
  const bool quick = bench.job.quick;
  const PictureSize fixedSize = quick ? PictureSize{64, 48} : PictureSize{320, 240};
  const int fixedLights = quick ? 64 : 512;
  const std::vector<int> lights =
      quick ? std::vector<int>{64, 128} : std::vector<int>{256, 512, 1024, 2048, 4096};
  const std::vector<PictureSize> sizes =
      quick ? std::vector<PictureSize>{{32, 24}, {64, 48}}
            : std::vector<PictureSize>{{160, 120}, {320, 240}, {640, 480}, {1280, 960}};
  std::vector<GrowthPoint> byLights, bySize;
  bench.print("\nCompress: growth\n{:<11} {:>6} {:>9} {:>9}\n", "picture", "n", "seconds", "MB");
  const auto add = [&](const PictureSize& size, int n, double x,
                       std::vector<GrowthPoint>& points) -> Result<void> {
    ASSIGN_OR_RETURN(const Compression compression,
                     compressed(bench, size, n, quick ? 1 : 2, false));
    points.push_back({x, compression.seconds(), compression.memory});
    bench.print("{:<11} {:>6} {:>9.2f} {:>9.0f}\n", size.name(), n, compression.seconds(),
                compression.memory * 1e-6);
    bench.figures["growth"].push_back({{"picture", size.name()},
                                       {"lights", n},
                                       {"seconds", compression.seconds()},
                                       {"residentBytes", compression.memory}});
    return {};
  };
  for (const int n : lights) RETURN_IF_ERROR(add(fixedSize, n, n, byLights));
  for (const PictureSize& size : sizes) {
    RETURN_IF_ERROR(add(size, fixedLights, 1.0 * size.width * size.height, bySize));
  }
  if (bench.job.plot.empty()) return {};
  std::ofstream out(bench.job.plot);
  out << "<svg xmlns='http://www.w3.org/2000/svg' width='760' height='370' "
         "font-family='sans-serif' font-size='12'>\n<rect width='760' height='370' fill='white'/>\n"
      << curve(byLights, 0, fmt::format("lights, {}", fixedSize.name()))
      << curve(bySize, 380, fmt::format("pixels, {} lights", fixedLights)) << "</svg>\n";
  if (!out.flush()) {
    return failure(ErrorCode::kIo, "{}: cannot be written", bench.job.plot.string());
  }
  return {};
}

Result<JobResult> measure(const BenchJob& job, Progress& progress) {
  Bench bench{job, progress};
  RETURN_IF_ERROR(bench.step("limits", 0, 1));
  bench.bandwidth = readBandwidth(bench.effort());
  bench.peak = fmaPeak(bench.effort());
  bench.print("Limits: memory reads {:.1f} GB/s, multiply-add peak {:.0f} GFLOP/s\n",
              bench.bandwidth * 1e-9, bench.peak * 1e-9);
  bench.figures["limits"] = {{"readBytesPerSecond", bench.bandwidth},
                             {"multiplyAddFlopPerSecond", bench.peak}};
  RETURN_IF_ERROR(benchRender(bench));
  RETURN_IF_ERROR(benchLoad(bench));
  RETURN_IF_ERROR(benchCompress(bench));
  RETURN_IF_ERROR(benchGrowth(bench));
  return JobResult{std::move(bench.text), std::move(bench.figures)};
}

}  // namespace

Result<JobResult> benchJob(const BenchJob& job, Progress& progress) {
  // Too little memory, too few threads or no temporary folder are the machine's, not ours.
  try {
    return measure(job, progress);
  } catch (const std::bad_alloc&) {
    return failure(ErrorCode::kIo, "bench: not enough memory; try --quick");
  } catch (const std::logic_error&) {
    throw;  // ours
  } catch (const std::exception& error) {
    return failure(ErrorCode::kIo, "bench: {}", error.what());
  }
}

}  // namespace lightsketch
