#include "capture/rig/scene_view.h"

#include <embree3/rtcore.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "capture/frame/vectorise.h"
#include "capture/rig/noise.h"
#include "capture/rig/parallel.h"

namespace lightsketch {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr float kPi = std::numbers::pi_v<float>;
constexpr int kLanes = 16;
constexpr int kTile = 4;  // kTile^2 pixels make one packet of shadow rays
constexpr int kTileColumns = SceneView::kWidth / kTile;
constexpr int kTileRows = SceneView::kHeight / kTile;
constexpr int kShadowSamples = 4;
constexpr float kRayOffset = 1e-4f;  // metres, off the surface

// A white surface facing the lamp at 0.9 m has radiance 1.
constexpr float kLampIntensity = static_cast<float>(kLampDistanceMetres * kLampDistanceMetres);
const Vector3f kLampColour(1.0f, 0.965f, 0.89f);
// The lamp's light that comes back from walls and ceiling, against a white surface's in its beam.
constexpr float kRoomBounce = 0.03f;

// Sixteen points of light transport: first hits, and what glossy first hits mirror.
struct alignas(64) Block {
  float px[kLanes], py[kLanes], pz[kLanes];  // position, off the surface
  float nx[kLanes], ny[kLanes], nz[kLanes];  // shading normal
  float vx[kLanes], vy[kLanes], vz[kLanes];  // to the viewer
  float albedo[3][kLanes], specular[3][kLanes];
  float alpha[kLanes];  // GGX width
  float translucency[kLanes], thickness[kLanes];
  float openness[kLanes];                    // share of the hemisphere that sees the room
  float bounce[3][kLanes];                   // colour of the objects around,
  float bx[kLanes], by[kLanes], bz[kLanes];  // and their mean normal: bounced light
  float weight[3][kLanes];                   // of this point in its pixel
  std::int32_t pixel[kLanes];                // -1: unused lane
};

// What shading needs of the lamp.
struct Lamp {
  float x, y, z;
};

// Radiance towards the viewer per unit of weight, lane by lane; `visible` is the lit share of the
// lamp. GGX with Smith's masking (Walter et al. 2007; Heitz 2014), widened by the lamp's size;
// Schlick's Fresnel term. The light that seeps through is a look-alike, not a simulation: wrapped
// diffuse light and a lobe against the light (after Barre-Brisebois and Bouchard 2011).
LIGHTSKETCH_VECTORISED
void shade(const Block& __restrict b, const Lamp& lamp, const float* __restrict visible,
           float (*__restrict radiance)[kLanes]) {
  const float lampX = lamp.x, lampY = lamp.y, lampZ = lamp.z;
  for (int i = 0; i < kLanes; ++i) {
    const float dx = lampX - b.px[i], dy = lampY - b.py[i], dz = lampZ - b.pz[i];
    const float d2 = dx * dx + dy * dy + dz * dz;
    const float inverse = 1 / std::sqrt(d2);
    const float lx = dx * inverse, ly = dy * inverse, lz = dz * inverse;
    const float irradiance = kLampIntensity / d2;
    const float cosLight = b.nx[i] * lx + b.ny[i] * ly + b.nz[i] * lz;
    const float nl = std::max(cosLight, 0.0f);
    const float nv = std::max(b.nx[i] * b.vx[i] + b.ny[i] * b.vy[i] + b.nz[i] * b.vz[i], 0.02f);

    const float hx = lx + b.vx[i], hy = ly + b.vy[i], hz = lz + b.vz[i];
    const float hInverse = 1 / std::sqrt(std::max(hx * hx + hy * hy + hz * hz, 1e-8f));
    const float nh = std::max((b.nx[i] * hx + b.ny[i] * hy + b.nz[i] * hz) * hInverse, 0.0f);
    const float vh = std::max((b.vx[i] * hx + b.vy[i] * hy + b.vz[i] * hz) * hInverse, 0.0f);
    const float widened = b.alpha[i] + 0.5f * static_cast<float>(kLampRadiusMetres) * inverse;
    const float a2 = widened * widened;
    const float t = nh * nh * (a2 - 1) + 1;
    const float lobe = a2 / std::max(t * t, 1e-12f);  // times pi: irradiance is in radiance units
    const float masking = 0.5f / std::max(nl * std::sqrt(nv * nv * (1 - a2) + a2) +
                                              nv * std::sqrt(nl * nl * (1 - a2) + a2),
                                          1e-5f);
    const float m = 1 - vh, m2 = m * m;
    const float schlick = m2 * m2 * m;
    const float glossy = lobe * masking * nl * visible[i];

    const float wrapped = std::max((cosLight + 0.6f) / 1.6f, 0.0f);
    const float against =
        std::max(-(b.vx[i] * (lx + 0.3f * b.nx[i]) + b.vy[i] * (ly + 0.3f * b.ny[i]) +
                   b.vz[i] * (lz + 0.3f * b.nz[i])),
                 0.0f);
    const float seeping = wrapped * wrapped + 1.2f * against * against * against;
    const float diffuse = visible[i] * (nl + b.translucency[i] * (seeping - nl));

    const float fromObjects = 0.8f * std::max(b.bx[i] * lx + b.by[i] * ly + b.bz[i] * lz, 0.0f);
    const float fromRoom = kRoomBounce * b.openness[i] * (0.75f + 0.25f * b.nz[i]);
    for (int c = 0; c < 3; ++c) {
      const float fresnel = b.specular[c][i] + (1 - b.specular[c][i]) * schlick;
      const float indirect = fromRoom + fromObjects * b.bounce[c][i];
      radiance[c][i] =
          b.weight[c][i] * (irradiance * (b.albedo[c][i] * diffuse + fresnel * glossy) +
                            b.albedo[c][i] * irradiance * indirect);
    }
  }
}

// Places on the lamp that shadow rays aim at: kShadowSamples for each lane, other ones for the four
// lanes of every 2 x 2 square.
struct LampPoints {
  alignas(64) float x[kShadowSamples][kLanes], y[kShadowSamples][kLanes], z[kShadowSamples][kLanes];
};

// Spread over the lamp as the scene sees it, and over the exposure.
LampPoints lampPointsAt(const LampMotion& motion, double timeSeconds, double exposureSeconds) {
  const Vector3d towards = motion.at(timeSeconds).position.normalized();
  const Vector3d u = towards.unitOrthogonal(), v = towards.cross(u);
  LampPoints points;
  for (int k = 0; k < kShadowSamples; ++k) {
    for (int group = 0; group < 4; ++group) {
      const int index = 4 * k + group;
      const double angle = 2 * std::numbers::pi * (k / 4.0 + group / 16.0);
      // Equal areas: radius^2 uniform, in an order that keeps neighbours apart; so is the time.
      constexpr std::array<int, 16> kOrder = {15, 6, 10, 1, 4, 13, 0, 11, 14, 3, 9, 7, 5, 12, 2, 8};
      const double radius =
          kLampRadiusMetres * std::sqrt((kOrder[static_cast<std::size_t>(index)] + 0.5) / 16);
      const double when = ((7 * index) % 16 + 0.5) / 16 - 0.5;
      const Vector3f p = (motion.at(timeSeconds + when * exposureSeconds).position +
                          radius * (std::cos(angle) * u + std::sin(angle) * v))
                             .cast<float>();
      for (int lane = 0; lane < kLanes; ++lane) {
        if (((lane & 1) | (lane >> 1 & 2)) != group) continue;
        points.x[k][lane] = p.x();
        points.y[k][lane] = p.y();
        points.z[k][lane] = p.z();
      }
    }
  }
  return points;
}

enum class Light : std::uint8_t { kUnknown, kDark, kLit, kMixed };

// Shadow rays in packets of sixteen.
class ShadowCaster {
 public:
  ShadowCaster(RTCScene scene, const LampPoints& points) : scene_(scene), points_(points) {
    rtcInitIntersectContext(&context_);
    for (int i = 0; i < kLanes; ++i) {
      rays_.time[i] = 0;
      rays_.mask[i] = ~0u;
      rays_.flags[i] = 0;
    }
  }

