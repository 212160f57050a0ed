// The Lighting Sensitive Display: the model under lamps, surroundings, the room or a lamp's path.
#pragma once

#include <QComboBox>
#include <QElapsedTimer>
#include <QPointer>
#include <array>
#include <vector>

#include "ui/app/page.h"
#include "ui/app/relight_panel.h"
#include "ui/app/relight_view.h"

class QButtonGroup;
class QMenu;
class QPushButton;
class QStackedWidget;
class QTimer;

namespace lightsketch {

class EnvironmentPanel;
class LampsPanel;
class PathPanel;
class RoomPanel;

class RelightPage final : public Page {
  Q_OBJECT
 public:
  enum class Light { kLamps, kSurroundings, kRoom, kPath };

  explicit RelightPage(Workspace& workspace, QWidget* parent = nullptr);
  ~RelightPage() override;

  QString title() const override { return tr("Relight"); }
  QString purpose() const override;
  void entered() override;
  void left() override;
  void begin() override;  // the light moves

  void setLight(Light light);
  // "lamp", "three-lamps", "surroundings", "room", "path"; false: it is none of them.
  bool setLight(const QString& name);
  Light light() const;
  RelightView& view() const { return *view_; }
  LampsPanel& lamps() const { return *lamps_; }
  EnvironmentPanel& surroundings() const { return *surroundings_; }
  PathPanel& path() const { return *path_; }
  const std::shared_ptr<RelightScene>& scene() const { return scene_; }
  float exposure() const;
  void findExposure();
  // Beside the picture, and its lamp in the picture; below 0: none.
  void compareWith(int frame);
  // In the background.
  void savePicture(const std::filesystem::path& file);
  void saveFilm(const std::filesystem::path& folder, double framesPerSecond);
  // Without anything around it, on that display; null: back.
  void fillScreen(QScreen* screen);
  RelightView* fullScreenView() const { return fullScreen_; }

 Q_SIGNALS:
  void sceneShown();

 protected:
  void dragEnterEvent(QDragEnterEvent* event) override;
  void dropEvent(QDropEvent* event) override;

 private:
  void buildColumn();
  void buildActions();
  void load();
  void use(std::shared_ptr<RelightScene> scene);
  void listPhotographs();
  RelightPanel& panel() const { return *panels_[static_cast<std::size_t>(light())]; }
  void watchMotion();
  void lightChanged();
  void prepareLight();
  void showExposure();
  void tell();
  void fillDisplays();
  void chooseWhereToSave(bool film);
  void tellOfSaved(Task* task);
  void connectView(RelightView& view);

  std::shared_ptr<RelightScene> scene_;
  std::filesystem::path wanted_;  // the model being loaded
  bool visible_ = false;
  bool dirty_ = true;         // the relighter's light is not the panel's
  bool exposureDue_ = false;  // to be found once the light is set

  RelightView* view_;
  QPointer<RelightView> fullScreen_;
  QWidget* column_;
  QButtonGroup* kinds_;
  QStackedWidget* stack_;
  std::array<RelightPanel*, 4> panels_{};
  LampsPanel* lamps_;
  EnvironmentPanel* surroundings_;
  RoomPanel* room_;
  PathPanel* path_;
  QSlider* exposure_;
  QLabel* exposureText_;
  QComboBox* tone_;
  QComboBox* photographs_;
  QPushButton* film_;
  QMenu* displays_;
  QLabel* numbers_;
  QTimer* motion_;
  QElapsedTimer sinceStep_;
  RadianceImage photograph_;
  std::filesystem::path sketch_;  // that photographs_ lists
};

}  // namespace lightsketch
