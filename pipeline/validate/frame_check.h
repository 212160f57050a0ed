// Finds the frames of a stack that do not fit the others: somebody's shadow on the subject, an
// exposure that jumped, a direction that is wrong.
#pragma once

#include <Eigen/Core>
#include <array>
#include <string>
#include <utility>
#include <vector>

#include "capture/frame/angle.h"
#include "capture/frame/json.h"
#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/sketch/light_stack.h"

namespace lightsketch {

struct FrameCheckOptions {
  int cells = 32;  // pictures are judged as block means, this many along their longer side
  // Robust z-scores, against the set's own spread, from which a frame counts as bad.
  double threshold = 6;
  double exposureThreshold = 3;  // brightness has thinner tails than shapes have

  Result<void> validate() const;
};

enum class FrameFault { kNone, kShadow, kExposure, kDirection, kOther };
// "good", "shadow", "exposure", "direction", "other".
const char* nameOf(FrameFault fault);

struct FrameVerdict {
  int id = 0;  // of LightStack::ids()
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();
  FrameFault fault = FrameFault::kNone;
  // Robust z-scores of what its neighbours do not explain.
  double exposureScore = 0;
  double directionScore = 0;
  double shadowScore = 0;    // a connected patch darker than predicted
  double residualScore = 0;  // whatever is left
  // Brightness over what its neighbours predict, in linear light, and one sigma of the set's log.
  double gain = 1;
  double gainSigma = 0;
  // Where its picture fits best, and one sigma of that in the set. `fitted` is only followed to its
  // end for frames at fault by their direction.
  Eigen::Vector3d fitted = Eigen::Vector3d::UnitZ();
  Angle shift;
  Angle shiftSigma;
  // Root mean square of the leave-one-out residual, square-root domain, before and after the gain
  // and shift were fitted.
  double residual = 0;
  double residualFitted = 0;
  double darkPart = 0;              // of the picture, that is darker than it should be
  std::array<double, 4> darkBox{};  // x, y, width, height of that patch, parts of the picture
  // The fault is explained by its gain or direction alone and can be put right.
  bool correctable = false;
  // What it should look like: sqrt(picture) is the sum of weight x sqrt(image `first` of the
  // stack). Only of frames at fault.
  std::vector<std::pair<int, double>> prediction;

  // A line for the journal: "shadow over 31 % of the picture (z 48)".
  std::string reason() const;
};

struct FrameCheck {
  std::vector<FrameVerdict> frames;  // in the stack's order
  Angle spacing;                     // typical distance between neighbouring lights
  int rounds = 0;                    // of setting aside and predicting again

  int count(FrameFault fault) const;
  std::vector<int> bad() const;  // indices into `frames`, worst first
  Json toJson() const;           // every figure, bad frames in full
};

// Every frame is predicted from its neighbours (leave-one-out) in the square-root domain; those
// that stand out most among their neighbours are set aside, the rest is predicted again, until
// nothing stands out. Fails with kInvalidArgument below kFewestFrames. Uses all cores; the result
// depends on nothing but its input.
inline constexpr int kFewestFrames = 16;
Result<FrameCheck> checkFrames(const LightStack& stack, const FrameCheckOptions& options,
                               Progress& progress);

}  // namespace lightsketch
