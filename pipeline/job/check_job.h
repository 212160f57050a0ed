// Whether what is on disk is whole, and what can be saved where it is not.
#pragma once

#include <filesystem>

#include "capture/frame/progress.h"
#include "pipeline/job/jobs.h"

namespace lightsketch {

struct CheckJob {
  std::filesystem::path file;  // a sketch; or a model, camera model or picture
  bool repair = false;         // sketches only; see repairSketch()
};
// The figures' "damaged" counts what is damaged and was not repaired.
Result<JobResult> checkJob(const CheckJob& job, Progress& progress);

}  // namespace lightsketch
