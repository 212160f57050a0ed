#include "calibration/model/flat_field.h"

#include <algorithm>
#include <cmath>

namespace lightsketch {

Result<FlatField> FlatField::create(int columns, int rows, int colours,
                                    std::vector<double> values) {
  if (columns < 2 || rows < 2 || columns > 1000 || rows > 1000 || (colours != 1 && colours != 3) ||
      values.size() != static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows) *
                           static_cast<std::size_t>(colours)) {
    return failure(ErrorCode::kInvalidArgument,
                   "flat field: {} values do not make {} x {} nodes of {} colours", values.size(),
                   columns, rows, colours);
  }
  const auto nodes = static_cast<std::ptrdiff_t>(columns) * rows;
  for (int colour = 0; colour < colours; ++colour) {
    const auto first = values.begin() + colour * nodes;
    const double peak = *std::max_element(first, first + nodes);
    for (auto at = first; at != first + nodes; ++at) {
      // A node that sees a ten-thousandth of the light cannot be corrected, only blown up.
      if (!(*at > 1e-4 * peak && std::isfinite(*at))) {
        return failure(ErrorCode::kInvalidArgument,
                       "flat field: a node has no light; use a brighter diffuser");
      }
      *at /= peak;
    }
  }
  FlatField field;
  field.columns_ = columns;
  field.rows_ = rows;
  field.colours_ = colours;
  field.values_ = std::move(values);
  return field;
}

double FlatField::node(int column, int row, int colour) const {
  return values_[static_cast<std::size_t>((colour * rows_ + row) * columns_ + column)];
}

double FlatField::sensitivity(double u, double v, int colour) const {
  const double x = std::clamp(u, 0.0, 1.0) * (columns_ - 1);
  const double y = std::clamp(v, 0.0, 1.0) * (rows_ - 1);
  const int column = std::min(static_cast<int>(x), columns_ - 2);
  const int row = std::min(static_cast<int>(y), rows_ - 2);
  const double top =
      std::lerp(node(column, row, colour), node(column + 1, row, colour), x - column);
  const double bottom =
      std::lerp(node(column, row + 1, colour), node(column + 1, row + 1, colour), x - column);
  return std::lerp(top, bottom, y - row);
}

void FlatField::sensitivityOfRow(double v, int colour, std::span<float> pixels) const {
  const double width = static_cast<double>(pixels.size());
  for (std::size_t x = 0; x < pixels.size(); ++x) {
    pixels[x] = static_cast<float>(sensitivity((static_cast<double>(x) + 0.5) / width, v, colour));
  }
}

Json FlatField::toJson() const {
  return {{"columns", columns_}, {"rows", rows_}, {"colours", colours_}, {"sensitivity", values_}};
}

Result<FlatField> FlatField::fromJson(const Json& json, std::string_view where) {
  ASSIGN_OR_RETURN(const auto columns, jsonInteger(json, "columns", where, 2, 1000));
  ASSIGN_OR_RETURN(const auto rows, jsonInteger(json, "rows", where, 2, 1000));
  ASSIGN_OR_RETURN(const auto colours, jsonInteger(json, "colours", where, 1, 3));
  ASSIGN_OR_RETURN(
      const auto values,
      jsonVector(json, "sensitivity", static_cast<int>(columns * rows * colours), where));
  auto field = create(static_cast<int>(columns), static_cast<int>(rows), static_cast<int>(colours),
                      {values.begin(), values.end()});
  if (!field) return failure(ErrorCode::kCorrupt, "{}: {}", where, field.error().message);
  return field;
}

}  // namespace lightsketch
