#include "pipeline/illumination/fisheye_light.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <numeric>
#include <optional>
#include <vector>

namespace lightsketch {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// Pixels are taken two by two, which holds one of each colour of a Bayer sensor.
constexpr int kQuad = 2;

// Neighbouring quads of a row that belong to one cell; few enough that their solid angles hardly
// differ (3 percent along 16 pixels near the rim of a 180-degree field 960 pixels wide).
constexpr int kLongestSpan = 8;
struct Span {
  int cell = 0;
  int x = 0;  // quads
  int count = 0;
  std::array<float, 3> weight{};  // steradians a quad over the sensitivity, per colour
};

// Solid angle of a small spherical triangle (Van Oosterom and Strackee 1983).
double triangleArea(const Vector3d& a, const Vector3d& b, const Vector3d& c) {
  return 2 * std::atan2(std::abs(a.dot(b.cross(c))), 1 + a.dot(b) + b.dot(c) + c.dot(a));
}

std::size_t index(Eigen::Index value) { return static_cast<std::size_t>(value); }

}  // namespace

struct FisheyeLight::Tables {
  int width = 0;
  int height = 0;
  std::shared_ptr<const SensorModel> sensor;
  double blackLevel = 0;
  std::vector<std::size_t> firstSpan;  // rows of quads + 1
  std::vector<Span> spans;
  std::vector<int> twin;            // per light: the light whose cell it shares
  std::vector<double> solidAngles;  // per light: of what the camera sees of its cell
  std::vector<double> scale;        // per light: of the sum over the cell
};

