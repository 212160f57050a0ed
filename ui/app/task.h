// Long work in the background: progress, warnings, cancel, one result.
#pragma once

#include <QObject>
#include <QString>
#include <QStringList>
#include <chrono>
#include <functional>
#include <mutex>
#include <optional>
#include <stop_token>
#include <thread>

#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/job/jobs.h"

namespace lightsketch {

// Lives on the UI thread; the work runs on a thread of its own and touches no widget. Its signals
// come on the UI thread.
class Task final : public QObject {
  Q_OBJECT
 public:
  using Work = std::function<Result<JobResult>(Progress&, std::stop_token)>;

  // Starts at once.
  Task(QString title, Work work, QObject* parent = nullptr);
  // Cancels and waits for the work's end.
  ~Task() override;

  const QString& title() const { return title_; }
  bool running() const { return running_; }
  // Asks the work to stop soon; finished() comes when it has.
  void cancel();
  // Once finished.
  const Result<JobResult>& result() const { return *result_; }
  bool cancelled() const;  // finished by cancel()

 Q_SIGNALS:
  // Part done of the stage, 0 to 1, below 0 where that is unknown; the same for the seconds left.
  void progressed(const QString& stage, double fraction, double secondsLeft);
  void warned(const QString& text);
  void finished();

 private:
  class Reporter;
  void poll();
  void end();

  const QString title_;
  bool running_ = true;
  std::optional<Result<JobResult>> result_;
  std::unique_ptr<Reporter> reporter_;
  std::jthread thread_;
};

}  // namespace lightsketch
