// A ChArUco board in somebody's hand: its print, its way past the cameras, and how a camera sees
// it.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "capture/frame/result.h"

namespace lightsketch {

// Board frame: origin in the first inner corner (top left of the print), x along columns, y along
// rows, z into the board, away from whoever looks at its front.
struct RigBoard {
  int columns = 10;  // inner corners; one more square each way
  int rows = 7;
  double spacingMetres = 0.03;
  double markerFraction = 0.75;
  std::string dictionary = "DICT_5X5_250";
  // It is bent: z = x (1 - u^2) + y (1 - v^2), u and v from -1 to 1 over the inner corners.
  Eigen::Vector2d warpMetres{0.0012, -0.0007};
  double marginMetres = 0.005;  // of white paper around the squares
  double stillSeconds = 0.42;   // for which it is held at each stop
};

// Whom the board is shown to.
struct BoardAudience {
  Eigen::Isometry3d sceneFromSceneCamera;
  Eigen::Vector2d sceneHalfField{0.2, 0.15};  // tangents of half its field
  std::vector<Eigen::Isometry3d> sceneFromSources;
  double tableHeight = 0;
};

// Immutable, so thread-safe.
class HeldBoard {
 public:
  static Result<HeldBoard> create(const RigBoard& board, const BoardAudience& audience);

  const RigBoard& options() const { return board_; }
  // The way repeats; it goes from stop to stop, and stays still at each.
  double periodSeconds() const;
  Eigen::Isometry3d sceneFromBoardAt(double seconds) const;
  bool stillAt(double seconds) const;
  // On the bent board, board frame.
  Eigen::Vector3d surface(double x, double y) const;
  Eigen::Vector3d corner(int column, int row) const;
  // Diffuse reflectance of the front, board frame; below 0 beside the board.
  float reflectance(float x, float y) const;
  // Which even, convex patch of the print a point lies in; negative beside the board.
  int patch(float x, float y) const;

 private:
  struct Stop {
    Eigen::Quaterniond rotation;
    Eigen::Vector3d centre;
    double arriveSeconds = 0, leaveSeconds = 0;
  };
  HeldBoard() = default;
  Eigen::Isometry3d poseOf(const Eigen::Quaterniond& rotation, const Eigen::Vector3d& centre) const;
  // `standingAt`: how high above the table its lowest point is held; nothing: only lifted off it.
  Stop stopAt(const Eigen::Vector3d& centre, const Eigen::Vector3d& front,
              const Eigen::Vector3d& up, double rollDegrees, double tableHeight,
              std::optional<double> standingAt = std::nullopt) const;
  void add(Stop stop, std::optional<double> seconds = std::nullopt);
  void showTo(const BoardAudience& audience);
  void showToBoth(const BoardAudience& audience, const Eigen::Isometry3d& source);

  RigBoard board_;
  std::vector<std::uint64_t> markers_;  // bits of each square, 0 where it is black; row by row
  int bits_ = 0;                        // of a marker's side, without its border
  std::vector<Stop> stops_;
};

// A camera's rays through the corners of its pixels, row by row, (width + 1) x (height + 1).
struct PixelCornerRays {
  int width = 0, height = 0;
  Eigen::Vector3d eye = Eigen::Vector3d::Zero();  // scene frame
  std::vector<Eigen::Vector3f> directions;        // scene frame, any length
};

// What the board adds to a picture: picture = picture (1 - cover) + light.
struct BoardLayer {
  int x0 = 0, y0 = 0, x1 = 0, y1 = 0;  // nothing outside
  std::vector<float> light, cover;     // whole pictures; valid inside the bounds only
};

// By the work light, between two moments; blurred by the optics. Rays are cast through the pixels'
// corners and 32 samples per pixel taken between them. Reuses the layer's memory.
void drawBoard(const HeldBoard& board, const PixelCornerRays& rays, double fromSeconds,
               double toSeconds, double blurPixels, BoardLayer& layer);

// The work light that is on while a board is shown, as irradiance / pi on a surface.
double workLight(const Eigen::Vector3d& position, const Eigen::Vector3d& normal);

}  // namespace lightsketch
