#include "pipeline/job/machine_limits.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <functional>
#include <vector>

#include "tests/capture/frame/temporary_folder.h"

namespace lightsketch {
namespace {

// Whatever else runs beside it, the best of many runs does not vary by more than this.
void expectSteady(const std::function<double()>& measure) {
  const double once = measure();
  const double again = measure();
  EXPECT_GT(once, 0);
  EXPECT_LT(std::max(once, again), 3 * std::min(once, again));
}

TEST(MachineLimits, ReadBandwidthIsSteady) { expectSteady(readBandwidth); }

TEST(MachineLimits, ReadBandwidthIsOfMemoryNotOfThePageOfZeros) {
  // No main memory of today reads 10 TB/s; a page in the cache, or sums that were optimised away,
  // would.
  EXPECT_LT(readBandwidth(), 1e13);
  EXPECT_GT(readBandwidth(), 1e9);
}

TEST(MachineLimits, FmaPeakIsSteady) { expectSteady(fmaPeak); }

TEST(MachineLimits, FmaPeakIsAboveOneScalarOperationACycle) {
  // Any processor with four-float vectors is far above 2 GFLOP/s; loops that were optimised away
  // would claim more than a thousand times what 64 cores of the largest vectors reach.
  const double peak = fmaPeak();
  EXPECT_GT(peak, 2e9);
  EXPECT_LT(peak, 1e16);
}

TEST(MachineLimits, AWarmFileIsReadAtRatesOfMemory) {
  const TemporaryFolder folder;
  const auto path = folder.path() / "bytes";
  std::ofstream(path, std::ios::binary) << std::string(std::size_t{5} << 20, 'x');
  const auto rate = warmFileRead(path);
  ASSERT_TRUE(rate.has_value()) << rate.error().message;
  EXPECT_GT(rate->oneThread, 1e8);  // a tenth of what the slowest machines copy
  EXPECT_GT(rate->allThreads, 1e8);
}

TEST(MachineLimits, AFileThatIsNotThereIsNamed) {
  const auto rate = warmFileRead("/nowhere/model.lsd");
  ASSERT_FALSE(rate.has_value());
  EXPECT_NE(rate.error().message.find("/nowhere/model.lsd"), std::string::npos);
}

}  // namespace
}  // namespace lightsketch
