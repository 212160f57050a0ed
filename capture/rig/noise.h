// Deterministic noise: hashes for solid textures and per-frame sensor noise.
#pragma once

#include <Eigen/Core>
#include <cstdint>

namespace lightsketch {

// SplitMix64's finaliser (Steele, Lea and Flood 2014): a good hash of 64 bits.
inline std::uint64_t hash64(std::uint64_t x) {
  x += 0x9E3779B97F4A7C15u;
  x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9u;
  x = (x ^ (x >> 27)) * 0x94D049BB133111EBu;
  return x ^ (x >> 31);
}
inline float uniformFromHash(std::uint64_t x) {
  return static_cast<float>(hash64(x) >> 40) * 0x1p-24f;
}

// Smooth value noise with period-1 lattice, in 0..1, summed over octaves of halving weight.
float fractalNoise(const Eigen::Vector3f& p, int octaves);

}  // namespace lightsketch
