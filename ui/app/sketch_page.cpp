#include "ui/app/sketch_page.h"

#include <QApplication>
#include <QCheckBox>
#include <QHBoxLayout>
#include <QLabel>
#include <QPushButton>
#include <QScrollArea>
#include <QShortcut>
#include <QStackedWidget>
#include <QTimer>
#include <QToolButton>
#include <QUndoCommand>
#include <QVBoxLayout>
#include <algorithm>
#include <cmath>

#include "capture/frame/direction.h"
#include "pipeline/job/jobs.h"
#include "ui/app/controls.h"
#include "ui/app/frame_view.h"
#include "ui/app/sketch_edits.h"
#include "ui/app/sketch_options.h"
#include "ui/app/workspace.h"

namespace lightsketch {
namespace {

using Eigen::Vector3d;

constexpr int kTickMilliseconds = 200;
constexpr std::size_t kPathSteps = 120;    // on the hemisphere
constexpr double kRefusedToneSeconds = 1;  // between two
constexpr double kLampLostSeconds = 0.7;   // until it is said
constexpr double kReconnectSeconds = 1800;

enum Side { kOptionsSide, kTallySide, kLessonsSide };

class TakeBack final : public QUndoCommand {
 public:
  TakeBack(const QString& text, std::function<void()> undo)
      : QUndoCommand(text), undo_(std::move(undo)) {}
  void undo() override {
    undo_();
    setObsolete(true);  // what was taken back is shot again, not brought back
  }

