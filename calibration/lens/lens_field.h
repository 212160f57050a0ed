// Internal to calibration/lens: where in the field the corners lie, and what to say about it.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "calibration/lens/lens_solver.h"

namespace lightsketch {

inline constexpr int kFieldSectors = 36;

// Per sector of azimuth the outermost used corner less one degree (see LensUncertainty). A sector
// is also taken as covered as far as one of its two neighbours on either side is: boards leave gaps
// of a square's width.
std::vector<Angle> coveredField(const SolverData& data, std::span<const std::size_t> views,
                                const SolverState& state);

struct FieldAdvice {
  std::vector<std::string> advice;
  std::vector<std::string> warnings;
};
FieldAdvice adviseOnField(const SolverData& data, std::span<const std::size_t> views,
                          const SolverState& state, const FisheyeModel& model);

// rms over the covered field's residual pattern: what neighbouring corners of different views have
// in common although the model does not explain it; radians per axis.
Angle residualPattern(const SolverData& data, std::span<const std::size_t> views,
                      const SolverState& state, const FisheyeModel& model, double sigma);

}  // namespace lightsketch
