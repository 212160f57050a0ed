// How much of the light each part of the picture receives: vignetting and shading, as a value.
#pragma once

#include <span>
#include <string_view>
#include <vector>

#include "capture/frame/json.h"
#include "capture/frame/result.h"

namespace lightsketch {

// Relative sensitivity over the picture, 1 at each colour's peak: what a diffuser's picture shows.
// A coarse grid of nodes, the outer ones on the picture's edges, bilinear between. Radiance is what
// was measured divided by it. Immutable, so thread-safe.
class FlatField {
 public:
  // values[(colour * rows + row) * columns + column], positive; scaled here to a peak of 1.
  static Result<FlatField> create(int columns, int rows, int colours, std::vector<double> values);
  static Result<FlatField> fromJson(const Json& json, std::string_view where);
  Json toJson() const;

  int columns() const { return columns_; }
  int rows() const { return rows_; }
  int colours() const { return colours_; }
  double node(int column, int row, int colour) const;
  // u, v: place as a fraction of the picture's width and height.
  double sensitivity(double u, double v, int colour) const;
  // The same at the centre of every pixel of a row.
  void sensitivityOfRow(double v, int colour, std::span<float> pixels) const;

 private:
  FlatField() = default;
  int columns_ = 0;
  int rows_ = 0;
  int colours_ = 0;
  std::vector<double> values_;
};

}  // namespace lightsketch
