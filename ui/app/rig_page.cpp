#include "ui/app/rig_page.h"

#include <QComboBox>
#include <QFileDialog>
#include <QFileInfo>
#include <QFrame>
#include <QHBoxLayout>
#include <QLabel>
#include <QLineEdit>
#include <QPushButton>
#include <QToolButton>
#include <QVBoxLayout>
#include <algorithm>
#include <cmath>

#include "capture/frame/median.h"
#include "ui/app/camera_panel.h"
#include "ui/app/controls.h"

namespace lightsketch {
namespace {

constexpr int kRefreshMilliseconds = 300;
enum Mode { kSimulated, kCameras };

// An item's address, or what was typed.
std::string addressIn(const QComboBox& box) {
  const int at = box.findText(box.currentText());
  return (at < 0 ? box.currentText().trimmed() : box.itemData(at).toString()).toStdString();
}

// Milliseconds between each exposure and the nearest of the other camera, the median.
std::optional<double> pairingError(const std::deque<TimePoint>& scene,
                                   const std::deque<TimePoint>& source) {
  std::vector<double> errors;
  for (const TimePoint at : scene) {
    double nearest = INFINITY;
    for (const TimePoint other : source) {
      nearest = std::min(nearest, std::abs(1e3 * toSeconds(at - other)));
    }
    if (std::isfinite(nearest)) errors.push_back(nearest);
  }
  if (errors.empty()) return std::nullopt;
  return median(errors);
}

}  // namespace

RigPage::RigPage(Workspace& workspace, QWidget* parent) : Page(workspace, parent) {
  auto* column = new QVBoxLayout(this);
  column->setContentsMargins(12, 8, 12, 8);
  column->setSpacing(6);
  column->addLayout(buildCameras());

  auto* panels = new QHBoxLayout;
  panels->setSpacing(14);
  scenePanel_ = new CameraPanel(workspace.rig(), true);
  sourcePanel_ = new CameraPanel(workspace.rig(), false);
  panels->addWidget(scenePanel_, 1);
  panels->addWidget(sourcePanel_, 1);
  column->addLayout(panels, 1);

  pairing_ = new QLabel;
  pairing_->setObjectName("pairing");
  pairing_->setToolTip(
      tr("How far apart in time a frame of the scene camera and the nearest frame of the source "
         "camera are. The lamp moves in between, so directions are interpolated; cameras that are "
         "triggered together read 0."));
  column->addWidget(pairing_);
  auto* line = new QFrame;
  line->setFrameShape(QFrame::HLine);
  column->addWidget(line);
  column->addLayout(buildFiles());

  refresh_.setInterval(kRefreshMilliseconds);
  connect(&refresh_, &QTimer::timeout, this, &RigPage::showLink);
  RigLink& rig = workspace.rig();
  connect(&rig, &RigLink::found, this, &RigPage::fillCameras);
  connect(&rig, &RigLink::stateChanged, this, &RigPage::showState);
  connect(&rig, &RigLink::setupChanged, this, [this] {
    fillCameras();
    showFiles();
  });
  fillCameras();
  showFiles();
  showState();
}

QString RigPage::purpose() const {
  return tr("Choose the cameras and set them up: exposure, focus, region");
}

QLayout* RigPage::buildCameras() {
  auto* row = new QHBoxLayout;
  row->setSpacing(8);
  const auto add = [&](const QString& text, QWidget* widget, int stretch) {
    row->addWidget(labelFor(widget, text));
    row->addWidget(widget, stretch);
  };
  mode_ = new QComboBox;
  mode_->setObjectName("mode");
  mode_->addItems({tr("Simulated rig"), tr("Cameras")});
  mode_->setToolTip(
      tr("The simulated rig is a still life, two cameras and somebody with a lamp, inside this "
         "program: everything can be tried with it"));
  add(tr("&Use"), mode_, 0);
  const auto chooser = [&](const QString& name, const QString& tip) {
    auto* box = new QComboBox;
    box->setObjectName(name);
    box->setEditable(true);
    box->setInsertPolicy(QComboBox::NoInsert);
    box->setMinimumContentsLength(18);
    box->setToolTip(tip);
    connect(box, &QComboBox::activated, this, &RigPage::useChosenCameras);
    connect(box->lineEdit(), &QLineEdit::editingFinished, this, &RigPage::useChosenCameras);
    return box;
  };
  scene_ = chooser("sceneCamera",
                   tr("The camera that looks at the subject: one that was found, or "
                      "an address such as aravis:192.168.1.20, v4l2:/dev/video0 or replay:FOLDER"));
  add(tr("S&cene"), scene_, 1);
  source_ = chooser("sourceCamera", tr("The camera with the fisheye that watches the lamp"));
  add(tr("S&ource"), source_, 1);
  search_ = new QPushButton(tr("Sea&rch"));
  search_->setObjectName("search");
  search_->setToolTip(tr("Look for cameras on the network and on USB"));
  row->addWidget(search_);
  state_ = new QLabel;
  state_->setObjectName("state");
  state_->setMinimumWidth(130);
  row->addWidget(state_);

  connect(mode_, &QComboBox::activated, this, &RigPage::useChosenCameras);
  connect(search_, &QPushButton::clicked, this, [this] {
    search_->setEnabled(false);
    search_->setText(tr("Searching ..."));
    workspace().rig().search();
  });
  return row;
}

QLayout* RigPage::buildFiles() {
  auto* row = new QHBoxLayout;
  row->setSpacing(6);
  const auto add = [&](const QString& name, const QString& text, const QString& tip,
                       std::filesystem::path CalibrationFiles::*which) {
    row->addWidget(new QLabel(QString("<b>%1</b>").arg(text)));
    auto* label = new QLabel;
    label->setObjectName(name);
    label->setToolTip(tip);
    label->setMinimumWidth(60);  // long names are cut, the window stays narrow
    row->addWidget(label);
    auto* choose = new QPushButton(tr("Choose ..."));
    choose->setObjectName(name + "Choose");
    choose->setAccessibleName(tr("Choose: %1").arg(text));
    choose->setToolTip(tip);
    connect(choose, &QPushButton::clicked, this, [this, text, which] { chooseFile(text, which); });
    row->addWidget(choose);
    auto* none = new QToolButton;
    none->setObjectName(name + "None");
    none->setText("\u00d7");
    none->setAutoRaise(true);
    none->setAccessibleName(tr("None: %1").arg(text));
    none->setToolTip(tr("Use no file (Ctrl+Z brings it back)"));
    connect(none, &QToolButton::clicked, this, [this, which] { use(which, {}); });
    row->addWidget(none);
    row->addSpacing(10);
    files_.push_back({label, which});
  };
  add("lensFile", tr("Lens"),
      tr("Of the source camera: which pixel looks in which direction. Without it no light has a "
         "direction."),
      &CalibrationFiles::sourceModel);
  add("posesFile", tr("Poses"),
      tr("Where the cameras stand, rig.json. Without it the source camera is taken to stand "
         "upright "
         "at the subject."),
      &CalibrationFiles::rigGeometry);
  add("responseFile", tr("Response"),
      tr("What the scene camera's counts mean. Without it the sensor is taken to be linear."),
      &CalibrationFiles::sceneResponse);
  add("sceneLensFile", tr("Scene lens"),
      tr("Of the scene camera: for sketches of flat subjects under near lamps, whose fall-off the "
         "Develop page takes out."),
      &CalibrationFiles::sceneModel);
  row->addStretch(1);
  calibrate_ = new QPushButton(tr("Calibrate"));
  calibrate_->setObjectName("calibrate");
  calibrate_->setToolTip(tr("Measure them with a printed board"));
  connect(calibrate_, &QPushButton::clicked, this, [this] { workspace().show("calibrate"); });
  row->addWidget(calibrate_);
  return row;
}

void RigPage::entered() {
  workspace().rig().watch(true);
  if (!searched_) workspace().rig().search();
  searched_ = true;
  refresh_.start();
}

void RigPage::left() {
  refresh_.stop();
  workspace().rig().watch(false);
}

void RigPage::fillCameras() {
  search_->setEnabled(true);
  search_->setText(tr("Sea&rch"));
  RigLink& rig = workspace().rig();
  const RigSetup& setup = rig.setup();
  mode_->setCurrentIndex(setup.simulated ? kSimulated : kCameras);
  for (const auto& [box, used, other] :
       {std::tuple{scene_, setup.sceneCamera, setup.rig.sceneAddress},
        std::tuple{source_, setup.sourceCamera, setup.rig.sourceAddress}}) {
    const QSignalBlocker blocker(box);
    box->clear();
    for (const CameraInfo& camera : rig.cameras()) {
      const QString address = QString::fromStdString(camera.address);
      box->addItem(QString("%1  %2 %3")
                       .arg(address, QString::fromStdString(camera.vendor),
                            QString::fromStdString(camera.model)),
                   address);
    }
    const int at = box->findData(QString::fromStdString(used));
    if (at >= 0) {
      box->setCurrentIndex(at);
    } else {
      box->setCurrentIndex(-1);
      box->setEditText(QString::fromStdString(used));
    }
    box->lineEdit()->setPlaceholderText(
        setup.simulated ? tr("simulated, at %1").arg(QString::fromStdString(other))
                        : tr("choose, or type an address"));
    if (setup.simulated) box->setEditText({});
    box->setEnabled(!setup.simulated);
  }
}

void RigPage::useChosenCameras() {
  RigLink& rig = workspace().rig();
  RigSetup setup = rig.setup();
  const bool simulated = mode_->currentIndex() == kSimulated;
  if (simulated == setup.simulated && simulated) return;
  if (!simulated && !setup.simulated) {
    setup.sceneCamera = addressIn(*scene_);
    setup.sourceCamera = addressIn(*source_);
    if (setup.sceneCamera == rig.setup().sceneCamera &&
        setup.sourceCamera == rig.setup().sourceCamera) {
      return;
    }
  }
  // Before a camera was ever chosen, those found are as good a guess as any.
  if (!simulated && setup.sceneCamera.empty() && rig.cameras().size() > 1) {
    setup.sceneCamera = rig.cameras()[0].address;
    setup.sourceCamera = rig.cameras()[1].address;
  }
  setup.simulated = simulated;
  rig.setSetup(setup);
}

void RigPage::showState() {
  switch (workspace().rig().state()) {
    case RigLink::State::kClosed:
      return state_->setText(tr("cameras closed"));
    case RigLink::State::kOpening:
      return state_->setText(tr("opening ..."));
    case RigLink::State::kLive:
      return state_->setText(tr("live"));
    case RigLink::State::kLent:
      return state_->setText(tr("in use"));
    case RigLink::State::kFailed:
      return state_->setText(tr("no pictures"));
  }
}

void RigPage::showFiles() {
  const RigSetup& setup = workspace().rig().setup();
  for (const File& file : files_) {
    const std::filesystem::path& path = setup.*file.which;
    const bool own = setup.simulated && (file.which == &CalibrationFiles::sourceModel ||
                                         file.which == &CalibrationFiles::rigGeometry);
    file.label->setText(!path.empty() ? toQString(path.filename())
                        : own         ? tr("the simulated rig's own")
                                      : tr("none"));
    findChild<QToolButton*>(file.label->objectName() + "None")->setVisible(!path.empty());
  }
  const bool missing = setup.sourceModel.empty() && !setup.simulated;
  calibrate_->setDefault(missing);
  calibrate_->setText(missing ? tr("Calibrate the lens first") : tr("Calibrate"));
}

void RigPage::showLink() {
  scenePanel_->refresh();
  sourcePanel_->refresh();
  const auto error = pairingError(scenePanel_->exposures(), sourcePanel_->exposures());
  pairing_->setText(error ? tr("Frames of the two cameras are %1 ms apart").arg(*error, 0, 'f', 1)
                          : tr("Frames of the two cameras cannot be paired: there are none"));
}

void RigPage::chooseFile(const QString& title, std::filesystem::path CalibrationFiles::*which) {
  const QString folder = workspace().settings().value("calibration/chosenFrom").toString();
  const QString file =
      QFileDialog::getOpenFileName(this, title, folder, tr("Calibration files (*.json)"));
  if (file.isEmpty()) return;
  workspace().settings().setValue("calibration/chosenFrom", QFileInfo(file).path());
  use(which, toPath(file));
}

void RigPage::use(std::filesystem::path CalibrationFiles::*which,
                  const std::filesystem::path& file) {
  CalibrationFiles files = workspace().rig().setup();
  files.*which = file;
  useCalibration(workspace(), files);
}

}  // namespace lightsketch
