// Bad frames out of a sketch, and back in.
#include <algorithm>
#include <array>
#include <optional>

#include "capture/frame/file.h"
#include "pipeline/job/jobs.h"
#include "pipeline/sketch/light_stack.h"
#include "pipeline/sketch/sketch.h"
#include "pipeline/validate/frame_check.h"
#include "pipeline/validate/frame_check_report.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

template <class Matrix>
Json toJson(const Matrix& matrix) {
  Json list = Json::array();
  for (Eigen::Index i = 0; i < matrix.size(); ++i) list.push_back(matrix.data()[i]);
  return list;
}

template <class Matrix>
Result<void> readInto(const Json& list, Matrix& matrix) {
  if (!list.is_array() || list.size() != static_cast<std::size_t>(matrix.size()) ||
      !std::ranges::all_of(list, [](const Json& value) { return value.is_number(); })) {
    return failure(ErrorCode::kCorrupt, "{} numbers expected", matrix.size());
  }
  for (Eigen::Index i = 0; i < matrix.size(); ++i) {
    matrix.data()[i] = list[static_cast<std::size_t>(i)].get<double>();
  }
  return {};
}

// What a correction replaces, whole, so that it can be put back.
Json lightOf(const FrameRecord& frame) {
  Json light = {{"direction", toJson(frame.light.direction)},
                {"covariance", toJson(frame.light.covariance)},
                {"calibrationId", frame.calibrationId},
                {"lampScale", frame.lampScale}};
  if (frame.light.position) {
    light["position"] = toJson(*frame.light.position);
    light["positionCovariance"] = toJson(frame.light.positionCovariance);
  }
  return light;
}

// The light that a frame at fault by its direction gets.
LightDirection correctedLight(const FrameRecord& frame, const FrameVerdict& verdict) {
  LightDirection light;
  light.direction = verdict.fitted;
  const double sigma = verdict.shiftSigma.radians();
  light.covariance =
      sigma * sigma * (Eigen::Matrix3d::Identity() - verdict.fitted * verdict.fitted.transpose());
  if (frame.light.position) {
    const double distance = frame.light.position->norm();
    light.position = distance * verdict.fitted;
    light.positionCovariance =
        frame.light.positionCovariance + distance * distance * light.covariance;
  }
  return light;
}

// The frame as cull leaves it.
FrameRecord culled(FrameRecord frame, const FrameVerdict& verdict) {
  if (!verdict.correctable) {
    frame.dropped = true;
    frame.dropReason = "cull: " + verdict.reason();
  } else if (verdict.fault == FrameFault::kDirection) {
    frame.light = correctedLight(frame, verdict);
    frame.calibrationId = "cull";
  } else {
    for (double& channel : frame.lampScale) channel *= verdict.gain;
  }
  return frame;
}

// Which sketch a cull.json is about, wherever its folder now lies: the pictures of its first
// `frames` frames. Later ones may have been recorded since.
std::string identityOf(const Sketch& sketch, std::size_t frames) {
  std::string sums;
  for (std::size_t i = 0; i < frames; ++i) sums += sketch.frames()[i].checksum + '\n';
  return checksum(sums);
}

fs::path absolutePath(const fs::path& path) {
  std::error_code error;
  const fs::path absolute = fs::absolute(path, error);
  return (error ? path : absolute).lexically_normal();
}

// The folder's own name, also of "vase/" and ".".
std::string nameOfFolder(const fs::path& path) {
  const fs::path absolute = absolutePath(path);
  return (absolute.has_filename() ? absolute : absolute.parent_path()).filename().string();
}

// Fails if the folder holds the only record of changes that were not taken back.
Result<void> checkReportFolder(const CullJob& job) {
  const fs::path file = job.report / "cull.json";
  std::error_code error;
  const bool there = fs::exists(file, error);
  if (error) {
    return failure(ErrorCode::kIo, "{}: cannot be looked at: {}", file.string(), error.message());
  }
  if (!there) return {};
  ASSIGN_OR_RETURN(const Json figures, readJsonFile(file));
  if (figures.is_object() && figures.value("applied", Json()) == Json(true) &&
      !figures.value("bad", Json()).empty()) {
    return failure(ErrorCode::kInvalidArgument,
                   "{}: undoes what an earlier `cull --apply` did and would be overwritten; undo "
                   "that first (lightsketch cull SKETCH --undo {}) or name another --report folder",
                   file.string(), file.string());
  }
  return {};
}

std::string counted(int count, std::string_view what) {
  return fmt::format("{} {}{}", count, what, count == 1 ? "" : "s");
}

// One frame's way back.
struct UndoStep {
  int id = 0;
  bool restores = false;  // else it puts the light back
  LightDirection light;
  std::string calibrationId;
  std::array<double, 3> lampScale{1, 1, 1};
};

