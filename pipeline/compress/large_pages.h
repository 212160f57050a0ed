// Memory straight from the system, on large pages where there is much of it: with ordinary ones the
// first touch of a page costs more than what is done in it. Internal to this folder but for
// FactorValues.
#pragma once

#include <cstddef>
#include <new>
#include <type_traits>

namespace lightsketch {

// Zeros, aligned to a page at least. Throws std::bad_alloc.
void* mapPages(std::size_t bytes);
void unmapPages(void* memory, std::size_t bytes) noexcept;

// For std::vector: large blocks are mapped, small ones come from the heap.
template <class T>
struct LargePages {
  using value_type = T;
  LargePages() = default;
  template <class U>
  LargePages(const LargePages<U>&) {}

  T* allocate(std::size_t count) {
    if (count > static_cast<std::size_t>(-1) / sizeof(T) / 2) throw std::bad_alloc();
    const std::size_t bytes = count * sizeof(T);
    return static_cast<T*>(bytes < kMapped ? ::operator new(bytes) : mapPages(bytes));
  }
  void deallocate(T* memory, std::size_t count) noexcept {
    const std::size_t bytes = count * sizeof(T);
    bytes < kMapped ? ::operator delete(memory) : unmapPages(memory, bytes);
  }
  bool operator==(const LargePages&) const { return true; }

 private:
  static constexpr std::size_t kMapped = std::size_t{1} << 21;
};

}  // namespace lightsketch
