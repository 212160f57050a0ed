#include "pipeline/compress/rate_distortion.h"

#include <oneapi/tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "pipeline/compress/kernels.h"
#include "pipeline/compress/lapack.h"

namespace lightsketch {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::MatrixXf;
using Eigen::VectorXd;
namespace tbb = oneapi::tbb;

// Numbers are rounded to a multiple of a step, and towards zero where that is near: entropy coders
// like zeros more than they cost (Sullivan 1996, "Efficient scalar quantization").
constexpr float kDeadZone = 0.2f;
constexpr float kDeadZoneV = 0.1f;
// V is rounded finer: its errors are the same over whole pictures, which 8-bit sRGB shows in the
// dark. Measured on RealRTI.
constexpr double kNoiseV = 0.5;

// A uniform quantiser's error is step^2 / 12.
float stepOf(double noise, double energy) {
  return static_cast<float>(std::sqrt(12 * noise / std::max(energy, 1e-30)));
}

int rounded(float value, float deadZone) {
  const float size = std::floor(std::fabs(value) + 0.5f - deadZone);
  return static_cast<int>(std::copysign(std::clamp(size, 0.0f, 32767.0f), value));
}

// In place: each light's three columns between RGB and opponent colours.
void turnColours(RowMajorMatrixf& V, const Eigen::Matrix3f& turn) {
  tbb::parallel_for(Index{0}, V.rows(), [&](Index k) {
    Eigen::Map<Eigen::Matrix3Xf> triples(V.row(k).data(), 3, V.cols() / 3);
    triples = (turn * triples).eval();
  });
}

// One block's basis pictures, rounded.
struct RoundedBlock {
  std::vector<float> step;   // b'
  Eigen::MatrixXi integers;  // b' x p
  MatrixXf refit;            // b' x b: coefficients in the rounded basis of what E held
};

RoundedBlock roundBlock(const Eigen::Ref<const RowMajorMatrixf>& E, const double* rowEnergy,
                        double noise) {
  const Index p = E.cols();
  const double least = rowThreshold(noise, static_cast<int>(p));
  RoundedBlock block;
  block.integers.resize(E.rows(), p);
  Index kept = 0;
  for (Index r = 0; r < E.rows() && rowEnergy[r] > least; ++r) {
    // A few steps per octave: scales that repeat cost the file next to nothing.
    constexpr float kPerOctave = 4;
    const float exact = std::min(stepOf(noise, rowEnergy[r]), 0.5f);
    const float step = std::exp2(std::round(kPerOctave * std::log2(exact)) / kPerOctave);
    for (Index k = 0; k < p; ++k) block.integers(kept, k) = rounded(E(r, k) / step, kDeadZone);
    if (block.integers.row(kept).isZero()) continue;
    block.step.push_back(step);
    ++kept;
  }
  block.integers.conservativeResize(kept, Eigen::NoChange);
  if (kept == 0) return block;
  const MatrixXf basis = Eigen::Map<const Eigen::VectorXf>(block.step.data(), kept).asDiagonal() *
                         block.integers.cast<float>();
  MatrixXf gram = basis * basis.transpose();
  gram.diagonal().array() += 1e-6f * gram.diagonal().maxCoeff();
  block.refit = gram.ldlt().solve(basis * E.transpose());
  return block;
}

// A code of zeros, with the one row that makes it a model like any other.
std::shared_ptr<const PackedCode> black(std::shared_ptr<PackedCode> code) {
  std::fill(code->blockOffset.begin() + 1, code->blockOffset.end(), 1);
  code->rank = 1;
  code->E.assign(static_cast<std::size_t>(code->layout.pixelsPerBlock()), 0);
  code->U.assign(1, 0);
  code->V.assign(3 * static_cast<std::size_t>(code->lights), 0);
  code->stepE = code->stepU = code->stepV = {1.0f};
  return code;
}

}  // namespace

double rowThreshold(double noise, int pixelsPerBlock) { return 3 * noise * pixelsPerBlock; }
double rankThreshold(double noise) { return 480 * noise; }

