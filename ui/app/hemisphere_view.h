// Light directions on a disc: the hemisphere in front of the scene as one sees it standing there.
#pragma once

#include <Eigen/Core>
#include <QColor>
#include <QPixmap>
#include <QString>
#include <QWidget>
#include <optional>
#include <vector>

namespace lightsketch {

// Scene frame: x right, y up, z towards the viewer, in the middle. Azimuthal equidistant: the
// distance from the middle is the angle to z; the rim is 90 degrees, or 180 for the whole sphere.
class HemisphereView : public QWidget {
  Q_OBJECT
 public:
  struct Dot {
    Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();
    QColor colour;
    double radius = 4;  // logical pixels
    bool hollow = false;
    QString tip = {};
  };
  // A lamp that can be dragged, or moved with the arrow keys once clicked.
  struct Handle {
    Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();
    QColor colour;
    double angularRadius = 0;  // radians, drawn as a disc of that size
  };

  explicit HemisphereView(QWidget* parent = nullptr);

  void setWholeSphere(bool on);
  void setDots(std::vector<Dot> dots);
  // Changes one dot without drawing the others anew.
  void setDot(int index, const Dot& dot);
  const std::vector<Dot>& dots() const { return dots_; }
  // A curve, older parts fainter.
  void setPath(std::vector<Eigen::Vector3d> path, const QColor& colour);
  void setHandles(std::vector<Handle> handles);
  const std::vector<Handle>& handles() const { return handles_; }
  int selectedHandle() const { return selected_; }
  void selectHandle(int index);
  // From the lamp to where it should go next.
  void setArrow(const std::optional<Eigen::Vector3d>& from,
                const std::optional<Eigen::Vector3d>& to);
  // Dragging on empty ground selects a region. With keys: the arrows move a circle, + and - size
  // it, Delete selects what it holds, Esc puts it away.
  void setSelectsRegions(bool on) { selectsRegions_ = on; }
  void setMarkedDot(int index);

  // Widget coordinates. Nothing outside of the disc.
  QPointF project(const Eigen::Vector3d& direction) const;
  std::optional<Eigen::Vector3d> unproject(const QPointF& point) const;

  QSize sizeHint() const override { return {360, 360}; }
  QSize minimumSizeHint() const override { return {160, 160}; }

 Q_SIGNALS:
  void dotClicked(int index);
  void handleSelected(int index);
  void handleMoved(int index, const Eigen::Vector3d& direction);
  // Radians.
  void regionSelected(const Eigen::Vector3d& centre, double angularRadius);
  // What was set before is on the screen when the event loop has gone round.
  void drawn();

 protected:
  void paintEvent(QPaintEvent* event) override;
  void resizeEvent(QResizeEvent* event) override;
  void changeEvent(QEvent* event) override;
  void mousePressEvent(QMouseEvent* event) override;
  void mouseMoveEvent(QMouseEvent* event) override;
  void mouseReleaseEvent(QMouseEvent* event) override;
  void keyPressEvent(QKeyEvent* event) override;
  bool event(QEvent* event) override;

 private:
  QPointF centre() const;
  double discRadius() const;
  double rimAngle() const;
  int dotAt(const QPointF& point) const;
  int handleAt(const QPointF& point) const;
  void paintDot(QPainter& painter, const Dot& dot) const;
  void paintGround();
  void paintRegion(QPainter& painter, const Eigen::Vector3d& middle, double radius) const;
  // Where a direction lies that many steps of an arrow key further right and down.
  std::optional<Eigen::Vector3d> stepped(const Eigen::Vector3d& from, QPointF steps) const;
  bool editRegion(int key);

  std::vector<Dot> dots_;
  std::vector<Handle> handles_;
  std::vector<Eigen::Vector3d> path_;
  QColor pathColour_;
  std::optional<Eigen::Vector3d> arrowFrom_;
  std::optional<Eigen::Vector3d> arrowTo_;
  QPixmap ground_;  // disc, rings and dots; null: to be drawn anew
  bool wholeSphere_ = false;
  bool selectsRegions_ = false;
  int selected_ = -1;
  int marked_ = -1;
  bool dragging_ = false;
  std::optional<Eigen::Vector3d> regionFrom_;
  std::optional<Eigen::Vector3d> regionTo_;
  std::optional<Eigen::Vector3d> keyRegion_;  // middle of the circle that keys move
  double keyRadius_ = 0.2;                    // radians
};

}  // namespace lightsketch
