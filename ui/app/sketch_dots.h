// The wanted directions as dots, the same on the hemisphere and in the source camera's picture.
#pragma once

#include <map>
#include <vector>

#include "ui/app/hemisphere_view.h"
#include "ui/app/sketch_overlay.h"

namespace lightsketch {

class SketchDots {
 public:
  explicit SketchDots(SketchOverlay& overlay) : overlay_(overlay) {}
  void setHemisphere(HemisphereView* hemisphere) { hemisphere_ = hemisphere; }
  void setPlan(const SketchPlan& plan);
  void setCaptured(const std::vector<bool>& captured);
  // Shown as refused for a moment. False: it is captured, and stays so.
  bool refuse(int index, TimePoint when);
  void expire(TimePoint now);

 private:
  void show(int index, SketchDot dot);

  SketchOverlay& overlay_;
  HemisphereView* hemisphere_ = nullptr;
  std::vector<SketchDot> dots_;
  std::map<int, TimePoint> refused_;  // and since when
};

}  // namespace lightsketch
