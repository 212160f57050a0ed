// The Sketch page's form: where a recording goes and what it is to be like.
#pragma once

#include <QWidget>
#include <filesystem>

#include "ui/app/sketch_plan.h"

class QCheckBox;
class QComboBox;
class QDoubleSpinBox;
class QLabel;
class QPushButton;
class QSpinBox;

namespace lightsketch {

struct RecordJob;
class Workspace;

class SketchOptions final : public QWidget {
  Q_OBJECT
 public:
  explicit SketchOptions(Workspace& workspace, QWidget* parent = nullptr);

  // Of the recording. At first one that is not there yet, named by date and time.
  std::filesystem::path folder() const;
  void setFolder(const std::filesystem::path& folder);
  void setNewFolder();
  // What stands in the form; cameras are the caller's.
  SketchWish wish() const;
  void fill(RecordJob& job) const;
  double coverageGoal() const;
  // What the folder holds. A sketch that is there is gone on with: its directions are fixed.
  void showPlan(const SketchPlan& plan);
  void showTrouble(const QString& text);

 Q_SIGNALS:
  // folder or directions.
  void wishChanged();
  void goalChanged();

 private:
  void chooseFolder();

  Workspace& workspace_;
  QComboBox* folder_;
  QLabel* note_;
  QSpinBox* directions_;
  QComboBox* domain_;
  QSpinBox* goal_;
  QDoubleSpinBox* timeLimit_;
  QComboBox* bracket_;
  QCheckBox* keepRaw_;
};

}  // namespace lightsketch
