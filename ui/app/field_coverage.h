// Which parts of a camera's picture the board has been held in, and where it goes next.
#pragma once

#include <Eigen/Core>
#include <QPainterPath>
#include <QSize>
#include <QString>
#include <array>
#include <optional>
#include <span>

namespace lightsketch {

// The picture's inscribed ellipse, which is a fisheye's field, cut into the middle and two rings of
// eight parts; the corners of a rectangular picture belong to the outer ring.
class FieldCoverage {
 public:
  static constexpr int kCells = 17;

  FieldCoverage() = default;
  // `corners`: of all kept views, pixels.
  FieldCoverage(std::span<const Eigen::Vector2d> corners, QSize picture);

  bool covered(int cell) const;
  int coveredCells() const;
  // Where the board is wanted most: the emptiest part, the nearest of these to `from` (pixels).
  // Nothing when all are covered.
  std::optional<int> next(const std::optional<Eigen::Vector2d>& from) const;
  // Pixels.
  QPainterPath outline(int cell) const;
  Eigen::Vector2d centre(int cell) const;
  // "at the upper left edge"
  static QString describe(int cell);

 private:
  std::array<int, kCells> corners_{};
  QSize picture_;
};

}  // namespace lightsketch
