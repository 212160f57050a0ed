#include "pipeline/sketch/sketch.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <fstream>
#include <set>
#include <utility>

#include "capture/frame/descriptor.h"
#include "capture/frame/file.h"
#include "pipeline/sketch/image_file.h"
#include "pipeline/sketch/sketch_files.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

tl::unexpected<Error> systemFailure(int errorNumber, const char* what, const fs::path& path) {
  return failure(errorNumber == ENOENT ? ErrorCode::kNotFound : ErrorCode::kIo, "{}: cannot {}: {}",
                 path.string(), what, systemMessage(errorNumber));
}

Result<void> syncPath(const fs::path& path) {
  const Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (!file || ::fsync(file.get()) != 0) return systemFailure(errno, "sync", path);
  return {};
}

Result<void> writeUnsynced(const fs::path& path, std::string_view content) {
  errno = 0;
  std::ofstream file(path, std::ios::binary | std::ios::trunc);
  file.write(content.data(), static_cast<std::streamsize>(content.size()));
  file.close();
  if (!file) return systemFailure(errno != 0 ? errno : EIO, "write", path);
  return {};
}

// Removes what a writer that was stopped has left: temporary files, and the picture of the frame
// that it was about to acknowledge. Pictures beyond that one were acknowledged: their lines are
// lost, and they are not ours to remove.
Result<void> removeLeftovers(const fs::path& folder, const std::vector<FrameRecord>& frames) {
  const std::string next = frameNumber(frameFile(static_cast<int>(frames.size())));
  std::vector<fs::path> leftovers;
  ASSIGN_OR_RETURN(const auto unnamed, unnamedPictures(folder, frames));
  for (const fs::path& path : unnamed) {
    if (frameNumber(path) != next) {
      return failure(ErrorCode::kCorrupt,
                     "{}: no line of {} names it; run: lightsketch check {} --repair",
                     path.string(), kJournalFile, folder.string());
    }
    leftovers.push_back(path);
  }
  std::error_code error;
  leftovers.push_back(folder / kFramesFolder / (next + ".raw.png"));
  for (const auto& directory : {folder, folder / kFramesFolder}) {
    for (fs::directory_iterator entry(directory, error), end; !error && entry != end;
         entry.increment(error)) {
      const std::string name = entry->path().filename().string();
      if (name.starts_with(".") && name.find(".partial") != name.npos) {
        leftovers.push_back(entry->path());
      }
    }
  }
  for (const auto& path : leftovers) fs::remove(path, error);
  return {};
}

}  // namespace

struct Sketch::State {
  fs::path folder;
  SketchManifest manifest;
  std::optional<RigGeometry> rig;
  Replay replay;

  // Writers only.
  Descriptor lock;
  Descriptor journal;
  off_t journalLength = 0;
  std::vector<fs::path> unsynced;

  fs::path journalPath() const { return folder / kJournalFile; }

  Result<void> checkWritable() const {
    if (journal) return {};
    return failure(ErrorCode::kInvalidArgument, "{}: the sketch is not open for writing",
                   folder.string());
  }

  // One write(), so that a reader or a crash sees the line whole or torn at its end; a line that
  // could not be made durable is taken back.
  Result<void> writeEvent(const Json& event, bool sync) {
    const std::string line = sealLine(event);
    ssize_t count = 0;
    do {
      count = ::write(journal.get(), line.data(), line.size());
    } while (count < 0 && errno == EINTR);
    int problem = 0;
    if (count != static_cast<ssize_t>(line.size()))
      problem = count < 0 ? errno : ENOSPC;
    else if (sync && ::fdatasync(journal.get()) != 0)
      problem = errno;
    if (problem != 0) {
      if (::ftruncate(journal.get(), journalLength) != 0) journal = Descriptor();
      return systemFailure(problem, "write", journalPath());
    }
    journalLength += static_cast<off_t>(line.size());
    return {};
  }

  Result<void> writeAndApply(const Json& event) {
    RETURN_IF_ERROR(checkWritable());
    RETURN_IF_ERROR(writeEvent(event, true));
    return replay.apply(event, journalPath().string());
  }

