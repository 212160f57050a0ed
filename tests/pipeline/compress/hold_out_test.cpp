#include "pipeline/compress/hold_out.h"

#include <gtest/gtest.h>

#include <fstream>

#include "tests/pipeline/compress/test_sketch.h"

namespace lightsketch {
namespace {

using testing::freshFolder;
using testing::makeSketch;
using testing::randomLights;

Sketch smallSketch(int count) {
  return makeSketch(freshFolder("sketch"), 2, 2, randomLights(count, 1),
                    [](const Eigen::Vector3d&) { return RadianceImage(2, 2, 3, 0.5f); });
}

TEST(HoldOut, EveryPicksByIdWhateverWasDropped) {
  auto sketch = smallSketch(30);
  const auto before = applyHoldOut(sketch, "every:8:4");
  ASSERT_TRUE(before);
  EXPECT_EQ(before->heldOut, (std::vector<int>{4, 12, 20, 28}));
  EXPECT_EQ(before->training.size(), 26u);
  ASSERT_TRUE(sketch.drop(2, "test"));
  ASSERT_TRUE(sketch.drop(12, "test"));
  const auto after = applyHoldOut(sketch, "every:8:4");
  EXPECT_EQ(after->heldOut, (std::vector<int>{4, 20, 28}));
  EXPECT_EQ(after->training.size(), 25u);
  EXPECT_EQ(after->rule, "every:8:4");
}

TEST(HoldOut, NothingIsHeldOutWithoutARule) {
  const auto sketch = smallSketch(5);
  const auto split = applyHoldOut(sketch, "");
  ASSERT_TRUE(split);
  EXPECT_EQ(split->training.size(), 5u);
  EXPECT_TRUE(split->heldOut.empty());
}

TEST(HoldOut, CellsKeepNearTwinsApart) {
  const auto sketch = smallSketch(800);
  const auto split = applyHoldOut(sketch, "cells:8:4");
  ASSERT_TRUE(split) << split.error().message;
  EXPECT_EQ(split->heldOut.size() + split->training.size() + split->margin.size(), 800u);
  EXPECT_GT(split->heldOut.size(), 800u / 16);
  EXPECT_LT(split->heldOut.size(), 800u / 4);
  EXPECT_GT(split->training.size(), 800u / 2);
  const auto closest = [&](const std::vector<int>& some) {
    double best = 9;
    for (const int a : split->heldOut) {
      for (const int b : some) {
        best = std::min(best, (sketch.frames()[static_cast<std::size_t>(a)].light.direction -
                               sketch.frames()[static_cast<std::size_t>(b)].light.direction)
                                  .norm());
      }
    }
    return best;
  };
  // 100 cells are 0.27 apart; a sixth of that, less what bisectors that meet at an angle give away.
  EXPECT_GT(closest(split->training), 0.03);
  EXPECT_LT(closest(split->margin), 0.03);
}

TEST(HoldOut, ListsAreFrameIdsALine) {
  const auto sketch = smallSketch(6);
  const auto file = freshFolder("list.txt");
  std::ofstream(file) << " 3\r\n\n5\n3\n";
  const auto split = applyHoldOut(sketch, "list:" + file.string());
  ASSERT_TRUE(split) << split.error().message;
  EXPECT_EQ(split->heldOut, (std::vector<int>{3, 5}));
  EXPECT_EQ(split->training, (std::vector<int>{0, 1, 2, 4}));
  std::ofstream(file) << "3\n6\n";
  const auto beyond = applyHoldOut(sketch, "list:" + file.string());
  ASSERT_FALSE(beyond);
  EXPECT_NE(beyond.error().message.find("line 2"), std::string::npos);
  EXPECT_FALSE(applyHoldOut(sketch, "list:/nowhere"));
}

TEST(HoldOut, RefusesNonsense) {
  const auto sketch = smallSketch(6);
  for (const char* rule : {"every", "every:8", "every:8:8", "every:0:0", "every:1:0", "every:-8:4",
                           "every:8:4x", "all", "cells:8", "every:100:99"}) {
    EXPECT_FALSE(applyHoldOut(sketch, rule)) << rule;
  }
  EXPECT_FALSE(applyHoldOut(smallSketch(0), ""));
}

}  // namespace
}  // namespace lightsketch
