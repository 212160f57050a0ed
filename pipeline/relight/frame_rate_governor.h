// Drops bases to hold a frame rate and restores them.
#pragma once

namespace lightsketch {

// Told how long each frame took, says which share of the bases the next one may use
// (RenderOptions::share). Knows no clock: what it answers depends on the told times alone.
// Not thread-safe. See README for the rules.
class FrameRateGovernor {
 public:
  struct Options {
    double targetSeconds = 1.0 / 30;
    double smallestShare = 0.05;  // never less, however slow the machine is
  };
  FrameRateGovernor() : FrameRateGovernor(Options{}) {}
  explicit FrameRateGovernor(const Options& options) : options_(options) {}

  // In [smallestShare, 1].
  double share() const { return share_; }
  // The last frame, drawn with share(), took `seconds`. Returns the share for the next.
  double frame(double seconds);

 private:
  static constexpr int kLeastPatience = 30;

  void change(double share);

  Options options_;
  double share_ = 1;
  int late_ = 0;                   // late frames in a row
  double quickest_ = 0;            // of these, seconds
  int calm_ = 0;                   // frames in time since share_ changed or one was late
  int spare_ = 0;                  // of these, the last ones that had much time to spare
  double slowest_ = 0;             // of those, seconds
  double before_ = 0;              // the share before a rise that has not proved itself yet, else 0
  int patience_ = kLeastPatience;  // calm frames before a rise without headroom is tried
};

}  // namespace lightsketch
