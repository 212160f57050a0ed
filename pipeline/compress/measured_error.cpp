#include "pipeline/compress/measured_error.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <mutex>

#include "capture/frame/srgb.h"

namespace lightsketch {
namespace {

using Eigen::Index;

// rows of v: q x 3.
using Coefficients = Eigen::Matrix<float, Eigen::Dynamic, 3>;

struct PictureError {
  double truth = 0;   // sum of squares, linear
  double linear = 0;  // of differences
  double srgb = 0;    // of differences in 8 bits
};

PictureError compare(const Factors& factors, const Coefficients& v, bool singleLamp,
                     const RadianceImage& picture) {
  const BlockLayout& layout = factors.layout;
  const int size = layout.blockSize;
  PictureError error;
  Coefficients pixels;
  for (int j = 0; j < layout.blocks(); ++j) {
    const auto from = factors.blockOffset[static_cast<std::size_t>(j)];
    const auto rows = factors.blockOffset[static_cast<std::size_t>(j) + 1] - from;
    pixels = factors.E.middleRows(from, rows).transpose() *
             Coefficients(factors.U.middleRows(from, rows) * v);
    const int left = j % layout.columns() * size;
    const int top = j / layout.columns() * size;
    for (int y = 0; y < std::min(size, layout.height - top); ++y) {
      for (int x = 0; x < std::min(size, layout.width - left); ++x) {
        for (int c = 0; c < 3; ++c) {
          const float truth = picture(left + x, top + y, c);
          const float drawn = pixels(y * size + x, c);
          const float value = singleLamp ? std::pow(std::max(drawn, 0.0f), 2.0f) : drawn;
          error.truth += std::pow(double{truth}, 2);
          error.linear += std::pow(double{value} - double{truth}, 2);
          error.srgb += std::pow(int{srgbEncode8(value)} - int{srgbEncode8(truth)}, 2);
        }
      }
    }
  }
  return error;
}

double decibels(double meanSquare, double peak) {
  constexpr double kBest = 100;  // dB; identical pictures have no noise
  return meanSquare > 0 ? std::min(kBest, 10 * std::log10(peak * peak / meanSquare)) : kBest;
}

}  // namespace

Result<MeasuredError> measureError(const RelightableModel& model, const LightStack& stack,
                                   Progress& progress) {
  constexpr const char* kStage = "measuring the error";
  const double pixels = static_cast<double>(stack.width()) * stack.height();
  const int count = std::min(stack.size(), static_cast<int>(std::clamp(20e6 / pixels, 8.0, 64.0)));
  const Factors factors = factorsOf(model);
  ASSIGN_OR_RETURN(const auto interpolator, interpolatorFor(model));
  std::vector<PictureError> errors(static_cast<std::size_t>(count));
  std::atomic<std::size_t> done = 0;
  std::mutex mutex;  // guards the first failure
  std::optional<Error> failed;
  progress.update(kStage, 0, errors.size());
  oneapi::tbb::parallel_for(0, count, [&](int k) {
    if (progress.cancelled()) return;
    const int i =
        static_cast<int>((2 * k + 1) * static_cast<std::int64_t>(stack.size()) / (2 * count));
    auto picture = stack.read(i);
    if (!picture) {
      const std::scoped_lock lock(mutex);
      if (!failed) failed = std::move(picture).error();
      return;
    }
    const auto& direction = stack.directions()[static_cast<std::size_t>(i)];
    const auto known = std::find(model.lights.begin(), model.lights.end(), direction);
    Coefficients v;
    if (known != model.lights.end()) {
      v = factors.V.middleCols(3 * (known - model.lights.begin()), 3);
    } else {
      const Eigen::VectorXf weights = interpolator.weights(direction).cast<float>();
      v.setZero(factors.V.rows(), 3);
      for (Index light = 0; light < weights.size(); ++light)
        v += weights[light] * factors.V.middleCols(3 * light, 3);
    }
    errors[static_cast<std::size_t>(k)] = compare(factors, v, model.singleLamp, *picture);
    progress.update(kStage, ++done, errors.size());
  });
  if (failed) return tl::unexpected<Error>(std::move(*failed));
  if (progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
  MeasuredError result;
  result.pictures = count;
  double truth = 0;
  double linear = 0;
  for (const auto& error : errors) {
    truth += error.truth;
    linear += error.linear;
    result.srgbPsnr += decibels(error.srgb / (3 * pixels), 255) / count;
  }
  result.relative = truth > 0 ? std::sqrt(linear / truth) : 0;
  result.linearPsnr = decibels(linear / (3 * pixels * count), 1);
  return result;
}

}  // namespace lightsketch
