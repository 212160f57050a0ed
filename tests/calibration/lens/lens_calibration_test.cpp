#include "calibration/lens/lens_calibration.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "tests/calibration/lens/synthetic_lens.h"

namespace lightsketch {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using ::testing::HasSubstr;

Result<LensCalibration> calibrate(const TrueLens& lens, std::span<const BoardView> views,
                                  const BoardGeometry& board,
                                  const LensCalibrationOptions& options = {}) {
  SilentProgress progress;
  return calibrateLens(views, board, lens.width, lens.height, options, progress);
}

// The family given and no splits: the solve alone, a tenth of the time.
LensCalibrationOptions solveOnly(LensFamily family = LensFamily::kKannalaBrandt) {
  LensCalibrationOptions options;
  options.family = family;
  options.splits = 0;
  return options;
}

double predictedRms(const CameraModel& model, const DirectionErrors& errors) {
  double sum = 0;
  for (const auto& direction : errors.directions) {
    sum += model.directionCovariance(direction).trace();
  }
  return std::sqrt(sum / static_cast<double>(errors.directions.size()));
}

TrueLens narrowLens(double focal) {
  TrueLens lens;
  lens.kind = TrueLens::Kind::kPinhole;
  lens.width = 640;
  lens.height = 480;
  lens.focal = focal;
  lens.cx = 322;
  lens.cy = 237;
  return lens;
}

BoardGeometry smallBoard() {
  BoardGeometry board = largeBoard();
  board.spacingMetres = 0.02;
  return board;
}

SceneOptions narrowScene(const TrueLens& lens) {
  SceneOptions scene;
  scene.fieldDegrees = std::atan(400 / lens.focal) / kDegree;
  scene.nearest = 0.4 * lens.focal / 600;
  scene.farthest = 0.8 * lens.focal / 600;
  scene.warp = {0.0003, -0.0002};
  return scene;
}

// 40 views at 0.2 px determine the edge to about 0.007 degrees rms; 0.02 is the promise.
TEST(LensCalibration, FindsALensOfItsFamilyToFiftiethsOfADegreeBeyondTheHemisphere) {
  const TrueLens lens;
  SceneOptions scene;
  scene.seed = 101;
  const auto views = syntheticViews(lens, largeBoard(), scene);
  const auto result = calibrate(lens, views, largeBoard());
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_EQ(result->family, LensFamily::kKannalaBrandt);
  EXPECT_EQ(result->trials.size(), 4U);
  const auto errors = directionErrors(lens, *result->model, 92);
  EXPECT_LT(errors.largest(92, 92), 0.02 * kDegree);
  EXPECT_LT(errors.rms(0, 92), 0.01 * kDegree);
  // One draw of some ten parameters: its error may lie a factor 2 from the expected.
  const double predicted = predictedRms(*result->model, errors);
  EXPECT_LT(errors.rms(0, 92), 2 * predicted);
  EXPECT_GT(errors.rms(0, 92), 0.5 * predicted);
  EXPECT_LT(result->splitHalf.rms.radians(), 2 * result->splitHalf.predicted.radians());
  EXPECT_GT(result->splitHalf.rms.radians(), 0.5 * result->splitHalf.predicted.radians());
  EXPECT_EQ(result->splitHalf.splits, 10);
  // The noise put in, known from 10,000 coordinates to 0.7 percent.
  EXPECT_NEAR(result->residualPixels, 0.2, 0.006);
  // The board's bend, metres; its own uncertainty is some 20 micrometres.
  EXPECT_NEAR(result->warpMetres.x(), 0.0012, 1e-4);
  EXPECT_NEAR(result->warpMetres.y(), -0.0007, 1e-4);
  // Nothing lacks in these pictures.
  EXPECT_TRUE(result->warnings.empty()) << result->warnings.front();
  for (double azimuth = 5; azimuth < 360; azimuth += 10) {
    const double theta = 90 * kDegree;
    EXPECT_TRUE(
        result->model->covers({std::sin(theta) * std::cos(azimuth * kDegree),
                               std::sin(theta) * std::sin(azimuth * kDegree), std::cos(theta)}))
        << azimuth;
  }
}

TEST(LensCalibration, ALensOfNoFamilyEarnsTheRicherOne) {
  TrueLens lens;
  lens.kind = TrueLens::Kind::kOutside;
  SceneOptions scene;
  scene.seed = 101;
  const auto result = calibrate(lens, syntheticViews(lens, largeBoard(), scene), largeBoard());
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_EQ(result->family, LensFamily::kFisheye624);
  const auto errors = directionErrors(lens, *result->model, 92);
  EXPECT_LT(errors.largest(92, 92), 0.05 * kDegree);
  EXPECT_LT(errors.rms(0, 92), 2 * predictedRms(*result->model, errors));
}

TEST(LensCalibration, AMovingPupilIsFoundWhereThereIsOne) {
  TrueLens lens;
  lens.kind = TrueLens::Kind::kPupil;
  SceneOptions scene;
  scene.seed = 103;
  const auto views = syntheticViews(lens, largeBoard(), scene);
  LensCalibrationOptions options;
  options.splits = 0;
  const auto result = calibrate(lens, views, largeBoard(), options);
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_EQ(result->family, LensFamily::kFisheye624Pupil);
  // 4 mm theta^2 was put in. At the edge, theta = 1.6, the shift is 10.5 mm; the two coefficients
  // alone trade with one another.
  const auto& pupil = result->model->values().pupilMetres;
  const double t2 = 1.62 * 1.62;
  EXPECT_NEAR(pupil[0] * t2 + pupil[1] * t2 * t2, 0.004 * t2, 0.0004);
  // A central lens is several times further off at the edge.
  const auto central = calibrate(lens, views, largeBoard(), solveOnly(LensFamily::kFisheye624));
  ASSERT_TRUE(central) << central.error().message;
  const double moving = directionErrors(lens, *result->model, 92).rms(85, 92);
  EXPECT_GT(directionErrors(lens, *central->model, 92).rms(85, 92), 5 * moving);
  EXPECT_LT(moving, 0.05 * kDegree);
}

TEST(LensCalibration, SaysThatTheEdgeIsUnknownWhereNoBoardWent) {
  const TrueLens lens;
  SceneOptions scene;
  scene.fieldDegrees = 75;
  const auto result =
      calibrate(lens, syntheticViews(lens, largeBoard(), scene), largeBoard(), solveOnly());
  ASSERT_TRUE(result) << result.error().message;
  ASSERT_FALSE(result->warnings.empty());
  EXPECT_THAT(result->warnings.front(), HasSubstr("edge of the field is unknown"));
  EXPECT_THAT(result->warnings.front(), HasSubstr("75 degrees"));
  EXPECT_THAT(result->advice.front(), HasSubstr("edge of the picture"));
  ASSERT_EQ(result->model->uncertainty().coveredField.size(), 36U);
  for (const Angle angle : result->model->uncertainty().coveredField) {
    EXPECT_GT(angle.degrees(), 65);
    EXPECT_LE(angle.degrees(), 74.1);
  }
  // The model goes on to where the picture does.
  EXPECT_GT(result->model->maxFieldAngle().degrees(), 95);
  // Out there it knows itself to be less certain.
  const auto sigma = [&](double degrees) {
    return std::sqrt(result->model
                         ->directionCovariance(
                             Vector3d(std::sin(degrees * kDegree), 0, std::cos(degrees * kDegree)))
                         .trace());
  };
  EXPECT_GT(sigma(92), 3 * sigma(70));
}

TEST(LensCalibration, ASideWithoutBoardsIsNamed) {
  const TrueLens lens;
  auto views = syntheticViews(lens, largeBoard(), {});
  // Nothing in the lower left, more than 50 degrees out.
  for (auto& view : views) {
    std::erase_if(view.corners, [&](const BoardCorner& corner) {
      const Vector2d off = corner.pixel - Vector2d(lens.cx, lens.cy);
      return off.norm() > 500 && off.x() < 0 && off.y() > 0;
    });
  }
  const auto result = calibrate(lens, views, largeBoard(), solveOnly());
  ASSERT_TRUE(result) << result.error().message;
  ASSERT_EQ(result->warnings.size(), 1U);
  EXPECT_THAT(result->warnings.front(), HasSubstr("percent of the azimuths"));
  EXPECT_THAT(result->advice, ::testing::Contains(HasSubstr("bottom left: no corners beyond")));
  EXPECT_THAT(result->advice, ::testing::Not(::testing::Contains(HasSubstr("top right"))));
}

TEST(LensCalibration, WrongCornersAndViewsAreThrownOutWithTheirReason) {
  const TrueLens lens;
  auto views = syntheticViews(lens, largeBoard(), {});
  const auto clean = calibrate(lens, views, largeBoard(), solveOnly());
  ASSERT_TRUE(clean) << clean.error().message;
  // 30 corners 8 px off or more, and a view whose corners belong to some other board.
  std::mt19937 random(5);
  std::uniform_real_distribution<double> uniform(0, 1);
  std::vector<std::pair<std::size_t, std::size_t>> wrong;
  for (std::size_t i = 0; i < 30; ++i) {
    auto& corners = views[i].corners;
    const std::size_t c = random() % corners.size();
    const double turn = 2 * std::numbers::pi * uniform(random);
    corners[c].pixel += (8 + 40 * uniform(random)) * Vector2d(std::cos(turn), std::sin(turn));
    wrong.emplace_back(i, c);
  }
  for (auto& corner : views[35].corners) {
    corner.pixel += 30 * Vector2d(uniform(random) - 0.5, uniform(random) - 0.5);
  }
  const auto result = calibrate(lens, views, largeBoard(), solveOnly());
  ASSERT_TRUE(result) << result.error().message;
  for (const auto& [view, corner] : wrong) {
    EXPECT_THAT(result->views[view].corners[corner].rejected, HasSubstr("px off")) << view;
  }
  EXPECT_THAT(result->views[35].rejected, HasSubstr("do not fit"));
  EXPECT_EQ(result->viewsUsed, 39);
  // Of good corners a 4 sigma gate throws out 3 in 10,000.
  int rejected = 0;
  for (const auto& view : result->views) {
    if (!view.rejected.empty()) continue;
    for (const auto& corner : view.corners) rejected += !corner.rejected.empty();
  }
  EXPECT_LE(rejected, 30 + 8);
  // What is left gives nearly the same lens as had nothing been wrong.
  EXPECT_NEAR(result->model->values().fx, clean->model->values().fx, 0.1);
}

TEST(LensCalibration, ANarrowLensIsCalibratedByTheSameCall) {
  for (const double focal : {600.0, 1200.0}) {
    const TrueLens lens = narrowLens(focal);
    const auto scene = narrowScene(lens);
    const auto result =
        calibrate(lens, syntheticViews(lens, smallBoard(), scene), smallBoard(), solveOnly());
    ASSERT_TRUE(result) << result.error().message;
    // The focal length is known to about 0.1 percent from boards this small.
    EXPECT_NEAR(result->model->values().fx, focal, 0.004 * focal);
    const double half = std::atan(230 / focal) / kDegree;
    EXPECT_LT(directionErrors(lens, *result->model, half).largest(0, half), 0.05 * kDegree);
    // Nothing blows up outside: every corner of the picture has a direction, near the true one.
    for (const double x : {0.5, 639.5}) {
      for (const double y : {0.5, 479.5}) {
        const auto direction = result->model->unproject({x, y});
        ASSERT_TRUE(direction);
        EXPECT_NEAR((lens.project(*direction) - Vector2d(x, y)).norm(), 0, 4);
      }
    }
  }
}

TEST(LensCalibration, TheRejectedAreNoViewsOfABoardSeenInAMirror) {
  const TrueLens lens;
  const auto board = largeBoard();
  auto views = syntheticViews(lens, board, {});
  // One view mirrored: it goes. All: nothing is left to calibrate.
  for (auto& corner : views[3].corners) corner.column = board.columns - 1 - corner.column;
  const auto one = calibrate(lens, views, board, solveOnly());
  ASSERT_TRUE(one) << one.error().message;
  EXPECT_THAT(one->views[3].rejected, HasSubstr("mirror"));
  for (std::size_t v = 0; v < views.size(); ++v) {
    if (v == 3) continue;
    for (auto& corner : views[v].corners) corner.column = board.columns - 1 - corner.column;
  }
  const auto all = calibrate(lens, views, board, solveOnly());
  ASSERT_FALSE(all);
  EXPECT_EQ(all.error().code, ErrorCode::kInvalidArgument);
  EXPECT_THAT(all.error().message, HasSubstr("numbered as in a mirror"));
}

TEST(LensCalibration, ABoardOfAnotherSizeIsRefused) {
  const TrueLens lens;
  const auto board = largeBoard();
  const auto views = syntheticViews(lens, board, {});
  // Said to be smaller than the corners' numbers.
  BoardGeometry smaller = board;
  smaller.columns = 12;
  const auto outside = calibrate(lens, views, smaller, solveOnly());
  ASSERT_FALSE(outside);
  EXPECT_EQ(outside.error().code, ErrorCode::kInvalidArgument);
  EXPECT_THAT(outside.error().message, HasSubstr("give the board's true size"));
  // 14 x 10 corners numbered as if there were 10 x 14.
  auto scrambled = views;
  for (auto& view : scrambled) {
    for (auto& corner : view.corners) {
      const int index = corner.row * board.columns + corner.column;
      corner.column = index % board.rows;
      corner.row = index / board.rows;
    }
  }
  BoardGeometry turned = board;
  std::swap(turned.columns, turned.rows);
  const auto wrong = calibrate(lens, scrambled, turned, solveOnly());
  ASSERT_FALSE(wrong);
  EXPECT_EQ(wrong.error().code, ErrorCode::kInvalidArgument);
  EXPECT_THAT(wrong.error().message, HasSubstr("check that the board really has 10 x 14"));
}

TEST(LensCalibration, SquaresThatAreNoSquaresAreRefused) {
  const TrueLens lens;
  BoardGeometry board = largeBoard();
  // Every second row only, as when a taller board is taken for this one.
  auto views = syntheticViews(lens, board, {});
  for (auto& view : views) {
    std::erase_if(view.corners, [](const BoardCorner& corner) { return corner.row % 2 == 1; });
    for (auto& corner : view.corners) corner.row /= 2;
  }
  board.rows = 5;
  const auto result = calibrate(lens, views, board, solveOnly());
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kInvalidArgument);
  EXPECT_THAT(result.error().message, HasSubstr("2.00"));
  EXPECT_THAT(result.error().message, HasSubstr("times as high as they are wide"));
}

