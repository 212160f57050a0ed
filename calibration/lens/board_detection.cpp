#include "calibration/lens/board_detection.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "calibration/lens/board_pattern.h"
#include "calibration/lens/saddle_grid.h"
#include "capture/frame/file.h"
#include "pipeline/sketch/image_file.h"

namespace lightsketch {
namespace {

using Eigen::Vector2d;

// Any picture as grey, 0..1: the 0.5 and 99.5 percentiles become 0 and 1, so that one set of
// thresholds does for every exposure.
cv::Mat stretched(const cv::Mat& picture) {
  cv::Mat grey;
  picture.convertTo(grey, CV_32F);
  if (grey.channels() == 3) cv::cvtColor(grey, grey, cv::COLOR_RGB2GRAY);
  cv::patchNaNs(grey, 0);
  std::vector<float> sample;
  const int stride =
      std::max(1, static_cast<int>(std::sqrt(static_cast<double>(grey.total()) / 40000)));
  for (int y = 0; y < grey.rows; y += stride) {
    for (int x = 0; x < grey.cols; x += stride) sample.push_back(grey.at<float>(y, x));
  }
  if (sample.empty()) return grey;
  const auto quantile = [&](double fraction) {
    const auto at = sample.begin() +
                    static_cast<std::ptrdiff_t>(fraction * static_cast<double>(sample.size() - 1));
    std::nth_element(sample.begin(), at, sample.end());
    return *at;
  };
  const float low = quantile(0.005);
  const float high = quantile(0.995);
  if (!(high > low)) return cv::Mat(grey.rows, grey.cols, CV_32F, cv::Scalar(0));
  grey = (grey - low) / (high - low);
  cv::min(grey, 1.0, grey);
  cv::max(grey, 0.0, grey);
  return grey;
}

// Final places, in our pixels. `scale`: pixels of the picture per pixel of the grid; `reach`: how
// far from a corner its squares are plain, in squares. Corners whose refinement runs away are
// dropped.
std::vector<BoardCorner> refined(const cv::Mat& grey, const SaddleGrid& grid, double scale,
                                 double reach) {
  // What was found on a coarser level is blurred.
  cv::Mat smooth;
  cv::GaussianBlur(grey, smooth, {0, 0}, 0.8 * scale);
  std::vector<BoardCorner> corners;
  for (const auto& [place, corner] : grid) {
    double nearest = 1e9;
    for (const auto& [dx, dy] : {std::pair(1, 0), {0, 1}, {-1, 0}, {0, -1}}) {
      const auto next = grid.find({place.first + dx, place.second + dy});
      if (next == grid.end()) continue;
      nearest = std::min(nearest, (next->second.saddle.point - corner.saddle.point).norm() * scale);
    }
    if (nearest == 1e9) continue;  // a lone corner cannot be checked by its neighbours
    const Vector2d start = corner.saddle.point * scale;
    // Measured: wider gains little against noise, and markers bend the fit (README).
    const double sigma = std::clamp(0.4 * reach * nearest, 1.0, 2 * scale);
    const auto saddle = refineSaddle(smooth, start, sigma);
    if (!saddle) continue;
    const Vector2d& found = *saddle;
    if (!((found - start).norm() < std::max(1.5 * scale, 0.15 * nearest))) continue;
    corners.push_back({place.first, place.second, found + Vector2d(0.5, 0.5)});
  }
  std::sort(corners.begin(), corners.end(), [](const BoardCorner& a, const BoardCorner& b) {
    return std::pair(a.row, a.column) < std::pair(b.row, b.column);
  });
  return corners;
}

// --- Plain chessboards ---------------------------------------------------------------------------

struct Bounds {
  int minX = 0, maxX = 0, minY = 0, maxY = 0;
  int width() const { return maxX - minX + 1; }
  int height() const { return maxY - minY + 1; }
};

Bounds boundsOf(const SaddleGrid& grid) {
  const auto& first = grid.begin()->first;
  Bounds b{first.first, first.first, first.second, first.second};
  for (const auto& [place, corner] : grid) {
    b.minX = std::min(b.minX, place.first);
    b.maxX = std::max(b.maxX, place.first);
    b.minY = std::min(b.minY, place.second);
    b.maxY = std::max(b.maxY, place.second);
  }
  return b;
}

// Does the board end one square beyond this side of the grid? Seen where the outermost squares
// alternate and beyond them all is bright paper.
bool endsBeyond(const SaddleFinder& finder, const SaddleGrid& grid, const Bounds& b,
                int direction) {
  const bool alongColumns = direction % 2 == 0;
  const int edge = direction == 0   ? b.maxX
                   : direction == 1 ? b.maxY
                   : direction == 2 ? b.minX
                                    : b.minY;
  const int inwards = direction < 2 ? -1 : 1;
  const auto point = [&](int along, int depth) -> std::optional<Vector2d> {
    const int across = edge + depth * inwards;
    const auto found =
        grid.find(alongColumns ? GridPlace{across, along} : GridPlace{along, across});
    if (found == grid.end()) return std::nullopt;
    return found->second.saddle.point;
  };
  std::vector<double> margin;
  double sum[2] = {0, 0};
  int count[2] = {0, 0};
  int cells = 0;
  const int first = alongColumns ? b.minY : b.minX;
  const int last = alongColumns ? b.maxY : b.maxX;
  for (int i = first; i < last; ++i) {
    // Middles between two corners of the outermost row, and of the rows within.
    std::array<std::optional<Vector2d>, 3> middle;
    for (int depth = 0; depth < 3; ++depth) {
      const auto a = point(i, depth);
      const auto c = point(i + 1, depth);
      if (a && c) middle[static_cast<std::size_t>(depth)] = 0.5 * (*a + *c);
    }
    if (!middle[0] || !middle[1]) continue;
    ++cells;
    const Vector2d step = middle[2] ? Vector2d(2 * *middle[0] - 3 * *middle[1] + *middle[2])
                                    : Vector2d(*middle[0] - *middle[1]);
    const double square = finder.at(*middle[0] + 0.5 * step);
    const double beyond = finder.at(*middle[0] + 1.25 * step);
    if (std::isnan(square) || std::isnan(beyond)) continue;
    margin.push_back(beyond);
    sum[i & 1] += square;
    ++count[i & 1];
  }
  if (cells < 2 || !count[0] || !count[1] ||
      margin.size() * 10 < static_cast<std::size_t>(cells) * 6) {
    return false;
  }
  const double a = sum[0] / count[0];
  const double c = sum[1] / count[1];
  if (std::abs(a - c) < 0.1) return false;
  const auto bright = std::count_if(margin.begin(), margin.end(),
                                    [&](double value) { return value > 0.5 * (a + c); });
  return static_cast<double>(bright) > 0.85 * static_cast<double>(margin.size());
}

SaddleGrid turned(const SaddleGrid& grid, int quarters) {
  SaddleGrid result;
  for (const auto& [place, corner] : grid) {
    auto [x, y] = place;
    for (int i = 0; i < quarters; ++i) std::tie(x, y) = std::pair(-y, x);
    GridCorner moved = corner;
    moved.turn = (corner.turn + quarters) % 4;
    result.emplace(GridPlace{x, y}, moved);
  }
  return result;
}

// The grid with its places on the board, or why that cannot be told.
struct Placed {
  SaddleGrid grid;
  std::string reason;
};

Placed placeOnBoard(const SaddleFinder& finder, const SaddleGrid& found,
                    const BoardGeometry& board) {
  const Bounds seen = boundsOf(found);
  std::array<bool, 4> ends{};
  for (int direction = 0; direction < 4; ++direction) {
    ends[static_cast<std::size_t>(direction)] = endsBeyond(finder, found, seen, direction);
  }
  // Every turn and offset that keeps most corners on the board.
  struct Candidate {
    int quarters, x, y;
    std::size_t inside;
    bool dark;         // the square outside the first corner
    double rightward;  // cosine of the columns' direction in the picture
  };
  std::vector<Candidate> candidates;
  std::size_t most = 0;
  for (int quarters = 0; quarters < 4; ++quarters) {
    const SaddleGrid grid = turned(found, quarters);
    const Bounds b = boundsOf(grid);
    const int slackX = board.columns - b.width();
    const int slackY = board.rows - b.height();
    double rightward = 0;
    for (const auto& [place, corner] : grid) rightward += std::cos(rayAngle(corner, 0));
    for (int x = std::min(0, slackX); x <= std::max(0, slackX); ++x) {
      for (int y = std::min(0, slackY); y <= std::max(0, slackY); ++y) {
        // A side that ends must be a side of the board.
        const auto closed = [&](int direction) {
          return ends[static_cast<std::size_t>((direction - quarters + 4) % 4)];
        };
        if (slackX > 0 && ((closed(2) && x != 0) || (closed(0) && x != slackX))) continue;
        if (slackY > 0 && ((closed(3) && y != 0) || (closed(1) && y != slackY))) continue;
        std::size_t inside = 0;
        for (const auto& [place, corner] : grid) {
          const int column = place.first - b.minX + x;
          const int row = place.second - b.minY + y;
          inside += column >= 0 && row >= 0 && column < board.columns && row < board.rows;
        }
        const auto& [place, corner] = *grid.begin();
        const int parity = place.first - b.minX + x + place.second - b.minY + y;
        candidates.push_back({quarters, x - b.minX, y - b.minY, inside,
                              brightDiagonal(corner) == (parity % 2 != 0), rightward});
        most = std::max(most, inside);
      }
    }
  }
  const int closedSides = static_cast<int>(std::count(ends.begin(), ends.end(), true));
  if (most * 10 < found.size() * 9 || candidates.empty()) {
    return {
        {},
        fmt::format("a grid of {} x {} corners, {}, does not fit a board of {} x {}: is the "
                    "board's size right (inner corners, one less than squares)?",
                    std::max(seen.width(), seen.height()), std::min(seen.width(), seen.height()),
                    closedSides == 4 ? "ended on all sides" : "ended on some sides", board.columns,
                    board.rows)};
  }
  std::erase_if(candidates, [&](const Candidate& c) { return c.inside != most; });
  if (std::any_of(candidates.begin(), candidates.end(), [](const auto& c) { return c.dark; })) {
    std::erase_if(candidates, [](const Candidate& c) { return !c.dark; });
  }
  // What is left must be one placing and its images under the board's own symmetry.
  const auto placeOf = [&](const Candidate& c, const GridPlace& place) {
    auto [x, y] = place;
    for (int i = 0; i < c.quarters; ++i) std::tie(x, y) = std::pair(-y, x);
    return GridPlace{x + c.x, y + c.y};
  };
  const GridPlace probe = found.begin()->first;
  const Candidate front = candidates.front();
  const auto [x, y] = placeOf(front, probe);
  const std::array<GridPlace, 4> images{{{x, y},
                                         {board.rows - 1 - y, x},
                                         {board.columns - 1 - x, board.rows - 1 - y},
                                         {y, board.columns - 1 - x}}};
  for (const Candidate& c : candidates) {
    const int quarter = (c.quarters - front.quarters + 4) % 4;
    const bool same = placeOf(c, probe) == images[static_cast<std::size_t>(quarter)] &&
                      (quarter % 2 == 0 || board.columns == board.rows);
    if (!same) {
      return {
          {},
          fmt::format("only {} x {} of the board's {} x {} corners, and which part cannot be "
                      "told: show a plain board's ends, or use a ChArUco board",
                      std::max(seen.width(), seen.height()), std::min(seen.width(), seen.height()),
                      std::max(board.columns, board.rows), std::min(board.columns, board.rows))};
    }
  }
  const Candidate chosen =
      *std::max_element(candidates.begin(), candidates.end(),
                        [](const auto& a, const auto& b) { return a.rightward < b.rightward; });
  Placed placed;
  for (const auto& [place, corner] : found) {
    const GridPlace at = placeOf(chosen, place);
    if (at.first < 0 || at.second < 0 || at.first >= board.columns || at.second >= board.rows) {
      continue;
    }
    GridCorner moved = corner;
    moved.turn = (corner.turn + chosen.quarters) % 4;
    placed.grid.emplace(at, moved);
  }
  return placed;
}

BoardDetection detectChessboard(const cv::Mat& grey, const BoardGeometry& board,
                                const BoardDetectionOptions& options) {
  BoardDetection best;
  const auto minimum = static_cast<std::size_t>(options.minimumCorners);
  cv::Mat level = grey;
  double scale = 1;
  // Blurred or noisy pictures show their corners on a coarser level.
  for (int i = 0; i < 3; ++i, scale *= 2) {
    if (i > 0) cv::pyrDown(level, level);
    if (std::min(level.cols, level.rows) < 64) break;
    const SaddleFinder finder(level);
    const auto saddles = finder.findAll();
    // Half a board's worth of links is enough to start from; extending finds the rest.
    auto grids = finder.grow(saddles, 4);
    if (grids.size() > 3) grids.resize(3);
    for (SaddleGrid& grid : grids) {
      const int longest = std::max(board.columns, board.rows) + 1;
      finder.extend(grid, [&](const GridPlace& place) {
        const Bounds b = boundsOf(grid);
        return std::max(b.maxX, place.first) - std::min(b.minX, place.first) < longest &&
               std::max(b.maxY, place.second) - std::min(b.minY, place.second) < longest;
      });
      if (grid.size() < std::max<std::size_t>(minimum, best.view.corners.size() + 1)) continue;
      Placed placed = placeOnBoard(finder, grid, board);
      if (placed.grid.empty()) {
        if (best.reason.empty()) best.reason = placed.reason;
        continue;
      }
      finder.extend(placed.grid, [&](const GridPlace& place) {
        return place.first >= 0 && place.second >= 0 && place.first < board.columns &&
               place.second < board.rows;
      });
      SaddleFinder::prune(placed.grid);
      auto corners = refined(grey, placed.grid, scale, 0.25);
      // A coarser level must find clearly more: what it adds at the board's rim is often wrong.
      if (corners.size() * 100 > best.view.corners.size() * 103) {
        best.view.corners = std::move(corners);
      }
    }
    if (best.view.corners.size() == static_cast<std::size_t>(board.cornerCount())) break;
  }
  if (best.view.corners.size() >= minimum) {
    best.reason.clear();
  } else {
    best.view.corners.clear();
    if (best.reason.empty()) {
      best.reason = fmt::format(
          "no grid of {} or more corners: is the whole board in the picture, sharp and lit?",
          minimum);
    }
  }
  return best;
}

// --- ChArUco -------------------------------------------------------------------------------------

BoardDetection detectCharuco(const cv::Mat& grey, const BoardGeometry& board,
                             const BoardDetectionOptions& options,
                             const cv::Ptr<cv::aruco::Dictionary>& dictionary) {
  cv::Mat bytes;
  grey.convertTo(bytes, CV_8U, 255);
  auto parameters = cv::aruco::DetectorParameters::create();
  // Markers shrink near the edge of a fisheye's field.
  parameters->minMarkerPerimeterRate = 0.01;
  parameters->polygonalApproxAccuracyRate = 0.05;
  std::vector<std::vector<cv::Point2f>> found;
  std::vector<int> ids;
  cv::aruco::detectMarkers(bytes, dictionary, found, ids, parameters);
  const auto squares = markerSquares(board);
  BoardDetection detection;

  // Each marker is a small flat piece: its homography places the corners of its square. The corners
  // themselves are then found in the picture, so neither cv::aruco's interpolation (wrong by
  // (0.5, 0.5) pixels in OpenCV 4.6) nor its contours' accuracy matters.
  struct Guess {
    Vector2d point = Vector2d::Zero();
    Vector2d column = Vector2d::Zero();
    Vector2d row = Vector2d::Zero();
    int votes = 0;
  };
  std::map<GridPlace, std::vector<Guess>> guesses;
  std::size_t markers = 0;
  const double inset = (1 - board.markerFraction) / 2;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    if (ids[i] < 0 || static_cast<std::size_t>(ids[i]) >= squares.size()) continue;
    const MarkerSquare& square = squares[static_cast<std::size_t>(ids[i])];
    const auto a = static_cast<float>(inset);
    const auto z = static_cast<float>(1 - inset);
    const std::vector<cv::Point2f> flat{{a, a}, {z, a}, {z, z}, {a, z}};
    const cv::Mat homography = cv::getPerspectiveTransform(flat, found[i]);
    ++markers;
    const std::vector<cv::Point2f> whole{{0, 0}, {1, 0}, {1, 1}, {0, 1}};
    std::vector<cv::Point2f> seen;
    cv::perspectiveTransform(whole, seen, homography);
    std::array<Vector2d, 4> p;
    for (std::size_t k = 0; k < 4; ++k) p[k] = Vector2d(seen[k].x, seen[k].y);
    const std::array<GridPlace, 4> places{{{square.x - 1, square.y - 1},
                                           {square.x, square.y - 1},
                                           {square.x, square.y},
                                           {square.x - 1, square.y}}};
    for (std::size_t k = 0; k < 4; ++k) {
      const auto [column, row] = places[k];
      if (column < 0 || row < 0 || column >= board.columns || row >= board.rows) continue;
      Guess guess;
      guess.point = p[k];
      guess.column = k < 2 ? p[1] - p[0] : p[2] - p[3];
      guess.row = k == 0 || k == 3 ? p[3] - p[0] : p[2] - p[1];
      guesses[places[k]].push_back(guess);
    }
  }
  if (markers == 0) {
    detection.reason = fmt::format(
        "no marker of {}: is the dictionary right, the board sharp and lit, the picture not "
        "mirrored?",
        board.dictionary);
    return detection;
  }

