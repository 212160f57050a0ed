#include "capture/session/coverage.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

namespace lightsketch {
namespace {

double angleBetween(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

TEST(Coverage, CountsCellsNotFrames) {
  Coverage coverage(LightGrid::create(100).value());
  const Eigen::Vector3d d = coverage.grid().directions()[17];
  coverage.add(d);
  coverage.add((d + Eigen::Vector3d(1e-3, 0, 0)).normalized());
  EXPECT_EQ(coverage.capturedCount(), 1);
  EXPECT_DOUBLE_EQ(coverage.fraction(), 0.01);
  coverage.remove(d);
  EXPECT_TRUE(coverage.captured(17));
  coverage.remove(d);
  EXPECT_FALSE(coverage.captured(17));
  coverage.remove(d);  // more often than added: nothing happens
  EXPECT_EQ(coverage.capturedCount(), 0);
}

TEST(Coverage, AHemisphereEndsHalfASpacingBelowTheHorizon) {
  const Coverage coverage(LightGrid::create(200).value());
  const double half = coverage.grid().spacing().radians() / 2;
  EXPECT_TRUE(coverage.cellOf({std::cos(0.8 * half), 0, -std::sin(0.8 * half)}));
  EXPECT_FALSE(coverage.cellOf({std::cos(1.2 * half), 0, -std::sin(1.2 * half)}));
  const Coverage sphere(LightGrid::create(200, LightGrid::Domain::kSphere).value());
  EXPECT_TRUE(sphere.cellOf({0, 0, -1}));
}

TEST(Coverage, FollowingNextVisitsEveryCellOnAShortWay) {
  for (const int count : {64, 300, 1000}) {
    for (int start = 0; start < 5; ++start) {
      Coverage coverage(LightGrid::create(count).value());
      const double spacing = coverage.grid().spacing().radians();
      const double z = 0.05 + 0.2 * start, azimuth = 2.4 * start;
      Eigen::Vector3d here(std::sqrt(1 - z * z) * std::cos(azimuth),
                           std::sqrt(1 - z * z) * std::sin(azimuth), z);
      Eigen::Vector3d heading = Eigen::Vector3d::Zero();
      double length = 0;
      int steps = 0;
      while (const auto next = coverage.next(here, heading)) {
        ASSERT_FALSE(coverage.captured(*next));
        const Eigen::Vector3d there = coverage.grid().directions()[static_cast<std::size_t>(*next)];
        length += angleBetween(here, there);
        heading = there - here;
        here = there;
        coverage.add(there);
        ++steps;
      }
      EXPECT_EQ(steps, count);
      EXPECT_DOUBLE_EQ(coverage.fraction(), 1);
      // A way through n cells cannot be much shorter than n spacings; plain nearest neighbours need
      // 1.15 of it, ours 1.03.
      EXPECT_LT(length, 1.1 * count * spacing) << count << " from " << start;
    }
  }
}

TEST(Coverage, PostponedAndSkippedCellsComeLater) {
  Coverage coverage(LightGrid::create(100).value());
  const Eigen::Vector3d here = coverage.grid().directions()[40];
  const int first = coverage.next(here).value();
  EXPECT_EQ(first, 40);
  const int skip[] = {40};
  EXPECT_NE(coverage.next(here, Eigen::Vector3d::Zero(), skip), 40);
  coverage.postpone(40);
  EXPECT_NE(coverage.next(here), 40);
  for (int i = 0; i < 100; ++i) {
    if (i != 40) coverage.add(coverage.grid().directions()[static_cast<std::size_t>(i)]);
  }
  EXPECT_EQ(coverage.next(here), 40);
}

}  // namespace
}  // namespace lightsketch
