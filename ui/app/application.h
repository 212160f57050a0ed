// QApplication that knows how long its event loop was blocked.
#pragma once

#include <QApplication>
#include <chrono>

#include "ui/app/statistics.h"

namespace lightsketch {

class Application final : public QApplication {
  Q_OBJECT
 public:
  Application(int& argc, char** argv) : QApplication(argc, argv) {}

  // From now on each event's time goes to `statistics` ("UI thread blocked, ms"), which outlives
  // the event loop.
  void watch(Statistics& statistics) { statistics_ = &statistics; }
  void unwatch() { statistics_ = nullptr; }

  bool notify(QObject* receiver, QEvent* event) override {
    if (!statistics_ || depth_ > 0) return QApplication::notify(receiver, event);
    ++depth_;
    const auto begin = std::chrono::steady_clock::now();
    const bool handled = QApplication::notify(receiver, event);
    const std::chrono::duration<double, std::milli> spent =
        std::chrono::steady_clock::now() - begin;
    --depth_;
    if (statistics_) statistics_->add("UI thread blocked, ms", spent.count());
    return handled;
  }

 private:
  Statistics* statistics_ = nullptr;
  int depth_ = 0;  // events sent while one is handled are part of it
};

}  // namespace lightsketch
