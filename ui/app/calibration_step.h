// What the calibrations have in common: a job on the lent cameras, its progress, its questions.
#pragma once

#include <QTimer>
#include <QWidget>
#include <functional>
#include <memory>

#include "pipeline/job/jobs.h"
#include "ui/app/calibration_feed.h"
#include "ui/app/workspace.h"

class QFrame;
class QLabel;
class QLayout;
class QProgressBar;
class QPushButton;

namespace lightsketch {

class CalibrationStep : public QWidget {
  Q_OBJECT
 public:
  bool running() const { return task_ != nullptr; }
  // Presses the button.
  virtual void begin() = 0;

 Q_SIGNALS:
  void runningChanged(bool running);

 protected:
  // `name`: "calibrateLens", the button's objectName.
  CalibrationStep(Workspace& workspace, const QString& name, const QString& start,
                  QWidget* parent = nullptr);
  // Pictures at the left; at the right the form, the button and what it says, then the result.
  void arrange(QWidget* pictures, QLayout* form, QWidget* result);

  struct Cameras {
    CameraOpener open;  // as the rig is set, showing `program` if it is a simulated one
    CalibrationFeed& feed;
  };
  using Work = std::function<Result<JobResult>(const Cameras&, Progress&, std::stop_token)>;
  // Lends the cameras, runs, gives them back; then finished(). False, with a message, if something
  // else has the cameras. `program`: nothing if the job says itself what it wants to see.
  bool run(const QString& title, std::optional<RigProgram> program, Work work);

  // On the UI thread.
  virtual void told(const LiveViewState&) {}
  virtual void finished(const Result<JobResult>& result) = 0;

  // The large words.
  void say(const QString& text, const QString& detail = {});
  Workspace& workspace() const { return workspace_; }
  // A new folder for this calibration's files, not made yet.
  std::filesystem::path newFolder(const QString& name) const;

 private:
  void look();

  Workspace& workspace_;
  const QString start_;
  QPushButton* button_;
  QLabel* words_;
  QLabel* detail_;
  QProgressBar* progress_;
  QFrame* panel_;
  QLabel* question_;
  QTimer timer_;
  std::shared_ptr<CalibrationFeed> feed_;
  Task* task_ = nullptr;
};

// For a label with setOpenExternalLinks.
QString linkTo(const std::filesystem::path& file, const QString& text);

}  // namespace lightsketch
