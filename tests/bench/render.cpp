// Drawing speed against this machine's limits, measured in the same run: how far from memory
// bandwidth and from pure arithmetic the relighter is, and how far from exact sRGB its 8 bits.
#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <memory>
#include <random>
#include <vector>

#include "capture/frame/srgb.h"
#include "pipeline/job/machine_limits.h"
#include "pipeline/relight/relighter.h"

namespace lightsketch {
namespace {

constexpr int kBlockRank = 10;
constexpr int kRank = 200;
constexpr int kLights = 4096;

double now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// Seconds of the quickest of as many runs as fit into `budget`, at least five.
template <class Function>
double bestOf(double budget, const Function& function) {
  double best = 1e9;
  const double start = now();
  for (int run = 0; run < 5 || now() - start < budget; ++run) {
    const double before = now();
    function();
    best = std::min(best, now() - before);
  }
  return best;
}

// Random numbers of a factorisation's size, stored as asked; pictures come out in about 0..1.
std::shared_ptr<const RelightableModel> randomModel(int width, int height, int blockRank, int rank,
                                                    int lights, Storage storage) {
  auto model = std::make_shared<RelightableModel>();
  model->layout = {width, height, 16};
  model->rank = rank;
  model->storage = storage;
  for (std::int64_t j = 0; j <= model->layout.blocks(); ++j) {
    model->blockOffset.push_back(j * blockRank);
  }
  const auto n = static_cast<std::size_t>(lights);
  model->lights.assign(n, Eigen::Vector3d::UnitZ());
  model->solidAngles.assign(n, 1.0 / lights);
  std::mt19937 random(1);
  const auto fill = [&](ElementType type, std::int64_t count) {
    // A thousand different numbers, over and over: what they are does not matter for the time.
    StoredFactor factor{FactorValues(type, static_cast<std::size_t>(count)), {}};
    std::uniform_real_distribution<float> number(-1, 1);
    const std::size_t distinct = std::min<std::size_t>(997, factor.values.count());
    const float range = type == ElementType::kInt8 ? 127 : 1;
    for (std::size_t i = 0; i < distinct; ++i) factor.values.set(i, range * number(random));
    const std::size_t bytes = bytesOf(type);
    for (std::size_t i = distinct * bytes; i < factor.values.bytes(); ++i) {
      factor.values.data()[i] = factor.values.data()[i - distinct * bytes];
    }
    return factor;
  };
  const bool floats = storage == Storage::kFloat32;
  const ElementType half = floats ? ElementType::kFloat32 : ElementType::kFloat16;
  model->E = fill(storage == Storage::kQ8 ? ElementType::kInt8 : half,
                  model->rows() * model->layout.pixelsPerBlock());
  if (storage == Storage::kQ8) {
    model->E.scale.assign(static_cast<std::size_t>(model->rows()), 1.0f / 127);
  }
  model->U = fill(half, model->panels() * rank * RelightableModel::kPanelRows);
  model->V = fill(half, std::int64_t{3} * lights * rank);
  return model;
}

double storedBytes(const RelightableModel& model) {
  return static_cast<double>(model.E.values.bytes() + model.U.values.bytes());
}

struct Row {
  const char* name;
  int width, height;
};

// Largest difference from exact sRGB of the same linear picture, in levels, and how many of the
// numbers differ at all.
void printError(const Relighter& relighter, int width, int height) {
  RadianceImage linear(width, height, 3);
  relighter.render(linear);
  FactorValues screen(ElementType::kInt8, static_cast<std::size_t>(width * height) * 4);
  relighter.renderBgra8({screen.data(), screen.bytes()}, static_cast<std::size_t>(width) * 4);
  int worst = 0;
  std::size_t different = 0;
  std::size_t grey = 0;
  for (std::size_t i = 0; i < linear.size(); ++i) {
    const int exact = srgbEncode8(linear.data()[i]);
    const int drawn = static_cast<std::uint8_t>(screen.data()[i / 3 * 4 + 2 - i % 3]);
    worst = std::max(worst, std::abs(exact - drawn));
    different += exact != drawn ? 1 : 0;
    grey += exact > 0 && exact < 255 ? 1 : 0;
  }
  fmt::print(
      "8-bit sRGB: largest error {} level (bar 1), {:.2f} % of {} values differ, {:.0f} % of them "
      "lie between black and white\n",
      worst, 100.0 * static_cast<double>(different) / static_cast<double>(linear.size()),
      linear.size(), 100.0 * static_cast<double>(grey) / static_cast<double>(linear.size()));
}

int run() {
  const double bandwidth = readBandwidth();
  const double peak = fmaPeak();
  fmt::print("memory reads {:.1f} GB/s, multiply-add peak {:.0f} GFLOP/s\n\n", bandwidth * 1e-9,
             peak * 1e-9);
  fmt::print("{:<10} {:<4} {:>8} {:>8} {:>9} {:>8} {:>10} {:>6}\n", "picture", "", "MB", "ms",
             "frames/s", "of memory", "of arithm.", "bar");
  for (const Row& size :
       {Row{"640x480", 640, 480}, Row{"1920x1080", 1920, 1080}, Row{"3840x2160", 3840, 2160}}) {
    for (const Storage storage : {Storage::kFloat32, Storage::kFloat16, Storage::kQ8}) {
      const auto model = randomModel(size.width, size.height, kBlockRank, kRank, kLights, storage);
      auto relighter = Relighter::create(model);
      if (!relighter) {
        fmt::print(stderr, "{}\n", relighter.error().message);
        return 1;
      }
      LightIntensities s = LightIntensities::Zero(kLights, 3);
      s.row(17).setConstant(0.05f);
      if (!relighter->setLight(s)) return 1;
      const auto stride = static_cast<std::size_t>(size.width) * 4;
      FactorValues screen(ElementType::kInt8, stride * static_cast<std::size_t>(size.height));
      const std::span<std::byte> pixels(screen.data(), screen.bytes());
      const double seconds = bestOf(2, [&] { relighter->renderBgra8(pixels, stride); });
      const double bytes = storedBytes(*model) + static_cast<double>(screen.bytes());
      const double flop =
          6.0 * static_cast<double>(model->rows()) * (kRank + model->layout.pixelsPerBlock());
      const bool large = size.width > 3000;
      std::string bar;
      if (large && storage == Storage::kQ8) bar = "0.70 of memory";
      if (large && storage == Storage::kFloat16) bar = "0.85 of memory";
      if (size.width == 640 && storage == Storage::kQ8) bar = "0.50 of arithmetic";
      fmt::print("{:<10} {:<4} {:>8.1f} {:>8.3f} {:>9.0f} {:>8.2f} {:>10.2f}   {}\n", size.name,
                 nameOf(storage), bytes * 1e-6, seconds * 1e3, 1 / seconds,
                 bytes / seconds / bandwidth, flop / seconds / peak, bar);
      if (size.width == 640 && storage == Storage::kQ8) {
        printError(*relighter, size.width, size.height);
        for (const float share : {0.5f, 0.25f}) {
          RenderOptions options;
          options.share = share;
          const double part = bestOf(1, [&] { relighter->renderBgra8(pixels, stride, options); });
          fmt::print("  share {:.2f} of the bases: {:.3f} ms\n", share, part * 1e3);
        }
        RadianceImage linear(size.width, size.height, 3);
        fmt::print("  linear floats: {:.3f} ms\n",
                   bestOf(1, [&] { relighter->render(linear); }) * 1e3);
        std::vector<std::byte> halves(static_cast<std::size_t>(size.width * size.height) * 8);
        fmt::print("  half RGBA: {:.3f} ms\n",
                   bestOf(1, [&] { relighter->renderHalf(halves, 2 * stride, 4); }) * 1e3);
        // One light of all, then all of them.
        const double one = bestOf(1, [&] {
          s(99, 0) += 0.001f;
          (void)relighter->setLight(s);
        });
        const double all = bestOf(1, [&] {
          s.array() += 0.001f;
          (void)relighter->setLight(s);
        });
        fmt::print("  V s: one light changed {:.2f} us, all {} {:.1f} us\n", one * 1e6, kLights,
                   all * 1e6);
      }
    }
  }
  return 0;
}

}  // namespace
}  // namespace lightsketch

int main() { return lightsketch::run(); }
