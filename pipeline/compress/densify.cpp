#include "pipeline/compress/densify.h"

#include <cblas.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "capture/frame/srgb.h"
#include "pipeline/illumination/light_grid.h"

namespace lightsketch {
namespace {

using Eigen::MatrixXf;
using Eigen::Vector3d;

// Every half float's value, as it is and sRGB-encoded: exact and faster than converting.
class HalfTable {
 public:
  explicit HalfTable(bool encoded) : values_(1 << 16) {
    for (std::size_t bits = 0; bits < values_.size(); ++bits) {
      const auto half = Eigen::numext::bit_cast<Eigen::half>(static_cast<std::uint16_t>(bits));
      const float value = static_cast<float>(half);
      values_[bits] = encoded ? srgbEncode(value) : value;
    }
  }
  float operator[](std::uint16_t bits) const { return values_[bits]; }

 private:
  std::vector<float> values_;
};

// srgbDecode of values from 0, by linear interpolation in a table up to 2 (error below 3e-8).
class SrgbDecoder {
 public:
  SrgbDecoder() : table_(kSteps + 2) {
    for (std::size_t i = 0; i < table_.size(); ++i)
      table_[i] = srgbDecode(static_cast<float>(i) / kScale);
  }
  float operator()(float encoded) const {
    if (!(encoded > 0)) return 0;
    const float position = encoded * kScale;
    if (position >= kSteps) return srgbDecode(encoded);
    const auto index = static_cast<std::size_t>(position);
    return table_[index] +
           (position - static_cast<float>(index)) * (table_[index + 1] - table_[index]);
  }

