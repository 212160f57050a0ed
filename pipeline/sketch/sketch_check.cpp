#include "pipeline/sketch/sketch_check.h"

#include <algorithm>
#include <optional>
#include <string_view>
#include <utility>

#include "calibration/model/camera_model.h"
#include "calibration/model/rig_geometry.h"
#include "capture/frame/file.h"
#include "pipeline/sketch/image_file.h"
#include "pipeline/sketch/sketch_files.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

// More frames than any sketch has; a hostile id must not make us fill a gap for hours.
constexpr int kLongestGap = 10'000;

// Damage is what a file says wrongly or that it is not there. All else (rights, handles, a disk
// that does not answer) says nothing about the sketch and ends the check.
bool isDamage(const Error& error) {
  return error.code == ErrorCode::kCorrupt || error.code == ErrorCode::kNotFound;
}

// "FILE: reason" without the file, which stands before it already.
std::string reasonOf(const Error& error, const fs::path& path) {
  const std::string& message = error.message;
  const std::string prefix = path.string() + ": ";
  return message.starts_with(prefix) ? message.substr(prefix.size()) : message;
}

// Everything that is known of a sketch, and what its files should become.
class Examination {
 public:
  Examination(fs::path folder, bool repairing, Progress& progress)
      : folder_(std::move(folder)), repairing_(repairing), progress_(progress) {}

  Result<void> run() {
    std::error_code error;
    if (!fs::is_directory(folder_, error)) {
      return failure(ErrorCode::kNotFound, "{}: there is no such folder", folder_.string());
    }
    if (!fs::exists(folder_ / kManifestFile, error) && !fs::exists(folder_ / kJournalFile, error)) {
      return failure(ErrorCode::kNotFound, "{}: is not a sketch (it has neither {} nor {})",
                     folder_.string(), kManifestFile, kJournalFile);
    }
    RETURN_IF_ERROR(refuseLinks(folder_));
    RETURN_IF_ERROR(readManifest());
    RETURN_IF_ERROR(readJournal());
    RETURN_IF_ERROR(takeInUnnamedPictures());
    RETURN_IF_ERROR(checkPictures());
    RETURN_IF_ERROR(checkAmbient());
    return checkCalibration();
  }

  // Each step leaves a sketch that another repair goes on with; the journal is last, since only it
  // says that there was damage.
  Result<void> repair() {
    std::error_code error;
    fs::create_directory(folder_ / kFramesFolder, error);
    if (newManifest_) {
      RETURN_IF_ERROR(keepBeside(folder_ / kManifestFile));
      RETURN_IF_ERROR(writeJsonFile(folder_ / kManifestFile, manifestToJson(*newManifest_)));
    }
    for (const fs::path& path : toSetAside_) {
      RETURN_IF_ERROR(keepBeside(path));
      if (!fs::remove(path, error)) {
        return failure(ErrorCode::kIo, "{}: cannot remove: {}", path.string(), error.message());
      }
    }
    const fs::path journal = folder_ / kJournalFile;
    if (newJournal_ == journal_) return {};
    if (!newJournal_.starts_with(journal_)) {
      RETURN_IF_ERROR(keepBeside(journal));
      Json note = eventOf("note");
      note["text"] = fmt::format("check --repair: {} damaged places", found.damage.size());
      newJournal_ += sealLine(note);
    }
    return writeFileAtomically(journal, newJournal_);
  }

  SketchCheck found;

 private:
  void damaged(const fs::path& path, int line, std::string what, std::string remedy) {
    found.damage.push_back(
        {fs::relative(path, folder_).string(), line, std::move(what), std::move(remedy)});
  }

  // A copy that is whole before the original changes.
  static Result<void> keepBeside(const fs::path& path) {
    const auto content = readFile(path);
    if (!content) {
      if (content.error().code == ErrorCode::kNotFound) return {};
      return tl::unexpected(content.error());
    }
    for (int number = 1;; ++number) {
      fs::path copy = path;
      copy += number == 1 ? std::string(".damaged") : fmt::format(".damaged-{}", number);
      const auto there = readFile(copy);
      if (there && *there == *content) return {};
      if (there) continue;
      if (there.error().code != ErrorCode::kNotFound) return tl::unexpected(there.error());
      return writeFileAtomically(copy, *content);
    }
  }