  const SaddleFinder finder(grey);
  SaddleGrid grid;
  std::size_t tried = 0;
  std::size_t disagreeing = 0;
  for (const auto& [place, list] : guesses) {
    Guess mean;
    for (const Guess& guess : list) {
      mean.point += guess.point / static_cast<double>(list.size());
      mean.column += guess.column / static_cast<double>(list.size());
      mean.row += guess.row / static_cast<double>(list.size());
    }
    const double step = std::min(mean.column.norm(), mean.row.norm());
    ++tried;
    if (list.size() == 2 && (list[0].point - list[1].point).norm() > 0.5 * step) {
      ++disagreeing;
      continue;
    }
    // Square (0, 0) is dark, so the one beyond corner (0, 0) is too.
    const auto corner = finder.locate(
        mean.point, step, std::atan2(mean.column.y(), mean.column.x()),
        std::atan2(mean.row.y(), mean.row.x()), (place.first + place.second) % 2 != 0);
    if (corner) grid.emplace(place, *corner);
  }
  if (disagreeing * 3 > tried) {
    detection.reason = fmt::format(
        "{} markers, but not where a board of {} x {} corners has them: are the board's columns, "
        "rows and marker size right?",
        markers, board.columns, board.rows);
    return detection;
  }
  // Beyond the last marker that could be read.
  finder.extend(grid, [&](const GridPlace& place) {
    return place.first >= 0 && place.second >= 0 && place.first < board.columns &&
           place.second < board.rows;
  });
  if (!grid.empty()) detection.view.corners = refined(grey, grid, 1, inset);
  if (detection.view.corners.size() < static_cast<std::size_t>(options.minimumCorners)) {
    detection.reason =
        fmt::format("{} markers but only {} corners, {} are wanted: show more of the board",
                    markers, detection.view.corners.size(), options.minimumCorners);
    detection.view.corners.clear();
  }
  return detection;
}

Result<BoardDetection> detect(const cv::Mat& picture, const BoardGeometry& board,
                              const BoardDetectionOptions& options) {
  RETURN_IF_ERROR(validateBoard(board));
  RETURN_IF_ERROR(options.validate());
  if (picture.empty() || (picture.channels() != 1 && picture.channels() != 3)) {
    return failure(ErrorCode::kInvalidArgument,
                   "board detection: give a picture of 1 or 3 channels");
  }
  try {
    const cv::Mat grey = stretched(picture);
    if (board.kind == BoardGeometry::Kind::kChessboard) {
      return detectChessboard(grey, board, options);
    }
    ASSIGN_OR_RETURN(const auto dictionary, markerDictionary(board.dictionary));
    return detectCharuco(grey, board, options, dictionary);
  } catch (const cv::Exception& error) {
    BoardDetection nothing;
    nothing.reason = fmt::format("OpenCV gave up: {}", error.err);
    return nothing;
  }
}

// OpenCV reads, but never writes, through this header.
template <class T>
cv::Mat header(const Image<T>& image, int depth) {
  return cv::Mat(image.height(), image.width(), CV_MAKETYPE(depth, std::max(1, image.channels())),
                 const_cast<T*>(image.data()));
}

struct Picture {
  cv::Mat pixels;
  std::string reason;
};

Picture readPicture(const std::filesystem::path& file) {
  const auto bytes = readFile(file);
  if (!bytes) return {{}, bytes.error().message};
  if (bytes->starts_with("\x76\x2f\x31\x01")) {
    const auto image = decodeExr(*bytes, file.string());
    if (!image) return {{}, image.error().message};
    // Linear: the square root brings dark squares nearer to what an eye and a threshold expect.
    cv::Mat encoded;
    cv::sqrt(cv::max(header(*image, CV_32F), 0.0), encoded);
    return {encoded, {}};
  }
  try {
    const cv::Mat raw(1, static_cast<int>(bytes->size()), CV_8U, const_cast<char*>(bytes->data()));
    cv::Mat pixels = cv::imdecode(
        raw, cv::IMREAD_GRAYSCALE | cv::IMREAD_ANYDEPTH | cv::IMREAD_IGNORE_ORIENTATION);
    if (!pixels.empty()) return {pixels, {}};
  } catch (const cv::Exception&) {
  }
  return {{}, "not an image that can be read: JPEG, PNG, TIFF or EXR is wanted"};
}

}  // namespace

