// One camera of the rig: its live view, its settings, what its link does.
#pragma once

#include <QWidget>
#include <deque>

#include "ui/app/frame_view.h"
#include "ui/app/rig_link.h"

class QCheckBox;
class QDoubleSpinBox;
class QLabel;
class QProgressBar;
class QPushButton;
class QSlider;
class QSpinBox;
class QTimer;

namespace lightsketch {

class HistogramView;

// A live view on which a rectangle can be dragged.
class RegionView final : public FrameView {
  Q_OBJECT
 public:
  using FrameView::FrameView;

 Q_SIGNALS:
  // Pixels of the picture shown; never empty.
  void selected(const QRect& pixels);

 protected:
  void paintEvent(QPaintEvent* event) override;
  void mousePressEvent(QMouseEvent* event) override;
  void mouseMoveEvent(QMouseEvent* event) override;
  void mouseReleaseEvent(QMouseEvent* event) override;
  void keyPressEvent(QKeyEvent* event) override;

 private:
  std::optional<QPointF> from_;
  QPointF to_;
};

class CameraPanel final : public QWidget {
  Q_OBJECT
 public:
  CameraPanel(RigLink& rig, bool sceneCamera, QWidget* parent = nullptr);

  // Middles of the exposures of the latest pictures, oldest first.
  const std::deque<TimePoint>& exposures() const { return exposures_; }
  // The link's figures; called now and then.
  void refresh();

 private:
  QLayout* buildTools();
  QLayout* buildSettings();
  LiveView& view() const { return scene_ ? rig_.sceneView() : rig_.sourceView(); }
  void showPicture();
  void showUsed();
  void configure(const CameraSettings& settings);
  void sendExposureSoon();

  RigLink& rig_;
  const bool scene_;
  RegionView* picture_;
  HistogramView* histogram_;
  QCheckBox* saturationOverlay_;
  QCheckBox* focusOverlay_;
  QLabel* saturated_;
  QProgressBar* focus_;
  QSlider* exposureSlider_;
  QDoubleSpinBox* exposure_;
  QDoubleSpinBox* gain_;
  QDoubleSpinBox* rate_;
  QSpinBox* region_[4];
  QLabel* answer_;
  QLabel* link_;
  QTimer* exposureSoon_;
  std::deque<TimePoint> exposures_;
  double sharpest_ = 0;
};

}  // namespace lightsketch
