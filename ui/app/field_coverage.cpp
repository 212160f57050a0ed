#include "ui/app/field_coverage.h"

#include <QCoreApplication>
#include <QTransform>
#include <algorithm>
#include <cmath>
#include <numbers>

namespace lightsketch {
namespace {

constexpr int kSides = 8;
constexpr std::array<double, 4> kRadii{0, 0.38, 0.72, 1};  // of middle and rings; 1: the ellipse
constexpr double kSideDegrees = 360.0 / kSides;
// A view has tens of corners, but only a few of them where the picture ends.
constexpr int kEnough = 4;

int cellOf(double ring, double degrees) {
  if (ring < kRadii[1]) return 0;
  const int side =
      static_cast<int>(std::lround((degrees + 360) / kSideDegrees)) % kSides;  // 0: right
  return 1 + (ring < kRadii[2] ? 0 : kSides) + side;
}
int ringOf(int cell) { return (cell + kSides - 1) / kSides; }
int sideOf(int cell) { return (cell - 1) % kSides; }

}  // namespace

FieldCoverage::FieldCoverage(std::span<const Eigen::Vector2d> corners, QSize picture)
    : picture_(picture) {
  for (const Eigen::Vector2d& pixel : corners) {
    const double x = 2 * pixel.x() / picture.width() - 1;
    const double y = 2 * pixel.y() / picture.height() - 1;
    ++corners_[static_cast<std::size_t>(
        cellOf(std::hypot(x, y), std::atan2(y, x) * 180 / std::numbers::pi))];
  }
}

bool FieldCoverage::covered(int cell) const {
  return corners_[static_cast<std::size_t>(cell)] >= kEnough;
}

int FieldCoverage::coveredCells() const {
  int count = 0;
  for (int cell = 0; cell < kCells; ++cell) count += covered(cell);
  return count;
}

std::optional<int> FieldCoverage::next(const std::optional<Eigen::Vector2d>& from) const {
  std::optional<int> best;
  const auto rank = [&](int cell) {
    const double far = from ? (centre(cell) - *from).norm() : ringOf(cell);
    return std::pair(corners_[static_cast<std::size_t>(cell)] > 0, far);
  };
  for (int cell = 0; cell < kCells; ++cell) {
    if (!covered(cell) && (!best || rank(cell) < rank(*best))) best = cell;
  }
  return best;
}

QPainterPath FieldCoverage::outline(int cell) const {
  const auto circle = [](double radius) {
    return QRectF(-radius, -radius, 2 * radius, 2 * radius);
  };
  QPainterPath path;
  if (cell == 0) {
    path.addEllipse(circle(kRadii[1]));
  } else {
    const auto ring = static_cast<std::size_t>(ringOf(cell));
    // Qt counts angles against the clock.
    const double begin = -(sideOf(cell) - 0.5) * kSideDegrees;
    path.arcMoveTo(circle(kRadii[ring]), begin);
    path.arcTo(circle(kRadii[ring]), begin, -kSideDegrees);
    path.arcTo(circle(kRadii[ring + 1]), begin - kSideDegrees, kSideDegrees);
    path.closeSubpath();
  }
  return (QTransform::fromTranslate(1, 1) *
          QTransform::fromScale(picture_.width() / 2.0, picture_.height() / 2.0))
      .map(path);
}

Eigen::Vector2d FieldCoverage::centre(int cell) const {
  Eigen::Vector2d at(1, 1);
  if (cell > 0) {
    const auto ring = static_cast<std::size_t>(ringOf(cell));
    const double radius = (kRadii[ring] + kRadii[ring + 1]) / 2;
    const double angle = sideOf(cell) * kSideDegrees * std::numbers::pi / 180;
    at += radius * Eigen::Vector2d(std::cos(angle), std::sin(angle));
  }
  return at.cwiseProduct(Eigen::Vector2d(picture_.width() / 2.0, picture_.height() / 2.0));
}

QString FieldCoverage::describe(int cell) {
  const auto tr = [](const char* text) {
    return QCoreApplication::translate("FieldCoverage", text);
  };
  if (cell == 0) return tr("in the middle");
  static constexpr std::array<const char*, 2 * kSides> kPlaces{
      QT_TRANSLATE_NOOP("FieldCoverage", "half way to the right"),
      QT_TRANSLATE_NOOP("FieldCoverage", "half way to the lower right"),
      QT_TRANSLATE_NOOP("FieldCoverage", "half way down"),
      QT_TRANSLATE_NOOP("FieldCoverage", "half way to the lower left"),
      QT_TRANSLATE_NOOP("FieldCoverage", "half way to the left"),
      QT_TRANSLATE_NOOP("FieldCoverage", "half way to the upper left"),
      QT_TRANSLATE_NOOP("FieldCoverage", "half way up"),
      QT_TRANSLATE_NOOP("FieldCoverage", "half way to the upper right"),
      QT_TRANSLATE_NOOP("FieldCoverage", "at the right edge"),
      QT_TRANSLATE_NOOP("FieldCoverage", "at the lower right edge"),
      QT_TRANSLATE_NOOP("FieldCoverage", "at the lower edge"),
      QT_TRANSLATE_NOOP("FieldCoverage", "at the lower left edge"),
      QT_TRANSLATE_NOOP("FieldCoverage", "at the left edge"),
      QT_TRANSLATE_NOOP("FieldCoverage", "at the upper left edge"),
      QT_TRANSLATE_NOOP("FieldCoverage", "at the upper edge"),
      QT_TRANSLATE_NOOP("FieldCoverage", "at the upper right edge")};
  return tr(kPlaces[static_cast<std::size_t>(cell - 1)]);
}

}  // namespace lightsketch
