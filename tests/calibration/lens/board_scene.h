// A board as a fisheye sees it, rendered for tests: its own lens equation (equidistant, nothing
// else) and cv::aruco's own drawing of ChArUco boards, so that no mistake is shared with what it
// tests.
#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <cstdint>
#include <opencv2/aruco/charuco.hpp>
#include <opencv2/core.hpp>
#include <random>

#include "calibration/lens/board.h"
#include "capture/frame/image.h"

namespace lightsketch {

struct EquidistantLens {
  int width = 800;
  int height = 800;
  double focal = 230;
  double cx = 402;  // our pixels: the top-left pixel's centre is (0.5, 0.5)
  double cy = 398;

  Eigen::Vector2d project(const Eigen::Vector3d& p) const {
    const double r = std::hypot(p.x(), p.y());
    const double d = focal * std::atan2(r, p.z());
    return {cx + d * p.x() / r, cy + d * p.y() / r};
  }
  Eigen::Vector3d ray(double x, double y) const {
    const double dx = (x - cx) / focal;
    const double dy = (y - cy) / focal;
    const double theta = std::hypot(dx, dy);
    if (theta < 1e-12) return {0, 0, 1};
    return {std::sin(theta) * dx / theta, std::sin(theta) * dy / theta, std::cos(theta)};
  }
};

class BoardScene {
 public:
  explicit BoardScene(const BoardGeometry& board) : board_(board) {
    if (board.kind != BoardGeometry::Kind::kCharuco) return;
    const auto dictionary = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_5X5_250);
    const auto charuco =
        cv::aruco::CharucoBoard::create(board.columns + 1, board.rows + 1, 1.0f,
                                        static_cast<float>(board.markerFraction), dictionary);
    charuco->draw({(board.columns + 1) * kSquare, (board.rows + 1) * kSquare}, drawing_, 0, 1);
  }

  // Reflectance 0..1 at a point of the board plane in squares from the printed area's corner;
  // half a square of white paper around it, darkness beyond.
  double at(double x, double y) const {
    const double paper = margin;
    if (x < -paper || y < -paper || x > board_.columns + 1 + paper || y > board_.rows + 1 + paper) {
      return 0.35;
    }
    if (x < 0 || y < 0 || x >= board_.columns + 1 || y >= board_.rows + 1) return 0.9;
    if (drawing_.empty()) {
      return (static_cast<int>(x) + static_cast<int>(y)) % 2 == 0 ? 0.05 : 0.9;
    }
    return drawing_.at<std::uint8_t>(static_cast<int>(y * kSquare), static_cast<int>(x * kSquare))
               ? 0.9
               : 0.05;
  }

  Image<std::uint8_t> render(const EquidistantLens& lens, const Eigen::Isometry3d& cameraFromBoard,
                             double noise = 2, unsigned seed = 1) const {
    const Eigen::Isometry3d boardFromCamera = cameraFromBoard.inverse();
    std::mt19937 random(seed);
    std::normal_distribution<double> grain(0, noise);
    Image<std::uint8_t> image(lens.width, lens.height, 1);
    constexpr int kSub = 4;
    for (int y = 0; y < lens.height; ++y) {
      for (int x = 0; x < lens.width; ++x) {
        double sum = 0;
        for (int i = 0; i < kSub * kSub; ++i) {
          const Eigen::Vector3d ray =
              lens.ray(x + (i % kSub + 0.5) / kSub, y + (i / kSub + 0.5) / kSub);
          const Eigen::Vector3d direction = boardFromCamera.linear() * ray;
          const Eigen::Vector3d origin = boardFromCamera.translation();
          const double t = -origin.z() / direction.z();
          double value = 0.35;
          if (t > 0) {
            const Eigen::Vector3d hit = origin + t * direction;
            value = at(hit.x() / board_.spacingMetres + 1, hit.y() / board_.spacingMetres + 1);
          }
          sum += value;
        }
        const double level = 230 * sum / (kSub * kSub) + 10 + grain(random);
        image(x, y) = static_cast<std::uint8_t>(std::clamp(level + 0.5, 0.0, 255.0));
      }
    }
    return image;
  }

  double margin = 0.6;  // paper around the board, squares

 private:
  static constexpr int kSquare =
      80;  // pixels of the drawing; a multiple of 16 keeps marker bits whole
  BoardGeometry board_;
  cv::Mat drawing_;
};

// The board's centre at `distance` along a direction, its front turned towards the camera, then
// turned by `roll` about its normal and tilted.
inline Eigen::Isometry3d boardTowards(const BoardGeometry& board, double azimuth, double fieldAngle,
                                      double distance, double roll, double tilt = 0.2) {
  const Eigen::Vector3d direction(std::sin(fieldAngle) * std::cos(azimuth),
                                  std::sin(fieldAngle) * std::sin(azimuth), std::cos(fieldAngle));
  const Eigen::Quaterniond facing =
      Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), direction);
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.linear() = (facing * Eigen::AngleAxisd(tilt, Eigen::Vector3d::UnitX()) *
                   Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitZ()))
                      .toRotationMatrix();
  pose.translation() = distance * direction -
                       pose.linear() * (0.5 * board.spacingMetres *
                                        Eigen::Vector3d(board.columns - 1, board.rows - 1, 0));
  return pose;
}

}  // namespace lightsketch
