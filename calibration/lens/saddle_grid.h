// The corners of a chequered pattern in one grey picture, grown from neighbour to neighbour: no
// global shape is assumed, so a fisheye may bend the rows as it likes. Internal to this folder;
// pixels here are OpenCV's (centre of the top-left pixel at (0, 0)).
#pragma once

#include <Eigen/Core>
#include <array>
#include <map>
#include <opencv2/core.hpp>
#include <optional>
#include <utility>
#include <vector>

namespace lightsketch {

// A point where two dark and two bright sectors meet. Rays are the four edges that leave it, as
// angles atan2(y, x), increasing; rays 0 and 2 pass from dark to bright as the angle grows.
struct Saddle {
  Eigen::Vector2d point = Eigen::Vector2d::Zero();
  std::array<double, 4> rays{};
  double contrast = 0;
};

// Corners by their place (column, row); both may be negative until the board is known. `turn` says
// which ray of a saddle runs along +column: ray (direction - turn) mod 4 runs along direction
// 0 +column, 1 +row, 2 -column, 3 -row.
struct GridCorner {
  Saddle saddle;
  int turn = 0;
};
using GridPlace = std::pair<int, int>;
using SaddleGrid = std::map<GridPlace, GridCorner>;

// The ray of a corner that runs along a direction (0..3 as above).
inline double rayAngle(const GridCorner& corner, int direction) {
  return corner.saddle.rays[static_cast<std::size_t>((direction - corner.turn + 8) % 4)];
}
// True where the square between +column and +row of a corner is bright.
inline bool brightDiagonal(const GridCorner& corner) { return (4 - corner.turn) % 2 == 0; }

// The saddle of a quadric fitted under a Gaussian weight of `sigma` pixels, from within two pixels
// of it; after Lucchese and Mitra 2002. `smooth`: CV_32F, lightly smoothed.
std::optional<Eigen::Vector2d> refineSaddle(const cv::Mat& smooth, const Eigen::Vector2d& start,
                                            double sigma);

// Grey level 0..1, float.
class SaddleFinder {
 public:
  explicit SaddleFinder(const cv::Mat& grey);

  // A saddle at `near`, if the ring of `radius` around it has two dark and two bright sectors;
  // its point is not refined.
  std::optional<Saddle> check(const Eigen::Vector2d& near, double radius) const;
  // Every saddle of the picture, strongest first, at most a few thousand.
  std::vector<Saddle> findAll() const;
  // Grids of at least `minimum` corners, largest first.
  std::vector<SaddleGrid> grow(const std::vector<Saddle>& saddles, std::size_t minimum) const;
  // Adds corners that the neighbours predict, where the picture shows one; only places that
  // `allowed` admits. Stops when nothing more is found.
  template <class Allowed>
  void extend(SaddleGrid& grid, const Allowed& allowed) const {
    for (bool more = true; more;) {
      more = false;
      for (const GridPlace& place : emptyNeighbours(grid)) {
        if (!allowed(place)) continue;
        if (const auto corner = predicted(grid, place)) {
          grid.emplace(place, *corner);
          more = true;
        }
      }
    }
  }
  // Where neighbours within two places, in a line, say a corner should be, and how long a step to
  // it is.
  static std::optional<std::pair<Eigen::Vector2d, double>> predict(const SaddleGrid& grid,
                                                                   const GridPlace& place);
  // Takes out corners that lie more than a quarter of a step from where their neighbours say, the
  // worst first.
  static void prune(SaddleGrid& grid);
  // Looks for the saddle within a third of `step` of `near`; its +column ray must lie within 35
  // degrees of `columnAngle` and the square beyond be as `bright` says.
  std::optional<GridCorner> locate(const Eigen::Vector2d& near, double step, double columnAngle,
                                   double rowAngle, bool bright) const;
  // Smoothed grey at a point; NaN outside.
  double at(const Eigen::Vector2d& point) const;

 private:
  static std::vector<GridPlace> emptyNeighbours(const SaddleGrid& grid);
  std::optional<GridCorner> predicted(const SaddleGrid& grid, const GridPlace& place) const;
  // Does an edge run from one saddle's ray to another's, dark and bright on the right sides?
  bool edgeBetween(const Saddle& from, int fromRay, const Saddle& to, int toRay) const;

  cv::Mat grey_;    // CV_32F
  cv::Mat smooth_;  // CV_32F, sigma 1.2
};

}  // namespace lightsketch
