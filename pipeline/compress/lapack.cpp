#include "pipeline/compress/lapack.h"

#include <cblas.h>
#include <lapack.h>

#include <stdexcept>
#include <vector>

namespace lightsketch {

SingleThreadedBlas::SingleThreadedBlas() : before_(openblas_get_num_threads()) {
  openblas_set_num_threads(1);
}
SingleThreadedBlas::~SingleThreadedBlas() { openblas_set_num_threads(before_); }

void largestEigen(Eigen::MatrixXd& matrix, int count, Eigen::VectorXd& values,
                  Eigen::MatrixXd& vectors) {
  auto n = static_cast<lapack_int>(matrix.rows());
  lapack_int first = n - count + 1;
  char job = 'V';
  char range = 'I';
  char lower = 'L';
  double zero = 0;
  double workSize = 0;
  lapack_int intSize = 0;
  lapack_int found = 0;
  lapack_int info = 0;
  lapack_int query = -1;
  values.resize(n);
  vectors.resize(n, count);
  std::vector<lapack_int> support(static_cast<std::size_t>(2 * n));
  LAPACK_dsyevr(&job, &range, &lower, &n, matrix.data(), &n, &zero, &zero, &first, &n, &zero,
                &found, values.data(), vectors.data(), &n, support.data(), &workSize, &query,
                &intSize, &query, &info);
  auto size = static_cast<lapack_int>(workSize);
  std::vector<double> work(static_cast<std::size_t>(size));
  std::vector<lapack_int> ints(static_cast<std::size_t>(intSize));
  LAPACK_dsyevr(&job, &range, &lower, &n, matrix.data(), &n, &zero, &zero, &first, &n, &zero,
                &found, values.data(), vectors.data(), &n, support.data(), work.data(), &size,
                ints.data(), &intSize, &info);
  if (info != 0 || found != count) throw std::runtime_error("eigenvalues did not converge");
  values = values.head(count).reverse().eval();
  vectors = vectors.rowwise().reverse().eval();
}

void addGram(const Eigen::MatrixXd& A, Eigen::MatrixXd& gram) {
  const auto n = static_cast<int>(A.rows());
  cblas_dsyrk(CblasColMajor, CblasLower, CblasNoTrans, n, static_cast<int>(A.cols()), 1, A.data(),
              n, 1, gram.data(), n);
}

}  // namespace lightsketch
