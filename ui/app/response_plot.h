// The response curves of a camera.
#pragma once

#include <QWidget>
#include <optional>

#include "calibration/model/response_curve.h"

namespace lightsketch {

class ResponsePlot : public QWidget {
  Q_OBJECT
 public:
  explicit ResponsePlot(QWidget* parent = nullptr);
  void setCurve(const ResponseCurve& curve);

  QSize sizeHint() const override { return {300, 260}; }
  QSize minimumSizeHint() const override { return {180, 150}; }

 protected:
  void paintEvent(QPaintEvent* event) override;

 private:
  std::optional<ResponseCurve> curve_;
};

}  // namespace lightsketch
