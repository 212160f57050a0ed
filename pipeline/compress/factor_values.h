// The numbers of a model's factor in one aligned piece of memory, as they lie in the file and as
// the render kernels read them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

namespace lightsketch {

enum class ElementType : std::uint8_t { kFloat32, kFloat16, kInt8, kInt16 };

std::size_t bytesOf(ElementType type);

// Owns its memory: 64-byte aligned, on huge pages where it is large, and followed by kPadding
// readable bytes, so that kernels may load past the last number. Deep copies.
class FactorValues {
 public:
  static constexpr std::size_t kPadding = 256;

  FactorValues() = default;
  // Zeros. Throws std::bad_alloc.
  FactorValues(ElementType type, std::size_t count);
  FactorValues(const FactorValues& other);
  FactorValues& operator=(const FactorValues& other);
  FactorValues(FactorValues&&) noexcept = default;
  FactorValues& operator=(FactorValues&&) noexcept = default;

  ElementType type() const { return type_; }
  std::size_t count() const { return count_; }
  std::size_t bytes() const { return count_ * bytesOf(type_); }
  const std::byte* data() const { return memory_.get(); }
  std::byte* data() { return memory_.get(); }
  // The numbers as T, whose size must be the element's (std::uint16_t: the bits of a half).
  template <class T>
  std::span<const T> as() const {
    return {reinterpret_cast<const T*>(data()), count_};
  }
  template <class T>
  std::span<T> as() {
    return {reinterpret_cast<T*>(data()), count_};
  }
  // One number, without its scale. Slow.
  float at(std::size_t i) const;
  // Rounds to the element; halfs saturate at 65504, integers at their symmetric range. Slow.
  void set(std::size_t i, float value);

 private:
  struct Unmap {
    Unmap() : bytes(0) {}
    explicit Unmap(std::size_t mapped) : bytes(mapped) {}
    std::size_t bytes;
    void operator()(std::byte* memory) const;
  };
  ElementType type_ = ElementType::kFloat32;
  std::size_t count_ = 0;
  std::unique_ptr<std::byte[], Unmap> memory_;
};

}  // namespace lightsketch
