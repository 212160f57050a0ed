// A lens calibration as a page that says how far it can be trusted, where, and what to do about it.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "calibration/lens/board_detection.h"
#include "calibration/lens/lens_calibration.h"
#include "calibration/lens/mrcal_check.h"
#include "capture/frame/result.h"

namespace lightsketch {

struct LensReport {
  std::string title;  // what was calibrated: a camera, a folder
  LensCalibration calibration;
  std::vector<BoardDetection> pictures;  // as found; those without a board are listed. May be empty
  std::optional<MrcalCheck> mrcal;
  std::string software = "lightsketch " LIGHTSKETCH_VERSION;
};

// One HTML page with its drawings in it, no scripts.
std::string lensReportHtml(const LensReport& report);
// The same as a file. Atomic.
Result<void> writeLensReport(const LensReport& report, const std::filesystem::path& path);

}  // namespace lightsketch
