#include "ui/app/histogram_view.h"

#include <QPainter>
#include <QPainterPath>
#include <algorithm>
#include <cmath>

namespace lightsketch {

HistogramView::HistogramView(QWidget* parent) : QWidget(parent) {
  setAccessibleName(tr("Histogram"));
  setToolTip(
      tr("How many pixels have which brightness, from black at the left to saturation at the "
         "right. Nothing should pile up at the right edge."));
}

void HistogramView::setPicture(std::shared_ptr<const ViewPicture> picture) {
  picture_ = std::move(picture);
  update();
}

void HistogramView::setLogarithmic(bool on) {
  logarithmic_ = on;
  update();
}

void HistogramView::paintEvent(QPaintEvent*) {
  QPainter painter(this);
  const QRectF area = QRectF(rect()).adjusted(0.5, 0.5, -0.5, -0.5);
  painter.fillRect(area, palette().color(QPalette::Base));
  painter.setPen(palette().color(QPalette::Mid));
  for (const double at : {0.25, 0.5, 0.75}) {
    const double x = area.left() + at * area.width();
    painter.drawLine(QPointF(x, area.top()), QPointF(x, area.bottom()));
  }
  painter.drawRect(area);
  if (!picture_) return;

  const auto& channels = picture_->histogram;
  const bool grey = channels[0] == channels[1] && channels[1] == channels[2];
  const auto height = [&](std::uint32_t count) {
    return logarithmic_ ? std::log1p(static_cast<double>(count)) : static_cast<double>(count);
  };
  double most = 1;
  // The darkest bin may tower over everything else; it is cut instead of hiding the rest.
  for (const auto& bins : channels) {
    for (std::size_t i = logarithmic_ ? 0 : 1; i < bins.size(); ++i) {
      most = std::max(most, height(bins[i]));
    }
  }
  painter.setRenderHint(QPainter::Antialiasing);
  painter.setCompositionMode(QPainter::CompositionMode_SourceOver);
  static const std::array<QColor, 3> kColours{QColor(235, 80, 70, 150), QColor(70, 190, 90, 150),
                                              QColor(80, 130, 245, 150)};
  for (std::size_t c = 0; c < (grey ? 1u : 3u); ++c) {
    QPainterPath path(area.bottomLeft());
    const double step = area.width() / static_cast<double>(channels[c].size());
    for (std::size_t i = 0; i < channels[c].size(); ++i) {
      const double y =
          area.bottom() - std::min(1.0, height(channels[c][i]) / most) * (area.height() - 2);
      path.lineTo(area.left() + step * static_cast<double>(i), y);
      path.lineTo(area.left() + step * static_cast<double>(i + 1), y);
    }
    path.lineTo(area.bottomRight());
    QColor colour = kColours[c];
    if (grey) {
      colour = palette().color(QPalette::Text);
      colour.setAlpha(150);
    }
    painter.fillPath(path, colour);
  }
}

}  // namespace lightsketch
