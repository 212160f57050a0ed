#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>

#include "calibration/lens/lens_calibration.h"
#include "tests/calibration/lens/synthetic_lens.h"

namespace lightsketch {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using ::testing::HasSubstr;

// A 180-degree lens whose equation is written out here: equidistant, no distortion.
constexpr double kFocal = 400;
Vector2d see(const Vector3d& p) {
  const double rho = std::hypot(p.x(), p.y());
  const double d = kFocal * std::atan2(rho, p.z()) / rho;
  return {640 + d * p.x(), 640 + d * p.y()};
}

std::shared_ptr<const FisheyeModel> model() {
  FisheyeParameters f;
  f.width = f.height = 1280;
  f.fx = f.fy = kFocal;
  f.cx = f.cy = 640;
  f.maxFieldAngle = Angle::degrees(110);
  return *FisheyeModel::create(f);
}

BoardGeometry board() {
  BoardGeometry board;
  board.columns = 8;
  board.rows = 6;
  board.spacingMetres = 0.03;
  return board;
}

// A board whose middle lies in direction (theta, phi), 0.4 m away, tilted.
Isometry3d poseAt(double thetaDegrees, double phiDegrees, double tiltDegrees = 25) {
  const double theta = thetaDegrees * kDegree;
  const double phi = phiDegrees * kDegree;
  const Vector3d sight(std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi),
                       std::cos(theta));
  const Vector3d z = Eigen::AngleAxisd(tiltDegrees * kDegree, sight.unitOrthogonal()) * sight;
  Eigen::Matrix3d rotation;
  rotation.col(0) = z.unitOrthogonal();
  rotation.col(1) = z.cross(rotation.col(0));
  rotation.col(2) = z;
  Isometry3d pose = Isometry3d::Identity();
  pose.linear() = rotation;
  pose.translation() = 0.4 * sight - rotation * Vector3d(0.105, 0.075, 0);
  return pose;
}

BoardView viewOf(const Isometry3d& pose, double noise = 0, unsigned seed = 1) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal(0, 1);
  BoardView view;
  view.name = "board.png";
  for (int row = 0; row < 6; ++row) {
    for (int column = 0; column < 8; ++column) {
      const Vector2d error(normal(random), normal(random));
      view.corners.push_back(
          {column, row, see(pose * Vector3d(0.03 * column, 0.03 * row, 0)) + noise * error});
    }
  }
  return view;
}

TEST(BoardPose, FindsTheTruePoseAllOverTheFieldAndBeyondTheHemisphere) {
  for (const double theta : {0.0, 30.0, 60.0, 92.0}) {
    for (const double phi : {0.0, 130.0, 250.0}) {
      const auto truth = poseAt(theta, phi);
      const auto pose = boardPose(*model(), viewOf(truth), board());
      ASSERT_TRUE(pose) << pose.error().message;
      // Exact corners: only rounding and the end of the iteration are left.
      EXPECT_LT((pose->cameraFromBoard.matrix() - truth.matrix()).norm(), 1e-7) << theta;
      EXPECT_LT(pose->residualPixels, 1e-5);
    }
  }
}

// (w, dt)' C^-1 (w, dt) is chi squared of 6 degrees of freedom: mean 6, and the mean of 200 draws
// lies within 0.25 (one sigma, sqrt(12 / 200)) of it.
TEST(BoardPose, KnowsHowUncertainItIs) {
  const auto truth = poseAt(60, 40);
  double sum = 0;
  constexpr int kDraws = 200;
  for (unsigned seed = 1; seed <= kDraws; ++seed) {
    const auto pose = boardPose(*model(), viewOf(truth, 0.1, seed), board());
    ASSERT_TRUE(pose) << pose.error().message;
    const Eigen::AngleAxisd turn(truth.linear() * pose->cameraFromBoard.linear().transpose());
    Eigen::Matrix<double, 6, 1> off;
    off << turn.angle() * turn.axis(), truth.translation() - pose->cameraFromBoard.translation();
    sum += off.dot(pose->covariance.ldlt().solve(off));
  }
  EXPECT_NEAR(sum / kDraws, 6, 1.2);  // 4 sigma, and the variance itself is an estimate
}

