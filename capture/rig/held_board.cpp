#include "capture/rig/held_board.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <opencv2/aruco/charuco.hpp>

#include "capture/frame/vectorise.h"

namespace lightsketch {
namespace {

using Eigen::Isometry3d;
using Eigen::Quaterniond;
using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kFlatSeconds = 6;  // as long as it takes to tell the program that it lies
constexpr float kPaper = 0.85f, kInk = 0.04f, kBack = 0.10f;

const std::map<std::string, int, std::less<>> kDictionaries = {
    {"DICT_4X4_50", cv::aruco::DICT_4X4_50},   {"DICT_4X4_100", cv::aruco::DICT_4X4_100},
    {"DICT_4X4_250", cv::aruco::DICT_4X4_250}, {"DICT_5X5_100", cv::aruco::DICT_5X5_100},
    {"DICT_5X5_250", cv::aruco::DICT_5X5_250}, {"DICT_5X5_1000", cv::aruco::DICT_5X5_1000},
    {"DICT_6X6_250", cv::aruco::DICT_6X6_250}, {"DICT_6X6_1000", cv::aruco::DICT_6X6_1000}};

// Patches of the print, all convex: the four sides of the margin, then per square the black square
// or the four sides around its marker, and the marker's modules.
constexpr int kMarginPatches = 4, kFirstModule = 5, kPatchesPerSquare = 128;

Vector3d spherical(double theta, double azimuth) {
  return {std::sin(theta) * std::cos(azimuth), std::sin(theta) * std::sin(azimuth),
          std::cos(theta)};
}

// `direction`, tilted by an angle towards the side that `azimuth` names.
Vector3d tilted(const Vector3d& direction, double angle, double azimuth) {
  const Vector3d u = direction.unitOrthogonal(), v = direction.cross(u);
  return std::cos(angle) * direction +
         std::sin(angle) * (std::cos(azimuth) * u + std::sin(azimuth) * v);
}

}  // namespace

double workLight(const Vector3d& position, const Vector3d& normal) {
  // A big soft box to the viewer's right, and what the ceiling gives back of it.
  constexpr double kStrength = 0.42, kDirected = 0.38, kReference = 1.75;
  const Vector3d to = Vector3d(0.5, -0.9, 1.45) - position;
  const double distance = to.norm();
  return kStrength * ((1 - kDirected) + kDirected * std::max(0.0, normal.dot(to) / distance)) *
         kReference / distance;
}

Result<HeldBoard> HeldBoard::create(const RigBoard& board, const BoardAudience& audience) {
  const auto dictionary = kDictionaries.find(board.dictionary);
  const int squares = (board.columns + 1) * (board.rows + 1);
  if (board.columns < 2 || board.rows < 2 || squares > 1000 || !(board.spacingMetres > 0.005) ||
      !(board.spacingMetres < 0.1) || !(board.markerFraction > 0.3) ||
      !(board.markerFraction < 0.95) || dictionary == kDictionaries.end()) {
    return failure(
        ErrorCode::kInvalidArgument,
        "simulated rig: a board of {} x {} corners, {} m apart, marker share {}, {}: give "
        "2 or more corners each way, 5 to 100 mm, 0.3 to 0.95, a dictionary such as "
        "DICT_5X5_250",
        board.columns, board.rows, board.spacingMetres, board.markerFraction, board.dictionary);
  }
  HeldBoard held;
  held.board_ = board;
  // The markers' bits, in the order in which OpenCV numbers the white squares.
  try {
    const auto markers = cv::aruco::getPredefinedDictionary(dictionary->second);
    if (squares / 2 > markers->bytesList.rows) {
      return failure(ErrorCode::kInvalidArgument,
                     "simulated rig: {} has too few markers for {} squares", board.dictionary,
                     squares);
    }
    held.bits_ = markers->markerSize;
    int id = 0;
    for (int row = 0; row <= board.rows; ++row) {
      for (int column = 0; column <= board.columns; ++column) {
        std::uint64_t bits = 0;
        if ((row + column) % 2 == 1) {  // the square in the corner is black
          cv::Mat picture;
          const int side = held.bits_ + 2;
          cv::aruco::drawMarker(markers, id++, side, picture, 1);
          for (int y = 0; y < side; ++y) {
            for (int x = 0; x < side; ++x) {
              if (picture.at<std::uint8_t>(y, x) != 0) bits |= std::uint64_t{1} << (y * side + x);
            }
          }
        }
        held.markers_.push_back(bits);
      }
    }
  } catch (const cv::Exception& e) {
    return failure(ErrorCode::kInvalidArgument, "simulated rig: cannot draw the board: {}", e.err);
  }
  held.showTo(audience);
  return held;
}

// --- The print --------------------------------------------------------------------------------

Vector3d HeldBoard::surface(double x, double y) const {
  const double s = board_.spacingMetres;
  // Beyond the paper the bend ends, so that rays that miss stay well-behaved.
  const double u = std::clamp(2 * x / (s * (board_.columns - 1)) - 1, -1.7, 1.7);
  const double v = std::clamp(2 * y / (s * (board_.rows - 1)) - 1, -1.7, 1.7);
  return {x, y, board_.warpMetres.x() * (1 - u * u) + board_.warpMetres.y() * (1 - v * v)};
}

Vector3d HeldBoard::corner(int column, int row) const {
  return surface(column * board_.spacingMetres, row * board_.spacingMetres);
}

int HeldBoard::patch(float x, float y) const {
  const auto s = static_cast<float>(board_.spacingMetres);
  const auto margin = static_cast<float>(board_.marginMetres);
  const float across = x + s, down = y + s;  // from the first square's outer corner
  const float width = s * static_cast<float>(board_.columns + 1);
  const float height = s * static_cast<float>(board_.rows + 1);
  if (!(across > -margin && down > -margin && across < width + margin && down < height + margin)) {
    return -1;
  }
  if (across < 0) return 0;
  if (across >= width) return 1;
  if (down < 0) return 2;
  if (down >= height) return 3;
  const float inverse = 1 / s;
  const float u = across * inverse, v = down * inverse;
  const int column = std::min(static_cast<int>(u), board_.columns);
  const int row = std::min(static_cast<int>(v), board_.rows);
  const int square = row * (board_.columns + 1) + column;
  const int base = kMarginPatches + kPatchesPerSquare * square;
  if ((row + column) % 2 == 0) return base;
  const auto fraction = static_cast<float>(board_.markerFraction);
  const float scale = static_cast<float>(bits_ + 2) / fraction;
  const float mu = (u - static_cast<float>(column) - 0.5f * (1 - fraction)) * scale;
  const float mv = (v - static_cast<float>(row) - 0.5f * (1 - fraction)) * scale;
  const int side = bits_ + 2;
  if (mu < 0) return base + 1;
  if (mu >= static_cast<float>(side)) return base + 2;
  if (mv < 0) return base + 3;
  if (mv >= static_cast<float>(side)) return base + 4;
  return base + kFirstModule + static_cast<int>(mv) * side + static_cast<int>(mu);
}

float HeldBoard::reflectance(float x, float y) const {
  const int number = patch(x, y);
  if (number < 0) return -1;
  if (number < kMarginPatches) return kPaper;
  const auto square = static_cast<std::size_t>((number - kMarginPatches) / kPatchesPerSquare);
  const int inside = (number - kMarginPatches) % kPatchesPerSquare;
  if (inside == 0) return kInk;
  if (inside < kFirstModule) return kPaper;
  return (markers_[square] >> (inside - kFirstModule) & 1) != 0 ? kPaper : kInk;
}

// --- The way ----------------------------------------------------------------------------------

Isometry3d HeldBoard::poseOf(const Quaterniond& rotation, const Vector3d& centre) const {
  Isometry3d pose = Isometry3d::Identity();
  pose.linear() = rotation.toRotationMatrix();
  const double s = board_.spacingMetres;
  pose.translation() = centre - pose.linear() * Vector3d(0.5 * s * (board_.columns - 1),
                                                         0.5 * s * (board_.rows - 1), 0);
  return pose;
}

// A stop with the front towards `front` and the print's top towards `up`, then rolled.
HeldBoard::Stop HeldBoard::stopAt(const Vector3d& centre, const Vector3d& front, const Vector3d& up,
                                  double rollDegrees, double tableHeight,
                                  std::optional<double> standingAt) const {
  Eigen::Matrix3d rotation;
  rotation.col(2) = -front.normalized();
  rotation.col(1) = -(up - up.dot(rotation.col(2)) * rotation.col(2)).normalized();
  rotation.col(0) = rotation.col(1).cross(rotation.col(2));
  rotation = rotation * Eigen::AngleAxisd(rollDegrees * kDegree, Vector3d::UnitZ());

  Stop stop{Quaterniond(rotation), centre};
  const Isometry3d pose = poseOf(stop.rotation, centre);
  const double s = board_.spacingMetres, m = board_.marginMetres;
  double lowest = std::numeric_limits<double>::max();
  for (const double a : {0.0, 0.5, 1.0}) {
    for (const double b : {0.0, 0.5, 1.0}) {
      const Vector3d p = surface(-s - m + a * (s * (board_.columns + 1) + 2 * m),
                                 -s - m + b * (s * (board_.rows + 1) + 2 * m));
      lowest = std::min(lowest, (pose * p).z());
    }
  }
  constexpr double kClear = 0.0005;
  const double lift = tableHeight + kClear + standingAt.value_or(0) - lowest;
  if (standingAt || lift > 0) stop.centre.z() += lift;
  return stop;
}

void HeldBoard::add(Stop stop, std::optional<double> seconds) {
  if (!stops_.empty()) {
    const double way = (stop.centre - stops_.back().centre).norm() +
                       0.12 * stop.rotation.angularDistance(stops_.back().rotation);
    stop.arriveSeconds = stops_.back().leaveSeconds + 0.3 + 0.5 * way;
  }
  stop.leaveSeconds = stop.arriveSeconds + seconds.value_or(board_.stillSeconds);
  stops_.push_back(stop);
}

void HeldBoard::showTo(const BoardAudience& audience) {
  const double table = audience.tableHeight;
  // Before every source camera: the middle, rings around it, then standing on the table around the
  // camera, which is the only way to bring corners to the rim of a field that ends at the table.
  for (const Isometry3d& camera : audience.sceneFromSources) {
    const Vector3d eye = camera.translation();
    const auto show = [&](double theta, double azimuth, double distance, double tilt, double tiltTo,
                          double roll) {
      const Vector3d direction = camera.linear() * spherical(theta * kDegree, azimuth * kDegree);
      add(stopAt(eye + distance * direction, tilted(-direction, tilt * kDegree, tiltTo * kDegree),
                 camera.linear() * Vector3d(0.1, -1, 0.05), roll, table));
    };
    show(4, 0, 0.30, 5, 0, 0);
    show(8, 120, 0.25, 35, 40, 90);
    show(6, 250, 0.36, 40, 160, 20);
    show(10, 30, 0.40, 38, 280, -60);
    show(5, 200, 0.60, 10, 90, 5);
    for (int i = 0; i < 6; ++i) {
      show(32, 60 * i + 15, i % 2 == 0 ? 0.27 : 0.36, 12 + 6 * (i % 4), 75 * i, 55 * i);
    }
    for (int i = 0; i < 9; ++i) {
      show(58, 40 * i, 0.24 + 0.04 * (i % 3), 8 + 8 * (i % 4), 100 * i + 30, 90 * (i % 2) + 8 * i);
    }
    // Standing: the lean is from upright, its top away from the camera. Held at several heights, so
    // that some row of corners comes to lie just inside the rim everywhere.
    const auto stand = [&](double azimuth, double distance, double lean, double roll,
                           double height) {
      const Vector3d outward(std::cos(azimuth * kDegree), std::sin(azimuth * kDegree), 0);
      const Vector3d front =
          -std::cos(lean * kDegree) * outward + std::sin(lean * kDegree) * Vector3d::UnitZ();
      add(stopAt(eye + distance * outward, front, Vector3d::UnitZ(), roll, table, height));
    };
    for (int i = 0; i < 12; ++i) {
      stand(30 * i, 0.19 + 0.03 * (i % 3), i % 2 == 0 ? 15 : -14, i % 4 == 3 ? 90 : 0,
            0.008 * (i % 4));
    }
    for (int i = 0; i < 6; ++i) stand(60 * i + 12, 0.21, 30, 0, 0.010 * (i % 3));
    // Where the camera, tilted, looks below its own height, only a board that leans close by gets
    // its corners low enough.
    const double low = std::atan2(camera(1, 2), camera(0, 2)) / kDegree;
    for (int i = 0; i < 7; ++i) stand(low + 28 * (i - 3), 0.17 + 0.01 * (i % 2), 38, 0, 0);
  }

  // Before the scene camera, which only ever sees a part of it.
  const Isometry3d& scene = audience.sceneFromSceneCamera;
  const Vector3d eye = scene.translation(), axis = scene.linear().col(2);
  constexpr std::array<std::array<double, 2>, 5> kOffsets = {
      {{0, 0}, {0.12, 0.08}, {-0.12, 0.08}, {-0.12, -0.08}, {0.12, -0.08}}};
  for (int i = 0; i < 12; ++i) {
    const auto& offset = kOffsets[static_cast<std::size_t>(i % 5)];
    const double distance = 0.34 + 0.035 * (i % 4);
    add(stopAt(eye + distance * (axis + offset[0] * scene.linear().col(0) +
                                 offset[1] * scene.linear().col(1)),
               tilted(-axis, (8 + 5 * (i % 7)) * kDegree, 75 * i * kDegree), -scene.linear().col(1),
               90 * (i % 3) + 10 * i, table));
  }
  for (const Isometry3d& camera : audience.sceneFromSources) showToBoth(audience, camera);

  // Flat on the table at the subject.
  add(stopAt(Vector3d(0, 0, table), Vector3d::UnitZ(), Vector3d::UnitY(), 0, table, 0.0),
      kFlatSeconds);
  add(stopAt(Vector3d(0.01, 0.01, table), Vector3d::UnitZ(), Vector3d::UnitY(), 25, table, 0.0));
}

// Where the scene camera and a source camera both see the front well. They look at it from opposite
// sides, so few places will do: the best of many, some way apart.
void HeldBoard::showToBoth(const BoardAudience& audience, const Isometry3d& source) {
  const Vector3d sceneEye = audience.sceneFromSceneCamera.translation();
  const Vector3d sourceEye = source.translation();
  const Vector3d away = -Vector3d(sourceEye.x(), sourceEye.y(), 0).normalized();
  const Vector3d aside(-away.y(), away.x(), 0);
  constexpr double kSteepest = 0.40;  // least cosine of incidence at which markers can be read
  constexpr double kField = 89 * kDegree;
  const auto score = [&](const Stop& stop) {
    const Isometry3d pose = poseOf(stop.rotation, stop.centre);
    const Vector3d front = -pose.linear().col(2);
    int byScene = 0, bySource = 0;
    for (int row = 0; row < board_.rows; ++row) {
      for (int column = 0; column < board_.columns; ++column) {
        const Vector3d p = pose * corner(column, row);
        const Vector3d inScene = audience.sceneFromSceneCamera.inverse() * p;
        const Vector3d inSource = source.inverse() * p;
        const Vector3d tangents = inScene / inScene.z();
        byScene += std::abs(tangents.x()) < audience.sceneHalfField.x() &&
                   std::abs(tangents.y()) < audience.sceneHalfField.y() &&
                   front.dot((sceneEye - p).normalized()) > kSteepest;
        bySource += inSource.z() > std::cos(kField) * inSource.norm() && inSource.norm() > 0.08 &&
                    front.dot((sourceEye - p).normalized()) > kSteepest;
      }
    }
    return std::min(byScene, bySource);
  };

  std::vector<std::pair<int, Stop>> candidates;
  for (int i = 0; i < 1200; ++i) {
    const double out = 0.015 * (i % 5), side = 0.03 * (i / 5 % 4) - 0.03;
    const double up = 0.02 + 0.02 * (i / 20 % 4), weight = 0.6 + 0.25 * (i / 80 % 5);
    const double roll = 60 * (i / 400) + 7.0 * (i % 7);
    const Vector3d centre = out * away + side * aside + Vector3d(0, 0, up);
    const Vector3d middle =
        (sceneEye - centre).normalized() + weight * (sourceEye - centre).normalized();
    const Stop stop = stopAt(centre, middle, Vector3d::UnitY(), roll, audience.tableHeight);
    candidates.emplace_back(score(stop), stop);
  }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const auto& a, const auto& b) { return a.first > b.first; });
  constexpr std::size_t kStops = 11;
  std::vector<Stop> chosen;
  for (const auto& [points, stop] : candidates) {
    const bool apart = std::none_of(chosen.begin(), chosen.end(), [&s = stop](const Stop& c) {
      return (c.centre - s.centre).norm() + 0.1 * c.rotation.angularDistance(s.rotation) < 0.035;
    });
    if (apart) chosen.push_back(stop);
    if (chosen.size() == kStops) break;
  }
  for (const Stop& stop : chosen) add(stop);
}

