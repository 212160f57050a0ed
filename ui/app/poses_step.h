// Where the cameras stand, and their lenses, from one board waved before both.
#pragma once

#include <array>

#include "ui/app/lens_step.h"

class QCheckBox;

namespace lightsketch {

class PosesStep final : public CalibrationStep {
  Q_OBJECT
 public:
  PosesStep(Workspace& workspace, BoardBox& board, QWidget* parent = nullptr);
  void begin() override;

 protected:
  void told(const LiveViewState& state) override;
  void finished(const Result<JobResult>& result) override;

 private:
  BoardBox& board_;
  std::array<FrameView*, 2> pictures_;
  QSpinBox* views_;
  QCheckBox* keepFrame_;
  QWidget* result_;
  QLabel* text_;
  QPushButton* use_;
  std::array<BoardGuide, 2> guides_;  // scene camera, source camera
  std::filesystem::path folder_;
};

}  // namespace lightsketch