TEST(BoardPose, OneWrongCornerHardlyMatters) {
  const auto truth = poseAt(40, 200);
  auto view = viewOf(truth, 0.1);
  view.corners[20].pixel += Vector2d(9, -6);
  const auto pose = boardPose(*model(), view, board());
  ASSERT_TRUE(pose) << pose.error().message;
  // As good as without: a tenth of a pixel is 0.1 mm at 0.4 m.
  EXPECT_LT((pose->cameraFromBoard.translation() - truth.translation()).norm(), 0.001);
}

TEST(BoardPose, ABentBoardIsTakenAsBent) {
  const auto truth = poseAt(50, 70);
  const Vector2d warp(0.002, -0.001);
  BoardView view;
  for (int row = 0; row < 6; ++row) {
    for (int column = 0; column < 8; ++column) {
      const double u = column / 3.5 - 1;
      const double v = row / 2.5 - 1;
      view.corners.push_back(
          {column, row,
           see(truth * Vector3d(0.03 * column, 0.03 * row,
                                warp.x() * (1 - u * u) + warp.y() * (1 - v * v)))});
    }
  }
  const auto bent = boardPose(*model(), view, board(), warp);
  const auto flat = boardPose(*model(), view, board());
  ASSERT_TRUE(bent && flat);
  EXPECT_LT((bent->cameraFromBoard.matrix() - truth.matrix()).norm(), 1e-7);
  EXPECT_GT((flat->cameraFromBoard.matrix() - truth.matrix()).norm(), 1e-3);
}

// A long lens sees a small board nearly in parallel projection: tilts by +a and -a look alike.
TEST(BoardPose, ANarrowLensIsNotFooledByTheTiltTheOtherWay) {
  FisheyeParameters f;
  f.width = 640;
  f.height = 480;
  f.fx = f.fy = 3000;
  f.cx = 320;
  f.cy = 240;
  f.maxFieldAngle = Angle::degrees(9);
  const auto narrow = *FisheyeModel::create(f);
  std::mt19937 random(4);
  std::normal_distribution<double> normal(0, 0.05);
  int right = 0;
  for (int i = 0; i < 20; ++i) {
    Isometry3d truth = poseAt(1.5, 18 * i, 35);
    truth.translation() += 2.2 * (truth * Vector3d(0.105, 0.075, 0)).normalized();
    BoardView view;
    for (int row = 0; row < 6; ++row) {
      for (int column = 0; column < 8; ++column) {
        const Vector3d p = truth * Vector3d(0.03 * column, 0.03 * row, 0);
        const double rho = std::hypot(p.x(), p.y());
        const double d = 3000 * std::atan2(rho, p.z()) / rho;
        view.corners.push_back(
            {column, row,
             Vector2d(320 + d * p.x() + normal(random), 240 + d * p.y() + normal(random))});
      }
    }
    const auto pose = boardPose(*narrow, view, board());
    ASSERT_TRUE(pose) << pose.error().message;
    right +=
        pose->cameraFromBoard.linear().col(2).dot(truth.linear().col(2)) > std::cos(10 * kDegree);
  }
  EXPECT_EQ(right, 20);
}

TEST(BoardPose, RefusesWhatTellsNoPose) {
  auto few = viewOf(poseAt(20, 0));
  few.corners.resize(5);
  const auto five = boardPose(*model(), few, board());
  ASSERT_FALSE(five);
  EXPECT_EQ(five.error().code, ErrorCode::kInvalidArgument);
  EXPECT_THAT(five.error().message, HasSubstr("at least 6"));

  auto row = viewOf(poseAt(20, 0));
  row.corners.resize(8);
  const auto line = boardPose(*model(), row, board());
  ASSERT_FALSE(line);
  EXPECT_THAT(line.error().message, HasSubstr("on a line"));

  auto mirrored = viewOf(poseAt(20, 0));
  for (auto& corner : mirrored.corners) corner.column = 7 - corner.column;
  const auto mirror = boardPose(*model(), mirrored, board());
  ASSERT_FALSE(mirror);
  EXPECT_THAT(mirror.error().message, HasSubstr("mirror"));

  auto larger = viewOf(poseAt(20, 0));
  larger.corners.front().column = 8;
  const auto outside = boardPose(*model(), larger, board());
  ASSERT_FALSE(outside);
  EXPECT_THAT(outside.error().message, HasSubstr("true size"));
}

}  // namespace
}  // namespace lightsketch
