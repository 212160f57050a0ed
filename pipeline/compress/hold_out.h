// Which frames are kept back from a model to measure it with. Rules pick by frame id, so later
// edits do not move the set.
#pragma once

#include <Eigen/Core>
#include <string>
#include <string_view>
#include <vector>

#include "capture/frame/result.h"
#include "pipeline/sketch/sketch.h"

namespace lightsketch {

struct HoldOut {
  std::string rule;           // as given
  std::vector<int> training;  // frame ids the model may see
  std::vector<int> heldOut;   // frame ids it is measured on
  std::vector<int> margin;    // frame ids that neither may use
};

// "every:8:4": index modulo 8 is 4, in journal (or .lp) order over active frames' ids.
// "cells:8:4": whole direction cells of a grid, with a margin so that no near twin leaks.
// "list:FILE": frame ids, one a line. "": nothing held out.
Result<HoldOut> applyHoldOut(const Sketch& sketch, std::string_view rule);

// The rule where none is asked for and something is to be measured. Free-hand sets of many frames
// hold near twins, so whole cells are kept back; the recorder keeps one frame a cell, and small
// sets have none to spare.
std::string defaultHoldOut(const Sketch& sketch);

}  // namespace lightsketch
