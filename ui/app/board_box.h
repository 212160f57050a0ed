// Which calibration board is held before the cameras.
#pragma once

#include <QWidget>

#include "calibration/lens/board.h"

class QComboBox;
class QDoubleSpinBox;
class QSpinBox;

namespace lightsketch {

class Workspace;

class BoardBox final : public QWidget {
  Q_OBJECT
 public:
  // Remembers itself among the settings.
  explicit BoardBox(Workspace& workspace, QWidget* parent = nullptr);

  BoardGeometry board() const;
  // In the background, at true scale; .pdf, .svg or .png.
  void print(const QString& file);

 private:
  void load();
  void save();

  Workspace& workspace_;
  QComboBox* kind_;
  QSpinBox* columns_;
  QSpinBox* rows_;
  QDoubleSpinBox* square_;
  QDoubleSpinBox* marker_;
  QComboBox* dictionary_;
};

}  // namespace lightsketch
