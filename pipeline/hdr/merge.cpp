#include "pipeline/hdr/merge.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <vector>

#include "pipeline/hdr/sample_plane.h"

namespace lightsketch {
namespace {

constexpr std::size_t kVarianceNodes = 512;
// A sample is trusted only where its expected exposure stays this many sigma below saturation:
// keeping those that noise happened to leave below would bias the mean down.
constexpr double kSaturationSigmas = 3;

// Variance of a sample's exposure as a function of its mean, at one gain; even steps of the root,
// in which photon noise is smooth.
class VarianceTable {
 public:
  VarianceTable(const SensorModel& sensor, int colour, double gainDb) {
    const ResponseCurve& response = sensor.response;
    for (std::size_t i = 0; i <= kVarianceNodes; ++i) {
      const double root = static_cast<double>(i) / kVarianceNodes;
      const double count = response.count(root * root, colour);
      variance_.push_back(sensor.noise.exposureVariance(root * root, response.slope(count, colour),
                                                        colour, gainDb));
    }
    for (std::size_t i = 0; i <= kVarianceNodes; ++i) {
      const double root = static_cast<double>(i) / kVarianceNodes;
      if (root * root + kSaturationSigmas * std::sqrt(variance_[i]) < 1) limit_ = root * root;
    }
  }

  double operator()(double exposure) const {
    const double position = std::sqrt(std::clamp(exposure, 0.0, 1.0)) * kVarianceNodes;
    const auto i = std::min(static_cast<std::size_t>(position), kVarianceNodes - 1);
    return variance_[i] + (position - static_cast<double>(i)) * (variance_[i + 1] - variance_[i]);
  }
  // Largest mean exposure that noise does not carry into saturation.
  double limit() const { return limit_; }