  // What the four corner pixels of up to four blocks say, each aiming at another place on the lamp.
  std::array<Light, 4> castCorners(const Block* blocks, std::size_t count, const Lamp& lamp) {
    constexpr std::array<int, 4> kCorners = {0, 3, 12, 15};
    for (int i = 0; i < kLanes; ++i) {
      const auto k = static_cast<std::size_t>(i / 4);
      const Block& b = blocks[std::min(k, count - 1)];
      const int lane = kCorners[static_cast<std::size_t>(i % 4)];
      const float dx = lamp.x - b.px[lane], dy = lamp.y - b.py[lane], dz = lamp.z - b.pz[lane];
      const bool facing = b.nx[lane] * dx + b.ny[lane] * dy + b.nz[lane] * dz > 0;
      valid_[i] = k < count && (facing || b.translucency[lane] > 0) ? -1 : 0;
      setRay(i, b, lane, points_.x[i % 4][i], points_.y[i % 4][i], points_.z[i % 4][i]);
    }
    rtcOccluded16(valid_, scene_, &context_, &rays_);
    std::array<Light, 4> result;
    for (int k = 0; k < 4; ++k) {
      int lit = 0;
      for (int i = 4 * k; i < 4 * k + 4; ++i) lit += valid_[i] && rays_.tfar[i] >= 0;
      result[static_cast<std::size_t>(k)] =
          lit == 0 ? Light::kDark : (lit == 4 ? Light::kLit : Light::kMixed);
    }
    return result;
  }

  // Share of the lamp that each lane sees: four places each, then the mean over the neighbours in
  // the tile that lie on the same surface (interleaved sampling, Keller and Heidrich 2001).
  void castTile(const Block& b, float* visible) {
    float raw[kLanes] = {};
    for (int k = 0; k < kShadowSamples; ++k) castRound(b, k, raw);
    for (int i = 0; i < kLanes; ++i) {
      float sum = 0, weight = 0;
      for (int y = std::max(i / kTile - 1, 0); y <= std::min(i / kTile + 1, kTile - 1); ++y) {
        for (int x = std::max(i % kTile - 1, 0); x <= std::min(i % kTile + 1, kTile - 1); ++x) {
          const int j = y * kTile + x;
          const float dx = b.px[j] - b.px[i], dy = b.py[j] - b.py[i], dz = b.pz[j] - b.pz[i];
          const float same = b.nx[j] * b.nx[i] + b.ny[j] * b.ny[i] + b.nz[j] * b.nz[i];
          constexpr float kNeighbour = 0.0015f;  // metres: three pixels
          if (dx * dx + dy * dy + dz * dz > kNeighbour * kNeighbour || same < 0.9f) continue;
          sum += raw[j];
          weight += 1;
        }
      }
      visible[i] = sum / (kShadowSamples * weight);
    }
  }

  // The same for points that are no tile: further samples only where the first ones disagree.
  void castLoose(const Block& b, float* visible) {
    std::fill(visible, visible + kLanes, 0.0f);
    castRound(b, 0, visible);
    int lit = 0, facing = 0;
    for (int i = 0; i < kLanes; ++i) {
      const bool faces =
          b.translucency[i] > 0 ||
          b.nx[i] * rays_.dir_x[i] + b.ny[i] * rays_.dir_y[i] + b.nz[i] * rays_.dir_z[i] > 0;
      facing += faces;
      lit += faces && visible[i] > 0;
    }
    if (lit == 0 || lit == facing) return;
    for (int k = 1; k < kShadowSamples; ++k) castRound(b, k, visible);
    for (int i = 0; i < kLanes; ++i) visible[i] /= kShadowSamples;
  }

