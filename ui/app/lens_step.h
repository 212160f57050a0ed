// A camera's lens, from a board held before it.
#pragma once

#include <optional>

#include "ui/app/calibration_step.h"
#include "ui/app/field_coverage.h"

class QComboBox;
class QPainter;
class QPushButton;
class QSpinBox;
class QStackedWidget;
class QTransform;

namespace lightsketch {

class BoardBox;
class FrameView;
struct FieldUncertainty;
class UncertaintyMap;

// What a camera with a board before it sees, and where the board goes next; drawn over its picture.
struct BoardGuide {
  std::vector<Eigen::Vector2d> corners;
  std::shared_ptr<const std::vector<Eigen::Vector2d>> kept;
  FieldCoverage coverage;
  std::optional<int> next;

  // Of the camera with this number in the state.
  void follow(const LiveViewState& state, std::size_t camera);
  void paint(QPainter& painter, const QTransform& widgetFromFrame) const;
};

class LensStep final : public CalibrationStep {
  Q_OBJECT
 public:
  LensStep(Workspace& workspace, BoardBox& board, QWidget* parent = nullptr);
  void begin() override;

 protected:
  void told(const LiveViewState& state) override;
  void finished(const Result<JobResult>& result) override;

 private:
  bool ofScene() const;
  void showCamera();

  BoardBox& board_;
  QComboBox* camera_;
  QSpinBox* views_;
  QStackedWidget* pictures_;
  FrameView* scenePicture_;
  FrameView* sourcePicture_;
  QWidget* result_;
  UncertaintyMap* map_;
  QLabel* figures_;
  QLabel* advice_;
  QPushButton* use_;
  BoardGuide guide_;
  std::filesystem::path file_;  // that comes, or has come, out
  std::filesystem::path report_;
  std::shared_ptr<const FieldUncertainty> field_;  // filled when the job has ended
};

// "hold still", "new view 12 of 40".
QString inWords(ViewVerdict verdict, int count, int wanted);
// A calibrated lens in a few lines of rich text, and what to do better, from the job's figures.
QString describeLens(const Json& figures);
QString adviceOn(const Json& figures);

}  // namespace lightsketch
