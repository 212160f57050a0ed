// What the pages share: the sketch, the model and the report at hand, the cameras, background
// tasks, messages, undo, settings.
#pragma once

#include <QObject>
#include <QSettings>
#include <QStringList>
#include <QUndoStack>
#include <filesystem>
#include <functional>
#include <optional>

#include "ui/app/rig_link.h"
#include "ui/app/statistics.h"
#include "ui/app/task.h"

namespace lightsketch {

QString toQString(const std::filesystem::path& path);
std::filesystem::path toPath(const QString& text);

// All of it on the UI thread.
class Workspace final : public QObject {
  Q_OBJECT
 public:
  // `settingsFile` empty: the user's own.
  explicit Workspace(const QString& settingsFile = {}, QObject* parent = nullptr);
  ~Workspace() override;

  RigLink& rig() { return *rig_; }
  QUndoStack& undo() { return undo_; }
  QSettings& settings() { return *settings_; }
  Statistics& statistics() { return statistics_; }

  // Empty: none. Setting one tells the pages, and remembers it among the recent files.
  const std::filesystem::path& sketch() const { return sketch_; }
  const std::filesystem::path& model() const { return model_; }
  const std::filesystem::path& report() const { return report_; }
  void setSketch(const std::filesystem::path& folder);
  void setModel(const std::filesystem::path& file);
  void setReport(const std::filesystem::path& folder);
  // The frames of the sketch at hand were changed on disk: recorded, dropped, restored.
  void touchSketch() { Q_EMIT sketchEdited(); }

  // Opens whatever it is: a sketch, a model, a report, a folder with a .lp file or pictures
  // (imported beside it in the background). What it cannot open becomes a message. Returns whether
  // it could be one.
  bool open(const std::filesystem::path& path);
  QStringList recent() const;

  // Runs it in the background, shown in the status bar with progress and cancel. A failure becomes
  // a message. The task deletes itself after finished().
  Task* run(const QString& title, Task::Work work);
  // The same for a value, which `then` gets on the UI thread if all went well and `receiver` is
  // still there. `work`: Result<Value>().
  template <class Work, class Then>
  Task* fetch(const QString& title, const QObject* receiver, Work work, Then then) {
    auto value = std::make_shared<std::optional<decltype(work())>>();
    Task* task = run(title, [value, work](Progress&, std::stop_token) -> Result<JobResult> {
      *value = work();
      if (!**value) return tl::unexpected<Error>((*value)->error());
      return JobResult{};
    });
    connect(task, &Task::finished, receiver, [task, value, then] {
      if (task->result()) then(std::move(***value));
    });
    return task;
  }
  // How many run. Tasks are cancelled and waited for by cancelAll(), which the window calls last.
  int running() const { return static_cast<int>(tasks_.size()); }
  void cancelAll();

  enum class Level { kInfo, kWarning, kError };
  struct Message {
    QString key;  // a new message with the same key takes the place of the old one
    Level level = Level::kInfo;
    QString text;
    QString action = {};  // label of a button; empty: none
    std::function<void()> onAction = {};
  };
  // A banner at the top of the window, until it is closed or withdrawn. Infos go by themselves.
  void say(Message message) { Q_EMIT messageChanged(message); }
  void withdraw(const QString& key) { Q_EMIT messageWithdrawn(key); }

  // Asks the window to show a page: "rig", "calibrate", "sketch", "develop", "relight", "validate".
  void show(const QString& page) { Q_EMIT pageWanted(page); }

 Q_SIGNALS:
  void sketchChanged();
  void sketchEdited();
  void modelChanged();
  void reportChanged();
  void recentChanged();
  void taskStarted(lightsketch::Task* task);
  void messageChanged(const lightsketch::Workspace::Message& message);
  void messageWithdrawn(const QString& key);
  void pageWanted(const QString& page);

 private:
  void remember(const std::filesystem::path& path);

  std::unique_ptr<QSettings> settings_;
  Statistics statistics_;
  QUndoStack undo_;
  std::unique_ptr<RigLink> rig_;
  std::filesystem::path sketch_;
  std::filesystem::path model_;
  std::filesystem::path report_;
  QList<Task*> tasks_;
};

}  // namespace lightsketch
