#include "calibration/model/sensor_model.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace lightsketch {
namespace {

TEST(ResponseCurve, LinearIsBlackToSaturation) {
  const auto curve = ResponseCurve::linear({64, 60, 70}, 4095, 4000);
  ASSERT_TRUE(curve);
  EXPECT_TRUE(curve->isLinear());
  EXPECT_NEAR(curve->exposure(64, 0), 0, 1e-12);
  EXPECT_NEAR(curve->exposure(4000, 0), 1, 1e-12);
  EXPECT_NEAR(curve->exposure(50, 1), -10.0 / 3940, 1e-12);  // below black: negative, not clipped
  EXPECT_NEAR(curve->exposure(4095, 2), 4025.0 / 3930, 1e-12);
  EXPECT_NEAR(curve->slope(2000, 0), 1.0 / 3936, 1e-15);
  EXPECT_NEAR(curve->blackCount(2), 70, 1e-9);
}

TEST(ResponseCurve, CountInvertsExposureAlsoBeyondTheEnds) {
  std::vector<double> table;
  for (int i = 0; i < 256; ++i) table.push_back(std::pow((i + 5) / 260.0, 2.2));
  const auto curve = ResponseCurve::tabulated({table}, 255, 250);
  ASSERT_TRUE(curve);
  EXPECT_FALSE(curve->isLinear());
  EXPECT_NEAR(curve->exposure(250, 0), 1, 1e-12);
  for (const double count : {-3.0, 0.0, 0.4, 17.0, 128.5, 254.9, 255.0, 261.0}) {
    EXPECT_NEAR(curve->count(curve->exposure(count, 0), 0), count, 1e-9);
  }
}

TEST(ResponseCurve, RefusesWhatIsNoCurve) {
  EXPECT_FALSE(ResponseCurve::tabulated({{0, 0.5, 0.5, 1}}, 255, 255));
  EXPECT_FALSE(ResponseCurve::tabulated({{0, std::nan(""), 1}}, 255, 255));
  EXPECT_FALSE(ResponseCurve::tabulated({{0, 1}, {0, 1}}, 255, 255));
  EXPECT_FALSE(ResponseCurve::tabulated({{-2, -1}}, 255, 255));
  EXPECT_FALSE(ResponseCurve::linear({300}, 255, 255));
  EXPECT_FALSE(ResponseCurve::linear({0}, 255, 256));
}

TEST(NoiseModel, IsPoissonPlusReadPlusRounding) {
  NoiseModel noise;
  noise.channels = {{10'000, 20}};
  const auto curve = ResponseCurve::linear({0}, 1000, 1000).value();
  // Half the well: 5000 electrons scatter by their root, read-out adds 20, a count is 10 electrons.
  const double electrons2 = 5000 + 400 + 100.0 / 12;
  EXPECT_NEAR(noise.countVariance(500, curve, 0), electrons2 / 100, 1e-9);
  EXPECT_NEAR(noise.countsPerElectron(curve, 0), 0.1, 1e-12);
  // Twice the amplification (6.02 dB): saturation is half the electrons.
  EXPECT_NEAR(noise.exposureVariance(0.5, 0, 0, 20 * std::log10(2.0)), (2500 + 400.0) / 5000 / 5000,
              1e-12);
}

TEST(FlatField, IsBilinearWithPeakOne) {
  std::vector<double> values;
  for (int j = 0; j < 3; ++j) {
    for (int i = 0; i < 5; ++i) values.push_back(2 * (1 - 0.1 * i - 0.05 * j));
  }
  const auto field = FlatField::create(5, 3, 1, values);
  ASSERT_TRUE(field);
  EXPECT_DOUBLE_EQ(field->node(0, 0, 0), 1);
  EXPECT_NEAR(field->sensitivity(0.3, 0.7, 0), 1 - 0.4 * 0.3 - 0.1 * 0.7, 1e-12);
  std::vector<float> row(10);
  field->sensitivityOfRow(0.25, 0, row);
  EXPECT_NEAR(row[9], 1 - 0.4 * 0.95 - 0.1 * 0.25, 1e-6);
  values[7] = 0;
  EXPECT_FALSE(FlatField::create(5, 3, 1, values));
  EXPECT_FALSE(FlatField::create(5, 4, 1, values));
}

TEST(SensorModel, SaysWhereAFrameIsAnotherCameras) {
  SensorModel sensor;
  sensor.format = PixelFormat::kBayerRG12;
  sensor.width = 640;
  sensor.height = 480;
  Frame frame;
  frame.format = PixelFormat::kBayerRG8;
  frame.width = 640;
  frame.height = 480;
  const auto fits = sensor.checkFits(frame);
  ASSERT_FALSE(fits);
  EXPECT_NE(fits.error().message.find("BayerRG8"), std::string::npos);
  EXPECT_NE(fits.error().message.find("calibrated for 640 x 480 BayerRG12"), std::string::npos);
}

}  // namespace
}  // namespace lightsketch
