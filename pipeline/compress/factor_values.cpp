#include "pipeline/compress/factor_values.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <new>
#include <utility>

#include "pipeline/compress/large_pages.h"

namespace lightsketch {
namespace {

// Saturates at +-limit, which int8 and int16 reach on both sides.
template <class T>
T rounded(float value) {
  constexpr float limit = static_cast<float>(std::numeric_limits<T>::max());
  return static_cast<T>(std::lround(std::clamp(value, -limit, limit)));
}

}  // namespace

std::size_t bytesOf(ElementType type) {
  switch (type) {
    case ElementType::kFloat32:
      return 4;
    case ElementType::kFloat16:
    case ElementType::kInt16:
      return 2;
    case ElementType::kInt8:
      return 1;
  }
  return 0;
}

void FactorValues::Unmap::operator()(std::byte* memory) const { unmapPages(memory, bytes); }

FactorValues::FactorValues(ElementType type, std::size_t count) : type_(type), count_(count) {
  if (count > std::numeric_limits<std::size_t>::max() / 16) throw std::bad_alloc();
  const std::size_t needed = bytes() + kPadding;
  memory_ =
      std::unique_ptr<std::byte[], Unmap>(static_cast<std::byte*>(mapPages(needed)), Unmap(needed));
}

FactorValues::FactorValues(const FactorValues& other) {
  if (!other.memory_) return;
  *this = FactorValues(other.type_, other.count_);
  std::memcpy(data(), other.data(), other.bytes());
}

FactorValues& FactorValues::operator=(const FactorValues& other) {
  if (this != &other) *this = FactorValues(other);
  return *this;
}

float FactorValues::at(std::size_t i) const {
  switch (type_) {
    case ElementType::kFloat32:
      return as<float>()[i];
    case ElementType::kFloat16:
      return static_cast<float>(as<Eigen::half>()[i]);
    case ElementType::kInt8:
      return static_cast<float>(as<std::int8_t>()[i]);
    case ElementType::kInt16:
      return static_cast<float>(as<std::int16_t>()[i]);
  }
  return 0;
}

void FactorValues::set(std::size_t i, float value) {
  constexpr float kLargestHalf = 65504;
  switch (type_) {
    case ElementType::kFloat32:
      as<float>()[i] = value;
      break;
    case ElementType::kFloat16:
      as<Eigen::half>()[i] =
          static_cast<Eigen::half>(std::clamp(value, -kLargestHalf, kLargestHalf));
      break;
    case ElementType::kInt8:
      as<std::int8_t>()[i] = rounded<std::int8_t>(value);
      break;
    case ElementType::kInt16:
      as<std::int16_t>()[i] = rounded<std::int16_t>(value);
      break;
  }
}

}  // namespace lightsketch
