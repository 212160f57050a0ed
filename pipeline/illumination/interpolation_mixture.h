// Several ways to interpolate between lights, and how much to trust each: judged by how well the
// other lights predict each light.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "pipeline/illumination/direction_interpolation.h"

namespace lightsketch {

struct InterpolationCandidate {
  InterpolationSettings settings;
  Eigen::MatrixXf leaveOneOut;  // n x n: row i predicts light i from the others, in closed form
};

// Kernels, trends, nuggets and stretches, those of them that the lights less any one determine;
// fewer kinds above 256 lights, empty below some five. Uses all cores.
std::vector<InterpolationCandidate> interpolationCandidates(
    std::span<const Eigen::Vector3d> lights);

// Lights at the rim: left out, they are outside the hull of the others. Empty if there is no rim.
std::vector<int> rimLights(std::span<const Eigen::Vector3d> lights);

// The mixture a >= 0, sum 1, with the least a^T G a, where G holds the products of the candidates'
// errors: stacked regression (Breiman 1996). By exchanges between the pair of candidates that
// promises most.
Eigen::VectorXd bestMixture(const Eigen::MatrixXd& errorProducts);

}  // namespace lightsketch