 private:
  static constexpr std::size_t kSteps = 8192;
  static constexpr float kScale = 4096;
  std::vector<float> table_;
};

// Where the model's lights are and how its pictures come from the captured ones.
struct LightPlan {
  std::vector<Vector3d> lights;
  InterpolationSettings interpolation;  // between the model's lights
  InterpolationSettings captured;       // between the captured ones
  // N x n: picture of each of the model's lights as a sum of captured ones, in the encoded domain.
  // Empty if the model's lights are the captured ones.
  RowMajorMatrixf weights;
  std::string description;
};

// About 4000 values per captured light, from blocks spread over the picture.
Result<MatrixXf> samplesOf(const ScratchStack& scratch, const BlockLayout& layout,
                           const HalfTable& table) {
  constexpr int kBlocks = 32;
  constexpr std::size_t kStep = 7;  // prime to the block's width: all rows, columns and channels
  const int blocks = std::min(kBlocks, layout.blocks());
  std::vector<std::vector<float>> rows(static_cast<std::size_t>(scratch.images()));
  std::vector<std::uint16_t> halfs;
  for (int k = 0; k < blocks; ++k) {
    const int block =
        static_cast<int>((2 * k + 1) * static_cast<std::int64_t>(layout.blocks()) / (2 * blocks));
    RETURN_IF_ERROR(scratch.read(block / layout.columns(), block % layout.columns(), 1, halfs));
    for (std::size_t i = 0; i < rows.size(); ++i) {
      for (std::size_t v = static_cast<std::size_t>(k) % kStep; v < scratch.blockValues();
           v += kStep) {
        rows[i].push_back(table[halfs[i * scratch.blockValues() + v]]);
      }
    }
  }
  MatrixXf samples(static_cast<Eigen::Index>(rows.size()),
                   static_cast<Eigen::Index>(rows[0].size()));
  for (std::size_t i = 0; i < rows.size(); ++i) {
    samples.row(static_cast<Eigen::Index>(i)) = Eigen::Map<const Eigen::RowVectorXf>(
        rows[i].data(), static_cast<Eigen::Index>(rows[i].size()));
  }
  return samples;
}

// Nodes for n captured lights. Eight times as many halve the spacing and a half more: on the six
// RealRTI sets that is where nothing is lost against interpolating in the encoded domain itself.
// Sets that are dense already are taken as they are.
int densityFor(int captures) {
  constexpr int kDense = 512;
  return captures > kDense ? CompressOptions::kDensifyOff : std::clamp(8 * captures, 256, 1024);
}

Result<LightPlan> planLights(const LightStack& stack, const ScratchStack& scratch,
                             const BlockLayout& layout, int nodes, bool nearLight) {
  LightPlan plan;
  const auto& captured = stack.directions();
  if (nodes == CompressOptions::kDensifyAuto) nodes = densityFor(stack.size());
  if (nearLight && nodes == CompressOptions::kDensifyOff) nodes = 1024;
  const bool densify = nodes != CompressOptions::kDensifyOff;
  ASSIGN_OR_RETURN(const MatrixXf samples, samplesOf(scratch, layout, HalfTable(densify)));
  ASSIGN_OR_RETURN(const auto settings, chooseInterpolation(captured, samples));
  if (!densify) {
    plan.lights = captured;
    plan.interpolation = settings;
    return plan;
  }
  ASSIGN_OR_RETURN(const auto cells, LightCells::create(captured));
  const bool below =
      std::any_of(captured.begin(), captured.end(), [](const Vector3d& d) { return d.z() < 0; });
  ASSIGN_OR_RETURN(const auto grid,
                   below ? LightGrid::create(std::min(2 * nodes, 10000), LightGrid::Domain::kSphere)
                         : LightGrid::create(nodes));
  for (const auto& node : grid.directions()) {
    if (cells.cellOf(node) >= 0) plan.lights.push_back(node);
  }
  ASSIGN_OR_RETURN(const auto interpolator, DirectionInterpolator::create(captured, settings));
  plan.weights.resize(static_cast<Eigen::Index>(plan.lights.size()), stack.size());
  for (std::size_t i = 0; i < plan.lights.size(); ++i) {
    plan.weights.row(static_cast<Eigen::Index>(i)) =
        interpolator.weights(plan.lights[i]).cast<float>().transpose();
  }
  // Between nodes this dense, kernels differ by hundredths of a decibel.
  plan.interpolation = {.kernel = InterpolationSettings::Kernel::kThinPlate,
                        .trendDegree = 1,
                        .nugget = 0,
                        .outsideClamp = 1};
  plan.captured = interpolator.settings();
  plan.description = interpolator.settings().describe();
  return plan;
}

// One block of a subject near the lamps: turns what was captured into what lamps as far from every
// pixel as from the origin would have given, and returns the block's own weights (as
// LightPlan::weights), for the lights as seen from its middle.
Result<RowMajorMatrixf> nearWeights(const LightStack& stack, const LightPlan& plan,
                                    const SurfacePoints& surface, const BlockLayout& layout,
                                    int block, std::vector<float>& captured) {
  const int size = layout.blockSize;
  const int left = block % layout.columns() * size;
  const int top = block / layout.columns() * size;
  const auto p = static_cast<std::size_t>(layout.pixelsPerBlock());
  std::vector<std::pair<std::size_t, Vector3d>> points;  // of the pixels that the picture has
  Vector3d middle = Vector3d::Zero();
  for (int y = 0; y < size && top + y < layout.height; ++y) {
    for (int x = 0; x < size && left + x < layout.width; ++x) {
      points.emplace_back(static_cast<std::size_t>(y * size + x),
                          Vector3d(surface(left + x, top + y, 0), surface(left + x, top + y, 1),
                                   surface(left + x, top + y, 2)));
      middle += points.back().second;
    }
  }
  middle /= static_cast<double>(points.size());
  std::vector<Vector3d> directions;
  for (std::size_t i = 0; i < static_cast<std::size_t>(stack.size()); ++i) {
    const Vector3d& lamp = *stack.positions()[i];
    directions.push_back((lamp - middle).normalized());
    for (const auto& [pixel, point] : points) {
      const auto factor = static_cast<float>(1 / nearFactor(lamp, point));
      for (std::size_t c = 0; c < 3; ++c) {
        float& value = captured[(i * 3 + c) * p + pixel];
        value = srgbEncode(value * factor);
      }
    }
  }
  ASSIGN_OR_RETURN(const auto interpolator,
                   DirectionInterpolator::create(directions, plan.captured));
  RowMajorMatrixf weights(static_cast<Eigen::Index>(plan.lights.size()), stack.size());
  for (std::size_t i = 0; i < plan.lights.size(); ++i) {
    weights.row(static_cast<Eigen::Index>(i)) =
        interpolator.weights(plan.lights[i]).cast<float>().transpose();
  }
  return weights;
}

}  // namespace

struct Densifier::State {
  State(const LightStack& captures, const BlockLayout& blocks, const SurfacePoints* points,
        LightPlan lightPlan)
      : stack(captures),
        layout(blocks),
        surface(points),
        plan(std::move(lightPlan)),
        active(plan.weights.size() > 0),
        table(active && !points) {}  // near lights are encoded after their distance
  const LightStack& stack;
  BlockLayout layout;
  const SurfacePoints* surface;
  LightPlan plan;
  bool active;
  HalfTable table;
  SrgbDecoder decode;
};

Result<Densifier> Densifier::create(const LightStack& stack, const ScratchStack& scratch,
                                    const BlockLayout& layout, const CompressOptions& options,
                                    Progress& progress) {
  progress.update("choosing the interpolation", 0, 1);
  ASSIGN_OR_RETURN(LightPlan plan,
                   planLights(stack, scratch, layout, options.densify, options.surface != nullptr));
  Densifier densifier;
  densifier.state_ =
      std::make_shared<const State>(stack, layout, options.surface.get(), std::move(plan));
  return densifier;
}

const std::vector<Vector3d>& Densifier::lights() const { return state_->plan.lights; }
const InterpolationSettings& Densifier::interpolation() const { return state_->plan.interpolation; }
bool Densifier::active() const { return state_->active; }
const std::string& Densifier::description() const { return state_->plan.description; }

Result<void> Densifier::columns(int block, const std::uint16_t* halfs, std::size_t stride,
                                Workspace& workspace, std::vector<float>& columns) const {
  const State& s = *state_;
  const auto images = static_cast<std::size_t>(s.stack.size());
  const auto values = 3 * static_cast<std::size_t>(s.layout.pixelsPerBlock());
  std::vector<float>& captured = s.active ? workspace.captured : columns;
  captured.resize(images * values);
  for (std::size_t i = 0; i < images; ++i) {
    float* target = captured.data() + i * values;
    for (std::size_t v = 0; v < values; ++v) target[v] = s.table[halfs[i * stride + v]];
  }
  if (!s.active) return {};
  const RowMajorMatrixf* weights = &s.plan.weights;
  if (s.surface) {
    ASSIGN_OR_RETURN(workspace.weights,
                     nearWeights(s.stack, s.plan, *s.surface, s.layout, block, captured));
    weights = &workspace.weights;
  }
  columns.resize(s.plan.lights.size() * values);
  cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, static_cast<int>(s.plan.lights.size()),
              static_cast<int>(values), static_cast<int>(images), 1, weights->data(),
              static_cast<int>(images), captured.data(), static_cast<int>(values), 0,
              columns.data(), static_cast<int>(values));
  for (float& value : columns) value = s.decode(value);
  return {};
}

}  // namespace lightsketch
