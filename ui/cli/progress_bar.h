// The command line's progress: one line that is rewritten on a terminal, a line per stage
// elsewhere.
#pragma once

#include <atomic>
#include <chrono>
#include <mutex>
#include <string>

#include "capture/frame/progress.h"

namespace lightsketch {

class ProgressBar final : public Progress {
 public:
  // Quiet: warnings only. `cancel` is polled; it outlives the bar.
  ProgressBar(bool quiet, const std::atomic<bool>& cancel);
  ~ProgressBar() override;

  void update(std::string_view stage, std::size_t done, std::size_t total) override;
  void warn(std::string_view message) override;
  bool cancelled() const override { return cancel_; }

  // Text kept at the end of the bar ("aim at 0.3 0.1 0.9").
  void setNote(std::string note);

 private:
  void clearLine();
  void endStage();

  const bool quiet_;
  const bool terminal_;
  const std::atomic<bool>& cancel_;
  std::mutex mutex_;  // guards everything below
  std::string stage_;
  std::string note_;
  std::size_t done_ = 0;
  std::chrono::steady_clock::time_point stageStart_;
  std::chrono::steady_clock::time_point lastDrawn_;
  bool lineDrawn_ = false;
};

}  // namespace lightsketch
