// The Develop page's form: how good or how large the model is to be, and its file.
#pragma once

#include <QWidget>

#include "pipeline/job/jobs.h"
#include "ui/app/sketch_summary.h"
#include "ui/app/workspace.h"

class QButtonGroup;
class QCheckBox;
class QComboBox;
class QDoubleSpinBox;
class QLineEdit;
class QSpinBox;

namespace lightsketch {

class DevelopChoices final : public QWidget {
  Q_OBJECT
 public:
  explicit DevelopChoices(Workspace& workspace, QWidget* parent = nullptr);
  // Of the workspace's sketch. `another`: a file name given by hand was for the one before.
  void setSummary(const SketchSummary& summary, bool another);
  // What is chosen, for that sketch.
  CompressJob job() const;
  // Whether the model will not see this frame.
  bool keepsBack(int frame) const;

 Q_SIGNALS:
  void holdOutChanged();

 private:
  enum Choice { kSmall, kStandard, kArchive, kSize, kPsnr, kPaper };

  QString suggestedFile() const;
  void chosen();

  Workspace& workspace_;
  SketchSummary summary_;
  QString fileByHand_;
  QButtonGroup* choices_;
  QDoubleSpinBox* megabytes_;
  QDoubleSpinBox* decibels_;
  QSpinBox* blockRank_;
  QSpinBox* rank_;
  QComboBox* storage_;
  QComboBox* blockSize_;
  QCheckBox* singleLamp_;
  QCheckBox* near_;
  QLineEdit* sceneModel_;
  QCheckBox* holdOut_;
  QLineEdit* file_;
};

}  // namespace lightsketch
