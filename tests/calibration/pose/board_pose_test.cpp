#include "calibration/pose/board_pose.h"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>

#include "tests/calibration/pose/synthetic_ball.h"

namespace lightsketch {
namespace {

using Eigen::Isometry3d;
using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

// A board waved between the subject and the viewer, where the scene camera before it sees its
// front. The source camera stands beside the scene camera, as it must to see the same front.
struct Boards {
  std::shared_ptr<const CameraModel> sceneModel = perspectiveCamera(700);
  std::shared_ptr<const CameraModel> sourceModel = sourceFisheye();
  CameraPose scene = sceneCameraPose();
  CameraPose source;
  BoardPoseOptions options;
  std::vector<BoardMoment> moments;

  explicit Boards(int count, double noise, unsigned seed = 1) {
    options.board.columns = 8;
    options.board.rows = 6;
    options.board.spacingMetres = 0.03;
    options.cornerSigmaPixels = std::max(noise, 0.01);
    source.camera = "source";
    source.sceneFromCamera.linear() =
        Eigen::AngleAxisd(0.3, Vector3d(1, 2, 3).normalized()) * scene.sceneFromCamera.linear();
    source.sceneFromCamera.translation() = Vector3d(0.25, 0.1, 0.9);
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> uniform(-1, 1);
    while (static_cast<int>(moments.size()) < count) {
      Isometry3d board = Isometry3d::Identity();
      board.linear() = Eigen::AngleAxisd(0.6 * uniform(random), Vector3d::UnitX()) *
                       Eigen::AngleAxisd(0.6 * uniform(random), Vector3d::UnitY()) *
                       Eigen::AngleAxisd(0.5 * uniform(random), Vector3d::UnitZ()) *
                       Matrix3d(Vector3d(1, -1, -1).asDiagonal());
      board.translation() = Vector3d(0.15 * uniform(random) - 0.1, 0.1 * uniform(random) + 0.07,
                                     0.1 + 0.15 * uniform(random));
      BoardMoment moment;
      moment.name = "moment " + std::to_string(moments.size());
      moment.scene = view(board, scene, *sceneModel, noise, random);
      moment.sources.push_back(view(board, source, *sourceModel, noise, random));
      if (moment.scene.corners.size() < 30 || moment.sources[0]->corners.size() < 30) continue;
      moments.push_back(moment);
    }
  }

  BoardView view(const Isometry3d& board, const CameraPose& pose, const CameraModel& model,
                 double noise, std::mt19937& random) const {
    std::normal_distribution<double> normal(0, noise);
    BoardView seen;
    for (int row = 0; row < options.board.rows; ++row) {
      for (int column = 0; column < options.board.columns; ++column) {
        const Vector3d corner = board * Vector3d(0.03 * column, 0.03 * row, 0);
        const auto pixel = model.projectPoint(pose.sceneFromCamera.inverse() * corner);
        if (!pixel || pixel->x() < 0 || pixel->y() < 0 || pixel->x() > model.width() ||
            pixel->y() > model.height()) {
          continue;
        }
        seen.corners.push_back({column, row, *pixel + Vector2d(normal(random), normal(random))});
      }
    }
    return seen;
  }

