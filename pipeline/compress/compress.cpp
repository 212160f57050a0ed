#include "pipeline/compress/compress.h"

#include <algorithm>
#include <cmath>
#include <exception>
#include <functional>
#include <memory>
#include <new>
#include <stdexcept>
#include <utility>

#include "capture/frame/time.h"
#include "pipeline/compress/densify.h"
#include "pipeline/compress/factorise.h"
#include "pipeline/compress/first_stage.h"
#include "pipeline/compress/hold_out.h"
#include "pipeline/compress/measured_error.h"
#include "pipeline/compress/packed_code.h"
#include "pipeline/compress/rate_distortion.h"
#include "pipeline/compress/scratch_stack.h"
#include "pipeline/illumination/light_grid.h"
#include "pipeline/sketch/light_stack.h"

namespace lightsketch {
namespace {

constexpr const char* kSoftware = "lightsketch " LIGHTSKETCH_VERSION;

double secondsSince(TimePoint start) { return toSeconds(Clock::now() - start); }

void fillRatios(CompressSummary& s) {
  // Equation 4: m p 3n values become m b p + m b 3n; equation 5: m b p + m b q + q 3n. n on the
  // left is what was captured, on the right what the model has.
  const auto p = static_cast<double>(s.pixelsPerBlock);
  const auto rows = static_cast<double>(s.rows);
  const double original = 3.0 * s.captures * s.blocks * p;
  s.ratioStage1 = original / (rows * p + rows * 3.0 * s.lights);
  s.ratio = original / (rows * p + rows * s.rank + 3.0 * s.rank * s.lights);
}

Result<void> checkNearLight(const LightStack& stack, const SurfacePoints& surface) {
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
                   "frame {} has no lamp position, near light needs it for all; `lightsketch "
                   "calibrate apply` finds positions from two source cameras or a given radius",
                   stack.ids()[i]);
  }
  return {};
}

Json notesOf(const CompressSummary& summary) {
  Json notes = summary.toJson();
  for (const char* seconds : {"readSeconds", "stage1Seconds", "stage2Seconds"})
    notes.erase(seconds);
  return notes;
}

// Of all pictures, as some blocks tell it.
Result<double> estimateEnergy(const ScratchStack& scratch, const Densifier& densifier,
                              const BlockLayout& layout) {
  constexpr int kBlocks = 32;
  const int count = std::min(kBlocks, layout.blocks());
  const std::size_t values = scratch.blockValues();
  std::vector<std::uint16_t> halfs(static_cast<std::size_t>(scratch.images()) * values);
  std::vector<float> columns;
  Densifier::Workspace workspace;
  double energy = 0;
  for (int k = 0; k < count; ++k) {
    const auto block =
        static_cast<int>((2 * k + 1) * static_cast<std::int64_t>(layout.blocks()) / (2 * count));
    RETURN_IF_ERROR(scratch.read(block, halfs.data()));
    RETURN_IF_ERROR(densifier.columns(block, halfs.data(), values, workspace, columns));
    for (const float value : columns) energy += static_cast<double>(value) * value;
  }
  return energy * layout.blocks() / count;
}

// Noise (see rate_distortion.h) as a part of the energy per pixel. On RealRTI, small and archive
// are where eight and twenty bits per pixel are spent.
double relativeNoise(Quality quality) {
  switch (quality) {
    case Quality::kSmall:
      return std::exp2(-10.5);
    case Quality::kStandard:
      return std::exp2(-12);
    case Quality::kArchive:
      return std::exp2(-13);
  }
  throw std::logic_error("unknown quality");
}

std::string settingOf(const CompressOptions& options) {
  if (options.papersSetting()) return "the paper's, given ranks";
  if (options.budgetBytes) return fmt::format("the best in {} bytes", *options.budgetBytes);
  if (options.psnr) return fmt::format("the smallest of {:.2f} dB (8-bit sRGB)", *options.psnr);
  return fmt::format("quality {}", nameOf(options.quality.value_or(Quality::kStandard)));
}

