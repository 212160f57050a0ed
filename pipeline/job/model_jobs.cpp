// Compress and validate.
#include "pipeline/job/jobs.h"

#include "calibration/lens/camera_formats.h"
#include "pipeline/compress/hold_out.h"
#include "pipeline/sketch/image_file.h"
#include "pipeline/sketch/sketch.h"
#include "pipeline/validate/report.h"
#include "pipeline/validate/validate.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

Result<void> requireParent(const fs::path& file) {
  std::error_code error;
  const fs::path folder = file.has_parent_path() ? file.parent_path() : fs::path(".");
  if (!fs::is_directory(folder, error)) {
    return failure(ErrorCode::kNotFound, "{}: the folder {} does not exist", file.string(),
                   folder.string());
  }
  return {};
}

// The subject's surface, as --near-light says it.
Result<std::shared_ptr<const SurfacePoints>> surfaceOf(const CompressJob& job,
                                                       const Sketch& sketch) {
  if (job.sceneModel.empty() || !sketch.rig()) {
    return failure(ErrorCode::kInvalidArgument,
                   "{}: near light needs --scene-model and a rig.json in the sketch: what the "
                   "scene camera's pixels see",
                   job.sketch.string());
  }
  ASSIGN_OR_RETURN(const auto camera, loadAnyCameraModel(job.sceneModel));
  const Eigen::Isometry3d& pose = sketch.rig()->sceneCamera.sceneFromCamera;
  SurfacePoints points;
  if (job.nearLight == "flat") {
    ASSIGN_OR_RETURN(points, flatSurface(*camera.model, pose));
  } else {
    ASSIGN_OR_RETURN(const RadianceImage picture, readImage(job.nearLight));
    Image<float> depth(picture.width(), picture.height(), 1);
    for (int y = 0; y < depth.height(); ++y) {
      for (int x = 0; x < depth.width(); ++x) depth(x, y) = picture(x, y, 0);
    }
    ASSIGN_OR_RETURN(points, surfaceFromDepth(*camera.model, pose, depth));
  }
  return std::make_shared<const SurfacePoints>(std::move(points));
}

}  // namespace

Result<JobResult> compressJob(const CompressJob& job, Progress& progress) {
  RETURN_IF_ERROR(requireParent(job.out));
  ASSIGN_OR_RETURN(const auto sketch, Sketch::open(job.sketch));
  CompressOptions options = job.options;
  if (!job.nearLight.empty()) {
    ASSIGN_OR_RETURN(options.surface, surfaceOf(job, sketch));
  }
  ASSIGN_OR_RETURN(auto compressed, compress(sketch, options, progress));
  RETURN_IF_ERROR(saveModel(compressed.model, job.out));
  std::error_code error;
  const auto bytes = fs::file_size(job.out, error);
  JobResult result;
  result.figures = compressed.summary.toJson();
  result.figures["bytes"] = bytes;
  const BlockLayout& layout = compressed.model.layout;
  result.figures["bitsPerPixel"] =
      8 * static_cast<double>(bytes) / (static_cast<double>(layout.width) * layout.height);
  result.text = fmt::format("{}: {:.2f} MB\n{}", job.out.string(), static_cast<double>(bytes) / 1e6,
                            compressed.summary.describe());
  return result;
}

Result<JobResult> validateJob(const ValidateJob& job, Progress& progress) {
  ASSIGN_OR_RETURN(const auto sketch, Sketch::open(job.sketch));
  ValidateOptions options;
  options.holdOutRule = job.holdOutRule;
  if (!job.environment.empty()) {
    ASSIGN_OR_RETURN(options.environment, readImage(job.environment));
    options.environmentName = job.environment.filename().string();
  }

  std::error_code error;
  const bool reportFolderIsNew = !fs::exists(job.report, error);
  const auto cleanUp = [&] {
    if (reportFolderIsNew) fs::remove_all(job.report, error);
  };
  RelightableModel model;
  options.modelFile = job.model;
  if (!job.model.empty()) {
    ASSIGN_OR_RETURN(model, loadModel(job.model));
  } else {
    CompressOptions compressOptions = job.compress;
    if (options.holdOutRule.empty()) options.holdOutRule = defaultHoldOut(sketch);
    compressOptions.holdOutRule = options.holdOutRule;
    ASSIGN_OR_RETURN(auto compressed, compress(sketch, compressOptions, progress));
    model = std::move(compressed.model);
    fs::create_directories(job.report, error);
    options.modelFile = job.report / "model.lsd";
    if (const auto saved = saveModel(model, options.modelFile); !saved) {
      cleanUp();
      return tl::unexpected<Error>(saved.error());
    }
  }
  const auto report = validate(sketch, model, options, progress);
  if (!report) {
    cleanUp();
    return tl::unexpected<Error>(report.error());
  }
  if (const auto written = writeReport(*report, job.report); !written) {
    cleanUp();
    return tl::unexpected<Error>(written.error());
  }
  return JobResult{
      fmt::format("{}\nreport: {}", report->describe(), (job.report / "index.html").string()),
      toJson(*report)};
}

}  // namespace lightsketch
