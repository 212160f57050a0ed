#include "pipeline/relight/frame_rate_governor.h"

#include <algorithm>

namespace lightsketch {

void FrameRateGovernor::change(double share) {
  share_ = std::clamp(share, options_.smallestShare, 1.0);
  late_ = 0;
  calm_ = 0;
  spare_ = 0;
}

double FrameRateGovernor::frame(double seconds) {
  constexpr int kLate = 2;    // one late frame is a hiccup
  constexpr int kProof = 15;  // frames in time that prove a rise
  constexpr int kHeadroomFor = 10;
  constexpr int kMostPatience = 240;
  constexpr double kAim = 0.9;       // of the target, where a change is to lead
  constexpr double kHeadroom = 0.8;  // below that part of the target more is sure to fit
  constexpr double kProbe = 1.1;     // a rise that is only tried
  const double target = options_.targetSeconds;

  if (seconds > target) {
    quickest_ = late_ == 0 ? seconds : std::min(quickest_, seconds);
    calm_ = 0;
    spare_ = 0;
    if (++late_ < kLate) return share_;
    if (before_ > 0) {
      // Too much was tried: back to what held, and the next try later.
      change(before_);
      patience_ = std::min(2 * patience_, kMostPatience);
      before_ = 0;
    } else {
      change(share_ * kAim * target / quickest_);
    }
    return share_;
  }

  late_ = 0;
  ++calm_;
  slowest_ = spare_ == 0 ? seconds : std::max(slowest_, seconds);
  spare_ = seconds < kHeadroom * target ? spare_ + 1 : 0;
  if (before_ > 0 && calm_ >= kProof) {
    before_ = 0;
    patience_ = kLeastPatience;
  }
  if (share_ == 1) return share_;
  // Time grows at most in proportion to the share, so a rise into headroom holds the target.
  const bool headroom = spare_ >= kHeadroomFor;
  if (headroom || calm_ >= patience_) {
    before_ = share_;
    change(share_ * (headroom ? kAim * target / std::max(slowest_, 1e-9) : kProbe));
  }
  return share_;
}

}  // namespace lightsketch
