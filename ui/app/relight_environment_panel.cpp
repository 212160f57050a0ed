#include "ui/app/relight_environment_panel.h"

#include <QFileDialog>
#include <QFileInfo>
#include <QHBoxLayout>
#include <QKeyEvent>
#include <QMouseEvent>
#include <QPainter>
#include <QVBoxLayout>
#include <algorithm>
#include <cmath>
#include <vector>

#include "capture/frame/median.h"
#include "pipeline/sketch/image_file.h"
#include "pipeline/validate/validate.h"

namespace lightsketch {
namespace {

constexpr double kTurnSeconds = 24;
constexpr auto kLastMap = "relight/environment";

double wrapped(double degrees) { return degrees - 360 * std::floor(degrees / 360); }

// Small, and as bright as one sees it: half of the map below a middle grey.
QImage previewOf(const RadianceImage& map) {
  constexpr int kWidth = 512;
  const int step = std::max(1, map.width() / kWidth);
  RadianceImage small(map.width() / step, map.height() / step, 3);
  std::vector<float> levels;
  for (int y = 0; y < small.height(); ++y) {
    for (int x = 0; x < small.width(); ++x) {
      for (int c = 0; c < 3; ++c) small(x, y, c) = map(x * step, y * step, c);
      levels.push_back(small(x, y, 1));
    }
  }
  return screenImage(small, 0.2f / std::max(median(levels), 1e-6f), Tone::kSoft);
}

}  // namespace

EnvironmentStrip::EnvironmentStrip(QWidget* parent) : QWidget(parent) {
  setFocusPolicy(Qt::StrongFocus);
  setCursor(Qt::SizeHorCursor);
  setSizePolicy(QSizePolicy::Expanding, QSizePolicy::Fixed);
  setFixedHeight(130);
}

void EnvironmentStrip::setPicture(const QImage& picture) {
  picture_ = picture;
  scaled_ = {};
  update();
}

void EnvironmentStrip::setYaw(double degrees) {
  yaw_ = degrees;
  update();
}

void EnvironmentStrip::paintEvent(QPaintEvent*) {
  QPainter painter(this);
  if (picture_.isNull()) {
    painter.fillRect(rect(), palette().color(QPalette::Base));
    return;
  }
  if (scaled_.width() != width()) {
    scaled_ = QPixmap::fromImage(
        picture_.scaled(size(), Qt::IgnoreAspectRatio, Qt::SmoothTransformation));
  }
  // A turn from +z towards +x moves what was in the middle to the left, where +x is drawn.
  const int shift = qRound(yaw_ / 360 * width());
  painter.drawPixmap(-shift, 0, scaled_);
  painter.drawPixmap(width() - shift, 0, scaled_);
  painter.setPen(QPen(palette().color(QPalette::Highlight), 1));
  painter.drawLine(width() / 2, 0, width() / 2, 6);
  painter.drawLine(width() / 2, height() - 7, width() / 2, height() - 1);
  if (hasFocus()) painter.drawRect(rect().adjusted(0, 0, -1, -1));
}

void EnvironmentStrip::mousePressEvent(QMouseEvent* event) { lastX_ = event->position().x(); }

void EnvironmentStrip::mouseMoveEvent(QMouseEvent* event) {
  const double by = event->position().x() - lastX_;
  lastX_ = event->position().x();
  Q_EMIT turned(-by / width() * 360);
}

void EnvironmentStrip::keyPressEvent(QKeyEvent* event) {
  if (event->key() == Qt::Key_Left) {
    Q_EMIT turned(2);
  } else if (event->key() == Qt::Key_Right) {
    Q_EMIT turned(-2);
  } else {
    QWidget::keyPressEvent(event);
  }
}

EnvironmentPanel::EnvironmentPanel(Workspace& workspace, QWidget* parent)
    : RelightPanel(workspace, parent) {
  auto* column = new QVBoxLayout(this);
  column->setContentsMargins(0, 0, 0, 0);
  name_ = new QLabel;
  name_->setWordWrap(true);
  column->addWidget(name_);
  strip_ = new EnvironmentStrip;
  strip_->setObjectName("strip");
  strip_->setAccessibleName(tr("Environment"));
  strip_->setToolTip(
      tr("The whole surroundings. Drag, or drag the picture itself: what stands in "
         "the middle shines from the front, what is left and right of it from the "
         "sides, the ends from behind."));
  column->addWidget(strip_);
  angle_ =
      addSlider(*column, tr("Turn"), tr("Turns the surroundings around the object"), 0, 359, 0);
  turning_ = new QCheckBox(tr("Turns by &itself"));
  turning_->setToolTip(tr("Let the surroundings wander round the object (Space)"));
  column->addWidget(turning_);
  auto* row = new QHBoxLayout;
  auto* choose = new QPushButton(tr("Open map..."));
  choose->setToolTip(
      tr("A lat-long panorama with real brightness, twice as wide as high: .exr or "
         ".hdr. Or drop the file onto the window."));
  auto* sky = new QPushButton(tr("Built-in sky"));
  sky->setToolTip(tr("Blue overhead, a warm horizon, a soft sun"));
  row->addWidget(choose);
  row->addWidget(sky);
  column->addLayout(row);
  column->addStretch(1);

  connect(choose, &QPushButton::clicked, this, &EnvironmentPanel::choose);
  connect(sky, &QPushButton::clicked, this, [this] { open({}); });
  connect(strip_, &EnvironmentStrip::turned, this, [this](double by) { setYaw(yaw_ + by); });
  connect(angle_, &QSlider::valueChanged, this, [this](int value) { setYaw(value); });
  connect(turning_, &QCheckBox::toggled, this, &RelightPanel::changed);
}

void EnvironmentPanel::entered() {
  if (map_ || preparing_ > 0) return;
  const std::filesystem::path last = toPath(workspace().settings().value(kLastMap).toString());
  open(std::filesystem::exists(last) ? last : std::filesystem::path());
}

void EnvironmentPanel::choose() {
  const QString folder = QFileInfo(workspace().settings().value(kLastMap).toString()).path();
  const QString file = QFileDialog::getOpenFileName(this, tr("Environment map"), folder,
                                                    tr("Lat-long maps (*.exr *.hdr)"));
  if (!file.isEmpty()) open(toPath(file));
}

void EnvironmentPanel::open(const std::filesystem::path& file) {
  ++preparing_;
  workspace().fetch(
      file.empty() ? tr("Make the sky") : tr("Open %1").arg(toQString(file.filename())), this,
      [file]() -> Result<RadianceImage> {
        if (file.empty()) return analyticSky();
        ASSIGN_OR_RETURN(RadianceImage map, readImage(file));
        // Refused here rather than when it is to light something.
        const std::vector<Eigen::Vector3d> any{Eigen::Vector3d::UnitZ()};
        ASSIGN_OR_RETURN(const auto tried, TurnableEnvironment::create(map, any));
        (void)tried;
        return map;
      },
      [this, file, asked = preparing_](RadianceImage map) {
        if (asked != preparing_) return;
        file_ = file;
        map_ = std::make_shared<RadianceImage>(std::move(map));
        workspace().settings().setValue(kLastMap, toQString(file));
        name_->setText(file.empty() ? tr("Built-in sky") : toQString(file.filename()));
        strip_->setPicture(previewOf(*map_));
        prepare();
      });
}

void EnvironmentPanel::setScene(std::shared_ptr<const RelightScene> scene) {
  RelightPanel::setScene(std::move(scene));
  environment_.reset();
  if (map_) prepare();
}

void EnvironmentPanel::prepare() {
  if (!scene() || scene()->model->singleLamp) return;
  ++preparing_;
  workspace().fetch(
      tr("Put the map around the model"), this,
      [map = map_, model = scene()->model] {
        return TurnableEnvironment::create(*map, model->lights);
      },
      [this, asked = preparing_](TurnableEnvironment environment) {
        if (asked != preparing_) return;
        environment_ = std::move(environment);
        Q_EMIT renewed();
      });
}

std::optional<LightIntensities> EnvironmentPanel::light() {
  if (!environment_) return std::nullopt;
  LightIntensities out;
  environment_->intensities(yaw_, out);
  return out;
}

void EnvironmentPanel::setYaw(double degrees) {
  const double yaw = wrapped(degrees);
  if (yaw == yaw_) return;
  yaw_ = yaw;
  strip_->setYaw(yaw_);
  const QSignalBlocker quiet(angle_);
  angle_->setValue(static_cast<int>(yaw_));
  Q_EMIT changed();
}

// What is near the object follows the pointer: to the right is from the left side of the
// surroundings to the front.
void EnvironmentPanel::drag(QPointF by) { setYaw(yaw_ + 90 * by.x()); }

void EnvironmentPanel::advance(double seconds) { setYaw(yaw_ + 360 * seconds / kTurnSeconds); }

std::optional<Film> EnvironmentPanel::film() const {
  if (!environment_) return std::nullopt;
  return Film{kTurnSeconds, [environment = *environment_, from = yaw_](double seconds) {
                LightIntensities out;
                environment.intensities(from + 360 * seconds / kTurnSeconds, out);
                return out;
              }};
}

}  // namespace lightsketch