  Result<const FrameRecord*> frame(int id) const {
    if (id < 0 || id >= static_cast<int>(replay.frames.size())) {
      return failure(ErrorCode::kInvalidArgument, "{}: there is no frame {}; it has {}",
                     folder.string(), id, replay.frames.size());
    }
    return &replay.frames[static_cast<std::size_t>(id)];
  }

  Result<void> checkShape(const RadianceImage& image, std::string_view where) const {
    if (image.width() == manifest.width && image.height() == manifest.height &&
        image.channels() == 3) {
      return {};
    }
    return failure(ErrorCode::kInvalidArgument,
                   "{}: is {} x {} with {} channels, the sketch's frames are {} x {} RGB", where,
                   image.width(), image.height(), image.channels(), manifest.width,
                   manifest.height);
  }

  Result<int> append(FrameRecord record, const RadianceImage& radiance, bool durable);
  Result<void> load();
};

Result<void> Sketch::State::load() {
  const fs::path manifestPath = folder / kManifestFile;
  std::error_code error;
  if (!fs::exists(folder, error)) {
    return failure(ErrorCode::kNotFound, "{}: there is no such folder", folder.string());
  }
  if (!fs::exists(manifestPath, error)) {
    return failure(ErrorCode::kNotFound, "{}: is not a sketch (it has no {})", folder.string(),
                   kManifestFile);
  }
  RETURN_IF_ERROR(refuseLinks(folder));
  ASSIGN_OR_RETURN(const auto json, readJsonFile(manifestPath));
  ASSIGN_OR_RETURN(manifest, manifestFromJson(json, manifestPath.string()));
  if (fs::exists(folder / kRigFile, error)) {
    ASSIGN_OR_RETURN(rig, loadRigGeometry(folder / kRigFile));
  }
  ASSIGN_OR_RETURN(const auto text, readFile(journalPath()));
  ASSIGN_OR_RETURN(const auto length, replayJournal(text, journalPath(), replay));
  journalLength = static_cast<off_t>(length);
  return {};
}

Result<int> Sketch::State::append(FrameRecord record, const RadianceImage& radiance, bool durable) {
  RETURN_IF_ERROR(checkWritable());
  record.id = static_cast<int>(replay.frames.size());
  record.file = frameFile(record.id);
  record.dropped = false;
  record.dropReason.clear();
  const fs::path path = folder / record.file;
  RETURN_IF_ERROR(checkRecord(record, ErrorCode::kInvalidArgument, path.string()));
  RETURN_IF_ERROR(checkShape(radiance, path.string()));
  if (!std::all_of(radiance.values().begin(), radiance.values().end(),
                   [](float value) { return std::isfinite(value); })) {
    return failure(ErrorCode::kInvalidArgument, "{}: has pixels that are not finite",
                   record.origin.empty() ? path.string() : record.origin);
  }

  ExrOptions options;
  options.numbers = {{"lightX", record.light.direction.x()},
                     {"lightY", record.light.direction.y()},
                     {"lightZ", record.light.direction.z()},
                     {"exposureSeconds", record.exposureSeconds},
                     {"gainDb", record.gainDb},
                     {"midExposureSeconds", record.midExposureSeconds}};
  const std::array<const char*, 3> names{"lampScaleR", "lampScaleG", "lampScaleB"};
  for (std::size_t c = 0; c < 3; ++c) options.numbers[names[c]] = record.lampScale[c];
  if (!record.origin.empty()) options.attributes["origin"] = record.origin;
  ASSIGN_OR_RETURN(const auto bytes, encodeExr(radiance, options));
  record.checksum = checksum(bytes);

  // First the image, then the line that vouches for it.
  auto written = durable ? writeFileAtomically(path, bytes) : writeUnsynced(path, bytes);
  if (written) written = writeEvent(frameToJson(record), durable);
  if (!written) {
    // Unless the line could not be taken back: then it must not speak of a picture that is gone.
    std::error_code ignored;
    if (journal) fs::remove(path, ignored);
    return tl::unexpected(written.error());
  }
  if (!durable) unsynced.push_back(path);
  replay.frames.push_back(std::move(record));
  return replay.frames.back().id;
}

