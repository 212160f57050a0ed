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

std::string Statistics::describe() const {
  std::string text =
      fmt::format("{:<44}{:>9}{:>10}{:>10}{:>10}\n", "", "count", "median", "95 %", "largest");
  for (const auto& [name, values] : series_) {
    const Summary s = summary(name);
    text += fmt::format("{:<44}{:>9}{:>10.2f}{:>10.2f}{:>10.2f}\n", name, s.count, s.median, s.p95,
                        s.largest);
  }
  for (const auto& [name, value] : figures_) text += fmt::format("{:<44}{:>9g}\n", name, value);
  return text;
}

}  // namespace lightsketch
