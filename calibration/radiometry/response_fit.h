// The solver behind calibrateResponse(): one response per colour from pixels seen at several
// exposures.
#pragma once

#include <array>
#include <vector>

#include "capture/frame/result.h"

namespace lightsketch {

// What the brackets say of some thousand places of the scene. Counts are fractions of the format's
// largest here, so that one set of numbers serves 8 to 16 bits.
struct ResponseSamples {
  struct Place {
    int colour;
    int bracket;
    std::vector<double> values;  // one per exposure of the bracket, means over its frames
  };
  struct Exposure {
    double seconds;  // nominal
    int frames;      // that were averaged
  };
  // Where there is no light: a measured value, or a guess with a generous sigma.
  struct Black {
    double value;
    double sigma;
    bool clipped;  // noise reaches down to 0, so values near black are no means
  };

  int colours = 1;
  double step = 1.0 / 255;  // one count
  double saturation = 1;
  std::vector<Black> black;                      // per colour
  std::vector<std::vector<Exposure>> exposures;  // per bracket
  std::vector<Place> places;
};

struct ResponseFitOptions {
  bool linear = false;         // a straight line and its black level instead of a curve
  bool estimateTimes = false;  // true exposure times beside the nominal ones
};

struct ResponseFit {
  static constexpr int kNodes = 1025;
  static constexpr int kKnots = 33;  // of ln(slope), even in the root of the value
  // Relative errors mean nothing at black: they are given from this exposure on.
  static constexpr double kDarkest = 0.003;
  struct Curve {
    double origin = 0;             // value of the first node; the curve goes on straight below
    std::vector<double> exposure;  // at the nodes; 1 at saturation
    std::vector<double>
        logSigma;      // one sigma of ln(exposure) from kDarkest on, a common factor aside
    double black = 0;  // value of no light
    double blackSigma = 0;
    double lowest = 0, highest = 0;  // values that samples of this fit reach

    // Nodes are even in the root of what the value exceeds the origin by: curves bend near black.
    double nodeValue(int node) const;
    double exposureAt(double value) const;
  };
  struct Residual {
    int colour;
    double value;  // as the fit predicts it
    double error;  // seen minus predicted
  };
  std::vector<Curve> curves;
  std::vector<std::vector<double>> timeErrors;  // ln(true / nominal) per bracket and exposure
  std::vector<Residual> residuals;
  double spread = 0;       // root mean square of the residuals, outliers limited to 5 sigma
  double disagreeing = 0;  // share of the places that contradict themselves over the exposures
  int iterations = 0;
  // Noise of a single frame, one sigma, at a value; from the residuals.
  double noiseSigma(int colour, double value) const;

  static constexpr int kNoiseBins = 24;
  std::vector<std::array<double, kNoiseBins>> noiseBins;  // per colour, even in the root of value
};

// Maximum likelihood in the domain where the noise lives: with f the curve, E a place's exposure
// rate and t a time, every sample is  value = f^-1(E t) + noise(value).  f is the integral of
// exp(q), q piecewise linear with a smoothness prior: monotone by construction. E, f, and the times
// where asked for, are solved together by Gauss-Newton, E eliminated (Schur complement); samples
// near the clipping levels are judged by their predicted value. Fails where too few places have two
// usable exposures.
Result<ResponseFit> fitResponse(const ResponseSamples& samples, const ResponseFitOptions& options);

}  // namespace lightsketch
