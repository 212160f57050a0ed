// Files that are whole or not there, and checksums that prove it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>

#include "capture/frame/result.h"

namespace lightsketch {

// Whole file as bytes. Refuses files over `maxBytes` before it allocates.
Result<std::string> readFile(const std::filesystem::path& path,
                             std::uint64_t maxBytes = std::uint64_t{1} << 30);

// Writes beside the target, syncs, renames, syncs the folder. After a crash at any moment the old
// content or the new one is there, never a part.
Result<void> writeFileAtomically(const std::filesystem::path& path, std::string_view content);

// A name beside `target` to write to, moved onto it by commit(). Without commit() the destructor
// removes what was written. For writers that need a path (HDF5, OpenEXR).
class PendingFile {
 public:
  explicit PendingFile(std::filesystem::path target);
  ~PendingFile();
  PendingFile(const PendingFile&) = delete;
  PendingFile& operator=(const PendingFile&) = delete;

  // Same folder and same extension as the target, unique to this process and object.
  const std::filesystem::path& path() const { return temporary_; }
  // Syncs the file, renames it onto the target, syncs the folder.
  Result<void> commit();

 private:
  std::filesystem::path target_;
  std::filesystem::path temporary_;
  bool committed_ = false;
};

// Same for a folder and everything in it: created on construction, renamed by commit(), removed
// otherwise. Fails if the target exists and is not an empty folder.
class PendingFolder {
 public:
  static Result<PendingFolder> create(const std::filesystem::path& target);
  ~PendingFolder();
  PendingFolder(PendingFolder&& other) noexcept;
  PendingFolder& operator=(PendingFolder&&) = delete;

  const std::filesystem::path& path() const { return temporary_; }
  Result<void> commit();

 private:
  PendingFolder(std::filesystem::path target, std::filesystem::path temporary);
  std::filesystem::path target_;
  std::filesystem::path temporary_;  // empty once committed or moved from
};

// XXH3 64-bit, as 16 hexadecimal digits. Guards against damage, not against malice.
std::string checksum(std::span<const std::byte> bytes);
std::string checksum(std::string_view bytes);
Result<std::string> checksumOfFile(const std::filesystem::path& path);

// "No space left on device" and the like for an errno value.
std::string systemMessage(int errorNumber);

}  // namespace lightsketch
