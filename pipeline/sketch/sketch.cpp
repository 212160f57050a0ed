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

#include "capture/frame/file.h"
#include "pipeline/sketch/image_file.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kFormat = "lightsketch-sketch";
constexpr int kFormatVersion = 1;
constexpr int kEventVersion = 1;
constexpr std::int64_t kMaxSide = 1 << 16;
constexpr std::int64_t kMaxPixels = std::int64_t{1} << 28;
constexpr std::int64_t kMaxDirections = 1'000'000;
constexpr std::int64_t kMaxFrames = 10'000'000;

constexpr const char* kManifestFile = "sketch.json";
constexpr const char* kRigFile = "rig.json";
constexpr const char* kJournalFile = "frames.jsonl";
constexpr const char* kFramesFolder = "frames";
constexpr const char* kAmbientFile = "ambient.exr";
constexpr const char* kLockFile = "lock";

tl::unexpected<Error> systemFailure(int errorNumber, const char* what, const fs::path& path) {
  return failure(errorNumber == ENOENT ? ErrorCode::kNotFound : ErrorCode::kIo, "{}: cannot {}: {}",
                 path.string(), what, systemMessage(errorNumber));
}

class Descriptor {
 public:
  Descriptor() = default;
  explicit Descriptor(int fd) : fd_(fd) {}
  ~Descriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  Descriptor(Descriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Descriptor& operator=(Descriptor&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }
  explicit operator bool() const { return fd_ >= 0; }
  int get() const { return fd_; }

 private:
  int fd_ = -1;
};

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

// --- sketch.json ---------------------------------------------------------------------------------

Json manifestToJson(const SketchManifest& manifest) {
  const Json view = {{"projection", "perspective"},
                     {"width", manifest.width},
                     {"height", manifest.height},
                     {"cameraModel", nullptr}};
  return {{"format", kFormat},
          {"formatVersion", kFormatVersion},
          {"views", Json::array({view})},
          {"grid",
           {{"directions", manifest.directions},
            {"domain", manifest.fullSphere ? "sphere" : "hemisphere"}}},
          {"ambientSubtracted", manifest.ambientSubtracted},
          {"software", manifest.software},
          {"cameras", manifest.cameras},
          {"provenance", manifest.provenance}};
}

Result<SketchManifest> manifestFromJson(const Json& json, std::string_view where) {
  RETURN_IF_ERROR(checkFormat(json, kFormat, kFormatVersion, where));
  SketchManifest manifest;
  ASSIGN_OR_RETURN(const Json* views, jsonMember(json, "views", where));
  if (!views->is_array() || views->size() != 1) {
    return failure(ErrorCode::kUnsupported, "{}: field 'views' does not list exactly one view",
                   where);
  }
  const Json& view = views->front();
  ASSIGN_OR_RETURN(const auto projection, jsonString(view, "projection", where));
  if (projection != "perspective") {
    return failure(ErrorCode::kUnsupported, "{}: views of projection '{}' are not supported", where,
                   projection);
  }
  ASSIGN_OR_RETURN(const auto width, jsonInteger(view, "width", where, 1, kMaxSide));
  ASSIGN_OR_RETURN(const auto height, jsonInteger(view, "height", where, 1, kMaxSide));
  if (width * height > kMaxPixels) {
    return failure(ErrorCode::kUnsupported, "{}: {} x {} pixels are more than are read here", where,
                   width, height);
  }
  manifest.width = static_cast<int>(width);
  manifest.height = static_cast<int>(height);
  ASSIGN_OR_RETURN(const Json* grid, jsonMember(json, "grid", where));
  ASSIGN_OR_RETURN(const auto directions,
                   jsonInteger(*grid, "directions", where, 0, kMaxDirections));
  manifest.directions = static_cast<int>(directions);
  ASSIGN_OR_RETURN(const auto domain, jsonString(*grid, "domain", where));
  if (domain != "sphere" && domain != "hemisphere") {
    return failure(ErrorCode::kCorrupt, "{}: field 'domain' is neither 'sphere' nor 'hemisphere'",
                   where);
  }
  manifest.fullSphere = domain == "sphere";
  ASSIGN_OR_RETURN(manifest.ambientSubtracted, jsonBool(json, "ambientSubtracted", where));
  ASSIGN_OR_RETURN(manifest.software, jsonString(json, "software", where));
  ASSIGN_OR_RETURN(const Json* cameras, jsonMember(json, "cameras", where));
  ASSIGN_OR_RETURN(const Json* provenance, jsonMember(json, "provenance", where));
  if (!cameras->is_array()) {
    return failure(ErrorCode::kCorrupt, "{}: field 'cameras' is not an array", where);
  }
  if (!provenance->is_object()) {
    return failure(ErrorCode::kCorrupt, "{}: field 'provenance' is not an object", where);
  }
  manifest.cameras = *cameras;
  manifest.provenance = *provenance;
  return manifest;
}

// --- A line of the journal -----------------------------------------------------------------------

// A line is a JSON object whose last field, "crc", is the checksum of the text before it. It is
// checked on the bytes, so that a damaged line is found even where it still is JSON.
constexpr std::string_view kCrcStart = ",\"crc\":\"";
constexpr std::string_view kCrcEnd = "\"}";
constexpr std::size_t kCrcDigits = 16;

std::string sealLine(const Json& event) {
  std::string line = event.dump(-1, ' ', false, Json::error_handler_t::replace);
  line.pop_back();
  const std::string crc = checksum(line);
  return line.append(kCrcStart).append(crc).append(kCrcEnd).append("\n");
}

bool sealHolds(std::string_view line) {
  const std::size_t tail = kCrcStart.size() + kCrcDigits + kCrcEnd.size();
  if (line.size() <= tail) return false;
  const std::string_view content = line.substr(0, line.size() - tail);
  return line.substr(content.size(), kCrcStart.size()) == kCrcStart &&
         line.substr(content.size() + kCrcStart.size(), kCrcDigits) == checksum(content) &&
         line.ends_with(kCrcEnd);
}

Json eventOf(const char* kind) { return {{"event", kind}, {"version", kEventVersion}}; }

template <int Size>
Json matrixToJson(const Eigen::Matrix<double, Size, Size>& symmetric) {
  return toJson(Eigen::Map<const Eigen::VectorXd>(symmetric.data(), symmetric.size()));
}

template <int Size>
Result<Eigen::Matrix<double, Size, Size>> matrixFromJson(const Json& json, std::string_view field,
                                                         std::string_view where) {
  ASSIGN_OR_RETURN(const auto values, jsonVector(json, field, Size * Size, where));
  return Eigen::Matrix<double, Size, Size>(
      Eigen::Map<const Eigen::Matrix<double, Size, Size>>(values.data()));
}

Json lightToJson(const LightDirection& light) {
  Json json = {{"type", light.position ? "point" : "directional"},
               {"direction", toJson(light.direction)},
               {"covariance", matrixToJson<3>(light.covariance)}};
  if (light.position) json["positionMetres"] = toJson(*light.position);
  if (!light.positionCovariance.isZero(0)) {
    json["positionCovariance"] = matrixToJson<3>(light.positionCovariance);
  }
  return json;
}

Result<LightDirection> lightFromJson(const Json& event, std::string_view where) {
  ASSIGN_OR_RETURN(const Json* json, jsonMember(event, "light", where));
  LightDirection light;
  ASSIGN_OR_RETURN(const auto type, jsonString(*json, "type", where));
  if (type != "point" && type != "directional") {
    return failure(ErrorCode::kUnsupported, "{}: lights of type '{}' are not supported", where,
                   type);
  }
  ASSIGN_OR_RETURN(light.direction, jsonVector(*json, "direction", 3, where));
  ASSIGN_OR_RETURN(light.covariance, matrixFromJson<3>(*json, "covariance", where));
  if (type == "point") {
    ASSIGN_OR_RETURN(light.position, jsonVector(*json, "positionMetres", 3, where));
  }
  if (json->contains("positionCovariance")) {
    ASSIGN_OR_RETURN(light.positionCovariance,
                     matrixFromJson<3>(*json, "positionCovariance", where));
  }
  return light;
}

// What a caller or a journal may claim about a light.
Result<void> checkLight(const LightDirection& light, ErrorCode code, std::string_view where) {
  // Directions are stored with full precision; 1e-6 only catches vectors nobody normalised.
  if (!(std::abs(light.direction.norm() - 1) < 1e-6)) {
    return failure(code, "{}: the light direction ({}, {}, {}) is not a unit vector", where,
                   light.direction.x(), light.direction.y(), light.direction.z());
  }
  if (!light.covariance.allFinite() || !light.positionCovariance.allFinite() ||
      (light.position && !light.position->allFinite())) {
    return failure(code, "{}: the light's covariance or position is not finite", where);
  }
  return {};
}

Result<void> checkLampScale(const std::array<double, 3>& lampScale, ErrorCode code,
                            std::string_view where) {
  for (const double scale : lampScale) {
    if (!(scale > 0 && std::isfinite(scale))) {
      return failure(code, "{}: lampScale must be positive", where);
    }
  }
  return {};
}

Result<void> checkRecord(const FrameRecord& record, ErrorCode code, std::string_view where) {
  RETURN_IF_ERROR(checkLight(record.light, code, where));
  RETURN_IF_ERROR(checkLampScale(record.lampScale, code, where));
  bool finite = true;
  for (const double value : {record.exposureSeconds, record.gainDb, record.midExposureSeconds,
                             record.pairingErrorSeconds, record.saturatedFraction}) {
    finite = finite && std::isfinite(value);
  }
  for (const auto& lamp : record.lampPixels) {
    finite = finite && lamp.pixel.allFinite() && lamp.covariance.allFinite();
  }
  if (!finite) return failure(code, "{}: a frame's times and pixels must be finite", where);
  return {};
}

Json frameToJson(const FrameRecord& record) {
  Json json = eventOf("frame");
  Json lamps = Json::array();
  for (const auto& lamp : record.lampPixels) {
    lamps.push_back({{"camera", lamp.camera},
                     {"pixel", toJson(lamp.pixel)},
                     {"covariance", matrixToJson<2>(lamp.covariance)}});
  }
  json["id"] = record.id;
  json["file"] = record.file;
  json["checksum"] = record.checksum;
  json["origin"] = record.origin;
  json["light"] = lightToJson(record.light);
  json["lampPixels"] = std::move(lamps);
  json["calibrationId"] = record.calibrationId;
  json["exposureSeconds"] = record.exposureSeconds;
  json["gainDb"] = record.gainDb;
  json["lampScale"] = record.lampScale;
  json["midExposureSeconds"] = record.midExposureSeconds;
  json["pairingErrorSeconds"] = record.pairingErrorSeconds;
  json["saturatedFraction"] = record.saturatedFraction;
  json["gates"] = record.gates;
  return json;
}

// A journal must not make us read or write outside the sketch.
bool isFrameFile(const std::string& file) {
  const fs::path path(file);
  return !path.is_absolute() && std::distance(path.begin(), path.end()) == 2 &&
         *path.begin() == kFramesFolder && path.filename() != ".." && path.filename() != "." &&
         !path.filename().empty();
}

Result<FrameRecord> frameFromJson(const Json& json, std::string_view where) {
  FrameRecord record;
  ASSIGN_OR_RETURN(const auto id, jsonInteger(json, "id", where, 0, kMaxFrames));
  record.id = static_cast<int>(id);
  ASSIGN_OR_RETURN(record.file, jsonString(json, "file", where));
  if (!isFrameFile(record.file)) {
    return failure(ErrorCode::kCorrupt, "{}: field 'file' ('{}') does not lie in frames/", where,
                   record.file);
  }
  ASSIGN_OR_RETURN(record.checksum, jsonString(json, "checksum", where));
  ASSIGN_OR_RETURN(record.origin, jsonString(json, "origin", where));
  ASSIGN_OR_RETURN(record.light, lightFromJson(json, where));
  ASSIGN_OR_RETURN(const Json* lamps, jsonMember(json, "lampPixels", where));
  if (!lamps->is_array()) {
    return failure(ErrorCode::kCorrupt, "{}: field 'lampPixels' is not an array", where);
  }
  for (const Json& element : *lamps) {
    LampPixel lamp;
    ASSIGN_OR_RETURN(lamp.camera, jsonString(element, "camera", where));
    ASSIGN_OR_RETURN(lamp.pixel, jsonVector(element, "pixel", 2, where));
    ASSIGN_OR_RETURN(lamp.covariance, matrixFromJson<2>(element, "covariance", where));
    record.lampPixels.push_back(std::move(lamp));
  }
  ASSIGN_OR_RETURN(record.calibrationId, jsonString(json, "calibrationId", where));
  ASSIGN_OR_RETURN(record.exposureSeconds, jsonNumber(json, "exposureSeconds", where));
  ASSIGN_OR_RETURN(record.gainDb, jsonNumber(json, "gainDb", where));
  ASSIGN_OR_RETURN(const auto scale, jsonVector(json, "lampScale", 3, where));
  std::copy(scale.begin(), scale.end(), record.lampScale.begin());
  ASSIGN_OR_RETURN(record.midExposureSeconds, jsonNumber(json, "midExposureSeconds", where));
  ASSIGN_OR_RETURN(record.pairingErrorSeconds, jsonNumber(json, "pairingErrorSeconds", where));
  ASSIGN_OR_RETURN(record.saturatedFraction, jsonNumber(json, "saturatedFraction", where));
  ASSIGN_OR_RETURN(const Json* gates, jsonMember(json, "gates", where));
  record.gates = *gates;
  RETURN_IF_ERROR(checkRecord(record, ErrorCode::kCorrupt, where));
  return record;
}

// What the journal adds up to.
struct Replay {
  std::vector<FrameRecord> frames;
  std::set<std::string> ambientChecksums;

