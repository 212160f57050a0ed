#include "ui/app/relight_path_panel.h"

#include <QFileDialog>
#include <QHBoxLayout>
#include <QVBoxLayout>
#include <algorithm>
#include <cmath>

namespace lightsketch {
namespace {

constexpr int kTicks = 1000;  // of the time slider
constexpr int kDouble = 10;   // steps of the speed slider to twice the speed

}  // namespace

PathPanel::PathPanel(Workspace& workspace, QWidget* parent) : RelightPanel(workspace, parent) {
  auto* column = new QVBoxLayout(this);
  column->setContentsMargins(0, 0, 0, 0);
  name_ = explained({});
  column->addWidget(name_);
  hemisphere_ = new HemisphereView;
  hemisphere_->setMinimumHeight(190);
  hemisphere_->setAccessibleName(tr("Path of the lamp"));
  column->addWidget(hemisphere_, 1);
  time_ = addSlider(*column, tr("Time"), tr("Where on its path the lamp is"), 0, kTicks, 0);
  time_->setObjectName("pathTime");
  speed_ = addSlider(*column, tr("Speed"), tr("From an eighth to eight times as fast"),
                     -3 * kDouble, 3 * kDouble, 0);
  auto* row = new QHBoxLayout;
  play_ = new QPushButton(tr("Play"));
  play_->setObjectName("play");
  play_->setCheckable(true);
  play_->setToolTip(tr("Let the lamp move along its path, again and again (Space)"));
  auto* choose = new QPushButton(tr("Open lights..."));
  choose->setToolTip(tr("A lights file (.json): its lamps one after the other, two a second"));
  auto* own = new QPushButton(tr("Sketch's path"));
  own->setToolTip(tr("The way the lamp went when the pictures were taken"));
  for (QPushButton* button : {play_, choose, own}) row->addWidget(button);
  column->addLayout(row);

  connect(play_, &QPushButton::toggled, this, [this](bool on) {
    play_->setText(on ? tr("Pause") : tr("Play"));
    Q_EMIT changed();
  });
  connect(time_, &QSlider::valueChanged, this,
          [this](int value) { seek(path_.seconds() * value / kTicks); });
  connect(own, &QPushButton::clicked, this, &PathPanel::useSketch);
  connect(choose, &QPushButton::clicked, this, [this] {
    const QString file = QFileDialog::getOpenFileName(
        this, tr("Lights"), this->workspace().settings().value("folder").toString(),
        tr("Lights files (*.json)"));
    if (!file.isEmpty()) open(toPath(file));
  });
}

void PathPanel::setScene(std::shared_ptr<const RelightScene> scene) {
  RelightPanel::setScene(std::move(scene));
  std::vector<HemisphereView::Dot> dots;
  if (const auto& now = this->scene()) {
    for (const auto& direction : now->model->capturedDirections) {
      dots.push_back({direction, QColor(128, 128, 128, 150), 1.3});
    }
  }
  hemisphere_->setDots(std::move(dots));
  if (ownPath_) useSketch();
}

void PathPanel::useSketch() {
  ownPath_ = true;
  setPath({}, tr("The model's sketch is not here. Open a lights file to let a lamp move."));
  if (!scene()) return;
  std::filesystem::path folder = scene()->model->sketch;
  if (!std::filesystem::exists(folder / "sketch.json")) folder = workspace().sketch();
  if (folder.empty()) return;
  workspace().fetch(
      tr("Read the lamp's path"), this,
      [folder]() -> Result<LightPath> {
        ASSIGN_OR_RETURN(const auto sketch, Sketch::open(folder));
        return LightPath::ofSketch(sketch);
      },
      [this, folder, model = scene()->model](LightPath path) {
        if (!scene() || scene()->model != model || !ownPath_ || path.empty()) return;
        setPath(std::move(path),
                tr("The lamp's path while %1 was recorded").arg(toQString(folder.filename())));
      });
}

void PathPanel::open(const std::filesystem::path& file) {
  const auto lamps = readLights(file);
  if (!lamps) {
    workspace().say({"relight/lights", Workspace::Level::kError,
                     QString::fromStdString(lamps.error().message)});
    return;
  }
  ownPath_ = false;
  setPath(LightPath::ofLamps(*lamps), toQString(file.filename()));
}

void PathPanel::setPath(LightPath path, const QString& name) {
  path_ = std::move(path);
  seconds_ = 0;
  name_->setText(name);
  std::vector<Eigen::Vector3d> curve;
  for (const auto& point : path_.points()) curve.push_back(point.lamp.direction);
  hemisphere_->setPath(std::move(curve), palette().color(QPalette::Highlight));
  play_->setEnabled(!path_.empty());
  time_->setEnabled(!path_.empty());
  if (path_.empty()) play_->setChecked(false);
  show();
  Q_EMIT renewed();
}

void PathPanel::show() {
  if (path_.empty()) {
    hemisphere_->setHandles({});
    return;
  }
  hemisphere_->setHandles({{path_.at(seconds_).direction, Qt::white}});
  const QSignalBlocker quiet(time_);
  time_->setValue(
      path_.seconds() > 0 ? static_cast<int>(std::lround(seconds_ / path_.seconds() * kTicks)) : 0);
}

void PathPanel::seek(double seconds) {
  if (path_.empty()) return;
  seconds_ = std::clamp(seconds, 0.0, path_.seconds());
  show();
  Q_EMIT changed();
}

std::optional<LightIntensities> PathPanel::light() {
  if (!scene() || path_.empty()) return std::nullopt;
  const DirectionalLamp lamp = path_.at(seconds_);
  const DiscLamp disc{lamp.direction, lamp.colour, Angle()};
  return scene()->intensitiesOf({&disc, 1});
}

void PathPanel::drag(QPointF by) { seek(seconds_ + by.x() / 4 * path_.seconds()); }

void PathPanel::advance(double seconds) {
  if (path_.seconds() <= 0) return;
  const double to = seconds_ + seconds * std::exp2(static_cast<double>(speed_->value()) / kDouble);
  seek(std::fmod(to, path_.seconds()));
}

std::optional<Film> PathPanel::film() const {
  if (!scene() || path_.seconds() <= 0) return std::nullopt;
  const double speed = std::exp2(static_cast<double>(speed_->value()) / kDouble);
  return Film{path_.seconds() / speed, [scene = scene(), path = path_, speed](double seconds) {
                const DirectionalLamp lamp = path.at(seconds * speed);
                const DiscLamp disc{lamp.direction, lamp.colour, Angle()};
                return scene->intensitiesOf({&disc, 1});
              }};
}

}  // namespace lightsketch
