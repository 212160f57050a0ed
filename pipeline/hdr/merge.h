// Several exposures of one still scene to one picture of high dynamic range.
#pragma once

#include <cstdint>
#include <memory>
#include <span>

#include "calibration/model/sensor_model.h"
#include "capture/frame/frame.h"
#include "capture/frame/image.h"
#include "capture/frame/result.h"
#include "pipeline/hdr/linearise.h"

namespace lightsketch {

// Frames of one camera from one pose; exposure times and gains in their metadata, any order, any
// number, also several of the same exposure.
using ExposureBracket = std::span<const Frame>;

struct MergeOptions {
  // What is known of the camera. Without it the sensor is taken to be linear with `blackLevel` and
  // NoiseModel's default noise.
  std::shared_ptr<const SensorModel> sensor = nullptr;
  double blackLevel = 0;
  double referenceExposureSeconds = 0;  // radiance 1.0 is saturation at this exposure and gain;
  double referenceGainDb = 0;           // 0 seconds: those of the shortest effective exposure
  bool sigma = false;                   // also estimate the error of every sample
};

struct RadianceMap {
  RadianceImage radiance;  // h x w x 3; mono is repeated to RGB
  // One sigma of the noise of each sample of the sensor, in units of radiance: h x w, Bayer sites
  // in place, before the demosaic; h x w x 3 of RGB formats. Empty unless asked for.
  Image<float> sigma;
  // h x w: 1 where a sample was saturated in every frame; its radiance is the lower bound that the
  // shortest exposure sets.
  Image<std::uint8_t> saturated;
  double saturatedFraction = 0;
  double referenceExposureSeconds = 0;  // and gain, that radiance 1.0 stands for
  double referenceGainDb = 0;
};

// Inverse-variance weighted mean of what the unsaturated exposures say of each sample (Poisson,
// read noise and rounding), before the demosaic. The variances follow from the estimate, not from
// the noisy sample, which would favour samples that happen to be dark. Hasinoff, Durand and Freeman
// 2010, "Noise-optimal capture for high dynamic range photography", eq. 5; Hanji, Zhong and Mantiuk
// 2020. Fails for an empty bracket, unknown exposure times or frames that differ in size or format.
// Thread-safe; spreads over the processors.
Result<RadianceMap> mergeExposures(ExposureBracket bracket, const MergeOptions& options = {});

// The same as linearise() returns it for one frame, for recorders that take either.
Result<LinearFrame> mergeBracketFrames(ExposureBracket bracket, const MergeOptions& options = {});

}  // namespace lightsketch