// One compression, from the decoded pictures to a model whose provenance is known already.
class Compression {
 public:
  Compression(const LightStack& stack, const CompressOptions& options, Progress& progress,
              CompressResult& result)
      : stack_(stack),
        options_(options),
        progress_(progress),
        model_(result.model),
        summary_(result.summary),
        layout_{stack.width(), stack.height(), options.blockSize} {}

  Result<void> run() {
    TimePoint start = Clock::now();
    const auto folder = options_.scratchFolder.empty() ? std::filesystem::temp_directory_path()
                                                       : options_.scratchFolder;
    ASSIGN_OR_RETURN(
        const ScratchStack scratch,
        ScratchStack::create(stack_, layout_, folder, progress_, options_.memoryLimitBytes));
    summary_.readSeconds = secondsSince(start);

    start = Clock::now();
    ASSIGN_OR_RETURN(const Densifier densifier,
                     Densifier::create(stack_, scratch, layout_, options_, progress_));
    model_.lights = densifier.lights();
    model_.singleLamp = options_.singleLamp;
    ASSIGN_OR_RETURN(model_.solidAngles, voronoiSolidAngles(model_.lights));
    describe(densifier);
    summary_.stage1Seconds = secondsSince(start);
    return options_.papersSetting() ? keepRanks(scratch, densifier)
                                    : chooseByRate(scratch, densifier);
  }

 private:
  double pixels() const { return static_cast<double>(layout_.width) * layout_.height; }

  void describe(const Densifier& densifier) {
    summary_.setting = settingOf(options_);
    summary_.captures = stack_.size();
    summary_.lights = static_cast<int>(model_.lights.size());
    summary_.densified = !densifier.description().empty();
    summary_.nearLight = options_.surface != nullptr;
    summary_.capturesInterpolation = densifier.description();
    summary_.blocks = layout_.blocks();
    summary_.pixelsPerBlock = layout_.pixelsPerBlock();
    summary_.capturedBytes = 6ull * static_cast<std::uint64_t>(stack_.size()) *
                             static_cast<std::uint64_t>(stack_.width()) *
                             static_cast<std::uint64_t>(stack_.height());
    model_.interpolation = densifier.interpolation();
    model_.capturedIds = stack_.ids();
    model_.capturedDirections = stack_.directions();
    model_.software = kSoftware;
  }

  // Bounds of the search for a noise, as parts of the energy per pixel.
  static constexpr double kFinest = 1.0 / (1 << 18);
  static constexpr double kCoarsest = 1.0 / 4;

  void countFactors(std::int64_t rows, int rank) {
    summary_.rows = rows;
    summary_.rank = rank;
    fillRatios(summary_);
    summary_.modelBytes = model_.factorBytes();
  }

  Result<void> measure() {
    if (options_.surface) return {};
    ASSIGN_OR_RETURN(summary_.error, measureError(model_, stack_, progress_));
    return {};
  }

  void noteEnergies(double captured, const SecondStage& second) {
    summary_.exactSecondStage = second.exact;
    summary_.stage1Energy = captured > 0 ? std::min(1.0, second.totalEnergy / captured) : 1;
    summary_.stage2Energy =
        second.totalEnergy > 0 ? std::min(1.0, second.keptEnergy / second.totalEnergy) : 1;
  }

  Result<FirstStage> doFirstStage(const ScratchStack& scratch, const Densifier& densifier,
                                  const RankRule& rule) {
    const TimePoint start = Clock::now();
    auto first = firstStage(scratch, densifier, layout_, rule, options_.memoryLimitBytes, progress_,
                            options_.watch);
    summary_.stage1Seconds += secondsSince(start);
    return first;
  }

