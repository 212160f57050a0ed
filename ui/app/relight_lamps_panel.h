// Lamps in the hand: several, coloured, sized, dragged on a hemisphere.
#pragma once

#include <QCheckBox>
#include <QColor>
#include <QPushButton>
#include <vector>

#include "ui/app/hemisphere_view.h"
#include "ui/app/relight_panel.h"

namespace lightsketch {

class LampsPanel final : public RelightPanel {
  Q_OBJECT
 public:
  struct Lamp {
    Eigen::Vector3d direction = Eigen::Vector3d(-0.5, 0.5, 0.7).normalized();
    QColor colour = Qt::white;  // as the screen shows it
    double brightness = 1;      // factor on that
    double radiusDegrees = 0;
    bool operator==(const Lamp&) const = default;
  };
  static constexpr int kMostLamps = 8;

  explicit LampsPanel(Workspace& workspace, QWidget* parent = nullptr);

  void setScene(std::shared_ptr<const RelightScene> scene) override;
  std::optional<LightIntensities> light() override;
  void drag(QPointF by) override;
  bool moving() const override { return orbit_->isChecked(); }
  void setMoving(bool on) override { orbit_->setChecked(on); }
  void advance(double seconds) override;
  std::optional<Film> film() const override;

  const std::vector<Lamp>& lamps() const { return lamps_; }
  // With undo, under this name. Changes of one `gesture` above 0 become one step.
  void change(const QString& name, std::vector<Lamp> lamps, int gesture = 0);
  // Key, fill and rim.
  static std::vector<Lamp> threeLamps();
  // Without undo.
  void setLamps(std::vector<Lamp> lamps);
  int selected() const { return hemisphere_->selectedHandle(); }
  void select(int lamp) { hemisphere_->selectHandle(lamp); }
  void add();
  void removeSelected();

 private:
  std::vector<DiscLamp> discs() const;
  // The selected lamp, changed by `edit` as one step of the present gesture.
  void edit(const QString& name, const std::function<void(Lamp&)>& edit);
  void showLamps();
  void showSelected();
  void chooseColour();

  std::vector<Lamp> lamps_;
  HemisphereView* hemisphere_;
  QPushButton* addButton_;
  QPushButton* removeButton_;
  QPushButton* colour_;
  QSlider* brightness_;
  QSlider* size_;
  QLabel* place_;
  QCheckBox* orbit_;
  int gesture_ = 1;
};

}  // namespace lightsketch
