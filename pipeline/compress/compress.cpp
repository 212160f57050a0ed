#include "pipeline/compress/compress.h"

#include <cblas.h>
#include <oneapi/tbb/enumerable_thread_specific.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cmath>
#include <exception>
#include <memory>
#include <mutex>
#include <new>
#include <numeric>
#include <optional>
#include <utility>

#include "capture/frame/srgb.h"
#include "capture/frame/time.h"
#include "pipeline/compress/factorise.h"
#include "pipeline/compress/hold_out.h"
#include "pipeline/compress/scratch_stack.h"
#include "pipeline/illumination/light_grid.h"
#include "pipeline/sketch/light_stack.h"

namespace lightsketch {
namespace {

namespace tbb = oneapi::tbb;
using Eigen::MatrixXf;
using Eigen::Vector3d;

constexpr const char* kSoftware = "lightsketch " LIGHTSKETCH_VERSION;
constexpr const char* kStage1 = "first stage";

double secondsSince(TimePoint start) { return toSeconds(Clock::now() - start); }

// Every half float's value, as it is and sRGB-encoded: exact and faster than converting.
class HalfTable {
 public:
  explicit HalfTable(bool encoded) : values_(1 << 16) {
    for (std::size_t bits = 0; bits < values_.size(); ++bits) {
      const auto half = Eigen::numext::bit_cast<Eigen::half>(static_cast<std::uint16_t>(bits));
      const float value = static_cast<float>(half);
      values_[bits] = encoded ? srgbEncode(value) : value;
    }
  }
  float operator[](std::uint16_t bits) const { return values_[bits]; }

 private:
  std::vector<float> values_;
};

// srgbDecode of values from 0, by linear interpolation in a table up to 2 (error below 3e-8).
class SrgbDecoder {
 public:
  SrgbDecoder() : table_(kSteps + 2) {
    for (std::size_t i = 0; i < table_.size(); ++i)
      table_[i] = srgbDecode(static_cast<float>(i) / kScale);
  }
  float operator()(float encoded) const {
    if (!(encoded > 0)) return 0;
    const float position = encoded * kScale;
    if (position >= kSteps) return srgbDecode(encoded);
    const auto index = static_cast<std::size_t>(position);
    return table_[index] +
           (position - static_cast<float>(index)) * (table_[index + 1] - table_[index]);
  }

