// A window of the app for tests, with settings of its own.
#pragma once

#include <QApplication>
#include <QDir>
#include <QLabel>
#include <QTemporaryDir>
#include <QTest>
#include <QWidget>

#include "ui/app/main_window.h"
#include "ui/app/theme.h"

namespace lightsketch {

// Milliseconds that something may take, on a busy machine. Sanitizers are slow.
constexpr int patience(int milliseconds) { return LIGHTSKETCH_PATIENCE * milliseconds; }

class AppTest {
 public:
  // `setup` is there before the first page looks for cameras.
  explicit AppTest(const RigSetup& setup = {})
      : workspace_(folder_.filePath("settings.ini")), window_(with(setup)) {
    window_.resize(1280, 720);
    window_.show();
    (void)QTest::qWaitForWindowExposed(&window_);
    QApplication::setActiveWindow(&window_);  // no window manager does it
  }

  Workspace& workspace() { return workspace_; }
  MainWindow& window() { return window_; }
  std::filesystem::path path(const char* name) const { return toPath(folder_.filePath(name)); }
  // A widget of the current page, by its objectName.
  template <class Widget>
  Widget* find(const char* name) {
    return window_.currentPage()->findChild<Widget*>(name);
  }
  // What a message at the top says; empty: there is none.
  QString banner(const QString& key) {
    const auto* frame = window_.findChild<QWidget*>("banner/" + key);
    const auto* label = frame ? frame->findChild<QLabel*>() : nullptr;
    return label ? label->text() : QString();
  }
  // In both themes.
  void screenshot(const QString& name) {
    QDir().mkpath(LIGHTSKETCH_SCREENSHOTS);
    for (const char* theme : {"light", "dark"}) {
      applyTheme(theme);
      QTest::qWait(100);
      const QString suffix = theme == QString("light") ? "-light" : "";
      window_.grab().save(QString(LIGHTSKETCH_SCREENSHOTS "/%1%2.png").arg(name, suffix));
    }
  }

 private:
  Workspace& with(const RigSetup& setup) {
    workspace_.rig().setSetup(setup);
    return workspace_;
  }

  QTemporaryDir folder_;
  Workspace workspace_;
  MainWindow window_;
};

}  // namespace lightsketch