  Result<void> readManifest() {
    const fs::path path = folder_ / kManifestFile;
    const auto read = [&]() -> Result<SketchManifest> {
      ASSIGN_OR_RETURN(const Json json, readJsonFile(path));
      return manifestFromJson(json, path.string());
    };
    auto manifest = read();
    if (manifest) {
      manifest_ = std::move(*manifest);
    } else if (!isDamage(manifest.error())) {
      return tl::unexpected(manifest.error());
    } else {
      // All that a reader needs is the frames' size, which every picture knows.
      ASSIGN_OR_RETURN(const auto pictures, unnamedPictures(folder_, {}));
      std::optional<RadianceImage> first;
      for (const fs::path& picture : pictures) {
        if (auto image = readPicture(picture)) {
          first = std::move(*image);
          break;
        }
      }
      if (!first) {
        return failure(ErrorCode::kCorrupt,
                       "{}; there is no whole picture to make it anew from: restore it from a copy",
                       manifest.error().message);
      }
      manifest_.width = first->width();
      manifest_.height = first->height();
      manifest_.software = "lightsketch check --repair";
      newManifest_ = manifest_;
      damaged(path, 0, reasonOf(manifest.error(), path),
              fmt::format("made anew for frames of {} x {}; cameras, grid and provenance are lost",
                          manifest_.width, manifest_.height));
    }
    const fs::path rigPath = folder_ / kRigFile;
    std::error_code error;
    if (!fs::exists(rigPath, error)) return {};
    if (const auto rig = loadRigGeometry(rigPath); !rig) {
      if (!isDamage(rig.error())) return tl::unexpected(rig.error());
      setAside(rigPath, reasonOf(rig.error(), rigPath), "the cameras' poses are lost");
    }
    return {};
  }

  void setAside(const fs::path& path, std::string what, std::string_view consequence) {
    damaged(path, 0, std::move(what),
            fmt::format("set aside as {}.damaged; {}", path.filename().string(), consequence));
    toSetAside_.push_back(path);
  }

  static Result<RadianceImage> readPicture(const fs::path& path) {
    RETURN_IF_ERROR(refuseLink(path));
    ASSIGN_OR_RETURN(const auto bytes, readFile(path));
    return decodeExr(bytes, path.string());
  }

  // A line of which one bit was flipped, as it was. Its checksum has 64 bits: none of the some
  // thousand others fits by chance.
  std::optional<std::string> withItsBitBack(std::string_view line) {
    if (line.size() > bytesToTry_) return std::nullopt;
    bytesToTry_ -= line.size();
    std::string text(line);
    for (char& c : text) {
      for (int bit = 0; bit < 8; ++bit) {
        c = static_cast<char>(c ^ (1 << bit));
        if (sealHolds(text)) return text;
        c = static_cast<char>(c ^ (1 << bit));
      }
    }
    return std::nullopt;
  }

  Result<void> readJournal() {
    const fs::path path = folder_ / kJournalFile;
    if (auto text = readFile(path)) {
      journal_ = std::move(*text);
    } else if (isDamage(text.error())) {
      damaged(path, 0, "is missing", "made anew from the pictures' headers");
    } else {
      return tl::unexpected(text.error());
    }
    std::string_view rest = journal_;
    for (int number = 1; !rest.empty(); ++number) {
      const auto newline = std::min(rest.find('\n'), rest.size() - 1);
      const std::string_view whole = rest.substr(0, newline + 1);
      const bool last = whole.size() == rest.size();
      rest.remove_prefix(whole.size());
      std::string line(whole.substr(0, whole.size() - (whole.ends_with('\n') ? 1 : 0)));
      const bool holds = whole.ends_with('\n') && sealHolds(line);
      if (!holds) {
        if (last && isTornEnd(whole)) {
          tornBytes_ = whole.size();
          break;
        }
        auto mended = withItsBitBack(line);
        damaged(path, number, "its checksum does not fit",
                mended ? "one bit was flipped; it is put right" : "the line is left out");
        if (!mended) {
          lost_ += line;
          continue;
        }
        line = std::move(*mended);
      }
      RETURN_IF_ERROR(take(line, path, number));
    }
    return {};
  }

  // A line whose checksum holds, after the frames that its id shows to be missing.
  Result<void> take(const std::string& line, const fs::path& path, int number) {
    const std::string where = fmt::format("{}: line {}", path.string(), number);
    const auto applied = [&]() -> Result<void> {
      ASSIGN_OR_RETURN(const Json event, parseJson(line, where));
      const auto id = event.is_object() && event.value("event", Json()) == "frame"
                          ? jsonInteger(event, "id", where, next(), next() + kLongestGap)
                          : Result<std::int64_t>(0);
      if (id) {
        while (next() < *id) RETURN_IF_ERROR(recover(next()));
      }
      return replay_.apply(event, where);
    }();
    if (applied) {
      newJournal_ += line + "\n";
      ++found.lines;
    } else if (isDamage(applied.error())) {
      damaged(path, number, reasonOf(applied.error(), where), "the line is left out");
    } else {
      return tl::unexpected(applied.error());
    }
    return {};
  }

