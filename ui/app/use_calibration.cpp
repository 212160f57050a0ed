#include "ui/app/use_calibration.h"

#include <QStandardPaths>
#include <QUndoCommand>

namespace lightsketch {
namespace {

void apply(RigLink& rig, const CalibrationFiles& files) {
  rig.setCalibration(files.sourceModel, files.rigGeometry, files.sceneResponse);
}

class Use final : public QUndoCommand {
 public:
  Use(Workspace& workspace, CalibrationFiles files)
      : QUndoCommand(Workspace::tr("change of calibration")),
        rig_(workspace.rig()),
        before_(calibrationInUse(workspace)),
        after_(std::move(files)) {}
  void redo() override { apply(rig_, after_); }
  void undo() override { apply(rig_, before_); }

 private:
  RigLink& rig_;
  const CalibrationFiles before_;
  const CalibrationFiles after_;
};

}  // namespace

CalibrationFiles calibrationInUse(Workspace& workspace) {
  const RigSetup& setup = workspace.rig().setup();
  return {setup.sourceModel, setup.rigGeometry, setup.sceneResponse};
}

void useCalibration(Workspace& workspace, const CalibrationFiles& files) {
  workspace.undo().push(new Use(workspace, files));
}

std::filesystem::path calibrationFolder(Workspace& workspace) {
  const QString usual =
      QStandardPaths::writableLocation(QStandardPaths::AppDataLocation) + "/calibration";
  return toPath(workspace.settings().value("calibration/folder", usual).toString());
}

}  // namespace lightsketch
