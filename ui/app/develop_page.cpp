#include "ui/app/develop_page.h"

#include <QButtonGroup>
#include <QHBoxLayout>
#include <QLabel>
#include <QListWidget>
#include <QProgressBar>
#include <QPushButton>
#include <QScrollArea>
#include <QShortcut>
#include <QTabWidget>
#include <QVBoxLayout>
#include <cmath>

#include "pipeline/sketch/image_file.h"
#include "pipeline/sketch/sketch.h"
#include "pipeline/validate/validate.h"
#include "ui/app/controls.h"
#include "ui/app/develop_choices.h"
#include "ui/app/frames_panel.h"
#include "ui/app/growing_picture.h"
#include "ui/app/hemisphere_view.h"
#include "ui/app/picture_view.h"
#include "ui/app/worker.h"
#include "ui/app/workspace.h"

namespace lightsketch {
namespace {

constexpr int kThumbnails = 24;
constexpr QSize kThumbnailSize{72, 54};
constexpr int kGrowMilliseconds = 80;

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
  row->addLayout(buildChoices());
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
  enlarge(name_, 1.5, true);
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

QLayout* DevelopPage::buildChoices() {
  auto* column = new QVBoxLayout;
  choices_ = new DevelopChoices(workspace());
  // Small windows scroll the choices, never the rest.
  auto* scroll = new QScrollArea;
  scroll->setWidget(choices_);
  scroll->setWidgetResizable(true);
  scroll->setFrameShape(QFrame::NoFrame);
  scroll->setHorizontalScrollBarPolicy(Qt::ScrollBarAlwaysOff);
  scroll->setFixedWidth(340);
  column->addWidget(scroll, 1);
  connect(choices_, &DevelopChoices::holdOutChanged, this, &DevelopPage::showDots);

  develop_ = new QPushButton(tr("Develop"));
  develop_->setObjectName("develop");
  develop_->setMinimumHeight(44);
  enlarge(develop_, 1.25, true);
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
  return column;
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
    makeChoice(button);
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
  choices_->setSummary(summary, another);
  showDots();
  frames_->setSummary(summary, another);
  develop_->setEnabled(task_ || summary.active > 0);
  if (another) {
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
}

void DevelopPage::showDots() {
  std::vector<HemisphereView::Dot> dots;
  for (const SketchSummary::Frame& frame : summary_.frames) {
    dots.push_back({frame.direction,
                    frame.dropped                   ? kDropped
                    : choices_->keepsBack(frame.id) ? kHeld
                                                    : kUsed,
                    summary_.frames.size() > 600 ? 2.0 : 3.5, frame.dropped,
                    frame.dropped ? tr("Frame %1, dropped: %2").arg(frame.id).arg(frame.dropReason)
                                  : tr("Frame %1").arg(frame.id)});
  }
  hemisphere_->setWholeSphere(summary_.wholeSphere);
  hemisphere_->setDots(std::move(dots));
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

void DevelopPage::develop() {
  CompressJob job = choices_->job();
  growing_ =
      std::make_shared<GrowingPicture>(pictures_[0], summary_, job.options.blockSize, exposure_);
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
  develop_->setText(tr("Cancel"));
  tabs_->setCurrentIndex(0);
  task_ = workspace().run(
      tr("Develop %1").arg(toQString(job.sketch.filename())),
      [job](Progress& progress, std::stop_token) { return compressJob(job, progress); });
  follow(task_, progress_);
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
  const bool kept = choices_->keepsBack(summary_.example);
  picture_->setPicture(pictures_[which]);
  picture_->setCaption(which == 0   ? tr("frame %1 as captured").arg(summary_.example)
                       : which == 1 ? (kept ? tr("frame %1, which the model has not seen, as it "
                                                 "draws it")
                                            : tr("frame %1 as the model draws it"))
                                          .arg(summary_.example)
                                    : tr("their difference, four times as strong"));
}

}  // namespace lightsketch
