#include "ui/app/response_step.h"

#include <QCheckBox>
#include <QComboBox>
#include <QDoubleSpinBox>
#include <QGridLayout>
#include <QHBoxLayout>
#include <QLabel>
#include <QPushButton>
#include <QSpinBox>
#include <QStackedWidget>
#include <QVBoxLayout>

#include "calibration/model/sensor_model.h"
#include "pipeline/job/calibrate_jobs.h"
#include "ui/app/controls.h"
#include "ui/app/frame_view.h"
#include "ui/app/response_plot.h"
#include "ui/app/use_calibration.h"

namespace lightsketch {
namespace {

enum Choice { kScene, kSource };

QString describeSensor(const SensorModel& sensor) {
  const ResponseCurve& curve = sensor.response;
  QStringList lines;
  lines << (curve.isLinear() ? ResponseStep::tr("The sensor is <b>linear</b>")
                             : ResponseStep::tr("The sensor is <b>not linear</b>: see its curve"));
  lines << ResponseStep::tr("saturates at count %1 of %2")
               .arg(curve.saturationCount(), 0, 'f', 0)
               .arg(curve.maxCount(), 0, 'f', 0);
  QStringList blacks, wells, noises;
  for (int c = 0; c < curve.colours(); ++c) {
    blacks << QString::number(curve.blackCount(c), 'f', 1);
    wells << QString::number(sensor.noise.channel(c).electronsAtSaturation, 'f', 0);
    noises << QString::number(sensor.noise.channel(c).readNoiseElectrons, 'f', 1);
  }
  lines << ResponseStep::tr("black at count %1").arg(blacks.join(", "));
  lines << ResponseStep::tr("noise: %1 electrons at saturation, %2 without light")
               .arg(wells.join(", "), noises.join(", "));
  lines << ResponseStep::tr("%1 hot pixels").arg(sensor.hotPixels.size());
  lines << (sensor.flatField ? ResponseStep::tr("flat field measured")
                             : ResponseStep::tr("no flat field"));
  return lines.join("<br>");
}

}  // namespace

ResponseStep::ResponseStep(Workspace& workspace, QWidget* parent)
    : CalibrationStep(workspace, "calibrateResponse", tr("&Start"), parent) {
  pictures_ = new QStackedWidget;
  for (LiveView* view : {&workspace.rig().sceneView(), &workspace.rig().sourceView()}) {
    auto* picture = new FrameView(*view);
    picture->setAccessibleName(tr("Live picture of the camera"));
    picture->setPlaceholder(tr("no picture yet"));
    pictures_->addWidget(picture);
  }

  auto* form = new QGridLayout;
  form->setHorizontalSpacing(6);
  const auto add = [&](int row, int column, const QString& text, QWidget* widget,
                       const QString& name, const QString& tip) {
    widget->setObjectName(name);
    widget->setToolTip(tip);
    form->addWidget(labelFor(widget, text), row, column);
    form->addWidget(widget, row, column + 1);
  };
  camera_ = new QComboBox;
  camera_->addItems({tr("Scene camera"), tr("Source camera")});
  add(0, 0, tr("&Camera"), camera_, "responseCamera",
      tr("The scene camera's is used in recordings"));
  connect(camera_, &QComboBox::currentIndexChanged, pictures_, &QStackedWidget::setCurrentIndex);
  frames_ = new QSpinBox;
  frames_->setRange(2, 100);
  frames_->setValue(4);
  add(0, 2, tr("&frames each"), frames_, "responseFrames",
      tr("Frames of each exposure; from their differences the noise is known"));
  const auto milliseconds = [](double value) {
    auto* box = new QDoubleSpinBox;
    box->setRange(0.001, 100'000);
    box->setDecimals(3);
    box->setSuffix(tr(" ms"));
    box->setValue(value);
    box->setStepType(QAbstractSpinBox::AdaptiveDecimalStepType);
    return box;
  };
  const ResponseJob usual;
  shortest_ = milliseconds(1e3 * usual.shortestSeconds);
  add(1, 0, tr("from"), shortest_, "shortest", tr("The shortest exposure: nothing is saturated"));
  longest_ = milliseconds(1e3 * usual.longestSeconds);
  add(1, 2, tr("to"), longest_, "longest", tr("The longest exposure: much is saturated"));
  dark_ = new QCheckBox(tr("also with the lens co&vered"));
  dark_->setObjectName("takeDark");
  dark_->setChecked(true);
  dark_->setToolTip(tr("Finds black level and hot pixels; you are asked to cover the lens"));
  diffuser_ = new QCheckBox(tr("also of an even &diffuser"));
  diffuser_->setObjectName("takeDiffuser");
  diffuser_->setToolTip(
      tr("Finds how much darker the corners are; you are asked to hold white "
         "paper or opal glass before the lens"));
  form->addWidget(dark_, 2, 0, 1, 2);
  form->addWidget(diffuser_, 2, 2, 1, 2);
  form->setColumnStretch(4, 1);

  result_ = new QWidget;
  auto* across = new QHBoxLayout(result_);
  across->setContentsMargins(0, 0, 0, 0);
  across->setSpacing(12);
  plot_ = new ResponsePlot;
  plot_->setObjectName("responsePlot");
  across->addWidget(plot_, 1, Qt::AlignTop);
  auto* column = new QVBoxLayout;
  figures_ = new QLabel;
  figures_->setObjectName("responseFigures");
  figures_->setWordWrap(true);
  figures_->setTextFormat(Qt::RichText);
  figures_->setOpenExternalLinks(true);
  column->addWidget(figures_);
  use_ = new QPushButton(tr("&Use this response"));
  use_->setObjectName("useResponse");
  use_->setToolTip(tr("From now on recordings are linearised by it (Ctrl+Z goes back)"));
  column->addWidget(use_);
  column->addStretch();
  across->addLayout(column, 1);
  result_->hide();
  arrange(pictures_, form, result_);
  say(tr("Nothing may move"),
      tr("Point the camera at a still scene with bright and dark parts, under a steady light, and "
         "keep away while its exposure goes from the shortest to the longest."));
  connect(use_, &QPushButton::clicked, this, [this] {
    CalibrationFiles files = this->workspace().rig().setup();
    files.sceneResponse = folder_ / "response.json";
    useCalibration(this->workspace(), files);
    use_->setEnabled(false);
    use_->setText(tr("In use"));
  });
}

bool ResponseStep::ofScene() const { return camera_->currentIndex() == kScene; }

void ResponseStep::begin() {
  RigLink& rig = workspace().rig();
  ResponseJob job;
  job.camera = ofScene() ? rig.sceneAddress() : rig.sourceAddress();
  job.shortestSeconds = 1e-3 * shortest_->value();
  job.longestSeconds = 1e-3 * longest_->value();
  job.framesPerExposure = frames_->value();
  job.takeDark = dark_->isChecked();
  job.takeDiffuser = diffuser_->isChecked();
  const std::filesystem::path folder = newFolder("response");
  job.out = folder / "response.json";
  job.report = folder / "report";
  if (!run(tr("Response calibration"), std::nullopt,
           [job](const Cameras& cameras, Progress& progress,
                 std::stop_token stop) -> Result<JobResult> {
             ResponseJob live = job;
             live.open = cameras.open;
             live.ask = [&](const std::string& wish) { return cameras.feed.ask(wish, stop); };
             std::error_code error;
             std::filesystem::create_directories(job.out.parent_path(), error);
             return responseJob(live, progress, stop);
           })) {
    return;
  }
  folder_ = folder;
  camera_->setEnabled(false);
  result_->hide();
  say(tr("Taking the bracket"), tr("Keep away, nothing may move."));
}

void ResponseStep::finished(const Result<JobResult>& result) {
  camera_->setEnabled(true);
  if (!result) return;
  const auto sensor = sensorModelFromJson(result->figures["sensor"], "response");
  if (!sensor) return say(tr("It did not work"), QString::fromStdString(sensor.error().message));
  say(tr("The response is known"));
  plot_->setCurve(sensor->response);
  figures_->setText(describeSensor(*sensor) + "<br>" +
                    linkTo(folder_ / "report/index.html", tr("Open the report")));
  use_->setVisible(ofScene());
  use_->setEnabled(true);
  use_->setText(tr("&Use this response"));
  result_->show();
}

}  // namespace lightsketch
