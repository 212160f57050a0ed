// Internal to calibration/lens: lenses solved from random halves of the views, against each other
// and against the views that they did not see.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "calibration/lens/lens_solver.h"

namespace lightsketch {

using Split = std::pair<std::vector<std::size_t>, std::vector<std::size_t>>;
std::vector<Split> randomHalves(std::span<const std::size_t> views, int count, std::uint32_t seed);

struct Validation {
  SplitHalf splitHalf;
  double heldOutPixels = 0;  // rms of the corners' distances
};
// `state`: the solution of all views, where each half begins.
Result<Validation> validateHalves(const SolverData& data, const std::vector<Split>& splits,
                                  const SolverState& state, const LensMask& mask, bool warp,
                                  Progress& progress);

}  // namespace lightsketch
