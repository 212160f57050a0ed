#include "capture/rig/source_view.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>

#include "capture/frame/vectorise.h"
#include "capture/rig/noise.h"
#include "capture/rig/parallel.h"

namespace lightsketch {
namespace {

using Eigen::Isometry3d;
using Eigen::Matrix2d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr int kSize = SourceView::kSize;
constexpr int kCell = 4;  // pixels between the nodes of the coarse grids
constexpr int kNodes = kSize / kCell + 1;

// The bulb's own radiance, so that a white surface facing it at 0.9 m has radiance 1.
constexpr double kLampRadiance =
    kLampDistanceMetres * kLampDistanceMetres / (kLampRadiusMetres * kLampRadiusMetres);

// Point spread: the optics' blur, and the part of the light that scatters into a halo.
constexpr double kBlurPixels = 0.8;
constexpr double kHaloShare = 5e-4, kHaloPixels = 9;     // Gaussian
constexpr double kVeilShare = 2.5e-4, kVeilPixels = 14;  // (1 + r^2 / s^2)^-2, integral pi s^2
constexpr double kGhostShare = 3e-6, kGhostPixels = 9;   // lens reflection, mirrored at the centre
constexpr int kGlareReach = 130;                         // pixels

constexpr double kHandRadius = 0.05;  // metres
constexpr double kHandBehind = 0.16;  // the lamp sits on a short stick
constexpr double kTableGloss = 0.12;  // of the Fresnel reflectance is left in the mirror direction

// Cuts the light that goes backwards, away from the scene: the bulb sits in a shade.
double emission(const Vector3d& fromLamp, const Vector3d& lampPosition) {
  const double cosine = -fromLamp.normalized().dot(lampPosition.normalized());
  const double t = std::clamp((cosine + 0.30) / 0.45, 0.0, 1.0);
  return 0.02 + 0.98 * t * t * (3 - 2 * t);
}

double schlick(double reflectance, double cosine) {
  return reflectance + (1 - reflectance) * std::pow(1 - std::clamp(cosine, 0.0, 1.0), 5);
}

// Relative illumination towards the rim of the field.
float vignetting(double theta) {
  return static_cast<float>(1 - 0.5 * std::pow(theta / FisheyeLens::kMaxFieldAngle.radians(), 3.0));
}

LIGHTSKETCH_VECTORISED
void addWallLight(const float* __restrict still, const float* __restrict albedo,
                  const float* __restrict above, const float* __restrict below, float fraction,
                  float* __restrict out) {
  for (int cell = 0; cell < kNodes - 1; ++cell) {
    const float left = above[cell] + fraction * (below[cell] - above[cell]);
    const float right = above[cell + 1] + fraction * (below[cell + 1] - above[cell + 1]);
    for (int i = 0; i < kCell; ++i) {
      const float light = left + (right - left) * (static_cast<float>(i) + 0.5f) / kCell;
      const int x = cell * kCell + i;
      out[x] = still[x] + albedo[x] * light;
    }
  }
}

LIGHTSKETCH_VECTORISED
void scale(const float* __restrict in, float factor, std::size_t count, float* __restrict out) {
  for (std::size_t i = 0; i < count; ++i) out[i] = factor * in[i];
}

// A luminous disk as the lens draws it: centre, and the map from the unit disk to pixels.
struct Disk {
  Vector2d centre;
  Matrix2d axes;
  double area() const { return std::numbers::pi * std::abs(axes.determinant()); }
};

std::optional<Disk> project(const FisheyeLens& lens, const Vector3d& inCamera, double radius) {
  const auto centre = lens.project(inCamera);
  if (!centre) return std::nullopt;
  const double distance = inCamera.norm();
  const Vector3d direction = inCamera / distance;
  const Vector3d u = direction.unitOrthogonal();
  return Disk{*centre, lens.jacobian(direction, u, direction.cross(u)) * (radius / distance)};
}

// What the coarse grid knows of the surface seen at each node.
struct Node {
  Vector3f position, normal;
  bool seen = false;
};

}  // namespace

namespace {

SourceSeat seatAt(const FisheyeLensShape& lens, const Vector3d& place, double tiltDegrees,
                  const Vector3d& tiltAxis, double twistDegrees) {
  constexpr double kDegree = std::numbers::pi / 180;
  SourceSeat seat{lens, Isometry3d::Identity()};
  seat.sceneFromCamera.translation() = place;
  seat.sceneFromCamera.linear() = (Eigen::AngleAxisd(tiltDegrees * kDegree, tiltAxis.normalized()) *
                                   Eigen::AngleAxisd(twistDegrees * kDegree, Vector3d::UnitZ()))
                                      .toRotationMatrix();
  return seat;
}

}  // namespace

SourceSeat firstSourceSeat() {
  return seatAt(kFirstLens, {0.122, -0.012, 0.012}, 5, {0.55, 0.83, 0}, 3);
}
SourceSeat secondSourceSeat() {
  return seatAt(kSecondLens, {-0.165, 0.075, 0.010}, 4, {-0.3, -0.95, 0}, -7);
}

// What stands still under the room's own light.
struct SourceView::Tableau {
  explicit Tableau(std::shared_ptr<const StillLife> things)
      : stillLife(std::move(things)),
        still(kPixels),
        albedo(kPixels),
        open(kPixels),
        nodes(kNodes * kNodes) {}

