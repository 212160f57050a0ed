// A relightable picture: the two-stage block factorisation of the Lighting Sensitive Display
// (Nayar, Belhumeur, Boult 2004).
//
// The picture is cut into m blocks of p = S x S pixels. With A_j the p x 3n matrix of block j under
// n lights (three columns per light: red, green, blue),
//   stage 1 (per block):   A_j ~ E_j^T L_j,   E_j: b_j x p orthonormal rows, L_j: b_j x 3n
//   stage 2 (all blocks):  [L_1; ...; L_m] ~ U V,   U: (sum b_j) x q,   V: q x 3n
// and the picture under intensities s (n x 3) is, for channel c,
//   v = V(:, c) s(:, c),   l_j = U_j v,   block j = E_j^T l_j.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "capture/frame/json.h"
#include "capture/frame/result.h"
#include "pipeline/illumination/direction_interpolation.h"

namespace lightsketch {

struct BlockLayout {
  int width = 0;  // of the picture, pixels
  int height = 0;
  int blockSize = 16;  // S; blocks at the right and lower rim are padded with zeros to S x S
  int columns() const { return (width + blockSize - 1) / blockSize; }
  int rows() const { return (height + blockSize - 1) / blockSize; }
  int blocks() const { return columns() * rows(); }             // m
  int pixelsPerBlock() const { return blockSize * blockSize; }  // p
};

enum class Storage { kFloat32, kFloat16 };

using RowMajorMatrixf = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

struct RelightableModel {
  BlockLayout layout;
  std::vector<std::int64_t> blockOffset;  // m + 1: first row of each block in E and U
  RowMajorMatrixf E;                      // rows x p
  RowMajorMatrixf U;                      // rows x q
  RowMajorMatrixf V;                      // q x 3n, column 3 i + c: light i, channel c
  Storage storage = Storage::kFloat16;    // on disk

  std::vector<Eigen::Vector3d> lights;  // n, unit, scene frame
  std::vector<double> solidAngles;      // n, Voronoi cells in steradians
  InterpolationSettings interpolation;  // between the model's lights, in linear light

  // Provenance.
  std::string holdOutRule;  // empty: nothing held out
  std::vector<int> heldOutIds;
  std::vector<int> capturedIds;  // frames it was made from
  std::vector<Eigen::Vector3d> capturedDirections;
  std::string sketch;  // where it came from
  std::string software;
  Json notes = Json::object();  // figures of the compression

  int lightCount() const { return static_cast<int>(lights.size()); }
  int rank() const { return static_cast<int>(V.rows()); }  // q
};

// One HDF5 file, .lsd, readable by h5py and MATLAB. A checksum in the user block is verified before
// libhdf5 sees the file; sizes are checked before anything is allocated. Atomic.
Result<void> saveModel(const RelightableModel& model, const std::filesystem::path& path);
Result<RelightableModel> loadModel(const std::filesystem::path& path);

}  // namespace lightsketch