double HeldBoard::periodSeconds() const {
  const double way = (stops_.front().centre - stops_.back().centre).norm();
  return stops_.back().leaveSeconds + 0.5 + 0.6 * way;
}

bool HeldBoard::stillAt(double seconds) const {
  const double t = seconds - std::floor(seconds / periodSeconds()) * periodSeconds();
  return std::any_of(stops_.begin(), stops_.end(),
                     [t](const Stop& s) { return t >= s.arriveSeconds && t <= s.leaveSeconds; });
}

Isometry3d HeldBoard::sceneFromBoardAt(double seconds) const {
  const double period = periodSeconds();
  const double t = seconds - std::floor(seconds / period) * period;
  std::size_t next = 0;
  while (next < stops_.size() && stops_[next].leaveSeconds < t) ++next;
  const Stop& to = stops_[next % stops_.size()];
  if (next < stops_.size() && t >= to.arriveSeconds) return poseOf(to.rotation, to.centre);
  // On its way: least jerk (Flash and Hogan 1985), as hands move.
  const Stop& from = stops_[(next + stops_.size() - 1) % stops_.size()];
  const double arrive = next < stops_.size() ? to.arriveSeconds : period;
  const double f = (t - from.leaveSeconds) / (arrive - from.leaveSeconds);
  const double g = f * f * f * (10 - 15 * f + 6 * f * f);
  return poseOf(from.rotation.slerp(g, to.rotation), (1 - g) * from.centre + g * to.centre);
}