  int next() const { return static_cast<int>(replay_.frames.size()); }

  // The frame `id`, which no line speaks of, from its picture's header; a dropped frame in its
  // place if there is no whole picture, so that the ids of those behind it stay.
  Result<void> recover(int id) {
    FrameRecord record;
    record.id = id;
    record.file = frameFile(id);
    const fs::path path = folder_ / record.file;
    const auto read = [&]() -> Result<void> {
      RETURN_IF_ERROR(refuseLink(path));
      ASSIGN_OR_RETURN(const auto bytes, readFile(path));
      record.checksum = checksum(bytes);
      ASSIGN_OR_RETURN(const auto picture, decodeExr(bytes, path.string()));
      if (picture.width() != manifest_.width || picture.height() != manifest_.height) {
        return failure(ErrorCode::kCorrupt, "{}: is {} x {}, not {} x {}", path.string(),
                       picture.width(), picture.height(), manifest_.width, manifest_.height);
      }
      ASSIGN_OR_RETURN(const auto header, readExrHeader(bytes, path.string()));
      const auto number = [&](const char* name, double otherwise) {
        const auto value = header.numbers.find(name);
        return value == header.numbers.end() ? otherwise : value->second;
      };
      record.light.direction = {number("lightX", 0), number("lightY", 0), number("lightZ", 0)};
      record.exposureSeconds = number("exposureSeconds", 0);
      record.gainDb = number("gainDb", 0);
      record.midExposureSeconds = number("midExposureSeconds", 0);
      record.lampScale = {number("lampScaleR", 1), number("lampScaleG", 1),
                          number("lampScaleB", 1)};
      if (const auto origin = header.attributes.find("origin"); origin != header.attributes.end())
        record.origin = origin->second;
      return checkRecord(record, ErrorCode::kCorrupt, path.string());
    };
    const auto whole = read();
    if (!whole && whole.error().code != ErrorCode::kUnsupported && !isDamage(whole.error()))
      return tl::unexpected(whole.error());
    if (whole) {
      // What is left of a lost line may still hold the picture's checksum.
      const bool sure = lost_.find(record.checksum) != lost_.npos;
      record.gates = {{"recovered", sure ? "picture verified" : "picture not verified"}};
      damaged(path, 0, "no line names it",
              fmt::format("frame {} is taken from its header: light, exposure, lamp scale", id));
      ++found.recovered;
    } else {
      FrameRecord empty;
      empty.id = id;
      empty.file = record.file;
      empty.checksum = record.checksum;
      record = std::move(empty);
      damaged(path, 0,
              fmt::format("no line names it, and it {}",
                          whole.error().code == ErrorCode::kNotFound
                              ? "is missing"
                              : "cannot be used: " + reasonOf(whole.error(), path)),
              fmt::format("frame {} is dropped", id));
    }
    RETURN_IF_ERROR(add(frameToJson(record)));
    return whole ? Result<void>() : drop(id, "its line and its picture are lost");
  }

  Result<void> add(const Json& event) {
    newJournal_ += sealLine(event);
    return replay_.apply(event, "repair");
  }
  Result<void> drop(int id, const std::string& reason) {
    Json event = eventOf("drop");
    event["id"] = id;
    event["reason"] = "check --repair: " + reason;
    return add(event);
  }

  Result<void> takeInUnnamedPictures() {
    std::error_code error;
    if (!fs::is_directory(folder_ / kFramesFolder, error)) {
      damaged(folder_ / kFramesFolder, 0, "is missing", "an empty one is made");
      return {};
    }
    ASSIGN_OR_RETURN(auto pictures, unnamedPictures(folder_, replay_.frames));
    // What a kill leaves: the picture that was about to be acknowledged, or half its line. A repair
    // takes the picture in, since lines that are lost with all behind them leave the same.
    const bool oneBeingWritten =
        pictures.size() == 1 && frameNumber(pictures.front()) == frameNumber(frameFile(next()));
    if (found.damage.empty() && !(repairing_ && oneBeingWritten) &&
        (pictures.empty() || oneBeingWritten)) {
      if (oneBeingWritten || tornBytes_ > 0) {
        found.remarks.push_back(
            "recording was cut off while it wrote a frame, which was not yet acknowledged; the "
            "next recording clears it away" +
            std::string(oneBeingWritten ? ", --repair takes it in" : ""));
      }
      return {};
    }
    if (tornBytes_ > 0) {
      damaged(folder_ / kJournalFile, found.lines + 1, "ends within a line", "its rest is cut off");
    }
    for (const fs::path& path : pictures) {
      const int id = std::stoi(frameNumber(path));
      if (id < next() || id > next() + kLongestGap) {
        setAside(path, "no line names it, and its number fits no frame", "nothing needs it");
        continue;
      }
      while (next() <= id) RETURN_IF_ERROR(recover(next()));
    }
    return {};
  }

