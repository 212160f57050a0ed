// What every command of the command line has.
#pragma once

#include <CLI/CLI.hpp>
#include <functional>
#include <stop_token>
#include <string>

#include "pipeline/job/jobs.h"
#include "ui/cli/progress_bar.h"

namespace lightsketch {

struct Common {
  std::string jsonFile;
  bool quiet = false;
};

// What the command that was called does.
using Action = std::function<Result<JobResult>(ProgressBar&, std::stop_token)>;

inline CLI::App* addCommand(CLI::App& app, const std::string& name, const std::string& description,
                            const std::string& example, Common& common) {
  CLI::App* command = app.add_subcommand(name, description);
  command->footer("Example:\n  " + example);
  command->add_option("--json", common.jsonFile, "write the figures to this file as JSON");
  command->add_flag("--quiet", common.quiet, "no progress bar");
  return command;
}

}  // namespace lightsketch
