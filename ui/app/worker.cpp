#include "ui/app/worker.h"

#include <utility>

namespace lightsketch {

Worker::Worker(QObject* parent)
    : QObject(parent), thread_([this](const std::stop_token& stop) { run(stop); }) {}

Worker::~Worker() {
  thread_.request_stop();
  {
    const std::lock_guard lock(mutex_);
    waiting_.clear();
    runningStop_.request_stop();
  }
  thread_.join();
}

void Worker::withdraw(const QString& key) {
  newest_[key] = ++count_;
  const std::lock_guard lock(mutex_);
  std::erase_if(waiting_, [&](const Job& job) { return job.key == key; });
  if (running_ == key) runningStop_.request_stop();
}

void Worker::ask(const QString& key, Work work) {
  withdraw(key);
  {
    const std::lock_guard lock(mutex_);
    waiting_.push_back({key, newest_[key], {}, std::move(work)});
  }
  asked_.notify_one();
}

void Worker::run(const std::stop_token& stop) {
  for (;;) {
    Job job;
    {
      std::unique_lock lock(mutex_);
      running_.clear();
      if (!asked_.wait(lock, stop, [&] { return !waiting_.empty(); })) return;
      job = std::move(waiting_.front());
      waiting_.pop_front();
      running_ = job.key;
      runningStop_ = job.stop;
    }
    Show show = job.work(job.stop.get_token());
    if (!show) continue;
    QMetaObject::invokeMethod(
        this,
        [this, key = job.key, number = job.number, show = std::move(show)] {
          if (newest_[key] == number) show();
        },
        Qt::QueuedConnection);
  }
}

}  // namespace lightsketch
