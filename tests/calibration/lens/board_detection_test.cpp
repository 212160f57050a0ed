#include "calibration/lens/board_detection.h"

#include <gtest/gtest.h>

#include <fstream>
#include <set>

#include "pipeline/sketch/image_file.h"
#include "tests/calibration/lens/board_scene.h"
#include "tests/capture/frame/temporary_folder.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

BoardGeometry chessboard(int columns, int rows) {
  BoardGeometry board;
  board.kind = BoardGeometry::Kind::kChessboard;
  board.columns = columns;
  board.rows = rows;
  return board;
}

BoardGeometry charuco() { return {}; }  // 10 x 7

struct Errors {
  double rms = 0;
  double largest = 0;
};

// Distances of the corners from where the scene's own lens puts them.
Errors errorsAgainst(const BoardView& view, const BoardGeometry& board, const EquidistantLens& lens,
                     const Eigen::Isometry3d& pose, int turns = 0) {
  Errors errors;
  for (const BoardCorner& corner : view.corners) {
    const int column = turns ? board.columns - 1 - corner.column : corner.column;
    const int row = turns ? board.rows - 1 - corner.row : corner.row;
    const Eigen::Vector3d point(column * board.spacingMetres, row * board.spacingMetres, 0);
    const double error = (lens.project(pose * point) - corner.pixel).norm();
    errors.rms += error * error / static_cast<double>(view.corners.size());
    errors.largest = std::max(errors.largest, error);
  }
  errors.rms = std::sqrt(errors.rms);
  return errors;
}

// Rows run to the left of columns when the board is seen from the back or in a mirror.
bool mirrored(const BoardView& view) {
  std::map<std::pair<int, int>, Eigen::Vector2d> at;
  for (const auto& corner : view.corners) at[{corner.column, corner.row}] = corner.pixel;
  for (const auto& [place, p] : at) {
    const auto right = at.find({place.first + 1, place.second});
    const auto below = at.find({place.first, place.second + 1});
    if (right == at.end() || below == at.end()) continue;
    const Eigen::Vector2d u = right->second - p;
    const Eigen::Vector2d v = below->second - p;
    if (u.x() * v.y() - u.y() * v.x() <= 0) return true;
  }
  return false;
}

BoardDetection detectIn(const Image<std::uint8_t>& image, const BoardGeometry& board) {
  auto result = detectBoard(image, board);
  EXPECT_TRUE(result) << result.error().message;
  return *result;
}

TEST(BoardDetection, ChessboardCornersAreWhereTheLensPutsThem) {
  const auto board = chessboard(9, 6);
  const EquidistantLens lens;
  const auto pose = boardTowards(board, 0.4, 0.7, 0.28, 0.3);
  const auto found = detectIn(BoardScene(board).render(lens, pose), board);
  ASSERT_EQ(found.view.corners.size(), 54u) << found.reason;
  const auto errors = errorsAgainst(found.view, board, lens, pose);
  // Noise of 2 grey levels on edges of 200: two hundredths of a pixel. Half a pixel, the mistake
  // that pixel conventions invite, would be 17 times the bar.
  EXPECT_LT(errors.rms, 0.03);
  EXPECT_LT(errors.largest, 0.1);
}

TEST(BoardDetection, CharucoCornersAreWhereTheLensPutsThem) {
  const auto board = charuco();
  const EquidistantLens lens;
  const BoardScene scene(board);
  for (const double angle : {0.0, 0.5, 1.0}) {
    const auto pose = boardTowards(board, 2 + angle, angle, 0.3, 0.2 + 3 * angle);
    const auto found = detectIn(scene.render(lens, pose), board);
    ASSERT_GE(found.view.corners.size(), 66u) << found.reason << " at " << angle;
    const auto errors = errorsAgainst(found.view, board, lens, pose);
    // Markers reach to an eighth of a square from the corner: they must not pull it.
    EXPECT_LT(errors.rms, 0.05) << angle;
    EXPECT_LT(errors.largest, 0.25) << angle;
    EXPECT_FALSE(mirrored(found.view));
  }
}

