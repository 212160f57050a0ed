// What the rest of the pipeline sees of a sketch: n images of one scene, a light direction each.
// Ambient light is subtracted and the lamp's scale divided out, so the images add up.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <optional>
#include <vector>

#include "pipeline/sketch/sketch.h"

namespace lightsketch {

class LightStack {
 public:
  // `ids`: which frames, in this order; none of them dropped. The sketch must outlive the stack.
  static Result<LightStack> create(const Sketch& sketch, std::vector<int> ids);
  // Pictures that a program makes: `read(i)` under unit vector directions[i], h x w x 3,
  // thread-safe. ids() count from 0.
  using Reader = std::function<Result<RadianceImage>(int)>;
  static LightStack of(int width, int height, std::vector<Eigen::Vector3d> directions, Reader read);

  int size() const { return static_cast<int>(ids_.size()); }
  int width() const { return width_; }
  int height() const { return height_; }
  const std::vector<int>& ids() const { return ids_; }
  const std::vector<Eigen::Vector3d>& directions() const { return directions_; }
  // Where the lamp was, metres, scene frame; nothing where only its direction is known.
  const std::vector<std::optional<Eigen::Vector3d>>& positions() const { return positions_; }

  // Linear RGB of image i (an index into ids()), h x w x 3. Thread-safe.
  Result<RadianceImage> read(int i) const { return read_(i); }

 private:
  Reader read_;
  int width_ = 0;
  int height_ = 0;
  std::vector<int> ids_;
  std::vector<Eigen::Vector3d> directions_;
  std::vector<std::optional<Eigen::Vector3d>> positions_;
};

}  // namespace lightsketch
