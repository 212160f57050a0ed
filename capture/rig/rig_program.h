// What happens in front of the simulated cameras, and since when.
#pragma once

#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace lightsketch {

// The numbers are those of the GenICam feature "RigProgram".
enum class RigProgram {
  kLamp = 0,        // a still life lit by a hand-held lamp that obeys the guide
  kBoard = 1,       // a calibration board moved before the cameras, by a work light
  kMirrorBall = 2,  // a chrome ball at the subject, the lamp waved around it
  kDiffuser = 3,    // an even white diffuser before every lens
  kDark = 4,        // lens caps on
  kStill = 5,       // the still life under the room's light, nothing moves
};
inline constexpr int kRigProgramCount = 6;

// "lamp", "board", "ball", "diffuser", "dark", "still".
std::string_view rigProgramName(RigProgram program);
std::optional<RigProgram> rigProgramFromName(const std::string& name);

// Thread-safe.
class ProgramLog {
 public:
  explicit ProgramLog(RigProgram first) : entries_{{first, 0}} {}
  struct Entry {
    RigProgram program;
    double sinceSeconds;  // of the rig's time
  };
  // Nothing happens if it runs already.
  void start(RigProgram program, double timeSeconds);
  Entry at(double timeSeconds) const;

 private:
  mutable std::mutex mutex_;  // guards entries_
  std::vector<Entry> entries_;
};

}  // namespace lightsketch
