// Shows a LiveView, with whatever a page draws over it.
#pragma once

#include <QTransform>
#include <QWidget>
#include <functional>

#include "ui/app/live_view.h"

namespace lightsketch {

// The converting thread makes the picture as large as it is shown, so that drawing it is one copy.
class FrameView : public QWidget {
  Q_OBJECT
 public:
  // Camera pixels (centre of the top left one at 0.5, 0.5) to widget coordinates.
  using Overlay = std::function<void(QPainter&, const QTransform& widgetFromFrame)>;

  explicit FrameView(LiveView& view, QWidget* parent = nullptr);
  ~FrameView() override;

  void setOverlay(Overlay overlay);
  // Mirrors the picture, not what is drawn over it: a camera that looks at the person shows them as
  // a looking glass does.
  void setFlipped(bool leftRight, bool upsideDown);
  // Said where there is no picture: "no camera".
  void setPlaceholder(const QString& text);
  LiveView& view() const { return view_; }
  // Where the picture lies; invalid where there is none.
  QRectF pictureRectangle() const;
  QTransform widgetFromFrame() const;

  QSize sizeHint() const override { return {480, 360}; }
  QSize minimumSizeHint() const override { return {160, 120}; }

 Q_SIGNALS:
  // A new picture was drawn; it is on the screen when the event loop has gone round.
  void drawn();

 protected:
  void paintEvent(QPaintEvent* event) override;
  void resizeEvent(QResizeEvent* event) override;
  void showEvent(QShowEvent* event) override;
  void hideEvent(QHideEvent* event) override;

 private:
  void wantSize();

  LiveView& view_;
  Overlay overlay_;
  QString placeholder_;
  bool leftRight_ = false;
  bool upsideDown_ = false;
  std::shared_ptr<const ViewPicture> picture_;
};

}  // namespace lightsketch