Result<void> BoardDetectionOptions::validate() const {
  if (minimumCorners >= 6) return {};
  return failure(ErrorCode::kInvalidArgument,
                 "board detection: {} corners do not fix a board's pose; ask for 6 or more",
                 minimumCorners);
}

Result<BoardDetection> detectBoard(const Image<std::uint8_t>& image, const BoardGeometry& board,
                                   const BoardDetectionOptions& options) {
  return detect(header(image, CV_8U), board, options);
}

Result<BoardDetection> detectBoard(const Image<std::uint16_t>& image, const BoardGeometry& board,
                                   const BoardDetectionOptions& options) {
  return detect(header(image, CV_16U), board, options);
}

Result<BoardDetection> detectBoard(const RadianceImage& image, const BoardGeometry& board,
                                   const BoardDetectionOptions& options) {
  if (image.empty()) return detect(cv::Mat(), board, options);
  cv::Mat encoded;
  cv::sqrt(cv::max(header(image, CV_32F), 0.0), encoded);
  return detect(encoded, board, options);
}

std::vector<BoardView> BoardSearch::views() const {
  std::vector<BoardView> views;
  for (const BoardDetection& picture : pictures) {
    if (!picture.view.corners.empty()) views.push_back(picture.view);
  }
  return views;
}

