#include "capture/frame/file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>
#ifdef __x86_64__
#include <xxh_x86dispatch.h>  // the same, by AVX2 or AVX-512 where there is one
#endif

#include <atomic>
#include <cerrno>
#include <memory>
#include <system_error>
#include <utility>
#include <vector>

#include "capture/frame/descriptor.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

ErrorCode codeFor(int errorNumber) {
  return errorNumber == ENOENT || errorNumber == ENOTDIR ? ErrorCode::kNotFound : ErrorCode::kIo;
}

tl::unexpected<Error> systemFailure(int errorNumber, const char* what, const fs::path& path) {
  return failure(codeFor(errorNumber), "{}: cannot {}: {}", path.string(), what,
                 systemMessage(errorNumber));
}

fs::path folderOf(const fs::path& path) {
  return path.has_parent_path() ? path.parent_path() : fs::path(".");
}

Descriptor opened(const fs::path& path, int flags, mode_t mode = 0644) {
  return Descriptor(::open(path.c_str(), flags | O_CLOEXEC, mode));
}

Result<void> syncPath(const fs::path& path) {
  const Descriptor file = opened(path, O_RDONLY);
  if (!file || ::fsync(file.get()) != 0) return systemFailure(errno, "sync", path);
  return {};
}

Result<void> renameSynced(const fs::path& from, const fs::path& to) {
  if (::rename(from.c_str(), to.c_str()) != 0) return systemFailure(errno, "replace", to);
  return syncPath(folderOf(to));
}

std::string uniqueSuffix() {
  static std::atomic<unsigned> counter{0};
  return fmt::format("{}-{}", ::getpid(), counter++);
}

}  // namespace

std::string systemMessage(int errorNumber) {
  return std::error_code(errorNumber, std::generic_category()).message();
}

Result<std::string> readFile(const fs::path& path, std::uint64_t maxBytes) {
  const Descriptor file = opened(path, O_RDONLY);
  if (!file) return systemFailure(errno, "open", path);
  struct stat status {};
  if (::fstat(file.get(), &status) != 0) return systemFailure(errno, "read", path);
  if (S_ISDIR(status.st_mode)) {
    return failure(ErrorCode::kInvalidArgument, "{}: is a folder, expected a file", path.string());
  }
  if (static_cast<std::uint64_t>(status.st_size) > maxBytes) {
    return failure(ErrorCode::kUnsupported, "{}: {} bytes, more than the {} that are read here",
                   path.string(), status.st_size, maxBytes);
  }
  std::string content;
  content.resize(static_cast<std::size_t>(status.st_size));
  std::size_t done = 0;
  while (done < content.size()) {
    const ssize_t count = ::read(file.get(), content.data() + done, content.size() - done);
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return systemFailure(errno, "read", path);
    if (count == 0) break;
    done += static_cast<std::size_t>(count);
  }
  content.resize(done);
  return content;
}

Result<void> writeFileAtomically(const fs::path& path, std::string_view content) {
  PendingFile pending(path);
  {
    const Descriptor file = opened(pending.path(), O_WRONLY | O_CREAT | O_TRUNC);
    if (!file) return systemFailure(errno, "write", path);
    while (!content.empty()) {
      const ssize_t count = ::write(file.get(), content.data(), content.size());
      if (count < 0 && errno == EINTR) continue;
      if (count < 0) return systemFailure(errno, "write", path);
      content.remove_prefix(static_cast<std::size_t>(count));
    }
  }
  return pending.commit();
}

PendingFile::PendingFile(fs::path target) : target_(std::move(target)) {
  temporary_ = folderOf(target_) / fmt::format(".{}.{}.partial{}", target_.stem().string(),
                                               uniqueSuffix(), target_.extension().string());
}

PendingFile::~PendingFile() {
  if (!committed_) {
    std::error_code ignored;
    fs::remove(temporary_, ignored);
  }
}

Result<void> PendingFile::commit() {
  RETURN_IF_ERROR(syncPath(temporary_));
  RETURN_IF_ERROR(renameSynced(temporary_, target_));
  committed_ = true;
  return {};
}

Result<PendingFolder> PendingFolder::create(const fs::path& target) {
  std::error_code error;
  if (fs::exists(target, error) &&
      !(fs::is_directory(target, error) && fs::is_empty(target, error))) {
    return failure(ErrorCode::kInvalidArgument,
                   "{}: exists already; choose another name or remove it", target.string());
  }
  // "out/sketch/" names the folder "sketch".
  const fs::path clean = target.has_filename() ? target : target.parent_path();
  if (clean.empty() || clean.filename() == "." || clean.filename() == "..") {
    return failure(ErrorCode::kInvalidArgument, "'{}': give the new folder a name of its own",
                   target.string());
  }
  if (fs::create_directories(folderOf(clean), error); error) {
    return systemFailure(error.value(), "create", folderOf(clean));
  }
  const fs::path temporary =
      folderOf(clean) / fmt::format(".{}.{}.partial", clean.filename().string(), uniqueSuffix());
  if (::mkdir(temporary.c_str(), 0755) != 0) return systemFailure(errno, "create", target);
  return PendingFolder(clean, temporary);
}

PendingFolder::PendingFolder(fs::path target, fs::path temporary)
    : target_(std::move(target)), temporary_(std::move(temporary)) {}

PendingFolder::PendingFolder(PendingFolder&& other) noexcept
    : target_(std::move(other.target_)), temporary_(std::exchange(other.temporary_, {})) {}

PendingFolder::~PendingFolder() {
  if (!temporary_.empty()) {
    std::error_code ignored;
    fs::remove_all(temporary_, ignored);
  }
}

Result<void> PendingFolder::commit() {
  std::error_code error;
  for (auto entry = fs::recursive_directory_iterator(temporary_, error);
       !error && entry != fs::recursive_directory_iterator(); entry.increment(error)) {
    RETURN_IF_ERROR(syncPath(entry->path()));
  }
  if (error) return systemFailure(error.value(), "read", temporary_);
  RETURN_IF_ERROR(syncPath(temporary_));
  RETURN_IF_ERROR(renameSynced(temporary_, target_));  // replaces an empty folder
  temporary_.clear();
  return {};
}

std::string checksum(std::span<const std::byte> bytes) {
  return fmt::format("{:016x}", XXH3_64bits(bytes.data(), bytes.size()));
}

std::string checksum(std::string_view bytes) {
  return checksum(std::as_bytes(std::span(bytes.data(), bytes.size())));
}

Result<std::string> checksumOfFile(const fs::path& path) {
  const Descriptor file = opened(path, O_RDONLY);
  if (!file) return systemFailure(errno, "open", path);
  const std::unique_ptr<XXH3_state_t, decltype(&XXH3_freeState)> state(XXH3_createState(),
                                                                       &XXH3_freeState);
  XXH3_64bits_reset(state.get());
  std::vector<std::byte> buffer(std::size_t{1} << 20);
  for (;;) {
    const ssize_t count = ::read(file.get(), buffer.data(), buffer.size());
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return systemFailure(errno, "read", path);
    if (count == 0) break;
    XXH3_64bits_update(state.get(), buffer.data(), static_cast<std::size_t>(count));
  }
  return fmt::format("{:016x}", XXH3_64bits_digest(state.get()));
}

}  // namespace lightsketch
