// What a camera's counts mean, from a bracket of exposures.
#pragma once

#include "ui/app/calibration_step.h"

class QCheckBox;
class QComboBox;
class QDoubleSpinBox;
class QLabel;
class QPushButton;
class QSpinBox;
class QStackedWidget;

namespace lightsketch {

class ResponsePlot;
struct SensorModel;

class ResponseStep final : public CalibrationStep {
  Q_OBJECT
 public:
  explicit ResponseStep(Workspace& workspace, QWidget* parent = nullptr);
  void begin() override;

 protected:
  void finished(const Result<JobResult>& result) override;

 private:
  bool ofScene() const;

  QComboBox* camera_;
  QDoubleSpinBox* shortest_;
  QDoubleSpinBox* longest_;
  QSpinBox* frames_;
  QCheckBox* dark_;
  QCheckBox* diffuser_;
  QStackedWidget* pictures_;
  QWidget* result_;
  ResponsePlot* plot_;
  QLabel* figures_;
  QPushButton* use_;
  std::filesystem::path folder_;
};

}  // namespace lightsketch
