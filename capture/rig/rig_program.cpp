#include "capture/rig/rig_program.h"

#include <algorithm>
#include <array>

namespace lightsketch {
namespace {

constexpr std::array<std::string_view, kRigProgramCount> kNames = {"lamp",     "board", "ball",
                                                                   "diffuser", "dark",  "still"};

}  // namespace

std::string_view rigProgramName(RigProgram program) {
  return kNames[static_cast<std::size_t>(program)];
}

std::optional<RigProgram> rigProgramFromName(const std::string& name) {
  const auto found = std::find(kNames.begin(), kNames.end(), name);
  if (found == kNames.end()) return std::nullopt;
  return static_cast<RigProgram>(found - kNames.begin());
}

void ProgramLog::start(RigProgram program, double timeSeconds) {
  const std::lock_guard lock(mutex_);
  if (entries_.back().program == program) return;
  // Two cameras may both be told, each on a thread of its own: time never runs backwards.
  entries_.push_back({program, std::max(timeSeconds, entries_.back().sinceSeconds)});
}

ProgramLog::Entry ProgramLog::at(double timeSeconds) const {
  const std::lock_guard lock(mutex_);
  for (auto entry = entries_.rbegin(); entry != entries_.rend(); ++entry) {
    if (entry->sinceSeconds <= timeSeconds) return *entry;
  }
  return entries_.front();
}

}  // namespace lightsketch
