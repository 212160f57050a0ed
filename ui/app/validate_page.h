// How good the model is: figures, where on the hemisphere it errs, and the pictures behind them.
#pragma once

#include <Eigen/Core>
#include <QStandardItemModel>
#include <filesystem>
#include <memory>
#include <vector>

#include "pipeline/compress/model.h"
#include "pipeline/job/jobs.h"
#include "pipeline/sketch/sketch.h"
#include "pipeline/validate/validate.h"
#include "ui/app/page.h"
#include "ui/app/task.h"
#include "ui/app/stored_report.h"

class QComboBox;
class QLabel;
class QMenu;
class QProgressBar;
class QPushButton;
class QSortFilterProxyModel;
class QTableView;

namespace lightsketch {

class ColourScale;
class HemisphereView;
class TripleView;
class Worker;

class ValidatePage final : public Page {
  Q_OBJECT
 public:
  explicit ValidatePage(Workspace& workspace, QWidget* parent = nullptr);
  ~ValidatePage() override;
  QString title() const override { return tr("Validate"); }
  QString purpose() const override;
  void entered() override;
  void begin() override;

  // What the export menu does once it knows where to.
  void exportFigures(const std::filesystem::path& csv);
  void exportDirections(const std::filesystem::path& lp);
  void exportPictures(const std::filesystem::path& folder);

 private:
  struct Sources;  // the sketch and the model that it is about

  QWidget* buildBar();
  QWidget* buildLeft();
  QWidget* buildRight();
  void describeModel();
  void chooseFromModel(const QString& holdOut, bool readable);
  void validateNow();
  void load();
  void show(std::shared_ptr<const StoredReport> report);
  void take(std::shared_ptr<const Sources> sources, const QString& problem);
  void fillDots();
  void select(int light);  // index into the report's lights
  void step(int worseBy);  // along the table
  void draw();

  std::shared_ptr<const StoredReport> report_;
  std::shared_ptr<const Sources> sources_;
  QString problem_;  // why there are no pictures
  bool staleModel_ = true;
  bool staleReport_ = false;
  int light_ = -1;
  Task* task_ = nullptr;

  QComboBox* subject_;
  QComboBox* holdOut_;
  QPushButton* validate_;
  QProgressBar* progress_;
  QLabel* advice_;
  QPushButton* open_;
  QPushButton* browser_;
  QPushButton* export_;
  QLabel* figures_;
  HemisphereView* hemisphere_;
  ColourScale* scale_;
  QLabel* caption_;
  QPushButton* worse_;
  QPushButton* better_;
  TripleView* pictures_;
  QTableView* table_;
  QStandardItemModel* rows_;
  QSortFilterProxyModel* sorted_;
  Worker* worker_;
};

}  // namespace lightsketch
