#include "ui/app/board_box.h"

#include <QComboBox>
#include <QDoubleSpinBox>
#include <QFileDialog>
#include <QHBoxLayout>
#include <QLabel>
#include <QLineEdit>
#include <QPushButton>
#include <QSpinBox>

#include "pipeline/job/calibrate_jobs.h"
#include "ui/app/controls.h"
#include "ui/app/workspace.h"

namespace lightsketch {
namespace {

enum Kind { kCharuco, kChessboard };

}  // namespace

BoardBox::BoardBox(Workspace& workspace, QWidget* parent) : QWidget(parent), workspace_(workspace) {
  auto* row = new QHBoxLayout(this);
  row->setContentsMargins(0, 0, 0, 0);
  row->setSpacing(6);
  const auto add = [&](const QString& text, QWidget* widget, const QString& name,
                       const QString& tip) {
    widget->setObjectName(name);
    widget->setToolTip(tip);
    row->addWidget(labelFor(widget, text));
    row->addWidget(widget);
  };
  kind_ = new QComboBox;
  kind_->addItems({tr("ChArUco"), tr("Chessboard")});
  add(tr("&Board"), kind_, "boardKind",
      tr("ChArUco: a chessboard with markers in its white squares. Parts of it are enough, so it "
         "reaches the edge of the picture. Better than a plain chessboard."));
  columns_ = new QSpinBox;
  rows_ = new QSpinBox;
  for (QSpinBox* box : {columns_, rows_}) box->setRange(3, 100);
  const QString corners = tr("Inner corners: where four squares meet, one less than squares");
  add(tr("&corners"), columns_, "boardColumns", corners);
  add(tr("\u00d7"), rows_, "boardRows", corners);
  square_ = new QDoubleSpinBox;
  square_->setRange(0.1, 10'000);
  square_->setDecimals(2);
  square_->setSuffix(tr(" mm"));
  add(tr("s&quare"), square_, "boardSquare",
      tr("Side of a square as measured on the paper, not as it was meant to be printed"));
  marker_ = new QDoubleSpinBox;
  marker_->setRange(0.2, 0.95);
  marker_->setSingleStep(0.05);
  add(tr("&marker"), marker_, "boardMarker", tr("Side of a marker, as a part of the square's"));
  dictionary_ = new QComboBox;
  dictionary_->setEditable(true);
  for (const char* bits : {"4X4", "5X5", "6X6"}) {
    for (const char* size : {"50", "100", "250", "1000"}) {
      dictionary_->addItem(QString("DICT_%1_%2").arg(bits, size));
    }
  }
  add(tr("&dictionary"), dictionary_, "boardDictionary",
      tr("OpenCV's name of the markers; boards printed here say theirs below the squares"));
  row->addStretch(1);
  auto* printButton = new QPushButton(tr("&Print a board ..."));
  printButton->setObjectName("printBoard");
  printButton->setToolTip(tr(
      "Write this board to a PDF at true scale; print it at 100 % and glue it to something flat"));
  row->addWidget(printButton);

  load();
  const auto changed = [this] {
    const bool charuco = kind_->currentIndex() == kCharuco;
    marker_->setEnabled(charuco);
    dictionary_->setEnabled(charuco);
    save();
  };
  changed();
  connect(kind_, &QComboBox::currentIndexChanged, this, changed);
  connect(columns_, &QSpinBox::valueChanged, this, changed);
  connect(rows_, &QSpinBox::valueChanged, this, changed);
  connect(square_, &QDoubleSpinBox::valueChanged, this, changed);
  connect(marker_, &QDoubleSpinBox::valueChanged, this, changed);
  connect(dictionary_, &QComboBox::currentTextChanged, this, changed);
  connect(printButton, &QPushButton::clicked, this, [this] {
    const QString file = QFileDialog::getSaveFileName(this, tr("Print a board"), "board.pdf",
                                                      tr("PDF (*.pdf);;SVG (*.svg);;PNG (*.png)"));
    if (!file.isEmpty()) print(file);
  });
}

BoardGeometry BoardBox::board() const {
  BoardGeometry board;
  board.kind = kind_->currentIndex() == kCharuco ? BoardGeometry::Kind::kCharuco
                                                 : BoardGeometry::Kind::kChessboard;
  board.columns = columns_->value();
  board.rows = rows_->value();
  board.spacingMetres = square_->value() / 1000;
  board.markerFraction = marker_->value();
  board.dictionary = dictionary_->currentText().toStdString();
  return board;
}

void BoardBox::print(const QString& file) {
  PrintBoardJob job;
  job.board = board();
  job.out = toPath(file);
  Task* task = workspace_.run(tr("Print a board"),
                              [job](Progress&, std::stop_token) { return printBoardJob(job); });
  connect(task, &Task::finished, this, [this, task] {
    if (!task->result()) return;
    workspace_.say(
        {"board", Workspace::Level::kInfo, QString::fromStdString(task->result()->text).trimmed()});
  });
}

void BoardBox::load() {
  const BoardGeometry usual;
  QSettings& settings = workspace_.settings();
  const auto value = [&](const char* name, const QVariant& otherwise) {
    return settings.value(QString("board/") + name, otherwise);
  };
  kind_->setCurrentIndex(value("kind", kCharuco).toInt());
  columns_->setValue(value("columns", usual.columns).toInt());
  rows_->setValue(value("rows", usual.rows).toInt());
  square_->setValue(value("squareMillimetres", 1000 * usual.spacingMetres).toDouble());
  marker_->setValue(value("marker", usual.markerFraction).toDouble());
  dictionary_->setCurrentText(
      value("dictionary", QString::fromStdString(usual.dictionary)).toString());
}

void BoardBox::save() {
  QSettings& settings = workspace_.settings();
  settings.setValue("board/kind", kind_->currentIndex());
  settings.setValue("board/columns", columns_->value());
  settings.setValue("board/rows", rows_->value());
  settings.setValue("board/squareMillimetres", square_->value());
  settings.setValue("board/marker", marker_->value());
  settings.setValue("board/dictionary", dictionary_->currentText());
}

}  // namespace lightsketch
