#include "ui/cli/progress_bar.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <utility>

namespace lightsketch {
namespace {

using std::chrono::steady_clock;

double secondsSince(steady_clock::time_point start) {
  return std::chrono::duration<double>(steady_clock::now() - start).count();
}

std::string clockText(double seconds) {
  const int whole = static_cast<int>(seconds + 0.5);
  return fmt::format("{}:{:02}", whole / 60, whole % 60);
}

}  // namespace

ProgressBar::ProgressBar(bool quiet, const std::atomic<bool>& cancel)
    : quiet_(quiet), terminal_(::isatty(STDERR_FILENO) == 1), cancel_(cancel) {}

ProgressBar::~ProgressBar() {
  const std::lock_guard lock(mutex_);
  endStage();
}

void ProgressBar::update(std::string_view stage, std::size_t done, std::size_t total) {
  if (quiet_) return;
  const std::lock_guard lock(mutex_);
  if (stage != stage_) {
    endStage();
    stage_ = stage;
    stageStart_ = steady_clock::now();
    lastDrawn_ = {};
  }
  done_ = done;
  if (!terminal_) return;

  // Redraw ten times a second, and at the end.
  const auto now = steady_clock::now();
  if (now - lastDrawn_ < std::chrono::milliseconds(100) && done < total) return;
  lastDrawn_ = now;
  constexpr std::size_t kWidth = 30;
  const double fraction =
      total == 0 ? 0 : std::min(1.0, static_cast<double>(done) / static_cast<double>(total));
  const auto filled = static_cast<std::size_t>(fraction * kWidth);
  const double elapsed = secondsSince(stageStart_);
  const std::string left =
      fraction > 0.02 ? fmt::format(", {} left", clockText(elapsed * (1 - fraction) / fraction))
                      : "";
  clearLine();
  fmt::print(stderr, "{:<22} [{}{}] {}/{}{}{}{}", stage_, std::string(filled, '#'),
             std::string(kWidth - filled, '.'), done, total, left, note_.empty() ? "" : "  ",
             note_);
  std::fflush(stderr);
  lineDrawn_ = true;
}

void ProgressBar::warn(std::string_view message) {
  const std::lock_guard lock(mutex_);
  clearLine();
  fmt::print(stderr, "warning: {}\n", message);
}

void ProgressBar::setNote(std::string note) {
  const std::lock_guard lock(mutex_);
  note_ = std::move(note);
}

void ProgressBar::clearLine() {
  if (lineDrawn_) fmt::print(stderr, "\r\033[K");
  lineDrawn_ = false;
}

void ProgressBar::endStage() {
  clearLine();
  if (!stage_.empty()) {
    fmt::print(stderr, "{}: {} in {:.1f} s\n", stage_, done_, secondsSince(stageStart_));
  }
  stage_.clear();
}

}  // namespace lightsketch