int estimateRank(const LargeMatrix& L, double threshold) {
  constexpr Index kMost = 768;
  const auto side = static_cast<int>(std::min(L.rows(), L.cols()));
  if (side <= kMost) return side;
  const Index count = std::min(kMost, L.cols());
  MatrixXd gram = MatrixXd::Zero(count, count);
  constexpr Index kChunk = 2048;
  for (Index at = 0; at < L.rows(); at += kChunk) {
    const auto rows = L.matrix().middleRows(at, std::min(kChunk, L.rows() - at));
    MatrixXd part(count, rows.rows());
    for (Index i = 0; i < count; ++i)
      part.row(i) = rows.col(i * L.cols() / count).cast<double>().transpose();
    addGram(part, gram);
  }
  VectorXd values;
  MatrixXd vectors;
  largestEigen(gram, static_cast<int>(count), values, vectors);
  const double scale = static_cast<double>(L.cols()) / static_cast<double>(count);
  const auto above = (values.array() * scale > threshold).count();
  // Where most of the sample is above, there are more than it can tell.
  return above > count * 2 / 3 ? std::min(side, static_cast<int>(2 * count))
                               : static_cast<int>(above);
}

RateDistortion::RateDistortion(const BlockLayout& layout, std::vector<std::int64_t> blockOffset,
                               const RowMajorMatrixf& E, const std::vector<double>& rowEnergy,
                               RowMajorMatrixf U, RowMajorMatrixf V)
    : layout_(layout),
      blockOffset_(std::move(blockOffset)),
      coefficients_(product(MatrixView(E), MatrixView(dctMatrix(layout.blockSize)).transposed(),
                            Cores::kAll)),
      rowEnergy_(rowEnergy),
      U_(std::move(U)),
      V_(std::move(V)) {
  for (Index k = 0; k < V_.rows(); ++k) {
    const float norm = V_.row(k).norm();
    if (norm > 0) V_.row(k) /= norm;
    U_.col(k) *= norm;
  }
  turnColours(V_, opponentColours());
}

std::shared_ptr<const PackedCode> RateDistortion::encode(double noise) const {
  auto code = std::make_shared<PackedCode>();
  const auto p = static_cast<std::size_t>(layout_.pixelsPerBlock());
  const auto n = static_cast<std::size_t>(V_.cols() / 3);
  const auto m = static_cast<std::size_t>(layout_.blocks());
  code->layout = layout_;
  code->lights = static_cast<int>(n);

  // E, and L (in the coordinates of V) in what became of it.
  std::vector<RoundedBlock> blocks(m);
  tbb::parallel_for(std::size_t{0}, m, [&](std::size_t j) {
    const auto from = blockOffset_[j];
    blocks[j] = roundBlock(coefficients_.middleRows(from, blockOffset_[j + 1] - from),
                           rowEnergy_.data() + from, noise);
  });
  code->blockOffset.assign(1, 0);
  for (const auto& block : blocks)
    code->blockOffset.push_back(code->blockOffset.back() + block.integers.rows());
  const Index rows = code->blockOffset.back();
  if (rows == 0) return black(std::move(code));
  // Columns of U_ that cannot be worth anything stay out; rounding turns the others only a little.
  Index reach = 1;
  while (reach < U_.cols() && U_.col(reach).squaredNorm() > 0.7 * rankThreshold(noise)) ++reach;
  RowMajorMatrixf L(rows, reach);
  tbb::parallel_for(std::size_t{0}, m, [&](std::size_t j) {
    const auto from = blockOffset_[j];
    if (blocks[j].integers.rows() == 0) return;
    L.middleRows(code->blockOffset[j], blocks[j].integers.rows()).noalias() =
        blocks[j].refit * U_.block(from, 0, blockOffset_[j + 1] - from, reach);
  });
  const auto order = packedRowOrder(code->blockOffset);
  std::vector<std::size_t> place(order.size());  // in the code
  for (std::size_t i = 0; i < order.size(); ++i) place[order[i]] = i;
  code->E.resize(order.size() * p);
  code->stepE.resize(order.size());
  tbb::parallel_for(std::size_t{0}, m, [&](std::size_t j) {
    for (Index r = 0; r < blocks[j].integers.rows(); ++r) {
      const std::size_t i = place[static_cast<std::size_t>(code->blockOffset[j] + r)];
      code->stepE[i] = blocks[j].step[static_cast<std::size_t>(r)];
      for (std::size_t k = 0; k < p; ++k) {
        code->E[k * order.size() + i] = foldSign(blocks[j].integers(r, static_cast<Index>(k)));
      }
    }
  });

  // The singular values of that L.
  MatrixXd gram = product(MatrixView(L).transposed(), MatrixView(L), Cores::kAll).cast<double>();
  VectorXd values;
  MatrixXd vectors;
  largestEigen(gram, static_cast<int>(gram.rows()), values, vectors);
  const auto q = std::max<Index>(1, (values.array() > rankThreshold(noise)).count());
  const RowMajorMatrixf turn = vectors.leftCols(q).cast<float>();
  const RowMajorMatrixf U = product(MatrixView(L), MatrixView(turn), Cores::kAll);
  RowMajorMatrixf V =
      product(MatrixView(turn).transposed(),
              MatrixView(V_).middleRows(0, static_cast<std::size_t>(reach)), Cores::kAll);

  // U: rows of E and V are of unit length, so that all its numbers are worth the same.
  code->rank = static_cast<int>(q);
  code->U.resize(static_cast<std::size_t>(q) * order.size());
  code->stepU.resize(static_cast<std::size_t>(q));
  RowMajorMatrixf rounds(rows, q);
  tbb::parallel_for(Index{0}, q, [&](Index k) {
    const float step = std::max(stepOf(noise, 1), U.col(k).cwiseAbs().maxCoeff() / 32767);
    code->stepU[static_cast<std::size_t>(k)] = step;
    for (Index r = 0; r < rows; ++r) {
      const int value = rounded(U(r, k) / step, kDeadZone);
      rounds(r, k) = static_cast<float>(value) * step;
      code->U[static_cast<std::size_t>(k) * order.size() + place[static_cast<std::size_t>(r)]] =
          foldSign(value);
    }
  });
  MatrixXd gramU =
      product(MatrixView(rounds).transposed(), MatrixView(rounds), Cores::kAll).cast<double>();
  const VectorXd energyU = gramU.diagonal();
  gramU.diagonal().array() += 1e-6 * energyU.maxCoeff() / static_cast<double>(q) + 1e-3 * noise;
  const RowMajorMatrixf cross =
      product(MatrixView(rounds).transposed(), MatrixView(U), Cores::kAll);
  const RowMajorMatrixf refit = gramU.ldlt().solve(cross.cast<double>()).cast<float>();
  V = product(MatrixView(refit), MatrixView(V), Cores::kAll);

  code->V.resize(3 * static_cast<std::size_t>(q) * n);
  code->stepV.resize(static_cast<std::size_t>(q));
  tbb::parallel_for(Index{0}, q, [&](Index k) {
    const auto at = static_cast<std::size_t>(k);
    const float step = std::max(stepOf(kNoiseV * noise, std::max(energyU[k], 12 * noise)),
                                V.row(k).cwiseAbs().maxCoeff() / 32767);
    code->stepV[at] = step;
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t c = 0; c < 3; ++c) {
        code->V[(3 * at + c) * n + i] =
            foldSign(rounded(V(k, static_cast<Index>(3 * i + c)) / step, kDeadZoneV));
      }
    }
  });
  return code;
}

