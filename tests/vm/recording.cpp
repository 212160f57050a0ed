// In the virtual machine: records onto a disk until its power is cut; checks afterwards what is
// there.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <span>
#include <string>

#include "pipeline/sketch/sketch.h"

namespace lightsketch {
namespace {

constexpr int kWidth = 64;
constexpr int kHeight = 48;

// Every frame differs; whole numbers to 2048 are exact as half floats.
RadianceImage pictureOf(int id) {
  RadianceImage picture(kWidth, kHeight, 3);
  for (int i = 0; i < static_cast<int>(picture.size()); ++i) {
    picture.values()[static_cast<std::size_t>(i)] =
        static_cast<float>((id * 131 + i * 17 + i / 5) % 2048);
  }
  return picture;
}

FrameRecord recordOf(int id) {
  FrameRecord record;
  record.light.direction = Eigen::Vector3d(0.1 * (id % 7), 0.2, 1).normalized();
  record.exposureSeconds = 0.02;
  record.midExposureSeconds = id;
  return record;
}

Result<void> recordForEver(const std::filesystem::path& folder) {
  SketchManifest manifest;
  manifest.width = kWidth;
  manifest.height = kHeight;
  ASSIGN_OR_RETURN(Sketch sketch, Sketch::create(folder, manifest));
  for (int id = 0;; ++id) {
    ASSIGN_OR_RETURN(const int acknowledged, sketch.append(recordOf(id), pictureOf(id)));
    std::printf("ACK %d\n", acknowledged);
    std::fflush(stdout);
  }
}

// How many frames there are, each of them whole and itself.
Result<int> check(const std::filesystem::path& folder) {
  ASSIGN_OR_RETURN(Sketch sketch, Sketch::openForAppend(folder));
  const int found = static_cast<int>(sketch.frames().size());
  for (int id = 0; id < found; ++id) {
    ASSIGN_OR_RETURN(const RadianceImage picture, sketch.readFrame(id));
    const RadianceImage expected = pictureOf(id);
    if (!std::ranges::equal(picture.values(), expected.values()) ||
        sketch.frames()[static_cast<std::size_t>(id)].midExposureSeconds != id) {
      return failure(ErrorCode::kCorrupt, "frame {} is not the one that was recorded", id);
    }
  }
  // The recording goes on.
  ASSIGN_OR_RETURN(const int next, sketch.append(recordOf(found), pictureOf(found)));
  RETURN_IF_ERROR(sketch.readFrame(next));
  return found;
}

int run(const std::string& what, std::span<char*> disks) {
  int failures = 0;
  for (const std::filesystem::path disk : disks) {
    if (what == "record") {
      const auto ended = recordForEver(disk / "sketch");
      std::printf("FAILED %s\n", ended.error().message.c_str());
      return 1;
    }
    if (const auto found = check(disk / "sketch")) {
      std::printf("FOUND %s %d\n", disk.filename().c_str(), *found);
    } else {
      std::printf("FAILED %s: %s\n", disk.c_str(), found.error().message.c_str());
      ++failures;
    }
  }
  return failures == 0 ? 0 : 1;
}

}  // namespace
}  // namespace lightsketch

// record DISK | check DISK...
int main(int argc, char** argv) {
  if (argc < 3) return 2;
  return lightsketch::run(argv[1], std::span(argv, static_cast<std::size_t>(argc)).subspan(2));
}