// Nothing if the frame already is as before. Fails if somebody else changed it since.
Result<std::optional<UndoStep>> undoStep(const Json& entry, const Sketch& sketch) {
  UndoStep step;
  step.id = entry.at("id").get<int>();
  step.restores = entry.at("action") == "drop";
  if (step.id < 0 || step.id >= static_cast<int>(sketch.frames().size())) {
    return failure(ErrorCode::kCorrupt, "there is no frame {}", step.id);
  }
  const FrameRecord& frame = sketch.frames()[static_cast<std::size_t>(step.id)];
  const Json& before = entry.at("before");
  const Json& after = entry.at("after");
  if (step.restores) {
    if (!frame.dropped) return std::nullopt;
    if (frame.dropReason != after.at("dropReason")) {
      return failure(ErrorCode::kInvalidArgument,
                     "frame {} was dropped again since (\"{}\"); nothing was undone", step.id,
                     frame.dropReason);
    }
    return step;
  }
  const Json now = lightOf(frame);
  if (now == before) return std::nullopt;
  if (now != after) {
    return failure(ErrorCode::kInvalidArgument,
                   "the light of frame {} is no longer the one that cull wrote; nothing was undone",
                   step.id);
  }
  RETURN_IF_ERROR(readInto(before.at("direction"), step.light.direction));
  RETURN_IF_ERROR(readInto(before.at("covariance"), step.light.covariance));
  if (before.contains("position")) {
    step.light.position.emplace();
    RETURN_IF_ERROR(readInto(before.at("position"), *step.light.position));
    RETURN_IF_ERROR(readInto(before.at("positionCovariance"), step.light.positionCovariance));
  }
  step.calibrationId = before.at("calibrationId").get<std::string>();
  step.lampScale = before.at("lampScale").get<std::array<double, 3>>();
  return step;
}

Result<JobResult> undo(const CullJob& job) {
  ASSIGN_OR_RETURN(Json figures, readJsonFile(job.undo));
  ASSIGN_OR_RETURN(auto sketch, Sketch::openForAppend(job.sketch));
  std::vector<UndoStep> steps;
  std::size_t listed = 0;
  try {
    if (!figures.at("applied").get<bool>()) {
      return failure(ErrorCode::kInvalidArgument,
                     "{}: there is nothing to undo: not written by `cull --apply`, or undone "
                     "already",
                     job.undo.string());
    }
    const Json& of = figures.at("sketch");
    const auto frames = of.at("frames").get<std::size_t>();
    if (frames > sketch.frames().size() || of.at("checksum") != identityOf(sketch, frames)) {
      return failure(ErrorCode::kInvalidArgument,
                     "{}: this is not what `cull --apply` wrote about {}: the pictures are others",
                     job.undo.string(), job.sketch.string());
    }
    listed = figures.at("bad").size();
    for (const Json& entry : figures.at("bad")) {
      auto step = undoStep(entry, sketch);
      if (!step) {
        return failure(step.error().code, "{}: {}", job.undo.string(), step.error().message);
      }
      if (*step) steps.push_back(std::move(**step));
    }
  } catch (const Json::exception& error) {
    return failure(ErrorCode::kCorrupt, "{}: not a cull.json: {}", job.undo.string(), error.what());
  }
  for (const UndoStep& step : steps) {
    if (step.restores) {
      RETURN_IF_ERROR(sketch.restore(step.id));
    } else {
      RETURN_IF_ERROR(sketch.relight(step.id, step.light, step.calibrationId, step.lampScale));
    }
  }
  // Last, so that an undo that was interrupted can be repeated.
  figures["applied"] = false;
  figures["undone"] = true;
  RETURN_IF_ERROR(writeJsonFile(job.undo, figures));
  return JobResult{fmt::format("{}: {} as before", job.sketch.string(),
                               counted(static_cast<int>(listed), "frame")),
                   {{"undone", steps.size()}}};
}

Result<void> checkIds(const Sketch& sketch, const std::vector<int>& ids) {
  for (const int id : ids) {
    if (id < 0 || id >= static_cast<int>(sketch.frames().size())) {
      return failure(ErrorCode::kInvalidArgument,
                     "{}: there is no frame {}; its frames are 0 to {}", sketch.folder().string(),
                     id, static_cast<int>(sketch.frames().size()) - 1);
    }
  }
  return {};
}

}  // namespace

