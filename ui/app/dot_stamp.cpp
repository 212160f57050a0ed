#include "ui/app/dot_stamp.h"

#include <QPixmapCache>
#include <cmath>

namespace lightsketch {

void stampDot(QPainter& painter, const QPointF& at, double radius, const QPen& outline,
              const QColor& fill) {
  const double ratio = painter.device()->devicePixelRatioF();
  const double line = outline.style() == Qt::NoPen ? 0 : outline.widthF();
  const QString key = QString::asprintf("dot %08x %08x %g %g %g", fill.rgba(),
                                        outline.color().rgba(), line, radius, ratio);
  const double half = std::ceil(radius + line) + 1;
  QPixmap stamp;
  if (!QPixmapCache::find(key, &stamp)) {
    const int side = static_cast<int>(std::ceil(2 * half * ratio));
    stamp = QPixmap(side, side);
    stamp.setDevicePixelRatio(ratio);
    stamp.fill(Qt::transparent);
    QPainter onto(&stamp);
    onto.setRenderHint(QPainter::Antialiasing);
    onto.setPen(outline);
    onto.setBrush(fill);
    onto.drawEllipse(QPointF(half, half), radius, radius);
    onto.end();
    QPixmapCache::insert(key, stamp);
  }
  painter.drawPixmap(at - QPointF(half, half), stamp);
}

}  // namespace lightsketch
