// Stage 1 over all blocks of a picture. Internal to this folder.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/compress/densify.h"
#include "pipeline/compress/model.h"
#include "pipeline/compress/scratch_stack.h"

namespace lightsketch {

// Which of a block's basis pictures are kept.
struct RankRule {
  int most = 10;         // b_j at most; 0: no limit
  double threshold = 0;  // and only those whose energy (eigenvalue of A_j A_j^T) is above
};

struct FirstStage {
  std::vector<std::int64_t> blockOffset;  // m + 1: b_j is what lies between
  RowMajorMatrixf E;                      // rows x p, by falling energy within a block
  RowMajorMatrixf L;                      // rows x 3N
  std::vector<double> rowEnergy;          // of each row of L: its eigenvalue
  double energy = 0;                      // of the pictures: sum of squares
};

// Each block is read once. Uses all cores and at most `memoryBytes` besides its result.
Result<FirstStage> firstStage(const ScratchStack& scratch, const Densifier& densifier,
                              const BlockLayout& layout, const RankRule& rule,
                              std::size_t memoryBytes, Progress& progress);

}  // namespace lightsketch