Sketch::Sketch(std::unique_ptr<State> state) : state_(std::move(state)) {}
Sketch::Sketch(Sketch&&) noexcept = default;
Sketch& Sketch::operator=(Sketch&&) noexcept = default;
Sketch::~Sketch() = default;

Result<Sketch> Sketch::create(const fs::path& folder, const SketchManifest& manifest,
                              const std::optional<RigGeometry>& rig) {
  if (manifest.width < 1 || manifest.height < 1 || manifest.width > kMaxFrameSide ||
      manifest.height > kMaxFrameSide ||
      std::int64_t{manifest.width} * manifest.height > kMaxFramePixels) {
    return failure(ErrorCode::kInvalidArgument, "{}: a sketch cannot have frames of {} x {} pixels",
                   folder.string(), manifest.width, manifest.height);
  }
  ASSIGN_OR_RETURN(auto pending, PendingFolder::create(folder));
  std::error_code error;
  for (const char* name : {kFramesFolder, kCalibrationFolder}) {
    if (fs::create_directory(pending.path() / name, error); error) {
      return systemFailure(error.value(), "create", folder / name);
    }
  }
  if (rig) RETURN_IF_ERROR(saveRigGeometry(*rig, pending.path() / kRigFile));
  RETURN_IF_ERROR(writeFileAtomically(pending.path() / kJournalFile, ""));
  RETURN_IF_ERROR(writeJsonFile(pending.path() / kManifestFile, manifestToJson(manifest)));
  RETURN_IF_ERROR(pending.commit());
  return openForAppend(folder);
}

Result<Sketch> Sketch::open(const fs::path& folder) {
  auto state = std::make_unique<State>();
  state->folder = folder;
  RETURN_IF_ERROR(state->load());
  return Sketch(std::move(state));
}

Result<Sketch> Sketch::openForAppend(const fs::path& folder) {
  auto state = std::make_unique<State>();
  state->folder = folder;
  std::error_code error;
  if (!fs::exists(folder / kManifestFile, error)) {
    RETURN_IF_ERROR(state->load());  // says what is missing
  }

  ASSIGN_OR_RETURN(state->lock, lockForWriting(folder));
  RETURN_IF_ERROR(state->load());
  RETURN_IF_ERROR(removeLeftovers(folder, state->replay.frames));

  const fs::path journalPath = state->journalPath();
  state->journal =
      Descriptor(::open(journalPath.c_str(), O_WRONLY | O_APPEND | O_CLOEXEC | O_NOFOLLOW));
  if (!state->journal) return systemFailure(errno, "write", journalPath);
  const off_t size = ::lseek(state->journal.get(), 0, SEEK_END);
  if (size != state->journalLength) {
    if (::ftruncate(state->journal.get(), state->journalLength) != 0) {
      return systemFailure(errno, "write", journalPath);
    }
    Json event = eventOf("note");
    event["text"] =
        fmt::format("cut off a torn last line of {} bytes", size - state->journalLength);
    RETURN_IF_ERROR(state->writeEvent(event, true));
  }
  return Sketch(std::move(state));
}

const fs::path& Sketch::folder() const { return state_->folder; }
const SketchManifest& Sketch::manifest() const { return state_->manifest; }
const std::optional<RigGeometry>& Sketch::rig() const { return state_->rig; }
const std::vector<FrameRecord>& Sketch::frames() const { return state_->replay.frames; }

std::vector<int> Sketch::activeFrames() const {
  std::vector<int> ids;
  for (const auto& record : frames()) {
    if (!record.dropped) ids.push_back(record.id);
  }
  return ids;
}

Result<int> Sketch::append(FrameRecord record, const RadianceImage& radiance) {
  return state_->append(std::move(record), radiance, true);
}

Result<int> Sketch::appendUnsynced(FrameRecord record, const RadianceImage& radiance) {
  return state_->append(std::move(record), radiance, false);
}

