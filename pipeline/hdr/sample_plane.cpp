#include "pipeline/hdr/sample_plane.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <utility>

namespace lightsketch {
namespace {

constexpr int kMargin = 2;  // reach of the demosaic's 5x5 filters

std::size_t index(int value) { return static_cast<std::size_t>(value); }

// Mirrored without repeating the edge sample, which keeps the Bayer phase.
int mirrored(int i, int size) {
  if (i < 0) i = -i;
  return i >= size ? 2 * size - 2 - i : i;
}

// Malvar, He and Cutler 2004, "High-quality linear interpolation for demosaicing of
// Bayer-patterned color images", figure 2: bilinear plus a gain-weighted Laplacian of the sample's
// own colour. All four filters are evaluated for every pixel of a row (they vectorise, given that
// nothing overlaps, and share their sums); the parity then picks.
void filterRow(const float* c, std::ptrdiff_t stride, int width, float* __restrict cross,
               float* __restrict alongRow, float* __restrict alongColumn,
               float* __restrict diagonal) {
  const float* const n = c - stride;
  const float* const s = c + stride;
  const float* const nn = n - stride;
  const float* const ss = s + stride;
  for (std::ptrdiff_t x = 0; x < width; ++x) {
    const float h1 = c[x - 1] + c[x + 1];
    const float v1 = n[x] + s[x];
    const float h2 = c[x - 2] + c[x + 2];
    const float v2 = nn[x] + ss[x];
    const float d = n[x - 1] + n[x + 1] + s[x - 1] + s[x + 1];
    cross[x] = 0.5f * c[x] + 0.25f * (h1 + v1) - 0.125f * (h2 + v2);
    alongRow[x] = 0.625f * c[x] + 0.5f * h1 - 0.125f * (h2 + d) + 0.0625f * v2;
    alongColumn[x] = 0.625f * c[x] + 0.5f * v1 - 0.125f * (v2 + d) + 0.0625f * h2;
    diagonal[x] = 0.75f * c[x] + 0.25f * d - 0.1875f * (h2 + v2);
  }
}

struct Filtered {
  float* cross;        // green at red and blue
  float* alongRow;     // the row's own colour at green
  float* alongColumn;  // the other colour at green
  float* diagonal;     // red at blue, blue at red
};

// `coloured`: the first sample of the row that is not green.
void weaveRow(const float* c, const Filtered& f, bool redRow, int coloured, int width,
              float* __restrict out) {
  // The colour that this row's mosaic holds beside green, and the one it lacks.
  const int own = redRow ? 0 : 2;
  const int other = 2 - own;
  const auto colour = [&](int x) {
    float* const pixel = out + 3 * x;
    pixel[own] = c[x];
    pixel[1] = f.cross[x];
    pixel[other] = f.diagonal[x];
  };
  const auto green = [&](int x) {
    float* const pixel = out + 3 * x;
    pixel[own] = f.alongRow[x];
    pixel[1] = c[x];
    pixel[other] = f.alongColumn[x];
  };
  for (int x = coloured; x < width; x += 2) colour(x);
  for (int x = 1 - coloured; x < width; x += 2) green(x);
}

}  // namespace

void readCounts(const Frame& frame, int row, std::span<float> counts) {
  const PixelFormatInfo& info = pixelFormatInfo(frame.format);
  const std::uint8_t* in =
      frame.bytes.data() + index(row) * index(frame.width) * index(info.bytesPerPixel);
  if (info.bits <= 8) {
    for (std::size_t i = 0; i < counts.size(); ++i) counts[i] = static_cast<float>(in[i]);
  } else {
    for (std::size_t i = 0; i < counts.size(); ++i) {
      counts[i] = static_cast<float>(in[2 * i] | (in[2 * i + 1] << 8));
    }
  }
}

Result<void> checkFrame(const Frame& frame) {
  const PixelFormatInfo& info = pixelFormatInfo(frame.format);
  const int smallest = info.isBayer ? kMargin + 1 : 1;
  if (frame.width < smallest || frame.height < smallest) {
    return failure(ErrorCode::kInvalidArgument, "frame {}: {} x {} pixels is too small for {}",
                   frame.metadata.id, frame.width, frame.height, info.name);
  }
  const std::size_t expected = index(frame.width) * index(frame.height) * index(info.bytesPerPixel);
  if (frame.bytes.size() != expected) {
    return failure(ErrorCode::kCorrupt, "frame {}: {} bytes where {} x {} {} needs {}",
                   frame.metadata.id, frame.bytes.size(), frame.width, frame.height, info.name,
                   expected);
  }
  return {};
}

Result<SensorModel> uncalibratedSensor(const Frame& frame, double blackLevel) {
  const PixelFormatInfo& info = pixelFormatInfo(frame.format);
  const double maximum = (1 << info.bits) - 1;
  if (!(blackLevel >= 0 && blackLevel < maximum)) {
    return failure(ErrorCode::kInvalidArgument, "black level {} is outside {}'s counts 0..{}",
                   blackLevel, info.name, maximum);
  }
  SensorModel sensor;
  sensor.format = frame.format;
  sensor.width = frame.width;
  sensor.height = frame.height;
  const std::vector<double> black(index(colourChannels(frame.format)), blackLevel);
  ASSIGN_OR_RETURN(sensor.response, ResponseCurve::linear(black, maximum, maximum));
  return sensor;
}

CountConverter::CountConverter(const SensorModel& sensor, double scale) : sensor_(sensor) {
  const PixelFormatInfo& info = pixelFormatInfo(sensor.format);
  const ResponseCurve& response = sensor.response;
  // Rows of a mosaic alternate; what belongs to each sample of a row is laid out beside it.
  for (int parity = 0; parity < (info.isBayer ? 2 : 1); ++parity) {
    Row row;
    for (int i = 0; i < sensor.width * info.channels; ++i) {
      const int colour = sampleColour(info, i, parity, i % info.channels);
      row.colour.push_back(static_cast<std::uint8_t>(colour));
      row.black.push_back(static_cast<float>(response.blackCount(colour)));
      row.slope.push_back(static_cast<float>(response.slope(0, colour) * scale));
    }
    rows_.push_back(std::move(row));
  }
  if (response.isLinear()) return;
  for (int colour = 0; colour < response.colours(); ++colour) {
    std::vector<float> table;
    for (int count = 0; count < 1 << info.bits; ++count) {
      table.push_back(static_cast<float>(response.exposure(count, colour) * scale));
    }
    tables_.push_back(std::move(table));
  }
}

void CountConverter::toExposure(int y, std::span<float> samples) const {
  const Row& row = rows_[index(y) % rows_.size()];
  const Image<float>& dark = sensor_.darkCounts;
  const float* const black = dark.empty() ? row.black.data() : dark.row(y).data();
  if (tables_.empty()) {
    const float* const slope = row.slope.data();
    for (std::size_t i = 0; i < samples.size(); ++i)
      samples[i] = (samples[i] - black[i]) * slope[i];
    return;
  }
  const float last = static_cast<float>(tables_[0].size() - 2);
  for (std::size_t i = 0; i < samples.size(); ++i) {
    const std::vector<float>& table = tables_[row.colour[i]];
    const float count = samples[i] - black[i] + row.black[i];
    const float base = std::clamp(std::floor(count), 0.0f, last);
    const auto at = static_cast<std::size_t>(base);
    samples[i] = table[at] + (count - base) * (table[at + 1] - table[at]);
  }
}

SamplePlane::SamplePlane(PixelFormat format, int width, int height)
    : info_(pixelFormatInfo(format)),
      width_(width),
      height_(height),
      margin_(info_.isBayer ? kMargin : 0),
      stride_(index(width + 2 * margin_) * index(info_.channels)),
      samples_(stride_ * index(height + 2 * margin_)) {}

std::span<float> SamplePlane::row(int y) {
  return {samples_.data() + index(y + margin_) * stride_ + margin_,
          index(width_) * index(info_.channels)};
}

void SamplePlane::flatten(const FlatField& field) {
  std::vector<float> sensitivity(index(width_));
  for (int y = 0; y < height_; ++y) {
    const std::span<float> samples = row(y);
    for (int colour = 0; colour < field.colours(); ++colour) {
      std::size_t x = 0;  // the first of the colour
      if (info_.isBayer) {
        while (x < 2 && sampleColour(info_, static_cast<int>(x), y, 0) != colour) ++x;
        if (x == 2) continue;
      }
      field.sensitivityOfRow((y + 0.5) / height_, colour, sensitivity);
      const std::size_t step = info_.isBayer ? 2 : index(info_.channels);
      for (std::size_t i = info_.isBayer ? x : index(colour); i < samples.size(); i += step) {
        samples[i] /= sensitivity[x];
        x += info_.isBayer ? 2 : 1;
      }
    }
  }
}

void SamplePlane::fill(std::span<const PixelPosition> hotPixels) {
  if (hotPixels.empty()) return;
  const auto key = [](int x, int y) { return std::pair(y, x); };
  std::vector<std::pair<int, int>> hot;
  hot.reserve(hotPixels.size());
  for (const PixelPosition& pixel : hotPixels) hot.push_back(key(pixel.x, pixel.y));
  std::sort(hot.begin(), hot.end());
  const int channels = info_.channels;
  const int pitch = info_.isBayer ? 2 : 1;  // to the next sample of the same colour
  for (const PixelPosition& pixel : hotPixels) {
    for (int c = 0; c < channels; ++c) {
      // Rings outwards until one holds a sound neighbour; clusters of hot pixels are small.
      for (int reach = pitch; reach <= 4 * pitch; reach += pitch) {
        float sum = 0;
        int count = 0;
        for (int dy = -reach; dy <= reach; dy += pitch) {
          for (int dx = -reach; dx <= reach; dx += pitch) {
            const int x = pixel.x + dx;
            const int y = pixel.y + dy;
            const bool onRing = std::abs(dx) + std::abs(dy) == reach;
            if (!onRing || x < 0 || y < 0 || x >= width_ || y >= height_ ||
                std::binary_search(hot.begin(), hot.end(), key(x, y))) {
              continue;
            }
            sum += row(y)[index(x * channels + c)];
            ++count;
          }
        }
        if (count == 0) continue;
        row(pixel.y)[index(pixel.x * channels + c)] = sum / static_cast<float>(count);
        break;
      }
    }
  }
}

// Mirrored edges, then the filters row by row.
RadianceImage SamplePlane::demosaic() {
  for (int y = 0; y < height_; ++y) {
    float* const samples = row(y).data();
    for (int i = 1; i <= kMargin; ++i) {
      samples[-i] = samples[mirrored(-i, width_)];
      samples[width_ - 1 + i] = samples[mirrored(width_ - 1 + i, width_)];
    }
  }
  for (int i = 1; i <= kMargin; ++i) {
    const auto copyRow = [&](int to, int from) {
      std::copy_n(row(from).data() - kMargin, stride_, row(to).data() - kMargin);
    };
    copyRow(-i, mirrored(-i, height_));
    copyRow(height_ - 1 + i, mirrored(height_ - 1 + i, height_));
  }

  RadianceImage image(width_, height_, 3);
  const std::size_t width = index(width_);
  std::vector<float> filtered(4 * width);
  for (int y = 0; y < height_; ++y) {
    const Filtered f{filtered.data(), filtered.data() + width, filtered.data() + 2 * width,
                     filtered.data() + 3 * width};
    const float* const samples = row(y).data();
    filterRow(samples, static_cast<std::ptrdiff_t>(stride_), width_, f.cross, f.alongRow,
              f.alongColumn, f.diagonal);
    const bool redRow = y % 2 == info_.redY;
    weaveRow(samples, f, redRow, redRow ? info_.redX : 1 - info_.redX, width_, image.row(y).data());
  }
  return image;
}

RadianceImage SamplePlane::toRadiance() && {
  if (info_.isBayer) return demosaic();
  RadianceImage image(width_, height_, 3);
  if (info_.channels == 3) {
    std::copy(samples_.begin(), samples_.end(), image.data());
  } else {
    for (std::size_t i = 0; i < samples_.size(); ++i) {
      std::fill_n(image.data() + 3 * i, 3, samples_[i]);
    }
  }
  return image;
}

}  // namespace lightsketch
