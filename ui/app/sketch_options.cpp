#include "ui/app/sketch_options.h"

#include <QCheckBox>
#include <QComboBox>
#include <QDateTime>
#include <QDir>
#include <QDoubleSpinBox>
#include <QFileDialog>
#include <QFileInfo>
#include <QFormLayout>
#include <QLabel>
#include <QLineEdit>
#include <QPushButton>
#include <QSpinBox>
#include <QVBoxLayout>

#include "pipeline/job/jobs.h"
#include "ui/app/controls.h"
#include "ui/app/workspace.h"

namespace lightsketch {
namespace {

constexpr auto kFolder = "sketch/folder";  // in which new sketches are made

// Shorter exposures only: the one of the Rig page is the longest that the frame rate leaves room
// for, or nearly.
const std::vector<std::vector<double>>& brackets() {
  static const std::vector<std::vector<double>> kBrackets{{}, {1, 1.0 / 8}, {1, 1.0 / 8, 1.0 / 64}};
  return kBrackets;
}

QString tidy(const QString& path) {
  const QString home = QDir::homePath() + '/';
  return path.startsWith(home) ? "~/" + path.mid(home.size()) : path;
}
QString whole(const QString& path) {
  return path.startsWith("~/") ? QDir::homePath() + path.mid(1) : path;
}

}  // namespace

SketchOptions::SketchOptions(Workspace& workspace, QWidget* parent)
    : QWidget(parent), workspace_(workspace) {
  QSettings& settings = workspace.settings();
  auto* form = new QFormLayout(this);
  form->setContentsMargins(0, 0, 0, 0);
  form->setVerticalSpacing(5);
  form->setFieldGrowthPolicy(QFormLayout::ExpandingFieldsGrow);

  folder_ = new QComboBox;
  folder_->setObjectName("folder");
  folder_->setEditable(true);
  folder_->setInsertPolicy(QComboBox::NoInsert);
  folder_->setSizeAdjustPolicy(QComboBox::AdjustToMinimumContentsLengthWithIcon);
  folder_->setMinimumContentsLength(8);
  folder_->setAccessibleName(tr("Folder of the sketch"));
  folder_->setToolTip(
      tr("The folder that the sketch goes to. Choose one that holds a sketch to go on with it."));
  auto* choose = new QPushButton(tr("..."));
  choose->setObjectName("chooseFolder");
  choose->setAccessibleName(tr("Choose a folder"));
  choose->setToolTip(tr("Choose a folder: an empty one, or a sketch to go on with"));
  choose->setMaximumWidth(34);
  auto* where = new QHBoxLayout;
  where->addWidget(folder_, 1);
  where->addWidget(choose);
  form->addRow(labelFor(folder_, tr("&Folder")), where);
  note_ = new QLabel;
  note_->setObjectName("folderNote");
  note_->setWordWrap(true);
  form->addRow(note_);

  directions_ = new QSpinBox;
  directions_->setObjectName("directions");
  directions_->setRange(64, 10000);  // LightGrid's
  directions_->setSingleStep(50);
  directions_->setValue(settings.value("sketch/directions", 300).toInt());
  directions_->setToolTip(
      tr("How many light directions are wanted, spread evenly. More of them show sharper "
         "highlights and shadows and take longer: about one second each."));
  form->addRow(tr("&Directions"), directions_);
  domain_ = new QComboBox;
  domain_->setObjectName("domain");
  domain_->addItems({tr("from the front"), tr("all around")});
  domain_->setCurrentIndex(settings.value("sketch/wholeSphere", false).toBool() ? 1 : 0);
  domain_->setToolTip(
      tr("From the front: the hemisphere on the camera's side. All around: light from behind too, "
         "for things that are translucent or stand free."));
  form->addRow(tr("&Light"), domain_);
  goal_ = new QSpinBox;
  goal_->setObjectName("coverageGoal");
  goal_->setRange(5, 100);
  goal_->setSuffix(tr(" %"));
  goal_->setValue(settings.value("sketch/goal", 95).toInt());
  goal_->setToolTip(
      tr("The recording ends by itself when so many of the directions are there. The last few "
         "often cannot be reached: a tripod is in the way, or the table."));
  form->addRow(tr("&End at"), goal_);
  timeLimit_ = new QDoubleSpinBox;
  timeLimit_->setObjectName("timeLimit");
  timeLimit_->setRange(0, 240);
  timeLimit_->setDecimals(1);
  timeLimit_->setSpecialValueText(tr("no limit"));
  timeLimit_->setSuffix(tr(" min"));
  timeLimit_->setValue(settings.value("sketch/minutes", 0).toDouble());
  timeLimit_->setToolTip(tr("The recording ends after this time, whatever is missing then."));
  form->addRow(tr("&Time"), timeLimit_);
  bracket_ = new QComboBox;
  bracket_->setObjectName("bracket");
  bracket_->addItems({tr("one"), tr("two: 1, 1/8"), tr("three: 1, 1/8, 1/64")});
  bracket_->setCurrentIndex(settings.value("sketch/bracket", 0).toInt());
  bracket_->setToolTip(
      tr("Several exposures for each direction, merged: for bright highlights beside deep "
         "shadows. The lamp has to be held still at each direction until it sounds."));
  form->addRow(tr("E&xposures"), bracket_);
  keepRaw_ = new QCheckBox(tr("&keep the sensor's own pictures"));
  keepRaw_->setObjectName("keepRaw");
  keepRaw_->setChecked(settings.value("sketch/keepRaw", false).toBool());
  keepRaw_->setToolTip(
      tr("Beside each frame also the counts of the sensor, as PNG: twice the disk space, for those "
         "who want to develop everything anew one day. Only with one exposure."));
  form->addRow(keepRaw_);

  connect(choose, &QPushButton::clicked, this, &SketchOptions::chooseFolder);
  connect(folder_, &QComboBox::activated, this, &SketchOptions::wishChanged);
  connect(folder_->lineEdit(), &QLineEdit::editingFinished, this, &SketchOptions::wishChanged);
  connect(directions_, &QSpinBox::valueChanged, this, &SketchOptions::wishChanged);
  connect(domain_, &QComboBox::currentIndexChanged, this, &SketchOptions::wishChanged);
  connect(goal_, &QSpinBox::valueChanged, this, &SketchOptions::goalChanged);
  const auto exclude = [this] {
    keepRaw_->setEnabled(bracket_->currentIndex() == 0);
    if (bracket_->currentIndex() > 0) keepRaw_->setChecked(false);
  };
  connect(bracket_, &QComboBox::currentIndexChanged, this, exclude);
  exclude();
  setNewFolder();
}

std::filesystem::path SketchOptions::folder() const {
  return toPath(whole(folder_->currentText().trimmed()));
}

void SketchOptions::setFolder(const std::filesystem::path& folder) {
  folder_->clear();
  for (const QString& path : workspace_.recent()) {
    if (QFileInfo::exists(path + "/sketch.json")) folder_->addItem(tidy(path));
  }
  folder_->setCurrentText(tidy(toQString(folder)));
  Q_EMIT wishChanged();
}

void SketchOptions::setNewFolder() {
  const QString parent =
      workspace_.settings().value(kFolder, QDir::homePath() + "/lightsketch").toString();
  const QString name = parent + '/' + QDateTime::currentDateTime().toString(tr("yyyy-MM-dd HH.mm"));
  QString free = name;
  for (int i = 2; QFileInfo::exists(free); ++i) free = QString("%1 (%2)").arg(name).arg(i);
  setFolder(toPath(free));
}

void SketchOptions::chooseFolder() {
  const QString start = QFileInfo(toQString(folder())).path();
  const QString path = QFileDialog::getExistingDirectory(
      this, tr("An empty folder, or a sketch to go on with"), start);
  if (path.isEmpty()) return;
  // One that holds other things gets a folder of its own for the sketch.
  const bool usable = QFileInfo::exists(path + "/sketch.json") || QDir(path).isEmpty();
  workspace_.settings().setValue(kFolder, usable ? QFileInfo(path).path() : path);
  usable ? setFolder(toPath(path)) : setNewFolder();
}

SketchWish SketchOptions::wish() const {
  SketchWish wish;
  wish.folder = folder();
  wish.directions = directions_->value();
  wish.wholeSphere = domain_->currentIndex() == 1;
  return wish;
}

double SketchOptions::coverageGoal() const { return goal_->value() / 100.0; }

void SketchOptions::fill(RecordJob& job) const {
  job.sketch = folder();
  RecorderOptions& options = job.recorder;
  options.directions = directions_->value();
  options.fullSphere = domain_->currentIndex() == 1;
  options.coverageGoal = coverageGoal();
  options.timeLimitSeconds.reset();
  if (timeLimit_->value() > 0) options.timeLimitSeconds = 60 * timeLimit_->value();
  options.bracket = brackets()[static_cast<std::size_t>(bracket_->currentIndex())];
  options.keepRaw = keepRaw_->isChecked();

  QSettings& settings = workspace_.settings();
  settings.setValue("sketch/directions", options.directions);
  settings.setValue("sketch/wholeSphere", options.fullSphere);
  settings.setValue("sketch/goal", goal_->value());
  settings.setValue("sketch/minutes", timeLimit_->value());
  settings.setValue("sketch/bracket", bracket_->currentIndex());
  settings.setValue("sketch/keepRaw", options.keepRaw);
}

void SketchOptions::showPlan(const SketchPlan& plan) {
  const QSignalBlocker quietDirections(directions_);
  const QSignalBlocker quietDomain(domain_);
  directions_->setValue(plan.directions);
  domain_->setCurrentIndex(plan.wholeSphere ? 1 : 0);
  directions_->setEnabled(!plan.exists);
  domain_->setEnabled(!plan.exists);
  note_->setText(plan.exists ? tr("Holds a sketch with %1 of %2 directions; it is gone on with.")
                                   .arg(plan.capturedCount)
                                   .arg(plan.grid->size())
                             : QString());
  note_->setVisible(plan.exists);
}

void SketchOptions::showTrouble(const QString& text) {
  note_->setText(text);
  note_->show();
}

}  // namespace lightsketch
