// What others keep of pictures under many lights, fitted to the same pictures; for measurement
// only.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "capture/frame/image.h"
#include "capture/frame/result.h"
#include "pipeline/sketch/light_stack.h"

namespace lightsketch {

// Whatever predicts pictures, and the bytes it needs to.
struct Peer {
  std::string name;
  std::uint64_t bytes = 0;
  // Linear RGB under a lamp in a unit direction. Thread-safe.
  std::function<Result<RadianceImage>(const Eigen::Vector3d&)> predict;
};

// Functions of the light's direction that each pixel's channels are sums of.
struct LightBasis {
  std::string name;
  int size = 0;
  std::function<Eigen::VectorXd(const Eigen::Vector3d&)> at;
};
// Malzbender, Gelb, Wolters 2001, eq. 1, in red, green and blue.
LightBasis polynomialTexture();
// Gautron et al. 2004: bands^2 functions, Legendre polynomials shifted to the hemisphere z >= 0.
LightBasis hemisphericalHarmonics(int bands);
// bands^2 functions.
LightBasis sphericalHarmonics(int bands);

// One peer for each basis, by regularised least squares over all of `stack` in one pass;
// coefficients are kept as half floats and counted as such.
Result<std::vector<Peer>> fitBases(const LightStack& stack, std::span<const LightBasis> bases);

// The best basis pictures of the whole picture that fit into `bytes` as floats: A ~ U V with U
// (pixels x q) and V (q x 3n). In the span that some thousands of pixels show: two passes. Between
// the lights V is interpolated as our own models are.
Result<Peer> fitGlobalPca(const LightStack& stack, std::uint64_t bytes);

// Errors pooled over pictures, pixels and channels.
struct PictureQuality {
  double linearPsnr = 0;  // dB, peak 1, nothing clipped
  double srgbPsnr = 0;    // dB, 8 bits, peak 255
};
// Against all of `truth`.
Result<PictureQuality> measureQuality(const Peer& peer, const LightStack& truth);

}  // namespace lightsketch
