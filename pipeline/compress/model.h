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
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "capture/frame/json.h"
#include "capture/frame/result.h"
#include "pipeline/compress/factor_values.h"
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

using RowMajorMatrixf = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// The factorisation in plain numbers, as it is computed.
struct Factors {
  BlockLayout layout;
  std::vector<std::int64_t> blockOffset;  // m + 1: first row of each block in E and U
  RowMajorMatrixf E;                      // rows x p
  RowMajorMatrixf U;                      // rows x q
  RowMajorMatrixf V;                      // q x 3n, column 3 i + c: light i, channel c
};

// How a model keeps its numbers, in memory as in the file.
enum class Storage {
  kFloat32,
  kFloat16,
  kQ8,      // E in int8 with a scale per row, U and V in half floats
  kPacked,  // integers whose steps rate and distortion chose; in the file deflated
};
// As the command line and the file call it: "f32", "f16", "q8", "packed".
const char* nameOf(Storage storage);

// The number at index i is values.at(i) times its scale; without scales, 1.
struct StoredFactor {
  FactorValues values;
  std::vector<float> scale;
};

struct PackedCode;

struct RelightableModel {
  BlockLayout layout;
  std::vector<std::int64_t> blockOffset;  // as Factors
  int rank = 0;                           // q

  // The factors as the render kernels read them.
  static constexpr int kPanelRows = 32;
  StoredFactor E;  // rows x p, row by row; a scale per row
  StoredFactor U;  // panels of 32 rows x q: row r, column k at ((r / 32) q + k) 32 + r % 32, rows
                   // padded with zeros; a scale per column k
  StoredFactor V;  // 3n x q (the transpose of the paper's V): light i, channel c, column k at
                   // (3 i + c) q + k; a scale per k
  Storage storage = Storage::kFloat16;
  // E^T U V gives square roots of radiance: better pictures of one lamp in as many bytes, and wrong
  // ones of more, since roots do not add up. Relighting squares what it draws.
  bool singleLamp = false;
  // Of a packed model, what its file holds and E, U and V were made from (packed_code.h).
  std::shared_ptr<const PackedCode> code;

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
  std::int64_t rows() const { return blockOffset.empty() ? 0 : blockOffset.back(); }
  std::int64_t panels() const { return (rows() + kPanelRows - 1) / kPanelRows; }
  // E, U and V in memory.
  std::size_t factorBytes() const { return E.values.bytes() + U.values.bytes() + V.values.bytes(); }
};

// Keeps `factors` in the model as f32, f16 or q8 (std::logic_error for kPacked, whose steps are
// chosen elsewhere). Sets layout, blocks, rank and storage, nothing else.
void setFactors(RelightableModel& model, const Factors& factors, Storage storage);
// The model's numbers in full, scales applied.
Factors factorsOf(const RelightableModel& model);
// Nothing, or why E, U and V, blocks, lights and scales do not fit each other.
std::optional<std::string> misfitOf(const RelightableModel& model);

// One HDF5 file, .lsd, readable by h5py and MATLAB. A checksum in the user block is verified before
// libhdf5 sees the file; sizes are checked before anything is allocated. Atomic.
Result<void> saveModel(const RelightableModel& model, const std::filesystem::path& path);
// Size of the file that saveModel would write.
Result<std::size_t> savedBytes(const RelightableModel& model);
Result<RelightableModel> loadModel(const std::filesystem::path& path);

}  // namespace lightsketch
