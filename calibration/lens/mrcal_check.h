// A second opinion: mrcal's splined stereographic lens solved from the same corners. It shares with
// ours the corners and where it starts, not the lens equation and not the solver.
#pragma once

#include <string>
#include <vector>

#include "calibration/lens/lens_calibration.h"
#include "capture/frame/angle.h"
#include "capture/frame/result.h"

namespace lightsketch {

struct MrcalCheckOptions {
  int knots = 16;  // each way; more follow the noise
  Result<void> validate() const;
};

struct MrcalCheck {
  std::string lens;  // "LENSMODEL_SPLINED_STEREOGRAPHIC_..."
  // Between the two lenses, after the best rotation, over the covered field.
  Angle rms;
  Angle largest;
  std::vector<Angle> byFieldAngle;  // rms per 5 degrees of field angle, from 0; NaN where uncovered
  double residualPixels = 0;        // mrcal's, rms per coordinate
  double solveSeconds = 0;
  std::string cameraModel;  // mrcal's lens, the text of a .cameramodel file
};

// `board`: as given to calibrateLens(). Corners that it threw out stay out. A moving pupil is
// beyond mrcal and shows as a difference. Fails where mrcal does not converge. Thread-safe.
Result<MrcalCheck> checkWithMrcal(const LensCalibration& calibration, const BoardGeometry& board,
                                  const MrcalCheckOptions& options = {});

}  // namespace lightsketch
