#include "pipeline/compress/large_pages.h"

#include <sys/mman.h>
#include <unistd.h>

#include <cstdint>

namespace lightsketch {
namespace {

constexpr std::size_t kLargePage = std::size_t{1} << 21;

// What is large ends with a large page, too.
std::size_t inPages(std::size_t bytes) {
  static const auto small = static_cast<std::size_t>(::sysconf(_SC_PAGESIZE));
  const std::size_t page = bytes >= kLargePage ? kLargePage : small;
  return (bytes + page - 1) / page * page;
}

}  // namespace

void* mapPages(std::size_t bytes) {
  // Aligned to large pages by asking for one more and giving back what lies before and after.
  const std::size_t used = inPages(bytes);
  const std::size_t surplus = used >= kLargePage ? kLargePage : 0;
  void* const mapped =
      ::mmap(nullptr, used + surplus, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (mapped == MAP_FAILED) throw std::bad_alloc();
  if (surplus == 0) return mapped;
  auto* start = static_cast<std::byte*>(mapped);
  const std::size_t lead =
      (kLargePage - reinterpret_cast<std::uintptr_t>(start) % kLargePage) % kLargePage;
  if (lead > 0) ::munmap(start, lead);
  start += lead;
  if (surplus > lead) ::munmap(start + used, surplus - lead);
  ::madvise(start, used, MADV_HUGEPAGE);
  return start;
}

void unmapPages(void* memory, std::size_t bytes) noexcept { ::munmap(memory, inPages(bytes)); }

}  // namespace lightsketch
