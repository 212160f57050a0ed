#include "ui/app/task.h"

#include <QTimer>
#include <exception>
#include <utility>

namespace lightsketch {

// What the work tells, kept until the UI thread looks: the work never waits for it.
class Task::Reporter final : public Progress {
 public:
  explicit Reporter(std::stop_token stop) : stop_(std::move(stop)) {}

  void update(std::string_view stage, std::size_t done, std::size_t total) override {
    const std::lock_guard lock(mutex_);
    if (stage != stage_) {
      stage_ = stage;
      since_ = std::chrono::steady_clock::now();
    }
    done_ = done;
    total_ = total;
    changed_ = true;
  }
  void warn(std::string_view message) override {
    const std::lock_guard lock(mutex_);
    warnings_.append(QString::fromUtf8(message.data(), static_cast<qsizetype>(message.size())));
  }
  bool cancelled() const override { return stop_.stop_requested(); }

  struct State {
    QString stage;
    double fraction = -1;
    double secondsLeft = -1;
  };
  std::optional<State> takeState() {
    const std::lock_guard lock(mutex_);
    if (!std::exchange(changed_, false)) return std::nullopt;
    State state{QString::fromStdString(stage_), -1, -1};
    if (total_ > 0) {
      state.fraction = static_cast<double>(done_) / static_cast<double>(total_);
      const std::chrono::duration<double> spent = std::chrono::steady_clock::now() - since_;
      // Before a twentieth is done the rest is a guess.
      if (state.fraction > 0.05) {
        state.secondsLeft = spent.count() * (1 - state.fraction) / state.fraction;
      }
    }
    return state;
  }
  QStringList takeWarnings() {
    const std::lock_guard lock(mutex_);
    return std::exchange(warnings_, {});
  }

 private:
  const std::stop_token stop_;
  std::mutex mutex_;  // Guards everything below.
  std::string stage_;
  std::size_t done_ = 0;
  std::size_t total_ = 0;
  std::chrono::steady_clock::time_point since_;
  QStringList warnings_;
  bool changed_ = false;
};

Task::Task(QString title, Work work, QObject* parent) : QObject(parent), title_(std::move(title)) {
  std::stop_source stop;
  reporter_ = std::make_unique<Reporter>(stop.get_token());
  auto* timer = new QTimer(this);
  connect(timer, &QTimer::timeout, this, &Task::poll);
  timer->start(50);
  // The jthread's own stop source is not known before it runs; requests go through it to `stop`.
  thread_ = std::jthread([this, stop, work = std::move(work)](std::stop_token own) mutable {
    const std::stop_callback forward(own, [&] { stop.request_stop(); });
    Result<JobResult> result = [&]() -> Result<JobResult> {
      try {
        return work(*reporter_, stop.get_token());
      } catch (const std::exception& problem) {
        return failure(ErrorCode::kInvalidArgument, "internal error: {}", problem.what());
      }
    }();
    QMetaObject::invokeMethod(
        this,
        [this, result = std::move(result)]() mutable {
          result_ = std::move(result);
          end();
        },
        Qt::QueuedConnection);
  });
}

Task::~Task() {
  thread_.request_stop();
  if (thread_.joinable()) thread_.join();
}

void Task::cancel() { thread_.request_stop(); }

bool Task::cancelled() const {
  return result_ && !*result_ && result_->error().code == ErrorCode::kCancelled;
}

void Task::poll() {
  if (const auto state = reporter_->takeState()) {
    Q_EMIT progressed(state->stage, state->fraction, state->secondsLeft);
  }
  for (const QString& warning : reporter_->takeWarnings()) Q_EMIT warned(warning);
}

void Task::end() {
  thread_.join();
  poll();
  running_ = false;
  Q_EMIT finished();
}

}  // namespace lightsketch
