#include "ui/app/sketch_dots.h"

#include <algorithm>
#include <cmath>

namespace lightsketch {
namespace {
constexpr double kRefusedSeconds = 1.5;
}

void SketchDots::setPlan(const SketchPlan& plan) {
  overlay_.setPlan(plan);
  hemisphere_->setWholeSphere(plan.wholeSphere);
  const double radius = std::clamp(60.0 / std::sqrt(plan.grid->size()), 1.5, 5.0);
  std::vector<HemisphereView::Dot> dots;
  for (const Eigen::Vector3d& direction : plan.grid->directions()) {
    dots.push_back({direction, colourOf(SketchDot::kOpen), radius, true, {}});
  }
  dots_.assign(dots.size(), SketchDot::kOpen);
  refused_.clear();
  hemisphere_->setDots(std::move(dots));
  setCaptured(plan.captured);
}

void SketchDots::setCaptured(const std::vector<bool>& captured) {
  for (std::size_t i = 0; i < std::min(captured.size(), dots_.size()); ++i) {
    const int index = static_cast<int>(i);
    if (captured[i]) {
      refused_.erase(index);
      show(index, SketchDot::kCaptured);
    } else if (dots_[i] == SketchDot::kCaptured) {
      show(index, SketchDot::kOpen);
    }
  }
}

bool SketchDots::refuse(int index, TimePoint when) {
  if (dots_.at(static_cast<std::size_t>(index)) == SketchDot::kCaptured) return false;
  refused_[index] = when;
  show(index, SketchDot::kRefused);
  return true;
}

void SketchDots::expire(TimePoint now) {
  std::erase_if(refused_, [&](const auto& refused) {
    if (toSeconds(now - refused.second) < kRefusedSeconds) return false;
    show(refused.first, SketchDot::kOpen);
    return true;
  });
}

void SketchDots::show(int index, SketchDot dot) {
  auto& shown = dots_.at(static_cast<std::size_t>(index));
  if (shown == dot) return;
  shown = dot;
  HemisphereView::Dot changed = hemisphere_->dots()[static_cast<std::size_t>(index)];
  changed.colour = colourOf(dot);
  changed.hollow = dot == SketchDot::kOpen;
  hemisphere_->setDot(index, changed);
  overlay_.setDot(index, dot);
}

}  // namespace lightsketch