  Result<void> keepRanks(const ScratchStack& scratch, const Densifier& densifier) {
    ASSIGN_OR_RETURN(FirstStage first,
                     doFirstStage(scratch, densifier, {.most = options_.blockRank.value_or(10)}));
    const TimePoint start = Clock::now();
    auto q = static_cast<int>(std::min(first.L.rows(), first.L.cols()));
    const int wanted = options_.rank.value_or(200);
    if (wanted > 0) q = std::min(q, wanted);
    ASSIGN_OR_RETURN(SecondStage second,
                     factoriseAll(std::move(first.L), q, SecondStageMethod::kAuto, progress_));
    noteEnergies(first.energy, second);
    setFactors(model_,
               {layout_, std::move(first.blockOffset), std::move(first.E), std::move(second.U),
                std::move(second.V)},
               options_.storage.value_or(Storage::kFloat16));
    countFactors(model_.rows(), q);
    RETURN_IF_ERROR(measure());
    summary_.stage2Seconds = secondsSince(start);
    return {};
  }

  Result<void> chooseByRate(const ScratchStack& scratch, const Densifier& densifier) {
    ASSIGN_OR_RETURN(const double energy, estimateEnergy(scratch, densifier, layout_));
    const double noise = relativeNoise(options_.quality.value_or(Quality::kStandard));
    double finest = noise * std::max(energy, 1e-30) / pixels();
    // Some blocks only tell the energy so well.
    if (!searches()) finest *= 0.5;
    // Both stages hold what the finest noise needs. A search that wants a finer one does them
    // again: most do not, and stages for any noise would cost many times more.
    for (;;) {
      ASSIGN_OR_RETURN(
          FirstStage first,
          doFirstStage(scratch, densifier,
                       {.most = 0, .threshold = rowThreshold(finest, layout_.pixelsPerBlock())}));
      const TimePoint start = Clock::now();
      unit_ = std::max(first.energy, 1e-30) / pixels();
      if (!searches()) finest = noise * unit_;
      const double strongest = first.rowEnergy.empty() ? 0
                                                       : *std::max_element(first.rowEnergy.begin(),
                                                                           first.rowEnergy.end());
      const double nothingLeft = 2 * strongest / rowThreshold(1, layout_.pixelsPerBlock());
      ASSIGN_OR_RETURN(const RateDistortion stages, bothStages(std::move(first), finest));
      double wanted = finest;
      if (searches()) {
        ASSIGN_OR_RETURN(
            wanted, search(stages, finest, std::max({kCoarsest * unit_, finest, nothingLeft})));
      } else {
        RETURN_IF_ERROR(make(stages, finest));
      }
      const bool enough = wanted >= finest || finest <= kFinest * unit_;
      if (enough) RETURN_IF_ERROR(measure());
      summary_.stage2Seconds += secondsSince(start);
      if (enough) break;
      finest = std::max(wanted, kFinest * unit_);
    }
    ASSIGN_OR_RETURN(summary_.modelBytes, fileBytes());
    return checkTarget();
  }

  bool searches() const { return options_.budgetBytes || options_.psnr; }

  // For codes of `finest` noise and coarser.
  Result<RateDistortion> bothStages(FirstStage first, double finest) {
    const int q = std::max(1, estimateRank(first.L, 0.7 * rankThreshold(finest)));
    // Directions below the threshold need not be exact.
    const bool few = 2 * q <= std::min(first.L.rows(), first.L.cols());
    ASSIGN_OR_RETURN(
        SecondStage second,
        factoriseAll(std::move(first.L), q,
                     few ? SecondStageMethod::kSpan : SecondStageMethod::kExact, progress_));
    noteEnergies(first.energy, second);
    return RateDistortion(layout_, std::move(first.blockOffset), first.E, first.rowEnergy,
                          std::move(second.U), std::move(second.V));
  }