 private:
  // One shadow ray per lane, to its k-th place; adds 1 where it is free.
  void castRound(const Block& b, int k, float* lit) {
    for (int i = 0; i < kLanes; ++i) {
      valid_[i] = -1;
      setRay(i, b, i, points_.x[k][i], points_.y[k][i], points_.z[k][i]);
    }
    rtcOccluded16(valid_, scene_, &context_, &rays_);
    for (int i = 0; i < kLanes; ++i) lit[i] += rays_.tfar[i] >= 0 ? 1.0f : 0.0f;
  }

  void setRay(int i, const Block& b, int lane, float x, float y, float z) {
    rays_.org_x[i] = b.px[lane];
    rays_.org_y[i] = b.py[lane];
    rays_.org_z[i] = b.pz[lane];
    rays_.dir_x[i] = x - b.px[lane];
    rays_.dir_y[i] = y - b.py[lane];
    rays_.dir_z[i] = z - b.pz[lane];
    // Light that seeps through does not meet its own object first. The lamp is about 0.9 m away.
    rays_.tnear[i] = b.thickness[lane] / static_cast<float>(kLampDistanceMetres);
    rays_.tfar[i] = 1;
  }

  RTCScene scene_;
  const LampPoints& points_;
  RTCIntersectContext context_;
  alignas(64) RTCRay16 rays_;
  alignas(64) std::int32_t valid_[kLanes];
};

// Light that is always there, and how open a point is to its surroundings.
struct Surroundings {
  Vector3f ambient = Vector3f::Zero();   // irradiance / pi
  Vector3f mirrored = Vector3f::Zero();  // radiance of the room in the polish
  float openness = 0;
  Vector3f bounceColour = Vector3f::Zero();
  Vector3f bounceNormal = Vector3f::Zero();
};

Vector3f cosineDirection(const Vector3f& normal, float u, float v) {
  const Vector3f tangent = normal.unitOrthogonal();
  const float r = std::sqrt(u);
  const float phi = 2 * kPi * v;
  return r * std::cos(phi) * tangent + r * std::sin(phi) * normal.cross(tangent) +
         std::sqrt(1 - u) * normal;
}

// Kronecker sequence of the plastic number (Roberts 2018), shifted per point.
std::array<float, 2> lowDiscrepancy(int i, float shiftU, float shiftV) {
  const float u = 0.7548776662f * static_cast<float>(i) + shiftU;
  const float v = 0.5698402910f * static_cast<float>(i) + shiftV;
  return {u - std::floor(u), v - std::floor(v)};
}

// How many rays look around from a point. A flat table needs fewer: its neighbours see the same.
struct Effort {
  int hemisphere, panel, polish;
};
constexpr Effort kStillLifeEffort{28, 8, 12}, kTableEffort{7, 2, 4};

Surroundings surroundingsOf(const StillLife& stillLife, const Room& room, const SurfacePoint& point,
                            const Effort& effort, std::uint64_t seed) {
  Surroundings s;
  const Vector3f origin = point.position + kRayOffset * point.geometricNormal;
  const float shiftU = uniformFromHash(2 * seed), shiftV = uniformFromHash(2 * seed + 1);

  // The hemisphere: walls and window, or other objects.
  const int rays = effort.hemisphere;
  const float part = 1 / static_cast<float>(rays);
  for (int i = 0; i < rays; ++i) {
    const auto [u, v] = lowDiscrepancy(i, shiftU, shiftV);
    const Vector3f direction = cosineDirection(point.normal, u, v);
    if (const auto other = stillLife.glance(origin, direction)) {
      constexpr float kAmbientOnObjects = 0.035f;
      s.ambient += kAmbientOnObjects * other->albedo * part;
      s.bounceColour += other->albedo * part;
      s.bounceNormal += other->normal * part;
    } else {
      s.openness += part;
      const RoomHit hit = room.trace(origin, direction);
      if (hit.normal.z() > -0.5f || hit.albedo.x() > 0) s.ambient += hit.radiance * part;
    }
  }
  // Ceiling panels and spots are small: sample them, not the hemisphere.
  for (const auto& panel : room.panels()) {
    const Vector3f size = panel.high - panel.low;
    for (int i = 0; i < effort.panel; ++i) {
      const auto [u, v] = lowDiscrepancy(i, shiftV, shiftU);
      const Vector3f to = panel.low + Vector3f(u * size.x(), v * size.y(), 0);
      const Vector3f d = to - origin;
      const float d2 = d.squaredNorm();
      const float cosHere = d.dot(point.normal) / std::sqrt(d2);
      const float cosThere = d.z() / std::sqrt(d2);
      if (cosHere <= 0 || stillLife.occluded(origin, to)) continue;
      s.ambient += Vector3f::Constant(panel.radiance * cosHere * cosThere * size.x() * size.y() /
                                      (d2 * kPi * static_cast<float>(effort.panel)));
    }
  }
  for (const auto& spot : room.spots()) {
    const Vector3f d = spot.position - origin;
    const float d2 = d.squaredNorm();
    const float cosHere = d.dot(point.normal) / std::sqrt(d2);
    if (cosHere <= 0 || stillLife.occluded(origin, spot.position)) continue;
    s.ambient +=
        spot.radiance * cosHere * spot.radius * spot.radius / d2 * Vector3f(1, 0.9f, 0.75f);
  }
  return s;
}

// The hits of one smooth surface inside a pixel, as sums until mean() is called.
struct SurfaceGroup {
  explicit SurfaceGroup(const SurfacePoint& first)
      : sum(first), firstNormal(first.geometricNormal), firstDistance(first.distance) {}

