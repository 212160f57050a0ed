#include "pipeline/sketch/sketch_files.h"

#include <fcntl.h>
#include <sys/file.h>

#include <algorithm>
#include <cerrno>
#include <cmath>

#include "capture/frame/file.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kFormat = "lightsketch-sketch";
constexpr int kFormatVersion = 1;
constexpr int kEventVersion = 1;
constexpr std::int64_t kMaxDirections = 1'000'000;
constexpr std::int64_t kMaxFrames = 10'000'000;

constexpr std::string_view kCrcStart = ",\"crc\":\"";
constexpr std::string_view kCrcEnd = "\"}";
constexpr std::size_t kCrcDigits = 16;

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

}  // namespace

std::string frameFile(int id) { return fmt::format("{}/{:06d}.exr", kFramesFolder, id); }

std::string frameNumber(const fs::path& file) {
  const std::string name = file.filename().string();
  return name.substr(0, name.find('.'));
}

Result<std::vector<fs::path>> unnamedPictures(const fs::path& folder,
                                              const std::vector<FrameRecord>& frames) {
  std::set<std::string> named;
  for (const auto& record : frames) named.insert(fs::path(record.file).filename().string());
  std::vector<fs::path> pictures;
  std::error_code error;
  for (fs::directory_iterator entry(folder / kFramesFolder, error), end; !error && entry != end;
       entry.increment(error)) {
    const std::string name = entry->path().filename().string();
    const std::string number = frameNumber(name);
    if (name == number + ".exr" && number.size() >= 6 && number.size() <= 8 &&
        number.find_first_not_of("0123456789") == number.npos && !named.contains(name)) {
      pictures.push_back(entry->path());
    }
  }
  if (error) {
    return failure(ErrorCode::kIo, "{}: cannot be read: {}", (folder / kFramesFolder).string(),
                   error.message());
  }
  std::sort(pictures.begin(), pictures.end(), [](const fs::path& a, const fs::path& b) {
    return std::stoi(frameNumber(a)) < std::stoi(frameNumber(b));
  });
  return pictures;
}

Result<Descriptor> lockForWriting(const fs::path& folder) {
  // The kernel drops this lock with the process, so a killed writer leaves none behind.
  const fs::path path = folder / kLockFile;
  Descriptor lock(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0644));
  if (!lock || ::flock(lock.get(), LOCK_EX | LOCK_NB) != 0) {
    if (lock && errno == EWOULDBLOCK) {
      return failure(ErrorCode::kIo,
                     "{}: another program is writing to this sketch; close it or wait for it",
                     folder.string());
    }
    return failure(ErrorCode::kIo, "{}: cannot {}: {}", path.string(), lock ? "lock" : "write",
                   systemMessage(errno));
  }
  return lock;
}

Result<void> refuseLink(const fs::path& path) {
  std::error_code error;
  if (!fs::is_symlink(fs::symlink_status(path, error))) return {};
  return failure(ErrorCode::kUnsupported,
                 "{}: is a link, which may lead out of the sketch; put the file itself there",
                 path.string());
}

Result<void> refuseLinks(const fs::path& folder) {
  for (const char* name : {kManifestFile, kRigFile, kJournalFile, kFramesFolder, kAmbientFile,
                           kCalibrationFolder, kLockFile}) {
    RETURN_IF_ERROR(refuseLink(folder / name));
  }
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
  ASSIGN_OR_RETURN(const auto width, jsonInteger(view, "width", where, 1, kMaxFrameSide));
  ASSIGN_OR_RETURN(const auto height, jsonInteger(view, "height", where, 1, kMaxFrameSide));
  if (width * height > kMaxFramePixels) {
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

// --- The journal ---------------------------------------------------------------------------------

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

Result<FrameRecord*> Replay::frame(const Json& event, std::string_view where) {
  ASSIGN_OR_RETURN(const auto id, jsonInteger(event, "id", where, 0,
                                              static_cast<std::int64_t>(frames.size()) - 1));
  return &frames[static_cast<std::size_t>(id)];
}

Result<void> Replay::apply(const Json& event, std::string_view where) {
  ASSIGN_OR_RETURN(const auto kind, jsonString(event, "event", where));
  ASSIGN_OR_RETURN(const auto version, jsonInteger(event, "version", where, 1, 1'000'000));
  const bool known = kind == "frame" || kind == "drop" || kind == "restore" || kind == "relight" ||
                     kind == "ambient" || kind == "note";
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
bool isTornEnd(std::string_view line) {
  return !line.ends_with('\n') || line.find('\0') != line.npos;
}

Result<std::size_t> replayJournal(std::string_view text, const fs::path& path, Replay& replay) {
  std::size_t position = 0;
  for (std::size_t number = 1; position < text.size(); ++number) {
    const std::size_t newline = text.find('\n', position);
    if (newline == text.npos) break;
    const std::string_view line = text.substr(position, newline - position);
    const std::string where = fmt::format("{}: line {}", path.string(), number);
    if (!sealHolds(line)) {
      if (newline + 1 == text.size() && isTornEnd(text.substr(position))) break;
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

}  // namespace lightsketch
