#include "pipeline/compress/scratch_file.h"

#include <fcntl.h>
#include <stdlib.h>
#include <unistd.h>

#include <cerrno>
#include <string>

#include "capture/frame/file.h"

namespace lightsketch {
namespace {

template <class Function, class Byte>
int transferAll(Function function, int fd, Byte* bytes, std::size_t count, off_t at) {
  while (count > 0) {
    const ssize_t done = function(fd, bytes, count, at);
    if (done < 0 && errno == EINTR) continue;
    if (done < 0) return errno;
    if (done == 0) return EIO;
    bytes += done;
    at += done;
    count -= static_cast<std::size_t>(done);
  }
  return 0;
}

}  // namespace

Result<Descriptor> openScratchFile(const std::filesystem::path& folder) {
  std::string name = (folder / "lightsketch-XXXXXX").string();
  Descriptor file(::mkostemp(name.data(), O_CLOEXEC));
  if (!file) {
    return failure(ErrorCode::kIo, "{}: cannot write a scratch file: {}", folder.string(),
                   systemMessage(errno));
  }
  ::unlink(name.c_str());
  return file;
}

int writeAll(int fd, const void* bytes, std::size_t count, std::int64_t at) {
  return transferAll(::pwrite, fd, static_cast<const char*>(bytes), count, at);
}

int readAll(int fd, void* bytes, std::size_t count, std::int64_t at) {
  return transferAll(::pread, fd, static_cast<char*>(bytes), count, at);
}

}  // namespace lightsketch
