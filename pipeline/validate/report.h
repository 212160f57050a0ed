// The report of a validation as files that need nothing else.
#pragma once

#include <filesystem>

#include "capture/frame/result.h"
#include "pipeline/validate/validate.h"

namespace lightsketch {

// Writes into `folder` (made if absent):
//   index.html   everything, pictures included, for any browser and for paper, no outside
//   references
//
//   report.json  every figure
//
//   lights.csv   a line per held-out light
//
// Each file is replaced as a whole; index.html comes last, so it never stands beside older figures.
Result<void> writeReport(const ValidationReport& report, const std::filesystem::path& folder);

}  // namespace lightsketch
