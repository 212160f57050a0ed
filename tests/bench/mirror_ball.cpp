// Mirror balls: directions of psm_chrome against lights.txt, and how well source cameras are placed
// by a ball at the subject, in synthetic geometry with 0.1 pixels of noise.
#include <Eigen/LU>
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>

#include "calibration/pose/ball_detection.h"
#include "calibration/pose/ball_pose.h"
#include "pipeline/sketch/image_file.h"
#include "tests/calibration/pose/synthetic_ball.h"

namespace lightsketch {
namespace {

using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

double medianOf(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const std::size_t n = values.size();
  return n % 2 ? values[n / 2] : (values[n / 2 - 1] + values[n / 2]) / 2;
}

double percentile95(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() * 95 / 100];
}

int chrome() {
  const std::filesystem::path folder =
      std::string(LIGHTSKETCH_SOURCE_DIR) + "/../shared/data/spheres/psm_chrome";
  if (!std::filesystem::exists(folder)) {
    std::printf("psm_chrome: %s is not here, skipped\n\n", folder.c_str());
    return 0;
  }
  const auto outline = readImage(folder / "chrome.mask.png", TransferFunction::kLinear);
  if (!outline) return std::fprintf(stderr, "%s\n", outline.error().message.c_str()), 1;
  const auto circle = findBallCircle(*outline, std::nullopt);
  if (!circle) return std::fprintf(stderr, "%s\n", circle.error().message.c_str()), 1;
  const auto mask = ballMask(*circle, outline->width(), outline->height());
  std::ifstream list(folder / "lights.txt");
  int count = 0;
  list >> count;
  std::printf("psm_chrome: outline at (%.2f, %.2f), radius %.2f pixels\n", circle->centre.x(),
              circle->centre.y(), circle->radiusPixels);
  std::printf("light  highlight         lights.txt is at   off it by  differs by\n");
  std::vector<Vector3d> found;
  std::vector<Vector3d> expected;
  std::vector<double> errors;
  int beside = 0;
  for (int i = 0; i < count; ++i) {
    Vector3d light;
    list >> light.x() >> light.y() >> light.z();
    const auto image = readImage(folder / ("chrome." + std::to_string(i) + ".png"));
    if (!image) return std::fprintf(stderr, "%s\n", image.error().message.c_str()), 1;
    const auto highlight = findHighlight(*image, {}, mask);
    if (!highlight) return std::fprintf(stderr, "%s\n", highlight.error().message.c_str()), 1;
    const Vector2d at = highlight->place.pixel;
    found.push_back(*directionFromHighlight(*circle, at));
    expected.push_back(light);
    errors.push_back(degreesBetween(found.back(), light));
    const Vector3d normal = (light + Vector3d::UnitZ()).normalized();
    const Vector2d claimed =
        circle->centre + circle->radiusPixels * Vector2d(normal.x(), -normal.y());
    const double off = (claimed - at).norm();
    const bool outside = off > std::sqrt(highlight->areaPixels / std::numbers::pi);
    beside += outside ? 1 : 0;
    std::printf("%5d  %6.2f %6.2f     %6.2f %6.2f     %5.2f px   %5.2f deg%s\n", i, at.x(), at.y(),
                claimed.x(), claimed.y(), off, errors.back(), outside ? "  beside the spot" : "");
  }
  double best = 180;
  for (int x = -30; x <= 30; ++x) {
    for (int y = -30; y <= 30; ++y) {
      for (int z = -30; z <= 30; ++z) {
        const Vector3d turn = Vector3d(x, y, z) * 0.1 * std::numbers::pi / 180;
        const Matrix3d rotation =
            turn.norm() > 0 ? Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix()
                            : Matrix3d(Matrix3d::Identity());
        std::vector<double> turned;
        for (std::size_t i = 0; i < found.size(); ++i) {
          turned.push_back(degreesBetween(rotation * found[i], expected[i]));
        }
        best = std::min(best, medianOf(turned));
      }
    }
  }
  std::printf("median %.2f deg; after one common turn %.2f deg (bar: 1.00)\n", medianOf(errors),
              best);
  std::printf("in %d pictures lights.txt points beside the saturated spot\n\n", beside);
  return 0;
}

struct Setup {
  const char* name;
  double ballRadius;
  std::vector<Vector3d> balls;
  int sources;
  bool ruler;
};

// Waves a lamp, solves, and points at 400 other lamps: with two source cameras by triangulation,
// with one by its line of sight and the ball's, which stays at the subject.
void placeCameras(const Setup& setup, double highlightNoise) {
  const auto sceneModel = perspectiveCamera();
  const auto sourceModel = sourceFisheye();
  const CameraPose scene = sceneCameraPose();
  const std::vector<CameraPose> all{sourceCameraPose({0.1, 0.01, 0.02}, {0.2, -0.1, 0.3}),
                                    sourceCameraPose({-0.2, 0.03, 0}, {0.1, 0.2, -2})};
  std::vector<double> errors;
  double turn = 0;
  double shift = 0;
  double predicted = 0;
  const int runs = 5;
  for (unsigned seed = 1; seed <= runs; ++seed) {
    std::mt19937 random(seed);
    std::normal_distribution<double> normal;
    const auto measured = [&](const Vector2d& pixel, double sigma) {
      return PixelMeasurement{pixel + sigma * Vector2d(normal(random), normal(random)),
                              sigma * sigma * Matrix2d::Identity()};
    };
    const auto highlightOf = [&](const Vector3d& lamp, const Vector3d& centre) {
      const Vector3d point =
          fermatPoint(scene.sceneFromCamera.translation(), lamp, centre, setup.ballRadius);
      return measured(*sceneModel->projectPoint(scene.sceneFromCamera.inverse() * point),
                      highlightNoise);
    };
    BallSetup problem;
    problem.sceneCamera = {"scene", sceneModel.get()};
    problem.sceneCameraPose = scene;
    for (int k = 0; k < setup.sources; ++k) {
      problem.sourceCameras.push_back({"source" + std::to_string(k), sourceModel.get()});
      const double distance =
          (all[static_cast<std::size_t>(k)].sceneFromCamera.translation() - setup.balls[0]).norm();
      problem.sourceDistances.push_back(
          setup.ruler ? std::optional(MeasuredLength{distance + 0.002 * normal(random), 0.002})
                      : std::nullopt);
    }
    for (const auto& centre : setup.balls) {
      const Vector3d inCamera = scene.sceneFromCamera.inverse() * centre;
      const double sigma = 0.05 / 900;
      BallCone cone;
      cone.axis = inCamera.normalized();
      const Vector3d u = cone.axis.unitOrthogonal();
      cone.axis =
          (cone.axis + sigma * normal(random) * u + sigma * normal(random) * cone.axis.cross(u))
              .normalized();
      cone.angularRadius =
          Angle::radians(std::asin(setup.ballRadius / inCamera.norm()) + sigma * normal(random));
      cone.covariance = sigma * sigma * Matrix3d::Identity();
      problem.outlines.push_back(cone);
      problem.radiiMetres.push_back(setup.ballRadius);
    }
    std::vector<BallMoment> moments;
    while (moments.size() < 240) {  // 20 seconds at 12 frames a second
      const Vector3d lamp = randomLamp(random);
      BallMoment moment;
      for (const auto& centre : setup.balls) moment.highlights.push_back(highlightOf(lamp, centre));
      for (int k = 0; k < setup.sources; ++k) {
        const auto pixel = sourceModel->projectPoint(
            all[static_cast<std::size_t>(k)].sceneFromCamera.inverse() * lamp);
        moment.lamps.push_back(pixel ? std::optional(measured(*pixel, 0.1)) : std::nullopt);
      }
      moments.push_back(moment);
    }
    const auto found = poseFromMirrorBalls(problem, moments);
    if (!found) {
      std::printf("%s: %s\n", setup.name, found.error().message.c_str());
      return;
    }
    const auto& poses = found->pose.rig.sourceCameras;
    turn += Eigen::AngleAxisd(Matrix3d(poses[0].sceneFromCamera.linear() *
                                       all[0].sceneFromCamera.linear().transpose()))
                .angle() *
            180 / std::numbers::pi / runs;
    shift +=
        1000 *
        (poses[0].sceneFromCamera.translation() - all[0].sceneFromCamera.translation()).norm() /
        runs;
    predicted += 1000 * std::sqrt(poses[0].covariance.bottomRightCorner<3, 3>().trace()) / runs;
    for (int i = 0; i < 400; ++i) {
      const Vector3d lamp = randomLamp(random);
      std::vector<LampRay> rays;
      for (std::size_t k = 0; k < poses.size(); ++k) {
        const auto pixel = sourceModel->projectPoint(all[k].sceneFromCamera.inverse() * lamp);
        if (!pixel) continue;
        const auto noisy = measured(*pixel, 0.1);
        if (const auto ray = lampRay(poses[k], *sourceModel, noisy.pixel, noisy.covariance)) {
          rays.push_back(*ray);
        }
      }
      if (setup.sources == 1) {
        if (const auto ray = rayFromHighlight(scene, *sceneModel, found->balls[0],
                                              highlightOf(lamp, setup.balls[0]))) {
          rays.push_back(*ray);
        }
      }
      const auto position = triangulateLamp(rays);
      if (position) errors.push_back(degreesBetween(position->position, lamp));
    }
  }
  std::printf("%-52s %6.2f %7.1f %9.1f   %6.3f %6.3f\n", setup.name, turn, shift, predicted,
              medianOf(errors), percentile95(errors));
}

}  // namespace
}  // namespace lightsketch

