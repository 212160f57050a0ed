#include "ui/app/calibration_step.h"

#include <QDateTime>
#include <QFrame>
#include <QHBoxLayout>
#include <QLabel>
#include <QProgressBar>
#include <QPushButton>
#include <QUrl>
#include <QVBoxLayout>
#include <atomic>

#include "ui/app/controls.h"
#include "ui/app/use_calibration.h"

namespace lightsketch {
namespace {

constexpr int kLookMilliseconds = 40;

// The opener of the rig, for cameras set as the preview has them.
CameraOpener prepared(const CameraOpener& open, const RigLink& rig,
                      std::optional<RigProgram> program,
                      const std::shared_ptr<std::atomic<bool>>& switched) {
  return [open, program, switched, setup = rig.setup(), scene = rig.sceneAddress()](
             const std::string& address) -> Result<std::unique_ptr<Camera>> {
    ASSIGN_OR_RETURN(auto camera, open(address));
    RETURN_IF_ERROR(camera->configure(address == scene ? setup.scene : setup.source));
    if (camera->hasFeature("RigProgram")) {
      *switched = true;
      if (program) {
        RETURN_IF_ERROR(camera->setFeature("RigProgram", static_cast<double>(*program)));
      }
    }
    return camera;
  };
}

}  // namespace

CalibrationStep::CalibrationStep(Workspace& workspace, const QString& name, const QString& start,
                                 QWidget* parent)
    : QWidget(parent), workspace_(workspace), start_(start) {
  button_ = new QPushButton(start);
  button_->setObjectName(name);
  button_->setToolTip(tr("Start; press it again to cancel"));
  button_->setMinimumHeight(34);
  words_ = new QLabel;
  words_->setObjectName("words");
  words_->setWordWrap(true);
  enlarge(words_, 2.2, true);
  detail_ = new QLabel;
  detail_->setObjectName("detail");
  detail_->setWordWrap(true);
  enlarge(detail_, 1.3);
  progress_ = new QProgressBar;
  progress_->setObjectName("progress");
  progress_->setAccessibleName(tr("Progress of the calibration"));
  progress_->hide();

  panel_ = new QFrame;
  panel_->setObjectName("question");
  panel_->setFrameShape(QFrame::StyledPanel);
  panel_->setBackgroundRole(QPalette::Midlight);
  panel_->setAutoFillBackground(true);
  question_ = new QLabel;
  question_->setWordWrap(true);
  enlarge(question_, 1.3);
  auto* go = new QPushButton(tr("&Continue"));
  go->setObjectName("continue");
  go->setToolTip(tr("Done: go on"));
  auto* stop = new QPushButton(tr("Give up"));
  stop->setObjectName("giveUp");
  stop->setToolTip(tr("End the calibration"));
  auto* row = new QHBoxLayout(panel_);
  row->addWidget(question_, 1);
  row->addWidget(go);
  row->addWidget(stop);
  panel_->hide();
  connect(go, &QPushButton::clicked, this, [this] { feed_->answer(true); });
  connect(stop, &QPushButton::clicked, this, [this] { feed_->answer(false); });

  connect(button_, &QPushButton::clicked, this, [this] {
    if (task_) {
      task_->cancel();
      say(tr("Stopping ..."));
    } else {
      begin();
    }
  });
  timer_.setInterval(kLookMilliseconds);
  connect(&timer_, &QTimer::timeout, this, &CalibrationStep::look);
}

void CalibrationStep::arrange(QWidget* pictures, QLayout* form, QWidget* result) {
  auto* across = new QHBoxLayout(this);
  across->setContentsMargins(8, 8, 8, 8);
  across->setSpacing(14);
  across->addWidget(pictures, 1);
  auto* side = new QVBoxLayout;
  side->setSpacing(8);
  side->addLayout(form);
  side->addWidget(button_);
  side->addWidget(panel_);
  side->addWidget(words_);
  side->addWidget(detail_);
  side->addWidget(progress_);
  side->addWidget(result, 1);
  side->addStretch();
  across->addLayout(side, 1);
}

bool CalibrationStep::run(const QString& title, std::optional<RigProgram> program, Work work) {
  RigLink& rig = workspace_.rig();
  if (rig.state() == RigLink::State::kLent) {
    workspace_.say({"calibrate", Workspace::Level::kWarning,
                    tr("The cameras are in use; wait for the end of what runs, or cancel it.")});
    return false;
  }
  rig.lend();
  feed_ = std::make_shared<CalibrationFeed>();
  const auto switched = std::make_shared<std::atomic<bool>>(false);
  const CameraOpener open = rig.opener();
  task_ = workspace_.run(
      title, [feed = feed_, open, switched, work = std::move(work),
              cameras = prepared(open, rig, program, switched), scene = rig.sceneAddress(),
              usual = rig.setup().rig.program](Progress& progress, std::stop_token stop) {
        const Result<JobResult> result = work({cameras, *feed}, progress, std::move(stop));
        if (*switched) {
          // What it showed before; if the rig is gone, so is its program.
          if (const auto camera = open(scene)) {
            (void)(*camera)->setFeature("RigProgram", static_cast<double>(usual));
          }
        }
        return result;
      });
  follow(task_, progress_);
  connect(task_, &Task::finished, this, [this, task = task_] {
    task_ = nullptr;
    timer_.stop();
    look();
    panel_->hide();
    button_->setText(start_);
    workspace_.rig().giveBack();
    say({});
    if (!task->result()) {
      say(task->cancelled() ? tr("Cancelled") : tr("It did not work"),
          QString::fromStdString(task->result().error().message));
    }
    finished(task->result());
    Q_EMIT runningChanged(false);
  });
  button_->setText(tr("Cancel"));
  say(tr("Preparing ..."));
  timer_.start();
  Q_EMIT runningChanged(true);
  return true;
}

void CalibrationStep::look() {
  if (const auto state = feed_->take()) told(*state);
  const QString wish = feed_->question();
  question_->setText(wish);
  panel_->setVisible(!wish.isEmpty());
}

void CalibrationStep::say(const QString& text, const QString& detail) {
  words_->setText(text);
  words_->setVisible(!text.isEmpty());
  detail_->setText(detail);
  detail_->setVisible(!detail.isEmpty());
}

std::filesystem::path CalibrationStep::newFolder(const QString& name) const {
  const QString when = QDateTime::currentDateTime().toString("yyyyMMdd-HHmmss");
  return calibrationFolder(workspace_) / (when + "-" + name).toStdString();
}

QString linkTo(const std::filesystem::path& file, const QString& text) {
  return QString("<a href=\"%1\">%2</a>")
      .arg(QUrl::fromLocalFile(toQString(file)).toString(QUrl::FullyEncoded), text.toHtmlEscaped());
}

}  // namespace lightsketch
