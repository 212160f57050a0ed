// What checkFrames() found, with pictures, as a page that needs nothing else.
#pragma once

#include <filesystem>
#include <string>

#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/sketch/light_stack.h"
#include "pipeline/validate/frame_check.h"

namespace lightsketch {

struct FrameCheckReportOptions {
  std::string title;   // of the sketch
  std::string action;  // a sentence: what was done about them
  int pictures = 60;   // frames at fault that are shown, the worst first
  int width = 240;     // of their pictures at most, pixels
};

// The page: a map of the lights, and for each frame at fault captured, predicted and their ratio.
// Reads every image of the stack once.
Result<std::string> frameCheckPage(const LightStack& stack, const FrameCheck& check,
                                   const FrameCheckReportOptions& options, Progress& progress);

}  // namespace lightsketch
