// The two singular value decompositions behind a model. Internal to this folder.
#pragma once

#include <cstdint>
#include <span>

#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/compress/model.h"

namespace lightsketch {

// One core for each BLAS call while this lives: the callers are parallel themselves.
class SingleThreadedBlas {
 public:
  SingleThreadedBlas();
  ~SingleThreadedBlas();
  SingleThreadedBlas(const SingleThreadedBlas&) = delete;
  SingleThreadedBlas& operator=(const SingleThreadedBlas&) = delete;

 private:
  int before_;
};

// Stage 1 on one block: the best b-dimensional basis E of its pixels (Eckart and Young) and the
// block in it, L = E A. `columns` is A column by column: one light and channel after the other, p
// pixels each. `inPicture` (p values): pixels that the picture has; the others are zero in
// `columns`. Fills E (b x p) and L (b x columns), both row-major; b is at most the number of pixels
// in the picture, for which E merely picks them and loses nothing.
void factoriseBlock(std::span<const float> columns, std::span<const bool> inPicture, int b,
                    float* E, float* L);

struct SecondStage {
  RowMajorMatrixf U;       // rows x q
  RowMajorMatrixf V;       // q x columns
  double keptEnergy = 0;   // squared Frobenius norm of U V
  double totalEnergy = 0;  // of L
  bool exact = false;
};

enum class SecondStageMethod { kAuto, kExact, kRandomised };

// Stage 2: the best factorisation of rank q, L ~ U V. Exact, through the Gram matrix of L's smaller
// side in double precision, or randomised with two power iterations (Halko, Martinsson, Tropp 2011,
// algorithms 4.4 and 5.1) where q is a small part of that side. At full rank L itself is one factor
// and an identity the other, unless kExact insists. Uses all cores.
Result<SecondStage> factoriseAll(RowMajorMatrixf L, int q, SecondStageMethod method,
                                 Progress& progress);

}  // namespace lightsketch