  Result<void> make(const RateDistortion& stages, double noise) {
    if (progress_.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
    setPacked(model_, stages.encode(noise));
    summary_.noise = noise / unit_;
    countFactors(model_.rows(), model_.rank);
    return {};
  }

  // Makes the model that was asked for and returns its noise; or, where a noise finer than `finest`
  // is called for, a guess at that.
  Result<double> search(const RateDistortion& stages, double finest, double coarsest) {
    NoiseTarget target;
    if (options_.budgetBytes) {
      // Bytes in octaves. They fall by half an octave and more with an octave of noise.
      const double most = std::log2(static_cast<double>(*options_.budgetBytes));
      target = {std::log2(0.985) + most, most, 0.5, false};
    } else {
      target = {*options_.psnr, *options_.psnr + 0.1, 1.0, true};
    }
    double made = 0;
    double reached = 0;
    const auto trial = [&](double noise) -> Result<double> {
      RETURN_IF_ERROR(make(stages, noise));
      made = noise;
      if (options_.budgetBytes) {
        ASSIGN_OR_RETURN(const std::size_t bytes, fileBytes());
        reached = std::log2(static_cast<double>(bytes));
      } else {
        RETURN_IF_ERROR(measure());
        reached = summary_.error->srgbPsnr;
      }
      return reached;
    };
    ASSIGN_OR_RETURN(const double noise, noiseFor(target, finest, finest, coarsest, trial));
    if (noise != made) {
      ASSIGN_OR_RETURN(reached, trial(noise));
    }
    if (noise > finest || reached >= target.least) return noise;
    return noise * std::exp2((reached - target.least) / target.perOctave);
  }

  Result<void> checkTarget() const {
    if (options_.budgetBytes && summary_.modelBytes > *options_.budgetBytes) {
      return failure(ErrorCode::kInvalidArgument,
                     "budget of {} bytes: the smallest model of these pictures takes {}; ask for "
                     "more, or densify to fewer lights",
                     *options_.budgetBytes, summary_.modelBytes);
    }
    if (options_.psnr && summary_.error->srgbPsnr < *options_.psnr) {
      return failure(ErrorCode::kInvalidArgument,
                     "PSNR of {:.2f} dB: a packed model of these pictures reaches {:.2f}; ask for "
                     "less{}",
                     *options_.psnr, summary_.error->srgbPsnr,
                     summary_.densified ? ", or switch densifying off" : "");
    }
    return {};
  }

  // Of the model as it would be saved now, with room for figures that are not known yet.
  Result<std::size_t> fileBytes() {
    Json notes = notesOf(summary_);
    if (!summary_.error) {
      constexpr double kLong = 1.2345678901234567e-05;
      summary_.error = MeasuredError{64, kLong, kLong, kLong};
      notes = notesOf(summary_);
      summary_.error.reset();
    }
    model_.notes = std::move(notes);
    constexpr std::size_t kDigits = 16;  // of the bytes themselves
    return savedBytes(model_).map([](std::size_t bytes) { return bytes + kDigits; });
  }

  const LightStack& stack_;
  const CompressOptions& options_;
  Progress& progress_;
  RelightableModel& model_;
  CompressSummary& summary_;
  BlockLayout layout_;
  double unit_ = 0;  // energy of all pictures per pixel, as the first stage found it
};

// Into a result that holds the model's provenance.
Result<void> compressInto(CompressResult& result, const LightStack& stack,
                          const CompressOptions& options, Progress& progress) {
  if (stack.size() < 1 || stack.width() < 1 || stack.height() < 1)
    return failure(ErrorCode::kInvalidArgument, "there are no pictures to compress");
  if (options.surface) RETURN_IF_ERROR(checkNearLight(stack, *options.surface));
  try {
    RETURN_IF_ERROR(Compression(stack, options, progress, result).run());
  } catch (const std::bad_alloc&) {
    return failure(ErrorCode::kUnsupported,
                   "not enough memory; ask for less quality or lower ranks");
  } catch (const std::exception& error) {
    return failure(ErrorCode::kIo, "compression failed: {}", error.what());
  }
  result.model.notes = notesOf(result.summary);
  return {};
}

}  // namespace

