// What lies in a sketch's folder, as values: the manifest, journal lines and what they add up to.
// Internal to this folder.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "capture/frame/descriptor.h"
#include "capture/frame/json.h"
#include "capture/frame/result.h"
#include "pipeline/sketch/sketch.h"

namespace lightsketch {

inline constexpr const char* kManifestFile = "sketch.json";
inline constexpr const char* kRigFile = "rig.json";
inline constexpr const char* kJournalFile = "frames.jsonl";
inline constexpr const char* kFramesFolder = "frames";
inline constexpr const char* kAmbientFile = "ambient.exr";
inline constexpr const char* kCalibrationFolder = "calibration";
inline constexpr const char* kLockFile = "lock";

inline constexpr std::int64_t kMaxFrameSide = 1 << 16;
inline constexpr std::int64_t kMaxFramePixels = std::int64_t{1} << 28;

// "frames/000123.exr", and back from that or from what stands beside it ("000123.raw.png").
std::string frameFile(int id);
std::string frameNumber(const std::filesystem::path& file);

// Pictures in frames/ with a frame's name that none of `frames` has, in order.
Result<std::vector<std::filesystem::path>> unnamedPictures(const std::filesystem::path& folder,
                                                           const std::vector<FrameRecord>& frames);

// Held by the one program that writes. Fails while another one does.
Result<Descriptor> lockForWriting(const std::filesystem::path& folder);
// A sketch from elsewhere must not make us read, write or remove anything outside of it: fails if
// the folder's own files and folders are links. Frames are asked for one by one.
Result<void> refuseLinks(const std::filesystem::path& folder);
Result<void> refuseLink(const std::filesystem::path& path);

Json manifestToJson(const SketchManifest& manifest);
Result<SketchManifest> manifestFromJson(const Json& json, std::string_view where);

// A journal line is a JSON object whose last field, "crc", is the checksum of the text before it.
// It is checked on the bytes, so that a damaged line is found even where it still is JSON.
// sealLine() ends its line; sealHolds() takes one without the newline.
std::string sealLine(const Json& event);
bool sealHolds(std::string_view line);

// Events without their content, {"event": kind, "version": ...}.
Json eventOf(const char* kind);
Json frameToJson(const FrameRecord& record);
Json lightToJson(const LightDirection& light);

// What a caller or a journal may claim.
Result<void> checkLight(const LightDirection& light, ErrorCode code, std::string_view where);
Result<void> checkLampScale(const std::array<double, 3>& lampScale, ErrorCode code,
                            std::string_view where);
Result<void> checkRecord(const FrameRecord& record, ErrorCode code, std::string_view where);

// What the journal adds up to.
struct Replay {
  std::vector<FrameRecord> frames;
  std::set<std::string> ambientChecksums;

  // Changes nothing where it fails.
  Result<void> apply(const Json& event, std::string_view where);

 private:
  Result<FrameRecord*> frame(const Json& event, std::string_view where);
};

// Only the last line may be torn: it was being written when the program or the machine stopped, so
// nobody was told it is safe. A kill leaves its beginning, a power cut also zeros in place of some
// of it. A last line that is whole but wrong is damage like any other: it may have been
// acknowledged. `line` is what stands from the last whole line to the end, newline included.
bool isTornEnd(std::string_view line);

// Replays whole lines; returns how many bytes of `text` they take.
Result<std::size_t> replayJournal(std::string_view text, const std::filesystem::path& path,
                                  Replay& replay);

}  // namespace lightsketch