  Result<FrameRecord*> frame(const Json& event, std::string_view where) {
    ASSIGN_OR_RETURN(const auto id, jsonInteger(event, "id", where, 0,
                                                static_cast<std::int64_t>(frames.size()) - 1));
    return &frames[static_cast<std::size_t>(id)];
  }

  Result<void> apply(const Json& event, std::string_view where) {
    ASSIGN_OR_RETURN(const auto kind, jsonString(event, "event", where));
    ASSIGN_OR_RETURN(const auto version, jsonInteger(event, "version", where, 1, 1'000'000));
    const bool known = kind == "frame" || kind == "drop" || kind == "restore" ||
                       kind == "relight" || kind == "ambient" || kind == "note";
    if (!known || version > kEventVersion) {
      return failure(ErrorCode::kUnsupported,
                     "{}: event '{}' version {} was written by a newer lightsketch; update "
                     "lightsketch",
                     where, kind, version);
    }
    if (kind == "frame") {
      ASSIGN_OR_RETURN(auto record, frameFromJson(event, where));
      if (record.id != static_cast<int>(frames.size())) {
        return failure(ErrorCode::kCorrupt, "{}: field 'id' is {}, expected {}; a line is missing",
                       where, record.id, frames.size());
      }
      frames.push_back(std::move(record));
    } else if (kind == "drop") {
      ASSIGN_OR_RETURN(FrameRecord * record, frame(event, where));
      ASSIGN_OR_RETURN(record->dropReason, jsonString(event, "reason", where));
      record->dropped = true;
    } else if (kind == "restore") {
      ASSIGN_OR_RETURN(FrameRecord * record, frame(event, where));
      record->dropped = false;
      record->dropReason.clear();
    } else if (kind == "relight") {
      ASSIGN_OR_RETURN(FrameRecord * record, frame(event, where));
      ASSIGN_OR_RETURN(const auto light, lightFromJson(event, where));
      RETURN_IF_ERROR(checkLight(light, ErrorCode::kCorrupt, where));
      ASSIGN_OR_RETURN(record->calibrationId, jsonString(event, "calibrationId", where));
      if (event.contains("lampScale")) {
        ASSIGN_OR_RETURN(const auto values, jsonVector(event, "lampScale", 3, where));
        const std::array<double, 3> scale{values[0], values[1], values[2]};
        RETURN_IF_ERROR(checkLampScale(scale, ErrorCode::kCorrupt, where));
        record->lampScale = scale;
      }
      record->light = light;
    } else if (kind == "ambient") {
      ASSIGN_OR_RETURN(auto sum, jsonString(event, "checksum", where));
      ambientChecksums.insert(std::move(sum));
    }
    return {};
  }
};

// Replays whole lines; returns how many bytes of `text` they take. Only the last line may be torn:
// it was being written when the program or the machine stopped, so nobody was told it is safe. A
// kill leaves its beginning, a power cut also zeros in place of some of it. A last line that is
// whole but wrong is damage like any other: it may have been acknowledged.
Result<std::size_t> replayJournal(std::string_view text, const fs::path& path, Replay& replay) {
  std::size_t position = 0;
  for (std::size_t number = 1; position < text.size(); ++number) {
    const std::size_t newline = text.find('\n', position);
    if (newline == text.npos) break;
    const std::string_view line = text.substr(position, newline - position);
    const std::string where = fmt::format("{}: line {}", path.string(), number);
    if (!sealHolds(line)) {
      if (newline + 1 == text.size() && line.find('\0') != line.npos) break;
      return failure(ErrorCode::kCorrupt,
                     "{}: damaged (its checksum does not fit); restore the file from a copy",
                     where);
    }
    ASSIGN_OR_RETURN(const auto event, parseJson(line, where));
    RETURN_IF_ERROR(replay.apply(event, where));
    position = newline + 1;
  }
  return position;
}

// Left behind by a writer that was stopped: a temporary file or an image that no line speaks of.
void removeLeftovers(const fs::path& folder, const std::vector<FrameRecord>& frames) {
  // By number: a frame's raw counts stand beside it, "000123.raw.png".
  const auto number = [](const fs::path& file) {
    const std::string name = file.filename().string();
    return name.substr(0, name.find('.'));
  };
  std::set<std::string> recorded;
  for (const auto& record : frames) recorded.insert(number(record.file));
  std::error_code error;
  std::vector<fs::path> leftovers;
  for (const auto& directory : {folder, folder / kFramesFolder}) {
    for (fs::directory_iterator entry(directory, error), end; !error && entry != end;
         entry.increment(error)) {
      const std::string name = entry->path().filename().string();
      const bool partial = name.starts_with(".") && name.find(".partial") != name.npos;
      const bool ours = name.ends_with(".exr") || name.ends_with(".raw.png");
      const bool orphan = directory != folder && ours && !recorded.contains(number(name));
      if (partial || orphan) leftovers.push_back(entry->path());
    }
  }
  for (const auto& path : leftovers) fs::remove(path, error);
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
  record.file = fmt::format("{}/{:06d}.exr", kFramesFolder, record.id);
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
                     {"gainDb", record.gainDb}};
  if (!record.origin.empty()) options.attributes["origin"] = record.origin;
  ASSIGN_OR_RETURN(const auto bytes, encodeExr(radiance, options));
  record.checksum = checksum(bytes);

