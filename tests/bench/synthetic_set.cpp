#include "tests/bench/synthetic_set.h"

#include <tbb/parallel_for.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>

namespace lightsketch {
namespace {

using Eigen::Vector3f;
constexpr float kPi = std::numbers::pi_v<float>;

struct Material {
  Vector3f albedo;
  float roughness;
  float reflectance;  // of the highlight, head-on
};

struct Sphere {
  Vector3f centre;
  float radius;
  Material material;
  bool mottled;
};

const std::array<Sphere, 10> kSpheres = {{
    {{0, 0, 1}, 1, {{0.8f, 0.15f, 0.1f}, 0.15f, 0.06f}, true},
    {{-2.1f, 0.6f, 0.7f}, 0.7f, {{0.1f, 0.3f, 0.8f}, 0.3f, 0.04f}, false},
    {{1.9f, -0.9f, 0.6f}, 0.6f, {{0.7f, 0.6f, 0.2f}, 0.08f, 0.5f}, false},
    {{0.9f, 1.9f, 0.85f}, 0.85f, {{0.75f, 0.75f, 0.75f}, 0.5f, 0.04f}, true},
    {{-1.2f, -1.5f, 0.45f}, 0.45f, {{0.1f, 0.7f, 0.2f}, 0.2f, 0.05f}, false},
    {{2.8f, 1.2f, 0.5f}, 0.5f, {{0.6f, 0.2f, 0.6f}, 0.1f, 0.06f}, false},
    {{-3.2f, -0.9f, 0.4f}, 0.4f, {{0.9f, 0.5f, 0.2f}, 0.25f, 0.2f}, false},
    {{0.3f, -1.9f, 0.3f}, 0.3f, {{0.9f, 0.9f, 0.9f}, 0.05f, 0.8f}, false},
    {{-1, 2.6f, 0.5f}, 0.5f, {{0.3f, 0.6f, 0.6f}, 0.35f, 0.05f}, false},
    {{0.2f, -0.2f, 2.35f}, 0.35f, {{0.8f, 0.8f, 0.2f}, 0.2f, 0.05f}, false},
}};
constexpr float kGround = -1;  // in place of a sphere's number

// --- The ground -------------------------------------------------------------------------------

std::uint32_t hashOf(int x, int y) {
  std::uint32_t h =
      static_cast<std::uint32_t>(x) * 374761393u + static_cast<std::uint32_t>(y) * 668265263u;
  h = (h ^ (h >> 13)) * 1274126177u;
  return h ^ (h >> 16);
}
float unitHash(int x, int y) { return static_cast<float>(hashOf(x, y) >> 8) / 16777216.0f; }

// Smooth noise, 0 to 1, of wavelength 1.
float noise(float x, float y) {
  const int ix = static_cast<int>(std::floor(x));
  const int iy = static_cast<int>(std::floor(y));
  const auto smooth = [](float t) { return t * t * (3 - 2 * t); };
  const float fx = smooth(x - static_cast<float>(ix));
  const float fy = smooth(y - static_cast<float>(iy));
  return std::lerp(std::lerp(unitHash(ix, iy), unitHash(ix + 1, iy), fx),
                   std::lerp(unitHash(ix, iy + 1), unitHash(ix + 1, iy + 1), fx), fy);
}

// Cobbles, each around a jittered point of a grid, and bumps.
float groundHeight(float x, float y) {
  const float cx = 1.6f * x;
  const float cy = 1.6f * y;
  const int ix = static_cast<int>(std::floor(cx));
  const int iy = static_cast<int>(std::floor(cy));
  float nearest = 9;
  for (int j = iy - 1; j <= iy + 1; ++j) {
    for (int i = ix - 1; i <= ix + 1; ++i) {
      const float dx = static_cast<float>(i) + 0.2f + 0.6f * unitHash(i, j) - cx;
      const float dy = static_cast<float>(j) + 0.2f + 0.6f * unitHash(j + 77, i) - cy;
      nearest = std::min(nearest, dx * dx + dy * dy);
    }
  }
  return 0.1f * std::sqrt(std::max(0.0f, 1 - 2.2f * nearest) + 0.02f) +
         0.04f * noise(3 * x, 3 * y) + 0.01f * noise(9 * x, 9 * y);
}

// groundHeight, sampled once over all the camera sees and what may shade it.
class GroundTable {
 public:
  GroundTable() : heights_(static_cast<std::size_t>(kColumns) * kRows) {
    tbb::parallel_for(0, kRows, [&](int row) {
      for (int column = 0; column < kColumns; ++column) {
        heights_[index(column, row)] = groundHeight(kLeft + kStep * static_cast<float>(column),
                                                    kFront + kStep * static_cast<float>(row));
      }
    });
  }
  float at(float x, float y) const {
    const float u = std::clamp((x - kLeft) / kStep, 0.0f, kColumns - 1.001f);
    const float v = std::clamp((y - kFront) / kStep, 0.0f, kRows - 1.001f);
    const int column = static_cast<int>(u);
    const int row = static_cast<int>(v);
    const float fu = u - static_cast<float>(column);
    const float fv = v - static_cast<float>(row);
    const float* const h = heights_.data() + index(column, row);
    const float near = h[0] + fu * (h[1] - h[0]);
    const float far = h[kColumns] + fu * (h[kColumns + 1] - h[kColumns]);
    return near + fv * (far - near);
  }

