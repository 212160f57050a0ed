// Calibration boards and what was seen of them: the values that detection makes and solving takes.
#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

namespace lightsketch {

// A flat board with a grid of inner corners. Board frame: origin in the first corner, x along
// columns, y along rows, z = x cross y into the board, away from whoever looks at its front.
struct BoardGeometry {
  enum class Kind { kChessboard, kCharuco };
  Kind kind = Kind::kCharuco;
  int columns = 10;  // inner corners; a board has one more square each way
  int rows = 7;
  double spacingMetres = 0.03;  // side of a square
  // ChArUco only.
  double markerFraction = 0.75;             // marker's side over the square's
  std::string dictionary = "DICT_5X5_250";  // OpenCV's name

  int cornerCount() const { return columns * rows; }
  // The board may be bent: z = warp.x (1 - u^2) + warp.y (1 - v^2), u and v from -1 to 1 over the
  // corners (mrcal's calobject warp).
  Eigen::Vector3d corner(int column, int row,
                         const Eigen::Vector2d& warpMetres = Eigen::Vector2d::Zero()) const;
};

struct BoardCorner {
  int column = 0;
  int row = 0;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
};

// One picture of the board; not every corner need be there.
struct BoardView {
  std::string name;  // file name or frame number, for reports
  std::vector<BoardCorner> corners;
};

}  // namespace lightsketch
