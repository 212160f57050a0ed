// Still pictures on a page.
#pragma once

#include <QImage>
#include <QPixmap>
#include <QWidget>
#include <cstdint>

#include "capture/frame/image.h"

namespace lightsketch {

// 8-bit RGB, reduced to what a screen shows. For background threads.
QImage toQImage(const Image<std::uint8_t>& picture);

// One picture as large as fits, with a line under it.
class PictureView final : public QWidget {
  Q_OBJECT
 public:
  explicit PictureView(QWidget* parent = nullptr);

  // A null image: the placeholder is shown.
  void setPicture(const QImage& image);
  const QImage& picture() const { return image_; }
  void setCaption(const QString& text);
  QString caption() const { return caption_; }
  void setPlaceholder(const QString& text);
  // Pixels stay squares where the picture is enlarged.
  void setPixelated(bool on);

  QSize sizeHint() const override { return {320, 260}; }
  QSize minimumSizeHint() const override { return {120, 100}; }

 Q_SIGNALS:
  void clicked();

 protected:
  void paintEvent(QPaintEvent* event) override;
  void mousePressEvent(QMouseEvent* event) override;

 private:
  QImage image_;
  QPixmap scaled_;  // null: to be made
  QString caption_;
  QString placeholder_;
  bool pixelated_ = false;
};

// Three pictures of one thing side by side; a click, or 1, 2 and 3, shows one of them alone, at the
// same place as the others, so that they can be compared by flipping. 0 or Escape: all again.
class TripleView final : public QWidget {
  Q_OBJECT
 public:
  explicit TripleView(QWidget* parent = nullptr);

  void setCaptions(const QString& first, const QString& second, const QString& third);
  void setPictures(const QImage& first, const QImage& second, const QImage& third);
  void setPlaceholder(const QString& text);
  PictureView* view(int i) const { return views_[i]; }
  // -1: all.
  void showOnly(int i);

 protected:
  void keyPressEvent(QKeyEvent* event) override;

 private:
  PictureView* views_[3];
  int only_ = -1;
};

}  // namespace lightsketch