// --- The picture ------------------------------------------------------------------------------

namespace {

constexpr int kTile = 16;
constexpr int kSamples = 32;

struct BoardPoint {
  float x, y;
  int patch;  // of the print; -1: beside the board; kMiss: nowhere
};
constexpr int kMiss = -2;
constexpr BoardPoint kNowhere{0, 0, kMiss};

// Where a ray meets the bent board, board frame. The back is all one patch.
BoardPoint meet(const HeldBoard& board, const Vector3d& origin, const Vector3d& direction) {
  if (std::abs(direction.z()) < 1e-9) return kNowhere;
  double t = -origin.z() / direction.z();
  if (t <= 0) return kNowhere;
  Vector3d p = origin + t * direction;
  if (std::abs(p.x()) > 1 || std::abs(p.y()) > 1) return kNowhere;
  const RigBoard& o = board.options();
  const double hx = 0.5 * o.spacingMetres * (o.columns - 1);
  const double hy = 0.5 * o.spacingMetres * (o.rows - 1);
  for (int i = 0; i < 3; ++i) {
    const double slope = direction.z() +
                         2 * o.warpMetres.x() * (p.x() - hx) / (hx * hx) * direction.x() +
                         2 * o.warpMetres.y() * (p.y() - hy) / (hy * hy) * direction.y();
    if (std::abs(slope) < 1e-9) return kNowhere;
    t -= (p.z() - board.surface(p.x(), p.y()).z()) / slope;
    p = origin + t * direction;
  }
  const auto x = static_cast<float>(p.x()), y = static_cast<float>(p.y());
  const int patch = board.patch(x, y);
  return {x, y, origin.z() < 0 ? patch : std::min(patch, 0)};
}

// A camera in the board's frame at one moment.
struct Eye {
  Vector3d origin;
  Eigen::Matrix3d boardFromScene;
  Eye(const HeldBoard& board, const PixelCornerRays& rays, double seconds) {
    const Isometry3d inverse = board.sceneFromBoardAt(seconds).inverse();
    origin = inverse * rays.eye;
    boardFromScene = inverse.linear();
  }
  BoardPoint meets(const HeldBoard& board, const PixelCornerRays& rays, int x, int y) const {
    const auto i = static_cast<std::size_t>(y) * static_cast<std::size_t>(rays.width + 1) +
                   static_cast<std::size_t>(x);
    return meet(board, origin, boardFromScene * rays.directions[i].cast<double>());
  }
};

// Samples inside a pixel and inside the exposure: Hammersley points, so that an edge along a row or
// a column is placed to a 32nd of a pixel.
struct Samples {
  std::array<float, kSamples> x, y, time;
  Samples() {
    for (unsigned i = 0; i < kSamples; ++i) {
      const auto k = static_cast<std::size_t>(i);
      unsigned reversed = 0;
      for (unsigned bit = 0; bit < 5; ++bit) reversed |= (i >> bit & 1) << (4 - bit);
      x[k] = (static_cast<float>(i) + 0.5f) / kSamples;
      y[k] = (static_cast<float>(reversed) + 0.5f) / kSamples;
      time[k] = (static_cast<float>(i * 13 % kSamples) + 0.5f) / kSamples;
    }
  }
};

LIGHTSKETCH_VECTORISED
void blurLine(const float* in, int taps, const float* kernel, int count, std::ptrdiff_t step,
              float* out) {
  for (int i = 0; i < count; ++i) {
    float sum = kernel[0] * in[i];
    for (int k = 1; k <= taps; ++k) sum += kernel[k] * (in[i + k * step] + in[i - k * step]);
    out[i] = sum;
  }
}

// Separable Gaussian over the layer's bounds; the picture is 0 outside them.
void blur(std::vector<float>& picture, const BoardLayer& layer, int width, double sigma,
          std::vector<float>& scratch) {
  constexpr int kTaps = 4;
  std::array<float, kTaps + 1> kernel;
  double sum = 0;
  for (int k = 0; k <= kTaps; ++k) {
    const double w = std::exp(-0.5 * k * k / (sigma * sigma));
    kernel[static_cast<std::size_t>(k)] = static_cast<float>(w);
    sum += k == 0 ? w : 2 * w;
  }
  for (float& w : kernel) w /= static_cast<float>(sum);
  const int columns = layer.x1 - layer.x0, rows = layer.y1 - layer.y0;
  const int stride = columns + 2 * kTaps;
  scratch.assign(static_cast<std::size_t>(stride) * static_cast<std::size_t>(rows + 2 * kTaps), 0);
  std::vector<float> line(static_cast<std::size_t>(columns));
  const auto at = [&](int row) {
    return scratch.data() + static_cast<std::ptrdiff_t>(row + kTaps) * stride + kTaps;
  };
  const auto source = [&](int row) {
    return picture.data() + static_cast<std::ptrdiff_t>(layer.y0 + row) * width + layer.x0;
  };
  for (int row = 0; row < rows; ++row) std::copy_n(source(row), columns, at(row));
  for (int row = 0; row < rows; ++row) {
    blurLine(at(row), kTaps, kernel.data(), columns, 1, line.data());
    std::copy(line.begin(), line.end(), at(row));
  }
  for (int row = 0; row < rows; ++row) {
    blurLine(at(row), kTaps, kernel.data(), columns, stride, source(row));
  }
}

}  // namespace

