// The inner loops of making a packed model's factors out of its file's bytes, by vector
// instructions chosen at run time. Internal to this folder.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace lightsketch {

// Folded numbers as HDF5's shuffle separates their bytes.
struct ByteLine {
  const std::uint8_t* lower = nullptr;
  const std::uint8_t* upper = nullptr;  // none: all are zero
};

// The inverse DCT of S x S coefficients.
struct InverseDct {
  std::size_t size = 0;         // S
  std::span<const float> line;  // S x S: a row per frequency, a column per pixel
  std::span<const std::uint32_t>
      position;  // of each coefficient: vertical frequency S + horizontal
};
// Basis pictures first <= i < last, a coefficient per line, as pixels scaled to -127 to 127:
// picture i's to pixels + targets[i - first] S S, and its largest absolute value before it was
// scaled to largest[i - first]. 64 more bytes can be read behind the last line.
void inverseTransform(const InverseDct& dct, std::span<const ByteLine> coefficients,
                      std::size_t first, std::size_t last, const std::uint32_t* targets,
                      std::int8_t* pixels, float* largest);

// One column of U to its panels of 32 rows: row r is number sources[r] of the line and goes to
// u[r / 32 panelStride + r % 32]. The last panel's other rows are left alone. u is at a multiple of
// 64 bytes, as is the stride.
void placeColumn(const ByteLine& line, std::span<const std::uint32_t> sources,
                 std::size_t panelStride, std::int16_t* u);

}  // namespace lightsketch
