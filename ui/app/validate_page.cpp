#include "ui/app/validate_page.h"

#include <QComboBox>
#include <QDesktopServices>
#include <QFileDialog>
#include <QHBoxLayout>
#include <QHeaderView>
#include <QLabel>
#include <QMenu>
#include <QProgressBar>
#include <QPushButton>
#include <QShortcut>
#include <QSortFilterProxyModel>
#include <QSplitter>
#include <QTableView>
#include <QUrl>
#include <QVBoxLayout>
#include <algorithm>
#include <cmath>
#include <optional>

#include "capture/frame/file.h"
#include "pipeline/compress/compress.h"
#include "pipeline/sketch/lp.h"
#include "ui/app/colour_scale.h"
#include "ui/app/controls.h"
#include "ui/app/hemisphere_view.h"
#include "ui/app/picture_view.h"
#include "ui/app/worker.h"
#include "ui/app/workspace.h"

namespace lightsketch {
namespace {

enum Column { kFrame, kPsnr, kSsim, kError, kNearest, kInside, kX, kY, kZ, kColumns };
enum Subject { kModelAtHand, kNewSmall, kNewStandard, kNewArchive };

// A number that sorts as one.
QStandardItem* numberItem(double value, int digits) {
  auto* item = new QStandardItem(shown(value, digits));
  item->setData(std::isfinite(value) ? value : 1e30, Qt::UserRole);
  item->setTextAlignment(Qt::AlignRight | Qt::AlignVCenter);
  item->setEditable(false);
  return item;
}

}  // namespace

struct ValidatePage::Sources {
  Sketch sketch;
  RelightableModel model;
  DirectionInterpolator interpolator;
};

ValidatePage::ValidatePage(Workspace& workspace, QWidget* parent) : Page(workspace, parent) {
  worker_ = new Worker(this);
  auto* column = new QVBoxLayout(this);
  column->setContentsMargins(12, 10, 12, 10);
  column->addWidget(buildBar());
  advice_ = new QLabel;
  advice_->setObjectName("validateAdvice");
  advice_->setWordWrap(true);
  column->addWidget(advice_);
  auto* across = new QHBoxLayout;
  across->setSpacing(12);
  across->addWidget(buildLeft());
  across->addWidget(buildRight(), 1);
  column->addLayout(across, 1);

  const auto modelChanged = [this] {
    staleModel_ = true;
    if (isVisible()) entered();
  };
  connect(&workspace, &Workspace::modelChanged, this, modelChanged);
  connect(&workspace, &Workspace::sketchChanged, this, modelChanged);
  connect(&workspace, &Workspace::sketchEdited, this, modelChanged);
  connect(&workspace, &Workspace::reportChanged, this, [this] {
    staleReport_ = true;
    if (isVisible()) entered();
  });
  show(nullptr);
  chooseFromModel({}, false);
}

ValidatePage::~ValidatePage() {
  delete worker_;  // what it shows goes next
}

QString ValidatePage::purpose() const {
  return tr("Measure the model on frames that it has not seen");
}

QWidget* ValidatePage::buildBar() {
  auto* bar = new QWidget;
  auto* row = new QHBoxLayout(bar);
  row->setContentsMargins(0, 0, 0, 0);
  const auto labelled = [&](const QString& text, QComboBox* box, const char* name,
                            const QString& tip) {
    box->setObjectName(name);
    box->setToolTip(tip);
    row->addWidget(labelFor(box, text));
    row->addWidget(box);
    return box;
  };
  subject_ = labelled(tr("&Measure"), new QComboBox, "subject",
                      tr("The model at hand, or a new one made only to be measured"));
  subject_->addItem(tr("the model at hand"), kModelAtHand);
  subject_->addItem(tr("a new model, small"), kNewSmall);
  subject_->addItem(tr("a new model, standard"), kNewStandard);
  subject_->addItem(tr("a new model, archive"), kNewArchive);
  holdOut_ = labelled(
      tr("&keeping back"), new QComboBox, "holdOutRule",
      tr("Which frames the model must not see: every eighth where directions are spread evenly; "
         "whole patches of directions where many frames are near twins"));
  holdOut_->addItem(tr("what suits the sketch"), QString());
  holdOut_->addItem(tr("every 4th frame"), "every:4:2");
  holdOut_->addItem(tr("every 8th frame"), "every:8:4");
  holdOut_->addItem(tr("every 16th frame"), "every:16:8");
  holdOut_->addItem(tr("an eighth in patches"), "cells:8:4");
  validate_ = new QPushButton(tr("Validate"));
  validate_->setObjectName("validate");
  validate_->setToolTip(
      tr("Compares each frame kept back with the model's picture under the same "
         "light (Ctrl+Return)"));
  validate_->setMinimumHeight(36);
  enlarge(validate_, 1, true);
  row->addWidget(validate_);
  progress_ = new QProgressBar;
  progress_->setObjectName("validateProgress");
  progress_->setAccessibleName(tr("Progress"));
  progress_->setMaximumWidth(240);
  progress_->hide();
  row->addWidget(progress_);
  row->addStretch(1);
  const auto button = [&](const char* name, const QString& text, const QString& tip) {
    auto* made = new QPushButton(text);
    made->setObjectName(name);
    made->setToolTip(tip);
    row->addWidget(made);
    return made;
  };
  open_ = button("openReport", tr("&Open a report..."),
                 tr("Shows a report made before: choose its folder, or drop it here"));
  browser_ = button("showHtml", tr("In the &browser"),
                    tr("The whole report as one page, with worst, median and best pictures"));
  export_ = button("export", tr("E&xport"), tr("Figures and light directions for other programs"));
  auto* menu = new QMenu(export_);
  menu->setToolTipsVisible(true);
  const auto entry = [&](const char* name, const QString& text, const QString& tip,
                         const auto& act) {
    QAction* action = menu->addAction(text, this, act);
    action->setObjectName(name);
    action->setToolTip(tip);
  };
  entry("exportCsv", tr("&Figures of the lights (.csv)..."),
        tr("A line per frame kept back: direction, errors"), [this] {
          const QString file = QFileDialog::getSaveFileName(
              this, tr("Figures of the lights"), toQString(report_->folder) + "-lights.csv",
              tr("Tables (*.csv)"));
          if (!file.isEmpty()) exportFigures(toPath(file));
        });
  entry("exportLp", tr("&Light directions (.lp)..."),
        tr("Names and directions of all frames of the sketch that are in use"), [this] {
          const QString file = QFileDialog::getSaveFileName(
              this, tr("Light directions"), toQString(report_->folder.parent_path() / "dirs.lp"),
              tr("Light positions (*.lp)"));
          if (!file.isEmpty()) exportDirections(toPath(file));
        });
  entry("exportPictures", tr("&Pictures with directions (folder)..."),
        tr("All frames in use as 16-bit PNG with dirs.lp, for RTI programs"), [this] {
          const QString folder = QFileDialog::getSaveFileName(
              this, tr("New folder for the pictures"), toQString(workspace().sketch()) + "-lp");
          if (!folder.isEmpty()) exportPictures(toPath(folder));
        });
  export_->setMenu(menu);

  connect(validate_, &QPushButton::clicked, this, [this] {
    if (task_) {
      task_->cancel();
    } else {
      validateNow();
    }
  });
  connect(new QShortcut(QKeySequence("Ctrl+Return"), this), &QShortcut::activated, this,
          [this] { begin(); });
  connect(subject_, &QComboBox::currentIndexChanged, this,
          [this] { holdOut_->setEnabled(subject_->currentData().toInt() != kModelAtHand); });
  connect(open_, &QPushButton::clicked, this, [this] {
    const QString folder = QFileDialog::getExistingDirectory(
        this, tr("A report's folder"), toQString(workspace().sketch().parent_path()));
    if (!folder.isEmpty()) workspace().setReport(toPath(folder));
  });
  connect(browser_, &QPushButton::clicked, this, [this] {
    QDesktopServices::openUrl(QUrl::fromLocalFile(toQString(report_->folder / "index.html")));
  });
  return bar;
}

QWidget* ValidatePage::buildLeft() {
  auto* left = new QWidget;
  left->setFixedWidth(330);
  auto* column = new QVBoxLayout(left);
  column->setContentsMargins(0, 0, 0, 0);
  figures_ = new QLabel;
  figures_->setObjectName("figures");
  figures_->setAccessibleName(tr("Figures"));
  figures_->setTextInteractionFlags(Qt::TextSelectableByMouse);
  figures_->setToolTip(
      tr("PSNR: of 8-bit sRGB pictures; 40 dB is off by 2.6 of 255 grey levels. SSIM: likeness to "
         "the eye, 1 is identical. Error: in linear light, against the picture's brightness. "
         "Inside: between captured lights; outside: beyond the last of them."));
  column->addWidget(figures_);
  hemisphere_ = new HemisphereView;
  hemisphere_->setObjectName("errorMap");
  hemisphere_->setAccessibleName(tr("Error by direction of the light"));
  column->addWidget(hemisphere_, 1);
  scale_ = new ColourScale;
  column->addWidget(scale_);
  connect(hemisphere_, &HemisphereView::dotClicked, this, [this](int dot) {
    if (report_ && dot < static_cast<int>(report_->lights.size())) select(dot);
  });
  return left;
}

QWidget* ValidatePage::buildRight() {
  auto* splitter = new QSplitter(Qt::Vertical);
  auto* top = new QWidget;
  auto* column = new QVBoxLayout(top);
  column->setContentsMargins(0, 0, 0, 0);
  auto* row = new QHBoxLayout;
  caption_ = new QLabel;
  caption_->setObjectName("lightCaption");
  enlarge(caption_, 1.15);
  row->addWidget(caption_, 1);
  const auto button = [&](const char* name, const QString& text, QKeyCombination key,
                          const QString& tip) {
    auto* made = new QPushButton(text);
    made->setObjectName(name);
    made->setToolTip(tip);
    row->addWidget(made);
    connect(new QShortcut(QKeySequence(key), this), &QShortcut::activated, made,
            &QPushButton::click);
    return made;
  };
  worse_ = button("worse", tr("\u25c2 worse"), Qt::CTRL | Qt::Key_Left,
                  tr("The next worse light (Ctrl+Left)"));
  better_ = button("better", tr("better \u25b8"), Qt::CTRL | Qt::Key_Right,
                   tr("The next better light (Ctrl+Right)"));
  connect(worse_, &QPushButton::clicked, this, [this] { step(1); });
  connect(better_, &QPushButton::clicked, this, [this] { step(-1); });
  column->addLayout(row);
  pictures_ = new TripleView;
  pictures_->setObjectName("lightPictures");
  column->addWidget(pictures_, 1);
  splitter->addWidget(top);

  rows_ = new QStandardItemModel(0, kColumns, this);
  rows_->setHorizontalHeaderLabels({tr("Frame"), tr("PSNR, dB"), tr("SSIM"), tr("Error, %"),
                                    tr("Nearest, \u00b0"), tr("Inside"), "x", "y", "z"});
  const QString tips[] = {tr("Number in the sketch"),
                          tr("Of 8-bit sRGB pictures, more is better"),
                          tr("Likeness to the eye, 1 is identical"),
                          tr("In linear light, against the picture's brightness"),
                          tr("Angle to the nearest light that the model was made from"),
                          tr("Whether it lies between lights that the model was made from"),
                          tr("Right"),
                          tr("Up"),
                          tr("Towards the viewer")};
  for (int i = 0; i < kColumns; ++i)
    rows_->setHeaderData(i, Qt::Horizontal, tips[i], Qt::ToolTipRole);
  sorted_ = new QSortFilterProxyModel(this);
  sorted_->setSourceModel(rows_);
  sorted_->setSortRole(Qt::UserRole);
  table_ = new QTableView;
  table_->setObjectName("lights");
  table_->setAccessibleName(tr("Lights"));
  table_->setModel(sorted_);
  table_->setSortingEnabled(true);
  table_->sortByColumn(kPsnr, Qt::AscendingOrder);
  table_->setSelectionBehavior(QAbstractItemView::SelectRows);
  table_->setSelectionMode(QAbstractItemView::SingleSelection);
  table_->setAlternatingRowColors(true);
  table_->setShowGrid(false);
  table_->verticalHeader()->hide();
  table_->verticalHeader()->setDefaultSectionSize(24);
  table_->horizontalHeader()->setSectionResizeMode(QHeaderView::Stretch);
  table_->setMinimumHeight(100);
  splitter->addWidget(table_);
  splitter->setStretchFactor(0, 3);
  splitter->setStretchFactor(1, 2);
  connect(table_->selectionModel(), &QItemSelectionModel::currentRowChanged, this,
          [this](const QModelIndex& index) {
            if (index.isValid()) select(sorted_->mapToSource(index).row());
          });
  return splitter;
}

void ValidatePage::entered() {
  if (std::exchange(staleModel_, false)) describeModel();
  if (std::exchange(staleReport_, false)) load();
}

void ValidatePage::begin() {
  if (!task_ && validate_->isEnabled()) validateNow();
}

// Whether the model at hand can be measured: looked up in its file, in the background.
void ValidatePage::describeModel() {
  const auto file = workspace().model();
  if (file.empty()) return chooseFromModel({}, false);
  worker_->ask("model", [this, file](const std::stop_token&) -> Worker::Show {
    const auto info = infoJob(file);
    const bool readable = info.has_value() && info->figures.contains("holdOut");
    const auto rule =
        readable ? QString::fromStdString(info->figures["holdOut"].get<std::string>()) : QString();
    return [this, readable, rule] { chooseFromModel(rule, readable); };
  });
}

void ValidatePage::chooseFromModel(const QString& holdOut, bool readable) {
  const bool measurable = readable && !holdOut.isEmpty();
  const bool sketch = !workspace().sketch().empty();
  subject_->setItemText(0, workspace().model().empty() ? tr("the model at hand")
                                                       : toQString(workspace().model().filename()));
  auto* items = qobject_cast<QStandardItemModel*>(subject_->model());
  items->item(kModelAtHand)->setEnabled(measurable);
  if (measurable) {
    subject_->setCurrentIndex(kModelAtHand);
  } else if (subject_->currentIndex() == kModelAtHand) {
    subject_->setCurrentIndex(kNewStandard);
  }
  holdOut_->setEnabled(subject_->currentIndex() != kModelAtHand);
  validate_->setEnabled(task_ || sketch);
  advice_->setText(
      !sketch
          ? tr("No sketch yet. Record one on the Sketch page, or open one. A report made before "
               "can be opened alone.")
      : readable && !measurable ? tr("The model at hand has seen every frame, so nothing is left "
                                     "to measure it with. A new "
                                     "one, without the frames kept back, is made for the report.")
                                : QString());
  advice_->setVisible(!advice_->text().isEmpty());
}

void ValidatePage::validateNow() {
  ValidateJob job;
  job.sketch = workspace().sketch();
  const int subject = subject_->currentData().toInt();
  if (subject == kModelAtHand) {
    job.model = workspace().model();
    job.report = job.model.parent_path() / (job.model.stem().string() + "-report");
  } else {
    job.compress.quality = static_cast<Quality>(subject - kNewSmall);
    job.holdOutRule = holdOut_->currentData().toString().toStdString();
    job.report = job.sketch.string() + "-report";
  }
  task_ = workspace().run(
      tr("Validate %1").arg(toQString(job.sketch.filename())),
      [job](Progress& progress, std::stop_token) { return validateJob(job, progress); });
  validate_->setText(tr("Cancel"));
  follow(task_, progress_);
  connect(task_, &Task::finished, this, [this, task = task_, job] {
    task_ = nullptr;
    validate_->setText(tr("Validate"));
    validate_->setEnabled(!workspace().sketch().empty());
    if (task->result()) workspace().setReport(job.report);
  });
}

void ValidatePage::load() {
  const auto folder = workspace().report();
  worker_->withdraw("sources");
  worker_->ask("report", [this, folder](const std::stop_token&) -> Worker::Show {
    auto report = StoredReport::read(folder);
    if (!report) {
      return [this, text = QString::fromStdString(report.error().message)] {
        workspace().say({"report", Workspace::Level::kError, text});
      };
    }
    return [this, report = std::move(*report)] { show(report); };
  });
}

void ValidatePage::show(std::shared_ptr<const StoredReport> report) {
  report_ = std::move(report);
  sources_ = nullptr;
  problem_.clear();
  light_ = -1;
  const bool any = report_ != nullptr;
  browser_->setEnabled(any);
  export_->setEnabled(any);
  worker_->withdraw("pictures");
  pictures_->setPictures({}, {}, {});
  pictures_->setCaptions({}, {}, {});
  pictures_->setPlaceholder(
      any ? QString()
          : tr("Nothing measured yet. Validate compares the model with frames "
               "that it has not seen; click a light on the map then, and see "
               "both pictures."));
  caption_->setText({});
  worse_->setEnabled(false);
  better_->setEnabled(false);
  rows_->removeRows(0, rows_->rowCount());
  scale_->setVisible(any);
  if (!any) {
    figures_->clear();
    hemisphere_->setDots({});
    return;
  }

  const Json& figures = report_->figures;
  figures_->setText(report_->table());

  double low = 1e9;
  double high = -1e9;
  for (const StoredReport::Light& light : report_->lights) {
    low = std::min(low, light.psnr);
    high = std::max(high, light.psnr);
    QList<QStandardItem*> items;
    auto* inside = new QStandardItem(light.insideHull ? tr("yes") : tr("no"));
    inside->setData(light.insideHull ? 1 : 0, Qt::UserRole);
    inside->setTextAlignment(Qt::AlignCenter);
    inside->setEditable(false);
    items << numberItem(light.id, 0) << numberItem(light.psnr, 2) << numberItem(light.ssim, 4)
          << numberItem(100 * light.relative, 2) << numberItem(light.nearest, 1) << inside
          << numberItem(light.direction.x(), 3) << numberItem(light.direction.y(), 3)
          << numberItem(light.direction.z(), 3);
    if (!light.origin.isEmpty()) items.front()->setToolTip(light.origin);
    rows_->appendRow(items);
  }
  // As the report's map: a black frame is predicted at 60 dB and more by any model.
  for (const StoredReport::Light& light : report_->lights) {
    if (light.id == figures.value("median", -1)) high = std::min(high, light.psnr + 15);
  }
  low = std::floor(low);
  scale_->setRange(low, std::max(low + 1, std::ceil(high)));
  fillDots();
  // The worst first: what one wants to know.
  if (sorted_->rowCount() > 0) table_->setCurrentIndex(sorted_->index(0, 0));

  // The sketch and the model behind it, for pictures.
  std::vector<std::filesystem::path> models;
  const Json model = figures.value("model", Json::object());
  const std::string file = model.value("file", std::string());
  if (const std::string path = model.value("path", std::string()); !path.empty())
    models.emplace_back(path);
  if (!file.empty()) {
    models.push_back(report_->folder / file);
    models.push_back(report_->folder.parent_path() / file);
  }
  const std::filesystem::path sketch = figures.value("sketch", std::string());
  pictures_->setPlaceholder(tr("Loading the model..."));
  worker_->ask(
      "sources",
      [this, models, sketch, other = workspace().sketch()](const std::stop_token&) -> Worker::Show {
        const auto load = [&]() -> Result<std::shared_ptr<const Sources>> {
          auto opened = Sketch::open(sketch);
          if (!opened && !other.empty() && other.filename() == sketch.filename())
            opened = Sketch::open(other);  // moved
          if (!opened) return tl::unexpected<Error>(opened.error());
          std::error_code error;
          const auto there = std::ranges::find_if(models, [&](const auto& path) {
            return std::filesystem::is_regular_file(path, error);
          });
          if (there == models.end()) {
            return failure(ErrorCode::kNotFound, "the model {} is not there any more",
                           models.empty() ? "of this report" : models.front().string());
          }
          ASSIGN_OR_RETURN(auto loaded, loadModel(*there));
          ASSIGN_OR_RETURN(auto interpolator, interpolatorFor(loaded));
          return std::make_shared<const Sources>(
              Sources{std::move(*opened), std::move(loaded), std::move(interpolator)});
        };
        auto sources = load();
        return [this, sources = sources.value_or(nullptr),
                problem = sources ? QString() : QString::fromStdString(sources.error().message)] {
          take(sources, problem);
        };
      });
}

void ValidatePage::take(std::shared_ptr<const Sources> sources, const QString& problem) {
  sources_ = std::move(sources);
  problem_ = problem;
  fillDots();
  draw();
}

void ValidatePage::fillDots() {
  std::vector<HemisphereView::Dot> dots;
  bool behind = false;
  for (const StoredReport::Light& light : report_->lights) {
    dots.push_back({light.direction, scale_->colourOf(light.psnr), 6, false,
                    tr("Frame %1: %2 dB").arg(light.id).arg(light.psnr, 0, 'f', 1)});
    behind |= light.direction.z() < 0;
  }
  if (sources_) {
    QColor grey = palette().color(QPalette::Mid);
    for (const Eigen::Vector3d& direction : sources_->model.capturedDirections) {
      dots.push_back({direction, grey, 1.8, false, tr("captured, in the model")});
      behind |= direction.z() < 0;
    }
  }
  hemisphere_->setWholeSphere(behind);
  hemisphere_->setDots(std::move(dots));
  hemisphere_->setMarkedDot(light_);
}

void ValidatePage::select(int light) {
  if (light == light_) return;
  light_ = light;
  hemisphere_->setMarkedDot(light);
  const QModelIndex index = sorted_->mapFromSource(rows_->index(light, 0));
  if (table_->currentIndex().row() != index.row()) table_->setCurrentIndex(index);
  table_->scrollTo(index);
  const StoredReport::Light& at = report_->lights[static_cast<std::size_t>(light)];
  caption_->setText(
      tr("<b>Frame %1</b> &nbsp; %2 dB &nbsp; SSIM %3 &nbsp; error %4 % &nbsp; nearest captured "
         "light %5\u00b0 away%6")
          .arg(at.id)
          .arg(shown(at.psnr, 2), shown(at.ssim, 4), shown(100 * at.relative, 2),
               shown(at.nearest, 1), at.insideHull ? QString() : tr(", outside")));
  int worst = 0;
  int best = 0;
  for (int i = 0; i < static_cast<int>(report_->lights.size()); ++i) {
    const auto psnr = [&](int k) { return report_->lights[static_cast<std::size_t>(k)].psnr; };
    if (psnr(i) < psnr(worst)) worst = i;
    if (psnr(i) > psnr(best)) best = i;
  }
  worse_->setEnabled(light != worst);
  better_->setEnabled(light != best);
  draw();
}

void ValidatePage::step(int worseBy) {
  if (light_ < 0) return;
  // By PSNR, whatever the table is sorted by.
  std::vector<int> order(report_->lights.size());
  for (int i = 0; i < static_cast<int>(order.size()); ++i) order[static_cast<std::size_t>(i)] = i;
  std::ranges::stable_sort(
      order, {}, [&](int i) { return report_->lights[static_cast<std::size_t>(i)].psnr; });
  const auto at = std::ranges::find(order, light_) - order.begin();
  const auto next = std::clamp<std::ptrdiff_t>(at - worseBy, 0, std::ssize(order) - 1);
  select(order[static_cast<std::size_t>(next)]);
}

// Truth, relit and difference of the selected light, on the worker.
void ValidatePage::draw() {
  if (light_ < 0) return;
  if (!sources_) {
    if (!problem_.isEmpty()) {
      pictures_->setPictures({}, {}, {});
      pictures_->setPlaceholder(
          tr("The figures are there, the pictures are not: %1. %2")
              .arg(problem_, tr("The report in the browser still shows its nine.")));
    }
    return;
  }
  const int id = report_->lights[static_cast<std::size_t>(light_)].id;
  worker_->ask("pictures",
               [this, id, sources = sources_,
                exposure = report_->pictureExposure](const std::stop_token&) -> Worker::Show {
                 const auto triple = heldOutPictures(sources->sketch, sources->model,
                                                     sources->interpolator, id, exposure);
                 if (!triple) {
                   return [this, text = QString::fromStdString(triple.error().message)] {
                     pictures_->setPictures({}, {}, {});
                     pictures_->setPlaceholder(text);
                   };
                 }
                 return [this, truth = toQImage(triple->truth), relit = toQImage(triple->relit),
                         difference = toQImage(triple->difference)] {
                   pictures_->setCaptions(tr("captured"), tr("by the model"),
                                          tr("difference \u00d7 %1").arg(kDifferenceGain));
                   pictures_->setPictures(truth, relit, difference);
                 };
               });
}

void ValidatePage::exportFigures(const std::filesystem::path& csv) {
  const auto from = report_->folder / "lights.csv";
  workspace().run(tr("Export figures"),
                  [from, csv](Progress&, std::stop_token) -> Result<JobResult> {
                    ASSIGN_OR_RETURN(const std::string table, readFile(from));
                    RETURN_IF_ERROR(writeFileAtomically(csv, table));
                    return JobResult{csv.string(), {}};
                  });
}

void ValidatePage::exportDirections(const std::filesystem::path& lp) {
  const std::filesystem::path folder = report_->figures.value("sketch", std::string());
  workspace().run(
      tr("Export directions"), [folder, lp](Progress&, std::stop_token) -> Result<JobResult> {
        ASSIGN_OR_RETURN(const auto sketch, Sketch::open(folder));
        std::vector<NamedDirection> entries;
        for (const int id : sketch.activeFrames()) {
          const FrameRecord& frame = sketch.frames()[static_cast<std::size_t>(id)];
          entries.push_back(
              {frame.origin.empty() ? frame.file : frame.origin, frame.light.direction});
        }
        RETURN_IF_ERROR(writeFileAtomically(lp, formatLp(entries)));
        return JobResult{lp.string(), {}};
      });
}

void ValidatePage::exportPictures(const std::filesystem::path& folder) {
  ExportJob job;
  job.sketch = report_->figures.value("sketch", std::string());
  job.out = folder;
  workspace().run(tr("Export pictures"),
                  [job](Progress& progress, std::stop_token) { return exportJob(job, progress); });
}

}  // namespace lightsketch
