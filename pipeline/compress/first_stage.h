// Stage 1 over all blocks of a picture. Internal to this folder.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/compress/compress.h"
#include "pipeline/compress/densify.h"
#include "pipeline/compress/large_matrix.h"
#include "pipeline/compress/leading_eigenvectors.h"
#include "pipeline/compress/model.h"
#include "pipeline/compress/scratch_stack.h"

namespace lightsketch {

// One block: the best basis E of its pixels (Eckart and Young) and the block in it, L = E A.
struct BlockFactors {
  RowMajorMatrixf E;              // b x p, by falling energy
  RowMajorMatrixf L;              // b x columns
  std::vector<double> rowEnergy;  // b: of each row of L, sum of squares
  double energy = 0;              // of A
};

// `columns` is A column by column: one light and channel after the other, p values each, half
// floats or floats. `inPicture` (p): pixels that the picture has; the others are zero in `columns`.
// A block at full rank keeps its pixels as they are and loses nothing. One core.
BlockFactors factoriseBlock(std::span<const std::uint16_t> columns, std::span<const bool> inPicture,
                            const RankRule& rule);
BlockFactors factoriseBlock(std::span<const float> columns, std::span<const bool> inPicture,
                            const RankRule& rule);

struct FirstStage {
  std::vector<std::int64_t> blockOffset;  // m + 1: b_j is what lies between
  RowMajorMatrixf E;                      // rows x p, by falling energy within a block
  LargeMatrix L;                          // rows x 3N
  std::vector<double> rowEnergy;          // of each row of L: its sum of squares, an eigenvalue
  double energy = 0;                      // of the pictures: sum of squares
};

// Each block is read once. Uses all cores, as far as the blocks being worked on fit into a quarter
// of `memoryBytes` (one is, whatever it takes); half of it is for L, which goes to a file beside
// the scratch stack where it is larger. E comes on top. The result does not depend
// on the number of cores.
Result<FirstStage> firstStage(const ScratchStack& scratch, const Densifier& densifier,
                              const BlockLayout& layout, const RankRule& rule,
                              std::size_t memoryBytes, Progress& progress,
                              const CompressWatch& watch = {});

}  // namespace lightsketch
