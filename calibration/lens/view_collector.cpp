#include "calibration/lens/view_collector.h"

#include <algorithm>

namespace lightsketch {
namespace {

constexpr double kStillPixels = 0.4;  // mean motion from one picture to the next
constexpr double kStillSeconds = 2;   // pictures further apart say nothing about motion
constexpr double kNewFraction = 1 / 40.0;
constexpr std::size_t kEnoughInCommon = 6;

// Mean distance of the corners that both views have; nothing for too few of them.
std::optional<double> displacement(const BoardView& a, const BoardView& b) {
  double sum = 0;
  std::size_t count = 0;
  for (const BoardCorner& corner : a.corners) {
    const auto twin = std::find_if(b.corners.begin(), b.corners.end(), [&](const BoardCorner& c) {
      return c.column == corner.column && c.row == corner.row;
    });
    if (twin == b.corners.end()) continue;
    sum += (twin->pixel - corner.pixel).norm();
    ++count;
  }
  if (count < kEnoughInCommon) return std::nullopt;
  return sum / static_cast<double>(count);
}

}  // namespace

std::string describe(ViewVerdict verdict) {
  switch (verdict) {
    case ViewVerdict::kKeep:
      return "kept";
    case ViewVerdict::kNoBoard:
      return "no board in view";
    case ViewVerdict::kMoving:
      return "hold the board still";
    case ViewVerdict::kNotNew:
      return "the board was here before; move, turn or tilt it";
  }
  return "unknown";
}

ViewVerdict ViewCollector::judge(const BoardView& view, TimePoint time) {
  if (view.corners.empty()) {
    previous_.reset();
    return ViewVerdict::kNoBoard;
  }
  const auto motion = previous_ && toSeconds(time - previousTime_) < kStillSeconds
                          ? displacement(*previous_, view)
                          : std::nullopt;
  previous_ = view;
  previousTime_ = time;
  if (!motion || *motion > kStillPixels) return ViewVerdict::kMoving;
  const bool old = std::any_of(kept_.begin(), kept_.end(), [&](const BoardView& kept) {
    const auto moved = displacement(kept, view);
    return moved && *moved < kNewFraction * imageWidth_;
  });
  return old ? ViewVerdict::kNotNew : ViewVerdict::kKeep;
}

}  // namespace lightsketch
