// One kind of light on the relight page.
#pragma once

#include <QLayout>
#include <QPointF>
#include <QSlider>
#include <QWidget>
#include <algorithm>
#include <memory>
#include <optional>

#include "ui/app/controls.h"
#include "ui/app/relight_scene.h"
#include "ui/app/workspace.h"

namespace lightsketch {

// Its controls, and the light that they stand for.
class RelightPanel : public QWidget {
  Q_OBJECT
 public:
  explicit RelightPanel(Workspace& workspace, QWidget* parent = nullptr)
      : QWidget(parent), workspace_(workspace) {}

  // Another model; null: none.
  virtual void setScene(std::shared_ptr<const RelightScene> scene) { scene_ = std::move(scene); }
  // Of the scene, now. Nothing: there is no light yet.
  virtual std::optional<LightIntensities> light() = 0;
  // The picture is dragged; the unit is half its shorter side, y up.
  virtual void drag(QPointF /*by*/) {}
  // Lamps that go round, a sky that turns, a path that is played: on, and a step of it.
  virtual bool moving() const { return false; }
  virtual void setMoving(bool /*on*/) {}
  virtual void advance(double /*seconds*/) {}
  // That movement once, to be saved; nothing: it has none.
  virtual std::optional<Film> film() const { return std::nullopt; }
  // The panel is shown; it is left.
  virtual void entered() {}
  virtual void left() {}

 Q_SIGNALS:
  void changed();  // the light
  void renewed();  // another light altogether, of another brightness

 protected:
  Workspace& workspace() const { return workspace_; }
  const std::shared_ptr<const RelightScene>& scene() const { return scene_; }

 private:
  Workspace& workspace_;
  std::shared_ptr<const RelightScene> scene_;
};

// A label and a slider under it, which the label names.
inline QSlider* addSlider(QLayout& column, const QString& text, const QString& tip, int least,
                          int most, int value) {
  auto* slider = new QSlider(Qt::Horizontal);
  auto* label = labelFor(slider, text);
  slider->setRange(least, most);
  slider->setValue(value);
  slider->setPageStep(std::max(1, (most - least) / 10));
  slider->setAccessibleName(text);
  for (QWidget* widget : {static_cast<QWidget*>(label), static_cast<QWidget*>(slider)}) {
    widget->setToolTip(tip);
    column.addWidget(widget);
  }
  return slider;
}

}  // namespace lightsketch