 private:
  std::function<void()> undo_;
};

}  // namespace

SketchPage::SketchPage(Workspace& workspace, QWidget* parent)
    : Page(workspace, parent), dots_(overlay_) {
  auto* column = new QVBoxLayout(this);
  column->setContentsMargins(10, 8, 10, 8);
  column->setSpacing(6);
  prompt_ = new SketchPrompt;
  prompt_->setObjectName("prompt");
  column->addWidget(prompt_);
  column->addWidget(buildViews(), 1);
  column->addWidget(buildButtons());

  auto* space = new QShortcut(Qt::Key_Space, this);
  connect(space, &QShortcut::activated, this, &SketchPage::begin);
  // A box that is ticked with the same key has it.
  connect(qApp, &QApplication::focusChanged, space,
          [space](QWidget*, QWidget* now) { space->setEnabled(!qobject_cast<QCheckBox*>(now)); });
  auto* ticker = new QTimer(this);
  connect(ticker, &QTimer::timeout, this, &SketchPage::tick);
  ticker->start(kTickMilliseconds);

  connect(wishes_, &SketchOptions::wishChanged, this, [this] {
    outcome_.clear();
    replan();
  });
  connect(wishes_, &SketchOptions::goalChanged, this, &SketchPage::refreshPrompt);
  RigLink& rig = workspace.rig();
  connect(&rig, &RigLink::stateChanged, this, [this] {
    const RigLink::State now = this->workspace().rig().state();
    if (now == RigLink::State::kLive) {
      replan();  // a simulated rig brings its calibration
    } else if (now == RigLink::State::kFailed && phase_ == Phase::kWaitingForCameras) {
      phase_ = Phase::kIdle;
    }
    refreshControls();
    refreshPrompt();
  });
  connect(&rig, &RigLink::setupChanged, this, &SketchPage::replan);
  connect(&workspace, &Workspace::sketchChanged, this, [this] {
    if (phase_ == Phase::kIdle) wishes_->setFolder(this->workspace().sketch());
  });
  connect(&workspace, &Workspace::sketchEdited, this, &SketchPage::replan);
  connect(hemisphere_, &HemisphereView::regionSelected, this, &SketchPage::deleteRegion);
  connect(hemisphere_, &HemisphereView::drawn, this, &SketchPage::dotsDrawn);
  connect(scene_, &FrameView::drawn, this, [this] { ++sceneDrawn_; });
  connect(source_, &FrameView::drawn, this, [this] { ++sourceDrawn_; });

  // With cameras of 30 frames a second; where the interval begins and ends costs a frame or two.
  Statistics& statistics = workspace.statistics();
  statistics.expectAtMost("frames dropped by the program", 0);
  statistics.expectAtLeast("scene view, frames a second", 29.5);
  statistics.expectAtLeast("source view, frames a second", 29.5);
  statistics.expectAtMost("frame's arrival to its dot, ms", 50, Statistics::Of::kP95);
  statistics.expectAtMost("UI thread blocked, ms", 50);
  replan();
  refreshControls();
  refreshPrompt();
}

SketchPage::~SketchPage() {
  if (session_) session_->close();
}

QString SketchPage::purpose() const {
  return tr("Wave the lamp around the subject; every new light direction becomes a frame");
}

QWidget* SketchPage::buildViews() {
  auto* views = new QWidget;
  auto* row = new QHBoxLayout(views);
  row->setContentsMargins(0, 0, 0, 0);
  row->setSpacing(10);
  RigLink& rig = workspace().rig();
  source_ = new FrameView(rig.sourceView());
  source_->setObjectName("sourceView");
  source_->setToolTip(
      tr("The source camera, as in a looking glass. Blue: the field that is calibrated. The lamp's "
         "uncertainty is drawn fifty times enlarged."));
  source_->setOverlay([this](QPainter& painter, const QTransform& widgetFromFrame) {
    overlay_.paint(painter, widgetFromFrame);
  });
  hemisphere_ = new HemisphereView;
  hemisphere_->setObjectName("hemisphere");
  hemisphere_->setAccessibleName(tr("Light directions, as seen standing before the subject"));
  hemisphere_->setToolTip(tr(
      "Wanted directions. Frames in a dragged circle are deleted, to be shot again (Ctrl+Z brings "
      "them back). With keys: arrows move a circle, + and - size it, Delete takes it."));
  hemisphere_->setSelectsRegions(true);
  dots_.setHemisphere(hemisphere_);
  const auto stack = [&](QWidget* view, QLabel* below, int stretch) {
    auto* column = new QVBoxLayout;
    column->setSpacing(3);
    column->addWidget(view, 1);
    column->addWidget(below);
    row->addLayout(column, stretch);
  };
  const auto spot = [](SketchDot dot, const QString& sign) {
    return QString("<span style='color:%1'>%2</span>").arg(colourOf(dot).name(), sign);
  };
  stack(source_,
        explained(tr("%1 captured  %2 to do  %3 refused  %4 the lamp's way")
                      .arg(spot(SketchDot::kCaptured, "\u25cf"), spot(SketchDot::kOpen, "\u25cb"),
                           spot(SketchDot::kRefused, "\u2715"),
                           "<span style='color:#ffa826'>\u2014</span>")),
        5);
  stack(hemisphere_,
        explained(tr("Seen from the camera. Drag a circle to delete and shoot again.")), 5);
  row->addWidget(buildSide(), 3);
  return views;
}

QWidget* SketchPage::buildSide() {
  auto* side = new QWidget;
  side->setMinimumWidth(250);
  auto* column = new QVBoxLayout(side);
  column->setContentsMargins(0, 0, 0, 0);
  column->setSpacing(8);
  scene_ = new FrameView(workspace().rig().sceneView());
  scene_->setObjectName("sceneView");
  scene_->setToolTip(tr("The scene camera: what is recorded"));
  column->addWidget(scene_, 3);

  side_ = new QStackedWidget;
  wishes_ = new SketchOptions(workspace());
  wishes_->setObjectName("options");
  side_->insertWidget(kOptionsSide, wishes_);
  tally_ = new QLabel;
  tally_->setObjectName("tally");
  tally_->setWordWrap(true);
  tally_->setAlignment(Qt::AlignTop);
  side_->insertWidget(kTallySide, tally_);
  lessons_ = new QLabel;
  lessons_->setObjectName("lessons");
  lessons_->setWordWrap(true);
  lessons_->setAlignment(Qt::AlignTop);
  lessons_->setTextInteractionFlags(Qt::TextSelectableByMouse);
  auto* scroll = new QScrollArea;
  scroll->setFrameShape(QFrame::NoFrame);
  scroll->setWidgetResizable(true);
  scroll->setWidget(lessons_);
  side_->insertWidget(kLessonsSide, scroll);
  column->addWidget(side_, 4);
  return side;
}

QWidget* SketchPage::buildButtons() {
  auto* bar = new QWidget;
  auto* row = new QHBoxLayout(bar);
  row->setContentsMargins(0, 0, 0, 0);
  const auto button = [&](const QString& name, const QString& text, const QString& tip,
                          auto pressed) {
    auto* made = new QPushButton(text);
    made->setObjectName(name);
    made->setToolTip(tip);
    made->setMinimumHeight(36);
    made->setFocusPolicy(Qt::TabFocus);
    connect(made, &QPushButton::clicked, this, pressed);
    row->addWidget(made);
    return made;
  };
  record_ = button("record", tr("&Record"), {}, &SketchPage::begin);
  record_->setMinimumWidth(150);
  enlarge(record_, 1, true);
  pause_ = button("pause", tr("&Pause"),
                  tr("Frames are let go until you go on; the cameras keep running (Space)"),
                  &SketchPage::togglePause);
  stop_ =
      button("stop", tr("&Stop"), tr("End the recording; all kept frames stay"), &SketchPage::stop);
  auto* undo = new QToolButton;
  undo->setObjectName("undo");
  undo->setMinimumHeight(36);
  QAction* action = workspace().undo().createUndoAction(undo, tr("Undo"));
  action->setToolTip(tr("Takes the last frame or deletion back, one after another (Ctrl+Z)"));
  undo->setDefaultAction(action);
  row->addWidget(undo);
  mute_ = new QToolButton;
  mute_->setObjectName("mute");
  mute_->setCheckable(true);
  mute_->setMinimumHeight(36);
  mute_->setText(tr("Mute"));
  mute_->setToolTip(
      tr("No tones. High: a frame was kept. Low: refused. Falling: the lamp is not seen (Ctrl+M)"));
  mute_->setShortcut(QKeySequence("Ctrl+M"));
  mute_->setChecked(workspace().settings().value("sketch/muted", false).toBool());
  sounds_.setMuted(mute_->isChecked());
  connect(mute_, &QToolButton::toggled, this, [this](bool on) {
    sounds_.setMuted(on);
    workspace().settings().setValue("sketch/muted", on);
  });
  row->addWidget(mute_);
  row->addStretch(1);
  new_ = button("newSketch", tr("&New sketch"), tr("Record to a new folder"), [this] {
    wishes_->setNewFolder();
    side_->setCurrentIndex(kOptionsSide);
  });
  develop_ = button("developSketch", tr("De&velop"),
                    tr("Make a picture of the sketch that any light can be thrown on"), [this] {
                      if (workspace().sketch() != wishes_->folder()) {
                        workspace().setSketch(wishes_->folder());
                      }
                      workspace().show("develop");
                    });
  develop_->setMinimumWidth(110);
  return bar;
}

void SketchPage::entered() {
  workspace().rig().watch(true);
  if (phase_ == Phase::kIdle) replan();
}

void SketchPage::left() { workspace().rig().watch(false); }

// --- What is wanted and what is there -----------------------------------------------------------

void SketchPage::replan() {
  if (phase_ != Phase::kIdle && phase_ != Phase::kWaitingForCameras) return;
  planAgain_ = planning_;
  if (planning_) return;
  planning_ = true;
  SketchWish wish = wishes_->wish();
  wish.sourceModel = workspace().rig().sourceModel();
  wish.rigGeometry = workspace().rig().rigGeometry();
  // Not through the workspace: it is over before anybody could read its name.
  auto plan = std::make_shared<Result<SketchPlan>>();
  auto* task = new Task(
      {},
      [wish, plan](Progress&, std::stop_token) -> Result<JobResult> {
        *plan = planSketch(wish);
        return JobResult{};
      },
      this);
  connect(task, &Task::finished, this, [this, task, wish, plan] {
    task->deleteLater();
    planning_ = false;
    // Of what is wished for no more, nothing is shown.
    planAgain_ ? replan() : takePlan(wish, *plan);
  });
}

void SketchPage::takePlan(const SketchWish& wish, const Result<SketchPlan>& plan) {
  if (phase_ != Phase::kIdle && phase_ != Phase::kWaitingForCameras) return;
  planTrouble_.clear();
  if (!plan) {
    phase_ = Phase::kIdle;
    planTrouble_ = QString::fromStdString(plan.error().message);
    wishes_->showTrouble(planTrouble_);
    refreshControls();
    refreshPrompt();
    return;
  }
  // A set that was imported cannot be gone on with.
  if (!plan->exists && wish.folder == workspace().sketch()) {
    if (wish.folder == wishes_->folder()) wishes_->setNewFolder();
    return;
  }
  plan_ = *plan;
  wishes_->showPlan(plan_);
  source_->setFlipped(plan_.flipLeftRight, plan_.flipUpsideDown);
  hemisphere_->setArrow({}, {});
  hemisphere_->setPath({}, {});
  dots_.setPlan(plan_);
  source_->update();
  if (phase_ == Phase::kWaitingForCameras && workspace().rig().state() == RigLink::State::kLive) {
    return record();
  }
  refreshControls();
  refreshPrompt();
}

// --- Recording ----------------------------------------------------------------------------------

void SketchPage::begin() {
  if (phase_ == Phase::kRecording) return togglePause();
  if (phase_ != Phase::kIdle) return;
  RigLink& rig = workspace().rig();
  const bool live = rig.state() == RigLink::State::kLive;
  if (live && !planning_) return record();
  phase_ = Phase::kWaitingForCameras;
  if (!live) rig.reopen();
  refreshControls();
  refreshPrompt();
}

void SketchPage::record() {
  RigLink& rig = workspace().rig();
  now_.job = rig.recordJob();
  wishes_->fill(now_.job);
  if (plan_.exists && plan_.capturedCount >= wishes_->coverageGoal() * plan_.grid->size()) {
    now_.job.recorder.coverageGoal = 1;  // whoever goes on all the same wants the rest
  }
  now_.job.reconnectSeconds = kReconnectSeconds;
  session_ = std::make_shared<SketchSession>(
      [this] { QMetaObject::invokeMethod(this, &SketchPage::look, Qt::QueuedConnection); });
  now_.job.control = &session_->control();

  phase_ = Phase::kRecording;
  now_.state = {};
  now_.state.coverage =
      plan_.exists ? static_cast<double>(plan_.capturedCount) / plan_.grid->size() : 0;
  now_.pace = {};
  outcome_.clear();
  now_.begun = Clock::now();
  now_.ambientSince.reset();
  unseenSince_.reset();
  captured_.reset();
  path_.clear();
  kept_.clear();
  for (const auto& [id, light] : plan_.frames) kept_.push_back({light});
  waitingDots_.clear();
  measuredFrom_.reset();
  workspace().undo().clear();

  rig.lend();
  task_ = workspace().run(
      toQString(now_.job.sketch.filename()),
      [job = now_.job, session = session_](Progress& progress, std::stop_token stop) {
        return recordJob(job, progress, std::move(stop),
                         [&](const RecorderState& state) { session->put(state); });
      });
  connect(task_, &Task::finished, this, [this, task = task_.data()] { ended(task->result()); });
  tally_->clear();
  side_->setCurrentIndex(kTallySide);
  refreshControls();
  refreshPrompt();
}

void SketchPage::togglePause() {
  if (phase_ != Phase::kRecording) return;
  session_->control().pause(!now_.state.paused);
}

void SketchPage::stop() {
  if (phase_ == Phase::kWaitingForCameras) phase_ = Phase::kIdle;
  if (phase_ == Phase::kRecording) {
    phase_ = Phase::kEnding;
    task_->cancel();
  }
  refreshControls();
  refreshPrompt();
}

// What came from the recorder since the last time.
void SketchPage::look() {
  if (!session_ || (phase_ != Phase::kRecording && phase_ != Phase::kEnding)) return;
  auto news = session_->take();
  if (!news) return;
  const bool wasPaused = now_.state.paused;
  now_.state = std::move(news->state);
  if (now_.state.captured && now_.state.captured != captured_) {
    captured_ = now_.state.captured;
    dots_.setCaptured(*captured_);
  }
  for (const JudgedFrame& judged : news->judged) follow(judged);
  followCameras();

  overlay_.addLamp(now_.state.lampCamera == 0 ? now_.state.lamp : std::nullopt);
  if (now_.state.lampDirection) {
    if (path_.empty() || path_.back() != *now_.state.lampDirection) {
      path_.push_back(*now_.state.lampDirection);
    }
    while (path_.size() > kPathSteps) path_.pop_front();
  }
  std::optional<int> target;
  if (now_.state.nextDirection) target = plan_.grid->nearest(*now_.state.nextDirection);
  overlay_.setTarget(target);
  hemisphere_->setPath({path_.begin(), path_.end()}, palette().color(QPalette::Highlight));
  hemisphere_->setArrow(now_.state.lampDirection, now_.state.nextDirection);
  if (now_.state.paused != wasPaused) refreshControls();
  refreshPrompt();
}

void SketchPage::follow(const JudgedFrame& judged) {
  if (!measuredFrom_) {
    measuredFrom_ = Clock::now();
    sceneDrawn_ = sourceDrawn_ = 0;
  }
  now_.pace.add(judged);
  const bool kept = judged.refusal == Refusal::kNone;
  if (kept) {
    sounds_.play(Sounds::Tone::kCaptured);
    const std::size_t index = kept_.size();
    kept_.push_back({judged.direction.value_or(Vector3d::UnitZ())});
    pushUndo(tr("last frame"), [this, index] { kept_[index].there = false; });
    if (isVisible()) waitingDots_.push_back(judged.arrival);
    return;
  }
  const RefusalWords words = wordsFor(judged.refusal);
  if (words.shout.isEmpty()) return;
  if (toSeconds(judged.decided - spoke_) > kRefusedToneSeconds &&
      now_.pace.trouble(judged.decided)) {
    spoke_ = judged.decided;
    sounds_.play(Sounds::Tone::kRefused);
  }
  if (!judged.direction) return;
  if (dots_.refuse(plan_.grid->nearest(*judged.direction), judged.decided) && isVisible()) {
    waitingDots_.push_back(judged.arrival);
  }
}

// A camera that was lost, and a lamp.
void SketchPage::followCameras() {
  if (!now_.state.waitingFor.empty()) {
    QString text = QString::fromStdString(now_.state.waitingFor);
    text[0] = text[0].toUpper();
    cameraLost_ = true;
    // In the place of the task's own warning.
    workspace().say({"warning/" + task_->title(), Workspace::Level::kWarning,
                     tr("%1. All %2 frames are kept; the recording goes on as soon as it is back.")
                         .arg(text)
                         .arg(now_.state.recorded),
                     tr("Stop recording"), [this] { stop(); }});
    now_.ambientSince.reset();
    return;
  }
  if (std::exchange(cameraLost_, false)) workspace().withdraw("warning/" + task_->title());
  if (now_.state.lampWantedOff && !now_.ambientSince) now_.ambientSince = Clock::now();
  if (!now_.state.lampWantedOff) now_.ambientSince.reset();
  const TimePoint now = Clock::now();
  if (now_.state.lampDirection || now_.state.lampWantedOff || now_.state.paused) {
    unseenSince_ = now + fromSeconds(kLampLostSeconds);
  } else if (unseenSince_ && now > *unseenSince_) {
    unseenSince_.reset();
    sounds_.play(Sounds::Tone::kLampLost);
  }
}

// Things that end by time.
void SketchPage::tick() {
  dots_.expire(Clock::now());
  if (phase_ != Phase::kRecording) return;
  refreshPrompt();
  measure();
  QString text = tr("<b>%1</b><br>%2 frames kept")
                     .arg(toQString(now_.job.sketch.filename()))
                     .arg(now_.state.recorded);
  for (const auto& [refusal, count] : now_.state.refusals) {
    if (!wordsFor(refusal).shout.isEmpty()) {
      text += QString("<br>%1: %2").arg(wordsFor(refusal).name).arg(count);
    }
  }
  tally_->setText(text);
}

void SketchPage::ended(const Result<JobResult>& result) {
  look();
  measure();
  if (std::exchange(cameraLost_, false)) workspace().withdraw("warning/" + task_->title());
  workspace().rig().giveBack();
  phase_ = Phase::kIdle;
  hemisphere_->setArrow({}, {});
  overlay_.setTarget({});
  session_->close();
  if (!result) {
    outcome_.clear();
    side_->setCurrentIndex(kOptionsSide);
    if (std::filesystem::exists(now_.job.sketch / "sketch.json"))
      workspace().setSketch(now_.job.sketch);
    replan();
    refreshControls();
    return refreshPrompt();
  }
  const Json& figures = result->figures;
  const double coverage = figures.value("coverage", 0.0);
  const bool done = coverage >= now_.job.recorder.coverageGoal - 1e-9;
  if (done) sounds_.play(Sounds::Tone::kDone);
  workspace().setSketch(now_.job.sketch);  // empties the undo stack: it was the recorder's
  outcome_ = done ? tr("Done") : tr("Stopped");
  outcomeDetail_ = tr("%1 frames recorded. Develop makes the picture; Space goes on recording.")
                       .arg(figures.value("recorded", 0));
  teach();
  side_->setCurrentIndex(kLessonsSide);
  workspace().say({"recorded", Workspace::Level::kInfo,
                   tr("%1: %2 % of the directions are there.")
                       .arg(toQString(now_.job.sketch.filename()))
                       .arg(100 * coverage, 0, 'f', 1),
                   tr("Develop"), [this] { workspace().show("develop"); }});
  refreshControls();
  refreshPrompt();
}

// What was refused and how to do better, the most frequent first.
void SketchPage::teach() {
  std::vector<std::pair<int, Refusal>> counts;
  for (const auto& [refusal, count] : now_.state.refusals) counts.emplace_back(count, refusal);
  std::sort(counts.rbegin(), counts.rend());
  QString text;
  for (const auto& [count, refusal] : counts) {
    const RefusalWords words = wordsFor(refusal);
    if (words.shout.isEmpty() || count == 0) continue;
    text += tr("<p><b>%1: %2.</b> %3</p>").arg(words.name).arg(count).arg(words.lesson);
  }
  lessons_->setText(text.isEmpty()
                        ? tr("<p><b>Nothing was refused.</b> Well held.</p>")
                        : tr("<p>Refused frames, and what to do about them:</p>") + text);
}

void SketchPage::pushUndo(const QString& text, std::function<void()> undo) {
  workspace().undo().push(new TakeBack(text, [session = session_, undo = std::move(undo)] {
    session->control().undo();
    undo();
  }));
}

void SketchPage::deleteRegion(const Vector3d& centre, double radius) {
  if (phase_ != Phase::kRecording) {
    if (phase_ != Phase::kIdle || !plan_.exists) return;
    dropFrames(workspace(), wishes_->folder(), plan_.framesWithin(centre, radius),
               "to be shot again", tr("deleted region"));
    return;
  }
  std::vector<std::size_t> within;
  for (std::size_t i = 0; i < kept_.size(); ++i) {
    if (kept_[i].there && angleBetween(kept_[i].direction, centre).radians() <= radius) {
      within.push_back(i);
    }
  }
  if (within.empty()) return;
  for (const std::size_t i : within) kept_[i].there = false;
  session_->control().dropRegion(centre, Angle::radians(radius), "to be shot again");
  pushUndo(tr("deleted region"), [this, within] {
    for (const std::size_t i : within) kept_[i].there = true;
  });
}

// --- What is said -------------------------------------------------------------------------------

void SketchPage::refreshControls() {
  const bool idle = phase_ == Phase::kIdle;
  const bool recording = phase_ == Phase::kRecording;
  record_->setText(plan_.exists ? tr("Go on &recording") : tr("&Record"));
  record_->setToolTip(tr("Begins with the lamp off, then follow the arrow (Space)"));
  record_->setVisible(!recording && phase_ != Phase::kEnding);
  record_->setEnabled(idle && planTrouble_.isEmpty());
  pause_->setVisible(recording);
  pause_->setText(now_.state.paused ? tr("Go &on") : tr("&Pause"));
  stop_->setVisible(!idle);
  stop_->setEnabled(phase_ != Phase::kEnding);
  new_->setVisible(idle && plan_.exists);
  develop_->setVisible(idle && plan_.exists);
  if (idle && outcome_.isEmpty()) side_->setCurrentIndex(kOptionsSide);
  const RigLink& rig = workspace().rig();
  const QString placeholder = rig.state() == RigLink::State::kFailed ? rig.trouble()
                              : idle && rig.state() == RigLink::State::kClosed
                                  ? tr("No picture yet")
                                  : tr("The cameras are being opened");
  source_->setPlaceholder(placeholder);
  scene_->setPlaceholder(placeholder);
}

void SketchPage::refreshPrompt() {
  prompt_->setContent(phase_ == Phase::kRecording ? now_.prompt(plan_.grid->size(), *hemisphere_)
                                                  : idlePrompt());
}

SketchPrompt::Content SketchPage::idlePrompt() const {
  SketchPrompt::Content content;
  content.goal = wishes_->coverageGoal();
  if (plan_.grid && plan_.exists) {
    content.coverage = static_cast<double>(plan_.capturedCount) / plan_.grid->size();
  }
  const RigLink& rig = workspace().rig();
  if (phase_ == Phase::kEnding) {
    content.coverage = now_.state.coverage;
    content.word = tr("One moment");
    content.detail = tr("The last frames are written.");
  } else if (!outcome_.isEmpty() && phase_ == Phase::kIdle) {
    content.word = outcome_;
    content.detail = outcomeDetail_;
    content.mood = SketchPrompt::Mood::kGood;
  } else if (phase_ == Phase::kWaitingForCameras || rig.state() == RigLink::State::kOpening) {
    content.word = tr("One moment");
    content.detail = tr("The cameras are being opened.");
  } else if (rig.state() == RigLink::State::kFailed) {
    content.word = tr("No camera");
    content.detail = rig.trouble();
    content.mood = SketchPrompt::Mood::kTrouble;
  } else if (!planTrouble_.isEmpty()) {
    content.word = tr("Not here");
    content.detail = planTrouble_;
    content.mood = SketchPrompt::Mood::kTrouble;
  } else {
    content.word = tr("Ready");
    content.detail =
        plan_.exists
            ? tr("Space goes on with this sketch.")
            : tr("Take the lamp, stand beside the camera, press Space. Lamp off for the first two "
                 "seconds.");
  }
  return content;
}

// --- Statistics ---------------------------------------------------------------------------------

void SketchPage::dotsDrawn() {
  const TimePoint now = Clock::now();
  for (const TimePoint arrival : waitingDots_) {
    workspace().statistics().add("frame's arrival to its dot, ms", 1e3 * toSeconds(now - arrival));
  }
  waitingDots_.clear();
}

void SketchPage::measure() {
  if (!measuredFrom_) return;
  Statistics& statistics = workspace().statistics();
  const double seconds = toSeconds(Clock::now() - *measuredFrom_);
  std::uint64_t dropped = now_.state.droppedByQueues + now_.state.scene.underruns;
  for (const StreamStatistics& source : now_.state.sources) dropped += source.underruns;
  statistics.set("frames dropped by the program", static_cast<double>(dropped));
  statistics.set("scene view, frames a second", sceneDrawn_ / seconds);
  statistics.set("source view, frames a second", sourceDrawn_ / seconds);
  statistics.set("kept a second (busiest 5 s)", now_.pace.mostKeptPerSecond());
}

}  // namespace lightsketch
