// Which of the wanted directions are captured, which remain, and where to go next.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "pipeline/illumination/light_grid.h"

namespace lightsketch {

// A wanted direction counts as captured once a frame lies in its cell. Not thread-safe.
class Coverage {
 public:
  explicit Coverage(LightGrid grid);

  const LightGrid& grid() const { return grid_; }
  // The cell a direction falls in; nothing outside the grid's domain (with half a spacing of
  // grace).
  std::optional<int> cellOf(const Eigen::Vector3d& direction) const;
  bool captured(int cell) const { return captured_[static_cast<std::size_t>(cell)] > 0; }
  void add(const Eigen::Vector3d& direction);
  void remove(const Eigen::Vector3d& direction);
  int capturedCount() const { return capturedCount_; }
  double fraction() const;
  // The wanted direction to aim for from `here`: near, straight on (`heading`: where the lamp is
  // moving, any length, zero if it rests), and in a region that leaves no islands behind. Nothing
  // when all are captured. `skip`: cells that the lamp is about to pass anyway.
  std::optional<int> next(const Eigen::Vector3d& here,
                          const Eigen::Vector3d& heading = Eigen::Vector3d::Zero(),
                          std::span<const int> skip = {}) const;
  // The lamp was held there in vain (before a lamp of the room, out of reach): others first, and
  // the neighbours a little later, too.
  void postpone(int cell);

 private:
  LightGrid grid_;
  std::vector<std::vector<int>> neighbours_;
  std::vector<int> captured_;
  std::vector<double> postponed_;
  int capturedCount_ = 0;
};

}  // namespace lightsketch
