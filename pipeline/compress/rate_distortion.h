// Bits where they buy most: which basis pictures and singular values are kept, and how finely every
// number is rounded, from one parameter. Internal to this folder.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/compress/first_stage.h"
#include "pipeline/compress/packed_code.h"

namespace lightsketch {

// The parameter is `noise`: the squared error, summed over all pictures, that rounding puts into
// them per stored number. At high rate a bit less for a number costs 2 ln 2 times that, whichever
// number it is (Cover & Thomas, 10.3: reverse water-filling); basis pictures and singular values
// are dropped where they would buy less.

// Energy that a row of L needs to be worth its basis picture of p pixels.
double rowThreshold(double noise, int pixelsPerBlock);
// Squared singular value that a column of U and V needs.
double rankThreshold(double noise);
// How many squared singular values of L lie above `threshold`, estimated from some of its columns;
// never more than its smaller side.
int estimateRank(const LargeMatrix& L, double threshold);

// Both stages, finer than any code that is to be made from them.
class RateDistortion {
 public:
  // U and V as SecondStage, V's rows orthogonal. Uses all cores.
  RateDistortion(const BlockLayout& layout, std::vector<std::int64_t> blockOffset,
                 const RowMajorMatrixf& E, const std::vector<double>& rowEnergy, RowMajorMatrixf U,
                 RowMajorMatrixf V);

  // The code of this noise. Basis pictures are rounded first, then the rest is fitted to what they
  // became, U rounded and V fitted to that: no error is handed on. Where nothing is worth its bits,
  // one row of zeros. Uses all cores.
  std::shared_ptr<const PackedCode> encode(double noise) const;

 private:
  BlockLayout layout_;
  std::vector<std::int64_t> blockOffset_;
  RowMajorMatrixf coefficients_;  // rows x p: DCT of E
  std::vector<double> rowEnergy_;
  RowMajorMatrixf U_;  // rows x q
  RowMajorMatrixf V_;  // q x 3n, orthonormal rows, opponent colours
};

// What a search for a noise is after: a quantity that falls with the noise.
struct NoiseTarget {
  double least = 0;  // anything from here to `most` will do
  double most = 0;
  double perOctave = 1;   // what an octave of noise takes from it, roughly
  bool overshoot = true;  // where it jumps across: more than `most` rather than less than `least`
};

// The noise, from `finest` to `coarsest`, for which `quantity` is what the target says, or comes
// closest from the side it says, to a 256th of an octave; `finest` or `coarsest` where it lies
// beyond. By false position and bisection from `start`.
Result<double> noiseFor(const NoiseTarget& target, double start, double finest, double coarsest,
                        const std::function<Result<double>(double)>& quantity);

}  // namespace lightsketch