  Result<PoseCalibration> solve() const {
    SilentProgress progress;
    const RigCamera source0{"source", sourceModel.get()};
    return poseFromBoards({"scene", sceneModel.get()}, std::span(&source0, 1), scene, moments,
                          options, progress);
  }
  Eigen::Matrix<double, 6, 1> error(const PoseCalibration& found) const {
    const CameraPose& pose = found.rig.sourceCameras.at(0);
    const Eigen::AngleAxisd turn(
        Matrix3d(pose.sceneFromCamera.linear() * source.sceneFromCamera.linear().transpose()));
    Eigen::Matrix<double, 6, 1> off;
    off << turn.axis() * turn.angle(),
        pose.sceneFromCamera.translation() - source.sceneFromCamera.translation();
    return off;
  }
};

TEST(PoseFromBoards, IsExactWithoutNoise) {
  const Boards boards(6, 0);
  const auto found = boards.solve();
  ASSERT_TRUE(found) << found.error().message;
  EXPECT_LT(boards.error(*found).norm(), 1e-7);
  EXPECT_EQ(found->used, 6);
}

TEST(PoseFromBoards, CovarianceIsHonest) {
  double sum = 0;
  for (unsigned seed = 1; seed <= 12; ++seed) {
    const Boards boards(10, 0.2, seed);
    const auto found = boards.solve();
    ASSERT_TRUE(found) << found.error().message;
    const auto off = boards.error(*found);
    sum += off.dot(found->rig.sourceCameras[0].covariance.inverse() * off) / 6;
    EXPECT_NEAR(found->residualSigmas, 1, 0.1);
    EXPECT_NEAR(found->residualPixels, 0.2 * std::sqrt(2.0), 0.04);
    EXPECT_LT(off.head<3>().norm() * 180 / std::numbers::pi, 0.15);
    EXPECT_LT(off.tail<3>().norm(), 0.002);
  }
  // Chi-square of 72 degrees of freedom over 72: 1 with a sigma of 0.17.
  EXPECT_GT(sum / 12, 0.5);
  EXPECT_LT(sum / 12, 1.7);
}

TEST(PoseFromBoards, ThrowsOutAMomentInWhichTheBoardMoved) {
  Boards boards(10, 0.2, 3);
  // Little: the source camera saw it a tenth of a second later, 5 mm on.
  for (auto& corner : boards.moments[2].sources[0]->corners) corner.pixel += Vector2d(3, -2);
  // Much: quite another moment.
  boards.moments[7].sources[0] = boards.moments[4].sources[0];
  const auto found = boards.solve();
  ASSERT_TRUE(found) << found.error().message;
  EXPECT_NE(found->evidence[2].rejected.find("moved"), std::string::npos)
      << found->evidence[2].rejected;
  EXPECT_NE(found->evidence[7].rejected.find("moved"), std::string::npos)
      << found->evidence[7].rejected;
  EXPECT_EQ(found->used, 8);
  EXPECT_LT(boards.error(*found).tail<3>().norm(), 0.002);
}

TEST(PoseFromBoards, SaysWhatIsWrong) {
  Boards boards(5, 0.2);
  boards.moments.resize(2);
  const auto few = boards.solve();
  ASSERT_FALSE(few);
  EXPECT_NE(few.error().message.find("at least 3"), std::string::npos) << few.error().message;
  boards.options.board.spacingMetres = 0;
  EXPECT_FALSE(boards.solve());
}

TEST(SceneCameraFromFlatBoard, PutsTheOriginInTheBoardsMiddle) {
  const Boards boards(1, 0);
  // Flat in the scene's plane, turned by 20 degrees in it; its middle is the origin.
  Isometry3d board = Isometry3d::Identity();
  board.linear() =
      Eigen::AngleAxisd(0.35, Vector3d::UnitZ()) * Matrix3d(Vector3d(1, -1, -1).asDiagonal());
  board.translation() = -(board.linear() * Vector3d(0.105, 0.075, 0));
  // A camera that looks on it askew.
  CameraPose pose = boards.scene;
  pose.sceneFromCamera = Eigen::AngleAxisd(0.3, Vector3d::UnitX()) * pose.sceneFromCamera;
  std::mt19937 random(1);
  const BoardView view = boards.view(board, pose, *boards.sceneModel, 0, random);
  const auto found = sceneCameraFromFlatBoard({"scene", boards.sceneModel.get()}, view,
                                              boards.options.board, Vector2d::Zero());
  ASSERT_TRUE(found) << found.error().message;
  EXPECT_TRUE(found->sceneFromCamera.isApprox(pose.sceneFromCamera, 1e-6))
      << found->sceneFromCamera.matrix();
  EXPECT_GT(found->covariance.diagonal().minCoeff(), -1e-15);
}

}  // namespace
}  // namespace lightsketch