TEST(LensCalibration, TooLittleToGoByIsRefusedWithWhatToDo) {
  const TrueLens lens;
  const auto board = largeBoard();
  const auto views = syntheticViews(lens, board, {});
  const auto refused = [&](std::span<const BoardView> some) {
    const auto result = calibrate(lens, some, board, solveOnly());
    EXPECT_FALSE(result);
    if (result) return std::string();
    EXPECT_EQ(result.error().code, ErrorCode::kInvalidArgument);
    EXPECT_EQ(result.error().message.find('\n'), std::string::npos);
    return result.error().message;
  };
  EXPECT_THAT(refused({}), HasSubstr("0 of 0 views can be used, at least 4"));
  EXPECT_THAT(refused(std::span(views).first(1)), HasSubstr("1 of 1 views"));

  // One picture over and over, but for its noise.
  std::vector<BoardView> same;
  std::mt19937 random(2);
  std::normal_distribution<double> noise(0, 0.2);
  for (int i = 0; i < 20; ++i) {
    same.push_back(views[7]);
    for (auto& corner : same.back().corners) corner.pixel += Vector2d(noise(random), noise(random));
  }
  EXPECT_THAT(refused(same), HasSubstr("all alike"));

  // Views that show next to nothing.
  auto few = views;
  for (auto& view : few) view.corners.resize(5);
  EXPECT_THAT(refused(few), HasSubstr("5 corners, at least 6"));
  auto line = views;
  for (auto& view : line) {
    const int row = view.corners.front().row;
    std::erase_if(view.corners, [&](const BoardCorner& corner) { return corner.row != row; });
  }
  EXPECT_THAT(refused(line), HasSubstr("at least 4 are needed"));
}

