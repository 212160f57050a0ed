#include "ui/app/response_plot.h"

#include <QPainter>
#include <QPainterPath>
#include <algorithm>
#include <array>

namespace lightsketch {

ResponsePlot::ResponsePlot(QWidget* parent) : QWidget(parent) {
  setAccessibleName(tr("Response curve"));
  setToolTip(
      tr("Which count the camera gives for how much light. A straight line is a linear sensor."));
}

void ResponsePlot::setCurve(const ResponseCurve& curve) {
  curve_ = curve;
  update();
}

void ResponsePlot::paintEvent(QPaintEvent*) {
  if (!curve_) return;
  QPainter painter(this);
  painter.setRenderHint(QPainter::Antialiasing);
  const int line = painter.fontMetrics().height();
  const QRectF area(line * 2.2, 4, width() - line * 2.2 - 4, height() - line * 2.4);
  painter.fillRect(area, palette().color(QPalette::Base));
  painter.setPen(palette().color(QPalette::Mid));
  for (int i = 0; i <= 4; ++i) {
    const double x = area.left() + i * area.width() / 4;
    const double y = area.top() + i * area.height() / 4;
    painter.drawLine(QPointF(x, area.top()), QPointF(x, area.bottom()));
    painter.drawLine(QPointF(area.left(), y), QPointF(area.right(), y));
  }
  painter.setPen(palette().color(QPalette::WindowText));
  const QRectF below(area.left(), area.bottom() + 2, area.width(), line * 1.2);
  painter.drawText(below, Qt::AlignLeft, tr("no light"));
  painter.drawText(below, Qt::AlignRight, tr("saturation"));
  painter.drawText(below.translated(0, line), Qt::AlignHCenter, tr("light"));
  painter.save();
  painter.translate(0, area.bottom());
  painter.rotate(-90);
  const QRectF beside(0, 0, area.height(), line * 2);
  painter.drawText(beside, Qt::AlignHCenter, tr("count"));
  painter.drawText(beside, Qt::AlignRight, QString::number(qRound(curve_->maxCount())));
  painter.restore();

  static const std::array<QColor, 3> kColours{QColor(235, 80, 70), QColor(60, 180, 80),
                                              QColor(80, 130, 245)};
  for (int c = 0; c < curve_->colours(); ++c) {
    QPainterPath path;
    constexpr int kPoints = 128;
    for (int i = 0; i <= kPoints; ++i) {
      const double light = static_cast<double>(i) / kPoints;
      const double count = std::clamp(curve_->count(light, c) / curve_->maxCount(), 0.0, 1.0);
      const QPointF at(area.left() + light * area.width(), area.bottom() - count * area.height());
      i == 0 ? path.moveTo(at) : path.lineTo(at);
    }
    painter.setPen(QPen(curve_->colours() == 1 ? palette().color(QPalette::Highlight)
                                               : kColours[static_cast<std::size_t>(c)],
                        2));
    painter.drawPath(path);
  }
}

}  // namespace lightsketch
