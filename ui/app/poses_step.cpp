#include "ui/app/poses_step.h"

#include <QCheckBox>
#include <QHBoxLayout>
#include <QLabel>
#include <QPushButton>
#include <QScrollArea>
#include <QSpinBox>
#include <QVBoxLayout>

#include "pipeline/job/calibrate_jobs.h"
#include "ui/app/board_box.h"
#include "ui/app/controls.h"
#include "ui/app/frame_view.h"
#include "ui/app/use_calibration.h"

namespace lightsketch {

PosesStep::PosesStep(Workspace& workspace, BoardBox& board, QWidget* parent)
    : CalibrationStep(workspace, "calibratePoses", tr("&Start"), parent), board_(board) {
  auto* both = new QWidget;
  auto* stacked = new QVBoxLayout(both);
  stacked->setContentsMargins(0, 0, 0, 0);
  for (const std::size_t i : {0u, 1u}) {
    auto* picture =
        new FrameView(i == 0 ? workspace.rig().sceneView() : workspace.rig().sourceView());
    picture->setAccessibleName(i == 0 ? tr("Live picture of the scene camera")
                                      : tr("Live picture of the source camera"));
    picture->setPlaceholder(i == 0 ? tr("scene camera: no picture yet")
                                   : tr("source camera: no picture yet"));
    picture->setOverlay([this, i](QPainter& painter, const QTransform& widgetFromFrame) {
      if (running()) guides_[i].paint(painter, widgetFromFrame);
    });
    pictures_[i] = picture;
    stacked->addWidget(picture, 1);
  }

  auto* form = new QVBoxLayout;
  auto* row = new QHBoxLayout;
  views_ = new QSpinBox;
  views_->setObjectName("posesViews");
  views_->setRange(3, 1000);
  views_->setValue(20);
  views_->setToolTip(tr("Views of the board that each camera is to get; some are of both at once"));
  row->addWidget(labelFor(views_, tr("&Views for each camera")));
  row->addWidget(views_);
  row->addStretch();
  form->addLayout(row);
  keepFrame_ = new QCheckBox(tr("&Keep where the subject is"));
  keepFrame_->setObjectName("keepFrame");
  keepFrame_->setToolTip(
      tr("The scene camera has not been moved since the poses in use were found. Otherwise you are "
         "asked at the end to lay the board flat at the subject: its centre becomes the middle of "
         "the scene, and its face up."));
  form->addWidget(keepFrame_);

  result_ = new QWidget;
  auto* column = new QVBoxLayout(result_);
  column->setContentsMargins(0, 0, 0, 0);
  text_ = new QLabel;
  text_->setObjectName("posesFigures");
  text_->setWordWrap(true);
  text_->setTextFormat(Qt::RichText);
  text_->setOpenExternalLinks(true);
  text_->setAlignment(Qt::AlignTop);
  auto* scroll = new QScrollArea;
  scroll->setWidgetResizable(true);
  scroll->setFrameShape(QFrame::NoFrame);
  scroll->setWidget(text_);
  column->addWidget(scroll, 1);
  use_ = new QPushButton(tr("&Use this lens and these poses"));
  use_->setObjectName("usePoses");
  use_->setToolTip(tr("From now on recordings take directions from them (Ctrl+Z goes back)"));
  column->addWidget(use_);
  result_->hide();
  arrange(both, form, result_);
  say(tr("Wave the board before both"),
      tr("Some places should be seen by both cameras at once: hold the board over the subject, "
         "between them. The lenses come out too."));
  connect(use_, &QPushButton::clicked, this, [this] {
    CalibrationFiles files = this->workspace().rig().setup();
    files.sourceModel = folder_ / "source-1.json";
    files.sceneModel = folder_ / "scene.json";
    files.rigGeometry = folder_ / "rig.json";
    useCalibration(this->workspace(), files);
    use_->setEnabled(false);
    use_->setText(tr("In use"));
  });
}

void PosesStep::begin() {
  RigLink& rig = workspace().rig();
  RigCalibrationJob job;
  job.sceneCamera = rig.sceneAddress();
  job.sourceCameras = {rig.sourceAddress()};
  job.views = views_->value();
  job.board = board_.board();
  if (keepFrame_->isChecked()) job.sceneFrom = rig.rigGeometry();
  job.out = newFolder("poses");
  const QString aside = rig.setup().simulated
                            ? tr(" (the simulated hand does so at the end of its round)")
                            : QString();
  guides_ = {};
  if (!run(tr("Calibration of the poses"), RigProgram::kBoard,
           [job, aside = aside.toStdString()](const Cameras& cameras, Progress& progress,
                                              std::stop_token stop) -> Result<JobResult> {
             RigCalibrationJob live = job;
             live.open = cameras.open;
             live.ask = [&](const std::string& wish) {
               return cameras.feed.ask(wish + aside, stop);
             };
             std::error_code error;
             std::filesystem::create_directories(job.out.parent_path(), error);
             return rigCalibrationJob(live, progress, stop, [&](const LiveViewState& state) {
               cameras.feed.publish(state);
             });
           })) {
    return;
  }
  folder_ = job.out;
  result_->hide();
}

void PosesStep::told(const LiveViewState& state) {
  // The best that either camera says: one of them need not see the board.
  constexpr std::array kFirst{ViewVerdict::kKeep, ViewVerdict::kMoving, ViewVerdict::kNotNew,
                              ViewVerdict::kNoBoard};
  const ViewVerdict verdict = *std::ranges::find_if(kFirst, [&](ViewVerdict v) {
    return v == ViewVerdict::kNoBoard || std::ranges::count(state.verdicts, v) > 0;
  });
  QStringList lines;
  for (const std::size_t i : {0u, 1u}) {
    guides_[i].follow(state, i);
    const auto& next = guides_[i].next;
    lines << tr("%1: %2 of %3 views; %4")
                 .arg(i == 0 ? tr("Scene camera") : tr("Source camera"))
                 .arg(state.counts[i])
                 .arg(state.wanted)
                 .arg(next ? tr("board wanted %1").arg(FieldCoverage::describe(*next))
                           : tr("its picture is covered"));
  }
  say(inWords(verdict, *std::ranges::min_element(state.counts), state.wanted), lines.join('\n'));
}

void PosesStep::finished(const Result<JobResult>& result) {
  for (FrameView* picture : pictures_) picture->update();
  if (!result) return;
  say(tr("The poses are known"));
  const Json& pose = result->figures["pose"];
  QString text = tr("<b>Poses</b> from %1 moments seen by both, residual %2 px")
                     .arg(pose["used"].get<int>())
                     .arg(pose["residualPixels"].get<double>(), 0, 'f', 2);
  for (const Json& warning : pose["warnings"]) {
    text += "<br>" + QString::fromStdString(warning.get<std::string>()).toHtmlEscaped();
  }
  for (const auto& [name, title] :
       {std::pair{"source-1", tr("Source camera")}, std::pair{"scene", tr("Scene camera")}}) {
    text += QString("<p><b>%1</b><br>%2<br>%3<br>%4</p>")
                .arg(title, describeLens(result->figures[name]),
                     linkTo(folder_ / (std::string(name) + ".html"), tr("Open the report")),
                     adviceOn(result->figures[name]));
  }
  text_->setText(text);
  use_->setEnabled(true);
  use_->setText(tr("&Use this lens and these poses"));
  result_->show();
}

}  // namespace lightsketch