TEST(BoardDetection, CharucoCutOffByTheEdgeOfTheFieldCounts) {
  const auto board = charuco();
  EquidistantLens lens;  // 800 px wide: 100 degrees to each side, so the board leaves the picture
  const auto pose = boardTowards(board, 0.1, 1.45, 0.3, 0.1);
  const auto found = detectIn(BoardScene(board).render(lens, pose), board);
  int inside = 0;
  for (int row = 0; row < board.rows; ++row) {
    for (int column = 0; column < board.columns; ++column) {
      const auto pixel = lens.project(pose * board.corner(column, row));
      inside += pixel.x() > 8 && pixel.y() > 8 && pixel.x() < 792 && pixel.y() < 792;
    }
  }
  ASSERT_LT(inside, board.cornerCount());
  EXPECT_GE(found.view.corners.size(), static_cast<std::size_t>(0.85 * inside)) << found.reason;
  const auto errors = errorsAgainst(found.view, board, lens, pose);
  EXPECT_LT(errors.rms, 0.1);
  EXPECT_LT(errors.largest, 0.5);
}

TEST(BoardDetection, CornersBeyondTheLastReadableMarkerAreFound) {
  const auto board = charuco();
  const EquidistantLens lens;
  const auto pose = boardTowards(board, 0.4, 0.5, 0.3, 0.3);
  auto image = BoardScene(board).render(lens, pose);
  // Paint over the markers' insides of the last three columns, leaving the squares' corners.
  for (int x = board.columns - 2; x <= board.columns; ++x) {
    for (int y = 0; y <= board.rows; ++y) {
      if ((x + y) % 2 == 0) continue;
      const auto centre = lens.project(pose * Eigen::Vector3d((x - 0.5) * board.spacingMetres,
                                                              (y - 0.5) * board.spacingMetres, 0));
      for (int dy = -5; dy <= 5; ++dy) {
        for (int dx = -5; dx <= 5; ++dx) {
          image(static_cast<int>(centre.x()) + dx, static_cast<int>(centre.y()) + dy) = 217;
        }
      }
    }
  }
  const auto found = detectIn(image, board);
  EXPECT_EQ(found.view.corners.size(), 70u);
  EXPECT_LT(errorsAgainst(found.view, board, lens, pose).largest, 0.3);
}

TEST(BoardDetection, PlainBoardsAreNumberedAlikeHoweverTheyAreTurned) {
  EquidistantLens lens;
  lens.width = lens.height = 420;  // renders faster
  lens.cx = 211;
  lens.cy = 209;
  for (const auto& board : {chessboard(9, 6), chessboard(6, 8), chessboard(7, 7)}) {
    const BoardScene scene(board);
    for (int i = 0; i < 5; ++i) {
      const auto pose = boardTowards(board, 0.8 * i, 0.3, 0.28, 0.1 + 1.26 * i);
      const auto found = detectIn(scene.render(lens, pose, 2, static_cast<unsigned>(i)), board);
      ASSERT_EQ(found.view.corners.size(), static_cast<std::size_t>(board.cornerCount()))
          << board.columns << " x " << board.rows << " turn " << i << ": " << found.reason;
      EXPECT_FALSE(mirrored(found.view));
      const double straight = errorsAgainst(found.view, board, lens, pose).rms;
      const double upsideDown = errorsAgainst(found.view, board, lens, pose, 1).rms;
      // Odd: the dark square tells the ends apart. Even: either end may be first.
      const bool odd = (board.columns + board.rows) % 2 != 0;
      EXPECT_LT(odd ? straight : std::min(straight, upsideDown), 0.1)
          << board.columns << " x " << board.rows << " turn " << i;
    }
  }
}

TEST(BoardDetection, PartOfAPlainBoardCountsWhereItsEndIsSeen) {
  const auto board = chessboard(9, 6);
  EquidistantLens lens;
  const auto pose = boardTowards(board, 0.0, 0.4, 0.28, 0.0, 0.0);
  const auto whole = BoardScene(board).render(lens, pose);
  // The picture ends inside the board's last columns.
  const auto last = lens.project(pose * board.corner(6, 2));
  Image<std::uint8_t> cut(static_cast<int>(last.x()) + 14, lens.height, 1);
  for (int y = 0; y < cut.height(); ++y) {
    for (int x = 0; x < cut.width(); ++x) cut(x, y) = whole(x, y);
  }
  const auto found = detectIn(cut, board);
  ASSERT_GE(found.view.corners.size(), 36u) << found.reason;
  ASSERT_LT(found.view.corners.size(), 54u);
  EXPECT_LT(errorsAgainst(found.view, board, lens, pose).rms, 0.1);
}

