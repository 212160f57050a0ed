#include "pipeline/sketch/light_stack.h"

#include <numeric>
#include <utility>

namespace lightsketch {
namespace {

Result<RadianceImage> readFrame(const Sketch& sketch, int id, const RadianceImage& ambient) {
  ASSIGN_OR_RETURN(auto image, sketch.readFrame(id));
  const auto& scale = sketch.frames()[static_cast<std::size_t>(id)].lampScale;
  const float factor[3] = {static_cast<float>(1 / scale[0]), static_cast<float>(1 / scale[1]),
                           static_cast<float>(1 / scale[2])};
  float* pixel = image.data();
  for (std::size_t k = 0; k < image.size(); ++k) {
    const float dark = ambient.empty() ? 0.0f : ambient.data()[k];
    pixel[k] = (pixel[k] - dark) * factor[k % 3];
  }
  return image;
}

}  // namespace

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
  stack.width_ = sketch.manifest().width;
  stack.height_ = sketch.manifest().height;
  stack.ids_ = std::move(ids);
  RadianceImage ambient;  // empty if there is nothing to subtract
  if (!sketch.manifest().ambientSubtracted) {
    ASSIGN_OR_RETURN(auto recorded, sketch.readAmbient());
    if (recorded) ambient = std::move(*recorded);
  }
  stack.read_ = [&sketch, ids = stack.ids_, ambient = std::move(ambient)](int i) {
    return readFrame(sketch, ids.at(static_cast<std::size_t>(i)), ambient);
  };
  return stack;
}

LightStack LightStack::of(int width, int height, std::vector<Eigen::Vector3d> directions,
                          Reader read) {
  LightStack stack;
  stack.width_ = width;
  stack.height_ = height;
  stack.ids_.resize(directions.size());
  std::iota(stack.ids_.begin(), stack.ids_.end(), 0);
  stack.positions_.resize(directions.size());
  stack.directions_ = std::move(directions);
  stack.read_ = std::move(read);
  return stack;
}

}  // namespace lightsketch
