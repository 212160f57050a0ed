// Boards in pictures: which corners, where. ChArUco boards and plain chessboards, whole or in part,
// as bent as a fisheye shows them.
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "calibration/lens/board.h"
#include "capture/frame/image.h"
#include "capture/frame/progress.h"
#include "capture/frame/result.h"

namespace lightsketch {

struct BoardDetectionOptions {
  int minimumCorners = 12;  // a board with fewer found is none
  Result<void> validate() const;
};

struct BoardDetection {
  BoardView view;      // no corners: nothing found
  std::string reason;  // why nothing was found; empty otherwise
};

// Grey (1 channel) or RGB (3 channels) pictures, any encoding: only the order of brightness counts.
// Corners come row by row, in our pixels (centre of the top-left pixel at (0.5, 0.5)), never
// mirrored. A plain board looks the same turned by 180 degrees (columns + rows even): its first
// corner is then the one that makes the columns run right in the picture. If columns + rows is
// odd, the square outside the first corner is the dark one.
// Part of a plain board counts where it says which part it is: where the board's end is seen.
// Fails only for a board that cannot be. The work is bounded by the number of pixels. Thread-safe.
Result<BoardDetection> detectBoard(const Image<std::uint8_t>& image, const BoardGeometry& board,
                                   const BoardDetectionOptions& options = {});
Result<BoardDetection> detectBoard(const Image<std::uint16_t>& image, const BoardGeometry& board,
                                   const BoardDetectionOptions& options = {});
// Linear radiance, as a sketch's frames hold it.
Result<BoardDetection> detectBoard(const RadianceImage& image, const BoardGeometry& board,
                                   const BoardDetectionOptions& options = {});

struct BoardSearch {
  int width = 0;  // of the pictures
  int height = 0;
  std::vector<BoardDetection> pictures;  // in the order of the files, named by file name
  std::vector<BoardView> views() const;  // of the pictures that show a board
  std::size_t found() const;
};

// Image files of any kind OpenCV or OpenEXR reads, in parallel. A file that cannot be read, or is
// not of the size that most have, has that as its reason. Fails with kNotFound for no files and
// with kCancelled.
Result<BoardSearch> detectBoards(std::span<const std::filesystem::path> files,
                                 const BoardGeometry& board, const BoardDetectionOptions& options,
                                 Progress& progress);
// Image files of a folder, by name with numbers counted ("img2" before "img10"). Fails with
// kNotFound, and what to do, if there is none.
Result<std::vector<std::filesystem::path>> imagesInFolder(const std::filesystem::path& folder);

}  // namespace lightsketch
