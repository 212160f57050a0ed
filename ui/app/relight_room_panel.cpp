#include "ui/app/relight_room_panel.h"

#include <QVBoxLayout>
#include <numbers>

#include "calibration/lens/camera_formats.h"
#include "calibration/model/rig_geometry.h"
#include "pipeline/hdr/linearise.h"

namespace lightsketch {

RoomPanel::RoomPanel(Workspace& workspace, QWidget* parent) : RelightPanel(workspace, parent) {
  auto* column = new QVBoxLayout(this);
  column->setContentsMargins(0, 0, 0, 0);
  column->addWidget(explained(
      tr("The source camera looks at the room, and the room's own light falls into the picture: "
         "walk past, hold a torch, open a curtain.")));
  view_ = new FrameView(workspace.rig().sourceView());
  view_->setPlaceholder(tr("No camera"));
  column->addWidget(view_, 1);
  state_ = new QLabel;
  state_->setWordWrap(true);
  state_->setObjectName("roomState");
  column->addWidget(state_);
  compensate_ = new QCheckBox(tr("&Ignore the camera's exposure"));
  compensate_->setChecked(true);
  compensate_->setToolTip(
      tr("A longer exposure makes the camera's picture brighter, not the room. "
         "On, the relit picture stays as it is when exposure or gain change."));
  column->addWidget(compensate_);
  column->addStretch(1);

  connect(&workspace.rig().sourceView(), &LiveView::pictureReady, this, &RoomPanel::frameCame);
  connect(&workspace.rig(), &RigLink::stateChanged, this, &RoomPanel::tell);
  connect(&workspace.rig(), &RigLink::setupChanged, this, [this] {
    room_.reset();
    trouble_.clear();
    tell();
  });
  connect(compensate_, &QCheckBox::toggled, this, &RelightPanel::changed);
}

void RoomPanel::entered() {
  active_ = true;
  first_ = true;
  workspace().rig().watch(true);
  tell();
}

void RoomPanel::left() {
  if (!std::exchange(active_, false)) return;
  workspace().rig().watch(false);
}

void RoomPanel::setScene(std::shared_ptr<const RelightScene> scene) {
  RelightPanel::setScene(std::move(scene));
  room_.reset();
  trouble_.clear();
}

// Where the camera stands comes from the rig's file; without one it looks at the viewer from the
// subject's place, as `record` takes it.
void RoomPanel::prepare() {
  if (preparing_ || !scene() || scene()->model->singleLamp || !trouble_.isEmpty()) return;
  preparing_ = true;
  auto made = std::make_shared<std::optional<FisheyeLight>>();
  Task* task = workspace().run(
      tr("Put the room around the model"),
      [made, model = scene()->model, lens = workspace().rig().sourceModel(),
       geometry = workspace().rig().rigGeometry()](Progress&,
                                                   std::stop_token) -> Result<JobResult> {
        if (lens.empty()) {
          return failure(
              ErrorCode::kInvalidArgument,
              "the source camera's lens is not calibrated; do that on the Calibrate page");
        }
        ASSIGN_OR_RETURN(const auto camera, loadAnyCameraModel(lens));
        Eigen::Isometry3d pose = uprightAtSubject();
        if (!geometry.empty()) {
          ASSIGN_OR_RETURN(const auto rig, loadRigGeometry(geometry));
          if (!rig.sourceCameras.empty()) pose = rig.sourceCameras.front().sceneFromCamera;
        }
        ASSIGN_OR_RETURN(*made, FisheyeLight::create(*camera.model, pose, model->lights));
        return JobResult{};
      });
  connect(task, &Task::finished, this, [this, task, made, model = scene()->model] {
    preparing_ = false;
    if (!scene() || scene()->model != model) return;
    if (task->result()) {
      room_ = *made;
    } else {
      trouble_ = QString::fromStdString(task->result().error().message);
    }
    tell();
  });
}

void RoomPanel::frameCame() {
  const auto frame = workspace().rig().sourceView().frame();
  if (!active_ || !frame) return;
  if (!room_) return prepare();
  if (!reference_) reference_ = frame->metadata;
  if (std::exchange(first_, false)) {
    tell();
    Q_EMIT renewed();
  } else {
    Q_EMIT changed();
  }
}

std::optional<LightIntensities> RoomPanel::light() {
  const auto frame = workspace().rig().sourceView().frame();
  if (!room_ || !frame || !reference_) return std::nullopt;
  double radiance = 1;
  if (compensate_->isChecked()) {
    // A camera that does not tell its exposure cannot be compensated for.
    radiance = referenceScale(frame->metadata, reference_->exposureSeconds, reference_->gainDb)
                   .value_or(1);
  }
  LightIntensities out;
  if (auto done = room_->intensities(*frame, radiance, out); !done) {
    trouble_ = QString::fromStdString(done.error().message);
    room_.reset();
    tell();
    return std::nullopt;
  }
  return out;
}

void RoomPanel::tell() {
  const RigLink& rig = workspace().rig();
  if (!trouble_.isEmpty()) {
    state_->setText(trouble_);
  } else if (rig.state() == RigLink::State::kFailed) {
    state_->setText(rig.trouble());
  } else if (rig.state() == RigLink::State::kOpening) {
    state_->setText(tr("Opening the cameras..."));
  } else if (room_) {
    state_->setText(tr("%1 % of the half sphere in sight")
                        .arg(qRound(100 * room_->coveredSolidAngle() / (2 * std::numbers::pi))));
  } else {
    state_->clear();
  }
}

}  // namespace lightsketch
