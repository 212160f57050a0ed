// The summary's figures as JSON, for the response file and the report.
#pragma once

#include "calibration/radiometry/response_calibration.h"
#include "capture/frame/json.h"

namespace lightsketch {

Json toJson(const ResponseSummary& summary);

}  // namespace lightsketch