Result<void> CompressOptions::validate() const {
  const auto refuse = [](const char* what, auto value, const char* range) {
    return failure(ErrorCode::kInvalidArgument, "{} is {}; it must be {}", what, value, range);
  };
  if (blockSize < 2 || blockSize > 64) return refuse("block size", blockSize, "from 2 to 64");
  if (blockRank.value_or(1) < 0) return refuse("block rank", *blockRank, "positive, or 0 for full");
  if (rank.value_or(1) < 0) return refuse("rank", *rank, "positive, or 0 for full");
  if (storage == Storage::kPacked)
    return refuse("storage of given ranks", nameOf(*storage), "f32, f16 or q8");
  if (psnr && !(*psnr > 0 && *psnr < 100)) return refuse("PSNR", *psnr, "between 0 and 100 dB");
  if (budgetBytes && *budgetBytes < 1) return refuse("budget", *budgetBytes, "at least a byte");
  if (quality.has_value() + budgetBytes.has_value() + psnr.has_value() + papersSetting() > 1) {
    return failure(ErrorCode::kInvalidArgument,
                   "quality, budget, PSNR and the paper's setting (block rank, rank, storage) "
                   "exclude each other; give one");
  }
  if (psnr && surface) {
    return failure(ErrorCode::kInvalidArgument,
                   "PSNR cannot be asked for with near light: the model's pictures are of far "
                   "light, and none was captured");
  }
  if (surface && densify == kDensifyOff) {
    return failure(ErrorCode::kInvalidArgument,
                   "near light always densifies; leave densifying on, or near light out");
  }
  if (densify != kDensifyAuto && densify != kDensifyOff && (densify < 64 || densify > 10000)) {
    return refuse("number of nodes to densify to", densify, "from 64 to 10000, or 0 for none");
  }
  if (memoryLimitBytes < (std::size_t{1} << 24))
    return refuse("memory limit", memoryLimitBytes, "at least 16 MiB");
  return {};
}

const char* nameOf(Quality quality) {
  constexpr const char* kNames[] = {"small", "standard", "archive"};
  return kNames[static_cast<int>(quality)];
}

Result<CompressResult> compress(const LightStack& stack, const CompressOptions& options,
                                Progress& progress) {
  RETURN_IF_ERROR(options.validate());
  if (!options.holdOutRule.empty())
    return failure(ErrorCode::kInvalidArgument, "hold-out rules are for sketches");
  CompressResult result;
  RETURN_IF_ERROR(compressInto(result, stack, options, progress));
  return result;
}

Result<CompressResult> compress(const Sketch& sketch, const CompressOptions& options,
                                Progress& progress) {
  RETURN_IF_ERROR(options.validate());
  ASSIGN_OR_RETURN(const HoldOut split, applyHoldOut(sketch, options.holdOutRule));
  ASSIGN_OR_RETURN(const LightStack stack, LightStack::create(sketch, split.training));
  CompressResult result;
  result.summary.heldOut = static_cast<int>(split.heldOut.size());
  result.model.holdOutRule = split.rule;
  result.model.heldOutIds = split.heldOut;
  result.model.sketch = sketch.folder().filename().string();
  RETURN_IF_ERROR(compressInto(result, stack, options, progress));
  return result;
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
  text += fmt::format("setting         {}\n", setting);
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
  if (error) {
    text += fmt::format(
        "measured error  {:.2f} dB (8-bit sRGB PSNR), {:.2f} dB (linear), {:.3f} % (linear, "
        "relative), on {} of the captured pictures\n",
        error->srgbPsnr, error->linearPsnr, 100 * error->relative, error->pictures);
  }
  return text;
}

Json CompressSummary::toJson() const {
  Json json{{"setting", setting},
            {"noise", noise},
            {"captures", captures},
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
  if (error) {
    json["error"] = {{"pictures", error->pictures},
                     {"relative", error->relative},
                     {"linearPsnr", error->linearPsnr},
                     {"srgbPsnr", error->srgbPsnr}};
  }
  return json;
}

}  // namespace lightsketch
