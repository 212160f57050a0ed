// The window: pages at the left, messages at the top, background tasks at the bottom.
#pragma once

#include <QMainWindow>
#include <map>
#include <vector>

#include "ui/app/page.h"
#include "ui/app/workspace.h"

class QBoxLayout;
class QListWidget;
class QMenu;
class QStackedWidget;

namespace lightsketch {

class MainWindow final : public QMainWindow {
  Q_OBJECT
 public:
  // Only a page that is shown wants cameras: the first one is all that starts them.
  explicit MainWindow(Workspace& workspace, const QString& firstPage = "rig",
                      QWidget* parent = nullptr);
  ~MainWindow() override;

  // "rig", "calibrate", "sketch", "develop", "relight", "validate".
  void showPage(const QString& name);
  Page* page(const QString& name) const;
  Page* currentPage() const;

 protected:
  void closeEvent(QCloseEvent* event) override;
  void dragEnterEvent(QDragEnterEvent* event) override;
  void dropEvent(QDropEvent* event) override;

 private:
  void addPage(const QString& name, Page* page);
  void buildMenus();
  void fillRecent();
  void showMessage(const Workspace::Message& message);
  void withdrawMessage(const QString& key);
  void showTask(Task* task);
  void chooseToOpen(bool folder);

  Workspace& workspace_;
  QListWidget* list_;
  QStackedWidget* stack_;
  QBoxLayout* messages_;
  QMenu* recent_ = nullptr;
  std::vector<QString> names_;
  std::vector<Page*> pages_;
  std::map<QString, QWidget*> banners_;
  int current_ = -1;
};

}  // namespace lightsketch
