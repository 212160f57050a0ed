#include "ui/app/develop_page.h"

#include <QButtonGroup>
#include <QCheckBox>
#include <QComboBox>
#include <QDoubleSpinBox>
#include <QFileDialog>
#include <QFormLayout>
#include <QGroupBox>
#include <QHBoxLayout>
#include <QLabel>
#include <QLineEdit>
#include <QListWidget>
#include <QPainter>
#include <QProgressBar>
#include <QPushButton>
#include <QRadioButton>
#include <QScrollArea>
#include <QShortcut>
#include <QSpinBox>
#include <QTabWidget>
#include <QToolButton>
#include <QVBoxLayout>
#include <cmath>
#include <mutex>

#include "pipeline/sketch/image_file.h"
#include "pipeline/sketch/sketch.h"
#include "pipeline/validate/validate.h"
#include "ui/app/frames_panel.h"
#include "ui/app/hemisphere_view.h"
#include "ui/app/picture_view.h"
#include "ui/app/worker.h"
#include "ui/app/workspace.h"

namespace lightsketch {
namespace {

constexpr int kThumbnails = 24;
constexpr QSize kThumbnailSize{72, 54};
constexpr int kGrowMilliseconds = 80;

// The chosen one of the large buttons is plain from two metres.
constexpr auto kLargeChoice =
    "QPushButton { text-align: left; padding: 6px 10px; border: 2px solid palette(mid);"
    " border-radius: 6px; background: palette(button); }"
    "QPushButton:hover { background: palette(midlight); }"
    "QPushButton:focus { border-style: dashed; }"
    "QPushButton:checked { border-color: palette(highlight); background: palette(base); }";

const QColor kUsed("#58a6d8");
const QColor kHeld("#f0a030");
const QColor kDropped("#e41a1c");

// 3.4 MB, 820 kB.
QString inBytes(double bytes) {
  return bytes < 1e6 ? DevelopPage::tr("%1 kB").arg(bytes / 1e3, 0, 'f', bytes < 1e4 ? 1 : 0)
                     : DevelopPage::tr("%1 MB").arg(bytes / 1e6, 0, 'f', bytes < 1e8 ? 1 : 0);
}

// "on average 39.8 dB, off by 2.6 of 255 grey levels"
QString inWords(double psnr) {
  const double levels = 255 / std::pow(10.0, psnr / 20);
  return DevelopPage::tr("%1 dB on average, off by %2 of 255 grey levels")
      .arg(psnr, 0, 'f', 1)
      .arg(levels, 0, 'f', levels < 1 ? 2 : 1);
}

QString describe(const Json& figures) {
  const double bytes = figures.at("bytes").get<double>();
  const double captured = figures.at("capturedBytes").get<double>();
  QString text = DevelopPage::tr("<b>%1</b>, %2 bits per pixel, %3 : 1 against the frames<br>")
                     .arg(inBytes(bytes))
                     .arg(figures.at("bitsPerPixel").get<double>(), 0, 'f', 1)
                     .arg(captured / bytes, 0, 'f', 0);
  if (figures.contains("error")) {
    const Json& error = figures.at("error");
    text += DevelopPage::tr("Measured on %1 of its own frames: <b>%2</b>.")
                .arg(error.at("pictures").get<int>())
                .arg(inWords(error.at("srgbPsnr").get<double>()));
  }
  const int heldOut = figures.at("heldOut").get<int>();
  text += heldOut > 0 ? DevelopPage::tr("<br>%1 frames were kept back: Validate measures on these.")
                            .arg(heldOut)
                      : DevelopPage::tr(
                            "<br>No frame was kept back, so Validate has nothing to "
                            "measure this model with.");
  return text;
}

}  // namespace

// Starts as the means of a captured frame's blocks, which is all that is known of them; each block
// becomes sharp when the first stage has found its basis. Written by any thread.
class DevelopPage::Growing {
 public:
  Growing(const QImage& captured, const SketchSummary& summary, int blockSize, float exposure)
      : exposure_(exposure),
        blocks_((summary.width + blockSize - 1) / blockSize *
                ((summary.height + blockSize - 1) / blockSize)) {
    const QSize size(summary.width, summary.height);
    picture_ = QImage(size, QImage::Format_RGB32);
    picture_.fill(Qt::black);
    if (captured.isNull()) return;
    const QSize means((summary.width + blockSize - 1) / blockSize,
                      (summary.height + blockSize - 1) / blockSize);
    QPainter(&picture_).drawImage(
        QRect(QPoint(), means * blockSize),
        captured.scaled(means, Qt::IgnoreAspectRatio, Qt::SmoothTransformation));
  }

