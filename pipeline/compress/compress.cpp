#include "pipeline/compress/compress.h"

#include <algorithm>
#include <exception>
#include <new>
#include <utility>

#include "capture/frame/time.h"
#include "pipeline/compress/densify.h"
#include "pipeline/compress/factorise.h"
#include "pipeline/compress/first_stage.h"
#include "pipeline/compress/hold_out.h"
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

Result<CompressResult> compressUnguarded(const LightStack& stack, const CompressOptions& options,
                                         Progress& progress) {
  CompressResult result;
  RelightableModel& model = result.model;
  CompressSummary& summary = result.summary;
  const BlockLayout layout{stack.width(), stack.height(), options.blockSize};
  if (stack.size() < 1 || stack.width() < 1 || stack.height() < 1) {
    return failure(ErrorCode::kInvalidArgument, "there are no pictures to compress");
  }

  if (options.surface) RETURN_IF_ERROR(checkNearLight(stack, *options.surface));

  TimePoint start = Clock::now();
  const auto folder = options.scratchFolder.empty() ? std::filesystem::temp_directory_path()
                                                    : options.scratchFolder;
  ASSIGN_OR_RETURN(const ScratchStack scratch,
                   ScratchStack::create(stack, layout, folder, progress));
  summary.readSeconds = secondsSince(start);

  start = Clock::now();
  ASSIGN_OR_RETURN(const Densifier densifier,
                   Densifier::create(stack, scratch, layout, options, progress));
  model.lights = densifier.lights();
  ASSIGN_OR_RETURN(model.solidAngles, voronoiSolidAngles(model.lights));
  ASSIGN_OR_RETURN(FirstStage first,
                   firstStage(scratch, densifier, layout, {.most = options.blockRank},
                              options.memoryLimitBytes, progress));
  summary.stage1Seconds = secondsSince(start);

  start = Clock::now();
  const auto rows = first.L.rows();
  auto q = static_cast<int>(std::min(first.L.rows(), first.L.cols()));
  if (options.rank > 0) q = std::min(q, options.rank);
  ASSIGN_OR_RETURN(SecondStage second,
                   factoriseAll(std::move(first.L), q, SecondStageMethod::kAuto, progress));
  setFactors(model,
             {layout, std::move(first.blockOffset), std::move(first.E), std::move(second.U),
              std::move(second.V)},
             options.storage);
  summary.stage2Seconds = secondsSince(start);

  summary.captures = stack.size();
  summary.lights = static_cast<int>(model.lights.size());
  summary.densified = densifier.active();
  summary.nearLight = options.surface != nullptr;
  summary.capturesInterpolation = densifier.description();
  summary.blocks = layout.blocks();
  summary.pixelsPerBlock = layout.pixelsPerBlock();
  summary.rows = rows;
  summary.rank = q;
  summary.exactSecondStage = second.exact;
  summary.stage1Energy = first.energy > 0 ? std::min(1.0, second.totalEnergy / first.energy) : 1;
  summary.stage2Energy =
      second.totalEnergy > 0 ? std::min(1.0, second.keptEnergy / second.totalEnergy) : 1;
  fillRatios(summary);
  summary.capturedBytes = 6ull * static_cast<std::uint64_t>(stack.size()) *
                          static_cast<std::uint64_t>(stack.width()) *
                          static_cast<std::uint64_t>(stack.height());
  summary.modelBytes = model.factorBytes();

  model.interpolation = densifier.interpolation();
  model.capturedIds = stack.ids();
  model.capturedDirections = stack.directions();
  model.software = kSoftware;
  return result;
}

Result<CompressResult> guarded(const LightStack& stack, const CompressOptions& options,
                               Progress& progress) {
  try {
    return compressUnguarded(stack, options, progress);
  } catch (const std::bad_alloc&) {
    return failure(ErrorCode::kUnsupported,
                   "not enough memory; ask for a lower block rank or rank");
  } catch (const std::exception& error) {
    return failure(ErrorCode::kIo, "compression failed: {}", error.what());
  }
}

Json notesOf(const CompressSummary& summary) {
  Json notes = summary.toJson();
  for (const char* seconds : {"readSeconds", "stage1Seconds", "stage2Seconds"})
    notes.erase(seconds);
  return notes;
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

Result<CompressResult> compress(const LightStack& stack, const CompressOptions& options,
                                Progress& progress) {
  RETURN_IF_ERROR(options.validate());
  if (!options.holdOutRule.empty())
    return failure(ErrorCode::kInvalidArgument, "hold-out rules are for sketches");
  ASSIGN_OR_RETURN(CompressResult result, guarded(stack, options, progress));
  result.model.notes = notesOf(result.summary);
  return result;
}

Result<CompressResult> compress(const Sketch& sketch, const CompressOptions& options,
                                Progress& progress) {
  RETURN_IF_ERROR(options.validate());
  ASSIGN_OR_RETURN(const HoldOut split, applyHoldOut(sketch, options.holdOutRule));
  ASSIGN_OR_RETURN(const LightStack stack, LightStack::create(sketch, split.training));
  ASSIGN_OR_RETURN(CompressResult result, guarded(stack, options, progress));
  result.summary.heldOut = static_cast<int>(split.heldOut.size());
  result.model.holdOutRule = split.rule;
  result.model.heldOutIds = split.heldOut;
  result.model.sketch = sketch.folder().filename().string();
  result.model.notes = notesOf(result.summary);
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