 private:
  static constexpr float kStep = 0.02f;
  static constexpr float kLeft = -13;
  static constexpr float kFront = -5;
  static constexpr int kColumns = 1300;
  static constexpr int kRows = 1100;
  static std::size_t index(int column, int row) {
    return static_cast<std::size_t>(row) * kColumns + static_cast<std::size_t>(column);
  }
  std::vector<float> heights_;
};

}  // namespace

// --- What the camera sees ---------------------------------------------------------------------

// Per pixel, a plane of numbers each, so that shading is loops over arrays. The horizon is that of
// the ground alone; spheres are tested for each light.
struct SyntheticScene::Surface {
  static constexpr int kAzimuths = 64;
  static constexpr float kHorizonScale = 4096;  // of slopes, in int16

  int width;
  int height;
  std::size_t pixels;
  std::vector<float> x, y, z;     // the point
  std::vector<float> nx, ny, nz;  // its normal
  std::vector<float> vx, vy, vz;  // towards the camera
  std::vector<float> red, green, blue, alpha, reflectance;
  std::vector<float> sphere;                                 // its number, or kGround
  std::array<std::vector<std::int16_t>, kAzimuths> horizon;  // steepest slope, per azimuth

  Surface(int w, int h)
      : width(w), height(h), pixels(static_cast<std::size_t>(w) * static_cast<std::size_t>(h)) {
    for (auto* plane : {&x, &y, &z, &nx, &ny, &nz, &vx, &vy, &vz, &red, &green, &blue, &alpha,
                        &reflectance, &sphere}) {
      plane->resize(pixels);
    }
    for (auto& plane : horizon) plane.resize(pixels);
    const GroundTable ground;
    tbb::parallel_for(0, height, [&](int row) {
      for (int column = 0; column < width; ++column) see(column, row, ground);
    });
  }

