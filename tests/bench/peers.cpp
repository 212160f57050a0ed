#include "tests/bench/peers.h"

#include <cblas.h>
#include <fmt/core.h>
#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <memory>
#include <mutex>
#include <numbers>
#include <optional>
#include <random>

#include "capture/frame/srgb.h"
#include "pipeline/illumination/direction_interpolation.h"

namespace lightsketch {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::MatrixXf;
using Eigen::Vector3d;
using Eigen::VectorXd;
using RowMajorF = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using RowMajorHalf = Eigen::Matrix<Eigen::half, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// Pictures `first` to `first` + planes.rows() / 3: a row for each picture and channel.
using UseBatch = std::function<void(int first, const RowMajorF& planes)>;

Result<void> forEachBatch(const LightStack& stack, const UseBatch& use) {
  const Index pixels = Index{stack.width()} * stack.height();
  constexpr int kBatch = 32;
  for (int first = 0; first < stack.size(); first += kBatch) {
    const int count = std::min(kBatch, stack.size() - first);
    RowMajorF planes(3 * Index{count}, pixels);
    std::mutex mutex;  // Guards error.
    std::optional<Error> error;
    tbb::parallel_for(0, count, [&](int i) {
      const auto picture = stack.read(first + i);
      if (!picture) {
        const std::lock_guard lock(mutex);
        error = picture.error();
        return;
      }
      planes.middleRows(3 * Index{i}, 3) =
          Eigen::Map<const Eigen::Matrix<float, 3, Eigen::Dynamic>>(picture->data(), 3, pixels);
    });
    if (error) return tl::unexpected<Error>(*error);
    use(first, planes);
  }
  return {};
}

// c (+)= op(a) op(b), on all cores; row-major, lda and ldb as given.
void multiply(CBLAS_TRANSPOSE ta, CBLAS_TRANSPOSE tb, Index m, Index n, Index k, const float* a,
              Index lda, const float* b, Index ldb, float beta, float* c, Index ldc) {
  cblas_sgemm(CblasRowMajor, ta, tb, static_cast<int>(m), static_cast<int>(n), static_cast<int>(k),
              1, a, static_cast<int>(lda), b, static_cast<int>(ldb), beta, c,
              static_cast<int>(ldc));
}

// Associated Legendre functions without the Condon-Shortley sign, P_l^m(x), 0 <= m <= l < bands.
MatrixXd legendre(int bands, double x) {
  MatrixXd p = MatrixXd::Zero(bands, bands);
  const double root = std::sqrt(std::max(0.0, 1 - x * x));
  p(0, 0) = 1;
  for (int m = 1; m < bands; ++m) p(m, m) = (2 * m - 1) * root * p(m - 1, m - 1);
  for (int m = 0; m + 1 < bands; ++m) p(m + 1, m) = (2 * m + 1) * x * p(m, m);
  for (int m = 0; m < bands; ++m) {
    for (int l = m + 2; l < bands; ++l) {
      p(l, m) = ((2 * l - 1) * x * p(l - 1, m) - (l + m - 1) * p(l - 2, m)) / (l - m);
    }
  }
  return p;
}

// Real harmonics of P_l^|m|(x) and the azimuth, orthonormal over `solidAngle`.
LightBasis harmonics(std::string name, int bands, double solidAngle,
                     std::function<double(double z)> argument) {
  const auto at = [bands, solidAngle, argument](const Vector3d& light) {
    const MatrixXd p = legendre(bands, argument(light.z()));
    const double azimuth = std::atan2(light.y(), light.x());
    VectorXd values(bands * bands);
    for (int l = 0; l < bands; ++l) {
      for (int m = -l; m <= l; ++m) {
        const int order = std::abs(m);
        const double norm = std::sqrt((m == 0 ? 1 : 2) * (2 * l + 1) / solidAngle *
                                      std::tgamma(l - order + 1) / std::tgamma(l + order + 1));
        const double turn = m < 0 ? std::sin(order * azimuth) : std::cos(order * azimuth);
        values[l * l + l + m] = norm * p(l, order) * turn;
      }
    }
    return values;
  };
  return {std::move(name), bands * bands, at};
}

// The picture whose pixel p, channel c is `values` (3 x pixels) at (c, p).
RadianceImage pictureOf(const LightStack& like, const RowMajorF& values) {
  RadianceImage picture(like.width(), like.height(), 3);
  Eigen::Map<Eigen::Matrix<float, 3, Eigen::Dynamic>>(picture.data(), 3, values.cols()) = values;
  return picture;
}

}  // namespace

