// From pictures of a still scene to what a camera's counts mean: response, noise, dark, flat field.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "calibration/model/sensor_model.h"
#include "capture/frame/frame.h"
#include "capture/frame/progress.h"
#include "capture/frame/result.h"

namespace lightsketch {

struct ResponseInput {
  // Each of one still scene under steady light from one pose; exposure times in the metadata, any
  // order. Two or more frames of an exposure give the photon-transfer noise. All of one camera,
  // size, format and gain.
  std::vector<std::span<const Frame>> brackets;
  std::span<const Frame> darkFrames;  // lens covered; may be empty
  std::span<const Frame> flatFrames;  // of an evenly lit diffuser, one exposure; may be empty
};

struct ResponseOptions {
  // A sensor whose curve stays this close to a straight line, as a fraction of full scale, is taken
  // to be linear.
  double linearTolerance = 0.01;
  int placesPerColour = 1500;  // of the scene that the curve is solved from
  double hotPixelSigmas = 8;   // over the dark frame's own scatter
  int flatColumns = 25;        // nodes of the flat field; rows follow from the picture's shape

  Result<void> validate() const;
};

// What is known about the result, per colour where it differs. Counts unless said otherwise.
struct ResponseSummary {
  struct Colour {
    std::string name;  // "grey", "red", ...
    double blackCount = 0;
    double blackSigma = 0;
    bool blackClipped = false;   // the camera cuts noise off at 0: its true black is not seen
    double linearDeviation = 0;  // largest, as a fraction of full scale
    double residual = 0;         // root mean square of seen minus predicted count
    double lowestCount = 0, highestCount = 0;  // reached by the samples; beyond it is extrapolated
    double curveSigma = 0;                     // median one sigma of ln(exposure) between these
    double electronsSigma = 0;                 // of the noise model's figures; 0 where not measured
    double readNoiseSigma = 0;
    double flatSigma = 0;   // of a node of the flat field, fraction
    double flatLowest = 1;  // the flat field's darkest node
  };
  struct Exposure {
    int bracket = 0;
    double seconds = 0;
    int frames = 0;
    double timeError = 0;  // true / nominal - 1
  };
  struct Point {  // of the report's plots
    int colour;
    double x;
    double y;
  };
  std::vector<Colour> colours;
  std::vector<Exposure> exposures;
  bool linear = false;
  bool timesEstimated = false;  // exposure times were found to differ from the nominal ones
  bool noiseFromPairs = false;  // photon transfer; otherwise from the curve's residuals
  double disagreeing = 0;       // share of the places that contradict themselves
  int places = 0;
  int darkFrames = 0;
  int flatFrames = 0;
  std::vector<Point> residuals;       // x: predicted count, y: seen minus predicted
  std::vector<Point> photonTransfer;  // x: exposure, y: its variance without rounding's

  // For a terminal: a few lines.
  std::string text(const SensorModel& sensor) const;
};

struct ResponseCalibration {
  SensorModel sensor;
  ResponseSummary summary;
};

// Fails with one line that says what to do: a single exposure time, everything saturated or black,
// frames of different cameras, a scene that moved, too few levels. Thread-safe.
Result<ResponseCalibration> calibrateResponse(const ResponseInput& input,
                                              const ResponseOptions& options = {},
                                              Progress* progress = nullptr);

}  // namespace lightsketch
