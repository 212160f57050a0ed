// From what a camera sent to linear radiance.
#pragma once

#include "capture/frame/frame.h"
#include "capture/frame/image.h"
#include "capture/frame/result.h"

namespace lightsketch {

struct LineariseOptions {
  double blackLevel = 0;                // in counts of the frame's format
  double referenceExposureSeconds = 0;  // radiance 1.0 is saturation at this exposure and gain;
  double referenceGainDb = 0;           // 0 seconds: the frame's own exposure and gain
};

struct LinearFrame {
  RadianceImage radiance;        // h x w x 3; mono frames are repeated to RGB
  double saturatedFraction = 0;  // pixels with a sample at the format's maximum
};

// Black level, exposure and gain, demosaic (Malvar, He, Cutler 2004, linear 5x5, on floats; the
// picture is mirrored at its edges). The sensor is taken to be linear. Values below black stay
// negative, so that means stay unbiased. Fails for a frame whose bytes do not fit its size, a black
// level outside the format's range, or a reference exposure without the frame's own. Thread-safe.
Result<LinearFrame> linearise(const Frame& frame, const LineariseOptions& options = {});

}  // namespace lightsketch
