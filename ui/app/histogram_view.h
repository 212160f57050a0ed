// How a camera's counts are spread.
#pragma once

#include <QWidget>
#include <array>
#include <cstdint>

#include "ui/app/live_view.h"

namespace lightsketch {

class HistogramView : public QWidget {
  Q_OBJECT
 public:
  explicit HistogramView(QWidget* parent = nullptr);

  // Null: nothing to show.
  void setPicture(std::shared_ptr<const ViewPicture> picture);
  // Logarithms of the counts: a few saturated pixels are seen beside a million dark ones.
  void setLogarithmic(bool on);

  QSize sizeHint() const override { return {220, 84}; }
  QSize minimumSizeHint() const override { return {120, 56}; }

 protected:
  void paintEvent(QPaintEvent* event) override;

 private:
  std::shared_ptr<const ViewPicture> picture_;
  bool logarithmic_ = false;
};

}  // namespace lightsketch
