#include "calibration/model/noise_model.h"

#include <algorithm>
#include <cmath>

namespace lightsketch {

double NoiseModel::exposureVariance(double exposure, double exposurePerCount, int colour,
                                    double atGainDb) const {
  const ChannelNoise& noise = channel(colour);
  const double electrons = noise.electronsAtSaturation * std::pow(10.0, -(atGainDb - gainDb) / 20);
  return (std::max(exposure, 0.0) +
          noise.readNoiseElectrons * noise.readNoiseElectrons / electrons) /
             electrons +
         exposurePerCount * exposurePerCount / 12;
}

double NoiseModel::countVariance(double count, const ResponseCurve& response, int colour) const {
  const double slope = response.slope(count, colour);
  return exposureVariance(response.exposure(count, colour), slope, colour, gainDb) /
         (slope * slope);
}

double NoiseModel::countsPerElectron(const ResponseCurve& response, int colour) const {
  return 1 / (channel(colour).electronsAtSaturation *
              response.slope(response.blackCount(colour), colour));
}

Json NoiseModel::toJson() const {
  Json list = Json::array();
  for (const ChannelNoise& noise : channels) {
    list.push_back({{"electronsAtSaturation", noise.electronsAtSaturation},
                    {"readNoiseElectrons", noise.readNoiseElectrons}});
  }
  return {{"gainDb", gainDb}, {"channels", list}};
}

Result<NoiseModel> NoiseModel::fromJson(const Json& json, std::string_view where) {
  NoiseModel model;
  ASSIGN_OR_RETURN(model.gainDb, jsonNumber(json, "gainDb", where));
  ASSIGN_OR_RETURN(const Json* list, jsonMember(json, "channels", where));
  if (!list->is_array() || (list->size() != 1 && list->size() != 3)) {
    return failure(ErrorCode::kCorrupt, "{}: field 'channels' is not an array of 1 or 3", where);
  }
  model.channels.clear();
  for (const Json& entry : *list) {
    ChannelNoise noise;
    ASSIGN_OR_RETURN(noise.electronsAtSaturation,
                     jsonNumber(entry, "electronsAtSaturation", where));
    ASSIGN_OR_RETURN(noise.readNoiseElectrons, jsonNumber(entry, "readNoiseElectrons", where));
    if (!(noise.electronsAtSaturation > 0 && noise.readNoiseElectrons >= 0)) {
      return failure(ErrorCode::kCorrupt, "{}: a noise channel has no electrons", where);
    }
    model.channels.push_back(noise);
  }
  return model;
}

}  // namespace lightsketch
