#include "pipeline/validate/validate.h"

#include <fmt/format.h>
#include <oneapi/tbb/parallel_for.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>
#include <set>
#include <span>
#include <string_view>

#include "capture/frame/angle.h"
#include "capture/frame/srgb.h"
#include "pipeline/compress/compress.h"
#include "pipeline/compress/hold_out.h"
#include "pipeline/illumination/direction_interpolation.h"
#include "pipeline/illumination/illumination.h"
#include "pipeline/illumination/light_grid.h"
#include "pipeline/relight/relighter.h"
#include "pipeline/sketch/image_file.h"
#include "pipeline/sketch/light_stack.h"
#include "pipeline/validate/metrics.h"

namespace lightsketch {
namespace {

namespace tbb = oneapi::tbb;

constexpr int kLongestShownSide = 640;  // pixels; keeps the report a few megabytes

tl::unexpected<Error> cancelledFailure() {
  return failure(ErrorCode::kCancelled, "validate: cancelled");
}

// Runs work(i) for i in 0..count-1 on all cores; the first failure by index wins.
template <class Work>
Result<void> forEach(std::size_t count, std::string_view stage, Progress& progress,
                     const Work& work) {
  std::vector<Result<void>> results(count);
  std::atomic<std::size_t> done{0};
  tbb::parallel_for(std::size_t{0}, count, [&](std::size_t i) {
    if (progress.cancelled()) {
      results[i] = cancelledFailure();
      return;
    }
    results[i] = work(i);
    progress.update(stage, ++done, count);
  });
  for (auto& result : results) RETURN_IF_ERROR(std::move(result));
  return {};
}

PictureError compare(const RadianceImage& picture, const RadianceImage& truth, double exposure) {
  const auto picture8 = toSrgb8(picture, static_cast<float>(exposure));
  const auto truth8 = toSrgb8(truth, static_cast<float>(exposure));
  const LinearError linear = linearError(picture, truth, exposure);
  return {.psnr = psnr8(picture8, truth8),
          .ssim = ssim8(picture8, truth8),
          .relative = linear.relative,
          .linearPsnr = linear.psnr,
          .identical = std::ranges::equal(picture8.values(), truth8.values())};
}

template <class Keep>
MeanError meanOf(std::span<const HeldOutLight> lights, const Keep& keep) {
  MeanError mean;
  double ssim = 0;
  int ssimCount = 0;
  int relativeCount = 0;
  for (const HeldOutLight& light : lights) {
    if (!keep(light)) continue;
    ++mean.count;
    mean.psnr += light.error.psnr;
    mean.linearPsnr += light.error.linearPsnr;
    if (light.error.ssim) ssim += *light.error.ssim, ++ssimCount;
    // A black truth has no relative error.
    if (std::isfinite(light.error.relative)) mean.relative += light.error.relative, ++relativeCount;
  }
  if (mean.count > 0) {
    mean.psnr /= mean.count;
    mean.linearPsnr /= mean.count;
  }
  if (relativeCount > 0) mean.relative /= relativeCount;
  if (ssimCount > 0) mean.ssim = ssim / ssimCount;
  return mean;
}

// Mean of factor x factor boxes; what does not fill a box at the rim is left out.
template <class T>
Image<float> shrunk(const Image<T>& image, int factor) {
  Image<float> out(image.width() / factor, image.height() / factor, image.channels());
  const float scale = 1.0f / static_cast<float>(factor * factor);
  for (int y = 0; y < out.height() * factor; ++y) {
    for (int x = 0; x < out.width() * factor; ++x) {
      for (int c = 0; c < out.channels(); ++c) {
        out(x / factor, y / factor, c) += scale * static_cast<float>(image(x, y, c));
      }
    }
  }
  return out;
}

PictureTriple tripleOf(const RadianceImage& picture, const RadianceImage& truth, double exposure,
                       int shrink) {
  const auto factor = static_cast<float>(exposure);
  Image<std::uint8_t> difference = toSrgb8(picture, factor);
  const Image<std::uint8_t> truth8 = toSrgb8(truth, factor);
  for (std::size_t i = 0; i < difference.size(); ++i) {
    const int d = std::abs(int{difference.data()[i]} - int{truth8.data()[i]});
    difference.data()[i] = static_cast<std::uint8_t>(std::min(255, kDifferenceGain * d));
  }
  if (shrink == 1) return {truth8, toSrgb8(picture, factor), std::move(difference)};
  const Image<float> small = shrunk(difference, shrink);
  Image<std::uint8_t> smallDifference(small.width(), small.height(), small.channels());
  std::ranges::transform(small.values(), smallDifference.data(),
                         [](float value) { return static_cast<std::uint8_t>(value + 0.5f); });
  return {toSrgb8(shrunk(truth, shrink), factor), toSrgb8(shrunk(picture, shrink), factor),
          std::move(smallDifference)};
}

// The value below which 99 percent of the pixels' largest channels lie.
double brightValue(const RadianceImage& picture) {
  std::vector<float> largest(picture.size() / 3);
  for (std::size_t i = 0; i < largest.size(); ++i) {
    const float* p = picture.data() + 3 * i;
    largest[i] = std::max({p[0], p[1], p[2]});
  }
  const auto at = largest.begin() + static_cast<std::ptrdiff_t>((largest.size() - 1) * 99 / 100);
  std::nth_element(largest.begin(), at, largest.end());
  return double{*at};
}

double exposureToShow(double value) { return value > 0 ? double{srgbDecode(0.9f)} / value : 1; }

// Outline of the hull as the interpolator understands it: from the directions' mean outwards, where
// "inside" ends. Empty if there is no such border (lights all around, or too few).
std::vector<Eigen::Vector3d> hullOutline(const DirectionInterpolator& interpolator,
                                         std::span<const Eigen::Vector3d> directions) {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& direction : directions) centre += direction;
  if (centre.norm() < 1e-6 * static_cast<double>(directions.size())) return {};
  centre.normalize();
  if (!interpolator.insideHull(centre)) return {};
  const Eigen::Vector3d right = centre.unitOrthogonal();
  const Eigen::Vector3d up = centre.cross(right);