Result<FisheyeLight> FisheyeLight::create(const CameraModel& camera,
                                          const Eigen::Isometry3d& sceneFromCamera,
                                          std::span<const Vector3d> lights,
                                          const FisheyeLightOptions& options) {
  if (!(options.lampIrradiance > 0)) {
    return failure(ErrorCode::kInvalidArgument, "the lamp's irradiance must be positive, not {}",
                   options.lampIrradiance);
  }
  ASSIGN_OR_RETURN(const auto cells, LightCells::create(lights, options.cells));
  auto tables = std::make_shared<Tables>();
  Tables& t = *tables;
  t.width = camera.width();
  t.height = camera.height();
  t.sensor = options.sensor;
  t.blackLevel = options.blackLevel;

  // Directions of the quads' corners in the scene; quads with a corner outside the field see
  // nothing.
  const int columns = t.width / kQuad;
  const int rows = t.height / kQuad;
  const auto at = [](int x, int y, int perRow) { return index(y) * index(perRow) + index(x); };
  std::vector<std::optional<Vector3d>> corners(at(0, rows + 1, columns + 1));
  oneapi::tbb::parallel_for(0, rows + 1, [&](int y) {
    for (int x = 0; x <= columns; ++x) {
      if (const auto ray = camera.unproject(Vector2d(kQuad * x, kQuad * y))) {
        corners[at(x, y, columns + 1)] = sceneFromCamera.linear() * *ray;
      }
    }
  });
  std::vector<double> area(at(0, rows, columns), 0);  // 0: sees nothing
  std::vector<int> cellOf(area.size(), -1);
  oneapi::tbb::parallel_for(0, rows, [&](int y) {
    for (int x = 0; x < columns; ++x) {
      const auto& a = corners[at(x, y, columns + 1)];
      const auto& b = corners[at(x + 1, y, columns + 1)];
      const auto& c = corners[at(x + 1, y + 1, columns + 1)];
      const auto& d = corners[at(x, y + 1, columns + 1)];
      if (!a || !b || !c || !d) continue;
      area[at(x, y, columns)] = triangleArea(*a, *b, *c) + triangleArea(*a, *c, *d);
      cellOf[at(x, y, columns)] = cells.cellOf((*a + *b + *c + *d).normalized());
    }
  });
  if (options.sensor) {
    for (const PixelPosition& hot : options.sensor->hotPixels) {
      const int x = hot.x / kQuad;
      const int y = hot.y / kQuad;
      if (x < columns && y < rows) cellOf[at(x, y, columns)] = -1;
    }
  }
  const auto quadOf = [&](const Vector3d& direction) -> std::optional<std::array<int, 2>> {
    const auto pixel = camera.project(sceneFromCamera.linear().transpose() * direction);
    if (!pixel || !((*pixel).minCoeff() >= 0)) return std::nullopt;
    const Vector2d quad = *pixel / kQuad;
    if (!(quad.x() < columns && quad.y() < rows)) return std::nullopt;
    const std::array<int, 2> found{static_cast<int>(quad.x()), static_cast<int>(quad.y())};
    if (area[at(found[0], found[1], columns)] == 0) return std::nullopt;
    return found;
  };

  std::vector<double> sampled(lights.size(), 0);  // steradians of the quads in a cell
  for (std::size_t quad = 0; quad < area.size(); ++quad) {
    if (cellOf[quad] >= 0) sampled[index(cellOf[quad])] += area[quad];
  }
  // Cells smaller than a quad take what the quad at their light sees.
  std::vector<std::vector<Span>> small(index(rows));
  for (std::size_t i = 0; i < lights.size(); ++i) {
    if (sampled[i] > 0 || cells.firstTwin(static_cast<int>(i)) != static_cast<int>(i)) continue;
    if (const auto quad = quadOf(lights[i])) {
      small[index((*quad)[1])].push_back(
          {.cell = static_cast<int>(i), .x = (*quad)[0], .count = 1});
      sampled[i] = area[at((*quad)[0], (*quad)[1], columns)];
    }
  }

  // Runs of quads that share a cell.
  for (int y = 0; y < rows; ++y) {
    t.firstSpan.push_back(t.spans.size());
    for (int x = 0; x < columns;) {
      const int cell = cellOf[at(x, y, columns)];
      int end = x + 1;
      while (end < columns && end < x + kLongestSpan && cellOf[at(end, y, columns)] == cell) ++end;
      if (cell >= 0) t.spans.push_back({.cell = cell, .x = x, .count = end - x});
      x = end;
    }
    t.spans.insert(t.spans.end(), small[index(y)].begin(), small[index(y)].end());
    for (std::size_t k = t.firstSpan.back(); k < t.spans.size(); ++k) {
      Span& span = t.spans[k];
      const double* const first = area.data() + at(span.x, y, columns);
      const double mean = std::accumulate(first, first + span.count, 0.0) / span.count;
      for (int c = 0; c < 3; ++c) {
        double sensitivity = 1;
        if (options.sensor && options.sensor->flatField) {
          const FlatField& flat = *options.sensor->flatField;
          sensitivity = flat.sensitivity((span.x + span.count / 2.0) / columns, (y + 0.5) / rows,
                                         std::min(c, flat.colours() - 1));
        }
        span.weight[index(c)] = static_cast<float>(mean / sensitivity);
      }
    }
  }
  t.firstSpan.push_back(t.spans.size());

  // How much of each cell is seen, by points spread evenly over the sphere: a cell that is wholly
  // seen counts with its exact area, whatever pixels it got.
  constexpr int kPoints = 400000;
  const double goldenAngle = std::numbers::pi * (3 - std::sqrt(5.0));
  std::vector<std::array<int, 2>> found(kPoints, {-1, 0});  // cell, seen
  oneapi::tbb::parallel_for(0, kPoints, [&](int i) {
    const double z = 1 - 2 * (i + 0.5) / kPoints;
    const double r = std::sqrt(1 - z * z);
    const Vector3d point(r * std::cos(goldenAngle * i), r * std::sin(goldenAngle * i), z);
    const int cell = cells.cellOf(point);
    if (cell >= 0) found[index(i)] = {cell, quadOf(point) ? 1 : 0};
  });
  std::vector<std::array<int, 2>> counts(lights.size(), {0, 0});
  for (const auto& [cell, seen] : found) {
    if (cell < 0) continue;
    ++counts[index(cell)][0];
    counts[index(cell)][1] += seen;
  }
  for (std::size_t i = 0; i < lights.size(); ++i) {
    const int twin = cells.firstTwin(static_cast<int>(i));
    const auto& [points, seen] = counts[index(twin)];
    const double part = sampled[index(twin)] == 0 ? 0
                        : points == 0             ? 1
                                                  : static_cast<double>(seen) / points;
    t.twin.push_back(twin);
    t.solidAngles.push_back(part * cells.solidAngles()[i]);
    t.scale.push_back(
        part == 0 ? 0 : t.solidAngles.back() / (options.lampIrradiance * sampled[index(twin)]));
  }
  FisheyeLight light;
  light.tables_ = std::move(tables);
  return light;
}

std::span<const double> FisheyeLight::solidAngles() const { return tables_->solidAngles; }

double FisheyeLight::coveredSolidAngle() const {
  return std::accumulate(tables_->solidAngles.begin(), tables_->solidAngles.end(), 0.0);
}

namespace {

// Radiance of every count, per colour.
using CountTables = std::array<std::vector<float>, 3>;

// Sums of a span's samples, per colour, each over as many samples as a quad has of the colour times
// the quads.
template <class Sample>
void sumMono(const Sample* top, const Sample* bottom, const Span& span, const CountTables& tables,
             Eigen::Array3f& sum) {
  const float* const table = tables[0].data();
  float sums[4] = {0, 0, 0, 0};
  for (int x = kQuad * span.x; x < kQuad * (span.x + span.count); x += kQuad) {
    sums[0] += table[top[x]];
    sums[1] += table[top[x + 1]];
    sums[2] += table[bottom[x]];
    sums[3] += table[bottom[x + 1]];
  }
  sum.setConstant(0.25f * ((sums[0] + sums[1]) + (sums[2] + sums[3])));
}

// `red`: where a quad has it.
template <class Sample>
void sumBayer(const Sample* top, const Sample* bottom, int red, const Span& span,
              const CountTables& tables, Eigen::Array3f& sum) {
  float sums[4] = {0, 0, 0, 0};
  for (int x = kQuad * span.x; x < kQuad * (span.x + span.count); x += kQuad) {
    sums[0] += tables[0][top[x + red]];
    sums[1] += tables[1][top[x + 1 - red]];
    sums[2] += tables[1][bottom[x + red]];
    sums[3] += tables[2][bottom[x + 1 - red]];
  }
  sum = {sums[0], 0.5f * (sums[1] + sums[2]), sums[3]};
}

void sumRgb(const std::uint8_t* top, const std::uint8_t* bottom, const Span& span,
            const CountTables& tables, Eigen::Array3f& sum) {
  sum.setZero();
  for (int x = kQuad * span.x; x < kQuad * (span.x + span.count); ++x) {
    for (int c = 0; c < 3; ++c) {
      sum[c] += tables[index(c)][top[3 * x + c]] + tables[index(c)][bottom[3 * x + c]];
    }
  }
  sum *= 0.25f;
}

}  // namespace

