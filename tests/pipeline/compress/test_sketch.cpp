#include "tests/pipeline/compress/test_sketch.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <stdexcept>

#include "capture/frame/srgb.h"

namespace lightsketch::testing {
namespace {

using Eigen::Vector3d;

struct Ball {
  Vector3d centre;
  double radius;
  Vector3d colour;
};

const Ball kBalls[] = {{{-0.35, 0.1, 0.3}, 0.3, {0.7, 0.2, 0.1}},
                       {{0.4, -0.25, 0.2}, 0.2, {0.1, 0.3, 0.6}}};

bool hits(const Ball& ball, const Vector3d& from, const Vector3d& direction) {
  const Vector3d to = ball.centre - from;
  const double along = to.dot(direction);
  return along > 0 && (to - along * direction).norm() < ball.radius &&
         to.norm() > ball.radius * 1.0001;
}

}  // namespace

std::filesystem::path freshFolder(const std::string& name) {
  const auto* test = ::testing::UnitTest::GetInstance()->current_test_info();
  const auto path =
      std::filesystem::path(::testing::TempDir()) /
      (std::string("compress_") + test->test_suite_name() + "_" + test->name() + "_" + name);
  std::filesystem::remove_all(path);
  return path;
}

RadianceImage renderBalls(int width, int height, const Vector3d& light) {
  RadianceImage image(width, height, 3);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      // Seen from above, orthographically: the topmost of table and balls.
      const double px = (2.0 * x + 1) / width - 1;
      const double py = 1 - (2.0 * y + 1) / height;
      Vector3d point(px, py, 0);
      Vector3d normal = Vector3d::UnitZ();
      const double check = 0.5 + 0.3 * std::sin(17 * px + 3 * py) * std::sin(13 * py);
      Vector3d colour(check, 0.9 * check, 0.6 * check);
      for (const Ball& ball : kBalls) {
        const double dx = px - ball.centre.x();
        const double dy = py - ball.centre.y();
        const double squared = ball.radius * ball.radius - dx * dx - dy * dy;
        if (squared < 0) continue;
        point.z() = ball.centre.z() + std::sqrt(squared);
        normal = (point - ball.centre) / ball.radius;
        colour = ball.colour;
      }
      double shade = std::max(0.0, normal.dot(light));
      double gloss =
          shade > 0
              ? 0.5 * std::pow(std::max(0.0, normal.dot((light + Vector3d::UnitZ()).normalized())),
                               40)
              : 0;
      for (const Ball& ball : kBalls) {
        if (hits(ball, point, light)) shade = gloss = 0;
      }
      for (int c = 0; c < 3; ++c) image(x, y, c) = static_cast<float>(colour[c] * shade + gloss);
    }
  }
  return image;
}

Sketch makeSketch(const std::filesystem::path& folder, int width, int height,
                  const std::vector<Vector3d>& lights,
                  const std::function<RadianceImage(const Vector3d&)>& render) {
  SketchManifest manifest;
  manifest.width = width;
  manifest.height = height;
  auto sketch = Sketch::create(folder, manifest);
  if (!sketch) throw std::runtime_error(sketch.error().message);
  for (const auto& light : lights) {
    FrameRecord record;
    record.light.direction = light;
    if (auto id = sketch->appendUnsynced(record, render(light)); !id)
      throw std::runtime_error(id.error().message);
  }
  if (auto synced = sketch->sync(); !synced) throw std::runtime_error(synced.error().message);
  return std::move(*sketch);
}

std::vector<Vector3d> randomLights(int count, unsigned seed, double lowest) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::vector<Vector3d> lights;
  while (static_cast<int>(lights.size()) < count) {
    const Vector3d d = Vector3d(normal(random), normal(random), normal(random)).normalized();
    if (d.z() > lowest) lights.push_back(d);
  }
  return lights;
}

RadianceImage reconstruct(const RelightableModel& model, const Eigen::VectorXf& s) {
  const Factors factors = factorsOf(model);
  const BlockLayout& layout = model.layout;
  RadianceImage image(layout.width, layout.height, 3);
  const auto n = static_cast<Eigen::Index>(model.lights.size());
  Eigen::MatrixXf v(model.rank, 3);
  for (int c = 0; c < 3; ++c) {
    v.col(c).setZero();
    for (Eigen::Index i = 0; i < n; ++i) v.col(c) += factors.V.col(3 * i + c) * s[3 * i + c];
  }
  for (int j = 0; j < layout.blocks(); ++j) {
    const auto from = model.blockOffset[static_cast<std::size_t>(j)];
    const auto rows = model.blockOffset[static_cast<std::size_t>(j) + 1] - from;
    const Eigen::MatrixXf pixels =
        factors.E.middleRows(from, rows).transpose() * (factors.U.middleRows(from, rows) * v);
    for (int k = 0; k < layout.pixelsPerBlock(); ++k) {
      const int x = j % layout.columns() * layout.blockSize + k % layout.blockSize;
      const int y = j / layout.columns() * layout.blockSize + k / layout.blockSize;
      if (x >= layout.width || y >= layout.height) continue;
      for (int c = 0; c < 3; ++c) image(x, y, c) = pixels(k, c);
    }
  }
  return image;
}

double rmsDifference(const RadianceImage& a, const RadianceImage& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i)
    sum += std::pow(double{a.data()[i]} - double{b.data()[i]}, 2);
  return std::sqrt(sum / static_cast<double>(a.size()));
}

double psnrSrgb(const RadianceImage& a, const RadianceImage& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    sum += std::pow(static_cast<double>(srgbEncode8(a.data()[i])) -
                        static_cast<double>(srgbEncode8(b.data()[i])),
                    2);
  }
  return 10 * std::log10(255.0 * 255.0 * static_cast<double>(a.size()) / sum);
}

}  // namespace lightsketch::testing
