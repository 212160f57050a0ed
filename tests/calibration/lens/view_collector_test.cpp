#include "calibration/lens/view_collector.h"

#include <gtest/gtest.h>

namespace lightsketch {
namespace {

TimePoint at(double seconds) { return TimePoint(fromSeconds(seconds)); }

BoardView board(double x, double y, int corners = 30) {
  BoardView view;
  for (int i = 0; i < corners; ++i) {
    view.corners.push_back({i % 6, i / 6, {x + 20 * (i % 6), y + 20 * (i / 6)}});
  }
  return view;
}

TEST(ViewCollector, KeepsABoardThatIsStillAndSomewhereNew) {
  ViewCollector collector(800);  // new means 20 pixels away
  EXPECT_EQ(collector.judge(board(100, 100), at(0)), ViewVerdict::kMoving);  // nobody knows yet
  EXPECT_EQ(collector.judge(board(103, 100), at(0.1)), ViewVerdict::kMoving);
  EXPECT_EQ(collector.judge(board(103.2, 100), at(0.2)), ViewVerdict::kKeep);
  collector.keep(board(103.2, 100));
  EXPECT_EQ(collector.judge(board(103.3, 100), at(0.3)), ViewVerdict::kNotNew);
  EXPECT_EQ(collector.judge({}, at(0.4)), ViewVerdict::kNoBoard);
  EXPECT_EQ(collector.judge(board(130, 100), at(0.5)), ViewVerdict::kMoving);
  EXPECT_EQ(collector.judge(board(130, 100), at(0.6)), ViewVerdict::kKeep);
  // Pictures three seconds apart do not tell whether it moved in between.
  EXPECT_EQ(collector.judge(board(130, 100), at(3.6)), ViewVerdict::kMoving);
}

TEST(ViewCollector, TakesAnotherPartOfTheBoardForNew) {
  ViewCollector collector(800);
  collector.keep(board(100, 100, 12));  // the first two rows
  BoardView rest = board(100, 100);
  rest.corners.erase(rest.corners.begin(), rest.corners.begin() + 12);
  collector.judge(rest, at(0));
  EXPECT_EQ(collector.judge(rest, at(0.1)), ViewVerdict::kKeep);
}

}  // namespace
}  // namespace lightsketch
