// Deterministic noise: hashes for solid textures and per-frame sensor noise.
#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "capture/frame/hash64.h"

namespace lightsketch {

inline float uniformFromHash(std::uint64_t x) {
  return static_cast<float>(hash64(x) >> 40) * 0x1p-24f;
}

// Smooth value noise with period-1 lattice, in 0..1, summed over octaves of halving weight.
float fractalNoise(const Eigen::Vector3f& p, int octaves);

}  // namespace lightsketch
