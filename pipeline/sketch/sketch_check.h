// Whether a sketch is as it was written, and what can be saved where it is not.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "capture/frame/progress.h"
#include "capture/frame/result.h"

namespace lightsketch {

struct SketchDamage {
  std::string file;    // relative to the sketch
  int line = 0;        // of the journal; 0: the whole file
  std::string what;    // "its checksum does not fit"
  std::string remedy;  // what repair does about it: "frame 12 is dropped"
};

struct SketchCheck {
  int lines = 0;   // whole lines of the journal
  int frames = 0;  // in use and whole, after a repair
  int recovered =
      0;  // of them, those whose line was lost and whose picture's header told the light
  std::vector<SketchDamage> damage;
  std::vector<std::string> remarks;  // nothing was lost by these
};

// Reads every line of the journal, every frame's checksum, the ambient picture and the calibration
// files. Changes nothing. Fails where there is no sketch, where a newer lightsketch wrote it, and
// where it cannot be read at all.
Result<SketchCheck> checkSketch(const std::filesystem::path& folder, Progress& progress);

// The same, and makes the sketch usable again: no frame whose picture is whole is lost. Flipped
// bits of journal lines are put right, lost lines of frames made anew from the picture's header,
// damaged frames dropped by events in the journal, other damaged files set aside. What is replaced
// stays beside as NAME.damaged. Killed at any moment, it can be repeated. Fails while another
// program writes.
Result<SketchCheck> repairSketch(const std::filesystem::path& folder, Progress& progress);

}  // namespace lightsketch
