#include "pipeline/compress/model.h"
#include "pipeline/job/jobs.h"
#include "pipeline/relight/relighter.h"
#include "pipeline/sketch/image_file.h"

namespace lightsketch {
namespace {

Result<LightIntensities> intensitiesFor(const RelightJob& job, const RelightableModel& model) {
  if (model.singleLamp &&
      (!job.environment.empty() || !job.lightsFile.empty() || job.lamps.size() > 1)) {
    return failure(ErrorCode::kInvalidArgument,
                   "{}: a single-lamp model shows one --light; compress without --single-lamp for "
                   "several or an environment",
                   job.model.string());
  }
  if (!job.environment.empty()) {
    ASSIGN_OR_RETURN(const auto map, readImage(job.environment, TransferFunction::kSrgb));
    return intensitiesOf(map, model.lights, job.environmentOptions);
  }
  std::vector<DirectionalLamp> lamps = job.lamps;
  if (!job.lightsFile.empty()) {
    ASSIGN_OR_RETURN(lamps, readLights(job.lightsFile));
  }
  if (lamps.empty()) {
    return failure(ErrorCode::kInvalidArgument,
                   "relight: no light given; use --light, --lights or --environment");
  }
  ASSIGN_OR_RETURN(const auto interpolator, interpolatorFor(model));
  if (model.singleLamp) return singleLamp(lamps[0], interpolator);
  return intensitiesOf(lamps, interpolator);
}

Result<void> savePicture(const RadianceImage& picture, const std::filesystem::path& path,
                         double exposure) {
  const std::string extension = path.extension().string();
  if (extension == ".exr") return writeExr(path, picture);
  return writePng(path, toSrgb8(picture, static_cast<float>(exposure)));
}

}  // namespace

Result<JobResult> relightJob(const RelightJob& job) {
  const std::string extension = job.out.extension().string();
  if (extension != ".exr" && extension != ".png") {
    return failure(ErrorCode::kInvalidArgument,
                   "{}: the picture must be .exr (linear) or .png (sRGB)", job.out.string());
  }
  ASSIGN_OR_RETURN(const auto model, loadModel(job.model));
  ASSIGN_OR_RETURN(const auto intensities, intensitiesFor(job, model));
  ASSIGN_OR_RETURN(const auto picture, relight(model, intensities));
  RETURN_IF_ERROR(savePicture(picture, job.out, job.exposure));
  return JobResult{
      fmt::format("{}: {} x {}", job.out.string(), picture.width(), picture.height()),
      {{"out", job.out.string()}, {"width", picture.width()}, {"height", picture.height()}}};
}

}  // namespace lightsketch