  std::vector<Eigen::Vector3d> outline;
  for (int step = 0; step < 360; ++step) {
    const double azimuth = Angle::degrees(step).radians();
    const Eigen::Vector3d side = std::cos(azimuth) * right + std::sin(azimuth) * up;
    double insideAngle = 0;
    double outsideAngle = std::numbers::pi;
    for (int i = 0; i < 14; ++i) {  // to 0.01 degrees
      const double middle = (insideAngle + outsideAngle) / 2;
      const bool inside =
          interpolator.insideHull(std::cos(middle) * centre + std::sin(middle) * side);
      (inside ? insideAngle : outsideAngle) = middle;
    }
    if (outsideAngle == std::numbers::pi) return {};
    outline.push_back(std::cos(insideAngle) * centre + std::sin(insideAngle) * side);
  }
  return outline;
}

Result<void> checkModelFits(const Sketch& sketch, const RelightableModel& model,
                            const ValidateOptions& options, const HoldOut& holdOut) {
  if (holdOut.heldOut.empty()) {
    return failure(ErrorCode::kInvalidArgument,
                   "validate: hold-out '{}' keeps no frame of {} back; choose a denser rule, such "
                   "as every:8:4",
                   holdOut.rule, sketch.folder().string());
  }
  if (model.layout.width != sketch.manifest().width ||
      model.layout.height != sketch.manifest().height) {
    return failure(
        ErrorCode::kInvalidArgument,
        "validate: the model is {} x {} pixels, the sketch {} x {}; give the sketch that "
        "the model was made from",
        model.layout.width, model.layout.height, sketch.manifest().width, sketch.manifest().height);
  }
  if (model.capturedIds.empty() || model.capturedIds.size() != model.capturedDirections.size()) {
    return failure(ErrorCode::kInvalidArgument,
                   "validate: the model does not say which frames it was made from; compress the "
                   "sketch again");
  }
  for (const auto* kept : {&holdOut.heldOut, &holdOut.margin}) {
    for (const int id : *kept) {
      if (std::ranges::find(model.capturedIds, id) == model.capturedIds.end()) continue;
      return failure(
          ErrorCode::kInvalidArgument,
          "validate: the model has seen frame {}, which '{}' keeps from it; compress the "
          "sketch again with --hold-out {}",
          id, holdOut.rule, holdOut.rule);
    }
  }
  if (!(options.exposure > 0) || options.pictures < 1) {
    return failure(ErrorCode::kInvalidArgument,
                   "validate: exposure {} and {} pictures; both must be positive", options.exposure,
                   options.pictures);
  }
  return {};
}

// Sum of the captures, each as strong as its row of `weights` says.
Result<RadianceImage> weightedSum(const LightStack& captures, const LightIntensities& weights,
                                  Progress& progress) {
  RadianceImage sum(captures.width(), captures.height(), 3);
  // In batches, added in order: memory stays bounded and the sum does not depend on the threads.
  constexpr int kBatch = 16;
  for (int first = 0; first < captures.size(); first += kBatch) {
    if (progress.cancelled()) return cancelledFailure();
    const int count = std::min(kBatch, captures.size() - first);
    std::vector<Result<RadianceImage>> images(static_cast<std::size_t>(count));
    tbb::parallel_for(0, count, [&](int i) {
      if (!weights.row(first + i).isZero(0)) {
        images[static_cast<std::size_t>(i)] = captures.read(first + i);
      }
    });
    for (int i = 0; i < count; ++i) {
      auto& image = images[static_cast<std::size_t>(i)];
      if (!image) return tl::unexpected<Error>(std::move(image).error());
      if (image->empty()) continue;
      for (std::size_t k = 0; k < sum.size(); ++k) {
        sum.data()[k] += weights(first + i, static_cast<Eigen::Index>(k % 3)) * image->data()[k];
      }
    }
    progress.update("summing captures", static_cast<std::size_t>(first + count),
                    static_cast<std::size_t>(captures.size()));
  }
  return sum;
}

LightIntensities intensitiesAt(const DirectionInterpolator& interpolator,
                               const Eigen::Vector3d& direction) {
  return interpolator.weights(direction).cast<float>().replicate(1, 3);
}

// Towards the centre of a pixel of a lat-long map: the middle of the picture +z, a quarter from the
// left +x, top +y.
Eigen::Vector3d latLongDirection(int x, int y, int width, int height) {
  const double elevation = std::numbers::pi * (0.5 - (y + 0.5) / height);
  const double turn = 2 * std::numbers::pi * (0.5 - (x + 0.5) / width);
  return {std::cos(elevation) * std::sin(turn), std::sin(elevation),
          std::cos(elevation) * std::cos(turn)};
}

// The map without what comes from directions that belong to no capture.
RadianceImage maskedTo(const LightCells& cells, RadianceImage environment) {
  for (int y = 0; y < environment.height(); ++y) {
    for (int x = 0; x < environment.width(); ++x) {
      const auto direction = latLongDirection(x, y, environment.width(), environment.height());
      if (cells.cellOf(direction) >= 0) continue;
      for (int c = 0; c < 3; ++c) environment(x, y, c) = 0;
    }
  }
  return environment;
}

// Largest |relight(s1 + s2) - relight(s1) - relight(s2)| as a part of the largest value, for two
// coloured lamps at held-out directions.
Result<double> linearityOf(const RelightableModel& model, const DirectionInterpolator& interpolator,
                           std::span<const HeldOutLight> lights) {
  LightIntensities first = intensitiesAt(interpolator, lights.front().direction);
  LightIntensities second = intensitiesAt(interpolator, lights.back().direction);
  first *= Eigen::Vector3f(1.0f, 0.6f, 0.3f).asDiagonal();
  second *= Eigen::Vector3f(0.2f, 0.5f, 1.0f).asDiagonal();
  ASSIGN_OR_RETURN(const auto a, relight(model, first));
  ASSIGN_OR_RETURN(const auto b, relight(model, second));
  ASSIGN_OR_RETURN(const auto both, relight(model, first + second));
  float largest = 0;
  float worst = 0;
  for (std::size_t i = 0; i < both.size(); ++i) {
    const float sum = a.data()[i] + b.data()[i];
    largest = std::max(largest, std::abs(sum));
    worst = std::max(worst, std::abs(both.data()[i] - sum));
  }
  return largest > 0 ? double{worst} / double{largest} : 0;
}

Result<Superposition> superpose(const Sketch& sketch, const RelightableModel& model,
                                const DirectionInterpolator& interpolator,
                                const ValidateOptions& options,
                                std::span<const HeldOutLight> lights, int shrink,
                                Progress& progress) {
  const bool given = !options.environment.empty();
  const RadianceImage sky = given ? RadianceImage() : analyticSky();
  const RadianceImage& environment = given ? options.environment : sky;
  Superposition result;
  result.environment = given ? options.environmentName : "built-in sky";

  ASSIGN_OR_RETURN(const auto captures, LightStack::create(sketch, model.capturedIds));
  ASSIGN_OR_RETURN(const LightIntensities weights,
                   intensitiesOf(environment, model.capturedDirections));
  ASSIGN_OR_RETURN(const RadianceImage truth, weightedSum(captures, weights, progress));
  result.exposure = exposureToShow(brightValue(truth));

  LightIntensities sameLamps = LightIntensities::Zero(model.lightCount(), 3);
  for (std::size_t i = 0; i < model.capturedDirections.size(); ++i) {
    const Eigen::RowVector3f lamp = weights.row(static_cast<Eigen::Index>(i));
    if (lamp.isZero(0)) continue;
    sameLamps += interpolator.weights(model.capturedDirections[i]).cast<float>() * lamp;
  }
  ASSIGN_OR_RETURN(const RadianceImage same, relight(model, sameLamps));
  result.sameLamps = compare(same, truth, result.exposure);
  result.pictures = tripleOf(same, truth, result.exposure, shrink);

  ASSIGN_OR_RETURN(const LightCells cells, LightCells::create(model.capturedDirections));
  result.coveredSolidAngle =
      std::accumulate(cells.solidAngles().begin(), cells.solidAngles().end(), 0.0);
  ASSIGN_OR_RETURN(const LightIntensities ownCells,
                   intensitiesOf(maskedTo(cells, environment), model.lights));
  ASSIGN_OR_RETURN(const RadianceImage own, relight(model, ownCells));
  result.ownCells = compare(own, truth, result.exposure);
  ASSIGN_OR_RETURN(result.linearity, linearityOf(model, interpolator, lights));
  return result;
}

// `count` positions among `total` ranks: first, last, the median and the rest evenly between.
std::set<std::size_t> spreadRanks(std::size_t total, std::size_t count) {
  std::set<std::size_t> ranks;
  for (const std::size_t rank : {std::size_t{0}, total - 1, (total - 1) / 2}) {
    if (ranks.size() < count) ranks.insert(rank);
  }
  for (std::size_t i = 1; i < count && ranks.size() < std::min(count, total); ++i) {
    ranks.insert(i * (total - 1) / count);
  }
  return ranks;
}

ModelSize sizeOf(std::uint64_t bytes, const ValidationReport& report) {
  const double pixels = static_cast<double>(report.width) * report.height;
  const double samples = 3 * pixels * report.captured;
  const auto size = static_cast<double>(bytes);
  return {bytes, 8 * size / pixels, 2 * samples / size, 4 * samples / size};
}

Json numberOrNull(double value) { return std::isfinite(value) ? Json(value) : Json(); }
Json numberOrNull(const std::optional<double>& value) { return value ? Json(*value) : Json(); }

Json toJson(const PictureError& error) {
  return {{"psnrDb", error.psnr},
          {"ssim", numberOrNull(error.ssim)},
          {"relativeError", numberOrNull(error.relative)},
          {"linearPsnrDb", error.linearPsnr},
          {"identical", error.identical}};
}

Json toJson(const MeanError& mean) {
  if (mean.count == 0) return {{"count", 0}};
  return {{"count", mean.count},
          {"psnrDb", mean.psnr},
          {"ssim", numberOrNull(mean.ssim)},
          {"relativeError", mean.relative},
          {"linearPsnrDb", mean.linearPsnr}};
}

}  // namespace

