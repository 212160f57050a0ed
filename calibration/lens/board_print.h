// A calibration board on paper, at true scale.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "calibration/lens/board.h"
#include "capture/frame/image.h"
#include "capture/frame/result.h"

namespace lightsketch {

struct BoardPrintOptions {
  // "A0" to "A5", "letter", "tabloid", "420x297" (millimetres), or "fit": just large enough.
  // Either way up.
  std::string paper = "A4";
  double dpi = 300;  // of a PNG
  Result<void> validate() const;
};

// What is on the sheet, in millimetres from its top left corner, y down.
struct BoardSheet {
  struct Rectangle {
    double x = 0, y = 0, width = 0, height = 0;
  };
  struct Text {
    double x = 0, y = 0;  // left end of the base line
    double size = 0;      // height of the font
    std::string text;     // ASCII
  };
  double width = 0;
  double height = 0;
  std::vector<Rectangle> black;
  std::vector<Text> texts;
  Rectangle board;  // all squares; the first corner is one square right and down of its corner
};

// The board in the middle, below it a bar of 100 mm to measure (50 mm on a small sheet), the board
// in words and the options that `lightsketch calibrate lens` needs for it. Fails with
// kInvalidArgument, and the largest square that fits, where the board and 5 mm of white around
// it (0.3 squares if more, for a plain board: its end is seen by them) do not fit the paper.
Result<BoardSheet> layOutBoard(const BoardGeometry& board, const BoardPrintOptions& options = {});

std::string boardSvg(const BoardSheet& sheet);
std::string boardPdf(const BoardSheet& sheet);  // one page; asks the viewer not to scale it
// Grey; pixel edges that a square's edge crosses are as grey as the part that it covers.
Result<Image<std::uint8_t>> boardPicture(const BoardSheet& sheet, double dpi);

// By the file's ending: .pdf, .svg or .png (with its resolution in it). Atomic.
Result<void> printBoard(const BoardGeometry& board, const BoardPrintOptions& options,
                        const std::filesystem::path& path);

}  // namespace lightsketch