  SurfacePoint sum;
  Vector3f firstNormal;
  float firstDistance;
  int count = 1;

  bool accepts(const SurfacePoint& hit) const {
    return hit.object == sum.object && hit.geometricNormal.dot(firstNormal) > 0.94f &&
           std::abs(hit.distance - firstDistance) < 0.002f;
  }
  void add(const SurfacePoint& hit) {
    ++count;
    sum.position += hit.position;
    sum.normal += hit.normal;
    sum.geometricNormal += hit.geometricNormal;
    sum.albedo += hit.albedo;
  }
  SurfacePoint mean() const {
    SurfacePoint point = sum;
    point.position /= static_cast<float>(count);
    point.normal.normalize();
    point.geometricNormal.normalize();
    point.albedo /= static_cast<float>(count);
    return point;
  }
};

float schlickFactor(const SurfacePoint& point, const Vector3f& toViewer) {
  const float m = 1 - std::clamp(point.normal.dot(toViewer), 0.0f, 1.0f);
  return m * m * m * m * m;
}

}  // namespace

// One arrangement of things on the table, and all of its picture that does not change.
struct SceneView::Tableau {
  Tableau(std::shared_ptr<const StillLife> still, const Room& theRoom, const Effort& theEffort,
          const std::optional<ChromeBall>& theBall)
      : stillLife(std::move(still)),
        room(theRoom),
        focal(kWidth / 2.0 / std::tan(stillLife->horizontalField().radians() / 2)),
        effort(theEffort),
        ball(theBall) {
    prepare();
  }

  // One point of a pixel and the share it has in it.
  struct Point {
    SurfacePoint surface;
    Surroundings surroundings;
    Vector3f toViewer;
    Vector3f weight;
    std::int32_t pixel;
  };

  void prepare();
  void addPixel(int x, int y, std::vector<Point>& points, std::vector<Point>& mirrored);
  void smoothSurroundings(const std::vector<Point*>& points);
  static void store(const std::vector<Point>& points, std::vector<Block>& blocks);
  void traceLamp(const LampState& lamp, const LampPoints& lampPoints, RadianceImage& frame);
  static void addLight(const Block& block, const Lamp& lamp, float power, const float* visible,
                       RadianceImage& frame);
  // The mirror image of a luminous ball in the chrome ball; it may move while the shutter is open.
  void addHighlight(const Vector3d& from, const Vector3d& to, double radius,
                    const Vector3f& radiance, RadianceImage& frame) const;

  std::shared_ptr<const StillLife> stillLife;
  const Room& room;
  double focal;  // pixels
  Effort effort;
  std::optional<ChromeBall> ball;
  std::vector<Block> tiles;             // 4 x 4 pixels, one point each, lanes row by row
  std::vector<std::size_t> tilePlaces;  // where each lies in the grid of tiles
  std::vector<Light> tileLight;         // of the whole grid; scratch
  std::vector<Block> loose;             // every other point
  RadianceImage ambient{kWidth, kHeight, 3};
  RadianceImage byWorkLight{kWidth, kHeight, 3};  // what the work light adds
  std::vector<float> roomInBall;                  // how much of each pixel mirrors the room
};

struct SceneView::State {
  State(std::shared_ptr<const StillLife> theStillLife, const Room& theRoom, LampMotion& theMotion,
        std::uint32_t theSeed, const Play* thePlay, const SensorFlaws& flaws)
      : stillLife(std::move(theStillLife)),
        room(theRoom),
        motion(theMotion),
        seed(theSeed),
        play(thePlay),
        pixels(kWidth, kHeight, flaws, theSeed) {
    const RigProgram program = programAt(0).program;
    if (program != RigProgram::kDiffuser && program != RigProgram::kDark) tableau(program);
  }

  ProgramLog::Entry programAt(double timeSeconds) const {
    return play ? play->programs.at(timeSeconds) : ProgramLog::Entry{RigProgram::kLamp, 0};
  }
  Tableau& tableau(RigProgram program);
  void showBoard(double programSeconds, double exposureSeconds);

  std::shared_ptr<const StillLife> stillLife;
  const Room& room;
  LampMotion& motion;
  std::uint32_t seed;
  const Play* play;
  FlawedPixels pixels;
  std::unique_ptr<Tableau> ofStillLife, ofTable, ofBall;  // absent until shown
  PixelCornerRays rays;                                   // empty until the board is shown
  BoardLayer boardLayer;
  RadianceImage frame{kWidth, kHeight, 3};
  std::vector<float> signal;
};

