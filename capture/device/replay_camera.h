// A stream of frames kept in a folder, and its player.
//
// FOLDER/frames.jsonl: a header line {"format": "lightsketch-frames", "formatVersion": 1, ...},
// then a line per frame: file, pixelFormat, id, deviceTimeNs, midExposureSeconds,
// timeUncertaintySeconds, exposureSeconds, gainDb. Pictures are PNG: 8 bits, or 16 bits that hold
// 10- to 16-bit samples as they are; mono and Bayer as grey, RGB as colour.
#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>

#include "capture/device/camera.h"

namespace lightsketch {

// Frames come at `rate` times the recorded speed, or (0) as fast as the callback returns. Their
// metadata is the recorded one, times included: two streams that were recorded together still pair.
// Checks the journal and that its files are there; pictures are read and checked while playing.
Result<std::unique_ptr<Camera>> openReplayCamera(const std::filesystem::path& folder, double rate);

// Keeps a stream. Not thread-safe.
class ReplayWriter {
 public:
  // Creates `folder`, which must be empty if it exists. `camera` is kept for the replay's info().
  static Result<ReplayWriter> create(const std::filesystem::path& folder, const CameraInfo& camera);
  // The picture first, then its journal line: what the journal names is there.
  Result<void> write(const Frame& frame);

 private:
  ReplayWriter(std::filesystem::path folder, std::ofstream journal);
  std::filesystem::path folder_;
  std::ofstream journal_;
  std::uint64_t count_ = 0;
};

}  // namespace lightsketch
