// Between a calibration on its own thread and the page that shows it.
#pragma once

#include <QString>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <optional>
#include <stop_token>
#include <string>

#include "pipeline/job/live_views.h"

namespace lightsketch {

// Shared by both, so that either may end first. Thread-safe. The page looks now and then: the job
// never waits for the screen, only for an answer that it asked for.
class CalibrationFeed {
 public:
  // The job's side.
  void publish(const LiveViewState& state);
  // Until somebody answers; false if they gave up or `stop` came.
  bool ask(const std::string& wish, std::stop_token stop);

  // The page's. The newest state since it was last taken.
  std::optional<LiveViewState> take();
  QString question() const;  // empty: none
  void answer(bool go);

 private:
  mutable std::mutex mutex_;  // Guards everything below.
  std::condition_variable_any answered_;
  std::optional<LiveViewState> state_;
  QString question_;
  std::optional<bool> answer_;
};

}  // namespace lightsketch
