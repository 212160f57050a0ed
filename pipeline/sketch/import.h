// Real multi-light sets into a sketch and out again, and what a sketch holds.
#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "capture/frame/json.h"
#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/sketch/image_file.h"
#include "pipeline/sketch/sketch.h"

namespace lightsketch {

struct ImportOptions {
  std::filesystem::path folder;             // images and the list of their lights
  std::optional<std::filesystem::path> lp;  // else found in the folder, see readLightList()
  std::optional<std::filesystem::path> intensities;  // table of lamp intensities, 1 or 3 columns
  // How integer samples are encoded. Without a choice: linear in DiLiGenT folders, else sRGB.
  std::optional<TransferFunction> transfer;
  std::filesystem::path out;  // the new sketch
  std::string software;       // name and version, for sketch.json
};

struct ImportSummary {
  int imported = 0;
  int skipped = 0;  // listed, but not there or listed twice
  int width = 0;
  int height = 0;
  TransferFunction transfer = TransferFunction::kSrgb;
  bool intensities = false;
  std::string describe() const;  // one line
};

// Pixels are stored as captured, 0..1; lamp intensities, divided by their mean over all imported
// lights and channels, become lampScale. All images must have one size. On failure or cancellation
// nothing is left behind.
Result<ImportSummary> importSet(const ImportOptions& options, Progress& progress);

struct ExportLpOptions {
  enum class Format { kPng16, kPng8, kExr };
  Format format = Format::kPng16;  // PNG: sRGB, clipped to 0..1; EXR: linear half
};

// The frames that are not dropped, ambient light subtracted, as images with dirs.lp; lamp scales,
// if any differs from 1, in light_intensities.txt. Returns how many were written. `out` is whole or
// not there.
Result<int> exportLp(const Sketch& sketch, const std::filesystem::path& out,
                     const ExportLpOptions& options, Progress& progress);

// Counts, size, dropped frames, range of directions, ambient light, bytes on disk.
Result<Json> describeSketch(const std::filesystem::path& folder);

}  // namespace lightsketch