void drawBoard(const HeldBoard& board, const PixelCornerRays& rays, double fromSeconds,
               double toSeconds, double blurPixels, BoardLayer& layer) {
  static const Samples samples;
  const int width = rays.width, height = rays.height;
  const auto pixels = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  layer.light.resize(pixels);
  layer.cover.resize(pixels);
  const bool moves =
      !(board.sceneFromBoardAt(fromSeconds).isApprox(board.sceneFromBoardAt(toSeconds), 1e-9));
  const Eye first(board, rays, fromSeconds), last(board, rays, toSeconds);

  // Tiles with the board in them: some corner of theirs or of a neighbour's meets it.
  const int columns = (width + kTile - 1) / kTile, rows = (height + kTile - 1) / kTile;
  std::vector<char> near(static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows), 0);
  int low[2] = {columns, rows}, high[2] = {0, 0};
  for (int row = 0; row <= rows; ++row) {
    for (int column = 0; column <= columns; ++column) {
      const int x = std::min(column * kTile, width), y = std::min(row * kTile, height);
      const auto hits = [&](const Eye& eye) { return eye.meets(board, rays, x, y).patch >= 0; };
      if (!hits(first) && !(moves && hits(last))) continue;
      for (int r = std::max(row - 2, 0); r <= std::min(row + 1, rows - 1); ++r) {
        for (int c = std::max(column - 2, 0); c <= std::min(column + 1, columns - 1); ++c) {
          near[static_cast<std::size_t>(r * columns + c)] = 1;
          low[0] = std::min(low[0], c), high[0] = std::max(high[0], c + 1);
          low[1] = std::min(low[1], r), high[1] = std::max(high[1], r + 1);
        }
      }
    }
  }
  layer.x0 = std::min(low[0] * kTile, width), layer.x1 = std::min(high[0] * kTile, width);
  layer.y0 = std::min(low[1] * kTile, height), layer.y1 = std::min(high[1] * kTile, height);
  if (layer.x0 >= layer.x1 || layer.y0 >= layer.y1) {
    layer.x0 = layer.x1 = layer.y0 = layer.y1 = 0;
    return;
  }
  for (int y = layer.y0; y < layer.y1; ++y) {
    const auto start = static_cast<std::ptrdiff_t>(y) * width;
    std::fill(layer.light.begin() + start + layer.x0, layer.light.begin() + start + layer.x1, 0.0f);
    std::fill(layer.cover.begin() + start + layer.x0, layer.cover.begin() + start + layer.x1, 0.0f);
  }

  // The light on it, linear over the board.
  const Isometry3d pose = board.sceneFromBoardAt(0.5 * (fromSeconds + toSeconds));
  const bool front = first.origin.z() < 0;
  const Vector3d normal = (front ? -1 : 1) * pose.linear().col(2);
  const RigBoard& o = board.options();
  const double endX = o.spacingMetres * o.columns, endY = o.spacingMetres * o.rows;
  const auto light = [&](double x, double y) {
    return workLight(pose * Vector3d(x, y, 0), normal);
  };
  const auto lightHere = static_cast<float>(light(0, 0));
  const auto lightX = static_cast<float>((light(endX, 0) - light(0, 0)) / endX);
  const auto lightY = static_cast<float>((light(0, endY) - light(0, 0)) / endY);

  constexpr std::size_t kSide = kTile + 1;
  std::array<BoardPoint, kSide * kSide> begin, end;
  for (int tile = 0; tile < columns * rows; ++tile) {
    if (!near[static_cast<std::size_t>(tile)]) continue;
    const int left = tile % columns * kTile, top = tile / columns * kTile;
    const int right = std::min(left + kTile, width), bottom = std::min(top + kTile, height);
    for (int y = top; y <= bottom; ++y) {
      for (int x = left; x <= right; ++x) {
        const auto i =
            static_cast<std::size_t>(y - top) * kSide + static_cast<std::size_t>(x - left);
        begin[i] = first.meets(board, rays, x, y);
        end[i] = moves ? last.meets(board, rays, x, y) : begin[i];
      }
    }
    for (int y = top; y < bottom; ++y) {
      for (int x = left; x < right; ++x) {
        const auto i =
            static_cast<std::size_t>(y - top) * kSide + static_cast<std::size_t>(x - left);
        const std::array<BoardPoint, 8> c = {
            begin[i], begin[i + 1], begin[i + kSide], begin[i + kSide + 1],
            end[i],   end[i + 1],   end[i + kSide],   end[i + kSide + 1]};
        if (std::any_of(c.begin(), c.end(), [](const BoardPoint& p) { return p.patch == kMiss; })) {
          continue;
        }
        const auto pixel = static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
                           static_cast<std::size_t>(x);
        float middleX = 0, middleY = 0;
        for (const BoardPoint& p : c) middleX += p.x / 8, middleY += p.y / 8;
        const float lit = lightHere + lightX * middleX + lightY * middleY;
        // All of it in one patch, which is convex.
        const int patch = c[0].patch;
        if (std::all_of(c.begin() + 1, c.end(),
                        [patch](const BoardPoint& p) { return p.patch == patch; })) {
          if (patch < 0) continue;
          layer.cover[pixel] = 1;
          layer.light[pixel] = lit * (front ? board.reflectance(c[0].x, c[0].y) : kBack);
          continue;
        }
        float sum = 0, hits = 0;
        for (std::size_t k = 0; k < kSamples; ++k) {
          const float u = samples.x[k], v = samples.y[k], t = samples.time[k];
          const auto mix = [&](float BoardPoint::*m) {
            const float a = c[0].*m + u * (c[1].*m - c[0].*m);
            const float b = c[2].*m + u * (c[3].*m - c[2].*m);
            const float before = a + v * (b - a);
            if (!moves) return before;
            const float d = c[4].*m + u * (c[5].*m - c[4].*m);
            const float e = c[6].*m + u * (c[7].*m - c[6].*m);
            return before + t * (d + v * (e - d) - before);
          };
          const float reflectance = board.reflectance(mix(&BoardPoint::x), mix(&BoardPoint::y));
          if (reflectance < 0) continue;
          hits += 1;
          sum += front ? reflectance : kBack;
        }
        layer.cover[pixel] = hits / kSamples;
        layer.light[pixel] = lit * sum / kSamples;
      }
    }
  }
  std::vector<float> scratch;
  blur(layer.light, layer, width, blurPixels, scratch);
  blur(layer.cover, layer, width, blurPixels, scratch);
}

}  // namespace lightsketch