  void put(int left, int top, const RadianceImage& block) {
    const Image<std::uint8_t> codes = toSrgb8(block, exposure_);
    const std::lock_guard lock(mutex_);
    for (int y = 0; y < codes.height(); ++y) {
      auto* line = reinterpret_cast<QRgb*>(picture_.scanLine(top + y)) + left;
      for (int x = 0; x < codes.width(); ++x)
        line[x] = qRgb(codes(x, y, 0), codes(x, y, 1), codes(x, y, 2));
    }
    ++done_;
  }
  // Null: nothing came since the last call.
  QImage take() {
    const std::lock_guard lock(mutex_);
    if (std::exchange(shown_, done_) == done_) return {};
    return picture_.copy();
  }
  double part() const { return std::min(1.0, static_cast<double>(shown_) / blocks_); }

 private:
  const float exposure_;
  const int blocks_;
  std::mutex mutex_;  // guards all below
  QImage picture_;
  int done_ = 0;
  int shown_ = -1;
};

DevelopPage::DevelopPage(Workspace& workspace, QWidget* parent) : Page(workspace, parent) {
  worker_ = new Worker(this);
  auto* across = new QHBoxLayout(this);
  across->setContentsMargins(12, 10, 12, 10);
  across->setSpacing(12);
  across->addWidget(buildSketch());

  tabs_ = new QTabWidget;
  tabs_->setObjectName("developTabs");
  tabs_->setDocumentMode(true);
  auto* make = new QWidget;
  auto* row = new QHBoxLayout(make);
  row->addWidget(buildChoices());
  row->addWidget(buildResult(), 1);
  frames_ = new FramesPanel(workspace, *worker_);
  tabs_->addTab(make, tr("&Develop"));
  tabs_->addTab(frames_, tr("&Bad frames"));
  tabs_->setTabToolTip(0, tr("From the frames to one small file that can be lit by anything"));
  tabs_->setTabToolTip(1, tr("Find frames that would spoil the model, and leave them out"));
  across->addWidget(tabs_, 1);

  growTimer_.setInterval(kGrowMilliseconds);
  connect(&growTimer_, &QTimer::timeout, this, &DevelopPage::grow);
  connect(frames_, &FramesPanel::suspectsChanged, this, [this](int count) {
    tabs_->setTabText(1, count > 0 ? tr("&Bad frames (%1)").arg(count) : tr("&Bad frames"));
  });
  connect(frames_, &FramesPanel::frameShown, this,
          [this](int id) { hemisphere_->setMarkedDot(id); });
  const auto reload = [this](bool another) {
    stale_ = true;
    another_ |= another;
    if (isVisible()) entered();
  };
  connect(&workspace, &Workspace::sketchChanged, this, [reload] { reload(true); });
  connect(&workspace, &Workspace::sketchEdited, this, [reload] { reload(false); });
  showSummary({}, true);
  chosen();
}

DevelopPage::~DevelopPage() {
  delete worker_;  // what it shows goes next
}

QString DevelopPage::purpose() const {
  return tr("Make one small file of a sketch's frames that can be lit by anything");
}

QWidget* DevelopPage::buildSketch() {
  auto* box = new QWidget;
  box->setFixedWidth(250);
  auto* column = new QVBoxLayout(box);
  column->setContentsMargins(0, 0, 0, 0);
  name_ = new QLabel;
  name_->setObjectName("sketchName");
  QFont large = name_->font();
  large.setPointSizeF(large.pointSizeF() * 1.5);
  large.setBold(true);
  name_->setFont(large);
  counts_ = new QLabel;
  counts_->setObjectName("sketchCounts");
  counts_->setWordWrap(true);
  hemisphere_ = new HemisphereView;
  hemisphere_->setObjectName("directions");
  hemisphere_->setAccessibleName(tr("Directions of the light"));
  hemisphere_->setFixedHeight(250);
  auto* legend = new QLabel(
      tr("<span style='color:%1'>\u25cf</span> used &nbsp; <span style='color:%2'>\u25cf</span> "
         "kept back &nbsp; <span style='color:%3'>\u25cb</span> dropped")
          .arg(kUsed.name(), kHeld.name(), kDropped.name()));
  legend->setAlignment(Qt::AlignCenter);
  thumbnails_ = new QListWidget;
  thumbnails_->setObjectName("thumbnails");
  thumbnails_->setAccessibleName(tr("Some of the frames"));
  thumbnails_->setToolTip(tr("Some of the frames; a click shows one large"));
  thumbnails_->setViewMode(QListView::IconMode);
  thumbnails_->setIconSize(kThumbnailSize);
  thumbnails_->setResizeMode(QListView::Adjust);
  thumbnails_->setMovement(QListView::Static);
  thumbnails_->setUniformItemSizes(true);
  thumbnails_->setGridSize(kThumbnailSize + QSize(4, 4));
  thumbnails_->setFrameShape(QFrame::NoFrame);
  column->addWidget(name_);
  column->addWidget(counts_);
  column->addWidget(hemisphere_);
  column->addWidget(legend);
  column->addWidget(thumbnails_, 1);
  const auto showFrame = [this](int id) {
    hemisphere_->setMarkedDot(id);
    if (task_) return;
    worker_->ask("frame",
                 [this, folder = workspace().sketch(), id,
                  exposure = exposure_](const std::stop_token&) -> Worker::Show {
                   const auto image = frameImage(folder, id, exposure);
                   if (!image) return {};
                   return [this, id, image = *image] {
                     tabs_->setCurrentIndex(0);
                     picture_->setPicture(image);
                     picture_->setCaption(tr("frame %1 as captured").arg(id));
                   };
                 });
  };
  connect(hemisphere_, &HemisphereView::dotClicked, this, showFrame);
  connect(thumbnails_, &QListWidget::currentItemChanged, this, [showFrame](QListWidgetItem* item) {
    if (item) showFrame(item->data(Qt::UserRole).toInt());
  });
  return box;
}

QWidget* DevelopPage::buildChoices() {
  auto* box = new QWidget;
  auto* column = new QVBoxLayout(box);
  column->setContentsMargins(0, 0, 6, 0);
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
      tr("Errors as parts of the picture's brightness. Ranks and roundings are chosen so that no "
         "bit is spent on less (lightsketch compress --quality %1)");
  large(kSmall, "qualitySmall", tr("&Small"), tr("to show and to send; errors near 3 %"),
        how.arg("small"));
  large(kStandard, "qualityStandard", tr("S&tandard"), tr("for most work; errors near 1.5 %"),
        how.arg("standard"));
  large(kArchive, "qualityArchive", tr("&Archive"),
        tr("to keep and to measure from; errors near 1 %"), how.arg("archive"));

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
  connect(near_, &QCheckBox::toggled, sceneModel_, &QWidget::setEnabled);
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
  auto* fileLabel = new QLabel(tr("File &name"));
  file_ = new QLineEdit;
  file_->setObjectName("modelFile");
  file_->setToolTip(tr("The model's file; made whole or not at all"));
  fileLabel->setBuddy(file_);
  fileRow->addWidget(fileLabel);
  fileRow->addWidget(file_, 1);
  column->addLayout(fileRow);
  connect(file_, &QLineEdit::textEdited, this, [this](const QString& text) { fileByHand_ = text; });

  develop_ = new QPushButton(tr("Develop"));
  develop_->setObjectName("develop");
  develop_->setMinimumHeight(44);
  QFont bold = develop_->font();
  bold.setPointSizeF(bold.pointSizeF() * 1.25);
  bold.setBold(true);
  develop_->setFont(bold);
  develop_->setToolTip(tr("Makes the model (Ctrl+Return)"));
  connect(new QShortcut(QKeySequence("Ctrl+Return"), this), &QShortcut::activated, this,
          [this] { begin(); });
  connect(develop_, &QPushButton::clicked, this, [this] {
    if (task_) {
      task_->cancel();
    } else {
      develop();
    }
  });
  column->addWidget(develop_);

  choices_->button(kStandard)->setChecked(true);
  connect(choices_, &QButtonGroup::idClicked, this, [this] { chosen(); });

  // Small windows scroll the choices, never the rest.
  auto* scroll = new QScrollArea;
  scroll->setWidget(box);
  scroll->setWidgetResizable(true);
  scroll->setFrameShape(QFrame::NoFrame);
  scroll->setHorizontalScrollBarPolicy(Qt::ScrollBarAlwaysOff);
  scroll->setFixedWidth(340);
  return scroll;
}

QWidget* DevelopPage::buildResult() {
  auto* box = new QWidget;
  auto* column = new QVBoxLayout(box);
  column->setContentsMargins(6, 0, 0, 0);
  picture_ = new PictureView;
  picture_->setObjectName("picture");
  column->addWidget(picture_, 1);

  shown_ = new QButtonGroup(this);
  shownRow_ = new QWidget;
  auto* row = new QHBoxLayout(shownRow_);
  row->setContentsMargins(0, 0, 0, 0);
  row->addStretch(1);
  const QString names[] = {tr("As &captured"), tr("By the &model"), tr("Difference \u00d7 4")};
  const char* objects[] = {"showCaptured", "showModel", "showDifference"};
  for (int i = 0; i < 3; ++i) {
    auto* button = new QPushButton(names[i]);
    button->setObjectName(objects[i]);
    button->setCheckable(true);
    button->setToolTip(tr("Flip between the frame as captured and as the model draws it"));
    shown_->addButton(button, i);
    row->addWidget(button);
  }
  row->addStretch(1);
  shownRow_->hide();
  column->addWidget(shownRow_);
  connect(shown_, &QButtonGroup::idClicked, this, [this] { showPicture(); });

  progress_ = new QProgressBar;
  progress_->setObjectName("developProgress");
  progress_->setAccessibleName(tr("Progress"));
  progress_->hide();
  column->addWidget(progress_);
  result_ = new QLabel;
  result_->setObjectName("developResult");
  result_->setWordWrap(true);
  result_->setTextInteractionFlags(Qt::TextSelectableByMouse);
  column->addWidget(result_);
  auto* next = new QHBoxLayout;
  relight_ = new QPushButton(tr("Relight it"));
  relight_->setObjectName("toRelight");
  relight_->setToolTip(tr("Light the model with lamps, maps and cameras"));
  validate_ = new QPushButton(tr("Validate it"));
  validate_->setObjectName("toValidate");
  validate_->setToolTip(tr("Measure the model on the frames that were kept back"));
  for (QPushButton* button : {relight_, validate_}) {
    button->setMinimumHeight(36);
    button->hide();
    next->addWidget(button);
  }
  column->addLayout(next);
  connect(relight_, &QPushButton::clicked, this, [this] { workspace().show("relight"); });
  connect(validate_, &QPushButton::clicked, this, [this] { workspace().show("validate"); });
  return box;
}

void DevelopPage::entered() {
  if (!stale_) return;
  stale_ = false;
  load(std::exchange(another_, false));
}

void DevelopPage::begin() {
  if (!task_ && develop_->isEnabled()) develop();
}

void DevelopPage::load(bool another) {
  const auto folder = workspace().sketch();
  if (folder.empty()) return showSummary({}, true);
  worker_->ask("summary", [this, folder, another](const std::stop_token&) -> Worker::Show {
    auto summary = summaryOf(folder);
    if (!summary) {
      return [this, text = QString::fromStdString(summary.error().message)] {
        showSummary({}, true);
        workspace().say({"sketch", Workspace::Level::kError, text});
      };
    }
    return [this, another, summary = std::move(*summary)] { showSummary(summary, another); };
  });
}

void DevelopPage::showSummary(const SketchSummary& summary, bool another) {
  summary_ = summary;
  const auto& folder = workspace().sketch();
  const bool any = !summary.frames.empty();
  name_->setText(folder.empty() ? tr("No sketch") : toQString(folder.filename()));
  name_->setToolTip(toQString(folder));
  const auto dropped = static_cast<int>(summary.frames.size()) - summary.active;
  counts_->setText(
      !any ? tr("Record one on the Sketch page, or open one: File, Open, or drop its folder here.")
           : tr("%1 frames, %2 \u00d7 %3%4")
                 .arg(summary.active)
                 .arg(summary.width)
                 .arg(summary.height)
                 .arg(dropped > 0 ? tr(", %1 dropped").arg(dropped) : QString()));
  std::vector<HemisphereView::Dot> dots;
  for (const SketchSummary::Frame& frame : summary.frames) {
    const bool held = holdOut_->isChecked() && summary.heldOut.contains(frame.id);
    dots.push_back({frame.direction,
                    frame.dropped ? kDropped
                    : held        ? kHeld
                                  : kUsed,
                    summary.frames.size() > 600 ? 2.0 : 3.5, frame.dropped,
                    frame.dropped ? tr("Frame %1, dropped: %2").arg(frame.id).arg(frame.dropReason)
                                  : tr("Frame %1").arg(frame.id)});
  }
  hemisphere_->setWholeSphere(summary.wholeSphere);
  hemisphere_->setDots(std::move(dots));
  holdOut_->setEnabled(!summary.holdOut.empty());
  holdOut_->setText(summary.heldOut.empty() ? tr("Keep some frames bac&k to measure with")
                                            : tr("Keep %1 of %2 frames bac&k to measure with")
                                                  .arg(summary.heldOut.size())
                                                  .arg(summary.active));
  frames_->setSummary(summary, another);
  develop_->setEnabled(task_ || summary.active > 0);
  if (another) {
    fileByHand_.clear();
    thumbnails_->clear();
    result_->clear();
    shownRow_->hide();
    relight_->hide();
    validate_->hide();
    for (QImage& picture : pictures_) picture = {};
    picture_->setPicture({});
    picture_->setPlaceholder(
        any ? QString() : tr("No sketch yet. Record one on the Sketch page, or open one."));
    if (any) loadThumbnails();
  }
  chosen();
}

void DevelopPage::loadThumbnails() {
  std::vector<int> active;
  for (const SketchSummary::Frame& frame : summary_.frames)
    if (!frame.dropped) active.push_back(frame.id);
  std::vector<int> some;
  const std::size_t count = std::min<std::size_t>(kThumbnails, active.size());
  for (std::size_t i = 0; i < count; ++i) some.push_back(active[i * active.size() / count]);
  worker_->ask(
      "thumbnails",
      [this, folder = workspace().sketch(), some, ratio = devicePixelRatioF(),
       example = summary_.example](const std::stop_token& stop) -> Worker::Show {
        auto thumbnails = thumbnailsOf(folder, some, kThumbnailSize * ratio, stop);
        for (Thumbnail& thumbnail : thumbnails.pictures) thumbnail.image.setDevicePixelRatio(ratio);
        const auto image = frameImage(folder, example, thumbnails.exposure);
        return [this, thumbnails = std::move(thumbnails), image = image.value_or(QImage())] {
          exposure_ = thumbnails.exposure;
          frames_->setExposure(exposure_);
          const QSignalBlocker quiet(thumbnails_);
          for (const Thumbnail& thumbnail : thumbnails.pictures) {
            auto* item =
                new QListWidgetItem(QIcon(QPixmap::fromImage(thumbnail.image)), {}, thumbnails_);
            item->setData(Qt::UserRole, thumbnail.id);
            item->setToolTip(tr("Frame %1").arg(thumbnail.id));
          }
          pictures_[0] = image;
          if (task_) return;
          picture_->setPicture(image);
          picture_->setCaption(tr("frame %1 as captured").arg(summary_.example));
        };
      });
}

QString DevelopPage::suggestedFile() const {
  if (workspace().sketch().empty()) return {};
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
  return toQString(workspace().sketch()) + "-" + name + ".lsd";
}

// Something about what is to be made was chosen.
void DevelopPage::chosen() {
  if (fileByHand_.isEmpty()) file_->setText(suggestedFile());
}

CompressJob DevelopPage::job() const {
  CompressJob job;
  job.sketch = workspace().sketch();
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

void DevelopPage::develop() {
  CompressJob job = this->job();
  growing_ = std::make_shared<Growing>(pictures_[0], summary_, job.options.blockSize, exposure_);
  if (summary_.example >= 0) {
    job.options.watch.light = summary_.frames[static_cast<std::size_t>(summary_.example)].direction;
  }
  job.options.watch.onBlock = [growing = growing_](int x, int y, const RadianceImage& block) {
    growing->put(x, y, block);
  };
  worker_->withdraw("frame");
  worker_->withdraw("compare");
  pictures_[1] = pictures_[2] = {};
  shownRow_->hide();
  result_->clear();
  relight_->hide();
  validate_->hide();
  progress_->setRange(0, 0);
  progress_->setFormat({});
  progress_->show();
  develop_->setText(tr("Cancel"));
  tabs_->setCurrentIndex(0);
  task_ = workspace().run(
      tr("Develop %1").arg(toQString(job.sketch.filename())),
      [job](Progress& progress, std::stop_token) { return compressJob(job, progress); });
  connect(task_, &Task::progressed, progress_,
          [this](const QString& stage, double fraction, double) {
            progress_->setRange(0, fraction < 0 ? 0 : 1000);
            if (fraction >= 0) progress_->setValue(qRound(1000 * fraction));
            progress_->setFormat(stage);
          });
  connect(task_, &Task::finished, this, [this, task = task_, job] { finish(*task, job); });
  growTimer_.start();
  grow();
}

void DevelopPage::grow() {
  const QImage picture = growing_->take();
  if (picture.isNull()) return;
  picture_->setPicture(picture);
  picture_->setCaption(
      growing_->part() <= 0
          ? tr("the means of a frame's blocks; each gets sharp when its basis is "
               "found")
          : tr("%1 % of the blocks have their basis").arg(100 * growing_->part(), 0, 'f', 0));
}

void DevelopPage::finish(const Task& task, const CompressJob& job) {
  task_ = nullptr;
  growTimer_.stop();
  progress_->hide();
  develop_->setText(tr("Develop"));
  develop_->setEnabled(summary_.active > 0);
  if (!task.result()) {
    result_->setText(task.cancelled() ? tr("Cancelled; no file was made.") : QString());
    if (!pictures_[0].isNull()) {
      picture_->setPicture(pictures_[0]);
      picture_->setCaption(tr("frame %1 as captured").arg(summary_.example));
    }
    return;
  }
  grow();
  result_->setText(describe(task.result()->figures));
  relight_->show();
  validate_->show();
  validate_->setEnabled(task.result()->figures.at("heldOut").get<int>() > 0);
  workspace().setModel(job.out);
  if (summary_.example >= 0) compareWithCapture(job.out);
}

void DevelopPage::compareWithCapture(const std::filesystem::path& file) {
  worker_->ask("compare",
               [this, file, folder = workspace().sketch(), id = summary_.example,
                exposure = exposure_](const std::stop_token&) -> Worker::Show {
                 const auto sketch = Sketch::open(folder);
                 const auto model = loadModel(file);
                 if (!sketch || !model) return {};
                 const auto interpolator = interpolatorFor(*model);
                 if (!interpolator) return {};
                 const auto triple = heldOutPictures(*sketch, *model, *interpolator, id, exposure);
                 if (!triple) return {};
                 return [this, captured = toQImage(triple->truth), relit = toQImage(triple->relit),
                         difference = toQImage(triple->difference)] {
                   pictures_[0] = captured;
                   pictures_[1] = relit;
                   pictures_[2] = difference;
                   shown_->button(1)->setChecked(true);
                   shownRow_->show();
                   showPicture();
                 };
               });
}

void DevelopPage::showPicture() {
  const int which = shown_->checkedId();
  const bool kept = holdOut_->isChecked() && summary_.heldOut.contains(summary_.example);
  picture_->setPicture(pictures_[which]);
  picture_->setCaption(which == 0   ? tr("frame %1 as captured").arg(summary_.example)
                       : which == 1 ? (kept ? tr("frame %1, which the model has not seen, as it "
                                                 "draws it")
                                            : tr("frame %1 as the model draws it"))
                                          .arg(summary_.example)
                                    : tr("their difference, four times as strong"));
}

}  // namespace lightsketch