RadianceImage analyticSky() {
  constexpr int kWidth = 256;
  constexpr int kHeight = 128;
  const Eigen::Vector3d sun = Eigen::Vector3d(0.5, 0.6, 0.62).normalized();
  RadianceImage sky(kWidth, kHeight, 3);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const Eigen::Vector3d d = latLongDirection(x, y, kWidth, kHeight);
      const double up = 0.5 + 0.5 * d.y();
      const double glow = 6 * std::exp(30 * (d.dot(sun) - 1));
      const Eigen::Vector3d horizon(0.75, 0.62, 0.5);
      const Eigen::Vector3d zenith(0.25, 0.45, 0.9);
      const Eigen::Vector3d colour =
          (1 - up) * horizon + up * zenith + glow * Eigen::Vector3d(1, 0.9, 0.7);
      for (int c = 0; c < 3; ++c) sky(x, y, c) = static_cast<float>(colour[c]);
    }
  }
  return sky;
}

double exposureToShow(const RadianceImage& picture) { return exposureToShow(brightValue(picture)); }

Result<PictureTriple> heldOutPictures(const Sketch& sketch, const RelightableModel& model,
                                      const DirectionInterpolator& interpolator, int id,
                                      double exposure) {
  ASSIGN_OR_RETURN(const auto stack, LightStack::create(sketch, {id}));
  ASSIGN_OR_RETURN(const RadianceImage truth, stack.read(0));
  ASSIGN_OR_RETURN(const RadianceImage picture,
                   relight(model, intensitiesAt(interpolator, stack.directions().front())));
  return tripleOf(picture, truth, exposure, 1);
}