std::size_t BoardSearch::found() const { return views().size(); }

Result<BoardSearch> detectBoards(std::span<const std::filesystem::path> files,
                                 const BoardGeometry& board, const BoardDetectionOptions& options,
                                 Progress& progress) {
  if (files.empty()) {
    return failure(ErrorCode::kNotFound, "board detection: no pictures; give image files");
  }
  RETURN_IF_ERROR(validateBoard(board));
  RETURN_IF_ERROR(options.validate());
  BoardSearch search;
  search.pictures.resize(files.size());
  std::vector<std::pair<int, int>> sizes(files.size());
  std::atomic<std::size_t> done = 0;
  progress.update("looking for boards", 0, files.size());
  tbb::parallel_for(std::size_t{0}, files.size(), [&](std::size_t i) {
    if (progress.cancelled()) return;
    BoardDetection& result = search.pictures[i];
    Picture picture = readPicture(files[i]);
    if (!picture.reason.empty()) {
      result.reason = picture.reason;
    } else {
      sizes[i] = {picture.pixels.cols, picture.pixels.rows};
      auto detection = detect(picture.pixels, board, options);
      if (detection) {
        result = std::move(*detection);
      } else {
        result.reason = detection.error().message;
      }
    }
    result.view.name = files[i].filename().string();
    progress.update("looking for boards", ++done, files.size());
  });
  if (progress.cancelled()) {
    return failure(ErrorCode::kCancelled, "board detection: cancelled");
  }
  // Most pictures' size is the camera's.
  std::map<std::pair<int, int>, int> counts;
  for (const auto& size : sizes) {
    if (size.first > 0) ++counts[size];
  }
  int most = 0;
  for (const auto& [size, count] : counts) {
    if (count > most)
      std::tie(most, search.width, search.height) = std::tuple(count, size.first, size.second);
  }
  for (std::size_t i = 0; i < files.size(); ++i) {
    if (sizes[i].first == 0 || sizes[i] == std::pair(search.width, search.height)) continue;
    search.pictures[i].view.corners.clear();
    search.pictures[i].reason =
        fmt::format("{} x {} pixels, the others have {} x {}: one camera, one setting, please",
                    sizes[i].first, sizes[i].second, search.width, search.height);
  }
  return search;
}

