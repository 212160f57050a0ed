// What `lightsketch-app --stats` prints.
#pragma once

#include <QString>
#include <map>
#include <string>
#include <vector>

namespace lightsketch {

// Series of measured values. UI thread only.
class Statistics {
 public:
  // `series` with its unit: "arrival to dot, ms". Of each series the last 100,000 values count.
  void add(const std::string& series, double value);
  // A single figure, the last one said: "frames dropped by the program".
  void set(const std::string& name, double value);
  // A count that goes up.
  void count(const std::string& name, double by = 1) { figures_[name] += by; }

  struct Summary {
    std::size_t count = 0;
    double median = 0;
    double p95 = 0;
    double largest = 0;
  };
  Summary summary(const std::string& series) const;
  // Nothing was said: 0.
  double figure(const std::string& name) const;
  // What is to be kept to: printed beside the figure of that name.
  enum class Of { kMedian, kP95, kLargest };  // of a series; a single figure is itself
  void expectAtMost(const std::string& name, double bar, Of of = Of::kLargest);
  void expectAtLeast(const std::string& name, double bar, Of of = Of::kMedian);
  // A line per series and figure, with its bars and whether they are kept.
  std::string describe() const;

 private:
  struct Series {
    std::vector<double> values;
    std::size_t next = 0;
  };
  struct Bar {
    double value;
    Of of;
    bool atMost;
  };
  std::string describeBars(const std::string& name, const Summary& values) const;

  std::map<std::string, Series> series_;
  std::map<std::string, std::vector<Bar>> bars_;
  std::map<std::string, double> figures_;
};

}  // namespace lightsketch
