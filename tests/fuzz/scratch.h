// A folder in memory for what parsers read from disk.
#pragma once

#include <fcntl.h>
#include <stdlib.h>
#include <unistd.h>

#include <filesystem>
#include <string>
#include <string_view>

#include "tests/fuzz/targets.h"

namespace lightsketch::fuzz {

class Scratch {
 public:
  Scratch() {
    std::error_code error;
    const std::filesystem::path memory = "/dev/shm";
    const auto base = std::filesystem::is_directory(memory, error)
                          ? memory
                          : std::filesystem::temp_directory_path();
    std::string name = (base / "lightsketch-fuzz-XXXXXX").string();
    demand(::mkdtemp(name.data()) != nullptr, "a folder to work in");
    path_ = name;
  }
  ~Scratch() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  Scratch(const Scratch&) = delete;
  Scratch& operator=(const Scratch&) = delete;

  std::filesystem::path operator/(const std::string& name) const { return path_ / name; }
  const std::filesystem::path& path() const { return path_; }

  void write(const std::string& name, std::string_view content) const {
    const int file = ::open((path_ / name).c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
    demand(file >= 0 && ::write(file, content.data(), content.size()) ==
                            static_cast<ssize_t>(content.size()),
           "a file to work with");
    ::close(file);
  }

 private:
  std::filesystem::path path_;
};

}  // namespace lightsketch::fuzz
