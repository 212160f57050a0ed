// A model's picture while it is made.
#pragma once

#include <QImage>
#include <QPainter>
#include <algorithm>
#include <cstdint>
#include <mutex>
#include <utility>

#include "capture/frame/image.h"
#include "pipeline/validate/validate.h"
#include "ui/app/sketch_summary.h"

namespace lightsketch {

// Starts as the means of a captured frame's blocks, which is all that is known of them; each block
// becomes sharp when the first stage has found its basis. Written by any thread.
class GrowingPicture {
 public:
  GrowingPicture(const QImage& captured, const SketchSummary& summary, int blockSize,
                 float exposure)
      : exposure_(exposure),
        blocks_((summary.width + blockSize - 1) / blockSize *
                ((summary.height + blockSize - 1) / blockSize)) {
    const QSize size(summary.width, summary.height);
    picture_ = QImage(size, QImage::Format_RGB32);
    picture_.fill(Qt::black);
    if (captured.isNull()) return;
    const QSize means((summary.width + blockSize - 1) / blockSize,
                      (summary.height + blockSize - 1) / blockSize);
    QPainter(&picture_).drawImage(
        QRect(QPoint(), means * blockSize),
        captured.scaled(means, Qt::IgnoreAspectRatio, Qt::SmoothTransformation));
  }

  void put(int left, int top, const RadianceImage& block) {
    const Image<std::uint8_t> codes = toSrgb8(block, exposure_);
    const std::lock_guard lock(mutex_);
    for (int y = 0; y < codes.height(); ++y) {
      auto* line = reinterpret_cast<QRgb*>(picture_.scanLine(top + y)) + left;
      for (int x = 0; x < codes.width(); ++x)
        line[x] = qRgb(codes(x, y, 0), codes(x, y, 1), codes(x, y, 2));
    }
    ++done_;
  }
  // Null: nothing came since the last call.
  QImage take() {
    const std::lock_guard lock(mutex_);
    if (std::exchange(shown_, done_) == done_) return {};
    return picture_.copy();
  }
  double part() const { return std::min(1.0, static_cast<double>(shown_) / blocks_); }

 private:
  const float exposure_;
  const int blocks_;
  std::mutex mutex_;  // guards all below
  QImage picture_;
  int done_ = 0;
  int shown_ = -1;
};

}  // namespace lightsketch
