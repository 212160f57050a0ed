#include "capture/rig/room.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

#include "capture/rig/noise.h"

namespace lightsketch {
namespace {

using Eigen::Vector3f;

const Vector3f kLow(-2.1f, -1.9f, -0.78f);  // z = 0 is just above the table top
const Vector3f kHigh(2.3f, 2.0f, 1.65f);

const Vector3f kWallPaint(0.62f, 0.58f, 0.50f);
const Vector3f kCeilingPaint(0.78f, 0.77f, 0.74f);
const Vector3f kFloorWood(0.22f, 0.15f, 0.10f);

// The window is in the wall y = kHigh.y(), the picture in the wall x = kLow.x().
constexpr float kWindowLeft = -0.95f, kWindowRight = 0.55f, kWindowBottom = 0.05f,
                kWindowTop = 1.25f;
constexpr float kPictureFront = -0.75f, kPictureBack = 0.25f, kPictureBottom = 0.25f,
                kPictureTop = 1.0f;

struct Ellipsoid {
  Vector3f centre, radii;
};
const Ellipsoid kBystander[] = {{{-0.05f, -1.30f, 0.42f}, {0.10f, 0.11f, 0.14f}},    // head
                                {{-0.05f, -1.35f, -0.12f}, {0.24f, 0.14f, 0.42f}}};  // trunk

bool inside(float value, float low, float high) { return value > low && value < high; }

// Daylight through the panes: bright sky above, a dark hedge below; frame and bars are wood.
void shadeWindow(float x, float z, RoomHit& hit) {
  const float u = (x - kWindowLeft) / (kWindowRight - kWindowLeft);
  const float v = (z - kWindowBottom) / (kWindowTop - kWindowBottom);
  const float bar = 0.02f;
  const bool frame = u < bar || u > 1 - bar || v < bar || v > 1 - bar ||
                     std::abs(u - 1 / 3.0f) < bar / 2 || std::abs(u - 2 / 3.0f) < bar / 2 ||
                     std::abs(v - 0.55f) < bar / 2;
  if (frame) {
    hit.albedo = Vector3f(0.7f, 0.7f, 0.68f);
    hit.radiance = 0.03f * hit.albedo;
    return;
  }
  hit.albedo.setZero();
  const float hedge = 0.36f + 0.10f * fractalNoise({6 * u, 3.0f, 1.7f}, 4);
  const float leaves = 0.6f + 0.8f * fractalNoise({40 * u, 40 * v, 0.3f}, 3);
  const float sky = 0.12f + 0.24f * v + 0.10f * fractalNoise({3 * u, 5 * v, 7.0f}, 4);
  hit.radiance = v < hedge ? Vector3f(0.035f * leaves * Vector3f(0.7f, 1.0f, 0.5f))
                           : Vector3f(sky * Vector3f(0.85f, 0.95f, 1.1f));
}

// A framed landscape behind glass.
void shadePicture(float y, float z, RoomHit& hit) {
  const float u = (y - kPictureFront) / (kPictureBack - kPictureFront);
  const float v = (z - kPictureBottom) / (kPictureTop - kPictureBottom);
  if (u < 0.05f || u > 0.95f || v < 0.065f || v > 0.935f) {
    hit.albedo = Vector3f(0.10f, 0.06f, 0.03f);
  } else if (u < 0.15f || u > 0.85f || v < 0.19f || v > 0.81f) {
    hit.albedo = Vector3f(0.8f, 0.79f, 0.75f);
  } else {
    const float hill = 0.45f + 0.2f * fractalNoise({4 * u, 0.5f, 0.9f}, 3);
    const float tone = fractalNoise({12 * u, 12 * v, 4.2f}, 4);
    hit.albedo = v < hill ? Vector3f((0.18f + 0.2f * tone) * Vector3f(0.7f, 0.9f, 0.4f))
                          : Vector3f((0.5f + 0.2f * tone) * Vector3f(0.7f, 0.85f, 1.0f));
  }
}

// Light that the surfaces get from window, panels and each other, smooth by construction: enough
// for walls that are only background.
float roomIrradiance(const Vector3f& p) {
  const float fromPanels = 0.020f * (1 + 0.35f * (p.z() - kLow.z()) / (kHigh.z() - kLow.z()));
  const Vector3f window(-0.2f, kHigh.y(), 0.65f);
  return fromPanels + 0.03f / (1 + 1.3f * (p - window).squaredNorm());
}

}  // namespace

Room::Room()
    : panes_{{1, kHigh.y(), {kWindowLeft, 0, kWindowBottom}, {kWindowRight, 0, kWindowTop}},
             {0, kLow.x(), {0, kPictureFront, kPictureBottom}, {0, kPictureBack, kPictureTop}}},
      spots_{{{1.15f, 0.75f, 1.62f}, 0.026f, 70},
             {{1.15f, -0.55f, 1.62f}, 0.026f, 70},
             {{-1.25f, -0.60f, 1.62f}, 0.026f, 70}},
      panels_{{{-0.45f, 0.50f, kHigh.z()}, {0.15f, 0.74f, kHigh.z()}, 1.4f}} {}

RoomHit Room::trace(const Vector3f& origin, const Vector3f& direction) const {
  RoomHit hit;
  // The box seen from inside: the nearest of the three planes that the ray runs towards.
  float nearest = std::numeric_limits<float>::max();
  int axis = 0;
  for (int i = 0; i < 3; ++i) {
    if (std::abs(direction[i]) < 1e-9f) continue;
    const float t = ((direction[i] > 0 ? kHigh[i] : kLow[i]) - origin[i]) / direction[i];
    if (t < nearest) {
      nearest = t;
      axis = i;
    }
  }
  hit.normal = Vector3f::Zero();
  hit.normal[axis] = direction[axis] > 0 ? -1.0f : 1.0f;
  hit.radiance.setZero();

  // Somebody stands in front of the wall.
  for (const auto& part : kBystander) {
    const Vector3f o = (origin - part.centre).cwiseQuotient(part.radii);
    const Vector3f d = direction.cwiseQuotient(part.radii);
    const float a = d.squaredNorm(), b = o.dot(d), c = o.squaredNorm() - 1;
    const float discriminant = b * b - a * c;
    if (discriminant <= 0) continue;
    const float t = (-b - std::sqrt(discriminant)) / a;
    if (t <= 0 || t >= nearest) continue;
    nearest = t;
    axis = -1;
    hit.position = origin + t * direction;
    hit.normal = (hit.position - part.centre).cwiseQuotient(part.radii.cwiseProduct(part.radii));
    hit.normal.normalize();
    hit.albedo = Vector3f(0.09f, 0.08f, 0.08f);
  }
  if (axis < 0) {
    hit.radiance = roomIrradiance(hit.position) * hit.albedo;
    return hit;
  }

  hit.position = origin + nearest * direction;
  const Vector3f& p = hit.position;
  if (axis == 2) {
    if (direction.z() > 0) {
      hit.albedo = kCeilingPaint;
      for (const auto& panel : panels_) {
        if (inside(p.x(), panel.low.x(), panel.high.x()) &&
            inside(p.y(), panel.low.y(), panel.high.y())) {
          hit.albedo.setZero();
          hit.radiance = panel.radiance * Vector3f(1, 0.98f, 0.92f);
          return hit;
        }
      }
    } else {
      hit.albedo = kFloorWood * (0.8f + 0.5f * fractalNoise({2 * p.x(), 22 * p.y(), 0.5f}, 3));
    }
  } else {
    hit.albedo = kWallPaint * (0.96f + 0.08f * fractalNoise(9 * p, 3));
    // Skirting board, and a darker field of wallpaper below the rail.
    if (p.z() < kLow.z() + 0.12f)
      hit.albedo = Vector3f(0.5f, 0.48f, 0.44f);
    else if (p.z() < -0.05f)
      hit.albedo *= 0.6f;
    if (axis == 1 && direction.y() > 0 && inside(p.x(), kWindowLeft, kWindowRight) &&
        inside(p.z(), kWindowBottom, kWindowTop)) {
      shadeWindow(p.x(), p.z(), hit);
      return hit;
    }
    if (axis == 0 && direction.x() < 0 && inside(p.y(), kPictureFront, kPictureBack) &&
        inside(p.z(), kPictureBottom, kPictureTop)) {
      shadePicture(p.y(), p.z(), hit);
    }
  }
  hit.radiance = roomIrradiance(p) * hit.albedo;
  return hit;
}

}  // namespace lightsketch
