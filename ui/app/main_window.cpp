#include "ui/app/main_window.h"

#include <QActionGroup>
#include <QApplication>
#include <QCloseEvent>
#include <QDragEnterEvent>
#include <QFileDialog>
#include <QFileInfo>
#include <QHBoxLayout>
#include <QLabel>
#include <QListWidget>
#include <QMenuBar>
#include <QMimeData>
#include <QProgressBar>
#include <QPushButton>
#include <QStackedWidget>
#include <QStatusBar>
#include <QTimer>
#include <QToolButton>
#include <QVBoxLayout>

#include "ui/app/calibrate_page.h"
#include "ui/app/controls.h"
#include "ui/app/develop_page.h"
#include "ui/app/relight_page.h"
#include "ui/app/rig_page.h"
#include "ui/app/sketch_page.h"
#include "ui/app/theme.h"
#include "ui/app/validate_page.h"

namespace lightsketch {
namespace {

constexpr int kInfoMilliseconds = 6000;
constexpr auto kTheme = "theme";
constexpr auto kDark = "dark";

QString colourOf(Workspace::Level level) {
  switch (level) {
    case Workspace::Level::kInfo:
      return "#2f5d8a";
    case Workspace::Level::kWarning:
      return "#8a6512";
    case Workspace::Level::kError:
      return "#8e2f2a";
  }
  return {};
}

QString inWords(double seconds) {
  if (seconds < 0) return {};
  if (seconds < 90) return MainWindow::tr("%1 s left").arg(qRound(seconds));
  return MainWindow::tr("%1 min left").arg(qRound(seconds / 60));
}

}  // namespace

MainWindow::MainWindow(Workspace& workspace, const QString& firstPage, QWidget* parent)
    : QMainWindow(parent), workspace_(workspace) {
  // First: pages take their colours from it.
  applyTheme(workspace_.settings().value(kTheme, kDark).toString());
  setWindowTitle("lightsketch");
  setAcceptDrops(true);
  resize(1280, 720);

  auto* centre = new QWidget;
  auto* across = new QHBoxLayout(centre);
  across->setContentsMargins(0, 0, 0, 0);
  across->setSpacing(0);
  list_ = new QListWidget;
  list_->setFixedWidth(116);
  list_->setFrameShape(QFrame::NoFrame);
  list_->setAccessibleName(tr("Pages"));
  enlarge(list_, 1.15);
  across->addWidget(list_);
  auto* column = new QVBoxLayout;
  column->setContentsMargins(0, 0, 0, 0);
  column->setSpacing(0);
  messages_ = new QVBoxLayout;
  column->addLayout(messages_);
  stack_ = new QStackedWidget;
  column->addWidget(stack_, 1);
  across->addLayout(column, 1);
  setCentralWidget(centre);

  addPage("rig", new RigPage(workspace_));
  addPage("calibrate", new CalibratePage(workspace_));
  addPage("sketch", new SketchPage(workspace_));
  addPage("develop", new DevelopPage(workspace_));
  addPage("relight", new RelightPage(workspace_));
  addPage("validate", new ValidatePage(workspace_));
  buildMenus();

  connect(list_, &QListWidget::currentRowChanged, this, [this](int row) {
    if (row < 0 || row == current_) return;
    if (Page* before = currentPage()) before->left();
    current_ = row;
    stack_->setCurrentWidget(currentPage());
    currentPage()->entered();
  });
  connect(&workspace_, &Workspace::pageWanted, this, &MainWindow::showPage);
  connect(&workspace_, &Workspace::messageChanged, this, &MainWindow::showMessage);
  connect(&workspace_, &Workspace::messageWithdrawn, this, &MainWindow::withdrawMessage);
  connect(&workspace_, &Workspace::taskStarted, this, &MainWindow::showTask);
  connect(&workspace_, &Workspace::recentChanged, this, &MainWindow::fillRecent);

  restoreGeometry(workspace_.settings().value("window").toByteArray());
  showPage(firstPage);
}

MainWindow::~MainWindow() = default;

void MainWindow::addPage(const QString& name, Page* page) {
  names_.push_back(name);
  pages_.push_back(page);
  stack_->addWidget(page);
  auto* item = new QListWidgetItem(page->title(), list_);
  item->setToolTip(tr("%1 (Ctrl+%2)").arg(page->purpose()).arg(names_.size()));
  item->setSizeHint({0, 52});
  item->setTextAlignment(Qt::AlignCenter);
}

void MainWindow::showPage(const QString& name) {
  const auto at = std::find(names_.begin(), names_.end(), name);
  if (at != names_.end()) list_->setCurrentRow(static_cast<int>(at - names_.begin()));
}

Page* MainWindow::page(const QString& name) const {
  const auto at = std::find(names_.begin(), names_.end(), name);
  if (at == names_.end()) return nullptr;
  return pages_[static_cast<std::size_t>(at - names_.begin())];
}

Page* MainWindow::currentPage() const {
  return current_ < 0 ? nullptr : pages_[static_cast<std::size_t>(current_)];
}

void MainWindow::buildMenus() {
  QMenu* file = menuBar()->addMenu(tr("&File"));
  file->addAction(tr("&Open model or light list..."), QKeySequence::Open, this,
                  [this] { chooseToOpen(false); });
  file->addAction(tr("Open &sketch or folder of pictures..."), QKeySequence("Ctrl+Shift+O"), this,
                  [this] { chooseToOpen(true); });
  recent_ = file->addMenu(tr("&Recent"));
  fillRecent();
  file->addSeparator();
  file->addAction(tr("&Quit"), QKeySequence::Quit, this, &QWidget::close);

  QMenu* edit = menuBar()->addMenu(tr("&Edit"));
  QAction* undo = workspace_.undo().createUndoAction(this, tr("&Undo"));
  undo->setShortcut(QKeySequence::Undo);
  QAction* redo = workspace_.undo().createRedoAction(this, tr("&Redo"));
  redo->setShortcut(QKeySequence::Redo);
  edit->addActions({undo, redo});

  QMenu* view = menuBar()->addMenu(tr("&View"));
  for (std::size_t i = 0; i < names_.size(); ++i) {
    view->addAction(page(names_[i])->title(), QKeySequence(QString("Ctrl+%1").arg(i + 1)), this,
                    [this, i] { showPage(names_[i]); });
  }
  view->addSeparator();
  auto* themes = new QActionGroup(this);
  const QString now = workspace_.settings().value(kTheme, kDark).toString();
  for (const auto& [name, label] : {std::pair{kDark, tr("&Dark")}, {"light", tr("&Light")}}) {
    QAction* action = view->addAction(label);
    action->setCheckable(true);
    action->setChecked(now == name);
    themes->addAction(action);
    connect(action, &QAction::triggered, this, [this, name = QString(name)] {
      workspace_.settings().setValue(kTheme, name);
      applyTheme(name);
    });
  }
}

void MainWindow::fillRecent() {
  recent_->clear();
  for (const QString& path : workspace_.recent()) {
    recent_->addAction(path, this, [this, path] { workspace_.open(toPath(path)); });
  }
  recent_->setEnabled(!recent_->isEmpty());
}

void MainWindow::chooseToOpen(bool folder) {
  const QString start = workspace_.settings().value("folder").toString();
  const QString path =
      folder ? QFileDialog::getExistingDirectory(this, tr("Sketch or folder of pictures"), start)
             : QFileDialog::getOpenFileName(this, tr("Model or light list"), start,
                                            tr("Models and light lists (*.lsd *.lp)"));
  if (path.isEmpty()) return;
  workspace_.settings().setValue("folder", QFileInfo(path).path());
  workspace_.open(toPath(path));
}

void MainWindow::showMessage(const Workspace::Message& message) {
  // Words that change do not take the button away from under the pointer.
  if (const auto at = banners_.find(message.key); at != banners_.end()) {
    const auto* button = at->second->findChild<QPushButton*>();
    if (button && button->text() == message.action) {
      return at->second->findChild<QLabel*>()->setText(message.text);
    }
  }
  withdrawMessage(message.key);
  auto* banner = new QFrame;
  banner->setObjectName("banner/" + message.key);
  banner->setStyleSheet(
      QString("QFrame { background: %1; } QLabel { color: white; }").arg(colourOf(message.level)));
  auto* row = new QHBoxLayout(banner);
  row->setContentsMargins(12, 6, 6, 6);
  auto* text = new QLabel(message.text);
  text->setWordWrap(true);
  text->setTextInteractionFlags(Qt::TextSelectableByMouse);
  row->addWidget(text, 1);
  if (!message.action.isEmpty()) {
    auto* button = new QPushButton(message.action);
    connect(button, &QPushButton::clicked, this, [act = message.onAction] { act(); });
    row->addWidget(button);
  }
  auto* close = new QToolButton;
  close->setText("\u00d7");
  close->setAutoRaise(true);
  close->setAccessibleName(tr("Close this message"));
  connect(close, &QToolButton::clicked, this, [this, key = message.key] { withdrawMessage(key); });
  row->addWidget(close);
  messages_->addWidget(banner);
  banners_[message.key] = banner;
  if (message.level == Workspace::Level::kInfo) {
    QTimer::singleShot(kInfoMilliseconds, banner,
                       [this, key = message.key] { withdrawMessage(key); });
  }
}

void MainWindow::withdrawMessage(const QString& key) {
  const auto at = banners_.find(key);
  if (at == banners_.end()) return;
  at->second->hide();
  at->second->deleteLater();
  banners_.erase(at);
}

void MainWindow::showTask(Task* task) {
  auto* box = new QWidget;
  auto* row = new QHBoxLayout(box);
  row->setContentsMargins(0, 0, 0, 0);
  auto* label = new QLabel(task->title());
  auto* bar = new QProgressBar;
  bar->setRange(0, 0);
  bar->setFixedWidth(160);
  auto* left = new QLabel;
  auto* cancel = new QPushButton(tr("Cancel"));
  cancel->setToolTip(tr("Stop %1; nothing half made is left").arg(task->title()));
  row->addWidget(label);
  row->addWidget(bar);
  row->addWidget(left);
  row->addWidget(cancel);
  statusBar()->addPermanentWidget(box);
  connect(cancel, &QPushButton::clicked, task, &Task::cancel);
  connect(task, &Task::progressed, box,
          [=, title = task->title()](const QString& stage, double fraction, double secondsLeft) {
            label->setText(QString("%1: %2").arg(title, stage));
            bar->setRange(0, fraction < 0 ? 0 : 1000);
            if (fraction >= 0) bar->setValue(qRound(1000 * fraction));
            left->setText(inWords(secondsLeft));
          });
  connect(task, &Task::finished, box, [this, box] {
    statusBar()->removeWidget(box);
    box->deleteLater();
  });
}

void MainWindow::closeEvent(QCloseEvent* event) {
  workspace_.settings().setValue("window", saveGeometry());
  if (Page* now = currentPage()) now->left();
  workspace_.cancelAll();
  event->accept();
}

void MainWindow::dragEnterEvent(QDragEnterEvent* event) {
  if (event->mimeData()->hasUrls()) event->acceptProposedAction();
}

void MainWindow::dropEvent(QDropEvent* event) {
  for (const QUrl& url : event->mimeData()->urls()) {
    if (url.isLocalFile()) workspace_.open(toPath(url.toLocalFile()));
  }
}

}  // namespace lightsketch
