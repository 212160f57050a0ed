// How certain a calibrated lens is, over its field.
#pragma once

#include <QWidget>
#include <vector>

#include "calibration/model/camera_model.h"

namespace lightsketch {

// One sigma of the direction, both axes together, sampled over the field. Takes a tenth of a
// second: not for the UI thread.
struct FieldUncertainty {
  static constexpr int kAzimuths = 72;
  static constexpr double kStepDegrees = 2.5;  // of the field angle
  double rimDegrees = 0;
  // Degrees; below 0 where no board was. [ring * kAzimuths + azimuth], from atan2(y, x) = 0 on.
  std::vector<double> sigmaDegrees;
};
FieldUncertainty uncertaintyOf(const CameraModel& model);

class UncertaintyMap : public QWidget {
  Q_OBJECT
 public:
  explicit UncertaintyMap(QWidget* parent = nullptr);
  void setField(FieldUncertainty field);
  const FieldUncertainty& field() const { return field_; }

  QSize sizeHint() const override { return {260, 300}; }
  QSize minimumSizeHint() const override { return {160, 190}; }

 protected:
  void paintEvent(QPaintEvent* event) override;

 private:
  FieldUncertainty field_;
};

}  // namespace lightsketch
