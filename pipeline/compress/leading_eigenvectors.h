// The few eigenvectors of a Gram matrix that hold its energy. Internal to this folder.
#pragma once

#include <span>

#include "pipeline/compress/model.h"

namespace lightsketch {

// Which of a block's basis pictures are kept.
struct RankRule {
  int most = 10;         // b_j at most; 0: no limit
  double threshold = 0;  // and only those whose energy (eigenvalue of A_j A_j^T) is above
};

// b x p, orthonormal rows by falling eigenvalue, of a Gram matrix (p x p, both triangles): subspace
// iteration with Rayleigh and Ritz's projection (Golub & Van Loan, 8.2.4) from a fixed start, until
// a step adds less than a ten-thousandth of the energy that is left out; dsyevr where many are
// wanted, or where the iteration does not settle what is above a threshold. `inPicture` (p): pixels
// that the picture has; rows and columns of the others are zero, and at most as many vectors are
// found.
RowMajorMatrixf leadingEigenvectors(const RowMajorMatrixf& gram, std::span<const bool> inPicture,
                                    const RankRule& rule);

}  // namespace lightsketch
