// A scene that has what makes relighting hard: ten spheres over cobbled, bumpy ground, shadows with
// half-shadows of a lamp of 1.25 degrees radius, and highlights from blurred to sharp. Pictures are
// computed, not read, so a set of any size costs no disk.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "capture/frame/image.h"
#include "pipeline/sketch/light_stack.h"

namespace lightsketch {

// Immutable, thread-safe. Takes some seconds and 250 bytes a pixel to make.
class SyntheticScene {
 public:
  SyntheticScene(int width, int height);
  int width() const;
  int height() const;
  // Linear RGB under a lamp in unit direction `light`, z up, far away. One thread; 1 is what a
  // matte white surface facing the lamp gives back, highlights reach 3.
  RadianceImage picture(const Eigen::Vector3d& light) const;

  struct Surface;

 private:
  std::shared_ptr<const Surface> surface_;
};

// side x side directions of equal solid angle on the hemisphere, 85 degrees from the zenith at
// most; neighbours in a row are neighbours on the sphere (Shirley & Chiu 1997). `offset` 0.5: the
// centres of the cells; 1: their far corners, between the others, where (side - 1)^2 of them are
// left.
std::vector<Eigen::Vector3d> hemisphereDirections(int side, double offset = 0.5);

// The scene under these lights.
LightStack syntheticStack(const SyntheticScene& scene, std::vector<Eigen::Vector3d> lights);

}  // namespace lightsketch