  Result<void> checkPictures() {
    for (std::size_t i = 0; i < replay_.frames.size(); ++i) {
      if (progress_.cancelled()) {
        return failure(ErrorCode::kCancelled, "cancelled; nothing was changed");
      }
      progress_.update("checking frames", i + 1, replay_.frames.size());
      const FrameRecord& record = replay_.frames[i];
      if (record.dropped) continue;
      const fs::path path = folder_ / record.file;
      std::string what;
      if (const auto linked = refuseLink(path); !linked) {
        what = reasonOf(linked.error(), path);
      } else if (const auto sum = checksumOfFile(path); !sum) {
        if (!isDamage(sum.error())) return tl::unexpected(sum.error());
        what = "is missing";
      } else if (*sum != record.checksum) {
        what = "its checksum does not fit";
      }
      if (what.empty()) {
        ++found.frames;
        continue;
      }
      damaged(path, 0, what,
              fmt::format("frame {} is dropped; with a copy of the file in its place, "
                          "lightsketch restore brings it back",
                          record.id));
      RETURN_IF_ERROR(drop(record.id, "the picture: " + what));
    }
    return {};
  }

  Result<void> checkAmbient() {
    const fs::path path = folder_ / kAmbientFile;
    std::error_code error;
    if (!fs::exists(path, error)) return {};
    ASSIGN_OR_RETURN(const auto sum, checksumOfFile(path));
    if (replay_.ambientChecksums.contains(sum)) return {};
    const auto picture = readPicture(path);
    if (picture && picture->width() == manifest_.width && picture->height() == manifest_.height &&
        (replay_.ambientChecksums.empty() || !lost_.empty())) {
      damaged(path, 0, "its line is lost", "it is named again");
      Json event = eventOf("ambient");
      event["checksum"] = sum;
      return add(event);
    }
    setAside(path, "its checksum is not in the journal", "frames keep the ambient light");
    return {};
  }

  Result<void> checkCalibration() {
    std::error_code error;
    std::vector<fs::path> files;
    for (fs::directory_iterator entry(folder_ / kCalibrationFolder, error), end;
         !error && entry != end; entry.increment(error)) {
      if (entry->path().extension() == ".json") files.push_back(entry->path());
    }
    std::sort(files.begin(), files.end());
    for (const fs::path& path : files) {
      const auto read = [&]() -> Result<void> {
        RETURN_IF_ERROR(refuseLink(path));
        ASSIGN_OR_RETURN(const Json json, readJsonFile(path));
        if (json.is_object() && json.value("format", Json()) == "lightsketch-camera")
          RETURN_IF_ERROR(cameraModelFromJson(json, path.string()));
        return {};
      }();
      if (read || !isDamage(read.error())) continue;
      setAside(path, reasonOf(read.error(), path), "copy the camera's model here again");
    }
    return {};
  }

  const fs::path folder_;
  const bool repairing_;
  Progress& progress_;
  SketchManifest manifest_;
  std::optional<SketchManifest> newManifest_;
  std::string journal_;     // as it is
  std::string newJournal_;  // as it should be
  std::string lost_;        // text of lines that could not be read
  std::size_t tornBytes_ = 0;
  std::size_t bytesToTry_ = std::size_t{1} << 20;  // withItsBitBack(), a millisecond each 600
  Replay replay_;                                  // of newJournal_
  std::vector<fs::path> toSetAside_;
};

}  // namespace

Result<SketchCheck> checkSketch(const fs::path& folder, Progress& progress) {
  Examination examination(folder, false, progress);
  RETURN_IF_ERROR(examination.run());
  return std::move(examination.found);
}

Result<SketchCheck> repairSketch(const fs::path& folder, Progress& progress) {
  std::error_code error;
  if (!fs::is_directory(folder, error)) return checkSketch(folder, progress);  // says so
  ASSIGN_OR_RETURN(const Descriptor lock, lockForWriting(folder));
  Examination examination(folder, true, progress);
  RETURN_IF_ERROR(examination.run());
  if (!examination.found.damage.empty()) RETURN_IF_ERROR(examination.repair());
  return std::move(examination.found);
}

}  // namespace lightsketch
