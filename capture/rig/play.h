// What stands before the cameras in the rig's programs, shared by whoever draws or reports it.
#pragma once

#include <memory>

#include "capture/rig/held_board.h"
#include "capture/rig/rig_program.h"
#include "capture/rig/still_life.h"

namespace lightsketch {

// Outlives the views. Thread-safe: all but `programs` is immutable.
struct Play {
  ProgramLog programs;
  HeldBoard board;
  ChromeBall ball;
  std::shared_ptr<const StillLife> bareTable;
  std::shared_ptr<const StillLife> tableWithBall;
};

// Radiance of the diffusers: half of a camera's range at its default exposure.
inline constexpr float kSceneDiffuserRadiance = 0.85f;
inline constexpr float kSourceDiffuserRadiance = 0.22f;

}  // namespace lightsketch
