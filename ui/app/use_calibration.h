// Calibration files, taken into use such that Ctrl+Z goes back.
#pragma once

#include <filesystem>

#include "ui/app/workspace.h"

namespace lightsketch {

void useCalibration(Workspace& workspace, const CalibrationFiles& files);

// Where calibrations made by this program go: the setting "calibration/folder", else beside its
// other data.
std::filesystem::path calibrationFolder(Workspace& workspace);

}  // namespace lightsketch