TEST(BoardDetection, PartOfAPlainBoardThatCouldBeAnyPartIsRefused) {
  const auto board = chessboard(40, 40);
  EquidistantLens lens;
  lens.width = lens.height = 300;
  lens.cx = lens.cy = 150;
  const auto pose = boardTowards(board, 0, 0, 0.3, 0.2);
  const auto found = detectIn(BoardScene(board).render(lens, pose), board);
  EXPECT_TRUE(found.view.corners.empty());
  EXPECT_NE(found.reason.find("which part"), std::string::npos) << found.reason;
}

TEST(BoardDetection, AWrongBoardSizeIsNamedAsTheReason) {
  const EquidistantLens lens;
  const auto shown = chessboard(6, 8);
  const auto image = BoardScene(shown).render(lens, boardTowards(shown, 0.4, 0.3, 0.3, 0.3));
  for (const auto& said : {chessboard(7, 9), chessboard(5, 7)}) {
    const auto found = detectIn(image, said);
    EXPECT_TRUE(found.view.corners.empty());
    EXPECT_NE(found.reason.find("8 x 6"), std::string::npos) << found.reason;
    EXPECT_NE(found.reason.find("size"), std::string::npos) << found.reason;
  }
  auto said = charuco();
  const auto markers = BoardScene(said).render(lens, boardTowards(said, 0.4, 0.3, 0.3, 0.3));
  said.columns = 8;
  said.rows = 9;
  const auto found = detectIn(markers, said);
  EXPECT_TRUE(found.view.corners.empty());
  EXPECT_NE(found.reason.find("columns, rows"), std::string::npos) << found.reason;
}

TEST(BoardDetection, AMirroredCharucoBoardIsNotNumberedBackwards) {
  const auto board = charuco();
  const EquidistantLens lens;
  const auto image = BoardScene(board).render(lens, boardTowards(board, 0.4, 0.3, 0.3, 0.3));
  Image<std::uint8_t> mirror(image.width(), image.height(), 1);
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) mirror(x, y) = image(image.width() - 1 - x, y);
  }
  const auto found = detectIn(mirror, board);
  EXPECT_TRUE(found.view.corners.empty());
  EXPECT_FALSE(found.reason.empty());
}

TEST(BoardDetection, SixteenBitsLinearAndColourPicturesGiveTheSameCorners) {
  const auto board = chessboard(9, 6);
  const EquidistantLens lens;
  const auto image = BoardScene(board).render(lens, boardTowards(board, 0.4, 0.5, 0.28, 0.3));
  const auto reference = detectIn(image, board);
  Image<std::uint16_t> deep(image.width(), image.height(), 1);
  RadianceImage radiance(image.width(), image.height(), 3);
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) {
      // An underexposed 12-bit sensor.
      deep(x, y) = static_cast<std::uint16_t>(300 + 4 * image(x, y));
      const float value = static_cast<float>(image(x, y)) / 255;
      for (int c = 0; c < 3; ++c) radiance(x, y, c) = value * value;
    }
  }
  const auto deepResult = detectBoard(deep, board);
  const auto radianceResult = detectBoard(radiance, board);
  ASSERT_TRUE(deepResult && radianceResult);
  ASSERT_EQ(reference.view.corners.size(), 54u);
  for (const auto* other : {&*deepResult, &*radianceResult}) {
    ASSERT_EQ(other->view.corners.size(), 54u);
    for (std::size_t i = 0; i < 54; ++i) {
      // Both are the same numbers but for rounding.
      EXPECT_LT((other->view.corners[i].pixel - reference.view.corners[i].pixel).norm(), 0.01);
    }
  }
}

TEST(BoardDetection, PicturesWithoutABoardSayWhy) {
  std::mt19937 random(3);
  Image<std::uint8_t> noise(640, 480, 1);
  for (auto& value : noise.values()) value = static_cast<std::uint8_t>(random() & 255);
  Image<std::uint8_t> black(640, 480, 1);
  for (const auto& board : {chessboard(6, 8), charuco()}) {
    for (const auto* image : {&noise, &black}) {
      const auto found = detectIn(*image, board);
      EXPECT_TRUE(found.view.corners.empty());
      EXPECT_FALSE(found.reason.empty());
    }
  }
}

