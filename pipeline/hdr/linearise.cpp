#include "pipeline/hdr/linearise.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lightsketch {
namespace {

std::size_t index(int value) { return static_cast<std::size_t>(value); }

// Raw samples as floats, black subtracted and scaled.
void scaleRow(const Frame& frame, int row, float black, float scale, float* out) {
  const PixelFormatInfo& info = pixelFormatInfo(frame.format);
  const std::size_t count = index(frame.width) * index(info.channels);
  const std::uint8_t* in =
      frame.bytes.data() + index(row) * index(frame.width) * index(info.bytesPerPixel);
  if (info.bits <= 8) {
    for (std::size_t i = 0; i < count; ++i) out[i] = (static_cast<float>(in[i]) - black) * scale;
  } else {
    for (std::size_t i = 0; i < count; ++i) {
      const int sample = in[2 * i] | (in[2 * i + 1] << 8);
      out[i] = (static_cast<float>(sample) - black) * scale;
    }
  }
}

std::size_t countSaturated(const Frame& frame) {
  const PixelFormatInfo& info = pixelFormatInfo(frame.format);
  const int maximum = (1 << info.bits) - 1;
  const std::size_t pixels = index(frame.width) * index(frame.height);
  const std::uint8_t* in = frame.bytes.data();
  std::size_t count = 0;
  if (info.channels == 3) {
    for (std::size_t i = 0; i < pixels; ++i) {
      const std::uint8_t* rgb = in + 3 * i;
      count += (rgb[0] == maximum) | (rgb[1] == maximum) | (rgb[2] == maximum) ? 1 : 0;
    }
  } else if (info.bits <= 8) {
    for (std::size_t i = 0; i < pixels; ++i) count += in[i] == maximum ? 1 : 0;
  } else {
    for (std::size_t i = 0; i < pixels; ++i) {
      count += (in[2 * i] | (in[2 * i + 1] << 8)) >= maximum ? 1 : 0;
    }
  }
  return count;
}

// Mirrored without repeating the edge sample, which keeps the Bayer phase.
int mirrored(int i, int size) {
  if (i < 0) i = -i;
  return i >= size ? 2 * size - 2 - i : i;
}

constexpr int kMargin = 2;  // reach of the 5x5 filters

// Malvar, He and Cutler 2004, "High-quality linear interpolation for demosaicing of
// Bayer-patterned color images", figure 2: bilinear plus a gain-weighted Laplacian of the sample's
// own colour. All four filters are evaluated for every pixel of a row (they vectorise and share
// their sums); the parity then picks.
RadianceImage demosaic(const Frame& frame, float black, float scale) {
  const int width = frame.width;
  const int height = frame.height;
  const std::size_t stride = index(width + 2 * kMargin);
  std::vector<float> padded(stride * index(height + 2 * kMargin));
  for (int y = 0; y < height; ++y) {
    float* row = padded.data() + index(y + kMargin) * stride;
    scaleRow(frame, y, black, scale, row + kMargin);
    for (int i = 1; i <= kMargin; ++i) {
      row[kMargin - i] = row[kMargin + mirrored(-i, width)];
      row[kMargin + width - 1 + i] = row[kMargin + mirrored(width - 1 + i, width)];
    }
  }
  for (int i = 1; i <= kMargin; ++i) {
    const auto copyRow = [&](int to, int from) {
      std::copy_n(padded.data() + index(from + kMargin) * stride, stride,
                  padded.data() + index(to + kMargin) * stride);
    };
    copyRow(-i, mirrored(-i, height));
    copyRow(height - 1 + i, mirrored(height - 1 + i, height));
  }

  RadianceImage image(width, height, 3);
  std::vector<float> filtered(4 * index(width));
  float* const cross = filtered.data();         // green at red and blue
  float* const alongRow = cross + width;        // the row's own colour at green
  float* const alongColumn = alongRow + width;  // the other colour at green
  float* const diagonal = alongColumn + width;  // red at blue, blue at red
  for (int y = 0; y < height; ++y) {
    const float* const c = padded.data() + index(y + kMargin) * stride + kMargin;
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
    float* out = image.row(y).data();
    const bool redRow = y % 2 == 0;
    for (int x = 0; x < width; ++x, out += 3) {
      const bool green = (x % 2 == 0) != redRow;
      // The colour that this row's mosaic holds beside green, and the one it lacks.
      const float own = green ? alongRow[x] : c[x];
      const float other = green ? alongColumn[x] : diagonal[x];
      out[0] = redRow ? own : other;
      out[1] = green ? c[x] : cross[x];
      out[2] = redRow ? other : own;
    }
  }
  return image;
}

}  // namespace

Result<LinearFrame> linearise(const Frame& frame, const LineariseOptions& options) {
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
  const double maximum = (1 << info.bits) - 1;
  if (!(options.blackLevel >= 0 && options.blackLevel < maximum)) {
    return failure(ErrorCode::kInvalidArgument, "black level {} is outside {}'s counts 0..{}",
                   options.blackLevel, info.name, maximum);
  }
  double exposure = 1;
  if (options.referenceExposureSeconds > 0) {
    if (!(frame.metadata.exposureSeconds > 0)) {
      return failure(ErrorCode::kInvalidArgument,
                     "frame {}: its exposure time is unknown, so it cannot be brought to the "
                     "reference exposure",
                     frame.metadata.id);
    }
    exposure = options.referenceExposureSeconds / frame.metadata.exposureSeconds *
               std::pow(10.0, (options.referenceGainDb - frame.metadata.gainDb) / 20);
  }
  const auto black = static_cast<float>(options.blackLevel);
  const auto scale = static_cast<float>(exposure / (maximum - options.blackLevel));

  LinearFrame result;
  result.saturatedFraction = static_cast<double>(countSaturated(frame)) /
                             (static_cast<double>(frame.width) * frame.height);
  if (info.isBayer) {
    result.radiance = demosaic(frame, black, scale);
    return result;
  }
  result.radiance = RadianceImage(frame.width, frame.height, 3);
  std::vector<float> grey(index(frame.width));
  for (int y = 0; y < frame.height; ++y) {
    float* out = result.radiance.row(y).data();
    if (info.channels == 3) {
      scaleRow(frame, y, black, scale, out);
    } else {
      scaleRow(frame, y, black, scale, grey.data());
      for (std::size_t x = 0; x < grey.size(); ++x) {
        out[3 * x] = out[3 * x + 1] = out[3 * x + 2] = grey[x];
      }
    }
  }
  return result;
}

}  // namespace lightsketch
