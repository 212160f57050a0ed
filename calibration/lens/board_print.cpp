#include "calibration/lens/board_print.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <opencv2/imgproc.hpp>

#include "calibration/lens/board_pattern.h"
#include "capture/frame/file.h"
#include "pipeline/sketch/image_file.h"

namespace lightsketch {
namespace {

constexpr double kInch = 25.4;
constexpr double kStrip = 15;      // millimetres under the board for the bar and the words
constexpr double kTextSize = 2.6;  // font height

struct Paper {
  const char* name;
  double width, height;  // millimetres; ISO 216, ANSI Y14.1
};
constexpr std::array<Paper, 8> kPapers{{{"A0", 841, 1189},
                                        {"A1", 594, 841},
                                        {"A2", 420, 594},
                                        {"A3", 297, 420},
                                        {"A4", 210, 297},
                                        {"A5", 148, 210},
                                        {"letter", 215.9, 279.4},
                                        {"tabloid", 279.4, 431.8}}};

bool sameName(std::string_view a, std::string_view b) {
  return std::ranges::equal(
      a, b, [](unsigned char x, unsigned char y) { return std::tolower(x) == std::tolower(y); });
}

// Width and height; both 0 for "fit".
Result<std::pair<double, double>> paperSize(const std::string& name) {
  if (sameName(name, "fit")) return std::pair(0.0, 0.0);
  for (const Paper& paper : kPapers) {
    if (sameName(name, paper.name)) return std::pair(paper.width, paper.height);
  }
  double width = 0;
  double height = 0;
  int used = 0;
  if (std::sscanf(name.c_str(), "%lfx%lf%n", &width, &height, &used) == 2 &&
      static_cast<std::size_t>(used) == name.size() && width >= 50 && height >= 50 &&
      width <= 5000 && height <= 5000) {
    return std::pair(width, height);
  }
  return failure(ErrorCode::kInvalidArgument,
                 "board: unknown paper '{}'; give A0 to A5, letter, tabloid, fit, or WIDTHxHEIGHT "
                 "in millimetres",
                 name);
}

// White around the squares, in squares: where a plain board ends is told by it.
double quietSquares(const BoardGeometry& board) {
  return board.kind == BoardGeometry::Kind::kChessboard ? 0.3 : 0;
}
constexpr double kLeastMargin = 5;  // millimetres; printers reach no further

std::string describe(const BoardGeometry& board) {
  if (board.kind == BoardGeometry::Kind::kChessboard) {
    return fmt::format("Chessboard, {} x {} inner corners, squares of {:g} mm", board.columns,
                       board.rows, 1000 * board.spacingMetres);
  }
  return fmt::format("ChArUco, {} x {} inner corners, squares of {:g} mm, markers of {:g} mm, {}",
                     board.columns, board.rows, 1000 * board.spacingMetres,
                     1000 * board.spacingMetres * board.markerFraction, board.dictionary);
}

std::string options(const BoardGeometry& board) {
  const std::string common = fmt::format("--corners {}x{} --square {:g}", board.columns, board.rows,
                                         1000 * board.spacingMetres);
  if (board.kind == BoardGeometry::Kind::kChessboard) {
    return "lightsketch calibrate lens PICTURES --board chessboard " + common;
  }
  return fmt::format(
      "lightsketch calibrate lens PICTURES --board charuco {} --marker {:g} "
      "--dictionary {}",
      common, board.markerFraction, board.dictionary);
}

// Runs of black cells of a marker with its border, row by row.
void addMarker(const cv::aruco::Dictionary& dictionary, int id, double x, double y, double side,
               std::vector<BoardSheet::Rectangle>& black) {
  const cv::Mat bits = cv::aruco::Dictionary::getBitsFromByteList(
      dictionary.bytesList.rowRange(id, id + 1), dictionary.markerSize);
  const int cells = dictionary.markerSize + 2;
  const double cell = side / cells;
  const auto isBlack = [&](int row, int column) {
    const bool border = row == 0 || column == 0 || row == cells - 1 || column == cells - 1;
    return border || bits.at<std::uint8_t>(row - 1, column - 1) == 0;
  };
  for (int row = 0; row < cells; ++row) {
    for (int column = 0; column < cells;) {
      int end = column;
      while (end < cells && isBlack(row, end)) ++end;
      if (end > column) {
        black.push_back({x + column * cell, y + row * cell, (end - column) * cell, cell});
      }
      column = end + 1;
    }
  }
}

std::string number(double value) { return fmt::format("{:.4f}", value); }

// CRC of PNG chunks (ISO 3309).
std::uint32_t crc32(std::string_view bytes) {
  std::uint32_t crc = ~0u;
  for (const char c : bytes) {
    crc ^= static_cast<unsigned char>(c);
    for (int bit = 0; bit < 8; ++bit) crc = (crc & 1u) ? (crc >> 1) ^ 0xedb88320u : crc >> 1;
  }
  return ~crc;
}

std::string bigEndian(std::uint32_t value) {
  return {static_cast<char>(value >> 24), static_cast<char>(value >> 16),
          static_cast<char>(value >> 8), static_cast<char>(value)};
}

// Puts a pHYs chunk (pixels per metre) behind the header of a PNG file.
std::string withResolution(const std::string& png, double dpi) {
  constexpr std::size_t kHeaderEnd = 8 + 4 + 4 + 13 + 4;
  const std::string perMetre = bigEndian(static_cast<std::uint32_t>(std::lround(dpi / 0.0254)));
  const std::string chunk = "pHYs" + perMetre + perMetre + '\1';
  return png.substr(0, kHeaderEnd) + bigEndian(9) + chunk + bigEndian(crc32(chunk)) +
         png.substr(kHeaderEnd);
}

}  // namespace

Result<void> BoardPrintOptions::validate() const {
  RETURN_IF_ERROR(paperSize(paper));
  if (!(dpi >= 30 && dpi <= 2400)) {
    return failure(ErrorCode::kInvalidArgument, "board: {:g} dpi; give 30 to 2400", dpi);
  }
  return {};
}

Result<BoardSheet> layOutBoard(const BoardGeometry& board, const BoardPrintOptions& printOptions) {
  RETURN_IF_ERROR(validateBoard(board));
  RETURN_IF_ERROR(printOptions.validate());
  ASSIGN_OR_RETURN(const auto size, paperSize(printOptions.paper));
  auto [paperWidth, paperHeight] = size;
  const double square = 1000 * board.spacingMetres;
  const int across = board.columns + 1;
  const int down = board.rows + 1;
  const double quiet = quietSquares(board);
  const double margin = std::max(kLeastMargin, quiet * square);
  const double wide = across * square + 2 * margin;
  const double high = down * square + 2 * margin + kStrip;
  if (paperWidth == 0) {
    paperWidth = std::max(wide, 70.0);
    paperHeight = high;
  }
  // Either way up: the one that leaves the larger of the narrower margins.
  const auto room = [&](double w, double h) { return std::min(w - wide, h - high); };
  if (room(paperHeight, paperWidth) > room(paperWidth, paperHeight)) {
    std::swap(paperWidth, paperHeight);
  }
  if (room(paperWidth, paperHeight) < -1e-9) {
    const auto fits = [&](double w, double h) {
      const double loose = std::min(w / (across + 2 * quiet), (h - kStrip) / (down + 2 * quiet));
      const double tight =
          std::min((w - 2 * kLeastMargin) / across, (h - 2 * kLeastMargin - kStrip) / down);
      return std::min(loose, tight);
    };
    const double largest =
        std::floor(10 * std::max(fits(paperWidth, paperHeight), fits(paperHeight, paperWidth))) /
        10;
    return failure(ErrorCode::kInvalidArgument,
                   "board: {} x {} squares of {:g} mm do not fit {} ({:g} x {:g} mm); squares of "
                   "{:g} mm do, or take larger paper",
                   across, down, square, printOptions.paper, paperWidth, paperHeight,
                   std::max(0.0, largest));
  }

  BoardSheet sheet;
  sheet.width = paperWidth;
  sheet.height = paperHeight;
  const double left = (paperWidth - across * square) / 2;
  const double top = (paperHeight - kStrip - down * square) / 2;
  sheet.board = {left, top, across * square, down * square};
  for (int y = 0; y < down; ++y) {
    for (int x = y % 2; x < across; x += 2) {
      sheet.black.push_back({left + x * square, top + y * square, square, square});
    }
  }
  if (board.kind == BoardGeometry::Kind::kCharuco) {
    ASSIGN_OR_RETURN(const auto dictionary, markerDictionary(board.dictionary));
    const double side = board.markerFraction * square;
    const double inset = (square - side) / 2;
    for (const MarkerSquare& marker : markerSquares(board)) {
      addMarker(*dictionary, marker.id, left + marker.x * square + inset,
                top + marker.y * square + inset, side, sheet.black);
    }
  }

  // The bar with a tick each 10 mm, and the words.
  const double bar = paperWidth >= 120 ? 100 : 50;
  const double barLeft = std::max(5.0, std::min(left, paperWidth - bar - 5));
  const double barTop = paperHeight - kStrip + 3;
  sheet.black.push_back({barLeft, barTop, bar, 0.4});
  for (int i = 0; i * 10 <= static_cast<int>(bar); ++i) {
    // Ticks lie inside the bar's ends, so that its length can be measured from edge to edge.
    const double x = barLeft + 10.0 * i -
                     (i == 0                            ? 0.0
                      : i * 10 == static_cast<int>(bar) ? 0.2
                                                        : 0.1);
    sheet.black.push_back({x, barTop - 1.2, 0.2, 1.2});
  }
  const double textWidth = paperWidth - barLeft - 5;
  const auto add = [&](double y, const std::string& text) {
    // Helvetica is about half as wide as it is high; long lines shrink to the sheet.
    const double wanted = 0.55 * kTextSize * static_cast<double>(text.size());
    sheet.texts.push_back(
        {barLeft, y, kTextSize * std::min(1.0, textWidth / std::max(1e-9, wanted)), text});
  };
  add(barTop + 3.6, fmt::format("Print at 100 %; this bar is {:g} mm. {}", bar, describe(board)));
  add(barTop + 7.2, options(board));
  return sheet;
}

std::string boardSvg(const BoardSheet& sheet) {
  std::string svg = fmt::format(
      "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<svg xmlns=\"http://www.w3.org/2000/svg\" "
      "width=\"{0:.4f}mm\" height=\"{1:.4f}mm\" viewBox=\"0 0 {0:.4f} {1:.4f}\">\n<rect "
      "width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n<path fill=\"#000000\" d=\"",
      sheet.width, sheet.height);
  for (const auto& r : sheet.black) {
    svg += fmt::format("M{} {}h{}v{}h-{}z\n", number(r.x), number(r.y), number(r.width),
                       number(r.height), number(r.width));
  }
  svg += "\"/>\n";
  for (const auto& t : sheet.texts) {
    svg += fmt::format(
        "<text x=\"{}\" y=\"{}\" font-family=\"Helvetica, Arial, sans-serif\" font-size=\"{}\">{}"
        "</text>\n",
        number(t.x), number(t.y), number(t.size), t.text);
  }
  return svg + "</svg>\n";
}

std::string boardPdf(const BoardSheet& sheet) {
  // Millimetres, y down; a text has to be turned over again. (ISO 32000-1, 8.3 and 9.4.)
  std::string content =
      fmt::format("{0} 0 0 -{0} 0 {1} cm\n0 g\n", 72 / kInch, sheet.height * 72 / kInch);
  for (const auto& r : sheet.black) {
    content += fmt::format("{} {} {} {} re\n", number(r.x), number(r.y), number(r.width),
                           number(r.height));
  }
  content += "f\n";
  for (const auto& t : sheet.texts) {
    std::string text;
    for (const char c : t.text) {
      if (c == '(' || c == ')' || c == '\\') text += '\\';
      text += c;
    }
    content += fmt::format("BT /F1 {} Tf 1 0 0 -1 {} {} Tm ({}) Tj ET\n", number(t.size),
                           number(t.x), number(t.y), text);
  }
  const std::array<std::string, 5> objects{
      "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
      "<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
      fmt::format("<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {:.4f} {:.4f}] /Contents 4 0 R "
                  "/Resources << /Font << /F1 5 0 R >> >> >>",
                  sheet.width * 72 / kInch, sheet.height * 72 / kInch),
      fmt::format("<< /Length {} >>\nstream\n{}endstream", content.size(), content),
      "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>"};
  std::string pdf = "%PDF-1.7\n";
  std::string table = fmt::format("xref\n0 {}\n0000000000 65535 f \n", objects.size() + 1);
  for (std::size_t i = 0; i < objects.size(); ++i) {
    table += fmt::format("{:010d} 00000 n \n", pdf.size());
    pdf += fmt::format("{} 0 obj\n{}\nendobj\n", i + 1, objects[i]);
  }
  const std::size_t start = pdf.size();
  return pdf + table +
         fmt::format("trailer\n<< /Size {} /Root 1 0 R >>\nstartxref\n{}\n%%EOF\n",
                     objects.size() + 1, start);
}

Result<Image<std::uint8_t>> boardPicture(const BoardSheet& sheet, double dpi) {
  const double scale = dpi / kInch;
  const double columns = std::round(sheet.width * scale);
  const double rows = std::round(sheet.height * scale);
  if (!(columns >= 1 && rows >= 1 && columns * rows <= 4e8)) {
    return failure(ErrorCode::kInvalidArgument,
                   "board: a picture of {:g} x {:g} pixels; take fewer dots per inch, or PDF",
                   columns, rows);
  }
  const int width = static_cast<int>(columns);
  const int height = static_cast<int>(rows);
  Image<float> ink(width, height, 1);
  // How much of pixel i the range covers.
  const auto part = [](int i, double from, double to) {
    return static_cast<float>(std::max(0.0, std::min(to, i + 1.0) - std::max<double>(from, i)));
  };
  for (const auto& r : sheet.black) {
    const double x0 = r.x * scale;
    const double x1 = (r.x + r.width) * scale;
    const double y0 = r.y * scale;
    const double y1 = (r.y + r.height) * scale;
    for (int y = std::max(0, static_cast<int>(y0)); y < std::min<double>(height, y1); ++y) {
      const float rowPart = part(y, y0, y1);
      for (int x = std::max(0, static_cast<int>(x0)); x < std::min<double>(width, x1); ++x) {
        ink(x, y) += rowPart * part(x, x0, x1);
      }
    }
  }
  Image<std::uint8_t> picture(width, height, 1);
  for (std::size_t i = 0; i < ink.size(); ++i) {
    const float grey = 255 * (1 - std::min(1.0f, ink.values()[i]));
    picture.values()[i] = static_cast<std::uint8_t>(std::lround(grey));
  }
  cv::Mat header(height, width, CV_8U, picture.data());
  for (const auto& t : sheet.texts) {
    // Hershey's plain letters are 9 units high at scale 1 and narrower than Helvetica's.
    const double fontScale = 0.72 * t.size * scale / 9;
    cv::putText(header, t.text, {static_cast<int>(t.x * scale), static_cast<int>(t.y * scale)},
                cv::FONT_HERSHEY_PLAIN, fontScale, cv::Scalar(0),
                std::max(1, static_cast<int>(std::lround(0.06 * t.size * scale))), cv::LINE_AA);
  }
  return picture;
}

Result<void> printBoard(const BoardGeometry& board, const BoardPrintOptions& printOptions,
                        const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const BoardSheet sheet, layOutBoard(board, printOptions));
  const std::string ending = path.extension().string();
  if (sameName(ending, ".pdf")) return writeFileAtomically(path, boardPdf(sheet));
  if (sameName(ending, ".svg")) return writeFileAtomically(path, boardSvg(sheet));
  if (sameName(ending, ".png")) {
    ASSIGN_OR_RETURN(const auto picture, boardPicture(sheet, printOptions.dpi));
    ASSIGN_OR_RETURN(const std::string png, encodePng(picture));
    return writeFileAtomically(path, withResolution(png, printOptions.dpi));
  }
  return failure(ErrorCode::kInvalidArgument,
                 "{}: a board is printed to .pdf, .svg or .png; name the file so", path.string());
}

}  // namespace lightsketch
