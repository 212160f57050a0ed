#include "ui/app/statistics.h"

#include <fmt/format.h>

#include <algorithm>

namespace lightsketch {
namespace {
constexpr std::size_t kKept = 100'000;
}

void Statistics::add(const std::string& series, double value) {
  Series& s = series_[series];
  if (s.values.size() < kKept) {
    s.values.push_back(value);
    return;
  }
  s.values[s.next] = value;
  s.next = (s.next + 1) % kKept;
}

void Statistics::set(const std::string& name, double value) { figures_[name] = value; }

Statistics::Summary Statistics::summary(const std::string& series) const {
  const auto found = series_.find(series);
  if (found == series_.end()) return {};
  std::vector<double> values = found->second.values;
  std::sort(values.begin(), values.end());
  const auto at = [&](double part) {
    return values[static_cast<std::size_t>(part * static_cast<double>(values.size() - 1))];
  };
  return {values.size(), at(0.5), at(0.95), values.back()};
}

double Statistics::figure(const std::string& name) const {
  const auto found = figures_.find(name);
  return found == figures_.end() ? 0 : found->second;
}

void Statistics::expectAtMost(const std::string& name, double bar, Of of) {
  bars_[name].push_back({bar, of, true});
}
void Statistics::expectAtLeast(const std::string& name, double bar, Of of) {
  bars_[name].push_back({bar, of, false});
}

std::string Statistics::describeBars(const std::string& name, const Summary& values) const {
  std::string text;
  const auto found = bars_.find(name);
  if (found == bars_.end()) return text;
  for (const Bar& bar : found->second) {
    const auto [value, which] = [&]() -> std::pair<double, const char*> {
      if (!series_.contains(name)) return {figure(name), ""};
      switch (bar.of) {
        case Of::kMedian:
          return {values.median, "median "};
        case Of::kP95:
          return {values.p95, "95 % "};
        case Of::kLargest:
          return {values.largest, "largest "};
      }
      return {};
    }();
    const bool kept = bar.atMost ? value <= bar.value : value >= bar.value;
    text += fmt::format("  {}{} {:g}: {}", which, bar.atMost ? "at most" : "at least", bar.value,
                        kept ? "kept" : "MISSED");
  }
  return text;
}

std::string Statistics::describe() const {
  std::string text =
      fmt::format("{:<36}{:>8}{:>9}{:>9}{:>9}  bar\n", "", "count", "median", "95 %", "largest");
  for (const auto& [name, values] : series_) {
    const Summary s = summary(name);
    text += fmt::format("{:<36}{:>8}{:>9.2f}{:>9.2f}{:>9.2f}{}\n", name, s.count, s.median, s.p95,
                        s.largest, describeBars(name, s));
  }
  for (const auto& [name, value] : figures_) {
    text += fmt::format("{:<36}{:>8.4g}{:27}{}\n", name, value, "", describeBars(name, {}));
  }
  return text;
}

}  // namespace lightsketch
