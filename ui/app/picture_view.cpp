#include "ui/app/picture_view.h"

#include <QHBoxLayout>
#include <QKeyEvent>
#include <QPainter>
#include <algorithm>

namespace lightsketch {
namespace {

constexpr int kLongestSide = 1920;  // of pictures kept for the screen
constexpr int kLineGap = 4;         // between a picture and its caption

}  // namespace

QImage toQImage(const Image<std::uint8_t>& picture) {
  if (picture.empty()) return {};
  const QImage view(picture.data(), picture.width(), picture.height(),
                    static_cast<qsizetype>(picture.rowSize()), QImage::Format_RGB888);
  if (std::max(view.width(), view.height()) <= kLongestSide)
    return view.convertToFormat(QImage::Format_RGB32);
  return view.scaled(kLongestSide, kLongestSide, Qt::KeepAspectRatio, Qt::SmoothTransformation)
      .convertToFormat(QImage::Format_RGB32);
}

PictureView::PictureView(QWidget* parent) : QWidget(parent) {
  setSizePolicy(QSizePolicy::Expanding, QSizePolicy::Expanding);
}

void PictureView::setPicture(const QImage& image) {
  image_ = image;
  scaled_ = {};
  update();
}

void PictureView::setCaption(const QString& text) {
  caption_ = text;
  setAccessibleName(text);
  update();
}

void PictureView::setPlaceholder(const QString& text) {
  placeholder_ = text;
  update();
}

void PictureView::setPixelated(bool on) {
  pixelated_ = on;
  scaled_ = {};
}

void PictureView::paintEvent(QPaintEvent*) {
  QPainter painter(this);
  const int line = caption_.isEmpty() ? 0 : fontMetrics().height() + kLineGap;
  const QRect room = rect().adjusted(0, 0, 0, -line);
  if (image_.isNull()) {
    painter.setPen(palette().color(QPalette::PlaceholderText));
    painter.drawText(room.adjusted(8, 8, -8, -8), Qt::AlignCenter | Qt::TextWordWrap, placeholder_);
    return;
  }
  const double ratio = devicePixelRatioF();
  const QSize size = image_.size().scaled(room.size(), Qt::KeepAspectRatio);
  if (scaled_.isNull() || scaled_.size() != size * ratio) {
    scaled_ = QPixmap::fromImage(
        image_.scaled(size * ratio, Qt::IgnoreAspectRatio,
                      pixelated_ ? Qt::FastTransformation : Qt::SmoothTransformation));
    scaled_.setDevicePixelRatio(ratio);
  }
  const QPoint at = room.center() - QRect({0, 0}, size).center();
  painter.drawPixmap(at, scaled_);
  painter.setPen(palette().color(QPalette::WindowText));
  const int below = at.y() + size.height() + kLineGap;
  painter.drawText(QRect(0, below, width(), fontMetrics().height()), Qt::AlignHCenter,
                   fontMetrics().elidedText(caption_, Qt::ElideRight, width()));
}

void PictureView::mousePressEvent(QMouseEvent*) { Q_EMIT clicked(); }

TripleView::TripleView(QWidget* parent) : QWidget(parent) {
  setFocusPolicy(Qt::StrongFocus);
  auto* row = new QHBoxLayout(this);
  row->setContentsMargins(0, 0, 0, 0);
  row->setSpacing(6);
  for (int i = 0; i < 3; ++i) {
    views_[i] = new PictureView;
    views_[i]->setObjectName(QString("picture%1").arg(i));
    views_[i]->setToolTip(tr("Click to see it large, click again for all three (keys 1, 2, 3, 0)"));
    connect(views_[i], &PictureView::clicked, this, [this, i] {
      setFocus();
      showOnly(only_ == i ? -1 : i);
    });
    row->addWidget(views_[i]);
  }
}

void TripleView::setCaptions(const QString& first, const QString& second, const QString& third) {
  views_[0]->setCaption(first);
  views_[1]->setCaption(second);
  views_[2]->setCaption(third);
}

void TripleView::setPictures(const QImage& first, const QImage& second, const QImage& third) {
  views_[0]->setPicture(first);
  views_[1]->setPicture(second);
  views_[2]->setPicture(third);
}

void TripleView::setPlaceholder(const QString& text) { views_[1]->setPlaceholder(text); }

void TripleView::showOnly(int i) {
  only_ = i;
  for (int k = 0; k < 3; ++k) views_[k]->setVisible(i < 0 || i == k);
}

void TripleView::keyPressEvent(QKeyEvent* event) {
  const int key = event->key();
  if (key >= Qt::Key_1 && key <= Qt::Key_3) {
    showOnly(key - Qt::Key_1);
  } else if (key == Qt::Key_0 || key == Qt::Key_Escape) {
    showOnly(-1);
  } else {
    QWidget::keyPressEvent(event);
  }
}

}  // namespace lightsketch
