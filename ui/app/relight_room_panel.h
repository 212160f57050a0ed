// The room lights the picture, as the source camera sees it.
#pragma once

#include <QCheckBox>
#include <chrono>

#include "pipeline/illumination/fisheye_light.h"
#include "ui/app/frame_view.h"
#include "ui/app/relight_panel.h"

namespace lightsketch {

class RoomPanel final : public RelightPanel {
  Q_OBJECT
 public:
  explicit RoomPanel(Workspace& workspace, QWidget* parent = nullptr);

  void setScene(std::shared_ptr<const RelightScene> scene) override;
  std::optional<LightIntensities> light() override;
  void entered() override;
  void left() override;

 private:
  void frameCame();
  void prepare();
  void tell();

  std::optional<FisheyeLight> room_;
  bool preparing_ = false;
  bool active_ = false;
  bool first_ = true;  // no frame has lit the picture yet
  QString trouble_;
  std::optional<FrameMetadata> reference_;  // whose exposure and gain count as 1
  QLabel* state_;
  FrameView* view_;
  QCheckBox* compensate_;
};

}  // namespace lightsketch