Result<ValidationReport> validate(const Sketch& sketch, const RelightableModel& model,
                                  const ValidateOptions& options, Progress& progress) {
  const std::string& rule = options.holdOutRule.empty() ? model.holdOutRule : options.holdOutRule;
  if (rule.empty()) {
    return failure(ErrorCode::kInvalidArgument,
                   "validate: the model has seen every frame; compress the sketch again with a "
                   "hold-out, such as --hold-out every:8:4");
  }
  if (rule != model.holdOutRule) {
    return failure(ErrorCode::kInvalidArgument,
                   "validate: the model was made with hold-out '{}', not '{}'; compress the sketch "
                   "again with --hold-out {}",
                   model.holdOutRule, rule, rule);
  }
  ASSIGN_OR_RETURN(const HoldOut holdOut, applyHoldOut(sketch, rule));
  RETURN_IF_ERROR(checkModelFits(sketch, model, options, holdOut));
  ASSIGN_OR_RETURN(const auto truths, LightStack::create(sketch, holdOut.heldOut));
  ASSIGN_OR_RETURN(const auto interpolator, interpolatorFor(model));
  // Only for its hull: the model's own lights may be a denser and wider grid.
  ASSIGN_OR_RETURN(const auto captured,
                   DirectionInterpolator::create(model.capturedDirections, {}));

  ValidationReport report;
  report.sketch = sketch.folder().string();
  report.model = options.modelFile.filename().string();
  report.modelFile = options.modelFile;
  report.holdOutRule = rule;
  report.software = model.software;
  report.interpolation = model.interpolation.describe();
  report.modelNotes = model.notes;
  report.width = model.layout.width;
  report.height = model.layout.height;
  report.captured = static_cast<int>(model.capturedIds.size());
  report.modelLights = model.lightCount();
  report.rank = model.rank;
  report.basisRows = model.rows();
  report.blockSize = model.layout.blockSize;
  report.storage = nameOf(model.storage);
  report.exposure = options.exposure;
  report.capturedDirections = model.capturedDirections;
  report.hull = hullOutline(captured, model.capturedDirections);
  if (!options.modelFile.empty()) {
    std::error_code error;
    const auto bytes = std::filesystem::file_size(options.modelFile, error);
    if (error) {
      return failure(ErrorCode::kIo, "{}: cannot read its size: {}", options.modelFile.string(),
                     error.message());
    }
    report.size = sizeOf(bytes, report);
  }

  // Every held-out light.
  report.lights.resize(holdOut.heldOut.size());
  const auto predict = [&](const Eigen::Vector3d& direction) {
    return relight(model, intensitiesAt(interpolator, direction));
  };
  RETURN_IF_ERROR(forEach(
      report.lights.size(), "comparing held-out lights", progress,
      [&](std::size_t i) -> Result<void> {
        HeldOutLight& light = report.lights[i];
        light.id = holdOut.heldOut[i];
        light.origin = sketch.frames()[static_cast<std::size_t>(light.id)].origin;
        light.direction = truths.directions()[i];
        light.insideHull = captured.insideHull(light.direction);
        double closest = -1;
        for (const auto& other : model.capturedDirections) {
          closest = std::max(closest, other.dot(light.direction));
        }
        light.nearestCapturedDegrees = Angle::radians(std::acos(std::min(1.0, closest))).degrees();
        ASSIGN_OR_RETURN(const RadianceImage truth, truths.read(static_cast<int>(i)));
        ASSIGN_OR_RETURN(const RadianceImage picture, predict(light.direction));
        light.error = compare(picture, truth, options.exposure);
        return {};
      }));
  report.all = meanOf(report.lights, [](const auto&) { return true; });
  report.inside = meanOf(report.lights, [](const auto& light) { return light.insideHull; });
  report.outside = meanOf(report.lights, [](const auto& light) { return !light.insideHull; });
  report.worstFirst.resize(report.lights.size());
  std::iota(report.worstFirst.begin(), report.worstFirst.end(), std::size_t{0});
  std::ranges::stable_sort(report.worstFirst, {},
                           [&](std::size_t i) { return report.lights[i].error.psnr; });

  // The pictures to show, all at one exposure: dark sets are brightened, none is darkened.
  report.pictureShrink =
      (std::max(report.width, report.height) + kLongestShownSide - 1) / kLongestShownSide;
  const auto spread = spreadRanks(report.lights.size(), static_cast<std::size_t>(options.pictures));
  const std::vector<std::size_t> ranks(spread.begin(), spread.end());
  std::vector<RadianceImage> shownTruths(ranks.size());
  std::vector<RadianceImage> shownPictures(ranks.size());
  double bright = 0;
  for (std::size_t i = 0; i < ranks.size(); ++i) {
    const std::size_t light = report.worstFirst[ranks[i]];
    ASSIGN_OR_RETURN(shownTruths[i], truths.read(static_cast<int>(light)));
    ASSIGN_OR_RETURN(shownPictures[i], predict(report.lights[light].direction));
    bright = std::max(bright, brightValue(shownTruths[i]));
    report.shown.push_back({light, {}});
  }
  report.pictureExposure = std::max(options.exposure, exposureToShow(bright));
  for (std::size_t i = 0; i < ranks.size(); ++i) {
    report.shown[i].pictures =
        tripleOf(shownPictures[i], shownTruths[i], report.pictureExposure, report.pictureShrink);
  }

  if (!model.singleLamp) {
    ASSIGN_OR_RETURN(report.superposition,
                     superpose(sketch, model, interpolator, options, report.lights,
                               report.pictureShrink, progress));
  }
  return report;
}

