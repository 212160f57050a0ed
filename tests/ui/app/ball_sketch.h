// A sketch of a matte, striped ball on a table, under directions all over a cap, made by formula.
#pragma once

#include <QTest>
#include <cmath>
#include <filesystem>
#include <numbers>
#include <set>

#include "pipeline/sketch/sketch.h"

namespace lightsketch {

struct BallSketch {
  int width = 64;
  int height = 48;
  int frames = 120;          // 8 degrees apart
  std::set<int> shadowed;    // a dark bar over a quarter of the picture
  std::set<int> brightened;  // by half

  Eigen::Vector3d direction(int i) const {
    const double z = 1 - 0.75 * (i + 0.5) / frames;
    const double turn = i * std::numbers::pi * (3 - std::sqrt(5.0));
    const double r = std::sqrt(1 - z * z);
    return {r * std::cos(turn), r * std::sin(turn), z};
  }
  // albedo max(0, n . l)
  RadianceImage picture(int i) const {
    const Eigen::Vector3d light = direction(i);
    RadianceImage image(width, height, 3);
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const double px = (2.0 * x + 1 - width) / height;
        const double py = 1 - (2.0 * y + 1) / height;
        const double squared = 0.49 - px * px - py * py;
        const bool ball = squared > 0;
        const Eigen::Vector3d normal =
            ball ? Eigen::Vector3d(px, py, std::sqrt(squared)) / 0.7 : Eigen::Vector3d(0, 0, 1);
        const double stripes = 0.6 + 0.3 * std::sin(ball ? 14 * px + 5 * py : 2 * px - 3 * py);
        const double tint[] = {0.9, ball ? 0.55 : 0.8, ball ? 0.4 : 0.75};
        double shade = std::max(0.0, normal.dot(light));
        if (shadowed.contains(i) && x > width / 3 && x < width / 3 + width / 4) shade *= 0.2;
        if (brightened.contains(i)) shade *= 1.5;
        for (int c = 0; c < 3; ++c)
          image(x, y, c) = static_cast<float>(0.9 * stripes * tint[c] * shade);
      }
    }
    return image;
  }
  void write(const std::filesystem::path& folder) const {
    SketchManifest manifest;
    manifest.width = width;
    manifest.height = height;
    manifest.directions = frames;
    manifest.software = "test";
    auto sketch = Sketch::create(folder, manifest);
    QVERIFY(sketch.has_value());
    for (int i = 0; i < frames; ++i) {
      FrameRecord record;
      record.light.direction = direction(i);
      QVERIFY(sketch->appendUnsynced(record, picture(i)).has_value());
    }
    QVERIFY(sketch->sync().has_value());
  }
};

}  // namespace lightsketch
