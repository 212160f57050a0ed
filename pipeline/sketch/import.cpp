#include "pipeline/sketch/import.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <future>
#include <limits>

#include "capture/frame/file.h"
#include "pipeline/sketch/lp.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kDecodingThreads = 2;

const char* nameOf(TransferFunction transfer) {
  return transfer == TransferFunction::kSrgb ? "sRGB" : "linear";
}

tl::unexpected<Error> cancelled() {
  return failure(ErrorCode::kCancelled, "cancelled; nothing was kept");
}

// Mean over lights and channels, so that lampScale is 1 on average and the pictures keep their
// brightness.
double meanIntensity(const LightList& list) {
  double sum = 0;
  for (const auto& entry : list.entries) {
    for (const double value : *entry.intensity) sum += value;
  }
  return sum / (3 * static_cast<double>(list.entries.size()));
}

double saturatedFraction(const RadianceImage& image) {
  std::size_t count = 0;
  for (std::size_t i = 0; i < image.size(); i += 3) {
    const float* pixel = image.data() + i;
    if (std::max({pixel[0], pixel[1], pixel[2]}) >= 1.0f) ++count;
  }
  return 3 * static_cast<double>(count) / static_cast<double>(image.size());
}

}  // namespace

std::string ImportSummary::describe() const {
  return fmt::format("{} images of {} x {} ({}{}){}", imported, width, height, nameOf(transfer),
                     intensities ? ", with lamp intensities" : "",
                     skipped > 0 ? fmt::format(", {} skipped", skipped) : "");
}

Result<ImportSummary> importSet(const ImportOptions& options, Progress& progress) {
  ASSIGN_OR_RETURN(const auto list,
                   readLightList(options.folder, options.lp, options.intensities, progress));
  ImportSummary summary;
  summary.transfer = options.transfer.value_or(list.diligent ? TransferFunction::kLinear
                                                             : TransferFunction::kSrgb);
  summary.skipped = list.skipped;
  summary.intensities = !list.intensities.empty();
  const double intensityUnit = summary.intensities ? meanIntensity(list) : 1.0;
  ASSIGN_OR_RETURN(auto pending, PendingFolder::create(options.out));

  // A few images are decoded ahead of the one being written; futures keep the order.
  const auto& entries = list.entries;
  std::deque<std::future<Result<RadianceImage>>> ahead;
  std::size_t next = 0;
  std::optional<Sketch> sketch;
  for (std::size_t i = 0; i < entries.size(); ++i) {
    if (progress.cancelled()) return cancelled();
    while (next < entries.size() && ahead.size() < kDecodingThreads) {
      ahead.push_back(
          std::async(std::launch::async, readImage, entries[next++].file, summary.transfer));
    }
    ASSIGN_OR_RETURN(const auto image, ahead.front().get());
    ahead.pop_front();

    if (!sketch) {
      summary.width = image.width();
      summary.height = image.height();
      SketchManifest manifest;
      manifest.width = image.width();
      manifest.height = image.height();
      manifest.software = options.software;
      manifest.fullSphere = std::any_of(entries.begin(), entries.end(),
                                        [](const auto& entry) { return entry.direction.z() < 0; });
      manifest.provenance = {{"importedFrom", options.folder.string()},
                             {"lights", list.source.filename().string()},
                             {"transfer", nameOf(summary.transfer)}};
      if (summary.intensities) {
        manifest.provenance["intensities"] = list.intensities.filename().string();
        manifest.provenance["intensityUnit"] = intensityUnit;
      }
      ASSIGN_OR_RETURN(sketch, Sketch::create(pending.path(), manifest));
    }
    if (image.width() != summary.width || image.height() != summary.height) {
      return failure(ErrorCode::kInvalidArgument,
                     "{}: is {} x {} pixels, {} is {} x {}; all images must have one size",
                     entries[i].file.string(), image.width(), image.height(),
                     entries.front().file.string(), summary.width, summary.height);
    }
    FrameRecord record;
    record.origin = entries[i].name;
    record.light.direction = entries[i].direction;
    record.saturatedFraction = saturatedFraction(image);
    if (entries[i].intensity) {
      record.lampScale = *entries[i].intensity;
      for (double& scale : record.lampScale) scale /= intensityUnit;
    }
    RETURN_IF_ERROR(sketch->appendUnsynced(std::move(record), image));
    progress.update("importing images", i + 1, entries.size());
  }
  summary.imported = static_cast<int>(entries.size());
  sketch.reset();
  RETURN_IF_ERROR(pending.commit());  // syncs every file in it
  return summary;
}

