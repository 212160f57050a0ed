#include "ui/app/sketch_edits.h"

#include <QUndoCommand>
#include <deque>
#include <utility>

#include "pipeline/job/jobs.h"
#include "ui/app/workspace.h"

namespace lightsketch {
namespace {

using Edit = Result<JobResult> (*)(const DropJob&);

// One after another: a sketch has one writer, and undo may be pressed faster than a disk syncs.
class EditQueue final : public QObject {
 public:
  static EditQueue& of(Workspace& workspace) {
    static const QString kName = "sketchEdits";
    auto* queue = workspace.findChild<QObject*>(kName, Qt::FindDirectChildrenOnly);
    if (!queue) {
      queue = new EditQueue(workspace);
      queue->setObjectName(kName);
    }
    return static_cast<EditQueue&>(*queue);
  }

  void add(Edit edit, const DropJob& job) {
    waiting_.emplace_back(edit, job);
    if (!busy_) next();
  }

 private:
  explicit EditQueue(Workspace& workspace) : QObject(&workspace), workspace_(workspace) {}

  void next() {
    if (waiting_.empty()) return;
    busy_ = true;
    const auto [edit, job] = std::move(waiting_.front());
    waiting_.pop_front();
    Task* task =
        workspace_.run(edit == &dropJob ? tr("Deleting frames") : tr("Restoring frames"),
                       [edit = edit, job = job](Progress&, std::stop_token) { return edit(job); });
    connect(task, &Task::finished, this, [this] {
      busy_ = false;
      workspace_.touchSketch();
      if (!busy_) next();
    });
  }

  Workspace& workspace_;
  std::deque<std::pair<Edit, DropJob>> waiting_;
  bool busy_ = false;
};

class DropFrames final : public QUndoCommand {
 public:
  DropFrames(Workspace& workspace, DropJob job, Edit forward, Edit back, const QString& text)
      : QUndoCommand(text),
        workspace_(workspace),
        job_(std::move(job)),
        forward_(forward),
        back_(back) {}
  void redo() override { EditQueue::of(workspace_).add(forward_, job_); }
  void undo() override { EditQueue::of(workspace_).add(back_, job_); }

 private:
  Workspace& workspace_;
  const DropJob job_;
  const Edit forward_;
  const Edit back_;
};

}  // namespace

void dropFrames(Workspace& workspace, const std::filesystem::path& sketch, std::vector<int> ids,
                std::string reason, const QString& text) {
  if (ids.empty()) return;
  workspace.undo().push(new DropFrames(workspace, {sketch, std::move(ids), std::move(reason)},
                                       &dropJob, &restoreJob, text));
}

void restoreFrames(Workspace& workspace, const std::filesystem::path& sketch, std::vector<int> ids,
                   std::string reason, const QString& text) {
  if (ids.empty()) return;
  workspace.undo().push(new DropFrames(workspace, {sketch, std::move(ids), std::move(reason)},
                                       &restoreJob, &dropJob, text));
}

}  // namespace lightsketch
