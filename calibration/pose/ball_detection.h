// Mirror balls in pictures: their outline and the lamp's highlight on them. Linear RGB pictures.
#pragma once

#include <Eigen/Core>
#include <optional>

#include "calibration/model/camera_model.h"
#include "calibration/pose/mirror_ball.h"
#include "capture/frame/image.h"
#include "capture/frame/result.h"

namespace lightsketch {

// Roughly where the ball is, pixels; within a third of the radius.
struct BallHint {
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  double radiusPixels = 0;
};

// The outline: edges along rays from the hint, the best circle or cone through three of them, then
// each edge to a fraction of a pixel along the curve's normal. Without a hint the picture's circles
// are tried, and one that stands out is taken. Fails where less than 0.4 of the outline shows an
// edge (0.6 without a hint), or where several balls could be meant. Thread-safe.
Result<BallCircle> findBallCircle(const RadianceImage& image, const std::optional<BallHint>& hint);
Result<BallCone> findBallCone(const RadianceImage& image, const CameraModel& model,
                              const std::optional<BallHint>& hint);

// 1 on the ball, less the outermost fiftieth of its radius, else 0.
Image<std::uint8_t> ballMask(const BallCircle& circle, int width, int height);
Image<std::uint8_t> ballMask(const BallCone& cone, const CameraModel& model);

// The least that each pixel has been: what does not come from a moving lamp. Start with an empty
// image.
void lowerTo(RadianceImage& minimum, const RadianceImage& image);

struct Highlight {
  PixelMeasurement place;
  double areaPixels = 0;
  double peak = 0;  // largest channel above the ambient light
};

// The brightest compact spot on the ball above `ambient` (empty: nothing to subtract): centroid of
// what exceeds half of its peak and its neighbours. Its covariance: a fiftieth of the spot's own
// extent, since a lamp's image is neither round nor evenly clipped, and what clipping leaves of the
// place of a small spot. Fails where nothing stands out, where the spot is no spot, and where a
// second one half as strong makes it doubtful which is the lamp's.
Result<Highlight> findHighlight(const RadianceImage& image, const RadianceImage& ambient,
                                const Image<std::uint8_t>& mask);

}  // namespace lightsketch
