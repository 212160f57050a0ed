// From the captured pictures to the pictures that are factored: as they are, or interpolated to a
// denser grid of lights. Internal to this folder.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/compress/compress.h"
#include "pipeline/compress/scratch_stack.h"
#include "pipeline/sketch/light_stack.h"

namespace lightsketch {

// Immutable, thread-safe. `stack` and `options.surface` must outlive it.
class Densifier {
 public:
  static Result<Densifier> create(const LightStack& stack, const ScratchStack& scratch,
                                  const BlockLayout& layout, const CompressOptions& options,
                                  Progress& progress);

  // The model's lights, N of them; the captured ones if it does nothing.
  const std::vector<Eigen::Vector3d>& lights() const;
  // Between the model's lights, in linear light.
  const InterpolationSettings& interpolation() const;
  // False: the pictures are the captured ones, and columns() only turns halfs into floats. True
  // also where they are the captured ones' square roots.
  bool active() const;
  // The pictures are square roots.
  bool squareRoots() const;
  // How the captured lights are interpolated, for people; empty if it does nothing.
  const std::string& description() const;

  // Kept by a thread from block to block.
  struct Workspace {
    std::array<RowMajorMatrixf, 2> captured;  // n x 3 p, in each encoded domain
    RowMajorMatrixf weights;
    std::vector<float> log;
  };
  // Block `block` under the model's lights, linear (its square roots for a
  // single-lamp model): N x 3 x p. `halfs`: under the captured ones,
  // image i at halfs + i stride, 3 x p each.
  Result<void> columns(int block, const std::uint16_t* halfs, std::size_t stride,
                       Workspace& workspace, std::vector<float>& columns) const;

 private:
  Result<void> linearColumns(int block, const std::uint16_t* halfs, std::size_t stride,
                             Workspace& workspace, std::vector<float>& columns) const;
  struct State;
  std::shared_ptr<const State> state_;
};

}  // namespace lightsketch
