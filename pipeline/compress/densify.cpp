#include "pipeline/compress/densify.h"

#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <utility>

#include "capture/frame/srgb.h"
#include "pipeline/compress/encoded_domain.h"
#include "pipeline/compress/kernels.h"
#include "pipeline/illumination/interpolation_mixture.h"
#include "pipeline/illumination/light_grid.h"

namespace lightsketch {
namespace {

using Eigen::MatrixXd;
using Eigen::MatrixXf;
using Eigen::Vector3d;
using Eigen::VectorXd;
template <class T>
using PerDomain = std::array<T, kEncodedDomains>;

constexpr EncodedDomain kDomains[] = {EncodedDomain::kSrgb, EncodedDomain::kLog};
constexpr std::size_t indexOf(EncodedDomain domain) { return static_cast<std::size_t>(domain); }

// Every half float's value, encoded: exact and faster than converting.
class HalfTable {
 public:
  HalfTable() = default;
  template <class Function>
  explicit HalfTable(Function function) : values_(1 << 16) {
    for (std::size_t bits = 0; bits < values_.size(); ++bits) {
      const auto half = Eigen::numext::bit_cast<Eigen::half>(static_cast<std::uint16_t>(bits));
      values_[bits] = function(static_cast<float>(half));
    }
  }
  float operator[](std::uint16_t bits) const { return values_[bits]; }