int main() {
  using namespace lightsketch;
  if (chrome() != 0) return 1;
  std::printf(
      "Source camera 10 cm from the subject, lamps at 0.6 to 1.5 m, 240 moments, mean of 5 waves;\n"
      "scene camera 640 x 480, f = 900 pixels, 1 m away (a ball of 3 cm shows 27 pixels of "
      "radius)\n"
      "%-52s %6s %7s %9s   direction at subject\n%-52s %6s %7s %9s   %6s %6s\n",
      "", "turned", "shifted", "predicted", "", "deg", "mm", "mm", "median", "p95");
  placeCameras({"one ball of 3 cm, one source, ball stays", 0.03, {{0, 0, 0}}, 1, false}, 0.1);
  placeCameras({"  and the camera's distance by a ruler, 2 mm", 0.03, {{0, 0, 0}}, 1, true}, 0.1);
  placeCameras({"one ball of 3 cm, two sources", 0.03, {{0, 0, 0}}, 2, false}, 0.1);
  placeCameras({"  and their distances by a ruler, 2 mm", 0.03, {{0, 0, 0}}, 2, true}, 0.1);
  placeCameras({"two balls of 3 cm, 26 cm apart, two sources",
                0.03,
                {{-0.12, 0.05, 0}, {0.12, -0.05, 0.02}},
                2,
                false},
               0.1);
  placeCameras({"one ball of 6 cm, one source, ball stays, ruler", 0.06, {{0, 0, 0}}, 1, true},
               0.1);
  placeCameras({"one ball of 6 cm, two sources", 0.06, {{0, 0, 0}}, 2, false}, 0.1);
  std::printf("bar%61s   %6.3f %6.3f\n", "", 0.2, 0.5);
  return 0;
}
