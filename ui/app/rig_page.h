#pragma once

#include <QTimer>

#include "ui/app/page.h"
#include "ui/app/use_calibration.h"

class QComboBox;
class QLabel;
class QPushButton;

namespace lightsketch {

class CameraPanel;

// Which cameras, how they are set, what they send.
class RigPage final : public Page {
  Q_OBJECT
 public:
  explicit RigPage(Workspace& workspace, QWidget* parent = nullptr);
  QString title() const override { return tr("Rig"); }
  QString purpose() const override;
  void entered() override;
  void left() override;

 private:
  QLayout* buildCameras();
  QLayout* buildFiles();
  void fillCameras();
  void useChosenCameras();
  void showState();
  void showFiles();
  void showLink();
  void chooseFile(const QString& title, std::filesystem::path CalibrationFiles::*which);
  void use(std::filesystem::path CalibrationFiles::*which, const std::filesystem::path& file);

  QComboBox* mode_;
  QComboBox* scene_;
  QComboBox* source_;
  QPushButton* search_;
  QLabel* state_;
  QLabel* pairing_;
  CameraPanel* scenePanel_;
  CameraPanel* sourcePanel_;
  struct File {
    QLabel* label;
    std::filesystem::path CalibrationFiles::*which;
  };
  std::vector<File> files_;
  QPushButton* calibrate_;
  QTimer refresh_;
  bool searched_ = false;
};

}  // namespace lightsketch
