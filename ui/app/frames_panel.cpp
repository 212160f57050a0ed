#include "ui/app/frames_panel.h"

#include <QHBoxLayout>
#include <QLabel>
#include <QListWidget>
#include <QPainter>
#include <QPushButton>
#include <QShortcut>
#include <QSplitter>
#include <QVBoxLayout>
#include <algorithm>
#include <cmath>

#include "pipeline/sketch/light_stack.h"
#include "pipeline/sketch/sketch.h"
#include "pipeline/validate/frame_check_report.h"
#include "ui/app/controls.h"
#include "ui/app/picture_view.h"
#include "ui/app/sketch_edits.h"
#include "ui/app/worker.h"

namespace lightsketch {
namespace {

constexpr int kPictureWidth = 480;  // of suspects, pixels at most
constexpr int kPictures = 200;      // of suspects that are drawn, the worst first

// ColorBrewer 2 Set1 without green: told apart by any eye, on dark and on light.
QColor colourOf(FrameFault fault) {
  static const QColor kColours[] = {"#888888", "#e41a1c", "#ff7f00", "#377eb8", "#984ea3"};
  return kColours[static_cast<int>(fault)];
}

QString inWords(const FrameVerdict& verdict) {
  switch (verdict.fault) {
    case FrameFault::kNone:
      return {};
    case FrameFault::kShadow:
      return FramesPanel::tr(
                 "Something dark lies over %1 % of the picture, most likely your shadow.")
          .arg(100 * verdict.darkPart, 0, 'f', 0);
    case FrameFault::kExposure:
      return FramesPanel::tr(
                 "%1 times as bright as its neighbours say: the lamp or the exposure "
                 "jumped.")
          .arg(verdict.gain, 0, 'f', 2);
    case FrameFault::kDirection:
      return FramesPanel::tr("The picture fits a lamp %1\u00b0 away from where it was seen.")
          .arg(verdict.shift.degrees(), 0, 'f', 1);
    case FrameFault::kOther:
      return FramesPanel::tr(
          "Does not look like its neighbours: something moved, or got in the way.");
  }
  return {};
}

QString nameInWords(FrameFault fault) {
  switch (fault) {
    case FrameFault::kNone:
      return FramesPanel::tr("dropped before");
    case FrameFault::kShadow:
      return FramesPanel::tr("shadow");
    case FrameFault::kExposure:
      return FramesPanel::tr("brightness");
    case FrameFault::kDirection:
      return FramesPanel::tr("direction");
    case FrameFault::kOther:
      return FramesPanel::tr("other");
  }
  return {};
}

QIcon chip(const QColor& colour) {
  QPixmap pixmap(24, 24);
  pixmap.fill(Qt::transparent);
  QPainter painter(&pixmap);
  painter.setRenderHint(QPainter::Antialiasing);
  painter.setPen(Qt::NoPen);
  painter.setBrush(colour);
  painter.drawEllipse(4, 4, 16, 16);
  return pixmap;
}

}  // namespace

struct FramesPanel::Found {
  FrameCheck check;
  std::vector<FrameCheckPictures> pictures;
};

FramesPanel::FramesPanel(Workspace& workspace, Worker& worker, QWidget* parent)
    : QWidget(parent), workspace_(workspace), worker_(worker) {
  auto* column = new QVBoxLayout(this);
  auto* buttons = new QHBoxLayout;
  const auto button = [&](const char* name, const QString& text, const QString& tip) {
    auto* made = new QPushButton(text);
    made->setObjectName(name);
    made->setToolTip(tip);
    buttons->addWidget(made);
    return made;
  };
  check_ = button("checkFrames", tr("&Check frames"),
                  tr("Compares every frame with what its neighbours say it should look like, and "
                     "lists those that differ"));
  dropShadows_ =
      button("dropShadows", tr("Drop all &shadows"),
             tr("Leaves all frames with somebody's shadow out of the model; the pictures "
                "stay on disk"));
  dropAll_ = button("dropSuspects", tr("Drop &all listed"),
                    tr("Leaves all listed frames out of the model; the pictures stay on disk"));
  outcome_ = new QLabel;
  outcome_->setObjectName("checkOutcome");
  outcome_->setWordWrap(true);
  buttons->addSpacing(8);
  buttons->addWidget(outcome_, 1);
  column->addLayout(buttons);

  auto* splitter = new QSplitter;
  list_ = new QListWidget;
  list_->setObjectName("suspects");
  list_->setAccessibleName(tr("Frames that do not fit"));
  list_->setToolTip(tr("The worst first. Arrow keys go through them, D drops, K keeps"));
  list_->setAlternatingRowColors(true);
  splitter->addWidget(list_);
  auto* detail = new QWidget;
  auto* detailColumn = new QVBoxLayout(detail);
  detailColumn->setContentsMargins(8, 0, 0, 0);
  reason_ = new QLabel;
  reason_->setObjectName("suspectReason");
  reason_->setWordWrap(true);
  enlarge(reason_, 1.2);
  detailColumn->addWidget(reason_);
  pictures_ = new TripleView;
  pictures_->setObjectName("suspectPictures");
  detailColumn->addWidget(pictures_, 1);
  auto* choice = new QHBoxLayout;
  const auto decision = [&](const char* name, const QString& text, const QString& tip) {
    auto* made = new QPushButton(text);
    made->setObjectName(name);
    made->setToolTip(tip);
    made->setMinimumHeight(36);
    choice->addWidget(made);
    return made;
  };
  drop_ = decision("dropFrame", tr("Drop"),
                   tr("Leave this frame out of the model (D); its picture stays on disk"));
  keep_ = decision("keepFrame", tr("Keep"), tr("Use this frame (K)"));
  detailColumn->addLayout(choice);
  splitter->addWidget(detail);
  splitter->setStretchFactor(1, 1);
  splitter->setSizes({230, 620});
  column->addWidget(splitter, 1);

  connect(check_, &QPushButton::clicked, this, &FramesPanel::check);
  connect(list_, &QListWidget::currentRowChanged, this, &FramesPanel::show);
  connect(dropShadows_, &QPushButton::clicked, this, [this] {
    const auto ids = open(FrameFault::kShadow);
    dropFrames(workspace_, workspace_.sketch(), ids, "shadow, by the frame check",
               tr("Drop %1 shadowed frames").arg(ids.size()));
  });
  connect(dropAll_, &QPushButton::clicked, this, [this] {
    const auto ids = open(FrameFault::kNone);
    dropFrames(workspace_, workspace_.sketch(), ids, "unlike its neighbours, by the frame check",
               tr("Drop %1 frames").arg(ids.size()));
  });
  const auto current = [this] { return list_->currentRow(); };
  const auto advance = [this] {
    if (list_->currentRow() + 1 < list_->count()) list_->setCurrentRow(list_->currentRow() + 1);
  };
  connect(drop_, &QPushButton::clicked, this, [this, current, advance] {
    if (current() < 0 || suspects_[static_cast<std::size_t>(current())].dropped) return;
    const Suspect& suspect = suspects_[static_cast<std::size_t>(current())];
    dropFrames(workspace_, workspace_.sketch(), {suspect.id}, suspect.forJournal,
               tr("Drop frame %1").arg(suspect.id));
    advance();
  });
  connect(keep_, &QPushButton::clicked, this, [this, current, advance] {
    if (current() < 0) return;
    const Suspect& suspect = suspects_[static_cast<std::size_t>(current())];
    if (suspect.dropped) {
      restoreFrames(workspace_, workspace_.sketch(), {suspect.id}, suspect.forJournal,
                    tr("Keep frame %1").arg(suspect.id));
    }
    advance();
  });
  connect(new QShortcut(Qt::Key_D, this), &QShortcut::activated, drop_, &QPushButton::click);
  connect(new QShortcut(Qt::Key_K, this), &QShortcut::activated, keep_, &QPushButton::click);
  fill();
}

void FramesPanel::setSummary(const SketchSummary& summary, bool another) {
  summary_ = summary;
  if (another) {
    found_.clear();
    checked_ = false;
  }
  fill();
}

void FramesPanel::check() {
  if (task_) return task_->cancel();
  auto found = std::make_shared<Found>();
  const auto folder = workspace_.sketch();
  task_ = workspace_.run(
      tr("Check frames"),
      [found, folder](Progress& progress, std::stop_token) -> Result<JobResult> {
        ASSIGN_OR_RETURN(const auto sketch, Sketch::open(folder));
        ASSIGN_OR_RETURN(const auto stack, LightStack::create(sketch, sketch.activeFrames()));
        ASSIGN_OR_RETURN(found->check, checkFrames(stack, {}, progress));
        FrameCheckReportOptions options;
        options.pictures = kPictures;
        options.width = kPictureWidth;
        ASSIGN_OR_RETURN(found->pictures,
                         frameCheckPictures(stack, found->check, options, progress));
        return JobResult{{}, found->check.toJson()};
      });
  connect(task_, &Task::finished, this, [this, found, folder, task = task_] {
    task_ = nullptr;
    check_->setText(tr("&Check frames"));
    if (task->result() && folder == workspace_.sketch()) take(*found);
  });
  check_->setText(tr("Cancel"));
}

void FramesPanel::take(const Found& found) {
  found_.clear();
  checked_ = true;
  for (const int i : found.check.bad()) {
    const FrameVerdict& verdict = found.check.frames[static_cast<std::size_t>(i)];
    Suspect suspect;
    suspect.id = verdict.id;
    suspect.fault = verdict.fault;
    suspect.reason = inWords(verdict);
    suspect.forJournal = verdict.reason();
    const auto at = std::ranges::find(found.pictures, i, &FrameCheckPictures::frame);
    if (at != found.pictures.end()) {
      suspect.captured = toQImage(at->captured);
      suspect.predicted = toQImage(at->predicted);
      suspect.ratio = toQImage(at->ratio);
    }
    found_.push_back(std::move(suspect));
  }
  fill();
  if (list_->count() > 0) list_->setCurrentRow(0);
  list_->setFocus();
}

void FramesPanel::fill() {
  const int row = list_->currentRow();
  const int id = row < 0 ? -1 : suspects_[static_cast<std::size_t>(row)].id;
  suspects_ = found_;
  for (const SketchSummary::Frame& frame : summary_.frames) {
    const auto known = std::ranges::find(suspects_, frame.id, &Suspect::id);
    if (known != suspects_.end()) {
      known->dropped = frame.dropped;
    } else if (frame.dropped) {
      Suspect suspect;
      suspect.id = frame.id;
      suspect.forJournal =
          frame.dropReason.isEmpty() ? "dropped by hand" : frame.dropReason.toStdString();
      suspect.reason = tr("Dropped: %1.").arg(frame.dropReason);
      suspect.dropped = true;
      suspects_.push_back(std::move(suspect));
    }
  }
  {
    const QSignalBlocker quiet(list_);
    list_->clear();
    for (const Suspect& suspect : suspects_) {
      auto* item = new QListWidgetItem(
          chip(colourOf(suspect.fault)),
          tr("Frame %1 \u2013 %2%3")
              .arg(suspect.id)
              .arg(nameInWords(suspect.fault), suspect.dropped && suspect.fault != FrameFault::kNone
                                                   ? tr(", dropped")
                                                   : QString()),
          list_);
      item->setToolTip(suspect.reason);
      if (suspect.dropped) {
        QFont font = item->font();
        font.setStrikeOut(true);
        item->setFont(font);
      }
    }
    const auto at = std::ranges::find(suspects_, id, &Suspect::id);
    if (at != suspects_.end()) list_->setCurrentRow(static_cast<int>(at - suspects_.begin()));
  }
  show(list_->currentRow());
  updateButtons();
}

void FramesPanel::updateButtons() {
  const auto waiting = open(FrameFault::kNone).size();
  const auto shadows = open(FrameFault::kShadow).size();
  check_->setEnabled(summary_.active > 0);
  dropShadows_->setEnabled(shadows > 0);
  dropAll_->setEnabled(waiting > 0);
  if (summary_.frames.empty()) {
    outcome_->setText({});
  } else if (!checked_) {
    outcome_->setText(tr("Finds your shadow, jumps of brightness and wrong directions."));
  } else if (found_.empty()) {
    outcome_->setText(tr("Every frame fits its neighbours."));
  } else if (waiting == 0) {
    outcome_->setText(tr("Nothing listed is in use any more."));
  } else {
    outcome_->setText(tr("%1 of the frames in use do not fit their neighbours.").arg(waiting));
  }
  Q_EMIT suspectsChanged(static_cast<int>(waiting));
}

std::vector<int> FramesPanel::open(FrameFault fault) const {
  std::vector<int> ids;
  for (const Suspect& suspect : suspects_) {
    if (!suspect.dropped && (fault == FrameFault::kNone || suspect.fault == fault))
      ids.push_back(suspect.id);
  }
  return ids;
}

void FramesPanel::show(int row) {
  const bool any = row >= 0 && row < static_cast<int>(suspects_.size());
  drop_->setEnabled(any && !suspects_[static_cast<std::size_t>(row)].dropped);
  keep_->setEnabled(any);
  worker_.withdraw("suspect");
  if (!any) {
    reason_->setText({});
    pictures_->setCaptions({}, {}, {});
    pictures_->setPictures({}, {}, {});
    pictures_->setPlaceholder(
        summary_.frames.empty() ? tr("No sketch yet. Record one on the Sketch page, or open one.")
        : checked_ && found_.empty()
            ? tr("Every frame fits its neighbours. Go on to Develop.")
            : tr("Check the frames once after recording: one frame with your shadow in it shows as "
                 "a stain under every light near it."));
    return;
  }
  const Suspect& suspect = suspects_[static_cast<std::size_t>(row)];
  reason_->setText(tr("<b>Frame %1.</b> %2").arg(suspect.id).arg(suspect.reason.toHtmlEscaped()));
  pictures_->setCaptions(
      tr("captured"), suspect.predicted.isNull() ? QString() : tr("as its neighbours say"),
      suspect.ratio.isNull() ? QString() : tr("blue: too dark, red: too bright"));
  pictures_->setPlaceholder({});
  pictures_->setPictures(suspect.captured, suspect.predicted, suspect.ratio);
  Q_EMIT frameShown(suspect.id);
  if (suspect.captured.isNull()) {
    worker_.ask("suspect",
                [this, folder = workspace_.sketch(), id = suspect.id,
                 exposure = exposure_](const std::stop_token&) -> Worker::Show {
                  const auto image = frameImage(folder, id, exposure);
                  if (!image) return {};
                  return [this, image = *image] { pictures_->view(0)->setPicture(image); };
                });
  }
}

}  // namespace lightsketch