  // First the image, then the line that vouches for it.
  auto written = durable ? writeFileAtomically(path, bytes) : writeUnsynced(path, bytes);
  if (written) written = writeEvent(frameToJson(record), durable);
  if (!written) {
    std::error_code ignored;
    fs::remove(path, ignored);
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
  if (manifest.width < 1 || manifest.height < 1 || manifest.width > kMaxSide ||
      manifest.height > kMaxSide || std::int64_t{manifest.width} * manifest.height > kMaxPixels) {
    return failure(ErrorCode::kInvalidArgument, "{}: a sketch cannot have frames of {} x {} pixels",
                   folder.string(), manifest.width, manifest.height);
  }
  ASSIGN_OR_RETURN(auto pending, PendingFolder::create(folder));
  std::error_code error;
  for (const char* name : {kFramesFolder, "calibration"}) {
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

  // The kernel drops this lock with the process, so a killed writer leaves none behind.
  const fs::path lockPath = folder / kLockFile;
  state->lock = Descriptor(::open(lockPath.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644));
  if (!state->lock) return systemFailure(errno, "write", lockPath);
  if (::flock(state->lock.get(), LOCK_EX | LOCK_NB) != 0) {
    if (errno != EWOULDBLOCK) return systemFailure(errno, "lock", lockPath);
    return failure(ErrorCode::kIo,
                   "{}: another program is writing to this sketch; close it or wait for it",
                   folder.string());
  }
  RETURN_IF_ERROR(state->load());

  const fs::path journalPath = state->journalPath();
  state->journal = Descriptor(::open(journalPath.c_str(), O_WRONLY | O_APPEND | O_CLOEXEC));
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
  removeLeftovers(folder, state->replay.frames);
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