LightBasis polynomialTexture() {
  return {"PTM", 6, [](const Vector3d& light) -> VectorXd {
            const double u = light.x();
            const double v = light.y();
            return Eigen::Vector<double, 6>(u * u, v * v, u * v, u, v, 1);
          }};
}

LightBasis hemisphericalHarmonics(int bands) {
  return harmonics(fmt::format("HSH {}", bands * bands), bands, 2 * std::numbers::pi,
                   [](double z) { return 2 * z - 1; });
}

LightBasis sphericalHarmonics(int bands) {
  return harmonics(fmt::format("SH {}", bands * bands), bands, 4 * std::numbers::pi,
                   [](double z) { return z; });
}

Result<std::vector<Peer>> fitBases(const LightStack& stack, std::span<const LightBasis> bases) {
  const Index n = stack.size();
  const Index pixels = Index{stack.width()} * stack.height();
  // On a hemisphere harmonics are far from orthogonal; the regularisation keeps their coefficients
  // within what half floats can tell apart. It costs less than 0.01 dB.
  constexpr double kRegularisation = 1e-5;
  // One row for each function of each basis: the weights of the pictures in its coefficient.
  std::vector<Index> firstRow = {0};
  for (const auto& basis : bases) firstRow.push_back(firstRow.back() + basis.size);
  RowMajorF solvers(firstRow.back(), n);
  for (std::size_t b = 0; b < bases.size(); ++b) {
    MatrixXd design(n, bases[b].size);
    for (Index i = 0; i < n; ++i) {
      design.row(i) = bases[b].at(stack.directions()[static_cast<std::size_t>(i)]).transpose();
    }
    MatrixXd normal = design.transpose() * design;
    normal.diagonal().array() += kRegularisation * normal.diagonal().mean();
    solvers.middleRows(firstRow[b], bases[b].size) =
        normal.ldlt().solve(design.transpose()).cast<float>();
  }

  // Coefficients: function by function, channel by channel, pixel by pixel.
  RowMajorF coefficients = RowMajorF::Zero(solvers.rows(), 3 * pixels);
  RETURN_IF_ERROR(forEachBatch(stack, [&](int first, const RowMajorF& planes) {
    multiply(CblasNoTrans, CblasNoTrans, solvers.rows(), 3 * pixels, planes.rows() / 3,
             solvers.data() + first, n, planes.data(), 3 * pixels, 1, coefficients.data(),
             3 * pixels);
  }));

  std::vector<Peer> peers;
  for (std::size_t b = 0; b < bases.size(); ++b) {
    const auto kept = std::make_shared<const RowMajorHalf>(
        coefficients.middleRows(firstRow[b], bases[b].size).cast<Eigen::half>());
    peers.push_back(
        {bases[b].name, static_cast<std::uint64_t>(kept->size()) * sizeof(Eigen::half),
         [kept, stack, basis = bases[b], pixels](const Vector3d& light) -> Result<RadianceImage> {
           const VectorXd weights = basis.at(light);
           RowMajorF values = RowMajorF::Zero(3, pixels);
           Eigen::Map<Eigen::RowVectorXf> sum(values.data(), values.size());
           for (Index k = 0; k < weights.size(); ++k) {
             sum += static_cast<float>(weights[k]) * kept->row(k).cast<float>();
           }
           return pictureOf(stack, values);
         }});
  }
  return peers;
}

