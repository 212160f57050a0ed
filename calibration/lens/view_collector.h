// Which pictures of a live camera are worth keeping for a calibration.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "calibration/lens/board.h"
#include "capture/frame/time.h"

namespace lightsketch {

enum class ViewVerdict { kKeep, kNoBoard, kMoving, kNotNew };
std::string describe(ViewVerdict verdict);  // "hold the board still"

// One camera's. Not thread-safe.
class ViewCollector {
 public:
  // `imageWidth`: a view is new if its corners lie a fortieth of it away from every kept view's.
  explicit ViewCollector(int imageWidth) : imageWidth_(imageWidth) {}

  // What to do with this view; kKeep changes nothing yet.
  ViewVerdict judge(const BoardView& view, TimePoint time);
  void keep(const BoardView& view) { kept_.push_back(view); }
  const std::vector<BoardView>& kept() const { return kept_; }

 private:
  int imageWidth_;
  std::vector<BoardView> kept_;
  std::optional<BoardView> previous_;
  TimePoint previousTime_;
};

}  // namespace lightsketch
