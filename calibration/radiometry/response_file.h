// The response file and the pictures that a response is calibrated from.
#pragma once

#include <filesystem>
#include <vector>

#include "calibration/model/sensor_model.h"
#include "calibration/radiometry/response_calibration.h"
#include "capture/frame/frame.h"
#include "capture/frame/result.h"

namespace lightsketch {

// Writes `path` (JSON, sensor_model.h) and, where there is a dark frame, a 16-bit PNG beside it,
// NAME.dark.png, first. The summary's figures go along for the reader's eyes.
Result<void> saveResponse(const ResponseCalibration& calibration,
                          const std::filesystem::path& path);
// Fails with file, field and reason; also where the dark frame is not the one that was saved.
Result<SensorModel> loadResponse(const std::filesystem::path& path);

// A bracket as files: 8- or 16-bit pictures (PNG, TIFF, JPEG, grey or 8-bit RGB) taken as raw
// counts, in the order of their names, with their exposure times from the one text file in the
// folder: a line per picture, "NAME SECONDS" or only "SECONDS" in that order; 1/60 is understood.
// Lines that start with # are comments.
Result<std::vector<Frame>> readBracketFolder(const std::filesystem::path& folder);

// A self-contained index.html (curves, residuals, photon transfer, hot pixels, flat field) and
// report.json in `folder`.
Result<void> writeResponseReport(const ResponseCalibration& calibration,
                                 const std::filesystem::path& folder);

}  // namespace lightsketch
