#include "calibration/model/sensor_model.h"

namespace lightsketch {
namespace {

constexpr std::string_view kFormat = "lightsketch-response";
constexpr int kFormatVersion = 1;

}  // namespace

Result<void> SensorModel::checkFits(const Frame& frame) const {
  if (frame.format != format || frame.width != width || frame.height != height) {
    return failure(ErrorCode::kInvalidArgument,
                   "frame {}: {} x {} {}, but the response was calibrated for {} x {} {}; "
                   "calibrate with the camera's present settings",
                   frame.metadata.id, frame.width, frame.height, pixelFormatInfo(frame.format).name,
                   width, height, pixelFormatInfo(format).name);
  }
  return {};
}

Json sensorModelToJson(const SensorModel& sensor) {
  Json hot = Json::array();
  for (const PixelPosition& pixel : sensor.hotPixels) hot.push_back({pixel.x, pixel.y});
  Json json = {{"format", kFormat},
               {"formatVersion", kFormatVersion},
               {"pixelFormat", pixelFormatInfo(sensor.format).name},
               {"width", sensor.width},
               {"height", sensor.height},
               {"response", sensor.response.toJson()},
               {"noise", sensor.noise.toJson()},
               {"hotPixels", hot}};
  if (sensor.flatField) json["flatField"] = sensor.flatField->toJson();
  return json;
}

Result<SensorModel> sensorModelFromJson(const Json& json, std::string_view where) {
  RETURN_IF_ERROR(checkFormat(json, kFormat, kFormatVersion, where));
  ASSIGN_OR_RETURN(const auto formatName, jsonString(json, "pixelFormat", where));
  const auto format = pixelFormatFromName(formatName);
  if (!format) {
    return failure(ErrorCode::kUnsupported, "{}: unknown pixel format '{}'", where, formatName);
  }
  ASSIGN_OR_RETURN(const auto width, jsonInteger(json, "width", where, 1, 100'000));
  ASSIGN_OR_RETURN(const auto height, jsonInteger(json, "height", where, 1, 100'000));
  ASSIGN_OR_RETURN(const Json* curve, jsonMember(json, "response", where));
  ASSIGN_OR_RETURN(auto response, ResponseCurve::fromJson(*curve, where));
  ASSIGN_OR_RETURN(const Json* scatter, jsonMember(json, "noise", where));
  ASSIGN_OR_RETURN(auto noise, NoiseModel::fromJson(*scatter, where));
  SensorModel sensor;
  sensor.format = *format;
  sensor.width = static_cast<int>(width);
  sensor.height = static_cast<int>(height);
  sensor.response = std::move(response);
  sensor.noise = std::move(noise);
  const auto colours = static_cast<std::size_t>(colourChannels(*format));
  if (static_cast<std::size_t>(sensor.response.colours()) != colours ||
      (sensor.noise.channels.size() != 1 && sensor.noise.channels.size() != colours) ||
      sensor.response.maxCount() != (1 << pixelFormatInfo(*format).bits) - 1) {
    return failure(ErrorCode::kCorrupt, "{}: the curve does not belong to {}", where, formatName);
  }
  ASSIGN_OR_RETURN(const Json* hot, jsonMember(json, "hotPixels", where));
  if (!hot->is_array()) {
    return failure(ErrorCode::kCorrupt, "{}: field 'hotPixels' is not an array", where);
  }
  for (const Json& entry : *hot) {
    ASSIGN_OR_RETURN(const auto place,
                     jsonVector(Json{{"hotPixels", entry}}, "hotPixels", 2, where));
    if (!(place[0] >= 0 && place[0] < sensor.width && place[1] >= 0 && place[1] < sensor.height)) {
      return failure(ErrorCode::kCorrupt, "{}: hot pixel ({}, {}) lies outside the picture", where,
                     place[0], place[1]);
    }
    sensor.hotPixels.push_back({static_cast<int>(place[0]), static_cast<int>(place[1])});
  }
  if (json.contains("flatField")) {
    ASSIGN_OR_RETURN(sensor.flatField, FlatField::fromJson(json["flatField"], where));
    if (static_cast<std::size_t>(sensor.flatField->colours()) != colours) {
      return failure(ErrorCode::kCorrupt, "{}: the flat field does not belong to {}", where,
                     formatName);
    }
  }
  return sensor;
}

}  // namespace lightsketch
