#include "ui/app/calibrate_page.h"

#include <QTabWidget>
#include <QVBoxLayout>

#include "ui/app/board_box.h"
#include "ui/app/lens_step.h"
#include "ui/app/poses_step.h"
#include "ui/app/response_step.h"

namespace lightsketch {

CalibratePage::CalibratePage(Workspace& workspace, QWidget* parent) : Page(workspace, parent) {
  auto* column = new QVBoxLayout(this);
  column->setContentsMargins(12, 8, 12, 8);
  column->setSpacing(6);
  auto* board = new BoardBox(workspace);
  board->setObjectName("board");
  column->addWidget(board);
  steps_ = new QTabWidget;
  steps_->setObjectName("steps");
  steps_->setDocumentMode(true);
  steps_->setAccessibleName(tr("Steps of the calibration"));
  column->addWidget(steps_, 1);
  auto* lens = new LensStep(workspace, *board);
  auto* poses = new PosesStep(workspace, *board);
  auto* response = new ResponseStep(workspace);
  steps_->addTab(lens, tr("&1 Lens"));
  steps_->addTab(poses, tr("&2 Poses"));
  steps_->addTab(response, tr("&3 Response"));
  steps_->setTabToolTip(0, tr("Which pixel looks in which direction"));
  steps_->setTabToolTip(1, tr("Where the cameras stand; the lenses too"));
  steps_->setTabToolTip(2, tr("What the scene camera's counts mean"));
  for (CalibrationStep* step : std::initializer_list<CalibrationStep*>{lens, poses, response}) {
    connect(step, &CalibrationStep::runningChanged, board, &QWidget::setDisabled);
  }
  // The board says nothing about counts.
  connect(steps_, &QTabWidget::currentChanged, board,
          [this, board, response](int at) { board->setVisible(steps_->widget(at) != response); });
}

QString CalibratePage::purpose() const {
  return tr("Measure the lenses, where the cameras stand, and what their counts mean");
}

void CalibratePage::entered() { workspace().rig().watch(true); }
void CalibratePage::left() { workspace().rig().watch(false); }

void CalibratePage::begin() { static_cast<CalibrationStep*>(steps_->currentWidget())->begin(); }

}  // namespace lightsketch
