#include "pipeline/sketch/light_stack.h"

#include <utility>

namespace lightsketch {

Result<LightStack> LightStack::create(const Sketch& sketch, std::vector<int> ids) {
  LightStack stack;
  for (const int id : ids) {
    if (id < 0 || id >= static_cast<int>(sketch.frames().size())) {
      return failure(ErrorCode::kInvalidArgument, "{}: there is no frame {}; it has {}",
                     sketch.folder().string(), id, sketch.frames().size());
    }
    const FrameRecord& record = sketch.frames()[static_cast<std::size_t>(id)];
    if (record.dropped) {
      return failure(ErrorCode::kInvalidArgument, "{}: frame {} was dropped ({})",
                     sketch.folder().string(), id, record.dropReason);
    }
    stack.directions_.push_back(record.light.direction);
    stack.positions_.push_back(record.light.position);
  }
  stack.sketch_ = &sketch;
  stack.width_ = sketch.manifest().width;
  stack.height_ = sketch.manifest().height;
  stack.ids_ = std::move(ids);
  if (!sketch.manifest().ambientSubtracted) {
    ASSIGN_OR_RETURN(auto ambient, sketch.readAmbient());
    if (ambient) stack.ambient_ = std::move(*ambient);
  }
  return stack;
}

Result<RadianceImage> LightStack::read(int i) const {
  const int id = ids_.at(static_cast<std::size_t>(i));
  ASSIGN_OR_RETURN(auto image, sketch_->readFrame(id));
  const auto& scale = sketch_->frames()[static_cast<std::size_t>(id)].lampScale;
  const float factor[3] = {static_cast<float>(1 / scale[0]), static_cast<float>(1 / scale[1]),
                           static_cast<float>(1 / scale[2])};
  float* pixel = image.data();
  const float* ambient = ambient_.data();
  for (std::size_t k = 0; k < image.size(); ++k) {
    const float dark = ambient_.empty() ? 0.0f : ambient[k];
    pixel[k] = (pixel[k] - dark) * factor[k % 3];
  }
  return image;
}

}  // namespace lightsketch