Result<std::vector<std::filesystem::path>> imagesInFolder(const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::directory_iterator entries(folder, error);
  if (error) {
    return failure(ErrorCode::kNotFound, "{}: cannot be read as a folder: {}", folder.string(),
                   error.message());
  }
  std::vector<std::filesystem::path> files;
  for (const auto& entry : entries) {
    std::string extension = entry.path().extension().string();
    std::transform(extension.begin(), extension.end(), extension.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    for (const char* known : {".jpg", ".jpeg", ".png", ".tif", ".tiff", ".exr", ".bmp", ".pgm"}) {
      if (extension == known) files.push_back(entry.path());
    }
  }
  if (files.empty()) {
    return failure(ErrorCode::kNotFound,
                   "{}: no pictures; put JPEG, PNG, TIFF or EXR files of the board there",
                   folder.string());
  }
  // Runs of digits compare as numbers.
  const auto key = [](const std::filesystem::path& path) {
    std::string padded;
    std::string digits;
    for (const char c : path.filename().string() + '\0') {
      if (c >= '0' && c <= '9') {
        digits += c;
        continue;
      }
      if (!digits.empty())
        padded += std::string(20 - std::min<std::size_t>(19, digits.size()), '0') + digits;
      digits.clear();
      padded += c;
    }
    return padded;
  };
  std::sort(files.begin(), files.end(),
            [&](const auto& a, const auto& b) { return key(a) < key(b); });
  return files;
}

}  // namespace lightsketch
