// Sketches rendered in the test: truth without a file of anybody else's.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "pipeline/compress/model.h"
#include "pipeline/sketch/light_stack.h"
#include "pipeline/sketch/sketch.h"

namespace lightsketch::testing {

// A folder of its own for the running test, empty.
std::filesystem::path freshFolder(const std::string& name);

// Two glossy balls on a textured table: shading, highlights, cast shadows, three colours.
RadianceImage renderBalls(int width, int height, const Eigen::Vector3d& light);

// A sketch of `render` under each light; values go through half floats as recorded ones do.
Sketch makeSketch(const std::filesystem::path& folder, int width, int height,
                  const std::vector<Eigen::Vector3d>& lights,
                  const std::function<RadianceImage(const Eigen::Vector3d&)>& render);

// Directions above z = `lowest`, by a fixed seed.
std::vector<Eigen::Vector3d> randomLights(int count, unsigned seed, double lowest = 0.1);

// The model's picture under intensities s (3n values, light by light), by its definition.
RadianceImage reconstruct(const RelightableModel& model, const Eigen::VectorXf& s);

// Root mean square difference; of 8-bit sRGB values for the PSNR.
double rmsDifference(const RadianceImage& a, const RadianceImage& b);
double psnrSrgb(const RadianceImage& a, const RadianceImage& b);

}  // namespace lightsketch::testing