Result<void> FisheyeLight::intensities(const Frame& frame, double radianceAtSaturation,
                                       LightIntensities& out) const {
  const Tables& t = *tables_;
  const PixelFormatInfo& info = pixelFormatInfo(frame.format);
  if (frame.width != t.width || frame.height != t.height) {
    return failure(ErrorCode::kInvalidArgument,
                   "frame {}: {} x {}, but the camera model is of {} x {} pixels; use the camera's "
                   "whole region",
                   frame.metadata.id, frame.width, frame.height, t.width, t.height);
  }
  if (frame.bytes.size() != index(t.width) * index(t.height) * index(info.bytesPerPixel)) {
    return failure(ErrorCode::kCorrupt, "frame {}: {} bytes do not make {} x {} pixels of {}",
                   frame.metadata.id, frame.bytes.size(), t.width, t.height, info.name);
  }
  const double maxCount = (1 << info.bits) - 1;
  std::optional<ResponseCurve> plain;
  if (t.sensor) {
    RETURN_IF_ERROR(t.sensor->checkFits(frame));
  } else {
    ASSIGN_OR_RETURN(
        plain, ResponseCurve::linear(
                   std::vector<double>(index(colourChannels(frame.format)), t.blackLevel), maxCount,
                   maxCount));
  }
  const ResponseCurve& response = plain ? *plain : t.sensor->response;
  CountTables tables;
  for (int c = 0; c < response.colours(); ++c) {
    // Words beyond the format's bits cannot index past the end.
    auto& table = tables[index(c)];
    table.resize(std::size_t{1} << (info.bits > 8 ? 16 : 8));
    const std::size_t counts = std::size_t{1} << info.bits;
    for (std::size_t count = 0; count < table.size(); ++count) {
      table[count] = count < counts
                         ? static_cast<float>(radianceAtSaturation *
                                              response.exposure(static_cast<double>(count), c))
                         : table[counts - 1];
    }
  }

  std::vector<Eigen::Array4f> sums(t.twin.size(), Eigen::Array4f::Zero());
  const auto addAll = [&](const auto* pixels, int samplesPerPixel, const auto& sumSpan) {
    const std::size_t stride = index(t.width) * index(samplesPerPixel);
    for (std::size_t y = 0; y + 1 < t.firstSpan.size(); ++y) {
      const auto* const top = pixels + kQuad * y * stride;
      for (std::size_t k = t.firstSpan[y]; k < t.firstSpan[y + 1]; ++k) {
        const Span& span = t.spans[k];
        Eigen::Array3f sum;
        sumSpan(top, top + stride, span, tables, sum);
        auto& cell = sums[index(span.cell)];
        cell += Eigen::Array4f(sum[0] * span.weight[0], sum[1] * span.weight[1],
                               sum[2] * span.weight[2], 0);
      }
    }
  };
  const std::uint8_t* const bytes = frame.bytes.data();
  // Frames hold little-endian words, and so do the machines this runs on; vectors are aligned.
  const auto* const words = reinterpret_cast<const std::uint16_t*>(bytes);
  if (info.channels == 3) {
    addAll(bytes, 3, sumRgb);
  } else if (info.isBayer) {
    const auto sum = [&info](const auto* top, const auto* bottom, auto&&... rest) {
      sumBayer(info.redY == 0 ? top : bottom, info.redY == 0 ? bottom : top, info.redX, rest...);
    };
    info.bits > 8 ? addAll(words, 1, sum) : addAll(bytes, 1, sum);
  } else {
    info.bits > 8 ? addAll(words, 1, sumMono<std::uint16_t>)
                  : addAll(bytes, 1, sumMono<std::uint8_t>);
  }

  out.resize(static_cast<Eigen::Index>(t.twin.size()), 3);
  for (std::size_t i = 0; i < t.twin.size(); ++i) {
    out.row(static_cast<Eigen::Index>(i)) =
        (static_cast<float>(t.scale[i]) * sums[index(t.twin[i])].head<3>()).transpose();
  }
  return {};
}

}  // namespace lightsketch
