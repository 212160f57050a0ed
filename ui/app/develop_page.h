// From frames to a model: which frames, how good or how large, and the result measured.
#pragma once

#include <QImage>
#include <QTimer>
#include <memory>

#include "pipeline/job/jobs.h"
#include "ui/app/page.h"
#include "ui/app/sketch_summary.h"
#include "ui/app/task.h"

class QButtonGroup;
class QLabel;
class QLayout;
class QListWidget;
class QProgressBar;
class QPushButton;
class QTabWidget;

namespace lightsketch {

class DevelopChoices;
class FramesPanel;
class GrowingPicture;
class HemisphereView;
class PictureView;
class Worker;

class DevelopPage final : public Page {
  Q_OBJECT
 public:
  explicit DevelopPage(Workspace& workspace, QWidget* parent = nullptr);
  ~DevelopPage() override;
  QString title() const override { return tr("Develop"); }
  QString purpose() const override;
  void entered() override;
  void begin() override;

 private:
  QWidget* buildSketch();
  QLayout* buildChoices();
  QWidget* buildResult();
  void load(bool another);
  void showSummary(const SketchSummary& summary, bool another);
  void showDots();
  void loadThumbnails();
  void develop();
  void grow();
  void finish(const Task& task, const CompressJob& job);
  void compareWithCapture(const std::filesystem::path& model);
  void showPicture();

  SketchSummary summary_;
  bool stale_ = true;  // the summary is not of what is on disk
  bool another_ = true;
  float exposure_ = 1;
  QImage pictures_[3];  // of the example: captured, by the model, their difference
  Task* task_ = nullptr;
  std::shared_ptr<GrowingPicture> growing_;
  QTimer growTimer_;

  QLabel* name_;
  QLabel* counts_;
  HemisphereView* hemisphere_;
  QListWidget* thumbnails_;
  QTabWidget* tabs_;
  FramesPanel* frames_;
  DevelopChoices* choices_;
  QPushButton* develop_;
  QProgressBar* progress_;
  PictureView* picture_;
  QButtonGroup* shown_;
  QWidget* shownRow_;
  QLabel* result_;
  QPushButton* relight_;
  QPushButton* validate_;
  Worker* worker_;  // last: its thread ends before what it shows
};

}  // namespace lightsketch
