#include "ui/app/colour_scale.h"

#include <QPainter>
#include <algorithm>

namespace lightsketch {
namespace {

// Red, amber, blue: ordered for every eye, seen on dark and on light.
QColor colourAt(double part) {
  static const QColor kStops[] = {"#d7301f", "#f0a030", "#9ecae1", "#2f7fd0"};
  const double at = std::clamp(part, 0.0, 1.0) * 3;
  const int i = std::min(2, static_cast<int>(at));
  const auto mix = [&](int a, int b) { return static_cast<int>(a + (at - i) * (b - a)); };
  return {mix(kStops[i].red(), kStops[i + 1].red()), mix(kStops[i].green(), kStops[i + 1].green()),
          mix(kStops[i].blue(), kStops[i + 1].blue())};
}

}  // namespace

void ColourScale::setRange(double low, double high) {
  low_ = low;
  high_ = high;
  update();
}

QColor ColourScale::colourOf(double value) const {
  return colourAt((value - low_) / (high_ - low_));
}

void ColourScale::paintEvent(QPaintEvent*) {
  QPainter painter(this);
  const QRect bar(10, 2, width() - 20, 10);
  QLinearGradient gradient(bar.topLeft(), bar.topRight());
  for (int i = 0; i <= 9; ++i) gradient.setColorAt(i / 9.0, colourAt(i / 9.0));
  painter.fillRect(bar, gradient);
  painter.setPen(palette().color(QPalette::WindowText));
  const QRect text(0, 14, width(), 20);
  painter.drawText(text.adjusted(10, 0, 0, 0), Qt::AlignLeft,
                   tr("%1 dB, worse").arg(low_, 0, 'f', 0));
  painter.drawText(text.adjusted(0, 0, -10, 0), Qt::AlignRight,
                   tr("better, %1 dB").arg(high_, 0, 'f', 0));
}

}  // namespace lightsketch