TEST(BoardDetection, BoardsThatCannotBeAreRefused) {
  const Image<std::uint8_t> image(64, 64, 1);
  auto board = charuco();
  board.dictionary = "DICT_5X5_20";
  auto result = detectBoard(image, board);
  ASSERT_FALSE(result);
  EXPECT_NE(result.error().message.find("DICT_5X5_20"), std::string::npos);
  board.dictionary = "DICT_4X4_50";
  board.columns = board.rows = 20;
  result = detectBoard(image, board);
  ASSERT_FALSE(result);
  EXPECT_NE(result.error().message.find("larger dictionary"), std::string::npos);
  EXPECT_FALSE(detectBoard(image, chessboard(2, 5)));
}

TEST(BoardSearch, EveryFileHasItsBoardOrItsReason) {
  const TemporaryFolder folder;
  const auto board = chessboard(6, 8);
  const EquidistantLens lens;
  const BoardScene scene(board);
  for (const int number : {2, 10, 1}) {
    const auto image = scene.render(lens, boardTowards(board, number, 0.3, 0.3, 0.1));
    ASSERT_TRUE(writePng(folder.path() / fmt::format("img{}.png", number), image));
  }
  ASSERT_TRUE(writePng(folder.path() / "small.png", Image<std::uint8_t>(100, 80, 1)));
  std::ofstream(folder.path() / "torn.jpg") << "not a picture";
  std::ofstream(folder.path() / "notes.txt") << "not a picture either";
  const auto files = imagesInFolder(folder.path());
  ASSERT_TRUE(files);
  ASSERT_EQ(files->size(), 5u);
  EXPECT_EQ((*files)[1].filename(), "img2.png");  // counted, not spelled
  SilentProgress progress;
  const auto search = detectBoards(*files, board, {}, progress);
  ASSERT_TRUE(search) << search.error().message;
  EXPECT_EQ(search->width, 800);
  EXPECT_EQ(search->found(), 3u);
  EXPECT_NE(search->pictures[3].reason.find("100 x 80"), std::string::npos);
  EXPECT_FALSE(search->pictures[4].reason.empty());
  EXPECT_EQ(search->pictures[4].view.name, "torn.jpg");
}

TEST(BoardSearch, AnEmptyFolderSaysWhatToPutThere) {
  const TemporaryFolder folder;
  const auto files = imagesInFolder(folder.path());
  ASSERT_FALSE(files);
  EXPECT_EQ(files.error().code, ErrorCode::kNotFound);
  EXPECT_NE(files.error().message.find("put JPEG"), std::string::npos);
}

TEST(BoardSearch, StopsWhenAskedTo) {
  class Cancelled final : public Progress {
    void update(std::string_view, std::size_t, std::size_t) override {}
    void warn(std::string_view) override {}
    bool cancelled() const override { return true; }
  } progress;
  const std::vector<fs::path> files{"a.png"};
  const auto search = detectBoards(files, charuco(), {}, progress);
  ASSERT_FALSE(search);
  EXPECT_EQ(search.error().code, ErrorCode::kCancelled);
}

TEST(BoardSearch, FindsTheBoardsOfRealFisheyes) {
  const fs::path data = fs::path(LIGHTSKETCH_SOURCE_DIR) / ".." / "shared" / "data" / "fisheye";
  if (!fs::exists(data)) GTEST_SKIP() << "the real fisheye pictures are not there";
  SilentProgress progress;
  // Every picture of both sets shows a whole board, one or two with its rim in the blur.
  for (const auto& [name, count] : {std::pair("fish_1", 15u), {"copark86", 18u}}) {
    const auto files = imagesInFolder(data / name);
    ASSERT_TRUE(files);
    const auto search = detectBoards(*files, chessboard(6, 8), {}, progress);
    ASSERT_TRUE(search);
    EXPECT_GE(search->found(), count) << name;
    for (const auto& view : search->views()) EXPECT_FALSE(mirrored(view)) << view.name;
  }
}

}  // namespace
}  // namespace lightsketch
