// Bad frames: found, shown beside what they should look like, dropped and taken back in.
#pragma once

#include <QImage>
#include <QWidget>
#include <filesystem>
#include <memory>
#include <vector>

#include "pipeline/job/jobs.h"
#include "pipeline/validate/frame_check.h"
#include "ui/app/sketch_summary.h"
#include "ui/app/workspace.h"

class QLabel;
class QListWidget;
class QListWidgetItem;
class QPushButton;

namespace lightsketch {

class TripleView;
class Worker;

class FramesPanel final : public QWidget {
  Q_OBJECT
 public:
  FramesPanel(Workspace& workspace, Worker& worker, QWidget* parent = nullptr);

  // The sketch at hand was opened (another, or edited on disk).
  void setSummary(const SketchSummary& summary, bool another);
  void setExposure(float exposure) { exposure_ = exposure; }

 Q_SIGNALS:
  void suspectsChanged(int count);  // not dropped yet
  void frameShown(int id);

 private:
  struct Suspect {
    int id = 0;
    FrameFault fault = FrameFault::kNone;
    QString reason;  // in words
    std::string forJournal = {};
    QImage captured, predicted, ratio;  // null where there is none
    bool dropped = false;
  };
  struct Found;
  void check();
  void take(const Found& found);
  void fill();
  void show(int row);
  std::vector<int> open(FrameFault fault) const;  // suspects that are not dropped
  void updateButtons();

  Workspace& workspace_;
  Worker& worker_;
  SketchSummary summary_;
  std::vector<Suspect> found_;     // by the last check
  std::vector<Suspect> suspects_;  // those, and frames dropped before; as the list shows them
  bool checked_ = false;
  float exposure_ = 1;
  Task* task_ = nullptr;
  QLabel* outcome_;
  QListWidget* list_;
  QLabel* reason_;
  TripleView* pictures_;
  QPushButton* check_;
  QPushButton* dropShadows_;
  QPushButton* dropAll_;
  QPushButton* drop_;
  QPushButton* keep_;
};

}  // namespace lightsketch
