// Nearest neighbour among unit vectors, by bins in space. Internal to this folder.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

namespace lightsketch {

// Immutable, thread-safe. Copies the directions.
class NearestDirection {
 public:
  NearestDirection() = default;
  // `binSize`: about the typical distance between neighbours, as a chord.
  NearestDirection(std::span<const Eigen::Vector3d> directions, double binSize);

  // Index of the closest direction (the first of equally close ones); exact. At least one
  // direction.
  int nearest(const Eigen::Vector3d& query) const;
  // Calls visit(index) for every direction within `chord` of the query, and perhaps for some
  // beyond.
  template <class Visit>
  void near(const Eigen::Vector3d& query, double chord, Visit visit) const;

 private:
  int bin(double coordinate) const;
  std::size_t flat(int x, int y, int z) const {
    return (static_cast<std::size_t>(x) * static_cast<std::size_t>(side_) +
            static_cast<std::size_t>(y)) *
               static_cast<std::size_t>(side_) +
           static_cast<std::size_t>(z);
  }

  std::vector<Eigen::Vector3d> directions_;
  double binSize_ = 2;
  int side_ = 0;            // bins per axis of the cube [-1, 1]^3
  std::vector<int> start_;  // side^3 + 1: where each bin begins in index_
  std::vector<int> index_;
};

template <class Visit>
void NearestDirection::near(const Eigen::Vector3d& query, double chord, Visit visit) const {
  int low[3];
  int high[3];
  for (int axis = 0; axis < 3; ++axis) {
    low[axis] = bin(query[axis] - chord);
    high[axis] = bin(query[axis] + chord);
  }
  for (int x = low[0]; x <= high[0]; ++x) {
    for (int y = low[1]; y <= high[1]; ++y) {
      const int end = start_[flat(x, y, high[2]) + 1];
      for (int k = start_[flat(x, y, low[2])]; k < end; ++k)
        visit(index_[static_cast<std::size_t>(k)]);
    }
  }
}

}  // namespace lightsketch