Result<void> Sketch::sync() {
  RETURN_IF_ERROR(state_->checkWritable());
  for (const auto& path : state_->unsynced) RETURN_IF_ERROR(syncPath(path));
  RETURN_IF_ERROR(syncPath(folder() / kFramesFolder));
  RETURN_IF_ERROR(syncPath(state_->journalPath()));
  state_->unsynced.clear();
  return {};
}

Result<void> Sketch::drop(int id, const std::string& reason) {
  ASSIGN_OR_RETURN(const FrameRecord* record, state_->frame(id));
  if (record->dropped) return {};
  Json event = eventOf("drop");
  event["id"] = id;
  event["reason"] = reason;
  return state_->writeAndApply(event);
}

Result<void> Sketch::restore(int id) {
  ASSIGN_OR_RETURN(const FrameRecord* record, state_->frame(id));
  if (!record->dropped) return {};
  Json event = eventOf("restore");
  event["id"] = id;
  return state_->writeAndApply(event);
}

Result<void> Sketch::relight(int id, const LightDirection& light, const std::string& calibrationId,
                             const std::optional<std::array<double, 3>>& lampScale) {
  RETURN_IF_ERROR(state_->frame(id));
  RETURN_IF_ERROR(checkLight(light, ErrorCode::kInvalidArgument, folder().string()));
  if (lampScale) {
    RETURN_IF_ERROR(checkLampScale(*lampScale, ErrorCode::kInvalidArgument, folder().string()));
  }
  Json event = eventOf("relight");
  event["id"] = id;
  event["light"] = lightToJson(light);
  event["calibrationId"] = calibrationId;
  if (lampScale) event["lampScale"] = *lampScale;
  return state_->writeAndApply(event);
}

Result<void> Sketch::note(const std::string& text) {
  Json event = eventOf("note");
  event["text"] = text;
  return state_->writeAndApply(event);
}

Result<void> Sketch::writeAmbient(const RadianceImage& radiance) {
  RETURN_IF_ERROR(state_->checkWritable());
  const fs::path path = folder() / kAmbientFile;
  RETURN_IF_ERROR(state_->checkShape(radiance, path.string()));
  ASSIGN_OR_RETURN(const auto bytes, encodeExr(radiance));
  // Announced before it is replaced: between the two steps the old file is still a known one.
  Json event = eventOf("ambient");
  event["checksum"] = checksum(bytes);
  RETURN_IF_ERROR(state_->writeAndApply(event));
  return writeFileAtomically(path, bytes);
}

Result<std::optional<RadianceImage>> Sketch::readAmbient() const {
  const fs::path path = folder() / kAmbientFile;
  std::error_code error;
  if (!fs::exists(path, error)) return std::nullopt;
  ASSIGN_OR_RETURN(const auto bytes, readFile(path));
  if (!state_->replay.ambientChecksums.contains(checksum(bytes))) {
    return failure(ErrorCode::kCorrupt,
                   "{}: damaged (its checksum is not in the journal); restore it from a copy",
                   path.string());
  }
  ASSIGN_OR_RETURN(auto image, decodeExr(bytes, path.string()));
  RETURN_IF_ERROR(state_->checkShape(image, path.string()));
  return image;
}

Result<RadianceImage> Sketch::readFrame(int id) const {
  ASSIGN_OR_RETURN(const FrameRecord* record, state_->frame(id));
  const fs::path path = folder() / record->file;
  RETURN_IF_ERROR(refuseLink(path));
  auto bytes = readFile(path);
  if (!bytes) {
    return failure(bytes.error().code, "{}; restore it from a copy or drop frame {}",
                   bytes.error().message, id);
  }
  if (checksum(*bytes) != record->checksum) {
    return failure(
        ErrorCode::kCorrupt,
        "{}: damaged (its checksum does not fit); restore it from a copy or drop frame {}",
        path.string(), id);
  }
  ASSIGN_OR_RETURN(auto image, decodeExr(*bytes, path.string()));
  RETURN_IF_ERROR(state_->checkShape(image, path.string()));
  return image;
}

}  // namespace lightsketch
