#include "pipeline/validate/metrics.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "capture/frame/srgb.h"

namespace lightsketch {
namespace {

template <class T>
void checkSameShape(const Image<T>& a, const Image<T>& b) {
  if (!a.sameShape(b) || a.empty()) throw std::logic_error("pictures of different shape compared");
}

double psnrOf(double meanSquare, double peak) {
  if (meanSquare <= 0) return kPsnrCap;
  return std::min(kPsnrCap, 10 * std::log10(peak * peak / meanSquare));
}

constexpr int kWindow = 11;

const std::array<double, kWindow>& gaussian() {
  static const auto weights = [] {
    std::array<double, kWindow> w{};
    double sum = 0;
    for (int i = 0; i < kWindow; ++i) {
      const double d = i - kWindow / 2;
      sum += w[static_cast<std::size_t>(i)] = std::exp(-d * d / (2 * 1.5 * 1.5));
    }
    for (double& value : w) value /= sum;
    return w;
  }();
  return weights;
}

Image<double> luma(const Image<std::uint8_t>& rgb) {
  Image<double> out(rgb.width(), rgb.height(), 1);
  for (std::size_t i = 0; i < out.size(); ++i) {
    const std::uint8_t* p = rgb.data() + 3 * i;
    out.data()[i] = double{kRec709Luma[0]} * p[0] + double{kRec709Luma[1]} * p[1] +
                    double{kRec709Luma[2]} * p[2];
  }
  return out;
}

// Separable Gaussian over the windows that lie inside.
Image<double> blurred(const Image<double>& in) {
  Image<double> across(in.width() - kWindow + 1, in.height(), 1);
  for (int y = 0; y < across.height(); ++y) {
    for (int k = 0; k < kWindow; ++k) {
      const double weight = gaussian()[static_cast<std::size_t>(k)];
      const double* from = &in(k, y);
      double* to = &across(0, y);
      for (int x = 0; x < across.width(); ++x) to[x] += weight * from[x];
    }
  }
  Image<double> out(across.width(), in.height() - kWindow + 1, 1);
  for (int y = 0; y < out.height(); ++y) {
    for (int k = 0; k < kWindow; ++k) {
      const double weight = gaussian()[static_cast<std::size_t>(k)];
      const double* from = &across(0, y + k);
      double* to = &out(0, y);
      for (int x = 0; x < out.width(); ++x) to[x] += weight * from[x];
    }
  }
  return out;
}

Image<double> product(const Image<double>& a, const Image<double>& b) {
  Image<double> out(a.width(), a.height(), 1);
  std::transform(a.values().begin(), a.values().end(), b.values().begin(), out.values().begin(),
                 std::multiplies<>());
  return out;
}

}  // namespace

double psnr8(const Image<std::uint8_t>& picture, const Image<std::uint8_t>& truth) {
  checkSameShape(picture, truth);
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    const int d = int{picture.data()[i]} - int{truth.data()[i]};
    sum += static_cast<std::uint64_t>(d * d);
  }
  return psnrOf(static_cast<double>(sum) / static_cast<double>(truth.size()), 255);
}

std::optional<double> ssim8(const Image<std::uint8_t>& picture, const Image<std::uint8_t>& truth) {
  checkSameShape(picture, truth);
  if (truth.channels() != 3) throw std::logic_error("SSIM wants RGB pictures");
  if (truth.width() < kWindow || truth.height() < kWindow) return std::nullopt;
  constexpr double c1 = (0.01 * 255) * (0.01 * 255);
  constexpr double c2 = (0.03 * 255) * (0.03 * 255);

  const Image<double> a = luma(picture);
  const Image<double> b = luma(truth);
  const Image<double> meanA = blurred(a);
  const Image<double> meanB = blurred(b);
  const Image<double> squareA = blurred(product(a, a));
  const Image<double> squareB = blurred(product(b, b));
  const Image<double> cross = blurred(product(a, b));
  double sum = 0;
  for (std::size_t i = 0; i < meanA.size(); ++i) {
    const double ma = meanA.data()[i];
    const double mb = meanB.data()[i];
    const double varianceA = squareA.data()[i] - ma * ma;
    const double varianceB = squareB.data()[i] - mb * mb;
    const double covariance = cross.data()[i] - ma * mb;
    sum += (2 * ma * mb + c1) * (2 * covariance + c2) /
           ((ma * ma + mb * mb + c1) * (varianceA + varianceB + c2));
  }
  return sum / static_cast<double>(meanA.size());
}

LinearError linearError(const RadianceImage& picture, const RadianceImage& truth, double exposure) {
  checkSameShape(picture, truth);
  double error = 0;
  double power = 0;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    const double t = truth.data()[i];
    const double d = picture.data()[i] - t;
    error += d * d;
    power += t * t;
  }
  LinearError result;
  result.psnr = psnrOf(error / static_cast<double>(truth.size()), 1 / exposure);
  if (error > 0) {
    result.relative =
        power > 0 ? std::sqrt(error / power) : std::numeric_limits<double>::infinity();
  }
  return result;
}

}  // namespace lightsketch
