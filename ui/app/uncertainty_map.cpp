#include "ui/app/uncertainty_map.h"

#include <QLinearGradient>
#include <QPainter>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace lightsketch {
namespace {

// ColorBrewer 2 YlGnBu, five classes, as in the lens report: readable with any colour vision; dark
// is uncertain.
constexpr std::array<QRgb, 5> kStops{0xffffffcc, 0xffa1dab4, 0xff41b6c4, 0xff2c7fb8, 0xff253494};

QColor colourAt(double fraction) {
  const double t = std::clamp(fraction, 0.0, 1.0) * (kStops.size() - 1);
  const auto i = std::min(static_cast<std::size_t>(t), kStops.size() - 2);
  const double f = t - static_cast<double>(i);
  const QColor a(kStops[i]), b(kStops[i + 1]);
  const auto mix = [&](int from, int to) { return static_cast<int>(from + f * (to - from)); };
  return {mix(a.red(), b.red()), mix(a.green(), b.green()), mix(a.blue(), b.blue())};
}

}  // namespace

FieldUncertainty uncertaintyOf(const CameraModel& model) {
  FieldUncertainty field;
  field.rimDegrees = model.maxFieldAngle().degrees();
  constexpr double kRadian = std::numbers::pi / 180;
  for (double ring = FieldUncertainty::kStepDegrees / 2; ring < field.rimDegrees;
       ring += FieldUncertainty::kStepDegrees) {
    for (int i = 0; i < FieldUncertainty::kAzimuths; ++i) {
      const double phi = (i + 0.5) * 2 * std::numbers::pi / FieldUncertainty::kAzimuths;
      const double sine = std::sin(ring * kRadian);
      const Eigen::Vector3d direction(sine * std::cos(phi), sine * std::sin(phi),
                                      std::cos(ring * kRadian));
      field.sigmaDegrees.push_back(model.covers(direction)
                                       ? std::sqrt(model.directionCovariance(direction).trace()) /
                                             kRadian
                                       : -1);
    }
  }
  return field;
}

UncertaintyMap::UncertaintyMap(QWidget* parent) : QWidget(parent) {
  setAccessibleName(tr("Uncertainty of the direction over the field"));
  setToolTip(
      tr("One sigma of the direction that a pixel stands for: the middle is the optical axis, the "
         "rim the edge of the field, every ring 30 degrees. Grey: no board was held there, and "
         "lamps there are refused."));
}

void UncertaintyMap::setField(FieldUncertainty field) {
  field_ = std::move(field);
  update();
}

void UncertaintyMap::paintEvent(QPaintEvent*) {
  if (field_.sigmaDegrees.empty()) return;
  QPainter painter(this);
  painter.setRenderHint(QPainter::Antialiasing);
  const int line = painter.fontMetrics().height();
  const double side = std::min(width(), height() - 2 * line - 6);
  const QPointF centre(width() / 2.0, side / 2);
  const double scale = (side / 2 - 2) / field_.rimDegrees;
  painter.setPen(Qt::NoPen);
  painter.setBrush(palette().color(QPalette::Mid));
  painter.drawEllipse(centre, scale * field_.rimDegrees, scale * field_.rimDegrees);

  // By factors: the rim is often ten times worse than the middle.
  double least = INFINITY;
  double most = 1e-9;
  for (const double sigma : field_.sigmaDegrees) {
    if (sigma < 0) continue;
    least = std::min(least, sigma);
    most = std::max(most, sigma);
  }
  least = std::max(std::min(least, most / 2), 1e-6);
  constexpr double kTurn = 2 * std::numbers::pi / FieldUncertainty::kAzimuths;
  // A hair larger than they are, so that nothing shines through between two of them.
  constexpr double kOverlap = 0.3;
  for (std::size_t i = 0; i < field_.sigmaDegrees.size(); ++i) {
    const double sigma = field_.sigmaDegrees[i];
    if (sigma < 0) continue;
    const auto ring = static_cast<double>(i / FieldUncertainty::kAzimuths);
    const double azimuth = kTurn * static_cast<double>(i % FieldUncertainty::kAzimuths);
    const double inner = scale * FieldUncertainty::kStepDegrees * ring;
    const double outer = std::min(inner + scale * FieldUncertainty::kStepDegrees + kOverlap,
                                  scale * field_.rimDegrees);
    const double turn = kTurn + kOverlap / outer;
    const auto at = [&](double radius, double angle) {
      return centre + radius * QPointF(std::cos(angle), std::sin(angle));
    };
    painter.setBrush(colourAt(std::log(sigma / least) / std::log(most / least)));
    painter.drawPolygon(QPolygonF{at(inner, azimuth), at(outer, azimuth), at(outer, azimuth + turn),
                                  at(inner, azimuth + turn)});
  }
  painter.setBrush(Qt::NoBrush);
  painter.setPen(QPen(QColor(0, 0, 0, 90), 1, Qt::DotLine));
  for (double ring = 30; ring < field_.rimDegrees; ring += 30) {
    painter.drawEllipse(centre, scale * ring, scale * ring);
  }

  // The legend.
  const QRectF bar(8, side + 6, width() - 16, line * 0.7);
  QLinearGradient gradient(bar.topLeft(), bar.topRight());
  for (std::size_t i = 0; i < kStops.size(); ++i) {
    gradient.setColorAt(static_cast<double>(i) / (kStops.size() - 1), QColor(kStops[i]));
  }
  painter.fillRect(bar, gradient);
  painter.setPen(palette().color(QPalette::WindowText));
  const QRectF text(8, side + 6 + line * 0.8, width() - 16, line * 1.2);
  painter.drawText(text, Qt::AlignLeft, tr("%1\u00b0").arg(least, 0, 'g', 2));
  painter.drawText(text, Qt::AlignRight, tr("%1\u00b0").arg(most, 0, 'g', 2));
  painter.drawText(text, Qt::AlignHCenter, tr("uncertainty"));
}

}  // namespace lightsketch