// Boards that all face a narrow lens: focal length and distance cannot be told apart.
TEST(LensCalibration, BoardsThatAreNeverTiltedAreRefused) {
  const TrueLens lens = narrowLens(1200);
  const auto board = smallBoard();
  std::mt19937 random(3);
  std::normal_distribution<double> noise(0, 0.2);
  std::vector<BoardView> views;
  for (int i = 0; i < 12; ++i) {
    BoardView view;
    view.name = "view " + std::to_string(i);
    for (int row = 0; row < board.rows; ++row) {
      for (int column = 0; column < board.columns; ++column) {
        const Vector3d p(0.02 * column - 0.13 + 0.02 * (i % 3 - 1),
                         0.02 * row - 0.09 + 0.02 * (i / 3 % 3 - 1), 1.0 + 0.1 * (i % 4));
        view.corners.push_back(
            {column, row, lens.project(p) + Vector2d(noise(random), noise(random))});
      }
    }
    views.push_back(std::move(view));
  }
  const auto result = calibrate(lens, views, board, solveOnly());
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kInvalidArgument);
  EXPECT_THAT(result.error().message, HasSubstr("tilt the board"));
}

TEST(LensCalibration, StopsWhenAsked) {
  class Impatient final : public Progress {
   public:
    void update(std::string_view, std::size_t, std::size_t) override {}
    void warn(std::string_view) override {}
    bool cancelled() const override { return true; }
  } progress;
  const TrueLens lens;
  const auto views = syntheticViews(lens, largeBoard(), {});
  const auto result = calibrateLens(views, largeBoard(), lens.width, lens.height, {}, progress);
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kCancelled);
}

TEST(LensCalibration, TheSameInputGivesTheSameLens) {
  const TrueLens lens;
  SceneOptions scene;
  scene.views = 12;
  const auto views = syntheticViews(lens, largeBoard(), scene);
  const auto first = calibrate(lens, views, largeBoard());
  const auto second = calibrate(lens, views, largeBoard());
  ASSERT_TRUE(first && second);
  // Threads sum in any order; 1e-6 px is that.
  EXPECT_LT((first->model->values().vector() - second->model->values().vector()).norm(), 1e-6);
  EXPECT_NEAR(first->splitHalf.rms.degrees(), second->splitHalf.rms.degrees(), 1e-6);
}

}  // namespace
}  // namespace lightsketch
