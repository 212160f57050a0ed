// The relit picture on the screen.
#pragma once

#include <QImage>
#include <QWidget>
#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "pipeline/relight/frame_rate_governor.h"
#include "ui/app/relight_scene.h"

class QLabel;
class QTimer;

namespace lightsketch {

// What the page and `--stats` tell about drawing.
struct RelightStatistics {
  double framesPerSecond = 0;      // over the last second; 0: the picture stands
  double drawMilliseconds = 0;     // of the last frame: light and pixels
  double latencyMilliseconds = 0;  // of the last frame: from the light's change to the screen
  float share = 1;                 // of the bases, as the governor has it
};

// Draws a scene as large as fits, in the middle of a dark neutral ground, beside it a photograph if
// there is one. Drawing happens on the UI thread (all cores): a picture takes a few milliseconds at
// most, which the governor sees to.
class RelightView final : public QWidget {
  Q_OBJECT
 public:
  using Clock = std::chrono::steady_clock;

  explicit RelightView(QWidget* parent = nullptr);
  ~RelightView() override;

  void setScene(std::shared_ptr<RelightScene> scene);
  void setExposure(float exposure, Tone tone);
  // Shown at the right of the picture, with a caption; null: none.
  void setPhotograph(const QImage& photograph, const QString& caption = {});
  // Said where there is no scene.
  void setPlaceholder(const QString& text);
  // The pointer vanishes when it rests.
  void setHidesPointer(bool on);
  // Called before a frame is drawn; sets the scene's light if that has changed.
  void setPrepare(std::function<void()> prepare) { prepare_ = std::move(prepare); }
  // The light was changed, by something that happened at `when`: draws as soon as possible.
  void lightChanged(Clock::time_point when = Clock::now());

  RelightStatistics statistics() const;

 Q_SIGNALS:
  // The pointer was moved with its button held; in units of half the picture's shorter side, y up.
  void dragged(QPointF by);
  // A frame is on the screen: milliseconds since the frame before (0 if the picture stood), from
  // the light's change, and of drawing.
  void shown(double interval, double latency, double drawing);
  void leaveRequested();  // Esc

 protected:
  void paintEvent(QPaintEvent* event) override;
  void resizeEvent(QResizeEvent* event) override;
  void mousePressEvent(QMouseEvent* event) override;
  void mouseMoveEvent(QMouseEvent* event) override;
  void mouseReleaseEvent(QMouseEvent* event) override;
  void mouseDoubleClickEvent(QMouseEvent* event) override;
  void wheelEvent(QWheelEvent* event) override;
  void keyPressEvent(QKeyEvent* event) override;

 private:
  void draw();
  void paintPicture(QPainter& painter, const QImage& picture, const QRectF& pane) const;
  // Where picture and photograph lie, logical pixels; the picture may be larger than its pane.
  QRectF picturePane() const;
  QRectF photographPane() const;
  QRectF pictureIn(const QRectF& pane, const QSizeF& size) const;
  PixelRectangle visible() const;
  void presented();
  void placeWords();

  std::shared_ptr<RelightScene> scene_;
  std::function<void()> prepare_;
  float exposure_ = 1;
  Tone tone_ = Tone::kPlain;
  QImage photograph_;
  QLabel* placeholder_;
  QLabel* relitCaption_;
  QLabel* photographCaption_;

  ScreenRenderer renderer_;
  FrameRateGovernor governor_;
  std::vector<std::byte> buffer_;
  std::size_t strideBytes_ = 0;
  QImage picture_;             // in buffer_
  bool stale_ = true;          // the buffer is not what is to be shown
  float drawnShare_ = 1;       // of what the buffer holds
  QTimer* pointer_ = nullptr;  // hides it
  QTimer* refine_;             // once more, with all bases and evenly reduced, when light rests
  bool moving_ = false;        // the buffer's light had just changed

  double zoom_ = 1;
  QPointF middle_{0.5, 0.5};  // of the pane, as a fraction of the picture
  std::optional<QPointF> last_;
  bool panning_ = false;

  std::optional<Clock::time_point> changed_;  // first change that is not yet drawn
  std::optional<Clock::time_point> drawing_;  // the same of the frame being presented
  std::optional<Clock::time_point> presentedAt_;
  std::vector<Clock::time_point> recent_;  // of frames with a new light, within a second
  RelightStatistics statistics_;
};

}  // namespace lightsketch
