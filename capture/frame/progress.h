// How long work reports and how it is asked to stop. One object serves the command line's bar, the
// app and the tests.
#pragma once

#include <cstddef>
#include <string_view>

namespace lightsketch {

class Progress {
 public:
  virtual ~Progress() = default;
  // `done` of `total` units of `stage` ("reading images"). Thread-safe in every implementation;
  // called often, so it must be cheap.
  virtual void update(std::string_view stage, std::size_t done, std::size_t total) = 0;
  // A line for the user that should stay on the screen ("line 12: image7.jpg does not exist").
  virtual void warn(std::string_view message) = 0;
  // Polled by the work; true makes it stop soon with ErrorCode::kCancelled, leaving nothing half
  // made.
  virtual bool cancelled() const = 0;
};

// Says nothing, never cancels.
class SilentProgress final : public Progress {
 public:
  void update(std::string_view, std::size_t, std::size_t) override {}
  void warn(std::string_view) override {}
  bool cancelled() const override { return false; }
};

}  // namespace lightsketch
