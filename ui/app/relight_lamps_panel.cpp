#include "ui/app/relight_lamps_panel.h"

#include <QColorDialog>
#include <QHBoxLayout>
#include <QMenu>
#include <QPainter>
#include <QToolButton>
#include <QUndoCommand>
#include <QVBoxLayout>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "capture/frame/srgb.h"

namespace lightsketch {
namespace {

using Eigen::Vector3d;
using std::numbers::pi;

constexpr int kStop = 20;  // steps of the brightness slider to a factor of two
constexpr double kDegree = pi / 180;

class ChangeLamps final : public QUndoCommand {
 public:
  ChangeLamps(LampsPanel& panel, const QString& name, std::vector<LampsPanel::Lamp> lamps,
              int gesture)
      : QUndoCommand(name),
        panel_(panel),
        before_(panel.lamps()),
        after_(std::move(lamps)),
        gesture_(gesture) {}

  void undo() override { panel_.setLamps(before_); }
  void redo() override { panel_.setLamps(after_); }
  int id() const override { return 1; }
  bool mergeWith(const QUndoCommand* other) override {
    const auto* next = dynamic_cast<const ChangeLamps*>(other);
    if (!next || gesture_ == 0 || next->gesture_ != gesture_) return false;
    after_ = next->after_;
    return true;
  }

