// Stage 2: all blocks' coefficients in one factorisation. Internal to this folder.
#pragma once

#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/compress/large_matrix.h"
#include "pipeline/compress/model.h"

namespace lightsketch {

struct SecondStage {
  RowMajorMatrixf U;       // rows x q, columns by falling singular value
  RowMajorMatrixf V;       // q x columns
  double keptEnergy = 0;   // squared Frobenius norm of U V
  double totalEnergy = 0;  // of L
  bool exact = false;
  // If not exact: products of L with so many columns, and the fall of the error (dB) that more of
  // them would bring, as the last ones' gains let expect.
  int passes = 0;
  int width = 0;
  double leftToGain = 0;
};

enum class SecondStageMethod {
  kAuto,
  kExact,
  kRandomised,
  kSpan,  // randomised, and as soon as there are q directions: those well above the last are exact
};

// The best factorisation of rank q, L ~ U V. Exact, through the Gram matrix of L's smaller side in
// double precision, or randomised where q is a small part of that side: block Krylov iteration
// (Musco & Musco 2015) from a sketch of L's rows (Clarkson & Woodruff 2013) that goes on until the
// error would fall by less than 0.01 dB. At full rank L itself is one factor and
// an identity the other, unless kExact insists. Of an L without rows: zeros. Uses all cores; the
// result does not depend on their number.
Result<SecondStage> factoriseAll(LargeMatrix L, int q, SecondStageMethod method,
                                 Progress& progress);

}  // namespace lightsketch
