// What LAPACK does for us. Internal to this folder.
#pragma once

#include <Eigen/Core>

namespace lightsketch {

// One core for each BLAS call while this lives: the callers are parallel themselves.
class SingleThreadedBlas {
 public:
  SingleThreadedBlas();
  ~SingleThreadedBlas();
  SingleThreadedBlas(const SingleThreadedBlas&) = delete;
  SingleThreadedBlas& operator=(const SingleThreadedBlas&) = delete;

 private:
  int before_;
};

// The `count` largest eigenvalues of a symmetric matrix (its lower triangle; destroyed), largest
// first, with their vectors as columns. Throws std::runtime_error if they do not converge.
void largestEigen(Eigen::MatrixXd& matrix, int count, Eigen::VectorXd& values,
                  Eigen::MatrixXd& vectors);

// Lower triangle of `gram` += A A^T.
void addGram(const Eigen::MatrixXd& A, Eigen::MatrixXd& gram);

}  // namespace lightsketch
