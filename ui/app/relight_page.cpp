#include "ui/app/relight_page.h"

#include <QAction>
#include <QButtonGroup>
#include <QDragEnterEvent>
#include <QFileDialog>
#include <QFileInfo>
#include <QGuiApplication>
#include <QHBoxLayout>
#include <QLabel>
#include <QMenu>
#include <QMimeData>
#include <QPushButton>
#include <QScreen>
#include <QStackedWidget>
#include <QTimer>
#include <QToolButton>
#include <QVBoxLayout>
#include <algorithm>
#include <cmath>

#include "ui/app/relight_environment_panel.h"
#include "ui/app/relight_lamps_panel.h"
#include "ui/app/relight_path_panel.h"
#include "ui/app/relight_room_panel.h"

namespace lightsketch {
namespace {

constexpr int kColumnWidth = 316;
constexpr int kStop = 10;  // steps of the exposure slider to a factor of two
constexpr int kMostStops = 10;
constexpr double kFilmRate = 30;
constexpr auto kTone = "relight/tone";

// The one dropped file, if it is something to light with.
QString lightFileOf(const QMimeData& data) {
  static const QStringList kSuffixes{"exr", "hdr", "json"};
  if (data.urls().size() != 1 || !data.urls().front().isLocalFile()) return {};
  const QString file = data.urls().front().toLocalFile();
  return kSuffixes.contains(QFileInfo(file).suffix().toLower()) ? file : QString();
}

}  // namespace

RelightPage::RelightPage(Workspace& workspace, QWidget* parent) : Page(workspace, parent) {
  setAcceptDrops(true);
  auto* across = new QHBoxLayout(this);
  across->setContentsMargins(0, 0, 0, 0);
  across->setSpacing(0);
  view_ = new RelightView;
  view_->setObjectName("relightView");
  view_->setPlaceholder(
      tr("Open a model (Ctrl+O), drop one here, or develop a sketch.\n\nThen drag on the picture: "
         "the lamp goes with the pointer."));
  across->addWidget(view_, 1);
  column_ = new QWidget;
  column_->setFixedWidth(kColumnWidth);
  across->addWidget(column_);
  buildColumn();
  buildActions();
  connectView(*view_);

  motion_ = new QTimer(this);
  motion_->setTimerType(Qt::PreciseTimer);
  connect(motion_, &QTimer::timeout, this, [this] {
    const double seconds = static_cast<double>(sinceStep_.restart()) / 1000;
    panel().advance(std::min(seconds, 0.1));
  });
  auto* slow = new QTimer(this);
  connect(slow, &QTimer::timeout, this, &RelightPage::tell);
  slow->start(250);

  connect(&workspace, &Workspace::modelChanged, this, [this] {
    if (visible_) load();
  });
  connect(&workspace, &Workspace::sketchChanged, this, &RelightPage::listPhotographs);
  Statistics& statistics = workspace.statistics();
  statistics.expectAtMost("light's change to pixels, ms", 33, Statistics::Of::kP95);
  statistics.expectAtMost("relit picture to the next, ms", 1000 / 60.0, Statistics::Of::kMedian);
  setLight(Light::kLamps);
  showExposure();
}

RelightPage::~RelightPage() { delete fullScreen_; }

QString RelightPage::purpose() const {
  return tr("Light the developed picture with lamps, surroundings or the room itself");
}

void RelightPage::buildColumn() {
  auto* column = new QVBoxLayout(column_);
  column->setContentsMargins(12, 10, 12, 8);
  column->setSpacing(5);

  // What lights the picture.
  kinds_ = new QButtonGroup(this);
  auto* row = new QHBoxLayout;
  row->setSpacing(2);
  const std::pair<QString, QString> kinds[] = {
      {tr("Lamps"), tr("Lamps that you drag (F5)")},
      {tr("Surroundings"),
       tr("A photographed or painted world around the object, turned by dragging "
          "the picture (F6)")},
      {tr("Room"), tr("This very room, as the source camera sees it now (F7)")},
      {tr("Path"), tr("The lamp as it was moved (F8)")}};
  for (int i = 0; i < 4; ++i) {
    auto* button = new QToolButton;
    button->setText(kinds[i].first);
    button->setToolTip(kinds[i].second);
    button->setSizePolicy(QSizePolicy::Expanding, QSizePolicy::Fixed);
    makeChoice(button);
    kinds_->addButton(button, i);
    row->addWidget(button);
  }
  column->addLayout(row);
  column->addSpacing(4);
  stack_ = new QStackedWidget;
  panels_ = {lamps_ = new LampsPanel(workspace()),
             surroundings_ = new EnvironmentPanel(workspace()), room_ = new RoomPanel(workspace()),
             path_ = new PathPanel(workspace())};
  for (RelightPanel* panel : panels_) {
    stack_->addWidget(panel);
    connect(panel, &RelightPanel::changed, this, [this, panel] {
      if (panel != &this->panel()) return;
      watchMotion();
      lightChanged();
    });
    connect(panel, &RelightPanel::renewed, this, [this, panel] {
      if (panel != &this->panel()) return;
      exposureDue_ = true;
      lightChanged();
    });
  }
  column->addWidget(stack_, 1);
  connect(kinds_, &QButtonGroup::idToggled, this, [this](int kind, bool on) {
    if (!on) return panels_[static_cast<std::size_t>(kind)]->left();
    stack_->setCurrentIndex(kind);
    if (visible_) panel().entered();
    exposureDue_ = true;
    watchMotion();
    lightChanged();
  });

  // How it is shown.
  auto* line = new QFrame;
  line->setFrameShape(QFrame::HLine);
  line->setForegroundRole(QPalette::Mid);
  column->addWidget(line);
  auto* exposureRow = new QHBoxLayout;
  exposureText_ = new QLabel;
  auto* automatic = new QPushButton(tr("Auto"));
  automatic->setObjectName("autoExposure");
  automatic->setToolTip(tr("The brightest hundredth of the picture just below white (A)"));
  exposureRow->addWidget(exposureText_, 1);
  tone_ = new QComboBox;
  tone_->addItems({tr("Plain"), tr("Soft highlights")});
  tone_->setAccessibleName(tr("Tone"));
  tone_->setToolTip(
      tr("Plain: white is where it is, brighter things are white too (for measuring). "
         "Soft highlights: they fade into white as on film."));
  tone_->setCurrentIndex(workspace().settings().value(kTone).toInt());
  exposureRow->addWidget(tone_);
  exposureRow->addWidget(automatic);
  column->addLayout(exposureRow);
  exposure_ = new QSlider(Qt::Horizontal);
  exposure_->setRange(-kMostStops * kStop, kMostStops * kStop);
  exposure_->setAccessibleName(tr("Exposure"));
  exposure_->setToolTip(tr("Brighter or darker (+ and -); a stop doubles the light"));
  column->addWidget(exposure_);
  photographs_ = new QComboBox;
  photographs_->setObjectName("photographs");
  photographs_->setAccessibleName(tr("Photograph beside the picture"));
  photographs_->setToolTip(
      tr("Puts a photograph that the model has not seen beside the picture, lit "
         "by a lamp at the same place: how far can it be believed?"));
  photographs_->setSizeAdjustPolicy(QComboBox::AdjustToMinimumContentsLengthWithIcon);
  column->addWidget(photographs_);

  auto* buttons = new QHBoxLayout;
  auto* save = new QPushButton(tr("Save..."));
  save->setToolTip(
      tr("The picture as the screen shows it (.png), or its light as numbers (.exr) "
         "(Ctrl+S)"));
  film_ = new QPushButton(tr("Film..."));
  film_->setToolTip(
      tr("The moving light as numbered pictures: one round of the lamps, one turn of the "
         "surroundings, or the whole path"));
  auto* fill = new QToolButton;
  fill->setObjectName("fullScreen");
  fill->setText(tr("Full screen"));
  fill->setToolTip(tr("The picture alone (F11); Esc comes back"));
  fill->setPopupMode(QToolButton::MenuButtonPopup);
  fill->setSizePolicy(QSizePolicy::Expanding, QSizePolicy::Fixed);
  displays_ = new QMenu(fill);
  fill->setMenu(displays_);
  for (QWidget* button :
       {static_cast<QWidget*>(save), static_cast<QWidget*>(film_), static_cast<QWidget*>(fill)}) {
    buttons->addWidget(button);
  }
  column->addLayout(buttons);
  numbers_ = explained({});
  numbers_->setObjectName("numbers");
  numbers_->setMinimumHeight(3 * fontMetrics().lineSpacing());
  numbers_->setToolTip(
      tr("When this machine cannot draw all detail in time, the display leaves out "
         "the least of it while the light moves, and adds it when it rests."));
  column->addWidget(numbers_);

  connect(automatic, &QPushButton::clicked, this, &RelightPage::findExposure);
  connect(exposure_, &QSlider::valueChanged, this, &RelightPage::showExposure);
  connect(tone_, &QComboBox::currentIndexChanged, this, [this](int tone) {
    workspace().settings().setValue(kTone, tone);
    showExposure();
  });
  connect(photographs_, &QComboBox::activated, this,
          [this] { compareWith(photographs_->currentData().toInt()); });
  connect(save, &QPushButton::clicked, this, [this] { chooseWhereToSave(false); });
  connect(film_, &QPushButton::clicked, this, [this] { chooseWhereToSave(true); });
  connect(fill, &QToolButton::clicked, this, [this] { fillScreen(screen()); });
  connect(displays_, &QMenu::aboutToShow, this, &RelightPage::fillDisplays);
}

void RelightPage::buildActions() {
  const auto key = [this](const QKeySequence& keys, auto act) {
    auto* action = new QAction(this);
    action->setShortcut(keys);
    action->setShortcutContext(Qt::WidgetWithChildrenShortcut);
    connect(action, &QAction::triggered, this, act);
    addAction(action);
  };
  for (int i = 0; i < 4; ++i) {
    key(QKeySequence(Qt::Key_F5 + i), [this, i] { setLight(static_cast<Light>(i)); });
  }
  key(Qt::Key_Space, [this] { panel().setMoving(!panel().moving()); });
  key(Qt::Key_A, [this] { findExposure(); });
  key(Qt::Key_Plus, [this] { exposure_->setValue(exposure_->value() + 2); });
  key(Qt::Key_Minus, [this] { exposure_->setValue(exposure_->value() - 2); });
  key(Qt::Key_F11, [this] { fillScreen(fullScreen_ ? nullptr : screen()); });
  key(QKeySequence::Save, [this] { chooseWhereToSave(false); });
  key(Qt::Key_Insert, [this] {
    if (light() == Light::kLamps) lamps_->add();
  });
  key(Qt::Key_Delete, [this] {
    if (light() == Light::kLamps) lamps_->removeSelected();
  });
  key(Qt::Key_N, [this] {  // the next lamp
    const auto lamps = static_cast<int>(lamps_->lamps().size());
    if (light() == Light::kLamps && lamps > 0) lamps_->select((lamps_->selected() + 1) % lamps);
  });
}

void RelightPage::connectView(RelightView& view) {
  view.setPrepare([this] { prepareLight(); });
  connect(&view, &RelightView::dragged, this, [this](QPointF by) { panel().drag(by); });
  connect(&view, &RelightView::shown, this,
          [this](double interval, double latency, double drawing) {
            Statistics& statistics = workspace().statistics();
            if (interval > 0) statistics.add("relit picture to the next, ms", interval);
            statistics.add("light's change to pixels, ms", latency);
            statistics.add("relit picture drawn in, ms", drawing);
          });
}

void RelightPage::entered() {
  visible_ = true;
  panel().entered();
  if (workspace().model() != wanted_) load();
  watchMotion();
}

void RelightPage::left() {
  visible_ = false;
  panel().left();
  watchMotion();
}

void RelightPage::begin() { panel().setMoving(true); }

RelightPage::Light RelightPage::light() const { return static_cast<Light>(kinds_->checkedId()); }

void RelightPage::setLight(Light light) { kinds_->button(static_cast<int>(light))->click(); }

bool RelightPage::setLight(const QString& name) {
  const auto kind = QStringList{"lamp", "surroundings", "room", "path"}.indexOf(name);
  if (name == "three-lamps") {
    lamps_->setLamps(LampsPanel::threeLamps());
    setLight(Light::kLamps);
  } else if (kind >= 0) {
    setLight(static_cast<Light>(kind));
  }
  return kind >= 0 || name == "three-lamps";
}

void RelightPage::load() {
  wanted_ = workspace().model();
  if (wanted_.empty()) return use(nullptr);
  workspace().fetch(
      tr("Open %1").arg(toQString(wanted_.filename())), this,
      [file = wanted_] { return RelightScene::load(file); },
      [this, file = wanted_](std::shared_ptr<RelightScene> loaded) {
        if (file == wanted_) use(std::move(loaded));
      });
}

void RelightPage::use(std::shared_ptr<RelightScene> scene) {
  scene_ = std::move(scene);
  const bool one = scene_ && scene_->model->singleLamp;
  for (const int kind : {1, 2}) {
    kinds_->button(kind)->setEnabled(!one);
  }
  if (one && (light() == Light::kSurroundings || light() == Light::kRoom)) setLight(Light::kLamps);
  for (RelightView* view : {view_, fullScreen_.data()}) {
    if (view) view->setScene(scene_);
  }
  for (RelightPanel* panel : panels_) panel->setScene(scene_);
  compareWith(-1);
  listPhotographs();
  exposureDue_ = true;
  lightChanged();
  Q_EMIT sceneShown();
}

void RelightPage::listPhotographs() {
  photographs_->clear();
  photographs_->addItem(tr("No photograph beside it"), -1);
  photographs_->setEnabled(false);
  if (!scene_) return;
  sketch_ = scene_->model->sketch;
  if (!std::filesystem::exists(sketch_ / "sketch.json")) sketch_ = workspace().sketch();
  if (sketch_.empty()) return;
  using Names = std::vector<std::pair<int, QString>>;
  workspace().fetch(
      tr("List the photographs"), this,
      [folder = sketch_, model = scene_->model]() -> Result<Names> {
        Names names;
        ASSIGN_OR_RETURN(const auto sketch, Sketch::open(folder));
        // Another picture's sketch is no comparison.
        if (sketch.manifest().width != model->layout.width ||
            sketch.manifest().height != model->layout.height) {
          return names;
        }
        const bool heldOut = !model->heldOutIds.empty();
        for (const int id : heldOut ? model->heldOutIds : sketch.activeFrames()) {
          if (id < 0 || id >= static_cast<int>(sketch.frames().size())) continue;
          names.emplace_back(id, heldOut
                                     ? RelightPage::tr("Photograph %1, not in the model").arg(id)
                                     : RelightPage::tr("Photograph %1").arg(id));
        }
        return names;
      },
      [this, folder = sketch_](const Names& names) {
        if (folder != sketch_ || photographs_->count() > 1) return;
        for (const auto& [id, name] : names) photographs_->addItem(name, id);
        photographs_->setEnabled(photographs_->count() > 1);
      });
}

void RelightPage::compareWith(int frame) {
  if (frame < 0) {
    photograph_ = {};
    view_->setPhotograph({});
    return;
  }
  struct Read {
    RadianceImage picture;
    Eigen::Vector3d direction;
  };
  workspace().fetch(
      tr("Read photograph %1").arg(frame), this,
      [frame, folder = sketch_]() -> Result<Read> {
        Read read;
        ASSIGN_OR_RETURN(const auto sketch, Sketch::open(folder));
        ASSIGN_OR_RETURN(read.picture, sketch.readFrame(frame));
        const FrameRecord& record = sketch.frames()[static_cast<std::size_t>(frame)];
        read.direction = record.light.direction;
        for (std::size_t i = 0; i < read.picture.size(); ++i) {
          read.picture.data()[i] /= static_cast<float>(record.lampScale[i % 3]);
        }
        return read;
      },
      [this, frame](Read read) {
        photograph_ = std::move(read.picture);
        photographs_->setCurrentIndex(photographs_->findData(frame));
        setLight(Light::kLamps);
        lamps_->setMoving(false);
        lamps_->change(tr("Lamp of a photograph"), {{read.direction}});
        exposureDue_ = true;
        showExposure();
      });
}

void RelightPage::watchMotion() {
  const bool on = visible_ && panel().moving();
  if (on == motion_->isActive()) return;
  if (!on) return motion_->stop();
  sinceStep_.start();
  // As often as the display shows a picture, and 60 times a second at least.
  motion_->start(std::max(1, static_cast<int>(1000 / std::max(60.0, screen()->refreshRate()))));
}

void RelightPage::lightChanged() {
  dirty_ = true;
  // What the full screen covers need not be drawn.
  if (fullScreen_) fullScreen_->lightChanged();
  if (!fullScreen_ || fullScreen_->screen() != screen()) view_->lightChanged();
}

void RelightPage::prepareLight() {
  if (!scene_ || !dirty_) return;
  if (const auto light = panel().light()) {
    if (auto set = scene_->relighter.setLight(*light); !set) {
      workspace().say(
          {"relight/light", Workspace::Level::kError, QString::fromStdString(set.error().message)});
    }
    if (std::exchange(exposureDue_, false)) findExposure();
  }
  dirty_ = false;
}

float RelightPage::exposure() const {
  return static_cast<float>(std::exp2(static_cast<double>(exposure_->value()) / kStop));
}

void RelightPage::findExposure() {
  if (!scene_) return;
  const double stops = std::log2(autoExposure(scene_->relighter));
  exposure_->setValue(static_cast<int>(std::lround(stops * kStop)));
}

void RelightPage::showExposure() {
  const double stops = static_cast<double>(exposure_->value()) / kStop;
  exposureText_->setText(
      tr("Exposure %1%2").arg(stops < 0 ? "\u2212" : "+").arg(std::abs(stops), 0, 'f', 1));
  const auto tone = static_cast<Tone>(tone_->currentIndex());
  for (RelightView* view : {view_, fullScreen_.data()}) {
    if (view) view->setExposure(exposure(), tone);
  }
  if (!photograph_.empty()) {
    view_->setPhotograph(screenImage(photograph_, exposure(), tone),
                         photographs_->currentText().toLower());
  }
}

void RelightPage::tell() {
  film_->setEnabled(panel().film().has_value());
  if (!scene_) return numbers_->clear();
  const RelightView& view = fullScreen_ ? *fullScreen_ : *view_;
  const RelightStatistics now = view.statistics();
  workspace().statistics().set("relit with a share of the bases", now.share);
  const QString detail =
      now.share == 1 ? tr("all detail")
                     : tr("%1 % of the detail while the light moves").arg(qRound(100 * now.share));
  const QString size = tr("%1 \u00d7 %2, %3 lights")
                           .arg(scene_->width())
                           .arg(scene_->height())
                           .arg(scene_->model->lightCount());
  numbers_->setText(now.framesPerSecond < 5 ? tr("%1\nat rest, %2").arg(size, detail)
                                            : tr("%1\n%2 pictures a second, drawn in %3 ms, %4")
                                                  .arg(size)
                                                  .arg(qRound(now.framesPerSecond))
                                                  .arg(now.drawMilliseconds, 0, 'f', 1)
                                                  .arg(detail));
}

void RelightPage::fillDisplays() {
  displays_->clear();
  int number = 1;
  for (QScreen* display : QGuiApplication::screens()) {
    displays_->addAction(tr("Display %1: %2 (%3 \u00d7 %4)")
                             .arg(number++)
                             .arg(display->name())
                             .arg(display->size().width())
                             .arg(display->size().height()),
                         this, [this, display] { fillScreen(display); });
  }
}

void RelightPage::fillScreen(QScreen* screen) {
  delete fullScreen_;
  if (!screen) {
    view_->lightChanged();
    return;
  }
  fullScreen_ = new RelightView;
  fullScreen_->setWindowTitle(tr("Relit picture"));
  fullScreen_->setHidesPointer(true);
  fullScreen_->addActions(actions());
  connectView(*fullScreen_);
  connect(
      fullScreen_, &RelightView::leaveRequested, this, [this] { fillScreen(nullptr); },
      Qt::QueuedConnection);
  fullScreen_->setScene(scene_);
  fullScreen_->setExposure(exposure(), static_cast<Tone>(tone_->currentIndex()));
  fullScreen_->setGeometry(screen->geometry());
  fullScreen_->showFullScreen();
  fullScreen_->activateWindow();
}

void RelightPage::tellOfSaved(Task* task) {
  connect(task, &Task::finished, this, [this, task] {
    if (!task->result()) return;
    workspace().say({"relight/saved", Workspace::Level::kInfo,
                     tr("Saved %1").arg(QString::fromStdString(task->result()->text))});
  });
}

void RelightPage::savePicture(const std::filesystem::path& file) {
  const auto light = panel().light();
  if (!scene_ || !light) return;
  Task* task = workspace().run(
      tr("Save %1").arg(toQString(file.filename())),
      [model = scene_->model, light = *light, exposure = exposure(),
       tone = static_cast<Tone>(tone_->currentIndex()), file](Progress&, std::stop_token) {
        return savePictureJob(*model, light, exposure, tone, file);
      });
  tellOfSaved(task);
}

void RelightPage::saveFilm(const std::filesystem::path& folder, double framesPerSecond) {
  const auto film = panel().film();
  if (!scene_ || !film) return;
  const FilmJob job{
      scene_->model, *film, framesPerSecond, exposure(), static_cast<Tone>(tone_->currentIndex()),
      folder};
  Task* task = workspace().run(
      tr("Save %1").arg(toQString(folder.filename())),
      [job](Progress& progress, std::stop_token) { return filmJob(job, progress); });
  tellOfSaved(task);
}

void RelightPage::chooseWhereToSave(bool film) {
  if (!scene_) return;
  const QString stem = toQString(scene_->file.parent_path() / scene_->file.stem());
  if (film) {
    const QString folder = QFileDialog::getSaveFileName(
        this, tr("New folder for the film's pictures"), stem + tr("-film"));
    if (!folder.isEmpty()) saveFilm(toPath(folder), kFilmRate);
    return;
  }
  QString file =
      QFileDialog::getSaveFileName(this, tr("Save picture"), stem + ".png",
                                   tr("As the screen shows it (*.png);;Light as numbers (*.exr)"));
  if (file.isEmpty()) return;
  if (QFileInfo(file).suffix().isEmpty()) file += ".png";
  savePicture(toPath(file));
}

void RelightPage::dragEnterEvent(QDragEnterEvent* event) {
  if (!lightFileOf(*event->mimeData()).isEmpty()) {
    event->acceptProposedAction();
  } else {
    event->ignore();  // the window may know it
  }
}

void RelightPage::dropEvent(QDropEvent* event) {
  const QString file = lightFileOf(*event->mimeData());
  if (file.endsWith(".json", Qt::CaseInsensitive)) {
    setLight(Light::kPath);
    path_->open(toPath(file));
  } else {
    surroundings_->open(toPath(file));
    setLight(Light::kSurroundings);
  }
  event->acceptProposedAction();
}

}  // namespace lightsketch
