// What lies over the source camera's picture while a sketch is recorded.
#pragma once

#include <Eigen/Core>
#include <QPainter>
#include <QPixmap>
#include <QTransform>
#include <deque>
#include <optional>
#include <vector>

#include "capture/tracker/lamp_tracker.h"
#include "ui/app/sketch_plan.h"

namespace lightsketch {

enum class SketchDot { kOpen, kCaptured, kRefused };

// Colours that hold on a dark and on a light ground, and beside each other for the colour-blind.
QColor colourOf(SketchDot dot);

class SketchOverlay {
 public:
  // Nothing captured yet, nothing refused.
  void setPlan(const SketchPlan& plan);
  void setDot(int index, SketchDot dot);
  // Goes on with the lamp's path; nothing: it is not seen now, and the path is interrupted.
  void addLamp(const std::optional<LampObservation>& lamp);
  void setTarget(std::optional<int> index) { target_ = index; }
  void clearPath() { path_.clear(); }

  void paint(QPainter& painter, const QTransform& widgetFromFrame);

 private:
  void paintLayer(const QPainter& painter, const QTransform& widgetFromFrame);
  void paintDot(QPainter& painter, const QTransform& widgetFromFrame, std::size_t index) const;

  struct Step {
    TimePoint time;
    std::optional<QPointF> pixel;
  };
  std::vector<std::optional<QPointF>> pixels_;
  std::vector<SketchDot> dots_;
  QPolygonF field_;
  QSizeF frame_;
  double radius_ = 3;
  std::deque<Step> path_;
  std::optional<LampObservation> lamp_;
  std::optional<int> target_;
  // Field and dots, which seldom change; as large as the view.
  QPixmap layer_;
  QTransform layerFromFrame_;
};

}  // namespace lightsketch
