// Worse to better as colours, and the bar that says which is which.
#pragma once

#include <QColor>
#include <QWidget>

namespace lightsketch {

class ColourScale final : public QWidget {
  Q_OBJECT
 public:
  explicit ColourScale(QWidget* parent = nullptr) : QWidget(parent) { setFixedHeight(34); }
  void setRange(double low, double high);  // dB
  QColor colourOf(double value) const;

 protected:
  void paintEvent(QPaintEvent* event) override;

 private:
  double low_ = 20;
  double high_ = 40;
};

}  // namespace lightsketch