// Points of one pixel: one for every smooth surface that four rays find in it. A glossy surface
// adds what it mirrors as a point of its own; the room's mirror image goes to the ambient light.
void SceneView::Tableau::addPixel(int x, int y, std::vector<Point>& points,
                                  std::vector<Point>& mirrored) {
  const auto& pose = stillLife->sceneFromCamera();
  const Vector3f eye = pose.translation().cast<float>();
  const std::int32_t pixel = y * kWidth + x;

  std::vector<SurfaceGroup> groups;
  for (int i = 0; i < 4; ++i) {
    const Vector3d inCamera((x + 0.25 + 0.5 * (i % 2) - kWidth / 2.0) / focal,
                            (y + 0.25 + 0.5 * (i / 2) - kHeight / 2.0) / focal, 1);
    const Vector3f direction = (pose.linear() * inCamera).normalized().cast<float>();
    const auto hit = stillLife->hit(eye, direction);
    if (!hit) {
      const Vector3f seen = room.trace(eye, direction).radiance;
      for (int c = 0; c < 3; ++c) ambient(x, y, c) += 0.25f * seen[c];
      continue;
    }
    auto group = std::find_if(groups.begin(), groups.end(),
                              [&](const SurfaceGroup& g) { return g.accepts(*hit); });
    if (group == groups.end())
      groups.emplace_back(*hit);
    else
      group->add(*hit);
  }

  for (std::size_t i = 0; i < groups.size(); ++i) {
    const float share = 0.25f * static_cast<float>(groups[i].count);
    Point p;
    p.surface = groups[i].mean();
    p.toViewer = (eye - p.surface.position).normalized();
    p.weight = Vector3f::Constant(share);
    p.pixel = pixel;
    const auto id = static_cast<std::uint64_t>(pixel) * 4 + i;
    p.surroundings = surroundingsOf(*stillLife, room, p.surface, effort, id);
    Vector3f& light = p.surroundings.mirrored;

    // What it mirrors; a rough surface mirrors a cone.
    const Vector3f fresnel = p.surface.specular + schlickFactor(p.surface, p.toViewer) *
                                                      (1 - p.surface.roughness) *
                                                      (Vector3f::Ones() - p.surface.specular);
    if (p.surface.roughness < 0.6f) {
      const Vector3f origin = p.surface.position + kRayOffset * p.surface.geometricNormal;
      const float spread = p.surface.roughness * p.surface.roughness;
      const int rays = spread < 0.01f ? 4 : effort.polish;
      for (int k = 0; k < rays; ++k) {
        const auto [u, v] = lowDiscrepancy(k, uniformFromHash(7 * id), uniformFromHash(7 * id + 1));
        const float r = spread * std::sqrt(u / (1.0f - 0.9f * u));
        const Vector3f tangent = p.surface.normal.unitOrthogonal();
        const Vector3f half = (p.surface.normal + r * std::cos(2 * kPi * v) * tangent +
                               r * std::sin(2 * kPi * v) * p.surface.normal.cross(tangent))
                                  .normalized();
        const Vector3f out = 2 * half.dot(p.toViewer) * half - p.toViewer;
        if (out.dot(p.surface.geometricNormal) <= 0) continue;
        const Vector3f part = fresnel / static_cast<float>(rays);
        const auto other = stillLife->hit(origin, out);
        if (!other) {
          light += part.cwiseProduct(room.trace(origin, out).radiance);
          if (p.surface.mirror) roomInBall[static_cast<std::size_t>(pixel)] += share * part.y();
          continue;
        }
        light += 0.035f * part.cwiseProduct(other->albedo);
      }
      // Other objects that the lamp lights, sharp: worth it only where much is mirrored.
      const Vector3f out = 2 * p.surface.normal.dot(p.toViewer) * p.surface.normal - p.toViewer;
      const auto other =
          spread < 0.08f && fresnel.maxCoeff() > 0.1f ? stillLife->hit(origin, out) : std::nullopt;
      if (other) {
        Point m;
        m.surface = *other;
        m.surroundings.openness = 0.7f;
        m.toViewer = -out;
        m.weight = share * fresnel;
        m.pixel = pixel;
        mirrored.push_back(m);
      }
    }
    points.push_back(std::move(p));
  }
}

void SceneView::Tableau::store(const std::vector<Point>& points, std::vector<Block>& blocks) {
  for (std::size_t start = 0; start < points.size(); start += kLanes) {
    Block& b = blocks.emplace_back();
    for (int i = 0; i < kLanes; ++i) {
      // Lanes past the end repeat the last point, so that the arithmetic stays finite.
      const std::size_t place = std::min(start + static_cast<std::size_t>(i), points.size() - 1);
      const Point& p = points[place];
      const SurfacePoint& s = p.surface;
      const Vector3f position = s.position + kRayOffset * s.geometricNormal;
      b.px[i] = position.x(), b.py[i] = position.y(), b.pz[i] = position.z();
      b.nx[i] = s.normal.x(), b.ny[i] = s.normal.y(), b.nz[i] = s.normal.z();
      b.vx[i] = p.toViewer.x(), b.vy[i] = p.toViewer.y(), b.vz[i] = p.toViewer.z();
      b.alpha[i] = s.roughness * s.roughness;
      b.translucency[i] = s.translucency;
      b.thickness[i] = s.thickness;
      b.openness[i] = p.surroundings.openness;
      b.bx[i] = p.surroundings.bounceNormal.x();
      b.by[i] = p.surroundings.bounceNormal.y();
      b.bz[i] = p.surroundings.bounceNormal.z();
      // The mean over open and closed directions: bounceNormal is weighted by their share already.
      const float closed = std::max(1 - p.surroundings.openness, 1e-3f);
      for (int c = 0; c < 3; ++c) {
        b.albedo[c][i] = s.albedo[c];
        b.specular[c][i] = s.specular[c];
        b.bounce[c][i] = p.surroundings.bounceColour[c] / closed;
        b.weight[c][i] = s.mirror ? 0 : p.weight[c];
      }
      b.pixel[i] = start + static_cast<std::size_t>(i) < points.size() ? p.pixel : -1;
    }
  }
}