Result<int> exportLp(const Sketch& sketch, const fs::path& out, const ExportLpOptions& options,
                     Progress& progress) {
  const auto ids = sketch.activeFrames();
  if (ids.empty()) {
    return failure(ErrorCode::kInvalidArgument, "{}: has no frames to export",
                   sketch.folder().string());
  }
  std::optional<RadianceImage> ambient;
  if (!sketch.manifest().ambientSubtracted) {
    ASSIGN_OR_RETURN(ambient, sketch.readAmbient());
  }
  ASSIGN_OR_RETURN(auto pending, PendingFolder::create(out));
  const char* extension = options.format == ExportLpOptions::Format::kExr ? "exr" : "png";
  std::vector<NamedDirection> list;
  std::string intensities;
  bool scaled = false;
  for (const int id : ids) {
    if (progress.cancelled()) return cancelled();
    const FrameRecord& record = sketch.frames()[static_cast<std::size_t>(id)];
    ASSIGN_OR_RETURN(auto image, sketch.readFrame(id));
    if (ambient) {
      for (std::size_t i = 0; i < image.size(); ++i) image.data()[i] -= ambient->data()[i];
    }
    list.push_back({fmt::format("image{:06d}.{}", id, extension), record.light.direction});
    const fs::path path = pending.path() / list.back().name;
    switch (options.format) {
      case ExportLpOptions::Format::kPng16:
        RETURN_IF_ERROR(writePng(path, toSrgb16(image)));
        break;
      case ExportLpOptions::Format::kPng8:
        RETURN_IF_ERROR(writePng(path, toSrgb8(image)));
        break;
      case ExportLpOptions::Format::kExr:
        RETURN_IF_ERROR(writeExr(path, image));
        break;
    }
    const auto& s = record.lampScale;
    intensities += fmt::format("{} {} {}\n", s[0], s[1], s[2]);
    scaled = scaled || s != std::array<double, 3>{1, 1, 1};
    progress.update("exporting images", list.size(), ids.size());
  }
  RETURN_IF_ERROR(writeFileAtomically(pending.path() / "dirs.lp", formatLp(list)));
  if (scaled) {
    RETURN_IF_ERROR(writeFileAtomically(pending.path() / "light_intensities.txt", intensities));
  }
  RETURN_IF_ERROR(pending.commit());
  return static_cast<int>(list.size());
}

Result<Json> describeSketch(const fs::path& folder) {
  ASSIGN_OR_RETURN(const auto sketch, Sketch::open(folder));
  const SketchManifest& manifest = sketch.manifest();
  const auto active = sketch.activeFrames();
  std::error_code error;
  std::uintmax_t bytes = 0;
  for (fs::recursive_directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    if (entry->is_regular_file(error)) bytes += entry->file_size(error);
  }
  if (error) {
    return failure(ErrorCode::kIo, "{}: cannot be read: {}", folder.string(), error.message());
  }

  Json info = {{"format", "lightsketch-sketch"},
               {"width", manifest.width},
               {"height", manifest.height},
               {"frames", active.size()},
               {"dropped", sketch.frames().size() - active.size()},
               {"gridDirections", manifest.directions},
               {"domain", manifest.fullSphere ? "sphere" : "hemisphere"},
               {"ambient", manifest.ambientSubtracted                  ? "subtracted"
                           : fs::exists(folder / "ambient.exr", error) ? "kept beside the frames"
                                                                       : "none recorded"},
               {"software", manifest.software},
               {"cameras", manifest.cameras},
               {"provenance", manifest.provenance},
               {"bytes", bytes}};
  if (!active.empty()) {
    Eigen::Vector3d low = Eigen::Vector3d::Constant(std::numeric_limits<double>::infinity());
    Eigen::Vector3d high = -low;
    for (const int id : active) {
      const auto& direction = sketch.frames()[static_cast<std::size_t>(id)].light.direction;
      low = low.cwiseMin(direction);
      high = high.cwiseMax(direction);
    }
    info["directionMin"] = toJson(low);
    info["directionMax"] = toJson(high);
  }
  return info;
}

}  // namespace lightsketch