 private:
  std::vector<float> values_;
};

// One way to interpolate: settings in a domain.
struct Way {
  EncodedDomain domain = EncodedDomain::kSrgb;
  InterpolationSettings settings;
  RowMajorMatrixf leaveOneOut;  // n x n
  RowMajorMatrixf weights;      // N x n
};

// How pictures under the captured lights become those under the model's. Every block mixes the ways
// by its own leave-one-out errors, held back by those of the whole picture.
struct Mixture {
  float white = 1;  // encoded values are relative to it
  std::vector<Way> ways;
  // Products of the ways' errors, relative to the error of the picture's mixture: over all lights,
  // and over those at the rim. Empty if there is but one way.
  MatrixXd everywhere;
  MatrixXd atRim;
  VectorXd picture;             // the picture's mixture
  std::vector<float> emphasis;  // per captured light: factor on its errors
};

// Where the model's lights are and how its pictures come from the captured ones.
struct LightPlan {
  std::vector<Vector3d> lights;  // first those inside the captured lights' hull
  std::size_t inside = 0;
  InterpolationSettings interpolation;  // between the model's lights
  InterpolationSettings captured;       // between the captured ones, if each block solves its own
  bool active = false;                  // else the model's lights are the captured ones
  Mixture mixture;
  std::string description;
};

// About 110 values each, n x v, linear, from blocks spread over the picture.
Result<std::vector<RowMajorMatrixf>> samplesOf(const ScratchStack& scratch,
                                               const BlockLayout& layout) {
  constexpr int kBlocks = 32;
  constexpr std::size_t kStep = 7;  // prime to the block's width: all rows, columns and channels
  const int blocks = std::min(kBlocks, layout.blocks());
  const auto images = static_cast<std::size_t>(scratch.images());
  const HalfTable linear([](float value) { return value; });
  std::vector<std::uint16_t> halfs(images * scratch.blockValues());
  std::vector<RowMajorMatrixf> samples;
  for (int k = 0; k < blocks; ++k) {
    const int block =
        static_cast<int>((2 * k + 1) * static_cast<std::int64_t>(layout.blocks()) / (2 * blocks));
    RETURN_IF_ERROR(scratch.read(block, halfs.data()));
    const std::size_t first = static_cast<std::size_t>(k) % kStep;
    RowMajorMatrixf part(
        static_cast<Eigen::Index>(images),
        static_cast<Eigen::Index>((scratch.blockValues() - first + kStep - 1) / kStep));
    for (std::size_t i = 0; i < images; ++i) {
      for (Eigen::Index v = 0; v < part.cols(); ++v) {
        part(static_cast<Eigen::Index>(i), v) =
            linear[halfs[i * scratch.blockValues() + first + static_cast<std::size_t>(v) * kStep]];
      }
    }
    samples.push_back(std::move(part));
  }
  return samples;
}

MatrixXf sideBySide(const std::vector<RowMajorMatrixf>& parts) {
  Eigen::Index columns = 0;
  for (const auto& part : parts) columns += part.cols();
  MatrixXf all(parts[0].rows(), columns);
  columns = 0;
  for (const auto& part : parts) {
    all.middleCols(columns, part.cols()) = part;
    columns += part.cols();
  }
  return all;
}

// Sums over lights and values of the products of the ways' leave-one-out errors, as sRGB-encoded.
// `encoded`: n x v in each domain that a way is of.
MatrixXd errorProducts(const std::vector<Way>& ways, const PerDomain<RowMajorMatrixf>& encoded,
                       const std::vector<float>& emphasis) {
  const RowMajorMatrixf& truth = encoded[indexOf(EncodedDomain::kSrgb)];
  const auto n = truth.rows();
  const auto size = truth.size();
  PerDomain<PackedMatrix> packed{PackedMatrix(MatrixView(encoded[0]), Cores::kOne),
                                 PackedMatrix(MatrixView(encoded[1]), Cores::kOne)};
  RowMajorMatrixf errors(static_cast<Eigen::Index>(ways.size()), size);
  for (std::size_t k = 0; k < ways.size(); ++k) {
    float* error = errors.row(static_cast<Eigen::Index>(k)).data();
    const std::size_t domain = indexOf(ways[k].domain);
    multiply(MatrixView(ways[k].leaveOneOut), packed[domain], error,
             static_cast<std::size_t>(truth.cols()), Cores::kOne);
    Eigen::Map<RowMajorMatrixf> predicted(error, n, truth.cols());
    predicted = predicted.cwiseMax(0.0f).cwiseMin(encoded[domain].maxCoeff());
    if (ways[k].domain == EncodedDomain::kLog) srgbFromLog(error, static_cast<std::size_t>(size));
    predicted =
        Eigen::Map<const Eigen::VectorXf>(emphasis.data(), n).asDiagonal() * (predicted - truth);
  }
  return (errors * errors.transpose()).cast<double>();
}

MatrixXd relativeTo(const MatrixXd& products, const VectorXd& mixture) {
  const double error = mixture.dot(products * mixture);
  return error > 0 ? MatrixXd(products / error) : MatrixXd(0 * products);
}

// How much the picture's errors count against a block's own, and all lights' errors against those
// at the rim: 0.3 is the least of what was tried for blocks (to 10) and was best; at the rim 0.1
// and 0.3 are alike.
constexpr double kPictureAgainstBlock = 0.3;
constexpr double kAllAgainstRim = 0.3;

VectorXd mixtureInside(const Mixture& m, const MatrixXd& block) {
  return bestMixture(relativeTo(block, m.picture) + kPictureAgainstBlock * m.everywhere);
}
VectorXd mixtureOutside(const Mixture& m, const MatrixXd& block) {
  return bestMixture(m.atRim +
                     kAllAgainstRim / (1 + kPictureAgainstBlock) *
                         (relativeTo(block, m.picture) + kPictureAgainstBlock * m.everywhere));
}

constexpr std::size_t kMostMixed = 1024;  // captured lights; more would take n^3 time a way
constexpr std::size_t kMostWays = 10;     // for the blocks to choose from

// Chooses the ways by leave-one-out over samples of the picture. Without weights yet.
Mixture chooseMixture(std::span<const Vector3d> captured,
                      const std::vector<RowMajorMatrixf>& samples) {
  Mixture mixture;
  // White: what one value in a thousand exceeds.
  std::vector<float> values;
  for (const auto& part : samples) {
    values.insert(values.end(), part.data(), part.data() + part.size());
  }
  const auto place = static_cast<std::ptrdiff_t>(values.size() - 1 - values.size() / 1000);
  std::nth_element(values.begin(), values.begin() + place, values.end());
  mixture.white = std::max(values[static_cast<std::size_t>(place)], 1e-6f);
  std::vector<PerDomain<RowMajorMatrixf>> encoded(samples.size());
  for (std::size_t b = 0; b < samples.size(); ++b) {
    for (const EncodedDomain domain : kDomains) {
      encoded[b][indexOf(domain)] = samples[b].unaryExpr(
          [&](float value) { return encodeValue(domain, value / mixture.white); });
    }
  }
  std::vector<Way> ways;
  if (captured.size() <= kMostMixed) {
    for (const auto& candidate : interpolationCandidates(captured)) {
      for (const EncodedDomain domain : kDomains) {
        ways.push_back({domain, candidate.settings, candidate.leaveOneOut, {}});
      }
    }
  }
  if (ways.empty()) return mixture;

  // Every light counts the same, however hard it is to predict: errors are divided by those of a
  // single plain way.
  auto plain = std::find_if(ways.begin(), ways.end(), [](const Way& way) {
    return way.settings.stretch == 1 && way.settings.nugget > 1e-3;
  });
  if (plain == ways.end()) plain = ways.begin();
  VectorXd squared = VectorXd::Constant(static_cast<Eigen::Index>(captured.size()), 1e-9);
  for (const auto& part : encoded) {
    squared += (plain->leaveOneOut * part[0] - part[0]).rowwise().squaredNorm().cast<double>();
  }
  squared.array() += 1e-3 * squared.mean();
  for (const double error : squared)
    mixture.emphasis.push_back(static_cast<float>(std::sqrt(squared.mean() / error)));
  std::vector<float> rimEmphasis(captured.size(), 0.0f);
  for (const int i : rimLights(captured))
    rimEmphasis[static_cast<std::size_t>(i)] = mixture.emphasis[static_cast<std::size_t>(i)];

  std::vector<MatrixXd> products(encoded.size());
  std::vector<MatrixXd> rim(encoded.size());
  oneapi::tbb::parallel_for(std::size_t{0}, encoded.size(), [&](std::size_t b) {
    products[b] = errorProducts(ways, encoded[b], mixture.emphasis);
    rim[b] = errorProducts(ways, encoded[b], rimEmphasis);
  });
  mixture.everywhere = std::accumulate(products.begin() + 1, products.end(), products[0]);
  mixture.atRim = std::accumulate(rim.begin() + 1, rim.end(), rim[0]);
  mixture.picture = bestMixture(mixture.everywhere);
  mixture.everywhere = relativeTo(mixture.everywhere, mixture.picture);
  mixture.atRim = relativeTo(mixture.atRim, mixture.picture);

  // Keep the ways that blocks, picture and rim want most.
  std::vector<VectorXd> wanted(products.size());
  oneapi::tbb::parallel_for(std::size_t{0}, products.size(), [&](std::size_t b) {
    wanted[b] = mixtureInside(mixture, products[b]) / static_cast<double>(products.size());
  });
  const VectorXd demand = std::accumulate(wanted.begin(), wanted.end(),
                                          VectorXd(mixture.picture + bestMixture(mixture.atRim)));
  std::vector<Eigen::Index> kept(ways.size());
  std::iota(kept.begin(), kept.end(), Eigen::Index{0});
  std::stable_sort(kept.begin(), kept.end(),
                   [&](Eigen::Index a, Eigen::Index b) { return demand[a] > demand[b]; });
  kept.resize(std::min(kept.size(), kMostWays));
  mixture.everywhere = MatrixXd(mixture.everywhere(kept, kept));
  mixture.atRim = MatrixXd(mixture.atRim(kept, kept));
  mixture.picture = bestMixture(mixture.everywhere);
  for (const Eigen::Index k : kept) {
    mixture.ways.push_back(std::move(ways[static_cast<std::size_t>(k)]));
  }
  return mixture;
}

std::string describe(const Mixture& mixture) {
  Eigen::Index most = 0;
  mixture.picture.maxCoeff(&most);
  double log = 0;
  for (std::size_t k = 0; k < mixture.ways.size(); ++k) {
    if (mixture.ways[k].domain == EncodedDomain::kLog)
      log += mixture.picture[static_cast<Eigen::Index>(k)];
  }
  return fmt::format(
      "{} ways mixed per block by leave-one-out, {:.0f} % of them in the log domain;"
      " most of all {}",
      mixture.ways.size(), 100 * log,
      mixture.ways[static_cast<std::size_t>(most)].settings.describe());
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
  plan.active = nodes != CompressOptions::kDensifyOff;
  ASSIGN_OR_RETURN(const auto samples, samplesOf(scratch, layout));
  if (!plan.active) {
    plan.lights = captured;
    ASSIGN_OR_RETURN(plan.interpolation, chooseInterpolation(captured, sideBySide(samples)));
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
  // Between nodes this dense, kernels differ by hundredths of a decibel.
  plan.interpolation = {.kernel = InterpolationSettings::Kernel::kThinPlate,
                        .trendDegree = 1,
                        .nugget = 0,
                        .outsideClamp = 1};

  if (!nearLight) plan.mixture = chooseMixture(captured, samples);
  Mixture& mixture = plan.mixture;
  if (mixture.ways.empty()) {
    ASSIGN_OR_RETURN(const auto settings,
                     chooseInterpolation(captured, sideBySide(samples).unaryExpr([&](float value) {
                       return encodeValue(EncodedDomain::kSrgb, value / mixture.white);
                     })));
    mixture.ways.push_back({EncodedDomain::kSrgb, settings, {}, {}});
    mixture.picture = VectorXd::Ones(1);
    plan.captured = settings;
  }
  ASSIGN_OR_RETURN(const auto any, DirectionInterpolator::create(captured, {}));
  plan.inside = static_cast<std::size_t>(
      std::stable_partition(plan.lights.begin(), plan.lights.end(),
                            [&](const Vector3d& node) { return any.insideHull(node); }) -
      plan.lights.begin());
  if (nearLight) {  // every block has weights of its own
    plan.description = plan.captured.describe();
    return plan;
  }
  for (Way& way : mixture.ways) {
    ASSIGN_OR_RETURN(const auto interpolator,
                     DirectionInterpolator::create(captured, way.settings));
    way.weights.resize(static_cast<Eigen::Index>(plan.lights.size()), stack.size());
    oneapi::tbb::parallel_for(std::size_t{0}, plan.lights.size(), [&](std::size_t i) {
      way.weights.row(static_cast<Eigen::Index>(i)) =
          interpolator.weights(plan.lights[i]).cast<float>().transpose();
    });
    way.settings = interpolator.settings();
  }
  plan.description = describe(mixture);
  return plan;
}

// One block of a subject near the lamps: turns what was captured into what lamps as far from every
// pixel as from the origin would have given, and returns the block's own weights (as
// LightPlan::weights), for the lights as seen from its middle.
Result<RowMajorMatrixf> nearWeights(const LightStack& stack, const LightPlan& plan,
                                    const SurfacePoints& surface, const BlockLayout& layout,
                                    int block, float* captured) {
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
        LightPlan lightPlan, bool squareRoots)
      : stack(captures),
        layout(blocks),
        surface(points),
        plan(std::move(lightPlan)),
        roots(squareRoots) {
    if (!plan.active || surface) {  // near lights are encoded after their distance
      tables[0] = HalfTable([](float value) { return value; });
      return;
    }
    for (const Way& way : plan.mixture.ways) wanted[indexOf(way.domain)] = true;
    wanted[0] = true;  // errors are measured in it
    for (const EncodedDomain domain : kDomains) {
      if (!wanted[indexOf(domain)]) continue;
      tables[indexOf(domain)] =
          HalfTable([&](float value) { return encodeValue(domain, value / plan.mixture.white); });
    }
  }

  const LightStack& stack;
  BlockLayout layout;
  const SurfacePoints* surface;
  LightPlan plan;
  bool roots;  // of a single-lamp model
  PerDomain<bool> wanted{};
  PerDomain<HalfTable> tables;
};

Result<Densifier> Densifier::create(const LightStack& stack, const ScratchStack& scratch,
                                    const BlockLayout& layout, const CompressOptions& options,
                                    Progress& progress) {
  progress.update("choosing the interpolation", 0, 1);
  ASSIGN_OR_RETURN(LightPlan plan,
                   planLights(stack, scratch, layout, options.densify, options.surface != nullptr));
  Densifier densifier;
  densifier.state_ = std::make_shared<const State>(stack, layout, options.surface.get(),
                                                   std::move(plan), options.singleLamp);
  return densifier;
}

const std::vector<Vector3d>& Densifier::lights() const { return state_->plan.lights; }
const InterpolationSettings& Densifier::interpolation() const { return state_->plan.interpolation; }
bool Densifier::active() const { return state_->plan.active || state_->roots; }
bool Densifier::squareRoots() const { return state_->roots; }
const std::string& Densifier::description() const { return state_->plan.description; }

Result<void> Densifier::columns(int block, const std::uint16_t* halfs, std::size_t stride,
                                Workspace& workspace, std::vector<float>& columns) const {
  RETURN_IF_ERROR(linearColumns(block, halfs, stride, workspace, columns));
  if (!state_->roots) return {};
  for (float& value : columns) value = std::sqrt(std::max(value, 0.0f));
  return {};
}

Result<void> Densifier::linearColumns(int block, const std::uint16_t* halfs, std::size_t stride,
                                      Workspace& workspace, std::vector<float>& columns) const {
  const State& s = *state_;
  const LightPlan& plan = s.plan;
  const auto images = static_cast<std::size_t>(s.stack.size());
  const auto values = 3 * static_cast<std::size_t>(s.layout.pixelsPerBlock());
  const auto decodeTo = [&](const HalfTable& table, float* target) {
    for (std::size_t i = 0; i < images; ++i) {
      for (std::size_t v = 0; v < values; ++v) *target++ = table[halfs[i * stride + v]];
    }
  };
  if (!plan.active) {
    columns.resize(images * values);
    decodeTo(s.tables[0], columns.data());
    return {};
  }
  columns.resize(plan.lights.size() * values);
  PerDomain<RowMajorMatrixf>& captured = workspace.captured;
  for (const EncodedDomain domain : kDomains) {
    if (!s.wanted[indexOf(domain)] && !s.surface) continue;
    captured[indexOf(domain)].resize(static_cast<Eigen::Index>(images),
                                     static_cast<Eigen::Index>(values));
    if (domain == EncodedDomain::kSrgb || !s.surface)
      decodeTo(s.tables[indexOf(domain)], captured[indexOf(domain)].data());
  }
  if (s.surface) {
    ASSIGN_OR_RETURN(const RowMajorMatrixf weights,
                     nearWeights(s.stack, plan, *s.surface, s.layout, block, captured[0].data()));
    multiply(MatrixView(weights), MatrixView(captured[0]), columns.data(), values, Cores::kOne);
    mixDomains({columns.data(), 1, captured[0].maxCoeff()}, {}, columns.size(), 1, columns.data());
    return {};
  }

  // The block's mixtures, from every third value: colours and pixels are alike enough.
  const Mixture& mixture = plan.mixture;
  VectorXd mixtures[2] = {mixture.picture, mixture.picture};  // inside and outside the hull
  if (mixture.ways.size() > 1) {
    PerDomain<RowMajorMatrixf> thinned;
    const auto count = static_cast<Eigen::Index>(values / 3);
    for (std::size_t d = 0; d < captured.size(); ++d) {
      if (s.wanted[d]) thinned[d] = captured[d](Eigen::all, Eigen::seqN(0, count, 3));
    }
    const MatrixXd products = errorProducts(mixture.ways, thinned, mixture.emphasis);
    mixtures[0] = mixtureInside(mixture, products);
    mixtures[1] = mixtureOutside(mixture, products);
  }

  // A few lights at a time, so that what is predicted is still in the cache when it is decoded.
  constexpr std::size_t kLightsAtOnce = 64;
  std::vector<PackedMatrix> packed;
  PerDomain<float> largest{};
  for (std::size_t d = 0; d < captured.size(); ++d) {
    packed.emplace_back(s.wanted[d] ? MatrixView(captured[d]) : MatrixView(), Cores::kOne);
    if (s.wanted[d]) largest[d] = captured[d].maxCoeff();
  }
  workspace.log.resize(kLightsAtOnce * values);
  for (std::size_t first = 0; first < plan.lights.size();) {
    const bool outside = first >= plan.inside;
    const std::size_t count =
        std::min(kLightsAtOnce, (outside ? plan.lights.size() : plan.inside) - first);
    const PerDomain<float*> target{columns.data() + first * values, workspace.log.data()};
    PerDomain<DomainPrediction> predictions;
    for (std::size_t d = 0; d < captured.size(); ++d) {
      double share = 0;
      workspace.weights.setZero(static_cast<Eigen::Index>(count),
                                static_cast<Eigen::Index>(images));
      for (std::size_t k = 0; k < mixture.ways.size(); ++k) {
        const double part = mixtures[outside ? 1 : 0][static_cast<Eigen::Index>(k)];
        if (indexOf(mixture.ways[k].domain) != d || part == 0) continue;
        share += part;
        workspace.weights += static_cast<float>(part) *
                             mixture.ways[k].weights.middleRows(static_cast<Eigen::Index>(first),
                                                                static_cast<Eigen::Index>(count));
      }
      predictions[d] = {target[d], static_cast<float>(share), largest[d]};
      if (share == 0) continue;
      workspace.weights /= static_cast<float>(share);
      multiply(MatrixView(workspace.weights), packed[d], target[d], values, Cores::kOne);
    }
    mixDomains(predictions[0], predictions[1], count * values, mixture.white, target[0]);
    first += count;
  }
  return {};
}

}  // namespace lightsketch
