#include "ui/app/sketch_summary.h"

#include <algorithm>

#include "pipeline/compress/hold_out.h"
#include "pipeline/sketch/image_file.h"
#include "pipeline/sketch/light_stack.h"
#include "pipeline/sketch/sketch.h"
#include "pipeline/validate/validate.h"
#include "ui/app/picture_view.h"

namespace lightsketch {

Result<SketchSummary> summaryOf(const std::filesystem::path& folder) {
  ASSIGN_OR_RETURN(const auto sketch, Sketch::open(folder));
  SketchSummary summary;
  summary.width = sketch.manifest().width;
  summary.height = sketch.manifest().height;
  for (const FrameRecord& frame : sketch.frames()) {
    summary.frames.push_back(
        {frame.id, frame.light.direction, frame.dropped, QString::fromStdString(frame.dropReason)});
    summary.wholeSphere |= frame.light.direction.z() < 0;
  }
  const std::vector<int> active = sketch.activeFrames();
  summary.active = static_cast<int>(active.size());
  if (const auto split = applyHoldOut(sketch, defaultHoldOut(sketch))) {
    summary.holdOut = split->rule;
    summary.heldOut.insert(split->heldOut.begin(), split->heldOut.end());
  }
  const Eigen::Vector3d upperLeft = Eigen::Vector3d(-0.45, 0.45, 0.77);
  const auto fit = [&](int id) {
    return sketch.frames()[static_cast<std::size_t>(id)].light.direction.dot(upperLeft);
  };
  const auto best = [&](const auto& ids) {
    const auto at = std::ranges::max_element(ids, {}, fit);
    return at == ids.end() ? -1 : *at;
  };
  summary.example = summary.heldOut.empty() ? best(active) : best(summary.heldOut);
  return summary;
}

Thumbnails thumbnailsOf(const std::filesystem::path& folder, const std::vector<int>& ids,
                        const QSize& size, const std::stop_token& stop) {
  Thumbnails thumbnails;
  const auto sketch = Sketch::open(folder);
  if (!sketch) return thumbnails;
  const auto stack = LightStack::create(*sketch, ids);
  if (!stack) return thumbnails;
  std::vector<double> exposures;
  std::vector<RadianceImage> pictures;
  for (int i = 0; i < stack->size() && !stop.stop_requested(); ++i) {
    const auto picture = stack->read(i);
    if (!picture) continue;  // checked, and said, by what uses it
    exposures.push_back(exposureToShow(*picture));
    // Every pixel of a thumbnail from one of the picture: small pictures wait for the exposure.
    const int step = std::max(
        {1, picture->width() / (2 * size.width()), picture->height() / (2 * size.height())});
    RadianceImage small(picture->width() / step, picture->height() / step, 3);
    for (int y = 0; y < small.height(); ++y) {
      for (int x = 0; x < small.width(); ++x) {
        for (int c = 0; c < 3; ++c) small(x, y, c) = (*picture)(x * step, y * step, c);
      }
    }
    pictures.push_back(std::move(small));
    thumbnails.pictures.push_back({ids[static_cast<std::size_t>(i)], {}});
  }
  if (pictures.empty()) return thumbnails;
  std::ranges::sort(exposures);
  thumbnails.exposure = static_cast<float>(exposures[exposures.size() / 4]);
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    thumbnails.pictures[i].image = toQImage(toSrgb8(pictures[i], thumbnails.exposure))
                                       .scaled(size, Qt::KeepAspectRatio, Qt::SmoothTransformation);
  }
  return thumbnails;
}

Result<QImage> frameImage(const std::filesystem::path& folder, int id, float exposure) {
  ASSIGN_OR_RETURN(const auto sketch, Sketch::open(folder));
  ASSIGN_OR_RETURN(RadianceImage picture, sketch.readFrame(id));
  if (!sketch.manifest().ambientSubtracted) {
    ASSIGN_OR_RETURN(const auto ambient, sketch.readAmbient());
    if (ambient && ambient->sameShape(picture)) {
      for (std::size_t i = 0; i < picture.size(); ++i) picture.data()[i] -= ambient->data()[i];
    }
  }
  return toQImage(toSrgb8(picture, exposure));
}

}  // namespace lightsketch
