#include "calibration/model/response_curve.h"

#include <algorithm>
#include <cmath>

namespace lightsketch {
namespace {

constexpr std::size_t kMaxNodes = 1 << 16;

}  // namespace

int colourChannels(PixelFormat format) {
  const PixelFormatInfo& info = pixelFormatInfo(format);
  return info.isBayer ? 3 : info.channels;
}

Result<ResponseCurve> ResponseCurve::linear(const std::vector<double>& blackCounts, double maxCount,
                                            double saturationCount) {
  std::vector<std::vector<double>> exposure;
  for (const double black : blackCounts) {
    if (!(black < saturationCount)) {
      return failure(ErrorCode::kInvalidArgument,
                     "response curve: the black level {} is not below saturation ({} counts)",
                     black, saturationCount);
    }
    exposure.push_back({-black, maxCount - black});
  }
  return tabulated(std::move(exposure), maxCount, saturationCount);
}

Result<ResponseCurve> ResponseCurve::tabulated(std::vector<std::vector<double>> exposure,
                                               double maxCount, double saturationCount) {
  if (!(maxCount > 0 && maxCount <= 65535 && saturationCount > 0 && saturationCount <= maxCount)) {
    return failure(ErrorCode::kInvalidArgument,
                   "response curve: saturation at {} of {} counts makes no sense", saturationCount,
                   maxCount);
  }
  if (exposure.size() != 1 && exposure.size() != 3) {
    return failure(ErrorCode::kInvalidArgument, "response curve: {} colours, expected 1 or 3",
                   exposure.size());
  }
  for (const auto& table : exposure) {
    if (table.size() < 2 || table.size() > kMaxNodes || table.size() != exposure[0].size()) {
      return failure(ErrorCode::kInvalidArgument,
                     "response curve: every colour needs the same number of nodes, 2 to {}",
                     kMaxNodes);
    }
    for (std::size_t i = 0; i < table.size(); ++i) {
      if (!std::isfinite(table[i]) || (i > 0 && !(table[i] > table[i - 1]))) {
        return failure(ErrorCode::kInvalidArgument,
                       "response curve: exposure does not rise from node {} to node {}",
                       i > 0 ? i - 1 : 0, i);
      }
    }
  }
  ResponseCurve curve;
  curve.exposure_ = std::move(exposure);
  curve.maxCount_ = maxCount;
  curve.saturationCount_ = saturationCount;
  for (int colour = 0; colour < curve.colours(); ++colour) {
    const double top = curve.exposure(saturationCount, colour);
    if (!(top > 0)) {
      return failure(ErrorCode::kInvalidArgument,
                     "response curve: no light where the sensor saturates");
    }
    for (double& value : curve.exposure_[static_cast<std::size_t>(colour)]) value /= top;
  }
  return curve;
}

std::size_t ResponseCurve::segment(double position) const {
  const double last = static_cast<double>(exposure_[0].size() - 2);
  return static_cast<std::size_t>(std::clamp(std::floor(position), 0.0, last));
}

double ResponseCurve::exposure(double count, int colour) const {
  const auto& table = exposure_[static_cast<std::size_t>(colour)];
  const double position = count / maxCount_ * static_cast<double>(table.size() - 1);
  const std::size_t i = segment(position);
  return table[i] + (position - static_cast<double>(i)) * (table[i + 1] - table[i]);
}

double ResponseCurve::slope(double count, int colour) const {
  const auto& table = exposure_[static_cast<std::size_t>(colour)];
  const double nodesPerCount = static_cast<double>(table.size() - 1) / maxCount_;
  const std::size_t i = segment(count * nodesPerCount);
  return (table[i + 1] - table[i]) * nodesPerCount;
}

double ResponseCurve::count(double exposure, int colour) const {
  const auto& table = exposure_[static_cast<std::size_t>(colour)];
  const auto above = std::upper_bound(table.begin() + 1, table.end() - 1, exposure);
  const auto i = static_cast<std::size_t>(above - table.begin()) - 1;
  return (static_cast<double>(i) + (exposure - table[i]) / (table[i + 1] - table[i])) * maxCount_ /
         static_cast<double>(table.size() - 1);
}

Json ResponseCurve::toJson() const {
  return {{"maxCount", maxCount_}, {"saturationCount", saturationCount_}, {"exposure", exposure_}};
}

Result<ResponseCurve> ResponseCurve::fromJson(const Json& json, std::string_view where) {
  ASSIGN_OR_RETURN(const double maxCount, jsonNumber(json, "maxCount", where));
  ASSIGN_OR_RETURN(const double saturationCount, jsonNumber(json, "saturationCount", where));
  ASSIGN_OR_RETURN(const Json* tables, jsonMember(json, "exposure", where));
  if (!tables->is_array() || tables->size() > 3) {
    return failure(ErrorCode::kCorrupt, "{}: field 'exposure' is not an array of 1 or 3 tables",
                   where);
  }
  std::vector<std::vector<double>> exposure;
  for (const Json& table : *tables) {
    const int nodes = table.is_array() && table.size() <= kMaxNodes ? static_cast<int>(table.size())
                                                                    : 2;  // jsonVector complains
    ASSIGN_OR_RETURN(const auto values,
                     jsonVector(Json{{"exposure", table}}, "exposure", nodes, where));
    exposure.emplace_back(values.begin(), values.end());
  }
  auto curve = tabulated(std::move(exposure), maxCount, saturationCount);
  if (!curve) return failure(ErrorCode::kCorrupt, "{}: {}", where, curve.error().message);
  return curve;
}

}  // namespace lightsketch
