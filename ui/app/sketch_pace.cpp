#include "ui/app/sketch_pace.h"

#include <algorithm>
#include <map>

#include "ui/app/sketch_prompt.h"

namespace lightsketch {
namespace {

constexpr double kTroubleSeconds = 1;
constexpr double kRateSeconds = 30;
constexpr double kBusySeconds = 5;

}  // namespace

void SketchPace::add(const JudgedFrame& judged) {
  const TimePoint now = judged.decided;
  if (!first_) first_ = now;
  judged_.emplace_back(now, judged.refusal);
  while (toSeconds(now - judged_.front().first) > kTroubleSeconds) judged_.pop_front();
  if (judged.refusal == Refusal::kNone) {
    kept_.push_back(now);
    mostKept_ = std::max(mostKept_, keptSince(now, kBusySeconds));
  }
  while (!kept_.empty() && toSeconds(now - kept_.front()) > kRateSeconds) kept_.pop_front();
}

std::optional<Refusal> SketchPace::trouble(TimePoint now) const {
  int kept = 0;
  int all = 0;
  std::map<Refusal, int> faults;
  for (const auto& [time, refusal] : judged_) {
    if (toSeconds(now - time) > kTroubleSeconds) continue;
    ++all;
    kept += refusal == Refusal::kNone;
    if (!wordsFor(refusal).shout.isEmpty()) ++faults[refusal];
  }
  const auto most =
      std::max_element(faults.begin(), faults.end(),
                       [](const auto& a, const auto& b) { return a.second < b.second; });
  if (most == faults.end() || most->second < 2 || 3 * most->second < all ||
      most->second < 2 * kept) {
    return std::nullopt;
  }
  return most->first;
}

bool SketchPace::keptWithin(TimePoint now, double seconds) const {
  return !kept_.empty() && toSeconds(now - kept_.back()) < seconds;
}

double SketchPace::keptPerMinute(TimePoint now) const {
  if (!first_) return 0;
  const double seconds = std::clamp(toSeconds(now - *first_), 1.0, kRateSeconds);
  return 60 * static_cast<double>(keptSince(now, kRateSeconds)) / seconds;
}

double SketchPace::mostKeptPerSecond() const {
  return static_cast<double>(mostKept_) / kBusySeconds;
}

std::ptrdiff_t SketchPace::keptSince(TimePoint now, double seconds) const {
  return std::count_if(kept_.begin(), kept_.end(),
                       [&](TimePoint t) { return toSeconds(now - t) <= seconds; });
}

}  // namespace lightsketch
