#include "calibration/lens/board_print.h"

#include <gtest/gtest.h>

#include <regex>

#include "calibration/lens/board_detection.h"
#include "tests/capture/frame/temporary_folder.h"

namespace lightsketch {
namespace {

BoardGeometry boardOf(BoardGeometry::Kind kind, int columns, int rows, double millimetres) {
  BoardGeometry board;
  board.kind = kind;
  board.columns = columns;
  board.rows = rows;
  board.spacingMetres = millimetres / 1000;
  return board;
}

const BoardGeometry kCharuco = boardOf(BoardGeometry::Kind::kCharuco, 8, 5, 30);
const BoardGeometry kChessboard = boardOf(BoardGeometry::Kind::kChessboard, 9, 6, 25);

constexpr double kDpi = 100;

// Every corner must be found, and lie where the sheet's millimetres put it.
void expectCorners(const Image<std::uint8_t>& picture, const BoardSheet& sheet,
                   const BoardGeometry& board) {
  const auto found = detectBoard(picture, board);
  ASSERT_TRUE(found);
  ASSERT_EQ(found->view.corners.size(), static_cast<std::size_t>(board.cornerCount()))
      << found->reason;
  const double square = 1000 * board.spacingMetres;
  for (const BoardCorner& corner : found->view.corners) {
    const Eigen::Vector2d expected = Eigen::Vector2d(sheet.board.x + (corner.column + 1) * square,
                                                     sheet.board.y + (corner.row + 1) * square) *
                                     kDpi / 25.4;
    // Without noise what is left is the sampling of perfectly sharp edges.
    EXPECT_LT((corner.pixel - expected).norm(), 0.1) << corner.column << ", " << corner.row;
  }
}

TEST(BoardPrint, ThePictureHoldsTheBoardAtTrueScale) {
  for (const auto& board : {kCharuco, kChessboard}) {
    const auto sheet = layOutBoard(board);
    ASSERT_TRUE(sheet) << sheet.error().message;
    const auto picture = boardPicture(*sheet, kDpi);
    ASSERT_TRUE(picture);
    EXPECT_EQ(picture->width(), 1169);  // 297 mm at 100 dpi
    EXPECT_EQ(picture->height(), 827);
    expectCorners(*picture, *sheet, board);
  }
}

// The vector drawings are read back by what stands in them, not by the code that wrote them.
Image<std::uint8_t> drawn(const std::string& text, const std::regex& rectangle, double width,
                          double height) {
  BoardSheet sheet;
  sheet.width = width;
  sheet.height = height;
  for (std::sregex_iterator it(text.begin(), text.end(), rectangle), end; it != end; ++it) {
    sheet.black.push_back(
        {std::stod((*it)[1]), std::stod((*it)[2]), std::stod((*it)[3]), std::stod((*it)[4])});
  }
  EXPECT_GT(sheet.black.size(), 20u);
  return *boardPicture(sheet, kDpi);
}

TEST(BoardPrint, SvgAndPdfHoldTheSameBoard) {
  const auto sheet = layOutBoard(kCharuco);
  ASSERT_TRUE(sheet);
  const std::regex path(R"(M([\d.]+) ([\d.]+)h([\d.]+)v([\d.]+))");
  expectCorners(drawn(boardSvg(*sheet), path, sheet->width, sheet->height), *sheet, kCharuco);
  const std::regex re(R"(([\d.]+) ([\d.]+) ([\d.]+) ([\d.]+) re)");
  expectCorners(drawn(boardPdf(*sheet), re, sheet->width, sheet->height), *sheet, kCharuco);
}

TEST(BoardPrint, SvgAndPdfSayTheirSize) {
  const auto sheet = layOutBoard(kCharuco);
  ASSERT_TRUE(sheet);
  const std::string svg = boardSvg(*sheet);
  EXPECT_NE(
      svg.find("width=\"297.0000mm\" height=\"210.0000mm\" viewBox=\"0 0 297.0000 210.0000\""),
      std::string::npos);
  const std::string pdf = boardPdf(*sheet);
  EXPECT_NE(pdf.find("/MediaBox [0 0 841.8898 595.2756]"), std::string::npos);
  // Millimetres to points, y turned over.
  EXPECT_NE(pdf.find("2.83464566929133"), std::string::npos);
  EXPECT_NE(pdf.find("/PrintScaling /None"), std::string::npos);
}

TEST(BoardPrint, PdfsTableOfObjectsIsRight) {
  const std::string pdf = boardPdf(*layOutBoard(kChessboard));
  const auto start = std::stoul(pdf.substr(pdf.find("startxref\n") + 10));
  ASSERT_EQ(pdf.substr(start, 9), "xref\n0 6\n");
  for (std::size_t i = 1; i <= 5; ++i) {
    const auto offset = std::stoul(pdf.substr(start + 9 + 20 * i, 10));
    EXPECT_EQ(pdf.substr(offset, 7), std::to_string(i) + " 0 obj");
  }
  const auto length = std::stoul(pdf.substr(pdf.find("/Length ") + 8));
  const auto stream = pdf.find("stream\n") + 7;
  EXPECT_EQ(pdf.substr(stream + length, 9), "endstream");
}

TEST(BoardPrint, TheSheetCarriesABarToMeasureAndItsOptions) {
  const auto sheet = layOutBoard(kCharuco);
  ASSERT_TRUE(sheet);
  const auto bar = std::ranges::find_if(
      sheet->black, [](const auto& r) { return r.width == 100 && r.height < 1; });
  ASSERT_NE(bar, sheet->black.end());
  for (const auto& r : sheet->black) {
    EXPECT_GE(r.x, 5 - 1e-9);
    EXPECT_LE(r.x + r.width, sheet->width - 5 + 1e-9);
    EXPECT_LE(r.y + r.height, sheet->height);
  }
  ASSERT_EQ(sheet->texts.size(), 2u);
  EXPECT_NE(sheet->texts[0].text.find("this bar is 100 mm"), std::string::npos);
  EXPECT_EQ(sheet->texts[1].text,
            "lightsketch calibrate lens PICTURES --board charuco --corners 8x5 --square 30 "
            "--marker 0.75 --dictionary DICT_5X5_250");
}

TEST(BoardPrint, PngSaysItsResolution) {
  const TemporaryFolder folder;
  ASSERT_TRUE(printBoard(kChessboard, {"A4", 300}, folder / "board.png"));
  const std::string png = contentOf(folder / "board.png");
  const auto chunk = png.find("pHYs");
  ASSERT_NE(chunk, std::string::npos);
  // 300 dpi are 11811 = 0x2e23 pixels per metre; the checksum is the one that every 300 dpi file
  // in the world has there.
  EXPECT_EQ(png.substr(chunk + 4, 13),
            std::string("\0\0\x2e\x23\0\0\x2e\x23\1\x78\xa5\x3f\x76", 13));
  EXPECT_EQ(png.substr(chunk - 4, 4), std::string("\0\0\0\x09", 4));
  const std::vector<std::filesystem::path> files{folder / "board.png"};
  SilentProgress progress;
  const auto found = detectBoards(files, kChessboard, {}, progress);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->width, 3508);
  EXPECT_EQ(found->found(), 1u);
}

TEST(BoardPrint, ABoardThatDoesNotFitIsRefusedWithOneThatDoes) {
  for (const auto kind : {BoardGeometry::Kind::kCharuco, BoardGeometry::Kind::kChessboard}) {
    for (const char* paper : {"A4", "a3", "letter", "150x120"}) {
      const auto refused = layOutBoard(boardOf(kind, 14, 10, 60), {paper, 300});
      ASSERT_FALSE(refused);
      std::smatch match;
      const std::string message = refused.error().message;
      ASSERT_TRUE(std::regex_search(message, match, std::regex("squares of ([\\d.]+) mm do,")))
          << message;
      const double fits = std::stod(match[1]);
      EXPECT_TRUE(layOutBoard(boardOf(kind, 14, 10, fits), {paper, 300})) << message;
      EXPECT_FALSE(layOutBoard(boardOf(kind, 14, 10, fits + 0.2), {paper, 300})) << message;
    }
  }
  EXPECT_TRUE(layOutBoard(boardOf(BoardGeometry::Kind::kCharuco, 14, 10, 60), {"fit", 300}));
}

TEST(BoardPrint, WrongCallsAreRefusedInWords) {
  const TemporaryFolder folder;
  EXPECT_NE(layOutBoard(kCharuco, {"B7", 300}).error().message.find("A0 to A5"), std::string::npos);
  EXPECT_NE(layOutBoard(kCharuco, {"A4", 3}).error().message.find("dpi"), std::string::npos);
  EXPECT_NE(printBoard(kCharuco, {}, folder / "board.gif").error().message.find(".pdf, .svg"),
            std::string::npos);
  EXPECT_FALSE(std::filesystem::exists(folder / "board.gif"));
}

}  // namespace
}  // namespace lightsketch