// The surroundings come from a few rays each: average them over neighbours on the same surface,
// then add the ambient light.
void SceneView::Tableau::smoothSurroundings(const std::vector<Point*>& points) {
  std::vector<const Point*> at(static_cast<std::size_t>(kWidth) * kHeight, nullptr);
  for (const Point* p : points) at[static_cast<std::size_t>(p->pixel)] = p;
  std::vector<Surroundings> smoothed(points.size());
  inParallel(static_cast<int>(points.size()), [&](int place) {
    const auto i = static_cast<std::size_t>(place);
    const Point& p = *points[i];
    const int x = p.pixel % kWidth, y = p.pixel / kWidth;
    constexpr int kReach = 4;
    Surroundings sum = p.surroundings;
    float weight = 1;
    for (int v = std::max(y - kReach, 0); v <= std::min(y + kReach, kHeight - 1); ++v) {
      for (int u = std::max(x - kReach, 0); u <= std::min(x + kReach, kWidth - 1); ++u) {
        const Point* q = at[static_cast<std::size_t>(v * kWidth + u)];
        if (!q || q == &p || q->surface.object != p.surface.object ||
            q->surface.normal.dot(p.surface.normal) < 0.95f ||
            std::abs((q->surface.position - p.surface.position).dot(p.surface.normal)) > 0.001f) {
          continue;
        }
        sum.ambient += q->surroundings.ambient;
        sum.mirrored += q->surroundings.mirrored;
        sum.openness += q->surroundings.openness;
        sum.bounceColour += q->surroundings.bounceColour;
        sum.bounceNormal += q->surroundings.bounceNormal;
        weight += 1;
      }
    }
    sum.ambient /= weight;
    // A sharp mirror image needs no smoothing and would suffer.
    constexpr float kSharp = 0.3f;
    sum.mirrored =
        p.surface.roughness < kSharp ? p.surroundings.mirrored : Vector3f(sum.mirrored / weight);
    sum.openness /= weight;
    sum.bounceColour /= weight;
    sum.bounceNormal /= weight;
    smoothed[i] = sum;
  });
  for (std::size_t i = 0; i < points.size(); ++i) {
    Point& p = *points[i];
    p.surroundings = smoothed[i];
    const Vector3f light = p.weight.cwiseProduct(
        p.surface.albedo.cwiseProduct(p.surroundings.ambient) + p.surroundings.mirrored);
    const Vector3f work = p.surroundings.openness *
                          static_cast<float>(workLight(p.surface.position.cast<double>(),
                                                       p.surface.normal.cast<double>())) *
                          p.weight.cwiseProduct(p.surface.albedo);
    for (int c = 0; c < 3; ++c) {
      ambient.data()[3 * p.pixel + c] += light[c];
      byWorkLight.data()[3 * p.pixel + c] += work[c];
    }
  }
}

void SceneView::Tableau::prepare() {
  roomInBall.assign(static_cast<std::size_t>(kWidth) * kHeight, 0);
  struct Tile {
    std::vector<Point> points, mirrored;
  };
  std::vector<Tile> grid(kTileColumns * kTileRows);
  inParallel(kTileRows, [&](int row) {
    for (int column = 0; column < kTileColumns; ++column) {
      Tile& tile = grid[static_cast<std::size_t>(row * kTileColumns + column)];
      for (int i = 0; i < kLanes; ++i) {
        addPixel(column * kTile + i % kTile, row * kTile + i / kTile, tile.points, tile.mirrored);
      }
    }
  });

  std::vector<Point*> points;
  for (Tile& tile : grid) {
    for (Point& p : tile.points) points.push_back(&p);
  }
  smoothSurroundings(points);

  tileLight.assign(grid.size(), Light::kUnknown);
  std::vector<Point> rest;
  for (std::size_t place = 0; place < grid.size(); ++place) {
    const Tile& tile = grid[place];
    if (tile.points.size() == kLanes) {
      store(tile.points, tiles);
      tilePlaces.push_back(place);
    } else {
      rest.insert(rest.end(), tile.points.begin(), tile.points.end());
    }
    rest.insert(rest.end(), tile.mirrored.begin(), tile.mirrored.end());
  }
  store(rest, loose);

  if (!ball) return;
  for (const auto& spot : room.spots()) {
    const Vector3d place = spot.position.cast<double>();
    addHighlight(place, place, spot.radius, spot.radiance * Vector3f(1, 0.9f, 0.75f), ambient);
  }
}

