// From what a camera sent to linear radiance.
#pragma once

#include <memory>

#include "calibration/model/sensor_model.h"
#include "capture/frame/frame.h"
#include "capture/frame/image.h"
#include "capture/frame/result.h"

namespace lightsketch {

struct LineariseOptions {
  // What is known of the camera. Without it the sensor is taken to be linear with `blackLevel`.
  std::shared_ptr<const SensorModel> sensor = nullptr;
  double blackLevel = 0;                // in counts of the frame's format; unused with `sensor`
  double referenceExposureSeconds = 0;  // radiance 1.0 is saturation at this exposure and gain;
  double referenceGainDb = 0;           // 0 seconds: the frame's own exposure and gain
};

struct LinearFrame {
  RadianceImage radiance;        // h x w x 3; mono frames are repeated to RGB
  double saturatedFraction = 0;  // pixels with a sample at the format's maximum
};

// Dark frame or black level, response, exposure and gain, flat field, hot pixels, demosaic (Malvar,
// He, Cutler 2004, linear 5x5, on floats; the picture is mirrored at its edges). Values below black
// stay negative, so that means stay unbiased. Fails for a frame whose bytes do not fit its size or
// its sensor model, a black level outside the format's range, or a reference exposure without the
// frame's own. Thread-safe.
Result<LinearFrame> linearise(const Frame& frame, const LineariseOptions& options = {});

// LinearFrame::saturatedFraction alone, at a small part of the cost.
Result<double> saturatedFraction(const Frame& frame, const LineariseOptions& options = {});

// What a frame's exposures (1 is its own saturation) are multiplied by to count in saturations at
// the reference exposure and gain. Fails where the frame's exposure time is unknown.
Result<double> referenceScale(const FrameMetadata& metadata, double referenceExposureSeconds,
                              double referenceGainDb);

}  // namespace lightsketch
