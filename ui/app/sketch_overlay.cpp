#include "ui/app/sketch_overlay.h"

#include <Eigen/Cholesky>
#include <QApplication>
#include <QPainterPath>
#include <QPalette>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "ui/app/dot_stamp.h"

namespace lightsketch {
namespace {

constexpr double kPathSeconds = 4;
// A tracked lamp's sigma is a few hundredths of a pixel; enlarged so that its shape can be seen.
constexpr double kEllipseScale = 50;

QPointF toPoint(const Eigen::Vector2d& pixel) { return {pixel.x(), pixel.y()}; }

}  // namespace

QColor colourOf(SketchDot dot) {
  switch (dot) {
    case SketchDot::kOpen:
      return {150, 160, 175};
    case SketchDot::kCaptured:
      return {64, 190, 120};
    case SketchDot::kRefused:
      return {240, 80, 70};
  }
  return {};
}

void SketchOverlay::setPlan(const SketchPlan& plan) {
  pixels_.clear();
  for (const auto& pixel : plan.pixels) {
    pixels_.push_back(pixel ? std::optional(toPoint(*pixel)) : std::nullopt);
  }
  dots_.assign(pixels_.size(), SketchDot::kOpen);
  field_.clear();
  for (const auto& corner : plan.field) field_.append(toPoint(corner));
  frame_ = QSizeF(plan.sourceWidth, plan.sourceHeight);
  path_.clear();
  lamp_.reset();
  target_.reset();
  layer_ = {};
}

void SketchOverlay::setDot(int index, SketchDot dot) {
  const auto i = static_cast<std::size_t>(index);
  if (i >= dots_.size() || dots_[i] == dot) return;
  dots_[i] = dot;
  if (layer_.isNull()) return;
  QPainter painter(&layer_);
  painter.setRenderHint(QPainter::Antialiasing);
  if (pixels_[i]) {  // what was there before
    painter.setCompositionMode(QPainter::CompositionMode_Clear);
    painter.setPen(Qt::NoPen);
    painter.setBrush(Qt::black);
    painter.drawEllipse(layerFromFrame_.map(*pixels_[i]), radius_ + 3, radius_ + 3);
    painter.setCompositionMode(QPainter::CompositionMode_SourceOver);
  }
  paintDot(painter, layerFromFrame_, i);
}

void SketchOverlay::addLamp(const std::optional<LampObservation>& lamp) {
  const TimePoint now = lamp ? lamp->time : Clock::now();
  if (lamp && lamp_ && lamp->time == lamp_->time) return;
  if (lamp || (!path_.empty() && path_.back().pixel)) {
    path_.push_back({now, lamp ? std::optional(toPoint(lamp->pixel)) : std::nullopt});
  }
  lamp_ = lamp;
  while (!path_.empty() && toSeconds(now - path_.front().time) > kPathSeconds) path_.pop_front();
}

void SketchOverlay::paintDot(QPainter& painter, const QTransform& widgetFromFrame,
                             std::size_t index) const {
  if (!pixels_[index]) return;
  const QPointF at = widgetFromFrame.map(*pixels_[index]);
  const QColor colour = colourOf(dots_[index]);
  if (dots_[index] == SketchDot::kRefused) {
    const double r = radius_ + 1;
    painter.setPen(QPen(colour, 2.5, Qt::SolidLine, Qt::RoundCap));
    painter.drawLine(at - QPointF(r, r), at + QPointF(r, r));
    painter.drawLine(at - QPointF(r, -r), at + QPointF(r, -r));
    return;
  }
  const bool open = dots_[index] == SketchDot::kOpen;
  stampDot(painter, at, radius_, QPen(open ? colour : QColor(0, 0, 0, 150), 1.3),
           open ? QColor(0, 0, 0, 90) : colour);
}

void SketchOverlay::paintLayer(const QPainter& painter, const QTransform& widgetFromFrame) {
  const QPaintDevice& device = *painter.device();
  const double ratio = device.devicePixelRatioF();
  layer_ = QPixmap(QSize(device.width(), device.height()) * ratio);
  layer_.setDevicePixelRatio(ratio);
  layer_.fill(Qt::transparent);
  layerFromFrame_ = widgetFromFrame;
  const double across = widgetFromFrame.mapRect(QRectF(QPointF(), frame_)).width();
  radius_ = std::clamp(0.25 * across / std::sqrt(static_cast<double>(dots_.size()) + 1), 1.5, 4.5);

  QPainter onto(&layer_);
  onto.setRenderHint(QPainter::Antialiasing);
  // Outside of the field nothing is measured: dimmed.
  QPainterPath outside;
  outside.addRect(QRectF(0, 0, device.width(), device.height()));
  QPainterPath inside;
  inside.addPolygon(widgetFromFrame.map(field_));
  inside.closeSubpath();
  onto.fillPath(outside.subtracted(inside), QColor(0, 0, 0, 130));
  onto.setPen(QPen(QColor(120, 180, 255), 1.5));
  onto.drawPath(inside);
  for (std::size_t i = 0; i < dots_.size(); ++i) paintDot(onto, widgetFromFrame, i);
}

void SketchOverlay::paint(QPainter& painter, const QTransform& widgetFromFrame) {
  if (dots_.empty()) return;
  const QSize size(painter.device()->width(), painter.device()->height());
  if (layer_.isNull() || layerFromFrame_ != widgetFromFrame ||
      layer_.deviceIndependentSize().toSize() != size) {
    paintLayer(painter, widgetFromFrame);
  }
  painter.drawPixmap(0, 0, layer_);
  const QColor accent = QApplication::palette().color(QPalette::Highlight);
  painter.setBrush(Qt::NoBrush);

  // Where the lamp was, older parts fainter: four pieces, since each has one colour.
  constexpr std::size_t kPieces = 4;
  for (std::size_t piece = 0; piece < kPieces; ++piece) {
    QPainterPath curve;
    const std::size_t end = path_.size() * (piece + 1) / kPieces;
    bool down = false;
    for (std::size_t i = path_.size() * piece / kPieces; i < std::min(end + 1, path_.size()); ++i) {
      if (path_[i].pixel) {
        const QPointF at = widgetFromFrame.map(*path_[i].pixel);
        down ? curve.lineTo(at) : curve.moveTo(at);
      }
      down = path_[i].pixel.has_value();
    }
    QColor colour = accent;
    colour.setAlphaF(static_cast<float>(piece + 1) / kPieces);
    painter.setPen(QPen(colour, 2));
    painter.drawPath(curve);
  }

  if (target_ && pixels_.at(static_cast<std::size_t>(*target_))) {
    const QPointF to = widgetFromFrame.map(*pixels_[static_cast<std::size_t>(*target_)]);
    painter.setPen(QPen(accent, 3));
    painter.drawEllipse(to, 11, 11);
  }
  if (!lamp_) return;
  const QPointF at = widgetFromFrame.map(toPoint(lamp_->pixel));
  painter.setPen(QPen(Qt::white, 2));
  painter.drawEllipse(at, 6, 6);
  const Eigen::Matrix2d shape = kEllipseScale * Eigen::Matrix2d(lamp_->covariance.llt().matrixL());
  QPolygonF ellipse;
  for (int i = 0; i < 24; ++i) {
    const double angle = 2 * std::numbers::pi * i / 24;
    const Eigen::Vector2d corner =
        lamp_->pixel + shape * Eigen::Vector2d(std::cos(angle), std::sin(angle));
    ellipse.append(widgetFromFrame.map(toPoint(corner)));
  }
  painter.setPen(QPen(QColor(120, 200, 255), 1.5));
  painter.drawPolygon(ellipse);
}

}  // namespace lightsketch