 private:
  std::vector<double> variance_;
  double limit_ = 0;
};

struct Sample {
  double exposure;  // 1 is the frame's saturation
  bool saturated;
};

struct Estimate {
  double radiance;
  double variance;
};

// `gain[j]` turns radiance into frame j's exposure, longest first; `noise[j]` is its scatter.
std::optional<Estimate> merge(std::span<const Sample> samples, std::span<const double> gain,
                              std::span<const VarianceTable* const> noise) {
  // Start: Poisson's maximum likelihood, sum of exposures over sum of times.
  double sum = 0, weight = 0;
  for (std::size_t j = 0; j < samples.size(); ++j) {
    if (samples[j].saturated) continue;
    sum += samples[j].exposure;
    weight += gain[j];
  }
  if (weight == 0) return std::nullopt;
  Estimate estimate{sum / weight, 0};
  for (int iteration = 0; iteration < 3; ++iteration) {
    sum = weight = 0;
    for (std::size_t j = 0; j < samples.size(); ++j) {
      if (samples[j].saturated) continue;
      const double expected = estimate.radiance * gain[j];
      // The shortest exposure serves even at the brink: there is no other.
      if (expected > noise[j]->limit() && (weight > 0 || j + 1 < samples.size())) continue;
      const double w = gain[j] * gain[j] / (*noise[j])(expected);
      sum += w * samples[j].exposure / gain[j];
      weight += w;
    }
    if (weight == 0) {  // only samples at the brink: the start is the best there is
      for (std::size_t j = 0; j < samples.size(); ++j) {
        if (!samples[j].saturated) weight += gain[j] * gain[j] / (*noise[j])(1);
      }
      estimate.variance = 1 / weight;
      return estimate;
    }
    estimate = {sum / weight, 1 / weight};
  }
  return estimate;
}

}  // namespace

Result<RadianceMap> mergeExposures(ExposureBracket bracket, const MergeOptions& options) {
  if (bracket.empty()) {
    return failure(ErrorCode::kInvalidArgument, "the bracket is empty; give at least one frame");
  }
  const Frame& first = bracket[0];
  RETURN_IF_ERROR(checkFrame(first));
  std::optional<SensorModel> plain;
  if (!options.sensor) {
    ASSIGN_OR_RETURN(plain, uncalibratedSensor(first, options.blackLevel));
  }
  const SensorModel& sensor = plain ? *plain : *options.sensor;
  const ResponseCurve& response = sensor.response;

  // Longest effective exposure first.
  struct Exposure {
    const Frame* frame;
    double effective;  // exposure time x gain
  };
  std::vector<Exposure> order;
  for (const Frame& frame : bracket) {
    RETURN_IF_ERROR(checkFrame(frame));
    RETURN_IF_ERROR(sensor.checkFits(frame));
    ASSIGN_OR_RETURN(const double scale, referenceScale(frame.metadata, 1, 0));
    order.push_back({&frame, 1 / scale});
  }
  std::stable_sort(order.begin(), order.end(),
                   [](const auto& a, const auto& b) { return a.effective > b.effective; });
  RadianceMap map;
  const FrameMetadata& shortest = order.back().frame->metadata;
  const bool own = !(options.referenceExposureSeconds > 0);
  map.referenceExposureSeconds = own ? shortest.exposureSeconds : options.referenceExposureSeconds;
  map.referenceGainDb = own ? shortest.gainDb : options.referenceGainDb;

  const int width = first.width;
  const int height = first.height;
  const PixelFormatInfo& info = pixelFormatInfo(first.format);
  const std::size_t frames = order.size();
  const auto colours = static_cast<std::size_t>(response.colours());
  std::vector<double> gain;
  std::vector<std::vector<VarianceTable>> tables(colours);
  for (const Exposure& exposure : order) {
    ASSIGN_OR_RETURN(const double scale,
                     referenceScale(exposure.frame->metadata, map.referenceExposureSeconds,
                                    map.referenceGainDb));
    gain.push_back(1 / scale);
    for (std::size_t c = 0; c < colours; ++c) {
      tables[c].emplace_back(sensor, static_cast<int>(c), exposure.frame->metadata.gainDb);
    }
  }
  std::vector<std::vector<const VarianceTable*>> noise(colours);
  for (std::size_t c = 0; c < colours; ++c) {
    for (const VarianceTable& table : tables[c]) noise[c].push_back(&table);
  }

  SamplePlane plane(first.format, width, height);
  map.saturated = Image<std::uint8_t>(width, height, 1);
  if (options.sigma) map.sigma = Image<float>(width, height, info.channels);
  const CountConverter converter(sensor);
  const auto saturation = static_cast<float>(response.saturationCount());
  tbb::parallel_for(tbb::blocked_range<int>(0, height), [&](const tbb::blocked_range<int>& rows) {
    const std::size_t rowSamples = plane.row(0).size();
    std::vector<float> counts(frames * rowSamples);
    std::vector<float> exposures(frames * rowSamples);
    std::vector<Sample> samples(frames);
    for (int y = rows.begin(); y < rows.end(); ++y) {
      for (std::size_t j = 0; j < frames; ++j) {
        const std::span<float> raw(counts.data() + j * rowSamples, rowSamples);
        const std::span<float> linear(exposures.data() + j * rowSamples, rowSamples);
        readCounts(*order[j].frame, y, raw);
        std::copy(raw.begin(), raw.end(), linear.begin());
        converter.toExposure(y, linear);
      }
      const std::span<float> out = plane.row(y);
      for (std::size_t i = 0; i < rowSamples; ++i) {
        const std::size_t x = i / static_cast<std::size_t>(info.channels);
        const auto colour = static_cast<std::size_t>(
            sampleColour(info, static_cast<int>(x), y, static_cast<int>(i) % info.channels));
        for (std::size_t j = 0; j < frames; ++j) {
          samples[j] = {exposures[j * rowSamples + i], counts[j * rowSamples + i] >= saturation};
        }
        const auto estimate = merge(samples, gain, noise[colour]);
        if (!estimate) map.saturated(static_cast<int>(x), y) = 1;
        out[i] = static_cast<float>(estimate ? estimate->radiance : 1 / gain.back());
        if (options.sigma) {
          map.sigma.row(y)[i] =
              static_cast<float>(estimate ? std::sqrt(estimate->variance) : 1 / gain.back());
        }
      }
    }
  });
  for (const std::uint8_t flag : map.saturated.values()) map.saturatedFraction += flag;
  map.saturatedFraction /= static_cast<double>(width) * height;

  if (sensor.flatField) {
    plane.flatten(*sensor.flatField);
    if (options.sigma) {
      // The error grows with the radiance.
      SamplePlane scatter(first.format, width, height);
      for (int y = 0; y < height; ++y) std::ranges::copy(map.sigma.row(y), scatter.row(y).begin());
      scatter.flatten(*sensor.flatField);
      for (int y = 0; y < height; ++y) std::ranges::copy(scatter.row(y), map.sigma.row(y).begin());
    }
  }
  plane.fill(sensor.hotPixels);
  map.radiance = std::move(plane).toRadiance();
  return map;
}

Result<LinearFrame> mergeBracketFrames(ExposureBracket bracket, const MergeOptions& options) {
  ASSIGN_OR_RETURN(auto map, mergeExposures(bracket, options));
  return LinearFrame{std::move(map.radiance), map.saturatedFraction};
}

}  // namespace lightsketch
