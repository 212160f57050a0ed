// A picture between counts and colour: one float per sample of the sensor.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "calibration/model/sensor_model.h"
#include "capture/frame/frame.h"
#include "capture/frame/image.h"

namespace lightsketch {

// Rows of samples; Bayer planes carry a margin of two samples on every side for the demosaic.
class SamplePlane {
 public:
  SamplePlane(PixelFormat format, int width, int height);

  int width() const { return width_; }
  int height() const { return height_; }
  const PixelFormatInfo& info() const { return info_; }
  std::span<float> row(int y);

  // Divides by the flat field.
  void flatten(const FlatField& field);
  // Hot samples become the mean of their nearest sound neighbours of the same colour.
  void fill(std::span<const PixelPosition> hotPixels);
  // h x w x 3: demosaiced (Malvar, He, Cutler 2004), mono repeated.
  RadianceImage toRadiance() &&;

 private:
  RadianceImage demosaic();

  const PixelFormatInfo& info_;
  int width_;
  int height_;
  int margin_;
  std::size_t stride_;
  std::vector<float> samples_;
};

// Counts to exposures, a row at a time: dark frame or black level, then the response.
class CountConverter {
 public:
  // The exposures come multiplied by `scale`. `sensor` must outlive this.
  explicit CountConverter(const SensorModel& sensor, double scale = 1);
  // In place; row y of the picture.
  void toExposure(int y, std::span<float> samples) const;

 private:
  struct Row {  // per sample of a row
    std::vector<std::uint8_t> colour;
    std::vector<float> black;  // counts
    std::vector<float> slope;  // of a linear response
  };
  const SensorModel& sensor_;
  std::vector<Row> rows_;                   // two of a mosaic, otherwise one
  std::vector<std::vector<float>> tables_;  // per colour and count, where not linear
};

// A sensor taken to be linear with one black level, for a frame that nobody has calibrated for.
Result<SensorModel> uncalibratedSensor(const Frame& frame, double blackLevel);

// The samples of a row as numbers 0..2^bits - 1.
void readCounts(const Frame& frame, int row, std::span<float> counts);
// Whether a frame's bytes fit its size, and its size the demosaic.
Result<void> checkFrame(const Frame& frame);

}  // namespace lightsketch
