// An environment map around the object, turned by hand.
#pragma once

#include <QCheckBox>
#include <QImage>
#include <QPushButton>
#include <filesystem>

#include "capture/frame/image.h"
#include "pipeline/illumination/turnable_environment.h"
#include "ui/app/relight_panel.h"

namespace lightsketch {

// The map as a strip that is dragged round; what stands in the middle stands before the object.
class EnvironmentStrip final : public QWidget {
  Q_OBJECT
 public:
  explicit EnvironmentStrip(QWidget* parent = nullptr);
  void setPicture(const QImage& picture);  // of the whole map
  void setYaw(double degrees);
  QSize sizeHint() const override { return {260, 130}; }

 Q_SIGNALS:
  void turned(double byDegrees);

 protected:
  void paintEvent(QPaintEvent* event) override;
  void mousePressEvent(QMouseEvent* event) override;
  void mouseMoveEvent(QMouseEvent* event) override;
  void keyPressEvent(QKeyEvent* event) override;

 private:
  QImage picture_;
  QPixmap scaled_;
  double yaw_ = 0;
  double lastX_ = 0;
};

class EnvironmentPanel final : public RelightPanel {
  Q_OBJECT
 public:
  explicit EnvironmentPanel(Workspace& workspace, QWidget* parent = nullptr);

  void setScene(std::shared_ptr<const RelightScene> scene) override;
  std::optional<LightIntensities> light() override;
  void drag(QPointF by) override;
  bool moving() const override { return turning_->isChecked(); }
  void setMoving(bool on) override { turning_->setChecked(on); }
  void advance(double seconds) override;
  std::optional<Film> film() const override;
  void entered() override;

  // In the background. Empty: the built-in sky.
  void open(const std::filesystem::path& file);
  double yawDegrees() const { return yaw_; }
  void setYaw(double degrees);

 private:
  void prepare();
  void choose();

  std::filesystem::path file_;
  std::shared_ptr<const RadianceImage> map_;
  std::optional<TurnableEnvironment> environment_;
  double yaw_ = 0;
  int preparing_ = 0;  // counts what was asked for; older answers are let go
  QLabel* name_;
  EnvironmentStrip* strip_;
  QSlider* angle_;
  QCheckBox* turning_;
};

}  // namespace lightsketch
