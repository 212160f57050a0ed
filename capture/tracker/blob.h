// Bright spots that the background does not explain.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "capture/frame/frame.h"
#include "capture/tracker/background.h"

namespace lightsketch {

struct Blob {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();               // centroid
  Eigen::Matrix2d moments = Eigen::Matrix2d::Zero();             // second moments, pixels^2
  Eigen::Matrix2d centroidCovariance = Eigen::Matrix2d::Zero();  // from pixel noise
  Region box;       // of the pixels above the threshold
  Region window;    // what was measured: the box and its surroundings
  double area = 0;  // pixels above the threshold
  double flux = 0;  // sum above background and surroundings, units of saturation
  // Light just outside the core, mean excess in units of saturation: two lights with saturated
  // cores of one size, a lamp and its image in a glass, differ here. The median over eight sides,
  // since the arm or a lit edge lies on one or two of them.
  double halo = 0;
  double staticFraction =
      0;                 // pixels on static lights in and close to the box, relative to the area
  bool cut = false;      // by the picture's border
  bool crowded = false;  // another blob is so close that they disturb each other
};

// The strongest blobs, brightest first, at most eight: where the excess over the background is
// above four fifths of the largest excess in the picture. That high, since a lamp lights the walls
// beside it, too. A pixel that became saturated has full excess, so that a lamp before a bright
// window is as bright as one before a dark wall.
std::vector<Blob> findBlobs(const Image<std::uint16_t>& counts, const Background& background);

}  // namespace lightsketch
