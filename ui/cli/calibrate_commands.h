// `lightsketch calibrate ...`
#pragma once

#include "pipeline/job/calibrate_jobs.h"
#include "ui/cli/command.h"

namespace lightsketch {

class CalibrateCommands {
 public:
  // `common` and `action` are filled in when one of the commands is called; they outlive this.
  CalibrateCommands(CLI::App& app, Common& common, Action& action);

 private:
  void addBoard(CLI::App& app);
  void addLens(CLI::App& app);
  void addRig(CLI::App& app);
  void addPose(CLI::App& app);
  void addResponse(CLI::App& app);
  void addApply(CLI::App& app);
  void addCheck(CLI::App& app);
  void addConvert(CLI::App& app);

  Common& common_;
  Action& action_;
  PrintBoardJob board_;
  LensJob lens_;
  RigCalibrationJob rig_;
  PoseJob pose_;
  ResponseJob response_;
  ApplyCalibrationJob apply_;
  CheckDirectionsJob check_;
  ConvertCameraJob convert_;
};

}  // namespace lightsketch
