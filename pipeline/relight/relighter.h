// Draws a relightable model under any light, as fast as the machine can read it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "capture/frame/image.h"
#include "capture/frame/result.h"
#include "pipeline/compress/model.h"
#include "pipeline/illumination/illumination.h"

namespace lightsketch {

struct PixelRectangle {
  int x = 0, y = 0;  // top left
  int width = 0, height = 0;
};

struct RenderOptions {
  float exposure = 1;  // factor on radiance
  // Of the bases, in (0, 1]: the strongest ceil(share b_j) rows of each block's E and the first
  // ceil(share q) columns of U are used. Drawing time falls about in proportion.
  float share = 1;
  // Only blocks that touch it are computed and written, whole; what it has outside of the picture
  // is ignored. Nothing: all.
  std::optional<PixelRectangle> visible;
};

// One model under a light that changes. Drawing is const and may happen in several threads at once
// as long as none sets the light; every call uses all cores. Blocks are summed by one thread in a
// fixed order, so pictures do not depend on the number of threads.
class Relighter {
 public:
  // No light is on. Fails if the model's parts do not fit each other.
  static Result<Relighter> create(std::shared_ptr<const RelightableModel> model);

  // v = V s. Reads only the columns of V whose lights have changed since the last call, or those
  // of all lights that are on, where these are fewer or rounding could show (see README). Fails if
  // s does not fit the model. Of a single-lamp model s are the weights of one lamp's neighbours
  // times the square root of its colour, see singleLamp().
  Result<void> setLight(const LightIntensities& intensities);

  // 8-bit sRGB, within one level of srgbEncode8, in bytes B, G, R, 255. Row y starts at byte
  // y strideBytes, which must be a multiple of 4 as the address is; multiples of 64 are fastest.
  void renderBgra8(std::span<std::byte> pixels, std::size_t strideBytes,
                   const RenderOptions& options = {}) const;
  // Linear half floats, 3 (RGB) or 4 (RGB and 1) a pixel, clamped to what they hold. Address and
  // stride are multiples of 2.
  void renderHalf(std::span<std::byte> pixels, std::size_t strideBytes, int channels,
                  const RenderOptions& options = {}) const;
  // Linear, not clipped: small negative values can occur. `picture` has the model's size and three
  // channels.
  void render(RadianceImage& picture, const RenderOptions& options = {}) const;
  // All three throw std::logic_error if the picture does not fit into what was given, or the share
  // is not one.

  const RelightableModel& model() const { return *model_; }

 private:
  explicit Relighter(std::shared_ptr<const RelightableModel> model);

  std::shared_ptr<const RelightableModel> model_;
  LightIntensities intensities_;  // that v_ stands for
  Eigen::Index on_ = 0;           // how many of them are not zero
  double magnitude_ = 0;          // their sum of absolute values
  double rounding_ = 0;           // bound on v_'s error by increments, in units of max |V|
  std::vector<double> v_;         // three times litStride(rank), without the scales
};

// Linear RGB picture under intensities s (n x 3): E^T (U (V s)). Fails if s or the model's parts do
// not fit. Not clipped: small negative values can occur. Thread-safe; uses all cores.
Result<RadianceImage> relight(const RelightableModel& model, const LightIntensities& intensities);

// The intensities that show one lamp on a single-lamp model. Fails if its colour is negative.
Result<LightIntensities> singleLamp(const DirectionalLamp& lamp,
                                    const DirectionInterpolator& interpolator);

}  // namespace lightsketch