std::string ValidationReport::describe() const {
  const auto ssimText = [](const std::optional<double>& ssim) {
    return ssim ? fmt::format("{:6.4f}", *ssim) : std::string("     -");
  };
  std::string text = fmt::format("{:<22}{:>7}{:>11}{:>8}{:>12}\n", "held-out lights", "count",
                                 "PSNR dB", "SSIM", "rel. error");
  const auto meanLine = [&](const char* name, const MeanError& mean) {
    if (mean.count == 0) return fmt::format("{:<22}{:>7}\n", name, 0);
    return fmt::format("{:<22}{:>7}{:>11.2f}{:>8}{:>11.2f}%\n", name, mean.count, mean.psnr,
                       ssimText(mean.ssim), 100 * mean.relative);
  };
  text += meanLine("mean", all);
  text += meanLine("  inside the hull", inside);
  text += meanLine("  outside the hull", outside);
  const auto lightLine = [&](const char* name, const HeldOutLight& light) {
    return fmt::format("{:<22}{:>7}{:>11.2f}{:>8}{:>11.2f}%\n", name, fmt::format("#{}", light.id),
                       light.error.psnr, ssimText(light.error.ssim), 100 * light.error.relative);
  };
  text += lightLine("worst", worst());
  text += lightLine("median", median());
  text += lightLine("best", best());
  if (superposition) {
    text += fmt::format("{:<22}{:>7}{:>11.2f}{:>8}{:>11.2f}%\n", "sum of captures", captured,
                        superposition->sameLamps.psnr, ssimText(superposition->sameLamps.ssim),
                        100 * superposition->sameLamps.relative);
  } else {
    text += "single-lamp model     sums of lights would come out wrong: none shown\n";
  }
  if (size) {
    text += fmt::format(
        "model                 {} bytes, {:.1f} bits per pixel, {:.1f} : 1 of half float\n",
        size->bytes, size->bitsPerPixel, size->ratioToHalf);
  }
  return text;
}

