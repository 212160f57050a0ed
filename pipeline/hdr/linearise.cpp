#include "pipeline/hdr/linearise.h"

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "pipeline/hdr/sample_plane.h"

namespace lightsketch {
namespace {

std::size_t index(int value) { return static_cast<std::size_t>(value); }

std::size_t countSaturated(const Frame& frame, int maximum) {
  const PixelFormatInfo& info = pixelFormatInfo(frame.format);
  const std::size_t pixels = index(frame.width) * index(frame.height);
  const std::uint8_t* in = frame.bytes.data();
  std::size_t count = 0;
  if (info.channels == 3) {
    for (std::size_t i = 0; i < pixels; ++i) {
      const std::uint8_t* rgb = in + 3 * i;
      count += ((rgb[0] >= maximum) | (rgb[1] >= maximum) | (rgb[2] >= maximum)) ? 1 : 0;
    }
  } else if (info.bits <= 8) {
    for (std::size_t i = 0; i < pixels; ++i) count += in[i] >= maximum ? 1 : 0;
  } else {
    for (std::size_t i = 0; i < pixels; ++i) {
      count += (in[2 * i] | (in[2 * i + 1] << 8)) >= maximum ? 1 : 0;
    }
  }
  return count;
}

double fractionSaturated(const Frame& frame, const SensorModel& sensor) {
  const auto top = static_cast<int>(std::ceil(sensor.response.saturationCount()));
  return static_cast<double>(countSaturated(frame, top)) /
         (static_cast<double>(frame.width) * frame.height);
}

// The sensor that `options` name, or one that `plain` then holds.
Result<const SensorModel*> sensorOf(const Frame& frame, const LineariseOptions& options,
                                    std::optional<SensorModel>& plain) {
  RETURN_IF_ERROR(checkFrame(frame));
  if (options.sensor) {
    RETURN_IF_ERROR(options.sensor->checkFits(frame));
    return options.sensor.get();
  }
  ASSIGN_OR_RETURN(plain, uncalibratedSensor(frame, options.blackLevel));
  return &*plain;
}

}  // namespace

Result<double> referenceScale(const FrameMetadata& metadata, double referenceExposureSeconds,
                              double referenceGainDb) {
  if (!(metadata.exposureSeconds > 0)) {
    return failure(ErrorCode::kInvalidArgument,
                   "frame {}: its exposure time is unknown, so it cannot be brought to the "
                   "reference exposure",
                   metadata.id);
  }
  return referenceExposureSeconds / metadata.exposureSeconds *
         std::pow(10.0, (referenceGainDb - metadata.gainDb) / 20);
}

Result<double> saturatedFraction(const Frame& frame, const LineariseOptions& options) {
  std::optional<SensorModel> plain;
  ASSIGN_OR_RETURN(const SensorModel* const sensor, sensorOf(frame, options, plain));
  return fractionSaturated(frame, *sensor);
}

Result<LinearFrame> linearise(const Frame& frame, const LineariseOptions& options) {
  std::optional<SensorModel> plain;
  ASSIGN_OR_RETURN(const SensorModel* const used, sensorOf(frame, options, plain));
  const SensorModel& sensor = *used;
  double scale = 1;
  if (options.referenceExposureSeconds > 0) {
    ASSIGN_OR_RETURN(scale, referenceScale(frame.metadata, options.referenceExposureSeconds,
                                           options.referenceGainDb));
  }

  LinearFrame result;
  result.saturatedFraction = fractionSaturated(frame, sensor);
  SamplePlane plane(frame.format, frame.width, frame.height);
  const CountConverter converter(sensor, scale);
  for (int y = 0; y < frame.height; ++y) {
    const std::span<float> row = plane.row(y);
    readCounts(frame, y, row);
    converter.toExposure(y, row);
  }
  if (sensor.flatField) plane.flatten(*sensor.flatField);
  plane.fill(sensor.hotPixels);
  result.radiance = std::move(plane).toRadiance();
  return result;
}

}  // namespace lightsketch
