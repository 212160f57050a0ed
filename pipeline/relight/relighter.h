// Draws a relightable model under any light.
#pragma once

#include "capture/frame/image.h"
#include "capture/frame/result.h"
#include "pipeline/compress/model.h"
#include "pipeline/illumination/illumination.h"

namespace lightsketch {

// Linear RGB picture under intensities s (n x 3): E^T (U (V s)). Fails if s does not fit. Not
// clipped: small negative values can occur. Thread-safe; uses all cores.
Result<RadianceImage> relight(const RelightableModel& model, const LightIntensities& intensities);

}  // namespace lightsketch
