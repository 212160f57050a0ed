#include "ui/app/hemisphere_view.h"

#include <Eigen/Geometry>
#include <QHelpEvent>
#include <QKeyEvent>
#include <QMouseEvent>
#include <QPainter>
#include <QToolTip>
#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

#include "capture/frame/direction.h"
#include "ui/app/dot_stamp.h"

namespace lightsketch {
namespace {

using Eigen::Vector3d;

constexpr double kMargin = 10;       // logical pixels around the disc
constexpr double kGrab = 12;         // how near a click must be
constexpr double kKeyStep = 2;       // degrees per arrow key
constexpr double kRingDegrees = 30;  // between rings

}  // namespace

HemisphereView::HemisphereView(QWidget* parent) : QWidget(parent) {
  setMouseTracking(true);
  setFocusPolicy(Qt::StrongFocus);
}

void HemisphereView::setWholeSphere(bool on) {
  if (wholeSphere_ == on) return;
  wholeSphere_ = on;
  ground_ = {};
  update();
}

void HemisphereView::setDots(std::vector<Dot> dots) {
  dots_ = std::move(dots);
  marked_ = -1;
  ground_ = {};
  update();
}

void HemisphereView::setDot(int index, const Dot& dot) {
  dots_.at(static_cast<std::size_t>(index)) = dot;
  if (!ground_.isNull()) {
    QPainter painter(&ground_);
    painter.setRenderHint(QPainter::Antialiasing);
    paintDot(painter, dot);
  }
  update();
}

void HemisphereView::setPath(std::vector<Vector3d> path, const QColor& colour) {
  path_ = std::move(path);
  pathColour_ = colour;
  update();
}

void HemisphereView::setHandles(std::vector<Handle> handles) {
  handles_ = std::move(handles);
  selected_ = std::min(selected_, static_cast<int>(handles_.size()) - 1);
  update();
}

void HemisphereView::selectHandle(int index) {
  if (selected_ == index) return;
  selected_ = index;
  update();
  Q_EMIT handleSelected(index);
}

void HemisphereView::setArrow(const std::optional<Vector3d>& from,
                              const std::optional<Vector3d>& to) {
  arrowFrom_ = from;
  arrowTo_ = to;
  update();
}

void HemisphereView::setMarkedDot(int index) {
  marked_ = index;
  update();
}

QPointF HemisphereView::centre() const { return {width() / 2.0, height() / 2.0}; }
double HemisphereView::discRadius() const {
  return std::max(1.0, std::min(width(), height()) / 2.0 - kMargin);
}
double HemisphereView::rimAngle() const {
  return wholeSphere_ ? std::numbers::pi : std::numbers::pi / 2;
}

QPointF HemisphereView::project(const Vector3d& direction) const {
  const double across = std::hypot(direction.x(), direction.y());
  const double angle = std::atan2(across, direction.z());
  const double r = discRadius() * angle / rimAngle();
  if (across < 1e-12) return centre() + QPointF(angle > 1 ? r : 0, 0);
  return centre() + r / across * QPointF(direction.x(), -direction.y());
}

std::optional<Vector3d> HemisphereView::unproject(const QPointF& point) const {
  const QPointF from = point - centre();
  const double r = std::hypot(from.x(), from.y());
  if (r > discRadius()) return std::nullopt;
  const double angle = r / discRadius() * rimAngle();
  if (r < 1e-9) return Vector3d::UnitZ();
  return Vector3d(std::sin(angle) * from.x() / r, -std::sin(angle) * from.y() / r, std::cos(angle));
}

int HemisphereView::dotAt(const QPointF& point) const {
  int best = -1;
  double nearest = kGrab;
  for (std::size_t i = 0; i < dots_.size(); ++i) {
    const QPointF d = project(dots_[i].direction) - point;
    const double distance = std::hypot(d.x(), d.y());
    if (distance < nearest) {
      nearest = distance;
      best = static_cast<int>(i);
    }
  }
  return best;
}

int HemisphereView::handleAt(const QPointF& point) const {
  for (std::size_t i = handles_.size(); i-- > 0;) {
    const QPointF d = project(handles_[i].direction) - point;
    if (std::hypot(d.x(), d.y()) < 1.5 * kGrab) return static_cast<int>(i);
  }
  return -1;
}

void HemisphereView::paintDot(QPainter& painter, const Dot& dot) const {
  const QPointF at = project(dot.direction);
  const QColor base = palette().color(QPalette::Base);
  if (dot.hollow) {
    stampDot(painter, at, dot.radius + 1, Qt::NoPen, base);  // what was there, if it was filled
    stampDot(painter, at, dot.radius, QPen(dot.colour, 1.5), Qt::transparent);
  } else {
    stampDot(painter, at, dot.radius, Qt::NoPen, dot.colour);
  }
}

// Disc, rings and dots seldom change, and there may be thousands.
void HemisphereView::paintGround() {
  ground_ = QPixmap(size() * devicePixelRatioF());
  ground_.setDevicePixelRatio(devicePixelRatioF());
  ground_.fill(Qt::transparent);
  QPainter painter(&ground_);
  painter.setRenderHint(QPainter::Antialiasing);
  const QColor line = palette().color(QPalette::Mid);
  painter.setPen(QPen(line, 1.5));
  painter.setBrush(palette().color(QPalette::Base));
  painter.drawEllipse(centre(), discRadius(), discRadius());
  painter.setBrush(Qt::NoBrush);
  painter.setPen(QPen(line, 1, Qt::DotLine));
  const double rim = rimAngle() * 180 / std::numbers::pi;
  for (double ring = kRingDegrees; ring < rim - 1; ring += kRingDegrees) {
    const double r = discRadius() * ring / rim;
    painter.drawEllipse(centre(), r, r);
  }
  painter.drawLine(centre() - QPointF(discRadius(), 0), centre() + QPointF(discRadius(), 0));
  painter.drawLine(centre() - QPointF(0, discRadius()), centre() + QPointF(0, discRadius()));
  for (const Dot& dot : dots_) paintDot(painter, dot);
}

void HemisphereView::paintRegion(QPainter& painter, const Vector3d& middle, double radius) const {
  QPolygonF outline;
  const Vector3d side = middle.unitOrthogonal();
  for (int i = 0; i < 64; ++i) {
    const Eigen::AngleAxisd around(2 * std::numbers::pi * i / 64, middle);
    outline << project(around * (Eigen::AngleAxisd(radius, middle.cross(side)) * middle));
  }
  painter.setPen(QPen(palette().color(QPalette::Highlight), 2, Qt::DashLine));
  painter.setBrush(Qt::NoBrush);
  painter.drawPolygon(outline);
}

void HemisphereView::paintEvent(QPaintEvent*) {
  if (ground_.isNull()) paintGround();
  QPainter painter(this);
  painter.drawPixmap(0, 0, ground_);
  painter.setRenderHint(QPainter::Antialiasing);

  // The path, older parts fainter.
  const std::size_t n = path_.size();
  for (std::size_t i = 1; i < n; ++i) {
    QColor colour = pathColour_;
    colour.setAlphaF(0.15f + 0.85f * static_cast<float>(i) / static_cast<float>(n));
    painter.setPen(QPen(colour, 2, Qt::SolidLine, Qt::RoundCap));
    painter.drawLine(project(path_[i - 1]), project(path_[i]));
  }

  // The arrow to the next gap, with a ring around it.
  const QColor accent = palette().color(QPalette::Highlight);
  if (arrowTo_) {
    const QPointF to = project(*arrowTo_);
    painter.setBrush(Qt::NoBrush);
    painter.setPen(QPen(accent, 3));
    painter.drawEllipse(to, 11, 11);
    if (arrowFrom_) {
      const QPointF from = project(*arrowFrom_);
      const QPointF along = to - from;
      const double length = std::hypot(along.x(), along.y());
      if (length > 24) {
        const QPointF unit = along / length;
        const QPointF side(-unit.y(), unit.x());
        const QPointF tip = to - 12 * unit;
        painter.drawLine(from + 8 * unit, tip - 8 * unit);
        painter.setBrush(accent);
        painter.drawPolygon(
            QPolygonF({tip, tip - 12 * unit + 6 * side, tip - 12 * unit - 6 * side}));
      }
    }
  }
  if (marked_ >= 0 && marked_ < static_cast<int>(dots_.size())) {
    painter.setBrush(Qt::NoBrush);
    painter.setPen(QPen(accent, 2));
    painter.drawEllipse(project(dots_[static_cast<std::size_t>(marked_)].direction), 9, 9);
  }

  // Lamps, with their size.
  for (std::size_t i = 0; i < handles_.size(); ++i) {
    const Handle& handle = handles_[i];
    const QPointF at = project(handle.direction);
    if (handle.angularRadius > 0) {
      QColor glow = handle.colour;
      glow.setAlphaF(0.25f);
      painter.setPen(Qt::NoPen);
      painter.setBrush(glow);
      const double r = discRadius() * handle.angularRadius / rimAngle();
      painter.drawEllipse(at, r, r);
    }
    painter.setBrush(handle.colour);
    painter.setPen(QPen(static_cast<int>(i) == selected_ ? accent : QColor(Qt::black), 2.5));
    painter.drawEllipse(at, 9, 9);
  }

  // The region being selected.
  if (regionFrom_ && regionTo_) {
    paintRegion(painter, *regionFrom_, angleBetween(*regionFrom_, *regionTo_).radians());
  } else if (keyRegion_) {
    paintRegion(painter, *keyRegion_, keyRadius_);
  }
  Q_EMIT drawn();
}

void HemisphereView::resizeEvent(QResizeEvent*) { ground_ = {}; }

void HemisphereView::changeEvent(QEvent* event) {
  if (event->type() == QEvent::PaletteChange) ground_ = {};
  QWidget::changeEvent(event);
}

void HemisphereView::mousePressEvent(QMouseEvent* event) {
  if (event->button() != Qt::LeftButton) return;
  const int handle = handleAt(event->position());
  if (handle >= 0) {
    selectHandle(handle);
    dragging_ = true;
    return;
  }
  if (selectsRegions_) {
    regionFrom_ = unproject(event->position());
    regionTo_.reset();
    return;
  }
  const int dot = dotAt(event->position());
  if (dot >= 0) Q_EMIT dotClicked(dot);
}

void HemisphereView::mouseMoveEvent(QMouseEvent* event) {
  const QPointF from = event->position() - centre();
  // Beyond the rim a dragged lamp stays on it.
  const double beyond = std::max(1.0, std::hypot(from.x(), from.y()) / (discRadius() * 0.999));
  const auto direction = unproject(centre() + from / beyond);
  if (dragging_ && direction) {
    handles_[static_cast<std::size_t>(selected_)].direction = *direction;
    update();
    Q_EMIT handleMoved(selected_, *direction);
  } else if (regionFrom_) {
    regionTo_ = direction;
    update();
  }
}

void HemisphereView::mouseReleaseEvent(QMouseEvent* event) {
  dragging_ = false;
  if (!regionFrom_) return;
  const auto from = *std::exchange(regionFrom_, std::nullopt);
  const auto to = std::exchange(regionTo_, std::nullopt);
  update();
  if (to && angleBetween(from, *to).degrees() > 0.5) {
    Q_EMIT regionSelected(from, angleBetween(from, *to).radians());
  } else if (const int dot = dotAt(event->position()); dot >= 0) {
    Q_EMIT dotClicked(dot);
  }
}

std::optional<Vector3d> HemisphereView::stepped(const Vector3d& from, QPointF steps) const {
  return unproject(project(from) +
                   kKeyStep * std::numbers::pi / 180 / rimAngle() * discRadius() * steps);
}

bool HemisphereView::editRegion(int key) {
  switch (key) {
    case Qt::Key_Plus:
    case Qt::Key_Minus:
      keyRadius_ = std::clamp(keyRadius_ * (key == Qt::Key_Plus ? 1.15 : 1 / 1.15), 0.03, 1.5);
      if (!keyRegion_) keyRegion_ = Vector3d::UnitZ();
      break;
    case Qt::Key_Escape:
      if (!keyRegion_) return false;
      keyRegion_.reset();
      break;
    case Qt::Key_Delete:
      if (!keyRegion_) return false;
      Q_EMIT regionSelected(*std::exchange(keyRegion_, std::nullopt), keyRadius_);
      break;
    default:
      return false;
  }
  update();
  return true;
}

void HemisphereView::keyPressEvent(QKeyEvent* event) {
  if (selectsRegions_ && editRegion(event->key())) return;
  const bool handle = selected_ >= 0 && selected_ < static_cast<int>(handles_.size());
  const std::map<int, QPointF> arrows{{Qt::Key_Left, {-1, 0}},
                                      {Qt::Key_Right, {1, 0}},
                                      {Qt::Key_Up, {0, -1}},
                                      {Qt::Key_Down, {0, 1}}};
  const auto arrow = arrows.find(event->key());
  if ((!handle && !selectsRegions_) || arrow == arrows.end()) {
    QWidget::keyPressEvent(event);
    return;
  }
  if (handle) {
    Vector3d& direction = handles_[static_cast<std::size_t>(selected_)].direction;
    if (const auto next = stepped(direction, arrow->second)) {
      direction = *next;
      Q_EMIT handleMoved(selected_, *next);
    }
  } else {
    // A circle that is not there yet begins in the middle; it moves faster than a lamp.
    keyRegion_ = keyRegion_ ? stepped(*keyRegion_, 2 * arrow->second).value_or(*keyRegion_)
                            : Vector3d::UnitZ();
  }
  update();
}

bool HemisphereView::event(QEvent* event) {
  if (event->type() == QEvent::ToolTip) {
    const auto* help = static_cast<QHelpEvent*>(event);
    const int dot = dotAt(help->pos());
    if (dot >= 0 && !dots_[static_cast<std::size_t>(dot)].tip.isEmpty()) {
      QToolTip::showText(help->globalPos(), dots_[static_cast<std::size_t>(dot)].tip, this);
    } else {
      QToolTip::hideText();
    }
    return true;
  }
  return QWidget::event(event);
}

}  // namespace lightsketch