  static constexpr std::size_t kPixels = static_cast<std::size_t>(kSize) * kSize;

  std::shared_ptr<const StillLife> stillLife;
  std::vector<float> still;   // picture of room, table and what is on it
  std::vector<float> albedo;  // times vignetting: what light of the lamp on them adds
  std::vector<float> open;    // vignetting where a distant lamp would be seen, else 0
  std::vector<Node> nodes;
};

struct SourceView::State {
  State(std::shared_ptr<const StillLife> objects, const Room& theRoom, LampMotion& theMotion,
        std::uint32_t theSeed, std::function<void(const Guide&)> guideTo, const Play* thePlay,
        const SourceSeat& seat, const SensorFlaws& flaws)
      : stillLife(std::move(objects)),
        room(theRoom),
        motion(theMotion),
        seed(theSeed),
        onGuide(std::move(guideTo)),
        play(thePlay),
        pixels(kSize, kSize, flaws, theSeed),
        lens(seat.lens),
        sceneFromCamera(seat.sceneFromCamera),
        frame(Tableau::kPixels),
        wallLight(kNodes * kNodes) {
    aim();
    const RigProgram program = programAt(0).program;
    if (program != RigProgram::kDiffuser && program != RigProgram::kDark) show(program);
  }

  ProgramLog::Entry programAt(double timeSeconds) const {
    return play ? play->programs.at(timeSeconds) : ProgramLog::Entry{RigProgram::kLamp, 0};
  }
  const std::shared_ptr<const StillLife>& thingsIn(RigProgram program) const;
  void aim();
  Vector3d directionAt(double x, double y) const;  // interpolated; scene frame
  double fieldAngle(const Vector3d& direction) const;
  void show(RigProgram program);
  void prepare();
  void shadePixel(int x, int y);
  void showBoard(double programSeconds, double exposureSeconds);
  void lightWalls(const LampState& lamp);
  void drawArm(const LampState& lamp);
  void drawCover(const LampState& lamp);
  void drawDisk(const Disk& disk, double radiance, double glare, std::vector<float>& out) const;
  void drawGlare(const Vector2d& centre, double flux, std::vector<float>& out) const;
  void drawShadow(const Vector3d& position, double radius);
  void drawReflections(const LampState& lamp);

  std::shared_ptr<const StillLife> stillLife;
  const Room& room;
  LampMotion& motion;
  std::uint32_t seed;
  std::function<void(const Guide&)> onGuide;
  const Play* play;
  FlawedPixels pixels;
  FisheyeLens lens;
  Isometry3d sceneFromCamera;

  std::vector<Vector3d> directions;                       // of the nodes, scene frame
  std::unique_ptr<Tableau> ofStillLife, ofTable, ofBall;  // absent until shown
  Tableau* now = nullptr;
  PixelCornerRays rays;             // empty until the board is shown
  std::vector<float> illumination;  // vignetting inside the field, else 0
  BoardLayer boardLayer;