Result<double> noiseFor(const NoiseTarget& target, double start, double finest, double coarsest,
                        const std::function<Result<double>(double)>& quantity) {
  // Octaves. Files of some 10 kB jump by several percent within a 32nd.
  constexpr double kClose = 1.0 / 256;
  const double aim = 0.5 * (target.least + target.most);
  struct Trial {
    double octave;
    double surplus;  // over `aim`
  };
  std::optional<Trial> tooMuch;
  std::optional<Trial> tooLittle;
  // From `finest`, which so is tried, and returned, to the last bit.
  const double last = std::log2(coarsest / finest);
  double octave = std::clamp(std::log2(start / finest), 0.0, last);
  for (int trials = 0;; ++trials) {
    ASSIGN_OR_RETURN(const double value, quantity(finest * std::exp2(octave)));
    const bool less = value < target.least;
    if (!less && value <= target.most) break;
    if (less ? octave <= 0 : octave >= last) break;
    (less ? tooLittle : tooMuch) = Trial{octave, value - aim};
    if (!tooMuch || !tooLittle) {
      // Every second step in one direction goes twice as far as it should.
      octave += (trials % 2 + 1) * (value - aim) / target.perOctave;
      octave = std::clamp(octave, 0.0, last);
      continue;
    }
    const double width = tooLittle->octave - tooMuch->octave;
    if (width <= kClose) {
      octave = (target.overshoot ? tooMuch : tooLittle)->octave;
      break;
    }
    // False position; every third step halves, as one end may stay where it is.
    const double part =
        trials % 3 == 2
            ? 0.5
            : std::clamp(tooMuch->surplus / (tooMuch->surplus - tooLittle->surplus), 0.05, 0.95);
    octave = tooMuch->octave + part * width;
  }
  return finest * std::exp2(octave);
}

}  // namespace lightsketch
