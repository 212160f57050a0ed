#include "ui/app/frame_view.h"

#include <QPainter>

namespace lightsketch {

FrameView::FrameView(LiveView& view, QWidget* parent)
    : QWidget(parent), view_(view), placeholder_(tr("no picture")) {
  setAttribute(Qt::WA_OpaquePaintEvent);
  connect(&view, &LiveView::pictureReady, this, qOverload<>(&QWidget::update));
}

FrameView::~FrameView() { view_.setSize(this, {}); }

void FrameView::setOverlay(Overlay overlay) {
  overlay_ = std::move(overlay);
  update();
}

void FrameView::setFlipped(bool leftRight, bool upsideDown) {
  leftRight_ = leftRight;
  upsideDown_ = upsideDown;
  update();
}

void FrameView::setPlaceholder(const QString& text) {
  placeholder_ = text;
  update();
}

QRectF FrameView::pictureRectangle() const {
  if (!picture_) return {};
  const QSizeF shown = QSizeF(picture_->frameSize).scaled(size(), Qt::KeepAspectRatio);
  return {QPointF((width() - shown.width()) / 2, (height() - shown.height()) / 2), shown};
}

QTransform FrameView::widgetFromFrame() const {
  const QRectF at = pictureRectangle();
  if (!at.isValid()) return {};
  return QTransform::fromScale(
             (leftRight_ ? -1 : 1) * at.width() / picture_->frameSize.width(),
             (upsideDown_ ? -1 : 1) * at.height() / picture_->frameSize.height()) *
         QTransform::fromTranslate(leftRight_ ? at.right() : at.x(),
                                   upsideDown_ ? at.bottom() : at.y());
}

void FrameView::paintEvent(QPaintEvent*) {
  QPainter painter(this);
  const auto newest = view_.picture();
  const bool fresh = newest && newest != picture_;
  picture_ = newest;
  painter.fillRect(rect(), palette().color(QPalette::Dark));
  if (!picture_) {
    painter.setPen(palette().color(QPalette::PlaceholderText));
    painter.drawText(rect(), Qt::AlignCenter | Qt::TextWordWrap, placeholder_);
    return;
  }
  painter.drawImage(pictureRectangle(), leftRight_ || upsideDown_
                                            ? picture_->image.mirrored(leftRight_, upsideDown_)
                                            : picture_->image);
  if (overlay_) {
    painter.setRenderHint(QPainter::Antialiasing);
    overlay_(painter, widgetFromFrame());
  }
  if (fresh) Q_EMIT drawn();
}

void FrameView::wantSize() {
  view_.setSize(this, isVisible() ? size() * devicePixelRatioF() : QSize());
}
void FrameView::resizeEvent(QResizeEvent*) { wantSize(); }
void FrameView::showEvent(QShowEvent*) { wantSize(); }
void FrameView::hideEvent(QHideEvent*) { view_.setSize(this, {}); }

}  // namespace lightsketch
