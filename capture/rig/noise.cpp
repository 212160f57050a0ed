#include "capture/rig/noise.h"

#include <cmath>

namespace lightsketch {
namespace {

float valueNoise(const Eigen::Vector3f& p) {
  const Eigen::Vector3f cell = p.array().floor();
  Eigen::Vector3f f = p - cell;
  f = f.array() * f.array() * (3 - 2 * f.array());  // smoothstep: continuous slope
  const auto corner = [&](int dx, int dy, int dz) {
    const auto lattice = [](float v) {
      return static_cast<std::uint64_t>(static_cast<std::int64_t>(v) + (1 << 20));
    };
    return uniformFromHash(lattice(cell.x() + static_cast<float>(dx)) |
                           lattice(cell.y() + static_cast<float>(dy)) << 21 |
                           lattice(cell.z() + static_cast<float>(dz)) << 42);
  };
  const auto mix = [](float a, float b, float t) { return a + t * (b - a); };
  const auto face = [&](int dz) {
    return mix(mix(corner(0, 0, dz), corner(1, 0, dz), f.x()),
               mix(corner(0, 1, dz), corner(1, 1, dz), f.x()), f.y());
  };
  return mix(face(0), face(1), f.z());
}

}  // namespace

float fractalNoise(const Eigen::Vector3f& p, int octaves) {
  float sum = 0, weight = 1, total = 0;
  Eigen::Vector3f q = p;
  for (int i = 0; i < octaves; ++i) {
    sum += weight * valueNoise(q);
    total += weight;
    weight *= 0.5f;
    q = 2.03f * q + Eigen::Vector3f(11.7f, 5.3f, 3.1f);  // octaves must not line up
  }
  return sum / total;
}

}  // namespace lightsketch
