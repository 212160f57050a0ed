// A lamp that moves as it was moved: along the sketch's own path or a lights file.
#pragma once

#include <QPushButton>

#include "ui/app/hemisphere_view.h"
#include "ui/app/relight_panel.h"

namespace lightsketch {

class PathPanel final : public RelightPanel {
  Q_OBJECT
 public:
  explicit PathPanel(Workspace& workspace, QWidget* parent = nullptr);

  void setScene(std::shared_ptr<const RelightScene> scene) override;
  std::optional<LightIntensities> light() override;
  void drag(QPointF by) override;
  bool moving() const override { return play_->isChecked(); }
  void setMoving(bool on) override { play_->setChecked(on); }
  void advance(double seconds) override;
  std::optional<Film> film() const override;

  // A lights file (JSON).
  void open(const std::filesystem::path& file);
  const LightPath& path() const { return path_; }
  double seconds() const { return seconds_; }
  void seek(double seconds);

 private:
  void useSketch();
  void setPath(LightPath path, const QString& name);
  void show();

  LightPath path_;
  double seconds_ = 0;
  bool ownPath_ = true;  // the sketch's, not a file's
  QLabel* name_;
  HemisphereView* hemisphere_;
  QSlider* time_;
  QSlider* speed_;
  QPushButton* play_;
};

}  // namespace lightsketch