void SceneView::Tableau::addHighlight(const Vector3d& from, const Vector3d& to, double radius,
                                      const Vector3f& radiance, RadianceImage& frame) const {
  const Eigen::Isometry3d& pose = stillLife->sceneFromCamera();
  const Vector3d eye = pose.translation();
  // Where to look for it: the point of the ball, between eye and light, where both make the same
  // angle with the normal.
  const auto pixelFor = [&](const Vector3d& light) -> std::optional<Eigen::Vector2d> {
    const Vector3d a = (eye - ball->centre).normalized(), b = (light - ball->centre).normalized();
    const double whole = std::atan2(a.cross(b).norm(), a.dot(b));
    const Vector3d aside = (b - b.dot(a) * a).normalized();
    double low = 0, high = whole;
    Vector3d point;
    for (int i = 0; i < 40; ++i) {
      const double angle = 0.5 * (low + high);
      const Vector3d normal = std::cos(angle) * a + std::sin(angle) * aside;
      point = ball->centre + ball->radius * normal;
      const bool tooNear =
          normal.dot((eye - point).normalized()) > normal.dot((light - point).normalized());
      (tooNear ? low : high) = angle;
    }
    const Vector3f outside = (point + 1e-4 * (point - ball->centre) / ball->radius).cast<float>();
    if (stillLife->occluded(outside, light.cast<float>())) return std::nullopt;
    const Vector3d p = pose.inverse() * point;
    return Eigen::Vector2d(focal * p.x() / p.z() + kWidth / 2.0,
                           focal * p.y() / p.z() + kHeight / 2.0);
  };
  const auto begin = pixelFor(from), end = pixelFor(to);
  if (!begin || !end) return;

  // Rays on a fine grid around it; what they find is spread by the lens, so that no pixel's
  // saturation hides where it is.
  constexpr int kPerPixel = 16, kMarginPixels = 4, kReach = 4;
  constexpr double kBlurPixels = 0.5;
  const Eigen::Vector2d low = begin->cwiseMin(*end).array() - kMarginPixels;
  const Eigen::Vector2d high = begin->cwiseMax(*end).array() + kMarginPixels;
  const Vector3d towardsEye = eye - ball->centre;
  for (int j = static_cast<int>(std::floor(low.y() * kPerPixel)); j < high.y() * kPerPixel; ++j) {
    for (int i = static_cast<int>(std::floor(low.x() * kPerPixel)); i < high.x() * kPerPixel; ++i) {
      const double x = (i + 0.5) / kPerPixel, y = (j + 0.5) / kPerPixel;
      const Vector3d direction =
          (pose.linear() * Vector3d((x - kWidth / 2.0) / focal, (y - kHeight / 2.0) / focal, 1))
              .normalized();
      const double b = direction.dot(towardsEye);
      const double discriminant = b * b - towardsEye.squaredNorm() + ball->radius * ball->radius;
      if (discriminant <= 0) continue;
      const Vector3d point = eye + (-b - std::sqrt(discriminant)) * direction;
      const Vector3d normal = (point - ball->centre) / ball->radius;
      const Vector3d out = direction - 2 * direction.dot(normal) * normal;
      // Places in the exposure spread over the grid without order (Roberts 2018).
      const double when = 0.7548776662 * i + 0.5698402910 * j;
      const Vector3d light = from + (when - std::floor(when)) * (to - from) - point;
      if (out.dot(light) <= 0 || out.cross(light).norm() > radius) continue;

      const double m = std::pow(1 + direction.dot(normal), 5);
      const int column = static_cast<int>(std::floor(x)), row = static_cast<int>(std::floor(y));
      for (int v = std::max(row - kReach, 0); v <= std::min(row + kReach, kHeight - 1); ++v) {
        for (int u = std::max(column - kReach, 0); u <= std::min(column + kReach, kWidth - 1);
             ++u) {
          const double dx = u + 0.5 - x, dy = v + 0.5 - y;
          const double share = std::exp(-0.5 * (dx * dx + dy * dy) / (kBlurPixels * kBlurPixels)) /
                               (2 * std::numbers::pi * kBlurPixels * kBlurPixels) /
                               (kPerPixel * kPerPixel);
          for (int c = 0; c < 3; ++c) {
            const double chrome = 0.55 + 0.45 * m;
            frame(u, v, c) += static_cast<float>(share * chrome) * radiance[c];
          }
        }
      }
    }
  }
}

// Adds the lamp's light to `frame`.
void SceneView::Tableau::traceLamp(const LampState& lamp, const LampPoints& lampPoints,
                                   RadianceImage& frame) {
  const auto power = static_cast<float>(lamp.power);
  const Lamp centre{static_cast<float>(lamp.position.x()), static_cast<float>(lamp.position.y()),
                    static_cast<float>(lamp.position.z())};
  ShadowCaster caster(stillLife->embreeScene(), lampPoints);

  // First the corners of every tile, four tiles to a packet. Where they disagree, or differ from a
  // neighbour's, there is a shadow's edge, and it is worth all samples. Without the neighbours the
  // outer part of a penumbra shows the tiles' outline.
  for (std::size_t first = 0; first < tiles.size(); first += 4) {
    const std::size_t count = std::min<std::size_t>(4, tiles.size() - first);
    const auto seen = caster.castCorners(tiles.data() + first, count, centre);
    for (std::size_t k = 0; k < count; ++k) tileLight[tilePlaces[first + k]] = seen[k];
  }
  const auto atEdge = [&](int place) {
    const Light here = tileLight[static_cast<std::size_t>(place)];
    if (here == Light::kMixed) return true;
    const int x = place % kTileColumns, y = place / kTileColumns;
    const auto differs = [&](int nx, int ny) {
      if (nx < 0 || ny < 0 || nx >= kTileColumns || ny >= kTileRows) return false;
      const Light there = tileLight[static_cast<std::size_t>(ny * kTileColumns + nx)];
      return there != here && there != Light::kUnknown;
    };
    return differs(x - 1, y) || differs(x + 1, y) || differs(x, y - 1) || differs(x, y + 1);
  };

  alignas(64) float visible[kLanes];
  for (std::size_t k = 0; k < tiles.size(); ++k) {
    const auto place = tilePlaces[k];
    if (atEdge(static_cast<int>(place))) {
      caster.castTile(tiles[k], visible);
    } else {
      std::fill(std::begin(visible), std::end(visible),
                tileLight[place] == Light::kLit ? 1.0f : 0.0f);
    }
    addLight(tiles[k], centre, power, visible, frame);
  }
  for (const Block& b : loose) {
    caster.castLoose(b, visible);
    addLight(b, centre, power, visible, frame);
  }
}

void SceneView::Tableau::addLight(const Block& b, const Lamp& lamp, float power,
                                  const float* visible, RadianceImage& frame) {
  alignas(64) float radiance[3][kLanes];
  shade(b, lamp, visible, radiance);
  for (int i = 0; i < kLanes; ++i) {
    if (b.pixel[i] < 0) continue;
    float* out = frame.data() + 3 * static_cast<std::size_t>(b.pixel[i]);
    for (int c = 0; c < 3; ++c) out[c] += radiance[c][i] * power * kLampColour[c];
  }
}

SceneView::Tableau& SceneView::State::tableau(RigProgram program) {
  const auto prepared = [&](std::unique_ptr<Tableau>& place,
                            const std::shared_ptr<const StillLife>& things, const Effort& effort,
                            const std::optional<ChromeBall>& ball) -> Tableau& {
    if (!place) place = std::make_unique<Tableau>(things, room, effort, ball);
    return *place;
  };
  switch (program) {
    case RigProgram::kBoard:
      return prepared(ofTable, play->bareTable, kTableEffort, std::nullopt);
    case RigProgram::kMirrorBall:
      return prepared(ofBall, play->tableWithBall, kTableEffort, play->ball);
    default:
      return prepared(ofStillLife, stillLife, kStillLifeEffort, std::nullopt);
  }
}

