#include "pipeline/relight/relighter.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <utility>

#include "pipeline/relight/render_kernels.h"

namespace lightsketch {
namespace {

namespace tbb = oneapi::tbb;
using Eigen::Index;

Result<void> checkLights(const RelightableModel& model, const LightIntensities& intensities) {
  if (intensities.rows() != model.lightCount()) {
    return failure(ErrorCode::kInvalidArgument,
                   "relight: {} light intensities given, the model has {} lights",
                   intensities.rows(), model.lightCount());
  }
  return {};
}

Result<void> checkModel(const RelightableModel& model) {
  if (const auto misfit = misfitOf(model))
    return failure(ErrorCode::kInvalidArgument, "model: {}", *misfit);
  return {};
}

std::vector<double> unlit(const RelightableModel& model) {
  return std::vector<double>(3 * litStride(model.rank));
}

// addLights on all cores. Parts are cut and summed in a fixed order: v does not depend on the
// number of threads.
void addManyLights(const RelightableModel& model, std::span<const LightChange> changes,
                   std::vector<double>& v) {
  constexpr std::size_t kPart = 256;
  if (changes.size() <= kPart) return addLights(model, changes, v.data());
  const std::size_t parts = (changes.size() + kPart - 1) / kPart;
  std::vector<double> sums(parts * v.size());
  tbb::parallel_for(std::size_t{0}, parts, [&](std::size_t part) {
    const std::size_t first = part * kPart;
    addLights(model, changes.subspan(first, std::min(kPart, changes.size() - first)),
              sums.data() + part * v.size());
  });
  for (std::size_t part = 0; part < parts; ++part) {
    for (std::size_t i = 0; i < v.size(); ++i) v[i] += sums[part * v.size() + i];
  }
}

bool isOn(const LightIntensities& s, Index light) {
  return s(light, 0) != 0 || s(light, 1) != 0 || s(light, 2) != 0;
}

std::vector<LightChange> lightsOn(const LightIntensities& s) {
  std::vector<LightChange> on;
  for (Index i = 0; i < s.rows(); ++i) {
    if (isOn(s, i)) on.push_back({static_cast<int>(i), {s(i, 0), s(i, 1), s(i, 2)}});
  }
  return on;
}

// Runs of blocks that one thread draws after another: each within a row of blocks unless whole
// rows are visible, and of about a thousand rows of E. That is enough work to hide what a task
// costs (some 0.3 us) and that panels of U at its rims are multiplied twice, and little enough for
// a small picture to be shared out evenly.
std::vector<std::pair<int, int>> tasksOf(const RelightableModel& model,
                                         const std::optional<PixelRectangle>& visible) {
  const BlockLayout& layout = model.layout;
  // Blocks first <= i < second that touch the pixels from <= x < from + extent inside the picture.
  const auto touched = [&](std::int64_t from, std::int64_t extent, std::int64_t limit) {
    const std::int64_t begin = std::clamp<std::int64_t>(from, 0, limit);
    const std::int64_t end = std::clamp<std::int64_t>(from + extent, 0, limit);
    const std::int64_t size = layout.blockSize;
    return begin < end ? std::pair(static_cast<int>(begin / size),
                                   static_cast<int>((end + size - 1) / size))
                       : std::pair(0, 0);
  };
  std::pair columns(0, layout.columns());
  std::pair rows(0, layout.rows());
  if (visible) {
    columns = touched(visible->x, visible->width, layout.width);
    rows = touched(visible->y, visible->height, layout.height);
    if (columns.first == columns.second) return {};
  }

  // A block costs its rows and what writing it takes, about four rows more.
  constexpr std::int64_t kTask = 1200;
  constexpr std::int64_t kBlock = 4;
  const auto cost = [&](int j) {
    return model.blockOffset[static_cast<std::size_t>(j)] + kBlock * j;
  };
  std::vector<std::pair<int, int>> tasks;
  const auto cut = [&](int first, int last) {
    const std::int64_t parts = std::max<std::int64_t>(1, (cost(last) - cost(first)) / kTask);
    const std::int64_t start = cost(first);
    const std::int64_t whole = cost(last) - start;
    int from = first;
    for (std::int64_t part = 1; part <= parts; ++part) {
      int to = last;
      if (part < parts) {
        // The first block that costs as much before it: bisection, since costs ascend.
        int low = from;
        while (low < to) {
          const int middle = low + (to - low) / 2;
          if (cost(middle) - start < whole * part / parts) {
            low = middle + 1;
          } else {
            to = middle;
          }
        }
      }
      if (from < to) tasks.emplace_back(from, to);
      from = to;
    }
  };
  if (columns == std::pair(0, layout.columns())) {
    cut(rows.first * layout.columns(), rows.second * layout.columns());
  } else {
    for (int row = rows.first; row < rows.second; ++row) {
      cut(row * layout.columns() + columns.first, row * layout.columns() + columns.second);
    }
  }
  return tasks;
}

void draw(const RelightableModel& model, const std::vector<double>& v, const RenderOptions& options,
          const RenderTarget& target) {
  if (!(options.share > 0 && options.share <= 1)) throw std::logic_error("share of bases");
  // v in floats, with all that scales columns.
  LitBasis basis;
  basis.rank = keptOf(static_cast<std::size_t>(model.rank), options.share);
  std::vector<float> lit(3 * basis.rank);
  const double exposure =
      model.singleLamp ? std::sqrt(double{options.exposure}) : double{options.exposure};
  for (std::size_t c = 0; c < 3; ++c) {
    float* const to = lit.data() + c * basis.rank;
    for (std::size_t k = 0; k < basis.rank; ++k) {
      double value = v[c * litStride(model.rank) + k] * exposure;
      if (!model.U.scale.empty()) value *= double{model.U.scale[k]};
      if (!model.V.scale.empty()) value *= double{model.V.scale[k]};
      to[k] = static_cast<float>(value);
    }
    basis.v[c] = to;
  }
  const auto tasks = tasksOf(model, options.visible);
  tbb::parallel_for(std::size_t{0}, tasks.size(), [&](std::size_t i) {
    renderBlocks(model, basis, options.share, target, tasks[i].first, tasks[i].second);
  });
}

RenderTarget checkedTarget(const RelightableModel& model, PixelFormat format,
                           std::span<std::byte> pixels, std::size_t strideBytes) {
  const auto height = static_cast<std::size_t>(model.layout.height);
  const std::size_t row = static_cast<std::size_t>(model.layout.width) * bytesPerPixel(format);
  const std::size_t alignment = format == PixelFormat::kBgra8 ? 4 : 2;
  if (strideBytes < row || pixels.size() < (height - 1) * strideBytes + row ||
      strideBytes % alignment != 0 ||
      reinterpret_cast<std::uintptr_t>(pixels.data()) % alignment != 0) {
    throw std::logic_error("a picture does not fit where it is to be drawn");
  }
  return {format, pixels.data(), strideBytes};
}

void drawFloats(const RelightableModel& model, const std::vector<double>& v,
                const RenderOptions& options, RadianceImage& picture) {
  if (picture.width() != model.layout.width || picture.height() != model.layout.height ||
      picture.channels() != 3) {
    throw std::logic_error("a picture of another size than the model");
  }
  draw(model, v, options,
       {PixelFormat::kRgbFloat, reinterpret_cast<std::byte*>(picture.data()),
        picture.rowSize() * sizeof(float)});
}

}  // namespace

Relighter::Relighter(std::shared_ptr<const RelightableModel> model)
    : model_(std::move(model)),
      intensities_(LightIntensities::Zero(model_->lightCount(), 3)),
      v_(unlit(*model_)) {}

Result<Relighter> Relighter::create(std::shared_ptr<const RelightableModel> model) {
  RETURN_IF_ERROR(checkModel(*model));
  return Relighter(std::move(model));
}

Result<void> Relighter::setLight(const LightIntensities& intensities) {
  RETURN_IF_ERROR(checkLights(*model_, intensities));
  // What has changed: groups of lights that are the same byte by byte are passed over.
  std::vector<LightChange> changes;
  const double before = magnitude_;
  constexpr Index kGroup = 64;
  for (Index first = 0; first < intensities.rows(); first += kGroup) {
    const Index last = std::min(first + kGroup, intensities.rows());
    const auto bytes = static_cast<std::size_t>(last - first) * sizeof(float);
    const auto same = [&](Index c) {
      return std::memcmp(&intensities(first, c), &intensities_(first, c), bytes) == 0;
    };
    if (same(0) && same(1) && same(2)) continue;
    for (Index i = first; i < last; ++i) {
      LightChange change{static_cast<int>(i), {}};
      bool changed = false;
      for (Index c = 0; c < 3; ++c) {
        const double now = intensities(i, c);
        const double then = intensities_(i, c);
        change.amount[static_cast<std::size_t>(c)] = now - then;
        magnitude_ += std::abs(now) - std::abs(then);
        changed = changed || !(now == then);
      }
      if (!changed) continue;
      on_ += Index{isOn(intensities, i)} - Index{isOn(intensities_, i)};
      intensities_.row(i) = intensities.row(i);
      changes.push_back(change);
    }
  }
  if (changes.empty()) return {};

  // Each increment rounds v by at most 2^-53 of its size, which is at most max |V| times the
  // magnitude of the light. Done anew once the sum of that could be an eighth of the rounding of
  // a float picture under the light there is now: after 2^26 changes of equal light, or at once
  // when a light 10^8 times as bright has gone out. A light that was not finite makes it anew, too.
  constexpr double kRounding = 0x1p-53;
  constexpr double kVisible = 0x1p-27;
  rounding_ += kRounding * static_cast<double>(changes.size()) * std::max(before, magnitude_);
  if (static_cast<Index>(changes.size()) < on_ && rounding_ <= kVisible * magnitude_) {
    addManyLights(*model_, changes, v_);
    return {};
  }
  std::fill(v_.begin(), v_.end(), 0.0);
  addManyLights(*model_, lightsOn(intensities_), v_);
  magnitude_ = intensities_.cast<double>().cwiseAbs().sum();
  rounding_ = 0;
  return {};
}

void Relighter::renderBgra8(std::span<std::byte> pixels, std::size_t strideBytes,
                            const RenderOptions& options) const {
  draw(*model_, v_, options, checkedTarget(*model_, PixelFormat::kBgra8, pixels, strideBytes));
}

void Relighter::renderHalf(std::span<std::byte> pixels, std::size_t strideBytes, int channels,
                           const RenderOptions& options) const {
  if (channels != 3 && channels != 4) throw std::logic_error("half pictures of 3 or 4 channels");
  const PixelFormat format = channels == 3 ? PixelFormat::kRgbHalf : PixelFormat::kRgbaHalf;
  draw(*model_, v_, options, checkedTarget(*model_, format, pixels, strideBytes));
}

void Relighter::render(RadianceImage& picture, const RenderOptions& options) const {
  drawFloats(*model_, v_, options, picture);
}

Result<LightIntensities> singleLamp(const DirectionalLamp& lamp,
                                    const DirectionInterpolator& interpolator) {
  if (lamp.colour.minCoeff() < 0)
    return failure(ErrorCode::kInvalidArgument, "a single-lamp model cannot show a negative lamp");
  const DirectionalLamp root{lamp.direction, lamp.colour.cwiseSqrt()};
  return intensitiesOf(std::span(&root, 1), interpolator);
}

Result<RadianceImage> relight(const RelightableModel& model, const LightIntensities& intensities) {
  RETURN_IF_ERROR(checkModel(model));
  RETURN_IF_ERROR(checkLights(model, intensities));
  try {
    std::vector<double> v = unlit(model);
    addManyLights(model, lightsOn(intensities), v);
    RadianceImage picture(model.layout.width, model.layout.height, 3);
    drawFloats(model, v, {}, picture);
    return picture;
  } catch (const std::bad_alloc&) {
    return failure(ErrorCode::kUnsupported, "relight: not enough memory for a picture of {} x {}",
                   model.layout.width, model.layout.height);
  }
}

}  // namespace lightsketch
