// A recording as it goes, and what the person with the lamp is told about it.
#pragma once

#include <optional>

#include "pipeline/job/jobs.h"
#include "ui/app/hemisphere_view.h"
#include "ui/app/sketch_pace.h"
#include "ui/app/sketch_prompt.h"

namespace lightsketch {

struct SketchProgress {
  RecordJob job;
  RecorderState state;
  SketchPace pace;
  TimePoint begun;
  std::optional<TimePoint> ambientSince;  // the room's own light is measured

  // Of so many wanted directions; arrows point as on that view.
  SketchPrompt::Content prompt(int directions, const HemisphereView& hemisphere) const;

 private:
  QString timeLeft(int directions) const;
};

}  // namespace lightsketch
