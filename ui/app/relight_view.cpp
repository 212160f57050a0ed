#include "ui/app/relight_view.h"

#include <QKeyEvent>
#include <QLabel>
#include <QMouseEvent>
#include <QPainter>
#include <QTimer>
#include <QWheelEvent>
#include <algorithm>
#include <cmath>
#include <utility>

namespace lightsketch {
namespace {

constexpr int kGround = 24;  // grey level around the picture: dark, and of no colour
constexpr int kGap = 12;     // between picture and photograph
constexpr double kMostZoom = 16;
constexpr int kRefineMilliseconds = 150;
constexpr double kReduced = 0.67;  // shown smaller than this, a picture shimmers without averages
constexpr int kPointerMilliseconds = 2000;
// Of a frame at 60 a second, what drawing may take; the rest is for the screen and everybody else.
constexpr double kDrawSeconds = 0.6 / 60;

double milliseconds(RelightView::Clock::duration duration) {
  return std::chrono::duration<double, std::milli>(duration).count();
}

}  // namespace

RelightView::RelightView(QWidget* parent)
    : QWidget(parent), governor_({.targetSeconds = kDrawSeconds}), refine_(new QTimer(this)) {
  setMinimumSize(320, 240);
  setAttribute(Qt::WA_OpaquePaintEvent);
  setFocusPolicy(Qt::StrongFocus);
  setAccessibleName(tr("Relit picture"));
  placeholder_ = new QLabel(this);
  relitCaption_ = new QLabel(tr("relit"), this);
  photographCaption_ = new QLabel(this);
  for (QLabel* words : {placeholder_, relitCaption_, photographCaption_}) {
    words->setAlignment(Qt::AlignCenter);
    words->setMargin(6);
    words->setStyleSheet("color: rgb(190, 190, 190);");  // on the dark ground of either theme
    words->setAttribute(Qt::WA_TransparentForMouseEvents);
  }
  placeholder_->setWordWrap(true);
  refine_->setSingleShot(true);
  connect(refine_, &QTimer::timeout, this, [this] {
    moving_ = false;
    stale_ = stale_ || drawnShare_ < 1;
    update();
  });
}

RelightView::~RelightView() = default;

void RelightView::setScene(std::shared_ptr<RelightScene> scene) {
  scene_ = std::move(scene);
  governor_ = FrameRateGovernor({.targetSeconds = kDrawSeconds});
  zoom_ = 1;
  middle_ = {0.5, 0.5};
  if (scene_) {
    // Rows of whole cache lines from an aligned address on.
    strideBytes_ = (static_cast<std::size_t>(scene_->width()) * 4 + 63) / 64 * 64;
    buffer_.assign(strideBytes_ * static_cast<std::size_t>(scene_->height()) + 64, std::byte{0});
    const auto address = reinterpret_cast<std::uintptr_t>(buffer_.data());
    picture_ =
        QImage(reinterpret_cast<uchar*>(buffer_.data() + (64 - address % 64) % 64), scene_->width(),
               scene_->height(), static_cast<qsizetype>(strideBytes_), QImage::Format_RGB32);
  }
  stale_ = true;
  placeWords();
  update();
}

void RelightView::setExposure(float exposure, Tone tone) {
  exposure_ = exposure;
  tone_ = tone;
  lightChanged();
}

void RelightView::setPhotograph(const QImage& photograph, const QString& caption) {
  photograph_ = photograph.isNull() ? QImage() : photograph.convertToFormat(QImage::Format_RGB32);
  photographCaption_->setText(caption);
  placeWords();
  stale_ = true;  // another part of the picture may be in sight
  update();
}

void RelightView::setPlaceholder(const QString& text) {
  placeholder_->setText(text);
  placeWords();
}

void RelightView::placeWords() {
  placeholder_->setVisible(!scene_);
  placeholder_->setGeometry(rect().adjusted(40, 40, -40, -40));
  const auto below = [&](QLabel* caption, const QRectF& pane) {
    caption->setVisible(scene_ && !photograph_.isNull());
    const int height = caption->sizeHint().height();
    caption->setGeometry(pane.toRect().adjusted(0, this->height() - height, 0, 0));
  };
  below(relitCaption_, picturePane());
  below(photographCaption_, photographPane());
}

void RelightView::resizeEvent(QResizeEvent* event) {
  QWidget::resizeEvent(event);
  stale_ = true;  // more of a zoomed picture may be in sight
  placeWords();
}

void RelightView::setHidesPointer(bool on) {
  delete pointer_;
  pointer_ = nullptr;
  if (!on) return;
  setMouseTracking(true);
  pointer_ = new QTimer(this);
  pointer_->setSingleShot(true);
  pointer_->start(kPointerMilliseconds);
  connect(pointer_, &QTimer::timeout, this, [this] { setCursor(Qt::BlankCursor); });
}

void RelightView::lightChanged(Clock::time_point when) {
  if (!changed_ && scene_) changed_ = when;
  stale_ = true;
  update();
}

RelightStatistics RelightView::statistics() const {
  RelightStatistics now = statistics_;
  const auto since = Clock::now() - std::chrono::seconds(1);
  now.framesPerSecond = static_cast<double>(
      std::count_if(recent_.begin(), recent_.end(), [&](auto at) { return at > since; }));
  return now;
}

QRectF RelightView::picturePane() const {
  if (photograph_.isNull()) return rect();
  return {0, 0, (width() - kGap) / 2.0, static_cast<double>(height())};
}

QRectF RelightView::photographPane() const {
  const double half = (width() - kGap) / 2.0;
  return {half + kGap, 0, half, static_cast<double>(height())};
}

QRectF RelightView::pictureIn(const QRectF& pane, const QSizeF& size) const {
  const QSizeF shown = zoom_ * size.scaled(pane.size(), Qt::KeepAspectRatio);
  const QPointF corner =
      pane.center() - QPointF(middle_.x() * shown.width(), middle_.y() * shown.height());
  return {corner, shown};
}

PixelRectangle RelightView::visible() const {
  const QRectF pane = picturePane();
  const QRectF picture = pictureIn(pane, QSizeF(scene_->width(), scene_->height()));
  const QRectF seen = pane.intersected(picture);
  const double scale = scene_->width() / picture.width();
  PixelRectangle part;
  part.x = std::clamp(static_cast<int>((seen.left() - picture.left()) * scale) - 1, 0,
                      scene_->width() - 1);
  part.y = std::clamp(static_cast<int>((seen.top() - picture.top()) * scale) - 1, 0,
                      scene_->height() - 1);
  part.width = std::min(static_cast<int>(seen.width() * scale) + 3, scene_->width() - part.x);
  part.height = std::min(static_cast<int>(seen.height() * scale) + 3, scene_->height() - part.y);
  return part;
}

void RelightView::draw() {
  const auto begin = Clock::now();
  if (prepare_) prepare_();
  const bool atRest = !changed_;
  const float share = atRest ? 1.0f : static_cast<float>(governor_.share());
  // bits() would copy: the picture's memory is ours.
  auto* const pixels =
      reinterpret_cast<std::byte*>(const_cast<uchar*>(std::as_const(picture_).bits()));
  renderer_.render(
      scene_->relighter, tone_, {.exposure = exposure_, .share = share, .visible = visible()},
      {pixels, strideBytes_ * static_cast<std::size_t>(scene_->height())}, strideBytes_);
  const auto drawn = Clock::now();
  statistics_.drawMilliseconds = milliseconds(drawn - begin);
  if (!atRest) governor_.frame(std::chrono::duration<double>(drawn - begin).count());
  statistics_.share = static_cast<float>(governor_.share());
  drawnShare_ = share;
  moving_ = !atRest;
  if (moving_) refine_->start(kRefineMilliseconds);
  drawing_ = std::exchange(changed_, std::nullopt);
  stale_ = false;
}

void RelightView::paintPicture(QPainter& painter, const QImage& picture, const QRectF& pane) const {
  const QRectF target = pictureIn(pane, picture.size());
  painter.setClipRect(pane);
  const double scale = target.width() * devicePixelRatioF() / picture.width();
  if (scale < kReduced && !moving_) {
    // Evenly averaged; two taps in each direction would leave pixels out.
    QImage reduced = picture.scaled((target.size() * devicePixelRatioF()).toSize(),
                                    Qt::IgnoreAspectRatio, Qt::SmoothTransformation);
    reduced.setDevicePixelRatio(devicePixelRatioF());
    painter.drawImage(target.topLeft(), reduced);
    return;
  }
  painter.setRenderHint(QPainter::SmoothPixmapTransform, scale != 1);
  painter.drawImage(target, picture);
}

void RelightView::paintEvent(QPaintEvent*) {
  QPainter painter(this);
  painter.fillRect(rect(), QColor(kGround, kGround, kGround));
  if (!scene_) return;
  if (stale_) draw();
  paintPicture(painter, picture_, picturePane());
  if (!photograph_.isNull()) paintPicture(painter, photograph_, photographPane());
  // Qt hands what was painted to the screen before it looks at the next event.
  if (drawing_) QMetaObject::invokeMethod(this, &RelightView::presented, Qt::QueuedConnection);
}

void RelightView::presented() {
  if (!drawing_) return;
  const auto now = Clock::now();
  const double latency = milliseconds(now - *drawing_);
  drawing_.reset();
  // After a rest there is no interval to speak of.
  double interval = presentedAt_ ? milliseconds(now - *presentedAt_) : 0;
  if (interval > 250) interval = 0;
  presentedAt_ = now;
  std::erase_if(recent_, [&](auto at) { return at < now - std::chrono::seconds(1); });
  recent_.push_back(now);
  statistics_.latencyMilliseconds = latency;
  Q_EMIT shown(interval, latency, statistics_.drawMilliseconds);
}

void RelightView::mousePressEvent(QMouseEvent* event) {
  last_ = event->position();
  panning_ = event->button() != Qt::LeftButton || event->modifiers() & Qt::ControlModifier;
}

void RelightView::mouseMoveEvent(QMouseEvent* event) {
  if (pointer_) {
    unsetCursor();
    pointer_->start(kPointerMilliseconds);
  }
  if (!last_ || !scene_) return;
  const QPointF by = event->position() - *last_;
  last_ = event->position();
  const QRectF picture = pictureIn(picturePane(), QSizeF(scene_->width(), scene_->height()));
  if (panning_) {
    middle_ -= QPointF(by.x() / picture.width(), by.y() / picture.height());
    middle_ = {std::clamp(middle_.x(), 0.0, 1.0), std::clamp(middle_.y(), 0.0, 1.0)};
    stale_ = true;
    update();
    return;
  }
  const double half = std::min(picture.width(), picture.height()) / (2 * zoom_);
  Q_EMIT dragged({by.x() / half, -by.y() / half});
}

void RelightView::mouseReleaseEvent(QMouseEvent*) { last_.reset(); }

void RelightView::mouseDoubleClickEvent(QMouseEvent*) {
  zoom_ = 1;
  middle_ = {0.5, 0.5};
  stale_ = true;
  update();
}

void RelightView::wheelEvent(QWheelEvent* event) {
  if (!scene_) return;
  // What is under the pointer stays there.
  const QSizeF size(scene_->width(), scene_->height());
  const QRectF pane =
      event->position().x() > picturePane().right() ? photographPane() : picturePane();
  const QRectF before = pictureIn(pane, size);
  const QPointF at((event->position().x() - before.left()) / before.width(),
                   (event->position().y() - before.top()) / before.height());
  zoom_ = std::clamp(zoom_ * std::pow(1.0015, event->angleDelta().y()), 1.0, kMostZoom);
  const QSizeF after = pictureIn(pane, size).size();
  middle_ = {at.x() - (event->position().x() - pane.center().x()) / after.width(),
             at.y() - (event->position().y() - pane.center().y()) / after.height()};
  if (zoom_ == 1) middle_ = {0.5, 0.5};
  middle_ = {std::clamp(middle_.x(), 0.0, 1.0), std::clamp(middle_.y(), 0.0, 1.0)};
  stale_ = true;
  update();
}

void RelightView::keyPressEvent(QKeyEvent* event) {
  if (event->key() == Qt::Key_Escape) {
    Q_EMIT leaveRequested();
    return;
  }
  QWidget::keyPressEvent(event);
}

}  // namespace lightsketch
