// Procedural triangle meshes for the rig's objects, in metres, in the object's own frame.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <functional>
#include <vector>

namespace lightsketch {

struct Mesh {
  std::vector<Eigen::Vector3f> positions;
  std::vector<Eigen::Vector3f> normals;  // unit, outward, per vertex
  std::vector<std::array<std::uint32_t, 3>> triangles;

  void append(const Mesh& other, const Eigen::Vector3f& offset);
};

Mesh makeEllipsoid(const Eigen::Vector3f& radii);
// Around the z axis.
Mesh makeTorus(float majorRadius, float minorRadius);
// Centred on the origin; edges rounded with `bevel`.
Mesh makeBox(const Eigen::Vector3f& size, float bevel);
// Open at +z, standing on z = 0.
Mesh makeOpenBox(const Eigen::Vector3f& size, float wall);
// Profile points (radius, z) turned around z, smooth between them (Catmull and Rom 1974). The
// outside is to the right of the direction in which the profile runs upwards.
Mesh makeLathe(const std::vector<Eigen::Vector2f>& profile);
// A slab of `size` on z = 0 whose top is size.z() + height(x, y).
Mesh makeHeightField(const Eigen::Vector3f& size, int columns, int rows,
                     const std::function<float(float, float)>& height);

}  // namespace lightsketch
