// One background thread for what a page wants to see: pictures, tables.
#pragma once

#include <QObject>
#include <QString>
#include <condition_variable>
#include <deque>
#include <functional>
#include <map>
#include <mutex>
#include <stop_token>
#include <thread>

namespace lightsketch {

// Lives on the UI thread. For work that is quick and has no result of its own; what takes long or
// may fail is a Task.
class Worker final : public QObject {
  Q_OBJECT
 public:
  // Called on the UI thread.
  using Show = std::function<void()>;
  // Runs on the worker's thread, touches no widget; its token is asked to stop when nobody wants
  // the answer any more.
  using Work = std::function<Show(const std::stop_token&)>;

  explicit Worker(QObject* parent = nullptr);
  ~Worker() override;

  // Runs `work` after what was asked before. Earlier work with the same key is not shown any more.
  void ask(const QString& key, Work work);
  // Forgets what was asked with this key.
  void withdraw(const QString& key);

 private:
  struct Job {
    QString key;
    quint64 number = 0;
    std::stop_source stop;
    Work work;
  };
  void run(const std::stop_token& stop);

  std::map<QString, quint64> newest_;  // UI thread only
  quint64 count_ = 0;                  // UI thread only
  std::mutex mutex_;                   // guards all below
  std::condition_variable_any asked_;
  std::deque<Job> waiting_;
  QString running_;
  std::stop_source runningStop_;
  std::jthread thread_;
};

}  // namespace lightsketch
