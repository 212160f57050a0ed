#include "ui/app/use_calibration.h"

#include <QStandardPaths>
#include <QUndoCommand>

namespace lightsketch {
namespace {

class Use final : public QUndoCommand {
 public:
  Use(Workspace& workspace, CalibrationFiles files)
      : QUndoCommand(Workspace::tr("change of calibration")),
        rig_(workspace.rig()),
        before_(workspace.rig().setup()),
        after_(std::move(files)) {}
  void redo() override { rig_.setCalibration(after_); }
  void undo() override { rig_.setCalibration(before_); }

 private:
  RigLink& rig_;
  const CalibrationFiles before_;
  const CalibrationFiles after_;
};

}  // namespace

void useCalibration(Workspace& workspace, const CalibrationFiles& files) {
  workspace.undo().push(new Use(workspace, files));
}

std::filesystem::path calibrationFolder(Workspace& workspace) {
  const QString usual =
      QStandardPaths::writableLocation(QStandardPaths::AppDataLocation) + "/calibration";
  return toPath(workspace.settings().value("calibration/folder", usual).toString());
}

}  // namespace lightsketch
