// A small sketch on disk whose pictures depend on the light direction linearly, and a model of it
// that is exact, made by hand.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <numbers>
#include <string>
#include <vector>

#include "pipeline/compress/hold_out.h"
#include "pipeline/compress/model.h"
#include "pipeline/sketch/sketch.h"

namespace lightsketch::testing {

inline constexpr int kWidth = 22;  // not a multiple of the block size
inline constexpr int kHeight = 14;

// A folder that vanishes with the test.
class TemporaryFolder {
 public:
  TemporaryFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "lightsketch-XXXXXX").string();
    path_ = ::mkdtemp(name.data());
  }
  ~TemporaryFolder() { std::filesystem::remove_all(path_); }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

// `count` directions evenly over the cap within 60 degrees of +z.
inline std::vector<Eigen::Vector3d> capDirections(int count) {
  std::vector<Eigen::Vector3d> directions;
  for (int i = 0; i < count; ++i) {
    const double z = 1 - 0.5 * (i + 0.5) / count;
    const double turn = i * std::numbers::pi * (3 - std::sqrt(5.0));
    const double r = std::sqrt(1 - z * z);
    directions.emplace_back(r * std::cos(turn), r * std::sin(turn), z);
  }
  return directions;
}

// Matte and unshadowed: radiance = albedo (normal . direction), an own normal per pixel.
inline RadianceImage mattePicture(const Eigen::Vector3d& light) {
  RadianceImage picture(kWidth, kHeight, 3);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const Eigen::Vector3d normal(0.3 * std::sin(x), 0.3 * std::cos(y), 0.9);
      for (int c = 0; c < 3; ++c) {
        picture(x, y, c) = static_cast<float>((0.3 + 0.2 * c) * normal.dot(light));
      }
    }
  }
  return picture;
}

// The same under every light; the values are exact in half float and lie far from where the 8-bit
// value would change.
inline RadianceImage constantPicture(const Eigen::Vector3d&) {
  RadianceImage picture(kWidth, kHeight, 3);
  for (std::size_t i = 0; i < picture.size(); ++i) {
    picture.data()[i] = 0.125f * static_cast<float>(1 + i % 7);
  }
  return picture;
}

using Scene = RadianceImage (*)(const Eigen::Vector3d&);

inline Sketch makeSketch(const std::filesystem::path& folder, Scene scene, int count,
                         const std::string& origin = "picture") {
  SketchManifest manifest;
  manifest.width = kWidth;
  manifest.height = kHeight;
  manifest.software = "test";
  auto sketch = Sketch::create(folder, manifest);
  EXPECT_TRUE(sketch) << sketch.error().message;
  for (const Eigen::Vector3d& direction : capDirections(count)) {
    FrameRecord record;
    record.origin = origin + std::to_string(sketch->frames().size()) + ".png";
    record.light.direction = direction;
    const auto id = sketch->appendUnsynced(record, scene(direction));
    EXPECT_TRUE(id) << id.error().message;
  }
  EXPECT_TRUE(sketch->sync());
  return std::move(*sketch);
}

// E and V are unit matrices, U holds the pictures of the frames that the rule leaves.
inline RelightableModel exactModel(const Sketch& sketch, Scene scene, const std::string& rule) {
  const auto holdOut = applyHoldOut(sketch, rule);
  EXPECT_TRUE(holdOut) << holdOut.error().message;
  RelightableModel model;
  Factors factors;
  factors.layout = {kWidth, kHeight, 8};
  model.holdOutRule = rule;
  model.heldOutIds = holdOut->heldOut;
  model.capturedIds = holdOut->training;
  for (const int id : model.capturedIds) {
    model.lights.push_back(sketch.frames()[static_cast<std::size_t>(id)].light.direction);
  }
  model.capturedDirections = model.lights;
  model.solidAngles.assign(model.lights.size(), 0.1);
  model.software = "lightsketch test";
  model.notes = Json{{"a <note>", "b & c"}};

  const int pixels = factors.layout.pixelsPerBlock();
  const int columns = 3 * model.lightCount();
  for (int j = 0; j <= factors.layout.blocks(); ++j) factors.blockOffset.push_back(j * pixels);
  factors.E = RowMajorMatrixf::Identity(pixels, pixels).replicate(factors.layout.blocks(), 1);
  factors.V = RowMajorMatrixf::Identity(columns, columns);
  factors.U = RowMajorMatrixf::Zero(factors.blockOffset.back(), columns);
  for (int i = 0; i < model.lightCount(); ++i) {
    const RadianceImage picture = scene(model.lights[static_cast<std::size_t>(i)]);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const int row = (y / 8 * factors.layout.columns() + x / 8) * pixels + y % 8 * 8 + x % 8;
        for (int c = 0; c < 3; ++c) factors.U(row, 3 * i + c) = picture(x, y, c);
      }
    }
  }
  setFactors(model, factors, Storage::kFloat32);
  return model;
}

// Every picture of the model times `factor`.
inline void scale(RelightableModel& model, float factor) {
  for (float& value : model.V.values.as<float>()) value *= factor;
}

}  // namespace lightsketch::testing
