// All that turns one camera's counts into radiance, as one value.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calibration/model/flat_field.h"
#include "calibration/model/noise_model.h"
#include "calibration/model/response_curve.h"
#include "capture/frame/frame.h"
#include "capture/frame/image.h"
#include "capture/frame/json.h"
#include "capture/frame/result.h"

namespace lightsketch {

struct PixelPosition {
  int x = 0;
  int y = 0;
  bool operator==(const PixelPosition&) const = default;
};

struct SensorModel {
  PixelFormat format = PixelFormat::kMono8;
  int width = 0;
  int height = 0;
  ResponseCurve response;
  NoiseModel noise;
  std::vector<PixelPosition> hotPixels;  // to be filled from their neighbours
  // Mean counts of every sample without light; its mean is the response's black level. Empty: the
  // black level alone is taken off.
  Image<float> darkCounts;
  double darkExposureSeconds = 0;  // at which the dark frame was taken
  std::optional<FlatField> flatField;

  // Fails with a line for the user where the model is another camera's.
  Result<void> checkFits(const Frame& frame) const;
};

// Our response file: JSON, "format": "lightsketch-response", "formatVersion": 1. The dark frame
// lies beside it as a picture (calibration/radiometry/response_file.h reads and writes both).
Json sensorModelToJson(const SensorModel& sensor);
Result<SensorModel> sensorModelFromJson(const Json& json, std::string_view where);

}  // namespace lightsketch
