#include "ui/app/develop_choices.h"

#include <QButtonGroup>
#include <QCheckBox>
#include <QComboBox>
#include <QDoubleSpinBox>
#include <QFileDialog>
#include <QFormLayout>
#include <QHBoxLayout>
#include <QLineEdit>
#include <QPushButton>
#include <QRadioButton>
#include <QSpinBox>
#include <QToolButton>
#include <QVBoxLayout>
#include <cmath>

#include "ui/app/controls.h"

namespace lightsketch {
namespace {

// The chosen one of the large buttons is plain from two metres.
constexpr auto kLargeChoice =
    "QPushButton { text-align: left; padding: 6px 10px; border: 2px solid palette(mid);"
    " border-radius: 6px; background: palette(button); }"
    "QPushButton:hover { background: palette(midlight); }"
    "QPushButton:focus { border-style: dashed; }"
    "QPushButton:checked { border-color: palette(highlight); background: palette(base); }";

}  // namespace

DevelopChoices::DevelopChoices(Workspace& workspace, QWidget* parent)
    : QWidget(parent), workspace_(workspace) {
  auto* column = new QVBoxLayout(this);
  column->setContentsMargins(0, 0, 0, 0);
  column->setSpacing(6);
  choices_ = new QButtonGroup(this);
  const auto large = [&](Choice choice, const char* name, const QString& title,
                         const QString& words, const QString& tip) {
    auto* button = new QPushButton(title + "\n" + words);
    button->setObjectName(name);
    button->setCheckable(true);
    button->setMinimumHeight(52);
    button->setStyleSheet(kLargeChoice);
    button->setToolTip(tip);
    choices_->addButton(button, choice);
    column->addWidget(button);
  };
  const QString how =
      tr("Ranks and roundings are chosen so that every bit buys as much as any other; the error is "
         "measured afterwards (lightsketch compress --quality %1)");
  large(kSmall, "qualitySmall", tr("&Small"), tr("to show and to send"), how.arg("small"));
  large(kStandard, "qualityStandard", tr("S&tandard"), tr("for most work; nearly twice the bytes"),
        how.arg("standard"));
  large(kArchive, "qualityArchive", tr("&Archive"),
        tr("to keep and to measure from; 2.5 times the bytes"), how.arg("archive"));

  auto* targets = new QGridLayout;
  targets->setColumnStretch(1, 1);
  const auto target = [&](Choice choice, const char* name, const QString& text,
                          QDoubleSpinBox*& spin, const QString& unit, double low, double high,
                          double value, const QString& tip) {
    auto* radio = new QRadioButton(text);
    radio->setObjectName(name);
    radio->setToolTip(tip);
    spin = new QDoubleSpinBox;
    spin->setObjectName(QString(name) + "Value");
    spin->setAccessibleName(text);
    spin->setToolTip(tip);
    spin->setDecimals(1);
    spin->setRange(low, high);
    spin->setValue(value);
    spin->setSuffix(unit);
    choices_->addButton(radio, choice);
    connect(spin, &QDoubleSpinBox::valueChanged, this, [radio, this] {
      radio->setChecked(true);
      chosen();
    });
    const int row = targets->rowCount();
    targets->addWidget(radio, row, 0);
    targets->addWidget(spin, row, 1);
  };
  target(kSize, "bySize", tr("Largest si&ze"), megabytes_, tr(" MB"), 0.1, 100000, 10,
         tr("As good as can be in a file no larger than this"));
  target(kPsnr, "byPsnr", tr("Smallest PSN&R"), decibels_, tr(" dB"), 10, 90, 40,
         tr("As small as can be with at least this PSNR; 40 dB is off by 2.6 of 255 grey levels"));
  column->addLayout(targets);

  holdOut_ = new QCheckBox(tr("Keep some frames bac&k to measure with"));
  holdOut_->setObjectName("holdOut");
  holdOut_->setChecked(true);
  holdOut_->setToolTip(
      tr("Frames that the model does not see; Validate compares it with them. Without, it gets all "
         "frames, and nobody can say how good it is between them."));
  column->addWidget(holdOut_);

  auto* more = new QToolButton;
  more->setObjectName("advanced");
  more->setText(tr("Advanced"));
  more->setToolTip(tr("Block size, single lamp, near lamps, the paper's setting"));
  more->setCheckable(true);
  more->setAutoRaise(true);
  more->setArrowType(Qt::RightArrow);
  more->setToolButtonStyle(Qt::ToolButtonTextBesideIcon);
  column->addWidget(more);
  auto* advanced = new QWidget;
  auto* form = new QFormLayout(advanced);
  form->setContentsMargins(4, 0, 0, 0);
  form->setVerticalSpacing(4);
  blockSize_ = new QComboBox;
  for (const int size : {8, 16, 32, 64}) blockSize_->addItem(tr("%1 pixels").arg(size), size);
  blockSize_->setCurrentIndex(1);
  blockSize_->setObjectName("blockSize");
  blockSize_->setToolTip(
      tr("Side of the blocks that the picture is cut into; 16 is best for most"));
  form->addRow(tr("Block s&ize"), blockSize_);
  singleLamp_ = new QCheckBox(tr("For one &lamp at a time"));
  singleLamp_->setObjectName("singleLamp");
  singleLamp_->setToolTip(
      tr("Better pictures of one lamp in as many bytes; several lamps or an environment do not add "
         "up"));
  form->addRow(singleLamp_);
  near_ = new QCheckBox(tr("The lamp was near, the subject is flat"));
  near_->setObjectName("nearLight");
  near_->setToolTip(
      tr("Takes the fall-off of a near lamp out. Needs lamp positions in the sketch and the scene "
         "camera's calibration. Off: the lamp counts as far away"));
  form->addRow(near_);
  sceneModel_ = new QLineEdit;
  sceneModel_->setObjectName("sceneModel");
  sceneModel_->setPlaceholderText(tr("scene camera's calibration (.json)"));
  sceneModel_->setToolTip(tr("What the Calibrate page saved for the scene camera"));
  sceneModel_->setEnabled(false);
  auto* browse = sceneModel_->addAction(style()->standardIcon(QStyle::SP_DirOpenIcon),
                                        QLineEdit::TrailingPosition);
  connect(browse, &QAction::triggered, this, [this] {
    const QString file = QFileDialog::getOpenFileName(this, tr("Scene camera's calibration"), {},
                                                      tr("Camera models (*.json *.yml *.xml)"));
    if (!file.isEmpty()) sceneModel_->setText(file);
  });
  connect(near_, &QCheckBox::toggled, this, [this](bool on) {
    sceneModel_->setEnabled(on);
    if (sceneModel_->text().isEmpty()) {
      sceneModel_->setText(toQString(workspace_.rig().setup().sceneModel));
    }
  });
  form->addRow(sceneModel_);
  auto* paper = new QRadioButton(tr("The paper's setting:"));
  paper->setObjectName("paper");
  paper->setToolTip(tr("Ranks as in Nayar, Belhumeur, Boult 2004; 0 keeps all"));
  choices_->addButton(paper, kPaper);
  form->addRow(paper);
  auto* ranks = new QHBoxLayout;
  const auto rank = [&](const char* name, const QString& prefix, int value, const QString& tip) {
    auto* spin = new QSpinBox;
    spin->setObjectName(name);
    spin->setAccessibleName(tip);
    spin->setToolTip(tip);
    spin->setPrefix(prefix);
    spin->setRange(0, 4096);
    spin->setValue(value);
    ranks->addWidget(spin);
    connect(spin, &QSpinBox::valueChanged, paper, [paper, this] {
      paper->setChecked(true);
      chosen();
    });
    return spin;
  };
  blockRank_ = rank("blockRank", "b = ", 10, tr("Basis pictures per block"));
  rank_ = rank("rank", "q = ", 200, tr("Rank of the whole"));
  storage_ = new QComboBox;
  storage_->setObjectName("storage");
  storage_->setToolTip(tr("How numbers are kept: float, half float, 8 bits"));
  storage_->addItem("f16", static_cast<int>(Storage::kFloat16));
  storage_->addItem("f32", static_cast<int>(Storage::kFloat32));
  storage_->addItem("q8", static_cast<int>(Storage::kQ8));
  ranks->addWidget(storage_);
  form->addRow(ranks);
  advanced->hide();
  column->addWidget(advanced);
  connect(more, &QToolButton::toggled, this, [more, advanced](bool on) {
    advanced->setVisible(on);
    more->setArrowType(on ? Qt::DownArrow : Qt::RightArrow);
  });
  column->addStretch(1);

  auto* fileRow = new QHBoxLayout;
  file_ = new QLineEdit;
  file_->setObjectName("modelFile");
  file_->setToolTip(tr("The model's file; made whole or not at all"));
  fileRow->addWidget(labelFor(file_, tr("File &name")));
  fileRow->addWidget(file_, 1);
  column->addLayout(fileRow);
  connect(file_, &QLineEdit::textEdited, this, [this](const QString& text) { fileByHand_ = text; });

  choices_->button(kStandard)->setChecked(true);
  connect(choices_, &QButtonGroup::idClicked, this, &DevelopChoices::chosen);
  connect(holdOut_, &QCheckBox::toggled, this, &DevelopChoices::holdOutChanged);
  chosen();
}

void DevelopChoices::setSummary(const SketchSummary& summary, bool another) {
  summary_ = summary;
  holdOut_->setEnabled(!summary.holdOut.empty());
  holdOut_->setText(summary.heldOut.empty() ? tr("Keep some frames bac&k to measure with")
                                            : tr("Keep %1 of %2 frames bac&k to measure with")
                                                  .arg(summary.heldOut.size())
                                                  .arg(summary.active));
  if (another) fileByHand_.clear();
  chosen();
}

bool DevelopChoices::keepsBack(int frame) const {
  return holdOut_->isChecked() && summary_.heldOut.contains(frame);
}

QString DevelopChoices::suggestedFile() const {
  if (workspace_.sketch().empty()) return {};
  QString name;
  switch (choices_->checkedId()) {
    case kSmall:
    case kStandard:
    case kArchive:
      name = nameOf(static_cast<Quality>(choices_->checkedId()));
      break;
    case kSize:
      name = QString("%1MB").arg(megabytes_->value());
      break;
    case kPsnr:
      name = QString("%1dB").arg(decibels_->value());
      break;
    default:
      name = QString("b%1q%2").arg(blockRank_->value()).arg(rank_->value());
  }
  return toQString(workspace_.sketch()) + "-" + name + ".lsd";
}

// Something about what is to be made was chosen.
void DevelopChoices::chosen() {
  if (fileByHand_.isEmpty()) file_->setText(suggestedFile());
}

CompressJob DevelopChoices::job() const {
  CompressJob job;
  job.sketch = workspace_.sketch();
  job.out = toPath(file_->text());
  CompressOptions& options = job.options;
  options.blockSize = blockSize_->currentData().toInt();
  options.singleLamp = singleLamp_->isChecked();
  if (holdOut_->isChecked()) options.holdOutRule = summary_.holdOut;
  switch (choices_->checkedId()) {
    case kSize:
      options.budgetBytes = static_cast<std::uint64_t>(std::llround(megabytes_->value() * 1e6));
      break;
    case kPsnr:
      options.psnr = decibels_->value();
      break;
    case kPaper:
      options.blockRank = blockRank_->value();
      options.rank = rank_->value();
      options.storage = static_cast<Storage>(storage_->currentData().toInt());
      break;
    default:
      options.quality = static_cast<Quality>(choices_->checkedId());
  }
  if (near_->isChecked()) {
    job.nearLight = "flat";
    job.sceneModel = toPath(sceneModel_->text());
  }
  return job;
}

}  // namespace lightsketch