 private:
  static constexpr std::size_t kSteps = 8192;
  static constexpr float kScale = 4096;
  std::vector<float> table_;
};

// Where the model's lights are and how its pictures come from the captured ones.
struct LightPlan {
  std::vector<Vector3d> lights;
  InterpolationSettings interpolation;  // between the model's lights
  InterpolationSettings captured;       // between the captured ones
  // N x n: picture of each of the model's lights as a sum of captured ones, in the encoded domain.
  // Empty if the model's lights are the captured ones.
  RowMajorMatrixf weights;
  std::string description;
};

// About 4000 values per captured light, from blocks spread over the picture.
Result<MatrixXf> samplesOf(const ScratchStack& scratch, const BlockLayout& layout,
                           const HalfTable& table) {
  constexpr int kBlocks = 32;
  constexpr std::size_t kStep = 7;  // prime to the block's width: all rows, columns and channels
  const int blocks = std::min(kBlocks, layout.blocks());
  std::vector<std::vector<float>> rows(static_cast<std::size_t>(scratch.images()));
  std::vector<std::uint16_t> halfs;
  for (int k = 0; k < blocks; ++k) {
    const int block =
        static_cast<int>((2 * k + 1) * static_cast<std::int64_t>(layout.blocks()) / (2 * blocks));
    RETURN_IF_ERROR(scratch.read(block / layout.columns(), block % layout.columns(), 1, halfs));
    for (std::size_t i = 0; i < rows.size(); ++i) {
      for (std::size_t v = static_cast<std::size_t>(k) % kStep; v < scratch.blockValues();
           v += kStep) {
        rows[i].push_back(table[halfs[i * scratch.blockValues() + v]]);
      }
    }
  }
  MatrixXf samples(static_cast<Eigen::Index>(rows.size()),
                   static_cast<Eigen::Index>(rows[0].size()));
  for (std::size_t i = 0; i < rows.size(); ++i) {
    samples.row(static_cast<Eigen::Index>(i)) = Eigen::Map<const Eigen::RowVectorXf>(
        rows[i].data(), static_cast<Eigen::Index>(rows[i].size()));
  }
  return samples;
}

// Nodes for n captured lights. Eight times as many halve the spacing and a half more: on the six
// RealRTI sets that is where nothing is lost against interpolating in the encoded domain itself.
// Sets that are dense already are taken as they are.
int densityFor(int captures) {
  constexpr int kDense = 512;
  return captures > kDense ? CompressOptions::kDensifyOff : std::clamp(8 * captures, 256, 1024);
}

Result<LightPlan> planLights(const LightStack& stack, const ScratchStack& scratch,
                             const BlockLayout& layout, int nodes, bool nearLight) {
  LightPlan plan;
  const auto& captured = stack.directions();
  if (nodes == CompressOptions::kDensifyAuto) nodes = densityFor(stack.size());
  if (nearLight && nodes == CompressOptions::kDensifyOff) nodes = 1024;
  const bool densify = nodes != CompressOptions::kDensifyOff;
  ASSIGN_OR_RETURN(const MatrixXf samples, samplesOf(scratch, layout, HalfTable(densify)));
  ASSIGN_OR_RETURN(const auto settings, chooseInterpolation(captured, samples));
  if (!densify) {
    plan.lights = captured;
    plan.interpolation = settings;
    return plan;
  }
  ASSIGN_OR_RETURN(const auto cells, LightCells::create(captured));
  const bool below =
      std::any_of(captured.begin(), captured.end(), [](const Vector3d& d) { return d.z() < 0; });
  ASSIGN_OR_RETURN(const auto grid,
                   below ? LightGrid::create(std::min(2 * nodes, 10000), LightGrid::Domain::kSphere)
                         : LightGrid::create(nodes));
  for (const auto& node : grid.directions()) {
    if (cells.cellOf(node) >= 0) plan.lights.push_back(node);
  }
  ASSIGN_OR_RETURN(const auto interpolator, DirectionInterpolator::create(captured, settings));
  plan.weights.resize(static_cast<Eigen::Index>(plan.lights.size()), stack.size());
  for (std::size_t i = 0; i < plan.lights.size(); ++i) {
    plan.weights.row(static_cast<Eigen::Index>(i)) =
        interpolator.weights(plan.lights[i]).cast<float>().transpose();
  }
  // Between nodes this dense, kernels differ by hundredths of a decibel.
  plan.interpolation = {.kernel = InterpolationSettings::Kernel::kThinPlate,
                        .trendDegree = 1,
                        .nugget = 0,
                        .outsideClamp = 1};
  plan.captured = interpolator.settings();
  plan.description = interpolator.settings().describe();
  return plan;
}

// One block of a subject near the lamps: turns what was captured into what lamps as far from every
// pixel as from the origin would have given, and returns the block's own weights (as
// LightPlan::weights), for the lights as seen from its middle.
Result<RowMajorMatrixf> nearWeights(const LightStack& stack, const LightPlan& plan,
                                    const SurfacePoints& surface, const BlockLayout& layout,
                                    int block, std::vector<float>& captured) {
  const int size = layout.blockSize;
  const int left = block % layout.columns() * size;
  const int top = block / layout.columns() * size;
  const auto p = static_cast<std::size_t>(layout.pixelsPerBlock());
  std::vector<std::pair<std::size_t, Vector3d>> points;  // of the pixels that the picture has
  Vector3d middle = Vector3d::Zero();
  for (int y = 0; y < size && top + y < layout.height; ++y) {
    for (int x = 0; x < size && left + x < layout.width; ++x) {
      points.emplace_back(static_cast<std::size_t>(y * size + x),
                          Vector3d(surface(left + x, top + y, 0), surface(left + x, top + y, 1),
                                   surface(left + x, top + y, 2)));
      middle += points.back().second;
    }
  }
  middle /= static_cast<double>(points.size());
  std::vector<Vector3d> directions;
  for (std::size_t i = 0; i < static_cast<std::size_t>(stack.size()); ++i) {
    const Vector3d& lamp = *stack.positions()[i];
    directions.push_back((lamp - middle).normalized());
    for (const auto& [pixel, point] : points) {
      const auto factor = static_cast<float>(1 / nearFactor(lamp, point));
      for (std::size_t c = 0; c < 3; ++c) {
        float& value = captured[(i * 3 + c) * p + pixel];
        value = srgbEncode(value * factor);
      }
    }
  }
  ASSIGN_OR_RETURN(const auto interpolator,
                   DirectionInterpolator::create(directions, plan.captured));
  RowMajorMatrixf weights(static_cast<Eigen::Index>(plan.lights.size()), stack.size());
  for (std::size_t i = 0; i < plan.lights.size(); ++i) {
    weights.row(static_cast<Eigen::Index>(i)) =
        interpolator.weights(plan.lights[i]).cast<float>().transpose();
  }
  return weights;
}

// Which of a block's pixels the picture has.
std::unique_ptr<bool[]> inPicture(const BlockLayout& layout, int block, int& pixels) {
  const int size = layout.blockSize;
  const int left = block % layout.columns() * size;
  const int top = block / layout.columns() * size;
  auto inside = std::make_unique<bool[]>(static_cast<std::size_t>(layout.pixelsPerBlock()));
  pixels = 0;
  for (int y = 0; y < size; ++y) {
    for (int x = 0; x < size; ++x) {
      const bool here = left + x < layout.width && top + y < layout.height;
      inside[static_cast<std::size_t>(y * size + x)] = here;
      pixels += here ? 1 : 0;
    }
  }
  return inside;
}

// What one thread needs for one block; kept from block to block.
struct Workspace {
  std::vector<float> captured;  // n x 3 x p
  std::vector<float> columns;   // N x 3 x p
};

// Stage 1 over all blocks. Each strip of blocks is read once; everything else is local to a block.
Result<double> firstStage(const LightStack& stack, const ScratchStack& scratch,
                          const LightPlan& plan, const CompressOptions& options,
                          RelightableModel& model, RowMajorMatrixf& L, Progress& progress) {
  const BlockLayout& layout = model.layout;
  const auto images = static_cast<std::size_t>(scratch.images());
  const std::size_t values = scratch.blockValues();
  const bool densify = plan.weights.size() > 0;
  const SurfacePoints* surface = options.surface.get();
  const HalfTable table(densify && !surface);  // near lights are encoded after their distance
  const SrgbDecoder decode;
  const SingleThreadedBlas singleThreaded;

  // Half of the memory for the strip, the rest for the threads' workspaces.
  const std::size_t perBlock = images * values * sizeof(std::uint16_t);
  const int columnsAtOnce = static_cast<int>(std::clamp<std::size_t>(
      options.memoryLimitBytes / 2 / perBlock, 1, static_cast<std::size_t>(layout.columns())));

  tbb::enumerable_thread_specific<Workspace> workspaces;
  std::vector<double> energies(static_cast<std::size_t>(layout.blocks()), 0.0);
  std::atomic<std::size_t> done = 0;
  std::mutex mutex;  // guards the first failure
  std::optional<Error> error;
  std::vector<std::uint16_t> halfs;
  progress.update(kStage1, 0, energies.size());
  for (int row = 0; row < layout.rows(); ++row) {
    for (int first = 0; first < layout.columns(); first += columnsAtOnce) {
      const int count = std::min(columnsAtOnce, layout.columns() - first);
      RETURN_IF_ERROR(scratch.read(row, first, count, halfs));
      tbb::parallel_for(0, count, [&](int k) {
        if (progress.cancelled()) return;
        const int block = row * layout.columns() + first + k;
        Workspace& work = workspaces.local();
        work.captured.resize(images * values);
        for (std::size_t i = 0; i < images; ++i) {
          const std::uint16_t* source =
              halfs.data() +
              (i * static_cast<std::size_t>(count) + static_cast<std::size_t>(k)) * values;
          float* target = work.captured.data() + i * values;
          for (std::size_t v = 0; v < values; ++v) target[v] = table[source[v]];
        }
        std::vector<float>* columns = &work.captured;
        const RowMajorMatrixf* weights = &plan.weights;
        RowMajorMatrixf own;
        if (surface) {
          auto made = nearWeights(stack, plan, *surface, layout, block, work.captured);
          if (!made) {
            const std::scoped_lock lock(mutex);
            if (!error) error = made.error();
            return;
          }
          own = std::move(*made);
          weights = &own;
        }
        if (densify) {
          columns = &work.columns;
          columns->resize(plan.lights.size() * values);
          cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans,
                      static_cast<int>(plan.lights.size()), static_cast<int>(values),
                      static_cast<int>(images), 1, weights->data(), static_cast<int>(images),
                      work.captured.data(), static_cast<int>(values), 0, columns->data(),
                      static_cast<int>(values));
          for (float& value : *columns) value = decode(value);
        }
        double energy = 0;
        for (std::size_t i = 0; i < columns->size(); i += values) {
          energy += static_cast<double>(Eigen::Map<const Eigen::VectorXf>(
                                            columns->data() + i, static_cast<Eigen::Index>(values))
                                            .squaredNorm());
        }
        energies[static_cast<std::size_t>(block)] = energy;
        const std::int64_t at = model.blockOffset[static_cast<std::size_t>(block)];
        const auto b =
            static_cast<int>(model.blockOffset[static_cast<std::size_t>(block) + 1] - at);
        int pixels = 0;
        const auto inside = inPicture(layout, block, pixels);
        factoriseBlock(*columns, {inside.get(), static_cast<std::size_t>(layout.pixelsPerBlock())},
                       b, model.E.row(at).data(), L.row(at).data());
        progress.update(kStage1, ++done, energies.size());
      });
      if (progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
      if (error) return tl::unexpected<Error>(std::move(*error));
    }
  }
  return std::accumulate(energies.begin(), energies.end(), 0.0);
}

// First row of each block: b_j is at most the pixels the picture has there and the columns.
std::vector<std::int64_t> blockOffsets(const BlockLayout& layout, int wanted, std::size_t columns) {
  std::vector<std::int64_t> offset{0};
  for (int block = 0; block < layout.blocks(); ++block) {
    int pixels = 0;
    inPicture(layout, block, pixels);
    int b = static_cast<int>(std::min<std::size_t>(static_cast<std::size_t>(pixels), columns));
    if (wanted > 0) b = std::min(b, wanted);
    offset.push_back(offset.back() + b);
  }
  return offset;
}

void fillRatios(CompressSummary& s) {
  // Equation 4: m p 3n values become m b p + m b 3n; equation 5: m b p + m b q + q 3n. n on the
  // left is what was captured, on the right what the model has.
  const auto p = static_cast<double>(s.pixelsPerBlock);
  const auto rows = static_cast<double>(s.rows);
  const double original = 3.0 * s.captures * s.blocks * p;
  s.ratioStage1 = original / (rows * p + rows * 3.0 * s.lights);
  s.ratio = original / (rows * p + rows * s.rank + 3.0 * s.rank * s.lights);
}

Result<void> checkNearLight(const LightStack& stack, const SurfacePoints& surface,
                            const Sketch& sketch) {
  if (surface.width() != stack.width() || surface.height() != stack.height() ||
      surface.channels() != 3) {
    return failure(ErrorCode::kInvalidArgument,
                   "near light: the scene camera's model is for {} x {}, the sketch's frames are "
                   "{} x {}",
                   surface.width(), surface.height(), stack.width(), stack.height());
  }
  for (std::size_t i = 0; i < stack.positions().size(); ++i) {
    if (stack.positions()[i]) continue;
    return failure(ErrorCode::kInvalidArgument,
                   "{}: frame {} has no lamp position, near light needs it for all; `lightsketch "
                   "calibrate apply` finds positions from two source cameras or a given radius",
                   sketch.folder().string(), stack.ids()[i]);
  }
  return {};
}

Result<CompressResult> compressUnguarded(const Sketch& sketch, const CompressOptions& options,
                                         Progress& progress) {
  RETURN_IF_ERROR(options.validate());
  ASSIGN_OR_RETURN(const HoldOut split, applyHoldOut(sketch, options.holdOutRule));
  ASSIGN_OR_RETURN(const LightStack stack, LightStack::create(sketch, split.training));

  CompressResult result;
  RelightableModel& model = result.model;
  CompressSummary& summary = result.summary;
  model.layout = {stack.width(), stack.height(), options.blockSize};
  if (stack.width() < 1 || stack.height() < 1) {
    return failure(ErrorCode::kCorrupt, "{}: its pictures have no size", sketch.folder().string());
  }

  if (options.surface) RETURN_IF_ERROR(checkNearLight(stack, *options.surface, sketch));

  TimePoint start = Clock::now();
  const auto folder = options.scratchFolder.empty() ? std::filesystem::temp_directory_path()
                                                    : options.scratchFolder;
  ASSIGN_OR_RETURN(const ScratchStack scratch,
                   ScratchStack::create(stack, model.layout, folder, progress));
  summary.readSeconds = secondsSince(start);

  start = Clock::now();
  progress.update("choosing the interpolation", 0, 1);
  ASSIGN_OR_RETURN(LightPlan plan, planLights(stack, scratch, model.layout, options.densify,
                                              options.surface != nullptr));
  ASSIGN_OR_RETURN(model.solidAngles, voronoiSolidAngles(plan.lights));
  const std::size_t columns = 3 * plan.lights.size();
  model.blockOffset = blockOffsets(model.layout, options.blockRank, columns);
  const auto rows = static_cast<Eigen::Index>(model.blockOffset.back());
  model.E.resize(rows, model.layout.pixelsPerBlock());
  RowMajorMatrixf L(rows, static_cast<Eigen::Index>(columns));
  ASSIGN_OR_RETURN(const double energy,
                   firstStage(stack, scratch, plan, options, model, L, progress));
  summary.stage1Seconds = secondsSince(start);

  start = Clock::now();
  auto q = static_cast<int>(std::min(L.rows(), L.cols()));
  if (options.rank > 0) q = std::min(q, options.rank);
  ASSIGN_OR_RETURN(SecondStage second,
                   factoriseAll(std::move(L), q, SecondStageMethod::kAuto, progress));
  model.U = std::move(second.U);
  model.V = std::move(second.V);
  summary.stage2Seconds = secondsSince(start);

  summary.captures = stack.size();
  summary.heldOut = static_cast<int>(split.heldOut.size());
  summary.lights = static_cast<int>(plan.lights.size());
  summary.densified = plan.weights.size() > 0;
  summary.nearLight = options.surface != nullptr;
  summary.capturesInterpolation = plan.description;
  summary.blocks = model.layout.blocks();
  summary.pixelsPerBlock = model.layout.pixelsPerBlock();
  summary.rows = rows;
  summary.rank = q;
  summary.exactSecondStage = second.exact;
  summary.stage1Energy = energy > 0 ? std::min(1.0, second.totalEnergy / energy) : 1;
  summary.stage2Energy =
      second.totalEnergy > 0 ? std::min(1.0, second.keptEnergy / second.totalEnergy) : 1;
  fillRatios(summary);
  summary.capturedBytes = 6ull * static_cast<std::uint64_t>(stack.size()) *
                          static_cast<std::uint64_t>(stack.width()) *
                          static_cast<std::uint64_t>(stack.height());
  summary.modelBytes =
      static_cast<std::uint64_t>(model.E.size() + model.U.size() + model.V.size()) *
      (options.storage == Storage::kFloat16 ? 2u : 4u);

  model.storage = options.storage;
  model.lights = std::move(plan.lights);
  model.interpolation = plan.interpolation;
  model.holdOutRule = split.rule;
  model.heldOutIds = split.heldOut;
  model.capturedIds = split.training;
  model.capturedDirections = stack.directions();
  model.sketch = sketch.folder().filename().string();
  model.software = kSoftware;
  model.notes = summary.toJson();
  for (const char* seconds : {"readSeconds", "stage1Seconds", "stage2Seconds"})
    model.notes.erase(seconds);
  return result;
}

}  // namespace

Result<void> CompressOptions::validate() const {
  const auto refuse = [](const char* what, auto value, const char* range) {
    return failure(ErrorCode::kInvalidArgument, "{} is {}; it must be {}", what, value, range);
  };
  if (blockSize < 2 || blockSize > 64) return refuse("block size", blockSize, "from 2 to 64");
  if (blockRank < 0) return refuse("block rank", blockRank, "positive, or 0 for full");
  if (rank < 0) return refuse("rank", rank, "positive, or 0 for full");
  if (densify != kDensifyAuto && densify != kDensifyOff && (densify < 64 || densify > 10000)) {
    return refuse("number of nodes to densify to", densify, "from 64 to 10000, or 0 for none");
  }
  if (memoryLimitBytes < (std::size_t{1} << 24))
    return refuse("memory limit", memoryLimitBytes, "at least 16 MiB");
  return {};
}

Result<CompressResult> compress(const Sketch& sketch, const CompressOptions& options,
                                Progress& progress) {
  try {
    return compressUnguarded(sketch, options, progress);
  } catch (const std::bad_alloc&) {
    return failure(ErrorCode::kUnsupported,
                   "not enough memory; ask for a lower block rank or rank");
  } catch (const std::exception& error) {
    return failure(ErrorCode::kIo, "compression failed: {}", error.what());
  }
}

Result<DirectionInterpolator> interpolatorFor(const RelightableModel& model) {
  return DirectionInterpolator::create(model.lights, model.interpolation);
}

std::string CompressSummary::describe() const {
  std::string text =
      fmt::format("captures        {}{}\n", captures,
                  heldOut > 0 ? fmt::format(" ({} more held out)", heldOut) : std::string());
  if (densified) {
    text += fmt::format("densified       to {} directions, encoded domain: {}\n", lights,
                        capturesInterpolation);
  }
  if (nearLight) text += "near light      every block's own directions, every pixel's distance\n";
  text += fmt::format(
      "first stage     {} blocks of {} pixels, {} basis rows, {:.4f} % of the energy, {:.1f} s\n",
      blocks, pixelsPerBlock, rows, 100 * stage1Energy, stage1Seconds);
  text += fmt::format("second stage    rank {} ({}), {:.4f} % of the energy, {:.1f} s\n", rank,
                      exactSecondStage ? "exact" : "randomised", 100 * stage2Energy, stage2Seconds);
  text += fmt::format(
      "ratio           {:.1f} : 1 after the first stage (eq. 4), {:.1f} : 1 after both (eq. 5)\n",
      ratioStage1, ratio);
  text += fmt::format("bytes           {} captured, {} in the model, {:.1f} : 1\n", capturedBytes,
                      modelBytes,
                      static_cast<double>(capturedBytes) /
                          static_cast<double>(std::max<std::uint64_t>(modelBytes, 1)));
  return text;
}

Json CompressSummary::toJson() const {
  return {{"captures", captures},
          {"heldOut", heldOut},
          {"lights", lights},
          {"densified", densified},
          {"nearLight", nearLight},
          {"capturesInterpolation", capturesInterpolation},
          {"blocks", blocks},
          {"pixelsPerBlock", pixelsPerBlock},
          {"rows", rows},
          {"rank", rank},
          {"exactSecondStage", exactSecondStage},
          {"stage1Energy", stage1Energy},
          {"stage2Energy", stage2Energy},
          {"ratioStage1", ratioStage1},
          {"ratio", ratio},
          {"capturedBytes", capturedBytes},
          {"modelBytes", modelBytes},
          {"readSeconds", readSeconds},
          {"stage1Seconds", stage1Seconds},
          {"stage2Seconds", stage2Seconds}};
}

}  // namespace lightsketch
