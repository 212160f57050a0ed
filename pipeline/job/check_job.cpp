#include "pipeline/job/check_job.h"

#include "pipeline/sketch/sketch_check.h"

namespace lightsketch {

Result<JobResult> checkJob(const CheckJob& job, Progress& progress) {
  std::error_code error;
  if (!std::filesystem::is_directory(job.file, error)) {
    if (job.repair) {
      return failure(ErrorCode::kInvalidArgument,
                     "{}: only sketches can be repaired; restore it from a copy or make it again",
                     job.file.string());
    }
    ASSIGN_OR_RETURN(auto result, infoJob(job.file));  // which reads all of it
    result.text += "\n  whole          yes";
    result.figures["damaged"] = 0;
    return result;
  }
  ASSIGN_OR_RETURN(const SketchCheck check,
                   job.repair ? repairSketch(job.file, progress) : checkSketch(job.file, progress));
  JobResult result;
  Json damage = Json::array();
  for (const SketchDamage& each : check.damage) {
    damage.push_back(
        {{"file", each.file}, {"line", each.line}, {"what", each.what}, {"remedy", each.remedy}});
    result.text += fmt::format("{}{}: {}\n  {} {}\n", each.file,
                               each.line > 0 ? fmt::format(": line {}", each.line) : "", each.what,
                               job.repair ? "repaired:" : "a repair:", each.remedy);
  }
  for (const std::string& remark : check.remarks) result.text += remark + "\n";
  const bool left = !check.damage.empty() && !job.repair;
  result.text += fmt::format(
      "{}: {} whole frames{}, {}", job.file.string(), check.frames,
      check.recovered > 0 ? fmt::format(" ({} from their pictures' headers)", check.recovered) : "",
      check.damage.empty()
          ? std::string("nothing is damaged")
          : fmt::format("{} damaged place{}{}", check.damage.size(),
                        check.damage.size() == 1 ? "" : "s", left ? "" : ", repaired"));
  result.figures = {{"kind", "sketch"},
                    {"lines", check.lines},
                    {"frames", check.frames},
                    {"recovered", check.recovered},
                    {"damage", damage},
                    {"remarks", check.remarks},
                    {"repaired", job.repair ? check.damage.size() : 0},
                    {"damaged", left ? check.damage.size() : 0}};
  return result;
}

}  // namespace lightsketch
