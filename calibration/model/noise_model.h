// How far a camera's samples scatter: photons, read-out, rounding.
#pragma once

#include <string_view>
#include <vector>

#include "calibration/model/response_curve.h"
#include "capture/frame/json.h"
#include "capture/frame/result.h"

namespace lightsketch {

struct ChannelNoise {
  double electronsAtSaturation = 10'000;  // at the model's gain
  double readNoiseElectrons = 10;
};

// The photon-transfer model (Janesick 2007; EMVA 1288 release 4, section 2): electrons are
// Poisson, read-out adds a constant variance, rounding to counts adds 1/12 count^2. The default is
// a plain small sensor, for cameras that nobody has measured.
struct NoiseModel {
  double gainDb = 0;                      // at which it was measured
  std::vector<ChannelNoise> channels{1};  // one for all colours, or one a colour

  const ChannelNoise& channel(int colour) const {
    return channels[channels.size() > 1 ? static_cast<std::size_t>(colour) : 0];
  }
  // Variance of the exposure (1 is saturation at `atGainDb`) that a sample of mean `exposure`
  // shows, where one count is worth `exposurePerCount`. Amplification by g turns 1/g of the
  // electrons into saturation.
  double exposureVariance(double exposure, double exposurePerCount, int colour,
                          double atGainDb) const;
  // The same in counts^2, at the model's own gain.
  double countVariance(double count, const ResponseCurve& response, int colour) const;
  // Counts of one electron, where the response is linear or at its black level.
  double countsPerElectron(const ResponseCurve& response, int colour) const;

  Json toJson() const;
  static Result<NoiseModel> fromJson(const Json& json, std::string_view where);
};

}  // namespace lightsketch
