// Recording for the jobs that hold the simulated rig themselves.
#pragma once

#include "capture/rig/simulated_rig.h"
#include "capture/session/recorder.h"
#include "pipeline/job/jobs.h"

namespace lightsketch {

// Opens the rig's two cameras over the network, as any others, and records with its calibration.
Result<RecorderSummary> recordOnRig(const RecordJob& job, const SimulatedRigOptions& options,
                                    const SimulatedRig& rig, Progress& progress,
                                    std::stop_token stop,
                                    const std::function<void(const RecorderState&)>& onState);

}  // namespace lightsketch