void SceneView::State::showBoard(double programSeconds, double exposureSeconds) {
  const Tableau& table = tableau(RigProgram::kBoard);
  if (rays.directions.empty()) {
    const Eigen::Isometry3d& pose = table.stillLife->sceneFromCamera();
    rays.width = kWidth;
    rays.height = kHeight;
    rays.eye = pose.translation();
    for (int y = 0; y <= kHeight; ++y) {
      for (int x = 0; x <= kWidth; ++x) {
        const Vector3d inCamera((x - kWidth / 2.0) / table.focal, (y - kHeight / 2.0) / table.focal,
                                1);
        rays.directions.push_back((pose.linear() * inCamera).cast<float>());
      }
    }
  }
  constexpr double kBlurPixels = 0.5;
  drawBoard(play->board, rays, programSeconds - exposureSeconds / 2,
            programSeconds + exposureSeconds / 2, kBlurPixels, boardLayer);
  for (std::size_t i = 0; i < static_cast<std::size_t>(kWidth) * kHeight * 3; ++i) {
    frame.data()[i] = table.ambient.data()[i] + table.byWorkLight.data()[i];
  }
  for (int y = boardLayer.y0; y < boardLayer.y1; ++y) {
    for (int x = boardLayer.x0; x < boardLayer.x1; ++x) {
      const auto i = static_cast<std::size_t>(y * kWidth + x);
      for (int c = 0; c < 3; ++c) {
        frame(x, y, c) += boardLayer.light[i] - boardLayer.cover[i] * frame(x, y, c);
      }
    }
  }
}

SceneView::SceneView(std::shared_ptr<const StillLife> stillLife, const Room& room,
                     LampMotion& motion, std::uint32_t seed, const Play* play,
                     const SensorFlaws& flaws)
    : state_(std::make_unique<State>(std::move(stillLife), room, motion, seed, play, flaws)) {}
SceneView::~SceneView() = default;

double SceneView::focalLengthPixels() const {
  return kWidth / 2.0 / std::tan(state_->stillLife->horizontalField().radians() / 2);
}

const FlawedPixels& SceneView::pixels() const { return state_->pixels; }

const RadianceImage& SceneView::render(double timeSeconds, double exposureSeconds) {
  State& s = *state_;
  const auto [program, since] = s.programAt(timeSeconds);
  const std::size_t values = static_cast<std::size_t>(kWidth) * kHeight * 3;
  switch (program) {
    case RigProgram::kBoard:
      s.showBoard(timeSeconds - since, exposureSeconds);
      return s.frame;
    case RigProgram::kDiffuser:
      std::fill_n(s.frame.data(), values, kSceneDiffuserRadiance);
      return s.frame;
    case RigProgram::kDark:
      std::fill_n(s.frame.data(), values, 0.0f);
      return s.frame;
    case RigProgram::kStill:
      s.frame = s.tableau(program).ambient;
      return s.frame;
    case RigProgram::kLamp:
    case RigProgram::kMirrorBall:
      break;
  }
  Tableau& tableau = s.tableau(program);
  s.motion.advanceTo(timeSeconds + exposureSeconds / 2);
  const LampState lamp = s.motion.at(timeSeconds);
  s.frame = tableau.ambient;
  if (!lamp.lit) return s.frame;

  tableau.traceLamp(lamp, lampPointsAt(s.motion, timeSeconds, exposureSeconds), s.frame);
  if (tableau.ball) {
    // The walls that the lamp lights, evenly.
    for (std::size_t i = 0; i < tableau.roomInBall.size(); ++i) {
      const float light = kRoomBounce * static_cast<float>(lamp.power) * tableau.roomInBall[i];
      for (int c = 0; c < 3; ++c)
        s.frame.data()[3 * i + static_cast<std::size_t>(c)] += light * kLampColour[c];
    }
    constexpr double kLampRadiance =
        kLampDistanceMetres * kLampDistanceMetres / (kLampRadiusMetres * kLampRadiusMetres);
    tableau.addHighlight(s.motion.at(timeSeconds - exposureSeconds / 2).position,
                         s.motion.at(timeSeconds + exposureSeconds / 2).position, kLampRadiusMetres,
                         static_cast<float>(lamp.power * kLampRadiance) * kLampColour, s.frame);
  }
  return s.frame;
}

void SceneView::expose(const ExposureRequest& request, std::vector<std::uint8_t>& bytes) {
  State& s = *state_;
  const RadianceImage& image = render(request.timeSeconds, request.exposureSeconds);
  const auto exposure = static_cast<float>(kSignalPerSecond * request.exposureSeconds);
  const PixelFormatInfo& info = pixelFormatInfo(request.format);
  const Region& r = request.region;

  s.signal.clear();
  for (int y = r.y; y < r.y + r.height; ++y) {
    const auto row = image.row(y);
    for (int x = r.x; x < r.x + r.width; ++x) {
      const float* rgb = row.data() + 3 * x;
      if (info.isBayer) {
        s.signal.push_back(exposure * rgb[(x & 1) + (y & 1)]);  // R G / G B
      } else {
        for (int c = 0; c < 3; ++c) s.signal.push_back(exposure * rgb[c]);
      }
    }
  }
  bytes.resize(static_cast<std::size_t>(r.width) * static_cast<std::size_t>(r.height) *
               static_cast<std::size_t>(info.bytesPerPixel));
  s.pixels.collect(r, info.isBayer ? 1 : 3, request.exposureSeconds, s.signal);
  readOut(kSceneSensor, request.format, request.gainDb, hash64(request.index) + s.seed, s.signal,
          bytes.data(), s.pixels.response());
}

}  // namespace lightsketch
