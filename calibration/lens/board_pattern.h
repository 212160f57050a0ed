// What is printed on a ChArUco board, for printing and for detection. Internal to this folder.
#pragma once

#include <opencv2/aruco.hpp>
#include <vector>

#include "calibration/lens/board.h"
#include "capture/frame/result.h"

namespace lightsketch {

// OpenCV's predefined dictionaries by name ("DICT_5X5_250").
Result<cv::Ptr<cv::aruco::Dictionary>> markerDictionary(const std::string& name);

// Squares are counted from the top left, (columns + 1) x (rows + 1) of them; the first is dark, and
// the bright ones carry markers 0, 1, 2 .. row by row (OpenCV 4.6 and later, calib.io).
struct MarkerSquare {
  int id = 0;
  int x = 0;
  int y = 0;
};
std::vector<MarkerSquare> markerSquares(const BoardGeometry& board);

// Fails with kInvalidArgument for boards that cannot be: fewer than 3 x 3 corners, more markers
// than the dictionary holds.
Result<void> validateBoard(const BoardGeometry& board);

}  // namespace lightsketch