Json toJson(const ValidationReport& report) {
  Json lights = Json::array();
  for (const HeldOutLight& light : report.lights) {
    Json entry = toJson(light.error);
    entry["id"] = light.id;
    entry["origin"] = light.origin;
    entry["direction"] = toJson(Eigen::VectorXd(light.direction));
    entry["insideHull"] = light.insideHull;
    entry["nearestCapturedDegrees"] = light.nearestCapturedDegrees;
    lights.push_back(std::move(entry));
  }
  Json json = {{"format", "lightsketch-validation"},
               {"formatVersion", 1},
               {"sketch", report.sketch},
               {"holdOut", report.holdOutRule},
               {"exposure", report.exposure},
               {"pictureExposure", report.pictureExposure},
               {"psnrCapDb", kPsnrCap},
               {"model",
                {{"file", report.model},
                 {"path", report.modelFile.string()},
                 {"software", report.software},
                 {"width", report.width},
                 {"height", report.height},
                 {"captures", report.captured},
                 {"lights", report.modelLights},
                 {"rank", report.rank},
                 {"basisRows", report.basisRows},
                 {"blockSize", report.blockSize},
                 {"storage", report.storage},
                 {"interpolation", report.interpolation},
                 {"notes", report.modelNotes}}},
               {"mean", toJson(report.all)},
               {"insideHull", toJson(report.inside)},
               {"outsideHull", toJson(report.outside)},
               {"worst", report.worst().id},
               {"median", report.median().id},
               {"best", report.best().id},
               {"lights", std::move(lights)}};
  if (report.superposition) {
    const Superposition& sum = *report.superposition;
    json["superposition"] = {{"environment", sum.environment},
                             {"exposure", sum.exposure},
                             {"sameLamps", toJson(sum.sameLamps)},
                             {"ownCells", toJson(sum.ownCells)},
                             {"coveredSteradians", sum.coveredSolidAngle},
                             {"linearity", sum.linearity}};
  }
  if (report.size) {
    json["size"] = {{"bytes", report.size->bytes},
                    {"bitsPerPixel", report.size->bitsPerPixel},
                    {"ratioToHalf", report.size->ratioToHalf},
                    {"ratioToFloat", report.size->ratioToFloat}};
  }
  return json;
}

}  // namespace lightsketch
