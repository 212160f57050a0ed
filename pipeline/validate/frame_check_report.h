// What checkFrames() found, with pictures, as a page that needs nothing else.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "capture/frame/image.h"
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

// A frame at fault beside what its neighbours predict, 8-bit sRGB, possibly shrunk.
struct FrameCheckPictures {
  int frame = 0;  // index into FrameCheck::frames
  Image<std::uint8_t> captured;
  Image<std::uint8_t> predicted;
  Image<std::uint8_t>
      ratio;  // white as predicted, blue darker, red brighter, full at a factor of 2
};
// Of the worst `options.pictures`, the worst first, all at one exposure. Reads every image of the
// stack once.
Result<std::vector<FrameCheckPictures>> frameCheckPictures(const LightStack& stack,
                                                           const FrameCheck& check,
                                                           const FrameCheckReportOptions& options,
                                                           Progress& progress);

// The page: a map of the lights, and for each frame at fault captured, predicted and their ratio.
Result<std::string> frameCheckPage(const LightStack& stack, const FrameCheck& check,
                                   const FrameCheckReportOptions& options, Progress& progress);

}  // namespace lightsketch