  std::vector<float> frame;
  std::vector<float> wallLight;  // at the nodes
  std::vector<float> signal;
};

const std::shared_ptr<const StillLife>& SourceView::State::thingsIn(RigProgram program) const {
  if (program == RigProgram::kBoard) return play->bareTable;
  if (program == RigProgram::kMirrorBall) return play->tableWithBall;
  return stillLife;
}

// Directions at the corners of the coarse cells; the lens is smooth enough to interpolate between
// (0.02 px).
void SourceView::State::aim() {
  directions.resize(static_cast<std::size_t>(kNodes) * kNodes);
  inParallel(kNodes, [&](int row) {
    for (int column = 0; column < kNodes; ++column) {
      directions[static_cast<std::size_t>(row * kNodes + column)] =
          sceneFromCamera.linear() * lens.unprojectUnbounded(Vector2d(column * kCell, row * kCell));
    }
  });
  illumination.assign(Tableau::kPixels, 0);
  inParallel(kSize, [&](int y) {
    for (int x = 0; x < kSize; ++x) {
      for (int i = 0; i < 4; ++i) {
        const double theta =
            fieldAngle(directionAt(x + 0.25 + 0.5 * (i % 2), y + 0.25 + 0.5 * (i / 2)));
        if (theta > FisheyeLens::kMaxFieldAngle.radians()) continue;
        illumination[static_cast<std::size_t>(y * kSize + x)] += 0.25f * vignetting(theta);
      }
    }
  });
}

Vector3d SourceView::State::directionAt(double x, double y) const {
  const int column = std::min(static_cast<int>(x) / kCell, kNodes - 2);
  const int row = std::min(static_cast<int>(y) / kCell, kNodes - 2);
  const double fx = x / kCell - column, fy = y / kCell - row;
  const auto corner = [&](int dx, int dy) -> const Vector3d& {
    return directions[static_cast<std::size_t>((row + dy) * kNodes + column + dx)];
  };
  return ((1 - fy) * ((1 - fx) * corner(0, 0) + fx * corner(1, 0)) +
          fy * ((1 - fx) * corner(0, 1) + fx * corner(1, 1)))
      .normalized();
}

double SourceView::State::fieldAngle(const Vector3d& direction) const {
  return std::acos(std::clamp(direction.dot(sceneFromCamera.linear().col(2)), -1.0, 1.0));
}

void SourceView::State::show(RigProgram program) {
  auto& place = program == RigProgram::kBoard        ? ofTable
                : program == RigProgram::kMirrorBall ? ofBall
                                                     : ofStillLife;
  const bool known = place != nullptr;
  if (!known) place = std::make_unique<Tableau>(thingsIn(program));
  now = place.get();
  if (!known) prepare();
}

void SourceView::State::prepare() {
  const Vector3f eye = sceneFromCamera.translation().cast<float>();
  const Vector3d axis = sceneFromCamera.linear().col(2);
  inParallel(kNodes * kNodes, [&](int place) {
    const auto i = static_cast<std::size_t>(place);
    const Vector3f direction = directions[i].cast<float>();
    Node& node = now->nodes[i];
    node.seen = directions[i].dot(axis) > std::cos(FisheyeLens::kMaxFieldAngle.radians() + 0.08);
    if (now->stillLife->glance(eye, direction)) {
      node.seen = false;  // close things keep the room's light only
    } else {
      const RoomHit wall = room.trace(eye, direction);
      node.position = wall.position;
      node.normal = wall.normal;
    }
  });
  inParallel(kSize, [&](int y) {
    for (int x = 0; x < kSize; ++x) shadePixel(x, y);
  });
  for (const auto& spot : room.spots()) {
    const Vector3d inCamera = sceneFromCamera.inverse() * spot.position.cast<double>();
    if (const auto disk = project(lens, inCamera, spot.radius)) {
      drawDisk(*disk, spot.radiance, 1, now->still);
    }
  }
}

void SourceView::State::shadePixel(int x, int y) {
  const auto pixel = static_cast<std::size_t>(y) * kSize + static_cast<std::size_t>(x);
  const Vector3f eye = sceneFromCamera.translation().cast<float>();
  for (int i = 0; i < 4; ++i) {
    // Four places inside the pixel.
    const Vector3d direction = directionAt(x + 0.25 + 0.5 * (i % 2), y + 0.25 + 0.5 * (i / 2));
    const double theta = fieldAngle(direction);
    if (theta > FisheyeLens::kMaxFieldAngle.radians()) continue;

    const float share = 0.25f * vignetting(theta);
    const Vector3f d = direction.cast<float>();
    Vector3f radiance, reflectance;
    // Only what is low can be an object or the table.
    const auto hit = direction.z() < 0.5 ? now->stillLife->hit(eye, d) : std::nullopt;
    if (hit) {
      // Ambient light, and the room mirrored in the polish.
      const Vector3f mirrored = d - 2 * d.dot(hit->normal) * hit->normal;
      const float gloss =
          (1 - hit->roughness) * static_cast<float>(schlick(0.04, -d.dot(hit->normal)));
      radiance = 0.04f * hit->albedo + gloss * room.trace(hit->position, mirrored).radiance;
      reflectance.setZero();
    } else {
      const RoomHit wall = room.trace(eye, d);
      radiance = wall.radiance;
      reflectance = wall.albedo;
      now->open[pixel] += share;
    }
    const Vector3f response(0.30f, 0.45f, 0.25f);  // of a silicon sensor without filters, roughly
    now->still[pixel] += share * response.dot(radiance);
    now->albedo[pixel] += share * response.dot(reflectance);
  }
}

// Irradiance / pi that the lamp throws on what each node sees.
void SourceView::State::lightWalls(const LampState& lamp) {
  for (std::size_t i = 0; i < now->nodes.size(); ++i) {
    const Node& node = now->nodes[i];
    wallLight[i] = 0;
    if (!lamp.lit || !node.seen) continue;
    const Vector3d d = node.position.cast<double>() - lamp.position;
    const double d2 = d.squaredNorm();
    const double cosine = -d.dot(node.normal.cast<double>()) / std::sqrt(d2);
    constexpr double kBounced = 0.02;  // from the rest of the room
    const double direct = std::max(cosine, 0.0) * kLampDistanceMetres * kLampDistanceMetres / d2;
    wallLight[i] =
        static_cast<float>(lamp.power * (kBounced + direct * emission(d, lamp.position)));
  }
}

// A dark ball, antialiased, over whatever is there.
void SourceView::State::drawShadow(const Vector3d& position, double radius) {
  const auto disk = project(lens, sceneFromCamera.inverse() * position, radius);
  if (!disk) return;
  const Matrix2d inverse = disk->axes.inverse();
  const double reach = disk->axes.norm() + 2;
  const int x0 = std::max(0, static_cast<int>(disk->centre.x() - reach));
  const int x1 = std::min(kSize - 1, static_cast<int>(disk->centre.x() + reach));
  const int y0 = std::max(0, static_cast<int>(disk->centre.y() - reach));
  const int y1 = std::min(kSize - 1, static_cast<int>(disk->centre.y() + reach));
  constexpr float kSkin = 0.004f;  // a hand against the light
  for (int y = y0; y <= y1; ++y) {
    for (int x = x0; x <= x1; ++x) {
      const Vector2d offset = Vector2d(x + 0.5, y + 0.5) - disk->centre;
      const double rho = (inverse * offset).norm();
      const double inside = rho > 1e-6 ? offset.norm() * (1 / rho - 1) : reach;  // pixels
      const auto alpha = static_cast<float>(std::clamp(0.5 + inside / 1.6, 0.0, 1.0));
      if (alpha <= 0) continue;
      const auto pixel = static_cast<std::size_t>(y) * kSize + static_cast<std::size_t>(x);
      if (now->open[pixel] <= 0) continue;
      frame[pixel] += alpha * (kSkin * now->open[pixel] - frame[pixel]);
    }
  }
}

// Hand and arm behind the lamp, as a chain of balls up to the shoulder of a person who walks around
// the table with it.
void SourceView::State::drawArm(const LampState& lamp) {
  const Vector3d outward = lamp.position.normalized();
  Vector3d aside(outward.x(), outward.y() - 0.6, 0);
  aside = aside.norm() > 1e-3 ? aside.normalized() : Vector3d(0, -1, 0);
  const Vector3d shoulder = 1.35 * aside + Vector3d(0, 0, 0.2);
  const Vector3d hand = lamp.position + kHandBehind * outward;
  const Vector3d elbow = 0.5 * (hand + shoulder) + 0.2 * aside - Vector3d(0, 0, 0.1);
  constexpr int kBalls = 110;
  for (int i = 0; i <= kBalls; ++i) {
    const double t = static_cast<double>(i) / kBalls;
    const Vector3d place = (1 - t) * (1 - t) * hand + 2 * t * (1 - t) * elbow + t * t * shoulder;
    const double radius = 0.034 + 0.02 * t + 0.016 * std::exp(-std::pow(t / 0.05, 2));
    drawShadow(place, radius);
  }
  // The stick.
  for (int i = 1; i <= 12; ++i) {
    drawShadow(lamp.position + (0.02 + 0.011 * i) * outward, 0.007);
  }
}

// The hand that slides in between.
void SourceView::State::drawCover(const LampState& lamp) {
  if (lamp.cover <= 0) return;
  const Vector3d eye = sceneFromCamera.translation();
  const Vector3d towards = (eye - lamp.position).normalized();
  Vector3d side = lamp.position + Vector3d(0.1, -0.3, -0.4);
  side = (side - side.dot(towards) * towards).normalized();
  const Vector3d hand =
      lamp.position + 0.06 * towards + (1 - lamp.cover) * 2.6 * kHandRadius * side;
  drawShadow(hand, kHandRadius);
  drawShadow(hand + 0.06 * side, 0.8 * kHandRadius);
}

void SourceView::State::drawGlare(const Vector2d& centre, double flux,
                                  std::vector<float>& out) const {
  constexpr double kTau = 2 * std::numbers::pi;
  const auto halo = static_cast<float>(flux * kHaloShare / (kTau * kHaloPixels * kHaloPixels));
  const auto veil = static_cast<float>(2 * flux * kVeilShare / (kTau * kVeilPixels * kVeilPixels));
  const int x0 = std::max(0, static_cast<int>(centre.x()) - kGlareReach);
  const int x1 = std::min(kSize - 1, static_cast<int>(centre.x()) + kGlareReach);
  const int y0 = std::max(0, static_cast<int>(centre.y()) - kGlareReach);
  const int y1 = std::min(kSize - 1, static_cast<int>(centre.y()) + kGlareReach);
  // The Gaussian is a product of one factor per column and one per row.
  std::array<float, 2 * kGlareReach + 2> columns;
  for (int x = x0; x <= x1; ++x) {
    const double d = x + 0.5 - centre.x();
    columns[static_cast<std::size_t>(x - x0)] =
        static_cast<float>(std::exp(-0.5 * d * d / (kHaloPixels * kHaloPixels)));
  }
  for (int y = y0; y <= y1; ++y) {
    const double dy = y + 0.5 - centre.y();
    const auto rowHalo =
        halo * static_cast<float>(std::exp(-0.5 * dy * dy / (kHaloPixels * kHaloPixels)));
    const auto dy2 = static_cast<float>(dy * dy);
    float* row = out.data() + static_cast<std::size_t>(y) * kSize;
    for (int x = x0; x <= x1; ++x) {
      const float dx = static_cast<float>(x) + 0.5f - static_cast<float>(centre.x());
      const float r2 = dx * dx + dy2;
      constexpr auto kReach2 = static_cast<float>(kGlareReach * kGlareReach);
      const float f = 1 + r2 * static_cast<float>(1 / (kVeilPixels * kVeilPixels));
      // Faded out towards the reach, so that there is no rim.
      const float fade = std::max(1 - r2 / kReach2, 0.0f);
      row[x] += rowHalo * columns[static_cast<std::size_t>(x - x0)] + veil * fade / (f * f);
    }
  }
}

// The disk itself, blurred by the optics and hidden by what is close, and `glare` (0 to 1) of the
// glare of the part that is seen. Small disks become a Gaussian of the same flux.
void SourceView::State::drawDisk(const Disk& disk, double radiance, double glare,
                                 std::vector<float>& out) const {
  const Matrix2d inverse = disk.axes.inverse();
  const Eigen::JacobiSVD<Matrix2d> svd(disk.axes);
  const bool small = svd.singularValues()[1] < 2;
  const Matrix2d covariance =
      0.25 * disk.axes * disk.axes.transpose() + kBlurPixels * kBlurPixels * Matrix2d::Identity();
  const Matrix2d information = covariance.inverse();
  const double peak =
      radiance * disk.area() / (2 * std::numbers::pi * std::sqrt(covariance.determinant()));

  const double reach = svd.singularValues()[0] + 7 * kBlurPixels + 1;
  const int x0 = std::max(0, static_cast<int>(disk.centre.x() - reach));
  const int x1 = std::min(kSize - 1, static_cast<int>(disk.centre.x() + reach));
  const int y0 = std::max(0, static_cast<int>(disk.centre.y() - reach));
  const int y1 = std::min(kSize - 1, static_cast<int>(disk.centre.y() + reach));
  double all = 0, seen = 0;
  for (int y = y0; y <= y1; ++y) {
    for (int x = x0; x <= x1; ++x) {
      const Vector2d offset = Vector2d(x + 0.5, y + 0.5) - disk.centre;
      double value = 0;
      if (small) {
        value = peak * std::exp(-0.5 * offset.dot(information * offset));
      } else {
        const double rho = (inverse * offset).norm();
        const double outside = rho > 1e-6 ? offset.norm() * (1 - 1 / rho) : -reach;  // pixels
        value = radiance * 0.5 * std::erfc(outside / (std::numbers::sqrt2 * kBlurPixels));
      }
      const auto pixel = static_cast<std::size_t>(y) * kSize + static_cast<std::size_t>(x);
      out[pixel] += static_cast<float>(value) * now->open[pixel];
      all += value;
      seen += value * now->open[pixel];
    }
  }
  if (glare <= 0 || all <= 0) return;
  const double flux = glare * radiance * disk.area() * seen / all;
  drawGlare(disk.centre, flux, out);
}

// The lamp in the window pane, in the picture's glass and in the polished table.
void SourceView::State::drawReflections(const LampState& lamp) {
  const Vector3d eye = sceneFromCamera.translation();
  for (const auto& pane : room.panes()) {
    Vector3d mirrored = lamp.position;
    mirrored[pane.axis] = 2.0 * pane.value - mirrored[pane.axis];
    const double t = (pane.value - eye[pane.axis]) / (mirrored[pane.axis] - eye[pane.axis]);
    const Vector3d on = eye + t * (mirrored - eye);
    bool onPane = t > 0 && t < 1;
    for (int i = 0; i < 3; ++i) {
      if (i == pane.axis) continue;
      onPane = onPane && on[i] > pane.low[i] && on[i] < pane.high[i];
    }
    if (!onPane) continue;
    const double cosine = std::abs((mirrored - eye).normalized()[pane.axis]);
    constexpr double kTwoFaces = 2;
    const double reflectance =
        kTwoFaces * schlick(0.04, cosine) * emission(on - lamp.position, lamp.position);
    if (const auto disk = project(lens, sceneFromCamera.inverse() * mirrored, kLampRadiusMetres)) {
      drawDisk(*disk, reflectance * lamp.power * kLampRadiance, 1, frame);
    }
  }
  const double top = stillLife->tableHeight();
  if (lamp.position.z() > top) {
    Vector3d mirrored = lamp.position;
    mirrored.z() = 2 * top - mirrored.z();
    const Vector3d on = eye + (top - eye.z()) / (mirrored.z() - eye.z()) * (mirrored - eye);
    if (on.head<2>().cwiseAbs().maxCoeff() < stillLife->tableHalfSize()) {
      // The satin finish spreads the image: wider, weaker. It lies on pixels that are not `open`.
      const double cosine = std::abs((mirrored - eye).normalized().z());
      const auto disk = project(lens, sceneFromCamera.inverse() * mirrored, 2 * kLampRadiusMetres);
      if (disk) {
        const double radiance =
            lamp.power * kTableGloss * schlick(0.04, cosine) * kLampRadiance / 4;
        drawGlare(disk->centre, radiance * disk->area() / kHaloShare * 0.25, frame);
      }
    }
  }
}

// Exact rays through the pixels' corners: one step of Newton's method from the interpolated ones,
// with the coarse cell's own differences as its Jacobian.
void SourceView::State::showBoard(double programSeconds, double exposureSeconds) {
  if (rays.directions.empty()) {
    rays.width = rays.height = kSize;
    rays.eye = sceneFromCamera.translation();
    rays.directions.resize(static_cast<std::size_t>(kSize + 1) * (kSize + 1));
    const Eigen::Matrix3d cameraFromScene = sceneFromCamera.linear().transpose();
    inParallel(kSize + 1, [&](int y) {
      const int row = std::min(y / kCell, kNodes - 2);
      for (int x = 0; x <= kSize; ++x) {
        const int column = std::min(x / kCell, kNodes - 2);
        const auto corner = [&](int dx, int dy) -> const Vector3d& {
          return directions[static_cast<std::size_t>((row + dy) * kNodes + column + dx)];
        };
        Vector3d direction = directionAt(x, y);
        // Outside the field nothing is seen.
        if (const auto pixel = lens.project(cameraFromScene * direction)) {
          const Vector2d error = Vector2d(x, y) - *pixel;
          direction += error.x() / kCell * (corner(1, 0) - corner(0, 0)) +
                       error.y() / kCell * (corner(0, 1) - corner(0, 0));
        }
        rays.directions[static_cast<std::size_t>(y) * (kSize + 1) + static_cast<std::size_t>(x)] =
            direction.cast<float>();
      }
    });
  }
  show(RigProgram::kBoard);
  drawBoard(play->board, rays, programSeconds - exposureSeconds / 2,
            programSeconds + exposureSeconds / 2, kBlurPixels, boardLayer);
  // The walls are far from the work light, and it does not reach below the table.
  constexpr float kWorkLightOnWalls = 0.05f;
  for (std::size_t i = 0; i < frame.size(); ++i) {
    frame[i] = now->still[i] + kWorkLightOnWalls * now->albedo[i];
  }
  for (int y = boardLayer.y0; y < boardLayer.y1; ++y) {
    for (int x = boardLayer.x0; x < boardLayer.x1; ++x) {
      const auto i = static_cast<std::size_t>(y * kSize + x);
      frame[i] += boardLayer.light[i] * illumination[i] - boardLayer.cover[i] * frame[i];
    }
  }
}

SourceView::SourceView(std::shared_ptr<const StillLife> stillLife, const Room& room,
                       LampMotion& motion, std::uint32_t seed,
                       std::function<void(const Guide&)> onGuide, const Play* play,
                       const SourceSeat& seat, const SensorFlaws& flaws)
    : state_(std::make_unique<State>(std::move(stillLife), room, motion, seed, std::move(onGuide),
                                     play, seat, flaws)) {}
SourceView::~SourceView() = default;

const Isometry3d& SourceView::sceneFromCamera() const { return state_->sceneFromCamera; }
const FisheyeLens& SourceView::lens() const { return state_->lens; }
const FlawedPixels& SourceView::pixels() const { return state_->pixels; }
double SourceView::falloff(const Vector2d& pixel) const {
  const auto direction = state_->lens.unproject(pixel);
  return direction ? vignetting(std::acos(std::clamp(direction->z(), -1.0, 1.0))) : 0.0;
}

void SourceView::guide(const Guide& guide) {
  if (state_->onGuide) state_->onGuide(guide);
}

bool SourceView::seesLamp(const LampState& lamp, RigProgram program) const {
  const State& s = *state_;
  // The sliding hand touches the lamp's disk at about half of its way.
  constexpr double kHandAtLamp = 0.45;
  if (!lamp.lit || lamp.cover > kHandAtLamp) return false;
  if (!s.lens.project(s.sceneFromCamera.inverse() * lamp.position)) return false;
  return !s.thingsIn(program)->occluded(s.sceneFromCamera.translation().cast<float>(),
                                        lamp.position.cast<float>());
}

const std::vector<float>& SourceView::render(double timeSeconds, double exposureSeconds) {
  State& s = *state_;
  const auto [program, since] = s.programAt(timeSeconds);
  switch (program) {
    case RigProgram::kBoard:
      s.showBoard(timeSeconds - since, exposureSeconds);
      return s.frame;
    case RigProgram::kDiffuser:
      for (std::size_t i = 0; i < s.frame.size(); ++i) {
        s.frame[i] = kSourceDiffuserRadiance * s.illumination[i];
      }
      return s.frame;
    case RigProgram::kDark:
      std::fill(s.frame.begin(), s.frame.end(), 0.0f);
      return s.frame;
    case RigProgram::kStill:
      s.show(program);
      s.frame = s.now->still;
      return s.frame;
    case RigProgram::kLamp:
    case RigProgram::kMirrorBall:
      break;
  }
  s.show(program);
  s.motion.advanceTo(timeSeconds + exposureSeconds / 2);
  const LampState lamp = s.motion.at(timeSeconds);
  const double lampRadiance = lamp.power * kLampRadiance;

  s.lightWalls(lamp);
  for (int y = 0; y < kSize; ++y) {
    const auto start = static_cast<std::size_t>(y) * kSize;
    const float* above = s.wallLight.data() + static_cast<std::size_t>(y / kCell) * kNodes;
    const float fraction = (static_cast<float>(y % kCell) + 0.5f) / kCell;
    addWallLight(s.now->still.data() + start, s.now->albedo.data() + start, above, above + kNodes,
                 fraction, s.frame.data() + start);
  }
  s.drawArm(lamp);
  if (!lamp.lit) return s.frame;

  // The lamp moves while the shutter is open: one disk per half pixel of its way.
  const auto pixelAt = [&](double t) {
    return s.lens.project(s.sceneFromCamera.inverse() * s.motion.at(t).position);
  };
  const auto begin = pixelAt(timeSeconds - exposureSeconds / 2);
  const auto end = pixelAt(timeSeconds + exposureSeconds / 2);
  const double way = begin && end ? (*end - *begin).norm() : 0;
  const int steps = std::clamp(static_cast<int>(std::ceil(2 * way)), 1, 24);
  const double uncovered = std::clamp(1.3 - 2 * lamp.cover, 0.0, 1.0);
  for (int i = 0; i < steps; ++i) {
    const double when = timeSeconds + ((i + 0.5) / steps - 0.5) * exposureSeconds;
    const Vector3d inCamera = s.sceneFromCamera.inverse() * s.motion.at(when).position;
    if (const auto disk = project(s.lens, inCamera, kLampRadiusMetres)) {
      s.drawDisk(*disk, lampRadiance / steps, uncovered, s.frame);
    }
  }
  s.drawCover(lamp);

  // The lens' own ghost, small and weak, opposite the centre; and the mirror images, which the hand
  // does not cover.
  if (const auto disk =
          project(s.lens, s.sceneFromCamera.inverse() * lamp.position, kLampRadiusMetres)) {
    const Vector2d middle = Vector2d::Constant(kSize / 2.0);
    const Disk ghost{middle - 0.45 * (disk->centre - middle), kGhostPixels * Matrix2d::Identity()};
    const double flux = uncovered * lampRadiance * disk->area();
    s.drawDisk(ghost, flux * kGhostShare / ghost.area(), 0, s.frame);
  }
  s.drawReflections(lamp);
  return s.frame;
}

void SourceView::expose(const ExposureRequest& request, std::vector<std::uint8_t>& bytes) {
  State& s = *state_;
  const std::vector<float>& image = render(request.timeSeconds, request.exposureSeconds);
  const Region& r = request.region;
  const auto width = static_cast<std::size_t>(r.width), height = static_cast<std::size_t>(r.height);
  s.signal.resize(width * height);
  for (std::size_t y = 0; y < height; ++y) {
    scale(
        image.data() + (static_cast<std::size_t>(r.y) + y) * kSize + static_cast<std::size_t>(r.x),
        static_cast<float>(kSignalPerSecond * request.exposureSeconds), width,
        s.signal.data() + y * width);
  }
  bytes.resize(s.signal.size() *
               static_cast<std::size_t>(pixelFormatInfo(request.format).bytesPerPixel));
  s.pixels.collect(r, 1, request.exposureSeconds, s.signal);
  readOut(kSourceSensor, request.format, request.gainDb, hash64(request.index) + s.seed, s.signal,
          bytes.data(), s.pixels.response());
}

}  // namespace lightsketch