Result<JobResult> cullJob(const CullJob& job, Progress& progress) {
  if (!job.undo.empty()) return undo(job);
  if (job.apply && job.report.empty()) {
    return failure(ErrorCode::kInvalidArgument,
                   "cull: --apply needs --report FOLDER, which keeps what is needed to undo it");
  }
  if (!job.report.empty()) RETURN_IF_ERROR(checkReportFolder(job));
  ASSIGN_OR_RETURN(auto sketch,
                   job.apply ? Sketch::openForAppend(job.sketch) : Sketch::open(job.sketch));
  ASSIGN_OR_RETURN(const auto stack, LightStack::create(sketch, sketch.activeFrames()));
  ASSIGN_OR_RETURN(const auto check, checkFrames(stack, {}, progress));

  const std::vector<int> bad = check.bad();
  int dropped = 0;
  int brightness = 0;
  int directions = 0;
  JobResult result;
  result.figures = check.toJson();
  for (std::size_t k = 0; k < bad.size(); ++k) {
    const FrameVerdict& verdict = check.frames[static_cast<std::size_t>(bad[k])];
    const bool correct = verdict.correctable;
    ++(!correct ? dropped : verdict.fault == FrameFault::kDirection ? directions : brightness);
    Json& entry = result.figures["bad"][k];
    entry["action"] = correct ? "correct" : "drop";
    const FrameRecord& frame = sketch.frames()[static_cast<std::size_t>(verdict.id)];
    entry["before"] = lightOf(frame);
    const FrameRecord after = culled(frame, verdict);
    entry["after"] = correct ? lightOf(after) : Json{{"dropReason", after.dropReason}};
  }
  result.figures["sketch"] = {{"folder", absolutePath(job.sketch).string()},
                              {"frames", sketch.frames().size()},
                              {"checksum", identityOf(sketch, sketch.frames().size())}};
  result.figures["applied"] = job.apply;
  result.figures["dropped"] = dropped;
  result.figures["correctedBrightness"] = brightness;
  result.figures["correctedDirections"] = directions;

  const fs::path undoFile = job.report / "cull.json";
  const std::string what = fmt::format("{} dropped, {} corrected in brightness and {} in direction",
                                       counted(dropped, "frame"), brightness, directions);
  const std::string action =
      bad.empty() ? "Every frame fits its neighbours; there is nothing to do."
      : job.apply ? fmt::format(
                        "{}, as events in the sketch's journal; no picture was touched. To undo "
                        "all of it: lightsketch cull {} --undo {}. To take single frames back in: "
                        "lightsketch restore {} ID...",
                        what, job.sketch.string(), undoFile.string(), job.sketch.string())
                  : fmt::format("Nothing was changed. With --apply: {}.", what);
  if (!job.report.empty()) {
    std::error_code error;
    fs::create_directories(job.report, error);
    if (error) {
      return failure(ErrorCode::kIo, "{}: cannot create the folder: {}", job.report.string(),
                     error.message());
    }
    FrameCheckReportOptions options;
    options.title = nameOfFolder(job.sketch);
    options.action = action;
    ASSIGN_OR_RETURN(const std::string page, frameCheckPage(stack, check, options, progress));
    // Before the first change: without it there is no way back.
    RETURN_IF_ERROR(writeJsonFile(undoFile, result.figures));
    RETURN_IF_ERROR(writeFileAtomically(job.report / "index.html", page));
  }
  if (job.apply) {
    for (const int i : bad) {
      const FrameVerdict& verdict = check.frames[static_cast<std::size_t>(i)];
      const FrameRecord after =
          culled(sketch.frames()[static_cast<std::size_t>(verdict.id)], verdict);
      if (after.dropped) {
        RETURN_IF_ERROR(sketch.drop(verdict.id, after.dropReason));
      } else {
        RETURN_IF_ERROR(
            sketch.relight(verdict.id, after.light, after.calibrationId, after.lampScale));
      }
    }
  }
  result.text = fmt::format(
      "{}: {} of {} frames do not fit their neighbours\n  shadow     {}\n  exposure   {}\n"
      "  direction  {}\n  other      {}\n{}",
      job.sketch.string(), bad.size(), check.frames.size(), check.count(FrameFault::kShadow),
      check.count(FrameFault::kExposure), check.count(FrameFault::kDirection),
      check.count(FrameFault::kOther), action);
  if (!job.report.empty()) {
    result.text += fmt::format("\nreport: {}", (job.report / "index.html").string());
  }
  return result;
}

Result<JobResult> dropJob(const DropJob& job) {
  if (job.reason.empty()) {
    return failure(ErrorCode::kInvalidArgument, "drop: say why with --reason TEXT");
  }
  ASSIGN_OR_RETURN(auto sketch, Sketch::openForAppend(job.sketch));
  RETURN_IF_ERROR(checkIds(sketch, job.ids));
  for (const int id : job.ids) {
    RETURN_IF_ERROR(sketch.drop(id, job.reason));
  }
  return JobResult{
      fmt::format("{}: {} of {} frames left; undo: lightsketch restore {} {}", job.sketch.string(),
                  sketch.activeFrames().size(), sketch.frames().size(), job.sketch.string(),
                  fmt::join(job.ids, " ")),
      {{"dropped", job.ids}, {"active", sketch.activeFrames().size()}}};
}

Result<JobResult> restoreJob(const DropJob& job) {
  ASSIGN_OR_RETURN(auto sketch, Sketch::openForAppend(job.sketch));
  RETURN_IF_ERROR(checkIds(sketch, job.ids));
  for (const int id : job.ids) {
    RETURN_IF_ERROR(sketch.restore(id));
  }
  return JobResult{fmt::format("{}: {} of {} frames are in use", job.sketch.string(),
                               sketch.activeFrames().size(), sketch.frames().size()),
                   {{"restored", job.ids}, {"active", sketch.activeFrames().size()}}};
}

}  // namespace lightsketch
