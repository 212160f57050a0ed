// The lens equation itself, for the model and for the solver that differentiates it.
#pragma once

#include <cmath>

namespace lightsketch {

// Where each parameter stands in a parameter vector.
struct FisheyeLayout {
  static constexpr int kFocal = 0;        // fx, fy
  static constexpr int kCentre = 2;       // cx, cy
  static constexpr int kRadial = 4;       // k0 .. k5
  static constexpr int kTangential = 10;  // p0, p1
  static constexpr int kPrism = 12;       // s0 .. s3
  static constexpr int kPupil = 16;       // a, b in metres
  static constexpr int kCount = 18;
};

// A direction of any length but 0 to a pixel; T is double or a Ceres jet. Smooth on the axis too.
template <class T>
void projectFisheyeDirection(const T* parameters, const T* direction, T* pixel) {
  using std::atan2;
  using std::sqrt;
  const T* k = parameters + FisheyeLayout::kRadial;
  const T* p = parameters + FisheyeLayout::kTangential;
  const T* s = parameters + FisheyeLayout::kPrism;
  const T radius2 = direction[0] * direction[0] + direction[1] * direction[1];
  const T& z = direction[2];
  T scale;  // d(theta) / radius
  // Near the axis theta = r/z - (r/z)^3 / 3: a square root has no derivative at 0.
  if (z > T(0) && radius2 < T(1e-10) * z * z) {
    const T t2 = radius2 / (z * z);
    scale = (T(1) + t2 * (k[0] - T(1.0 / 3))) / z;
  } else {
    const T radius = sqrt(radius2);
    const T theta = atan2(radius, z);
    const T t2 = theta * theta;
    scale =
        theta / radius *
        (T(1) + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * (k[3] + t2 * (k[4] + t2 * k[5]))))));
  }
  const T x = scale * direction[0];
  const T y = scale * direction[1];
  const T r2 = x * x + y * y;
  const T xd = x + T(2) * p[0] * x * y + p[1] * (r2 + T(2) * x * x) + r2 * (s[0] + r2 * s[1]);
  const T yd = y + p[0] * (r2 + T(2) * y * y) + T(2) * p[1] * x * y + r2 * (s[2] + r2 * s[3]);
  pixel[0] = parameters[FisheyeLayout::kFocal] * xd + parameters[FisheyeLayout::kCentre];
  pixel[1] = parameters[FisheyeLayout::kFocal + 1] * yd + parameters[FisheyeLayout::kCentre + 1];
}

// A point in metres, camera frame. The ray that the lens makes a pixel of passes through
// (0, 0, a theta^2 + b theta^4), theta being the ray's own angle.
template <class T>
void projectFisheyePoint(const T* parameters, const T* point, T* pixel) {
  using std::atan2;
  using std::sqrt;
  T ray[3] = {point[0], point[1], point[2]};
  const T& a = parameters[FisheyeLayout::kPupil];
  const T& b = parameters[FisheyeLayout::kPupil + 1];
  const T radius2 = point[0] * point[0] + point[1] * point[1];
  if (radius2 > T(0)) {
    // The shift is millimetres: each round gains a factor of distance over shift.
    const T radius = sqrt(radius2);
    for (int round = 0; round < 3; ++round) {
      const T theta = atan2(radius, ray[2]);
      const T t2 = theta * theta;
      ray[2] = point[2] - t2 * (a + t2 * b);
    }
  }
  projectFisheyeDirection(parameters, ray, pixel);
}

}  // namespace lightsketch
