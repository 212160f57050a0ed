// A good hash of 64 bits: SplitMix64's finaliser (Steele, Lea and Flood 2014). The same everywhere.
#pragma once

#include <cstdint>

namespace lightsketch {

inline std::uint64_t hash64(std::uint64_t x) {
  x += 0x9E3779B97F4A7C15u;
  x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9u;
  x = (x ^ (x >> 27)) * 0x94D049BB133111EBu;
  return x ^ (x >> 31);
}

}  // namespace lightsketch
