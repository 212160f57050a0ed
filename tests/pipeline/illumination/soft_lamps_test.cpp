#include "pipeline/illumination/soft_lamps.h"

#include <gtest/gtest.h>

#include <cmath>

#include "pipeline/illumination/light_grid.h"

namespace lightsketch {
namespace {

using Eigen::Vector3d;

struct Lights {
  explicit Lights(int count)
      : grid(*LightGrid::create(count)),
        interpolator(*DirectionInterpolator::create(grid.directions(), {.trendDegree = 1})),
        lamps(*SoftLamps::create(grid.directions(), interpolator)) {}
  LightGrid grid;
  DirectionInterpolator interpolator;
  SoftLamps lamps;
};

TEST(SoftLamps, WithoutSizeAreTheInterpolatorsLamps) {
  const Lights lights(300);
  const Vector3d direction = Vector3d(0.3, -0.2, 0.8).normalized();
  const DirectionalLamp point{direction, {1, 0.5, 2}};
  const DiscLamp disc{direction, {1, 0.5, 2}, Angle()};
  EXPECT_EQ(lights.lamps.intensitiesOf({&disc, 1}),
            intensitiesOf({&point, 1}, lights.interpolator));
}

TEST(SoftLamps, KeepTheirLightWhateverTheirSize) {
  const Lights lights(300);
  for (const Vector3d& direction :
       {Vector3d(0, 0, 1), Vector3d(0.6, 0, 0.8), Vector3d(0.98, 0.1, 0.17)}) {
    for (double radius = 0; radius <= 90; radius += 3) {
      const DiscLamp lamp{direction.normalized(), {1, 2, 3}, Angle::degrees(radius)};
      const auto intensities = lights.lamps.intensitiesOf({&lamp, 1});
      EXPECT_NEAR(intensities.col(0).sum(), 1, 1e-4) << radius;  // sums of floats
      EXPECT_NEAR(intensities.col(2).sum(), 3, 3e-4) << radius;
    }
  }
}

// A scene that is as bright as the light's direction is high along an axis: under a disc of radius
// r about d it is d (1 + cos r) / 2, the mean direction of a cap.
TEST(SoftLamps, LightALinearSceneAsTheCapDoes) {
  const Lights lights(1000);
  for (const Vector3d& direction : {Vector3d(0, 0, 1), Vector3d(0.5, 0.2, 0.8)}) {
    const Vector3d d = direction.normalized();
    for (const double radius : {1.0, 3.0, 6.0, 12.0, 25.0}) {
      const DiscLamp lamp{d, Vector3d::Ones(), Angle::degrees(radius)};
      const auto intensities = lights.lamps.intensitiesOf({&lamp, 1});
      Vector3d mean = Vector3d::Zero();
      for (Eigen::Index i = 0; i < intensities.rows(); ++i) {
        mean += intensities(i, 0) * lights.grid.directions()[static_cast<std::size_t>(i)];
      }
      const Vector3d expected = d * (1 + std::cos(Angle::degrees(radius).radians())) / 2;
      // Lights are 4.5 degrees apart; an eighth of that is what the lights at the rim may shift the
      // mean by.
      EXPECT_LT((mean - expected).norm(), 0.01) << radius << " about " << d.transpose();
    }
  }
}

TEST(SoftLamps, GrowAndMoveWithoutJumps) {
  const Lights lights(300);
  const auto of = [&](double azimuth, double radius) {
    const double a = Angle::degrees(azimuth).radians();
    const DiscLamp lamp{Vector3d(0.6 * std::cos(a), 0.6 * std::sin(a), 0.8), Vector3d::Ones(),
                        Angle::degrees(radius)};
    return lights.lamps.intensitiesOf({&lamp, 1});
  };
  // Lights are 8 degrees apart; a disc of 9 degrees holds some five of them, so one of them
  // that came or went at once would be 20 percent.
  for (double step = 0; step < 30; step += 0.02) {
    EXPECT_LT((of(0, step + 0.02) - of(0, step)).cwiseAbs().sum(), 0.03f) << step;
    EXPECT_LT((of(step + 0.02, 9) - of(step, 9)).cwiseAbs().sum(), 0.03f) << step;
  }
}

TEST(SoftLamps, AddUp) {
  const Lights lights(200);
  const DiscLamp lamps[] = {{Vector3d(0, 0, 1), {1, 0, 0}, Angle::degrees(20)},
                            {Vector3d(0.6, 0, 0.8), {0, 1, 0.5}, Angle()}};
  LightIntensities sum = lights.lamps.intensitiesOf({lamps, 1});
  lights.lamps.add(lamps[1], sum);
  EXPECT_EQ(lights.lamps.intensitiesOf(lamps), sum);
}

}  // namespace
}  // namespace lightsketch