Result<Peer> fitGlobalPca(const LightStack& stack, std::uint64_t bytes) {
  const Index pixels = Index{stack.width()} * stack.height();
  const Index columns = 3 * Index{stack.size()};
  const auto bytesPerRank = static_cast<std::uint64_t>(4 * (pixels + columns));
  const Index q = std::min<Index>(static_cast<Index>(bytes / bytesPerRank), columns);
  if (q < 1) {
    return failure(ErrorCode::kInvalidArgument, "global PCA: a basis picture needs {} bytes",
                   bytesPerRank);
  }

  // A is `pixels` x `columns`, its transpose `planes`. Some pixels of all pictures span next to
  // what all of them do: two passes over the pictures instead of three, and no basis of whole
  // pictures to orthonormalise. Subspace iteration within the sample; then the principal axes of A
  // in what it found (Halko, Martinsson, Tropp 2011, sections 4.5 and 5.2).
  const Index k = std::min({q + 40, columns, pixels});
  const Index step = std::max<Index>(1, pixels / std::max<Index>(4096, 4 * k));
  RowMajorF sample(columns, (pixels + step - 1) / step);
  RETURN_IF_ERROR(forEachBatch(stack, [&](int first, const RowMajorF& planes) {
    for (Index i = 0; i < sample.cols(); ++i)
      sample.block(3 * Index{first}, i, planes.rows(), 1) = planes.col(i * step);
  }));
  RowMajorF right(columns, k);
  std::mt19937 random(1);
  std::normal_distribution<float> normal;
  for (float& value : right.reshaped()) value = normal(random);
  const auto orthonormalise = [k](RowMajorF& matrix) {
    const Eigen::HouseholderQR<MatrixXf> qr(matrix);
    matrix = qr.householderQ() * MatrixXf::Identity(matrix.rows(), k);
  };
  RowMajorF some(sample.cols(), k);
  for (int round = 0; round < 4; ++round) {
    orthonormalise(right);
    multiply(CblasTrans, CblasNoTrans, some.rows(), k, columns, sample.data(), sample.cols(),
             right.data(), k, 0, some.data(), k);
    multiply(CblasNoTrans, CblasNoTrans, columns, k, some.rows(), sample.data(), sample.cols(),
             some.data(), k, 0, right.data(), k);
  }
  orthonormalise(right);
  RowMajorF left = RowMajorF::Zero(pixels, k);  // A right
  RETURN_IF_ERROR(forEachBatch(stack, [&](int first, const RowMajorF& planes) {
    multiply(CblasTrans, CblasNoTrans, pixels, k, planes.rows(), planes.data(), pixels,
             right.row(3 * Index{first}).data(), k, 1, left.data(), k);
  }));
  MatrixXf gram(k, k);
  multiply(CblasTrans, CblasNoTrans, k, k, pixels, left.data(), k, left.data(), k, 0, gram.data(),
           k);
  const Eigen::SelfAdjointEigenSolver<MatrixXd> axes(gram.cast<double>());
  const MatrixXf best = axes.eigenvectors().rightCols(q).cast<float>();

  struct Factors {
    RowMajorF U;  // pixels x q
    RowMajorF V;  // 3n x q
  };
  const auto factors = std::make_shared<Factors>();
  factors->U.resize(pixels, q);
  const RowMajorF bestRows = best;
  multiply(CblasNoTrans, CblasNoTrans, pixels, q, k, left.data(), k, bestRows.data(), q, 0,
           factors->U.data(), q);
  factors->V = right * best;

  ASSIGN_OR_RETURN(const auto interpolator, DirectionInterpolator::create(stack.directions(), {}));
  return Peer{
      fmt::format("global PCA {}", q), bytesPerRank * static_cast<std::uint64_t>(q),
      [factors, stack, interpolator, pixels](const Vector3d& light) -> Result<RadianceImage> {
        const auto& lights = stack.directions();
        VectorXd weights;
        const auto known = std::find_if(lights.begin(), lights.end(), [&](const Vector3d& one) {
          return (one - light).norm() < 1e-9;
        });
        if (known != lights.end()) {
          weights = VectorXd::Unit(stack.size(), known - lights.begin());
        } else {
          weights = interpolator.weights(light);
        }
        RowMajorF v = RowMajorF::Zero(3, factors->V.cols());
        for (Index i = 0; i < weights.size(); ++i) {
          v += static_cast<float>(weights[i]) * factors->V.middleRows(3 * i, 3);
        }
        return pictureOf(stack, v * factors->U.transpose());
      }};
}

Result<PictureQuality> measureQuality(const Peer& peer, const LightStack& truth) {
  std::mutex mutex;  // Guards error and both sums.
  std::optional<Error> error;
  double linear = 0;
  double encoded = 0;
  tbb::parallel_for(0, truth.size(), [&](int i) {
    const auto wanted = truth.read(i);
    const auto predicted = peer.predict(truth.directions()[static_cast<std::size_t>(i)]);
    double squares = 0;
    double squares8 = 0;
    if (wanted && predicted) {
      for (std::size_t k = 0; k < wanted->size(); ++k) {
        const float a = wanted->values()[k];
        const float b = predicted->values()[k];
        squares += static_cast<double>(a - b) * static_cast<double>(a - b);
        const int step = srgbEncode8(a) - srgbEncode8(b);
        squares8 += step * step;
      }
    }
    const std::lock_guard lock(mutex);
    if (!wanted) error = wanted.error();
    if (!predicted) error = predicted.error();
    linear += squares;
    encoded += squares8;
  });
  if (error) return tl::unexpected<Error>(*error);
  const double values = 3.0 * truth.width() * truth.height() * truth.size();
  return PictureQuality{-10 * std::log10(linear / values),
                        -10 * std::log10(encoded / values / (255.0 * 255.0))};
}

}  // namespace lightsketch
