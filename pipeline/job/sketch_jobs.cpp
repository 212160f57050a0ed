// Sets in and out, and what a file holds.
#include "pipeline/job/jobs.h"

#include "calibration/model/camera_model.h"
#include "pipeline/sketch/image_file.h"
#include "pipeline/sketch/sketch.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

Result<JobResult> describeModel(const fs::path& file) {
  ASSIGN_OR_RETURN(const auto model, loadModel(file));
  std::error_code error;
  const double bytes = static_cast<double>(fs::file_size(file, error));
  const double pixels = static_cast<double>(model.layout.width) * model.layout.height;
  JobResult result;
  result.figures = {{"kind", "model"},
                    {"width", model.layout.width},
                    {"height", model.layout.height},
                    {"lights", model.lightCount()},
                    {"captures", model.capturedIds.size()},
                    {"block", model.layout.blockSize},
                    {"basisRows", model.rows()},
                    {"rank", model.rank},
                    {"storage", nameOf(model.storage)},
                    {"holdOut", model.holdOutRule},
                    {"heldOut", model.heldOutIds.size()},
                    {"bytes", bytes},
                    {"bitsPerPixel", 8 * bytes / pixels},
                    {"interpolation", model.interpolation.describe()},
                    {"software", model.software},
                    {"sketch", model.sketch},
                    {"notes", model.notes}};
  result.text = fmt::format(
      "{}: relightable model\n  picture        {} x {}\n  lights         {} from {} captures\n"
      "  factors        {} x {} blocks, {} basis pictures in all, rank {}, {}\n"
      "  size           {:.2f} MB, {:.1f} bits a pixel\n  held out       {}\n  between lights {}",
      file.string(), model.layout.width, model.layout.height, model.lightCount(),
      model.capturedIds.size(), model.layout.blockSize, model.layout.blockSize, model.rows(),
      model.rank, nameOf(model.storage), bytes / 1e6,
      8 * bytes / pixels,
      model.holdOutRule.empty()
          ? std::string("nothing")
          : fmt::format("{} frames by {}", model.heldOutIds.size(), model.holdOutRule),
      model.interpolation.describe());
  return result;
}

Result<JobResult> describeCamera(const fs::path& file) {
  ASSIGN_OR_RETURN(const auto model, loadCameraModel(file));
  JobResult result;
  result.figures = cameraModelToJson(*model);
  result.figures["kind"] = "camera model";
  result.text = fmt::format(
      "{}: camera model\n  model  {}\n  image  {} x {}\n  field  {:.1f} degrees off axis",
      file.string(), model->modelName(), model->width(), model->height(),
      model->maxFieldAngle().degrees());
  return result;
}

Result<JobResult> describePicture(const fs::path& file) {
  ASSIGN_OR_RETURN(const auto picture, readImage(file));
  return JobResult{
      fmt::format("{}: picture, {} x {}", file.string(), picture.width(), picture.height()),
      {{"kind", "picture"}, {"width", picture.width()}, {"height", picture.height()}}};
}

// Name and value lines of an object whose values are plain; lists of objects a line each.
std::string listFields(const Json& object) {
  std::string text;
  for (const auto& [name, value] : object.items()) {
    if (value.is_null() || value.empty()) continue;
    if (value.is_array() && value.front().is_object()) {
      for (const Json& element : value) text += fmt::format("\n  {:<18} {}", name, element.dump());
    } else {
      text += fmt::format("\n  {:<18} {}", name,
                          value.is_string() ? value.get<std::string>() : value.dump());
    }
  }
  return text;
}

}  // namespace

Result<JobResult> importJob(const ImportOptions& job, Progress& progress) {
  ImportOptions options = job;
  options.software = kSoftware;
  ASSIGN_OR_RETURN(const auto summary, importSet(options, progress));
  return JobResult{fmt::format("{}: {}", job.out.string(), summary.describe()),
                   {{"out", job.out.string()},
                    {"imported", summary.imported},
                    {"skipped", summary.skipped},
                    {"width", summary.width},
                    {"height", summary.height}}};
}

Result<JobResult> exportJob(const ExportJob& job, Progress& progress) {
  if (job.format != "lp") {
    return failure(ErrorCode::kUnsupported, "export: unknown format '{}'; known: lp", job.format);
  }
  ASSIGN_OR_RETURN(const auto sketch, Sketch::open(job.sketch));
  ASSIGN_OR_RETURN(const int count, exportLp(sketch, job.out, job.lp, progress));
  return JobResult{fmt::format("{}: {} images and dirs.lp", job.out.string(), count),
                   {{"out", job.out.string()}, {"images", count}}};
}

Result<JobResult> infoJob(const fs::path& file) {
  std::error_code error;
  if (!fs::exists(file, error)) {
    return failure(ErrorCode::kNotFound, "{}: no such file or folder", file.string());
  }
  if (fs::is_directory(file, error)) {
    ASSIGN_OR_RETURN(auto figures, describeSketch(file));
    JobResult result{fmt::format("{}: sketch{}", file.string(), listFields(figures)), figures};
    result.figures["kind"] = "sketch";
    return result;
  }
  const std::string extension = file.extension().string();
  if (extension == ".lsd") return describeModel(file);
  if (extension == ".json") return describeCamera(file);
  return describePicture(file);
}

}  // namespace lightsketch
