// The whole job on the simulated rig, and a picture that sums it up.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <vector>

#include "calibration/model/camera_model.h"
#include "capture/frame/file.h"
#include "pipeline/compress/model.h"
#include "pipeline/job/jobs.h"
#include "pipeline/job/record_on.h"
#include "pipeline/relight/relighter.h"
#include "pipeline/sketch/image_file.h"
#include "pipeline/sketch/light_stack.h"
#include "pipeline/validate/report.h"
#include "pipeline/validate/validate.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

constexpr const char* kFormat = "lightsketch-demo";
// The recorder keeps one frame a cell, so single frames held out have no near twin among the
// others.
constexpr const char* kHoldOut = "every:8:4";

// How well the recorded lamp directions agree with the rig's truth, seen from the source camera.
struct DirectionErrors {
  double medianDegrees = 0;
  double p95Degrees = 0;
  double maxDegrees = 0;
};

Result<DirectionErrors> compareWithTruth(const Sketch& sketch, const SimulatedRig& rig,
                                         TimePoint timeZero) {
  const auto model = rig.calibratedSourceModel();
  const double offset = toSeconds(timeZero - rig.startTime());
  std::vector<double> degrees;
  for (const FrameRecord& frame : sketch.frames()) {
    if (frame.lampPixels.empty()) continue;
    const auto seen = model->unproject(frame.lampPixels.front().pixel);
    if (!seen) continue;
    const LampTruth truth = rig.truthAt(offset + frame.midExposureSeconds);
    degrees.push_back(Angle::radians(std::atan2(seen->cross(truth.directionInSource).norm(),
                                                seen->dot(truth.directionInSource)))
                          .degrees());
  }
  if (degrees.empty()) return failure(ErrorCode::kInvalidArgument, "demo: no frame was recorded");
  std::sort(degrees.begin(), degrees.end());
  const auto at = [&](double part) {
    return degrees[static_cast<std::size_t>(part * static_cast<double>(degrees.size() - 1))];
  };
  return DirectionErrors{at(0.5), at(0.95), degrees.back()};
}

// Pictures of one size side by side in rows, with a gap.
Image<std::uint8_t> montage(const std::vector<std::vector<Image<std::uint8_t>>>& rows) {
  constexpr int kGap = 6;
  const auto& first = rows.front().front();
  const int columns = static_cast<int>(rows.front().size());
  const int width = columns * first.width() + (columns - 1) * kGap;
  const int height =
      static_cast<int>(rows.size()) * first.height() + (static_cast<int>(rows.size()) - 1) * kGap;
  Image<std::uint8_t> sheet(width, height, 3, 255);
  for (std::size_t r = 0; r < rows.size(); ++r) {
    for (std::size_t c = 0; c < rows[r].size(); ++c) {
      const auto& picture = rows[r][c];
      const int x0 = static_cast<int>(c) * (first.width() + kGap);
      const int y0 = static_cast<int>(r) * (first.height() + kGap);
      for (int y = 0; y < picture.height(); ++y) {
        std::copy(picture.row(y).begin(), picture.row(y).end(),
                  sheet.row(y0 + y).begin() + static_cast<std::ptrdiff_t>(x0) * 3);
      }
    }
  }
  return sheet;
}

// The 99.5th percentile of the picture's values becomes nearly white.
float exposureFor(const RadianceImage& picture) {
  std::vector<float> values(picture.values().begin(), picture.values().end());
  const auto nth =
      values.begin() + static_cast<std::ptrdiff_t>(0.995 * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), nth, values.end());
  return 0.95f / std::max(*nth, 1e-6f);
}

}  // namespace

