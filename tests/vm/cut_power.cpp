// What a disk holds after a power cut: replays the writes that QEMU logged (blklogwrites, in
// dm-log-writes' format) up to a moment, as a disk with a volatile cache may have kept them.
//
//   cut_power IMAGE LOG BYTES SEED
//
// IMAGE is the disk as it was before the log began. Of the log's first BYTES everything up to the
// last flush is written. Of what came after it a write is kept, lost, or torn between two sectors.
#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <random>
#include <string>
#include <vector>

namespace {

// Kernel: Documentation/admin-guide/device-mapper/log-writes.rst, drivers/md/dm-log-writes.c.
constexpr std::uint64_t kMagic = 0x6a736677736872;
constexpr std::uint64_t kFlush = 1, kDiscard = 4, kMark = 8;
struct Super {
  std::uint64_t magic, version, entries;
  std::uint32_t sectorBytes, padding;
};
struct Entry {
  std::uint64_t sector, sectors, flags, dataBytes;
};

struct Write {
  std::uint64_t logAt;  // of its data
  Entry entry;
};

bool readAt(int fd, void* to, std::size_t size, std::uint64_t at) {
  return ::pread(fd, to, size, static_cast<off_t>(at)) == static_cast<ssize_t>(size);
}

int run(const char* imagePath, const char* logPath, std::uint64_t end, unsigned seed) {
  const int image = ::open(imagePath, O_RDWR);
  const int log = ::open(logPath, O_RDONLY);
  Super super{};
  if (image < 0 || log < 0 || !readAt(log, &super, sizeof(super), 0) || super.magic != kMagic) {
    std::fprintf(stderr, "cut_power: no image %s, or %s is no log of writes\n", imagePath, logPath);
    return 1;
  }
  const std::uint64_t unit = super.sectorBytes;

  // The log's entries that end before the cut, and how many of them the last flush made safe.
  std::vector<Write> writes;
  std::size_t safe = 0;
  int flushes = 0;
  for (std::uint64_t at = unit; at + unit <= end;) {
    Entry entry{};
    if (!readAt(log, &entry, sizeof(entry), at)) break;
    at += unit;
    const bool hasData = (entry.flags & (kDiscard | kMark)) == 0;
    const std::uint64_t bytes = hasData ? entry.sectors * unit : 0;
    if (at + bytes > end) break;
    // A flush makes safe what was written before it.
    if ((entry.flags & kFlush) != 0) {
      safe = writes.size();
      ++flushes;
    }
    if (bytes > 0) writes.push_back({at, entry});
    at += bytes;
  }

  std::mt19937 random(seed);
  std::size_t kept = 0;
  std::vector<char> data;
  for (std::size_t i = 0; i < writes.size(); ++i) {
    std::uint64_t sectors = writes[i].entry.sectors;
    if (i >= safe) {
      const unsigned fate = random() % 4;  // lost, torn, or kept
      sectors = fate == 0 ? 0 : fate == 1 ? random() % (sectors + 1) : sectors;
      kept += sectors > 0 ? 1 : 0;
    }
    data.resize(sectors * unit);
    if (!readAt(log, data.data(), data.size(), writes[i].logAt) ||
        ::pwrite(image, data.data(), data.size(),
                 static_cast<off_t>(writes[i].entry.sector * unit)) !=
            static_cast<ssize_t>(data.size())) {
      std::perror("cut_power");
      return 1;
    }
  }
  std::printf("%zu writes safe by %d flushes, %zu of the %zu later ones kept\n", safe, flushes,
              kept, writes.size() - safe);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 5) {
    std::fprintf(stderr, "usage: cut_power IMAGE LOG BYTES SEED\n");
    return 2;
  }
  return run(argv[1], argv[2], std::stoull(argv[3]), static_cast<unsigned>(std::stoul(argv[4])));
}