 private:
  void see(int column, int row, const GroundTable& ground) {
    static const Vector3f eye(0, -7.5f, 5.2f);
    static const Vector3f forward = (Vector3f(0, 0.1f, 0.55f) - eye).normalized();
    static const Vector3f right = forward.cross(Vector3f::UnitZ()).normalized();
    static const Vector3f up = right.cross(forward);
    const float scale = 0.66f / static_cast<float>(height);
    const float right01 =
        (static_cast<float>(column) + 0.5f - 0.5f * static_cast<float>(width)) * scale;
    const float up01 = (0.5f * static_cast<float>(height) - static_cast<float>(row) - 0.5f) * scale;
    const Vector3f ray = (forward + right * right01 + up * up01).normalized();

    // The first sphere, if any.
    float distance = 1e9f;
    int hit = -1;
    for (int s = 0; s < static_cast<int>(kSpheres.size()); ++s) {
      const auto& ball = kSpheres[static_cast<std::size_t>(s)];
      const Vector3f from = eye - ball.centre;
      const float b = from.dot(ray);
      const float q = b * b - from.squaredNorm() + ball.radius * ball.radius;
      if (q > 0 && -b - std::sqrt(q) < distance) {
        distance = -b - std::sqrt(q);
        hit = s;
      }
    }
    // The ground, from a height above all of it: steps, then bisection.
    float below = (0.4f - eye.z()) / ray.z();
    float above = below;
    const auto isBelow = [&](float t) {
      const Vector3f p = eye + t * ray;
      return p.z() < ground.at(p.x(), p.y());
    };
    while (below < distance && !isBelow(below)) {
      above = below;
      below += 0.006f;
    }
    Vector3f point, normal;
    Material material;
    if (below < distance) {
      for (int step = 0; step < 8; ++step) {
        const float middle = 0.5f * (below + above);
        (isBelow(middle) ? below : above) = middle;
      }
      hit = -1;
      point = eye + below * ray;
      const float px = point.x();
      const float py = point.y();
      constexpr float kEps = 0.004f;
      const float slopeX = (groundHeight(px + kEps, py) - groundHeight(px - kEps, py)) / (2 * kEps);
      const float slopeY = (groundHeight(px, py + kEps) - groundHeight(px, py - kEps)) / (2 * kEps);
      normal = Vector3f(-slopeX, -slopeY, 1).normalized();
      const float grain =
          0.25f + 0.5f * noise(2 * px + 40, 2 * py) + 0.15f * noise(30 * px, 30 * py);
      const float hue = noise(0.8f * px + 9, 0.8f * py - 3);
      material = {grain * Vector3f(0.55f + 0.35f * hue, 0.6f, 0.6f - 0.3f * hue), 0.55f, 0.03f};
    } else {
      const auto& ball = kSpheres[static_cast<std::size_t>(hit)];
      point = eye + distance * ray;
      normal = (point - ball.centre) / ball.radius;
      material = ball.material;
      if (ball.mottled) {
        material.albedo *=
            0.6f + 0.5f * noise(8 * normal.x() + 20, 8 * normal.z() + 5 * normal.y());
      }
    }

    const std::size_t i = static_cast<std::size_t>(row) * static_cast<std::size_t>(width) +
                          static_cast<std::size_t>(column);
    x[i] = point.x(), y[i] = point.y(), z[i] = point.z();
    nx[i] = normal.x(), ny[i] = normal.y(), nz[i] = normal.z();
    vx[i] = -ray.x(), vy[i] = -ray.y(), vz[i] = -ray.z();
    red[i] = material.albedo.x(), green[i] = material.albedo.y(), blue[i] = material.albedo.z();
    alpha[i] = material.roughness * material.roughness;
    reflectance[i] = material.reflectance;
    sphere[i] = hit < 0 ? kGround : static_cast<float>(hit);
    for (int a = 0; a < kAzimuths; ++a) {
      float slope = -7;  // nothing in the way
      if (hit < 0) {
        const float angle = 2 * kPi * static_cast<float>(a) / kAzimuths;
        const float cosine = std::cos(angle);
        const float sine = std::sin(angle);
        for (float far = 0.02f; far < 1.2f; far *= 1.2f) {
          const float rise =
              ground.at(point.x() + cosine * far, point.y() + sine * far) - point.z();
          slope = std::max(slope, rise / far);
        }
      }
      horizon[static_cast<std::size_t>(a)][i] =
          static_cast<std::int16_t>(std::lround(kHorizonScale * std::clamp(slope, -7.0f, 7.0f)));
    }
  }
};

namespace {

// From 0 at -1/2 to 1 at 1/2.
inline float shade(float t) {
  t += 0.5f;
  t = t > 0 ? t : 0;
  t = t < 1 ? t : 1;
  return t * t * (3 - 2 * t);
}

}  // namespace

SyntheticScene::SyntheticScene(int width, int height)
    : surface_(std::make_shared<const Surface>(width, height)) {}
int SyntheticScene::width() const { return surface_->width; }
int SyntheticScene::height() const { return surface_->height; }

RadianceImage SyntheticScene::picture(const Eigen::Vector3d& light) const {
  const Surface& s = *surface_;
  const float lx = static_cast<float>(light.x());
  const float ly = static_cast<float>(light.y());
  const float lz = static_cast<float>(light.z());
  const float lampWidth = std::tan(2.5f * kPi / 180);  // across the lamp
  const float level = std::max(1e-4f, std::hypot(lx, ly));
  const float lampSlope = lz / level;
  const float slopeWidth = lampWidth * (1 + lampSlope * lampSlope);
  float azimuth = std::atan2(ly, lx) * Surface::kAzimuths / (2 * kPi);
  azimuth += azimuth < 0 ? static_cast<float>(Surface::kAzimuths) : 0;
  const int before = static_cast<int>(azimuth) % Surface::kAzimuths;
  const float after = (azimuth - std::floor(azimuth)) / Surface::kHorizonScale;
  const float until = 1 / Surface::kHorizonScale - after;
  const auto* const horizon0 = s.horizon[static_cast<std::size_t>(before)].data();
  const auto* const horizon1 =
      s.horizon[static_cast<std::size_t>((before + 1) % Surface::kAzimuths)].data();

  RadianceImage result(s.width, s.height, 3);
  constexpr std::size_t kStrip = 256;
  std::array<float, kStrip> visible, red, green, blue;
  for (std::size_t first = 0; first < s.pixels; first += kStrip) {
    const std::size_t count = std::min(kStrip, s.pixels - first);
    // Shadows that the ground throws on itself.
    for (std::size_t k = 0; k < count; ++k) {
      const std::size_t i = first + k;
      const float slope =
          until * static_cast<float>(horizon0[i]) + after * static_cast<float>(horizon1[i]);
      visible[k] = shade((lampSlope - slope) / (2 * slopeWidth));
    }
    // Shadows of spheres: how far the ray to the lamp passes from the centre, against the
    // half-shadow at that distance.
    for (std::size_t b = 0; b < kSpheres.size(); ++b) {
      const float cx = kSpheres[b].centre.x();
      const float cy = kSpheres[b].centre.y();
      const float cz = kSpheres[b].centre.z();
      const float radius = kSpheres[b].radius;
      const float own = static_cast<float>(b);
      for (std::size_t k = 0; k < count; ++k) {
        const std::size_t i = first + k;
        const float dx = cx - s.x[i];
        const float dy = cy - s.y[i];
        const float dz = cz - s.z[i];
        const float along = dx * lx + dy * ly + dz * lz;
        const float aside2 = dx * dx + dy * dy + dz * dz - along * along;
        const float aside = std::sqrt(aside2 > 0 ? aside2 : 0);
        const float halfShadow = lampWidth * (along > 0.02f ? along : 0.02f);
        float seen = shade((aside - radius) / (2 * halfShadow));
        seen = along > 0 ? seen : 1;
        seen = s.sphere[i] == own ? 1 : seen;
        visible[k] *= seen;
      }
    }
    // Lambert's law, a little light from all around, and GGX highlights (Walter et al. 2007) with
    // Schlick's Fresnel and masking terms.
    for (std::size_t k = 0; k < count; ++k) {
      const std::size_t i = first + k;
      const float nx = s.nx[i], ny = s.ny[i], nz = s.nz[i];
      const float vx = s.vx[i], vy = s.vy[i], vz = s.vz[i];
      const float cosine = nx * lx + ny * ly + nz * lz;
      const float nl = cosine > 0 ? cosine : 0;
      float hx = lx + vx, hy = ly + vy, hz = lz + vz;
      const float normalise = 1 / std::sqrt(hx * hx + hy * hy + hz * hz);
      hx *= normalise, hy *= normalise, hz *= normalise;
      float nh = nx * hx + ny * hy + nz * hz;
      nh = nh > 0 ? nh : 0;
      float nv = nx * vx + ny * vy + nz * vz;
      nv = nv > 0.05f ? nv : 0.05f;
      const float a2 = s.alpha[i] * s.alpha[i] + 4e-4f;  // the lamp's size blurs even mirrors
      const float lobe = nh * nh * (a2 - 1) + 1;
      const float distribution = a2 / (kPi * lobe * lobe);
      const float graze = 1 - (vx * hx + vy * hy + vz * hz);
      const float graze2 = graze * graze;
      const float fresnel = s.reflectance[i] + (1 - s.reflectance[i]) * graze2 * graze2 * graze;
      const float mask = 0.5f * s.alpha[i] + 0.05f;
      const float masking = 0.25f / ((nv * (1 - mask) + mask) * (nl * (1 - mask) + mask));
      float highlight = fresnel * distribution * masking * nl * kPi * visible[k];
      highlight = highlight < 3 ? highlight : 3;
      const float around =
          0.03f * lz + 0.02f * (0.5f + 0.5f * cosine) + 0.02f * (0.5f - 0.5f * nz) * lz;
      const float matte = nl * visible[k] + around;
      red[k] = s.red[i] * matte + highlight;
      green[k] = s.green[i] * matte + highlight;
      blue[k] = s.blue[i] * matte + highlight;
    }
    float* out = result.data() + 3 * first;
    for (std::size_t k = 0; k < count; ++k) {
      *out++ = red[k];
      *out++ = green[k];
      *out++ = blue[k];
    }
  }
  return result;
}

std::vector<Eigen::Vector3d> hemisphereDirections(int side, double offset) {
  constexpr double kQuarter = std::numbers::pi / 4;
  const double lowest = std::cos(85 * std::numbers::pi / 180);
  const int count = offset < 1 ? side : side - 1;
  std::vector<Eigen::Vector3d> directions;
  for (int row = 0; row < count; ++row) {
    for (int column = 0; column < count; ++column) {
      // From the square to the disc, ring by ring, and up to the sphere.
      const double a = 2 * (column + offset) / side - 1;
      const double b = 2 * (row + offset) / side - 1;
      const bool sideways = std::abs(a) > std::abs(b);
      const double radius = sideways ? a : b;
      const double angle = sideways ? kQuarter * b / a
                           : b == 0 ? 0
                                    : 2 * kQuarter - kQuarter * a / b;
      const double z = 1 - radius * radius * (1 - lowest);
      const double level = std::copysign(std::sqrt(1 - z * z), radius);
      directions.emplace_back(level * std::cos(angle), level * std::sin(angle), z);
    }
  }
  return directions;
}

LightStack syntheticStack(const SyntheticScene& scene, std::vector<Eigen::Vector3d> lights) {
  return LightStack::of(scene.width(), scene.height(), lights,
                        [scene, lights](int i) -> Result<RadianceImage> {
                          return scene.picture(lights[static_cast<std::size_t>(i)]);
                        });
}

}  // namespace lightsketch
