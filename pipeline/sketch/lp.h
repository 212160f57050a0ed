// Lists of images and the light each was taken under, as other programs write them: `.lp` files of
// RTI, and folders in the manner of DiLiGenT.
#pragma once

#include <Eigen/Core>
#include <array>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "capture/frame/progress.h"
#include "capture/frame/result.h"

namespace lightsketch {

struct LightListEntry {
  std::filesystem::path file;                            // exists
  std::string name;                                      // as the list calls it, with '/'
  Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();  // unit vector
  std::optional<std::array<double, 3>> intensity;        // of the lamp in red, green and blue
};

struct LightList {
  std::filesystem::path source;       // the file that was read
  std::filesystem::path intensities;  // the intensity table that was read; empty if none
  bool diligent = false;              // a DiLiGenT folder: its images are linear
  std::vector<LightListEntry> entries;
  int skipped = 0;  // listed, but not there or listed twice
};

// The list of `folder`: `lp` if given, else the folder's only .lp file (dirs.lp if there are
// several), else light_directions.txt with filenames.txt. `intensities`, else the folder's
// light_intensities.txt where there is one, is a table of 1 or 3 columns, a row for every line of
// the list. Images are looked for beside the list and in `folder`. Warns about vectors that are not
// of unit length (and normalises them), images that do not exist or are listed twice (and skips
// them), and a wrong count. Refuses what is not a number, with file and line.
Result<LightList> readLightList(const std::filesystem::path& folder,
                                const std::optional<std::filesystem::path>& lp,
                                const std::optional<std::filesystem::path>& intensities,
                                Progress& progress);

// `.lp` text: the count, then "name x y z" a line. Names with spaces are fine, the last three
// tokens are the vector.
struct NamedDirection {
  std::string name;
  Eigen::Vector3d direction;
};
std::string formatLp(std::span<const NamedDirection> entries);

}  // namespace lightsketch
