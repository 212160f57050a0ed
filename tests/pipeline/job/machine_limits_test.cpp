#include "pipeline/job/machine_limits.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <string>

#include "tests/capture/frame/temporary_folder.h"

namespace lightsketch {
namespace {

// How fast is the machine's affair; a rate is a positive number on any.
void expectRate(double rate) {
  EXPECT_TRUE(std::isfinite(rate)) << rate;
  EXPECT_GT(rate, 0);
}

TEST(MachineLimits, MemoryAndMultiplyAddHaveARate) {
  expectRate(readBandwidth(LimitEffort::kQuick));
  expectRate(fmaPeak(LimitEffort::kQuick));
}

TEST(MachineLimits, AWarmFileIsReadAtARate) {
  const TemporaryFolder folder;
  const auto path = folder.path() / "bytes";
  std::ofstream(path, std::ios::binary) << std::string(std::size_t{5} << 20, 'x');
  const auto rate = warmFileRead(path, LimitEffort::kQuick);
  ASSERT_TRUE(rate.has_value()) << rate.error().message;
  expectRate(rate->oneThread);
  expectRate(rate->allThreads);
}

TEST(MachineLimits, AFileThatIsNotThereIsNamed) {
  const auto rate = warmFileRead("/nowhere/model.lsd");
  ASSERT_FALSE(rate.has_value());
  EXPECT_NE(rate.error().message.find("/nowhere/model.lsd"), std::string::npos);
}

}  // namespace
}  // namespace lightsketch