Result<JobResult> demoJob(const DemoJob& job, Progress& progress, std::stop_token stop) {
  const auto begin = Clock::now();
  // A former demo is replaced, but only once this one is whole; anything else is left alone.
  std::error_code error;
  const auto former = fs::exists(job.out / "demo.json", error) ? readJsonFile(job.out / "demo.json")
                                                               : Result<Json>(Json());
  const bool replace = former && former->is_object() && former->value("format", "") == kFormat;
  const fs::path target =
      replace ? fs::path(fs::absolute(job.out).lexically_normal().string() + ".new") : job.out;
  ASSIGN_OR_RETURN(auto folder, PendingFolder::create(target));
  const fs::path& out = folder.path();

  // Record on the rig.
  RecordJob record;
  record.sketch = out / "sketch";
  record.recorder.directions = job.directions;
  record.recorder.timeLimitSeconds = 150;
  ASSIGN_OR_RETURN(const auto rig, SimulatedRig::start(job.rig));
  ASSIGN_OR_RETURN(const auto recorded, recordOnRig(record, job.rig, *rig, progress, stop, {}));
  ASSIGN_OR_RETURN(const auto sketch, Sketch::open(record.sketch));
  ASSIGN_OR_RETURN(const auto directions, compareWithTruth(sketch, *rig, recorded.timeZero));

  // Compress, without the frames that are held out to measure with.
  CompressOptions options;
  options.holdOutRule = kHoldOut;
  options.blockRank =
      24;  // sharp shadows and a mirror ball: the paper's 10 and 200 show in the dark
  options.rank = 400;
  ASSIGN_OR_RETURN(const auto compressed, compress(sketch, options, progress));
  const RelightableModel& model = compressed.model;
  RETURN_IF_ERROR(saveModel(model, out / "model.lsd"));

  // Relight: three lamps, then a sky.
  ASSIGN_OR_RETURN(const auto interpolator, interpolatorFor(model));
  const std::vector<Eigen::Vector3d> lamps = {
      {-0.75, 0.35, 0.55}, {0.15, 0.75, 0.65}, {0.85, -0.10, 0.45}};
  std::vector<Image<std::uint8_t>> firstRow;
  float exposure = 0;
  for (std::size_t i = 0; i < lamps.size(); ++i) {
    DirectionalLamp lamp;
    lamp.direction = lamps[i].normalized();
    ASSIGN_OR_RETURN(const auto picture,
                     relight(model, intensitiesOf(std::span(&lamp, 1), interpolator)));
    if (i == 0) exposure = exposureFor(picture);
    firstRow.push_back(toSrgb8(picture, exposure));
    RETURN_IF_ERROR(writePng(out / fmt::format("light-{}.png", i + 1), firstRow.back()));
  }
  const RadianceImage sky = analyticSky();
  RETURN_IF_ERROR(writeExr(out / "environment.exr", sky));
  ASSIGN_OR_RETURN(const auto skyLight, intensitiesOf(sky, model.lights));
  ASSIGN_OR_RETURN(const auto underSky, relight(model, skyLight));
  const auto skyPicture = toSrgb8(underSky, exposureFor(underSky));
  RETURN_IF_ERROR(writePng(out / "environment.png", skyPicture));
  RETURN_IF_ERROR(writeExr(out / "environment-relit.exr", underSky));

  // Validate, and show the median light: as captured and as relit.
  ValidateOptions validateOptions;
  validateOptions.holdOutRule = kHoldOut;
  validateOptions.modelFile = out / "model.lsd";
  ASSIGN_OR_RETURN(const auto report, validate(sketch, model, validateOptions, progress));
  RETURN_IF_ERROR(writeReport(report, out / "report"));
  ASSIGN_OR_RETURN(const auto heldOut, LightStack::create(sketch, {report.median().id}));
  ASSIGN_OR_RETURN(const auto truth, heldOut.read(0));
  DirectionalLamp lamp;
  lamp.direction = heldOut.directions().front();
  ASSIGN_OR_RETURN(const auto relit,
                   relight(model, intensitiesOf(std::span(&lamp, 1), interpolator)));
  const float shared = exposureFor(truth);
  RETURN_IF_ERROR(
      writePng(out / "demo.png",
               montage({firstRow, {skyPicture, toSrgb8(truth, shared), toSrgb8(relit, shared)}})));

  const double seconds = toSeconds(Clock::now() - begin);
  const auto& summary = recorded;
  JobResult result;
  result.figures = Json{
      {"recorded", summary.recorded},
      {"coverage", summary.coverage},
      {"recordingSeconds", summary.seconds},
      {"packetsReceived", summary.scene.packetsReceived + summary.sources.front().packetsReceived},
      {"directionErrorDegrees",
       {{"median", directions.medianDegrees},
        {"p95", directions.p95Degrees},
        {"max", directions.maxDegrees}}},
      {"validation", toJson(report)},
      {"seconds", seconds}};
  RETURN_IF_ERROR(writeJsonFile(out / "demo.json", result.figures));
  RETURN_IF_ERROR(folder.commit());
  if (replace) {
    fs::remove_all(job.out, error);
    fs::rename(target, job.out, error);
    if (error) {
      return failure(ErrorCode::kIo, "{}: cannot replace the former demo: {}; the new one is {}",
                     job.out.string(), error.message(), target.string());
    }
  }

  const auto line = [](std::string_view what, const std::string& value) {
    return fmt::format("  {:<26} {}\n", what, value);
  };
  result.text =
      "\nlightsketch demo\n" +
      line("directions recorded",
           fmt::format("{} in {:.0f} s", summary.recorded, summary.seconds)) +
      line("grid covered", fmt::format("{:.1f} % of {}", 100 * summary.coverage, job.directions)) +
      line("frames over GVSP",
           fmt::format("{} scene, {} source ({} packets)", summary.scene.delivered,
                       summary.sources.front().delivered,
                       summary.scene.packetsReceived + summary.sources.front().packetsReceived)) +
      line("lamp direction error",
           fmt::format("median {:.3f}, 95 % {:.3f}, worst {:.3f} degrees (rig's truth)",
                       directions.medianDegrees, directions.p95Degrees, directions.maxDegrees)) +
      line("model",
           fmt::format("{:.1f} MB, {:.0f}:1 against half-float frames",
                       static_cast<double>(report.size->bytes) / 1e6, report.size->ratioToHalf)) +
      line("held-out frames", fmt::format("{}: {:.1f} dB PSNR, {:.3f} SSIM", report.all.count,
                                          report.all.psnr, report.all.ssim.value_or(0))) +
      line("whole demo", fmt::format("{:.0f} s", seconds)) + "\n" +
      line("pictures", (job.out / "demo.png").string()) +
      line("report", (job.out / "report" / "index.html").string()) +
      line("model", (job.out / "model.lsd").string()) +
      line("sketch", (job.out / "sketch").string());
  result.text.pop_back();
  return result;
}

}  // namespace lightsketch
