// Files without a name: nothing is left behind whatever happens. Internal to this folder.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>

#include "capture/frame/descriptor.h"
#include "capture/frame/result.h"

namespace lightsketch {

Result<Descriptor> openScratchFile(const std::filesystem::path& folder);

// All of a range; the errno of what failed, 0 if nothing did.
int writeAll(int fd, const void* bytes, std::size_t count, std::int64_t at);
int readAll(int fd, void* bytes, std::size_t count, std::int64_t at);

}  // namespace lightsketch
