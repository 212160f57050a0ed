// Painting the hemisphere with light, guided live.
#pragma once

#include <QPointer>
#include <deque>
#include <memory>
#include <optional>
#include <vector>

#include "ui/app/hemisphere_view.h"
#include "ui/app/page.h"
#include "ui/app/sketch_dots.h"
#include "ui/app/sketch_overlay.h"
#include "ui/app/sketch_plan.h"
#include "ui/app/sketch_progress.h"
#include "ui/app/sketch_session.h"
#include "ui/app/sounds.h"
#include "ui/app/task.h"

class QLabel;
class QPushButton;
class QStackedWidget;
class QToolButton;

namespace lightsketch {

class FrameView;
class SketchOptions;

class SketchPage final : public Page {
  Q_OBJECT
 public:
  explicit SketchPage(Workspace& workspace, QWidget* parent = nullptr);
  ~SketchPage() override;
  QString title() const override { return tr("Sketch"); }
  QString purpose() const override;
  void entered() override;
  void left() override;
  // Records, or goes on with what is paused.
  void begin() override;

 private:
  enum class Phase { kIdle, kWaitingForCameras, kRecording, kEnding };
  // A frame of the sketch that is being recorded.
  struct Kept {
    Eigen::Vector3d direction;
    bool there = true;  // else taken back or deleted
  };

  QWidget* buildViews();
  QWidget* buildSide();
  QWidget* buildButtons();

  // What the sketch holds and wants, read in the background.
  void replan();
  void takePlan(const SketchWish& wish, const Result<SketchPlan>& plan);

  void record();
  void togglePause();
  void stop();
  void look();
  void follow(const JudgedFrame& judged);
  void followCameras();
  void tick();
  void ended(const Result<JobResult>& result);
  void teach();
  void deleteRegion(const Eigen::Vector3d& centre, double radius);
  void pushUndo(const QString& text, std::function<void()> undo);

  void refreshControls();
  void refreshPrompt();
  SketchPrompt::Content idlePrompt() const;
  void dotsDrawn();
  void measure();

  SketchOptions* wishes_ = nullptr;
  SketchPrompt* prompt_ = nullptr;
  FrameView* source_ = nullptr;
  FrameView* scene_ = nullptr;
  HemisphereView* hemisphere_ = nullptr;
  QStackedWidget* side_ = nullptr;
  QLabel* tally_ = nullptr;
  QLabel* lessons_ = nullptr;
  QPushButton* record_ = nullptr;
  QPushButton* pause_ = nullptr;
  QPushButton* stop_ = nullptr;
  QPushButton* new_ = nullptr;
  QPushButton* develop_ = nullptr;
  QToolButton* mute_ = nullptr;
  Sounds sounds_;
  SketchOverlay overlay_;
  SketchDots dots_;

  SketchPlan plan_;
  QString planTrouble_;
  bool planning_ = false;
  bool planAgain_ = false;

  Phase phase_ = Phase::kIdle;
  std::shared_ptr<SketchSession> session_;
  QPointer<Task> task_;
  SketchProgress now_;  // of the present or the last recording
  QString outcome_;     // of the last recording, in a word; empty: none of this sketch
  QString outcomeDetail_;
  TimePoint spoke_;                       // a refusal was heard
  std::optional<TimePoint> unseenSince_;  // the lamp, and it was not heard yet
  std::shared_ptr<const std::vector<bool>> captured_;
  bool cameraLost_ = false;  // and a banner says so
  std::vector<Kept> kept_;
  std::deque<Eigen::Vector3d> path_;
  // For the statistics.
  std::vector<TimePoint> waitingDots_;  // arrivals of frames whose dots are not on the screen yet
  std::optional<TimePoint> measuredFrom_;
  int sceneDrawn_ = 0;
  int sourceDrawn_ = 0;
};

}  // namespace lightsketch