 private:
  LampsPanel& panel_;
  std::vector<LampsPanel::Lamp> before_;
  std::vector<LampsPanel::Lamp> after_;
  int gesture_;
};

Vector3d linear(const QColor& colour) {
  return {srgbDecode(colour.redF()), srgbDecode(colour.greenF()), srgbDecode(colour.blueF())};
}

// Height above the horizon and the way round, clockwise from above, as words.
QString placeOf(const Vector3d& direction) {
  const double height = std::asin(std::clamp(direction.z(), -1.0, 1.0)) / kDegree;
  const double around = std::atan2(direction.x(), direction.y()) / kDegree;
  return LampsPanel::tr("%1\u00b0 above the surface, at %2 o'clock")
      .arg(qRound(height))
      .arg((qRound(around / 30) + 11) % 12 + 1);
}

Vector3d at(double aroundDegrees, double heightDegrees) {
  const double across = std::cos(heightDegrees * kDegree);
  return {across * std::sin(aroundDegrees * kDegree), across * std::cos(aroundDegrees * kDegree),
          std::sin(heightDegrees * kDegree)};
}

}  // namespace

LampsPanel::LampsPanel(Workspace& workspace, QWidget* parent) : RelightPanel(workspace, parent) {
  auto* column = new QVBoxLayout(this);
  column->setContentsMargins(0, 0, 0, 0);

  hemisphere_ = new HemisphereView;
  hemisphere_->setObjectName("hemisphere");
  hemisphere_->setMinimumHeight(190);
  hemisphere_->setToolTip(tr(
      "The lamps as one sees them standing before the object: in the middle light falls straight "
      "on it, at the rim it grazes the surface. Drag a lamp, or click it and use the arrow "
      "keys. Small dots are directions that were photographed."));
  hemisphere_->setAccessibleName(tr("Lamps on the hemisphere"));
  column->addWidget(hemisphere_, 1);
  place_ = explained({});
  place_->setAlignment(Qt::AlignCenter);
  column->addWidget(place_);

  auto* row = new QHBoxLayout;
  addButton_ = new QPushButton(tr("Add"));
  addButton_->setToolTip(tr("One more lamp (Insert)"));
  addButton_->setObjectName("addLamp");
  removeButton_ = new QPushButton(tr("Remove"));
  removeButton_->setToolTip(tr("Take the chosen lamp away (Delete); Ctrl+Z brings it back"));
  auto* presets = new QPushButton(tr("Arrange"));
  presets->setToolTip(tr("Lamps as photographers place them, to begin with"));
  auto* menu = new QMenu(presets);
  const auto preset = [&](const QString& name, const QString& tip, std::vector<Lamp> lamps) {
    QAction* action = menu->addAction(name, this, [this, name, lamps = std::move(lamps)] {
      change(name, lamps);
      select(0);
      Q_EMIT renewed();
    });
    action->setToolTip(tip);
  };
  menu->setToolTipsVisible(true);
  preset(tr("One lamp"), tr("From the upper left, as drawings are lit"), {Lamp{}});
  preset(tr("Raking light"),
         tr("Low from the side: relief, tool marks and brush strokes stand out"),
         {{at(-75, 12), Qt::white, 1, 0}});
  preset(tr("Key, fill and rim"),
         tr("A warm lamp, a soft cool one against it, a low one from behind"), threeLamps());
  preset(tr("Soft from all sides"), tr("Large lamps all round: colour without shadows"),
         {{at(-45, 50), Qt::white, 0.6, 35},
          {at(75, 50), Qt::white, 0.6, 35},
          {at(195, 50), Qt::white, 0.6, 35}});
  preset(tr("Three colours"),
         tr("Red, green and blue low from three sides: slopes turn into colours"),
         {{at(-90, 25), QColor(255, 90, 80), 1, 3},
          {at(30, 25), QColor(90, 255, 110), 1, 3},
          {at(150, 25), QColor(90, 130, 255), 1, 3}});
  presets->setMenu(menu);
  for (QPushButton* button : {addButton_, removeButton_, presets}) row->addWidget(button);
  column->addLayout(row);

  colour_ = new QPushButton(tr("Colour"));
  colour_->setToolTip(tr("The chosen lamp's colour"));
  column->addWidget(colour_);
  brightness_ = addSlider(*column, tr("Brightness"),
                          tr("Of the chosen lamp; each fifth of the way "
                             "doubles it"),
                          -5 * kStop, 2 * kStop, 0);
  size_ = addSlider(*column, tr("Size"),
                    tr("How large the chosen lamp is, seen from the object: a point casts hard "
                       "shadows, a large lamp soft ones. Its light stays the same in sum."),
                    0, 45, 0);
  orbit_ = new QCheckBox(tr("Lamps go &round"));
  orbit_->setObjectName("orbit");
  orbit_->setToolTip(
      tr("Let the lamps circle around the object (Space). Good as a screen-saver, "
         "and to see relief."));
  column->addWidget(orbit_);

  connect(addButton_, &QPushButton::clicked, this, &LampsPanel::add);
  connect(removeButton_, &QPushButton::clicked, this, &LampsPanel::removeSelected);
  connect(colour_, &QPushButton::clicked, this, &LampsPanel::chooseColour);
  connect(hemisphere_, &HemisphereView::handleSelected, this, [this] {
    ++gesture_;
    showSelected();
  });
  connect(hemisphere_, &HemisphereView::handleMoved, this, [this](int, const Vector3d& direction) {
    edit(tr("Move a lamp"), [&](Lamp& lamp) { lamp.direction = direction; });
  });
  connect(brightness_, &QSlider::valueChanged, this, [this](int value) {
    edit(tr("Brightness of a lamp"),
         [&](Lamp& lamp) { lamp.brightness = std::exp2(static_cast<double>(value) / kStop); });
  });
  connect(size_, &QSlider::valueChanged, this, [this](int value) {
    edit(tr("Size of a lamp"), [&](Lamp& lamp) { lamp.radiusDegrees = value; });
  });
  for (QSlider* slider : {brightness_, size_}) {
    connect(slider, &QSlider::sliderPressed, this, [this] { ++gesture_; });
  }
  connect(orbit_, &QCheckBox::toggled, this, &RelightPanel::changed);
  lamps_ = {Lamp{}};
  showLamps();
  select(0);
}

std::vector<LampsPanel::Lamp> LampsPanel::threeLamps() {
  const QColor warm(255, 226, 190);
  const QColor cool(190, 215, 255);
  return {
      {at(-50, 45), warm, 1, 4}, {at(70, 40), cool, 0.35, 25}, {at(165, 15), Qt::white, 0.6, 2}};
}

void LampsPanel::setScene(std::shared_ptr<const RelightScene> scene) {
  RelightPanel::setScene(std::move(scene));
  std::vector<HemisphereView::Dot> dots;
  bool below = false;
  if (const auto& now = this->scene()) {
    for (const Vector3d& direction : now->model->capturedDirections) {
      dots.push_back({direction, QColor(128, 128, 128, 150), 1.3});
      below |= direction.z() < -0.05;
    }
  }
  hemisphere_->setDots(std::move(dots));
  hemisphere_->setWholeSphere(below);
  const bool one = this->scene() && this->scene()->model->singleLamp;
  if (one && lamps_.size() > 1) setLamps({lamps_.front()});
  size_->setEnabled(!one);
  showSelected();
}

std::vector<DiscLamp> LampsPanel::discs() const {
  std::vector<DiscLamp> discs;
  for (const Lamp& lamp : lamps_) {
    discs.push_back({lamp.direction, lamp.brightness * linear(lamp.colour),
                     Angle::degrees(lamp.radiusDegrees)});
  }
  return discs;
}

std::optional<LightIntensities> LampsPanel::light() {
  if (!scene()) return std::nullopt;
  return scene()->intensitiesOf(discs());
}

void LampsPanel::drag(QPointF by) {
  const int lamp = selected();
  if (lamp < 0) return;
  // On the flat picture of the hemisphere, as if the lamp itself were dragged there.
  const Vector3d& from = lamps_[static_cast<std::size_t>(lamp)].direction;
  const double across = std::hypot(from.x(), from.y());
  const double angle = std::atan2(across, from.z()) / (pi / 2);
  Eigen::Vector2d place =
      across > 1e-9 ? Eigen::Vector2d(angle * from.head<2>() / across) : Eigen::Vector2d::Zero();
  place += Eigen::Vector2d(by.x(), by.y());
  if (place.norm() > 0.999) place *= 0.999 / place.norm();
  const double to = place.norm() * pi / 2;
  Vector3d direction = Vector3d::UnitZ();
  if (to > 1e-9) direction << std::sin(to) * place.normalized(), std::cos(to);
  edit(tr("Move a lamp"), [&](Lamp& moved) { moved.direction = direction; });
}

void LampsPanel::advance(double seconds) {
  auto discs = this->discs();
  orbit(discs, seconds);
  for (std::size_t i = 0; i < lamps_.size(); ++i) lamps_[i].direction = discs[i].direction;
  showLamps();
  Q_EMIT changed();
}

std::optional<Film> LampsPanel::film() const {
  if (!scene()) return std::nullopt;
  return Film{kOrbitSeconds, [scene = scene(), lamps = discs()](double seconds) {
                auto now = lamps;
                orbit(now, seconds);
                return scene->intensitiesOf(now);
              }};
}

void LampsPanel::change(const QString& name, std::vector<Lamp> lamps, int gesture) {
  workspace().undo().push(new ChangeLamps(*this, name, std::move(lamps), gesture));
}

void LampsPanel::setLamps(std::vector<Lamp> lamps) {
  lamps_ = std::move(lamps);
  showLamps();
  if (selected() < 0 && !lamps_.empty()) select(0);
  showSelected();
  Q_EMIT changed();
}

void LampsPanel::edit(const QString& name, const std::function<void(Lamp&)>& edit) {
  const int lamp = selected();
  if (lamp < 0) return;
  auto lamps = lamps_;
  edit(lamps[static_cast<std::size_t>(lamp)]);
  if (lamps == lamps_) return;
  change(name, std::move(lamps), gesture_);
}

void LampsPanel::add() {
  if (lamps_.size() >= kMostLamps || !addButton_->isEnabled()) return;
  // Across from the chosen one, so that it is seen at once.
  auto lamps = lamps_;
  Lamp lamp;
  if (selected() >= 0) {
    lamp = lamps[static_cast<std::size_t>(selected())];
    lamp.direction = Vector3d(-lamp.direction.x(), -lamp.direction.y(), lamp.direction.z());
  }
  lamps.push_back(lamp);
  change(tr("Add a lamp"), lamps);
  select(static_cast<int>(lamps.size()) - 1);
}

void LampsPanel::removeSelected() {
  if (selected() < 0 || lamps_.size() <= 1) return;
  auto lamps = lamps_;
  lamps.erase(lamps.begin() + selected());
  change(tr("Remove a lamp"), std::move(lamps));
}

void LampsPanel::showLamps() {
  std::vector<HemisphereView::Handle> handles;
  for (const Lamp& lamp : lamps_) {
    handles.push_back({lamp.direction, lamp.colour, lamp.radiusDegrees * kDegree});
  }
  hemisphere_->setHandles(std::move(handles));
  if (selected() >= 0) {
    place_->setText(placeOf(lamps_[static_cast<std::size_t>(selected())].direction));
  }
}

void LampsPanel::showSelected() {
  const bool one = scene() && scene()->model->singleLamp;
  addButton_->setEnabled(!one && lamps_.size() < kMostLamps);
  removeButton_->setEnabled(lamps_.size() > 1);
  if (selected() < 0) return;
  const Lamp& lamp = lamps_[static_cast<std::size_t>(selected())];
  const QSignalBlocker quietBrightness(brightness_);
  const QSignalBlocker quietSize(size_);
  brightness_->setValue(qRound(std::log2(lamp.brightness) * kStop));
  size_->setValue(qRound(lamp.radiusDegrees));
  QPixmap swatch(28, 14);
  swatch.fill(lamp.colour);
  colour_->setIcon(swatch);
  colour_->setIconSize(swatch.size());
  place_->setText(placeOf(lamp.direction));
}

void LampsPanel::chooseColour() {
  if (selected() < 0) return;
  const auto before = lamps_;
  ++gesture_;
  QColorDialog dialog(before[static_cast<std::size_t>(selected())].colour, this);
  dialog.setWindowTitle(tr("Colour of the lamp"));
  connect(&dialog, &QColorDialog::currentColorChanged, this, [this](const QColor& colour) {
    edit(tr("Colour of a lamp"), [&](Lamp& lamp) { lamp.colour = colour; });
  });
  if (dialog.exec() == QDialog::Rejected) change(tr("Colour of a lamp"), before, gesture_);
  ++gesture_;
}

}  // namespace lightsketch
