// Bytes as choices. When they run out, every choice is the normal one.
#pragma once

#include <cstdint>
#include <cstring>
#include <initializer_list>
#include <string>
#include <string_view>

namespace lightsketch::fuzz {

class Choices {
 public:
  explicit Choices(std::string_view bytes) : bytes_(bytes) {}

  std::uint8_t byte() {
    if (bytes_.empty()) return 0;
    const auto value = static_cast<std::uint8_t>(bytes_.front());
    bytes_.remove_prefix(1);
    return value;
  }
  // Three times out of four what it should be.
  bool hostile() { return byte() >= 192; }

  template <class T>
  T pick(T normal, std::initializer_list<T> others) {
    if (!hostile()) return normal;
    return others.begin()[byte() % others.size()];
  }
  template <class T>
  T oneOf(std::initializer_list<T> all) {
    return all.begin()[byte() % all.size()];
  }

  std::int64_t integer(std::int64_t normal) {
    if (!hostile()) return normal;
    const auto kind = byte() % 10;
    constexpr std::int64_t kEdges[] = {0, -1, 1, 128, INT32_MAX, INT32_MIN, INT64_MAX, INT64_MIN};
    if (kind < 8) return kEdges[kind];
    if (kind == 8) return normal + static_cast<std::int8_t>(byte());
    std::int64_t value = 0;
    for (int i = 0; i < 8; ++i) value = (value << 8) | byte();
    return value;
  }
  double number(double normal) {
    if (!hostile()) return normal;
    constexpr double kInfinity = __builtin_inf();
    return oneOf({0.0, -1.0, 1.0, 1e-40, 1e30, -1e30, 3.4e38, 1e300, -normal, 255.0, 65535.0,
                  kInfinity, -kInfinity, __builtin_nan("")});
  }
  std::string text(const std::string& normal) {
    if (!hostile()) return normal;
    const std::size_t size = byte();
    std::string value(bytes_.substr(0, size));
    bytes_.remove_prefix(value.size());
    return value;
  }

 private:
  std::string_view bytes_;
};

}  // namespace lightsketch::fuzz
