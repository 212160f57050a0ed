#include "ui/app/workspace.h"

#include <QDir>
#include <QFileInfo>

#include "ui/app/rig_setup_settings.h"

namespace lightsketch {
namespace {

constexpr int kRecent = 12;

bool holdsPictures(const QDir& folder) {
  static const QStringList kPictures{"*.lp",   "*.jpg", "*.jpeg", "*.png", "*.tif",
                                     "*.tiff", "*.exr", "*.dng",  "*.nef", "*.cr2"};
  return !folder.entryList(kPictures, QDir::Files).isEmpty();
}

}  // namespace

QString toQString(const std::filesystem::path& path) {
  return QString::fromStdString(path.string());
}
std::filesystem::path toPath(const QString& text) { return text.toStdString(); }

Workspace::Workspace(const QString& settingsFile, QObject* parent) : QObject(parent) {
  settings_ = settingsFile.isEmpty()
                  ? std::make_unique<QSettings>("lightsketch", "lightsketch-app")
                  : std::make_unique<QSettings>(settingsFile, QSettings::IniFormat);
  rig_ = std::make_unique<RigLink>();
  rig_->setSetup(loadRigSetup(*settings_));
  connect(rig_.get(), &RigLink::setupChanged, this,
          [this] { saveRigSetup(*settings_, rig_->setup()); });
  connect(rig_.get(), &RigLink::stateChanged, this, [this] {
    if (rig_->state() != RigLink::State::kFailed) return withdraw("camera");
    say({"camera", Level::kError, tr("No pictures: %1").arg(rig_->trouble()), tr("Reconnect"),
         [this] { rig_->reopen(); }});
  });
}

Workspace::~Workspace() { cancelAll(); }

void Workspace::setSketch(const std::filesystem::path& folder) {
  remember(folder);
  undo_.clear();
  sketch_ = folder;
  Q_EMIT sketchChanged();
}

void Workspace::setModel(const std::filesystem::path& file) {
  remember(file);
  model_ = file;
  Q_EMIT modelChanged();
}

void Workspace::setReport(const std::filesystem::path& folder) {
  report_ = folder;
  Q_EMIT reportChanged();
}

bool Workspace::open(const std::filesystem::path& path) {
  const QFileInfo info(toQString(path));
  if (info.isFile() && info.suffix().toLower() == "lsd") {
    setModel(path);
    show("relight");
    return true;
  }
  if (info.isFile() && info.suffix().toLower() == "lp") return open(path.parent_path());
  if (info.isDir() && QFileInfo::exists(toQString(path / "sketch.json"))) {
    setSketch(path);
    show("develop");
    return true;
  }
  if (info.isDir() && QFileInfo::exists(toQString(path / "report.json"))) {
    setReport(path);
    show("validate");
    return true;
  }
  if (info.isDir() && holdsPictures(QDir(info.filePath()))) {
    ImportOptions import;
    import.folder = path;
    import.out = path.string() + ".sketch";
    if (QFileInfo::exists(toQString(import.out / "sketch.json"))) return open(import.out);
    Task* task =
        run(tr("Import %1").arg(info.fileName()),
            [import](Progress& progress, std::stop_token) { return importJob(import, progress); });
    connect(task, &Task::finished, this, [this, task, out = import.out] {
      if (task->result()) open(out);
    });
    return true;
  }
  say({"open", Level::kError,
       tr("%1: neither a sketch, nor a model (.lsd), nor a folder with a light position file (.lp)")
           .arg(info.filePath())});
  return false;
}

QStringList Workspace::recent() const { return settings_->value("recent").toStringList(); }

void Workspace::remember(const std::filesystem::path& path) {
  QStringList files = recent();
  const QString absolute = QFileInfo(toQString(path)).absoluteFilePath();
  files.removeAll(absolute);
  files.prepend(absolute);
  while (files.size() > kRecent) files.removeLast();
  settings_->setValue("recent", files);
  Q_EMIT recentChanged();
}

Task* Workspace::run(const QString& title, Task::Work work) {
  auto* task = new Task(title, std::move(work), this);
  tasks_.append(task);
  connect(task, &Task::warned, this, [this, title](const QString& text) {
    say({"warning/" + title, Level::kWarning, text});
  });
  connect(task, &Task::finished, this, [this, task] {
    tasks_.removeOne(task);
    if (!task->result() && !task->cancelled()) {
      say({"task/" + task->title(), Level::kError,
           QString::fromStdString(task->result().error().message)});
    }
    task->deleteLater();
  });
  Q_EMIT taskStarted(task);
  return task;
}

void Workspace::cancelAll() {
  for (Task* task : tasks_) task->cancel();
  qDeleteAll(std::exchange(tasks_, {}));
}

}  // namespace lightsketch
