#include "calibration/lens/board_pattern.h"

#include <array>
#include <utility>

namespace lightsketch {

Result<cv::Ptr<cv::aruco::Dictionary>> markerDictionary(const std::string& name) {
  using namespace cv::aruco;
  static constexpr std::array<std::pair<const char*, PREDEFINED_DICTIONARY_NAME>, 21> kNames{{
      {"DICT_4X4_50", DICT_4X4_50},
      {"DICT_4X4_100", DICT_4X4_100},
      {"DICT_4X4_250", DICT_4X4_250},
      {"DICT_4X4_1000", DICT_4X4_1000},
      {"DICT_5X5_50", DICT_5X5_50},
      {"DICT_5X5_100", DICT_5X5_100},
      {"DICT_5X5_250", DICT_5X5_250},
      {"DICT_5X5_1000", DICT_5X5_1000},
      {"DICT_6X6_50", DICT_6X6_50},
      {"DICT_6X6_100", DICT_6X6_100},
      {"DICT_6X6_250", DICT_6X6_250},
      {"DICT_6X6_1000", DICT_6X6_1000},
      {"DICT_7X7_50", DICT_7X7_50},
      {"DICT_7X7_100", DICT_7X7_100},
      {"DICT_7X7_250", DICT_7X7_250},
      {"DICT_7X7_1000", DICT_7X7_1000},
      {"DICT_ARUCO_ORIGINAL", DICT_ARUCO_ORIGINAL},
      {"DICT_APRILTAG_16h5", DICT_APRILTAG_16h5},
      {"DICT_APRILTAG_25h9", DICT_APRILTAG_25h9},
      {"DICT_APRILTAG_36h10", DICT_APRILTAG_36h10},
      {"DICT_APRILTAG_36h11", DICT_APRILTAG_36h11},
  }};
  for (const auto& [known, value] : kNames) {
    if (name == known) return getPredefinedDictionary(value);
  }
  return failure(ErrorCode::kInvalidArgument,
                 "board: unknown marker dictionary '{}'; OpenCV's names are known, such as "
                 "DICT_4X4_50, DICT_5X5_250, DICT_6X6_1000, DICT_APRILTAG_36h11",
                 name);
}

std::vector<MarkerSquare> markerSquares(const BoardGeometry& board) {
  std::vector<MarkerSquare> squares;
  for (int y = 0; y <= board.rows; ++y) {
    for (int x = (y + 1) % 2; x <= board.columns; x += 2) {
      squares.push_back({static_cast<int>(squares.size()), x, y});
    }
  }
  return squares;
}

Result<void> validateBoard(const BoardGeometry& board) {
  if (board.columns < 3 || board.rows < 3 || board.columns > 100 || board.rows > 100) {
    return failure(ErrorCode::kInvalidArgument,
                   "board: {} x {} inner corners; give 3 to 100 each way (one less than squares)",
                   board.columns, board.rows);
  }
  if (!(board.spacingMetres > 1e-4 && board.spacingMetres < 10)) {
    return failure(ErrorCode::kInvalidArgument,
                   "board: squares of {:g} m; give their side in metres", board.spacingMetres);
  }
  if (board.kind == BoardGeometry::Kind::kChessboard) return {};
  if (!(board.markerFraction > 0.2 && board.markerFraction < 0.95)) {
    return failure(ErrorCode::kInvalidArgument,
                   "board: markers of {:g} squares; give 0.2 to 0.95, or 0.75 as usual",
                   board.markerFraction);
  }
  ASSIGN_OR_RETURN(const auto dictionary, markerDictionary(board.dictionary));
  const std::size_t needed = markerSquares(board).size();
  if (needed > static_cast<std::size_t>(dictionary->bytesList.rows)) {
    return failure(ErrorCode::kInvalidArgument,
                   "board: {} x {} corners need {} markers, {} has {}; choose a larger dictionary",
                   board.columns, board.rows, needed, board.dictionary, dictionary->bytesList.rows);
  }
  return {};
}

}  // namespace lightsketch
