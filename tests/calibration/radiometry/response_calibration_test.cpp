#include "calibration/radiometry/response_calibration.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "calibration/radiometry/response_file.h"
#include "tests/calibration/radiometry/simulated_sensor.h"

namespace lightsketch {
namespace {

using Scene = SimulatedSensor::Scene;

std::vector<Frame> bracket(const SimulatedSensor& sensor, const Scene& scene, int first, int last,
                           int repeats = 1, int seed = 100) {
  std::vector<Frame> frames;
  for (int i = last; i >= first; --i) {  // longest first: any order will do
    for (int r = 0; r < repeats; ++r) {
      frames.push_back(
          sensor.expose(scene, std::pow(2.0, i), static_cast<unsigned>(seed + 10 * i + r)));
    }
  }
  return frames;
}

Scene decades(const SimulatedSensor& sensor) {
  return [sensor](int x, int y, int) { return fourDecades(sensor, x, y); };
}

std::string complaint(const std::vector<Frame>& frames) {
  const auto result = calibrateResponse({.brackets = {frames}, .darkFrames = {}, .flatFrames = {}});
  return result ? "accepted" : result.error().message;
}

// rms of ln(found / true), the best common factor taken off.
double rmsRelative(const ResponseCurve& curve, int colour, int low, int high,
                   const std::function<double(double)>& truth) {
  double mean = 0, square = 0;
  const double n = high - low + 1;
  for (int count = low; count <= high; ++count) {
    const double e = std::log(curve.exposure(count, colour) / truth(count));
    mean += e / n;
    square += e * e / n;
  }
  return std::sqrt(std::max(0.0, square - mean * mean));
}

TEST(ResponseCalibration, AnSrgbLikeCameraIsRecoveredToHalfAPercent) {
  SimulatedSensor sensor;
  sensor.prnu = 0.01;
  sensor.vignetting = 0.4;  // neither may matter: places are compared with themselves
  sensor.response = srgbSignal;
  const auto frames = bracket(sensor, decades(sensor), -4, 4);
  const auto result = calibrateResponse({.brackets = {frames}, .darkFrames = {}, .flatFrames = {}});
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_FALSE(result->summary.linear);
  EXPECT_FALSE(result->summary.timesEstimated);
  const auto truth = [](double count) { return srgbLight(count / 255); };
  for (int c = 0; c < 3; ++c) {
    const double error = rmsRelative(result->sensor.response, c, 20, 235, truth);
    EXPECT_LT(error, 0.005);  // the bar
    for (int count = 1; count < 256; ++count) {
      EXPECT_GT(result->sensor.response.exposure(count, c),
                result->sensor.response.exposure(count - 1, c));
    }
    // The predicted error is of the size of the true one. A single colour's rms stems from a few
    // correlated degrees of freedom, hence the wide band.
    EXPECT_LT(error, 4 * result->summary.colours[static_cast<std::size_t>(c)].curveSigma);
    EXPECT_GT(error, 0.25 * result->summary.colours[static_cast<std::size_t>(c)].curveSigma);
  }
}

TEST(ResponseCalibration, ASCurveThatIsNeitherLineNorGammaIsRecovered) {
  SimulatedSensor sensor;
  sensor.format = PixelFormat::kMono8;
  // A toe and a shoulder: smoothstep mixed with a root.
  const auto forward = [](double e) {
    const double r = std::sqrt(e);
    return 0.5 * r + 0.5 * r * r * (3 - 2 * r);
  };
  sensor.response = forward;
  const auto frames = bracket(sensor, decades(sensor), -4, 4);
  const auto result = calibrateResponse({.brackets = {frames}, .darkFrames = {}, .flatFrames = {}});
  ASSERT_TRUE(result) << result.error().message;
  const auto truth = [&](double count) {
    double low = 0, high = 1;
    for (int i = 0; i < 60; ++i) {
      const double middle = 0.5 * (low + high);
      (forward(middle) < count / 255 ? low : high) = middle;
    }
    return low;
  };
  EXPECT_LT(rmsRelative(result->sensor.response, 0, 20, 235, truth), 0.01);
}

TEST(ResponseCalibration, ALinearSensorIsFoundLinearWithItsBlackNoiseHotPixelsAndVignetting) {
  SimulatedSensor sensor;
  sensor.format = PixelFormat::kBayerRG12;
  sensor.width = 160;
  sensor.height = 120;
  sensor.pedestal = 64;
  sensor.fullWell = 10'500;
  sensor.readNoise = 14;
  sensor.prnu = 0.01;
  sensor.hotShare = 2e-3;
  sensor.vignetting = 0.5;
  const Scene colourful = [&](int x, int y, int c) {
    return fourDecades(sensor, x, y) * (1 - 0.25 * c);
  };
  const auto frames = bracket(sensor, colourful, -4, 4, 2);
  std::vector<Frame> dark, flat;
  for (unsigned i = 0; i < 8; ++i) {
    dark.push_back(sensor.expose([](int, int, int) { return 0.0; }, 1, 500 + i));
    flat.push_back(sensor.expose([](int, int, int) { return 0.7; }, 1, 600 + i));
  }
  const auto result =
      calibrateResponse({.brackets = {frames}, .darkFrames = dark, .flatFrames = flat});
  ASSERT_TRUE(result) << result.error().message;
  const SensorModel& model = result->sensor;
  EXPECT_TRUE(result->summary.linear);
  EXPECT_TRUE(result->summary.noiseFromPairs);
  for (int c = 0; c < 3; ++c) {
    const auto& colour = result->summary.colours[static_cast<std::size_t>(c)];
    EXPECT_LT(colour.linearDeviation, 0.005);
    EXPECT_NEAR(model.response.blackCount(c), 64, 0.3);
    // Three predicted sigmas, which must themselves be useful.
    const ChannelNoise& noise = model.noise.channel(c);
    EXPECT_NEAR(noise.electronsAtSaturation, sensor.fullWell, 3.5 * colour.electronsSigma);
    EXPECT_LT(colour.electronsSigma, 0.03 * sensor.fullWell);
    EXPECT_NEAR(noise.readNoiseElectrons, sensor.readNoise, 0.5);
  }
  int found = 0, hot = 0;
  for (int y = 0; y < sensor.height; ++y) {
    for (int x = 0; x < sensor.width; ++x) hot += sensor.hot(x, y);
  }
  for (const PixelPosition& pixel : model.hotPixels) found += sensor.hot(pixel.x, pixel.y);
  ASSERT_GT(hot, 10);
  EXPECT_EQ(found, hot);
  EXPECT_LE(static_cast<int>(model.hotPixels.size()),
            hot + 2);  // eight sigma: next to none by chance
  ASSERT_TRUE(model.flatField);
  for (const auto& [x, y] : {std::pair{80, 60}, {0, 0}, {159, 119}, {40, 60}, {80, 10}}) {
    const double u = (x + 0.5) / 160, v = (y + 0.5) / 120;
    // The picture is so small that a node rests on ten samples of 1 % scatter, in a corner on
    // three.
    EXPECT_NEAR(model.flatField->sensitivity(u, v, 1), sensor.sensitivity(x, y), 0.015);
  }
}

// Few places reach the upper half and none the top: the curve is free to bend there.
TEST(ResponseCalibration, ALineThatEndsShortOfSaturationIsALineAndASlightBendIsNone) {
  for (const double bow : {0.0, 0.25}) {
    SimulatedSensor sensor;
    sensor.format = PixelFormat::kMono12;
    sensor.width = 96;
    sensor.height = 96;
    sensor.pedestal = 64;
    sensor.fullWell = 2'000;
    if (bow > 0)
      sensor.response = [bow](double light) { return light + bow * light * (1 - light); };
    int nonlinear = 0;
    double largest = 0;
    for (int which = 0; which < 3; ++which) {
      const Scene dim = [&](int x, int y, int) {
        const double level = SimulatedSensor::fixedPattern(x / 4, y / 4, which);
        return 0.056 * std::pow(level, 10);
      };
      const auto frames = bracket(sensor, dim, -4, 4, 2, 1000 * which + 100);
      const auto result =
          calibrateResponse({.brackets = {frames}, .darkFrames = {}, .flatFrames = {}});
      ASSERT_TRUE(result) << result.error().message;
      nonlinear += !result->summary.linear;
      largest = std::max(largest, result->summary.colours[0].linearDeviation);
    }
    EXPECT_EQ(nonlinear, bow > 0 ? 3 : 0) << "deviation up to " << largest;
  }
}

TEST(ResponseCalibration, BlackIsFoundWithoutDarkFrames) {
  SimulatedSensor sensor;
  sensor.format = PixelFormat::kMono12;
  sensor.pedestal = 200;
  const auto frames = bracket(sensor, decades(sensor), -4, 4);
  const auto result = calibrateResponse({.brackets = {frames}, .darkFrames = {}, .flatFrames = {}});
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_TRUE(result->summary.linear);
  EXPECT_NEAR(result->sensor.response.blackCount(0), 200, 0.5);
}

TEST(ResponseCalibration, ASensorThatStopsShortOfItsFormatSaturatesThere) {
  SimulatedSensor sensor;
  sensor.format = PixelFormat::kMono12;
  sensor.pedestal = 64;
  auto frames = bracket(sensor, decades(sensor), -4, 4);
  for (Frame& frame : frames) {
    for (std::size_t i = 0; i < frame.bytes.size(); i += 2) {
      const int count = std::min(frame.bytes[i] | (frame.bytes[i + 1] << 8), 3900);
      frame.bytes[i] = static_cast<std::uint8_t>(count & 255);
      frame.bytes[i + 1] = static_cast<std::uint8_t>(count >> 8);
    }
  }
  const auto result = calibrateResponse({.brackets = {frames}, .darkFrames = {}, .flatFrames = {}});
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_EQ(result->sensor.response.saturationCount(), 3900);
  EXPECT_TRUE(result->summary.linear);
  EXPECT_NEAR(result->sensor.response.exposure(3900, 0), 1, 1e-12);
}

TEST(ResponseCalibration, WrongExposureTimesAreFound) {
  SimulatedSensor sensor;
  sensor.format = PixelFormat::kMono12;
  sensor.pedestal = 64;
  auto frames = bracket(sensor, decades(sensor), -4, 4);
  // The shutter was open 6 % longer than it says at two times that balance each other in the mean.
  for (Frame& frame : frames) {
    if (frame.metadata.exposureSeconds == 1) frame.metadata.exposureSeconds /= 1.06;
  }
  const auto result = calibrateResponse({.brackets = {frames}, .darkFrames = {}, .flatFrames = {}});
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_TRUE(result->summary.timesEstimated);
  double wrong = 0, others = 0;
  for (const auto& exposure : result->summary.exposures) {
    const bool isWrong = std::abs(exposure.seconds - 1 / 1.06) < 1e-6;
    (isWrong ? wrong : others) += exposure.timeError / (isWrong ? 1 : 8);
  }
  EXPECT_NEAR(wrong - others, 0.06, 0.005);
}

TEST(ResponseCalibration, TwoBracketsServeTogether) {
  SimulatedSensor sensor;
  sensor.format = PixelFormat::kMono8;
  sensor.response = srgbSignal;
  const auto first = bracket(sensor, decades(sensor), -4, 0);
  const auto second = bracket(
      sensor, [&](int x, int y, int) { return fourDecades(sensor, y, x); }, -2, 4);
  const auto result =
      calibrateResponse({.brackets = {first, second}, .darkFrames = {}, .flatFrames = {}});
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_LT(rmsRelative(result->sensor.response, 0, 20, 235,
                        [](double count) { return srgbLight(count / 255); }),
            0.005);
  EXPECT_EQ(result->summary.exposures.size(), first.size() + second.size());
}

TEST(ResponseCalibration, SaysWhatIsWrongWithABadBracket) {
  SimulatedSensor sensor;
  sensor.format = PixelFormat::kMono8;
  const Scene scene = decades(sensor);
  EXPECT_NE(complaint(bracket(sensor, scene, 0, 0, 3)).find("one exposure time only"),
            std::string::npos);
  EXPECT_NE(complaint(bracket(
                          sensor, [](int, int, int) { return 100.0; }, -4, 4))
                .find("saturated"),
            std::string::npos);
  EXPECT_NE(complaint(bracket(
                          sensor, [](int, int, int) { return 0.0; }, -4, 4))
                .find("as dark as"),
            std::string::npos);
  EXPECT_NE(complaint({}).find("no bracket"), std::string::npos);

  auto frames = bracket(sensor, scene, -4, 4);
  SimulatedSensor smaller = sensor;
  smaller.width = 100;
  frames[3] = smaller.expose(scene, frames[3].metadata.exposureSeconds, 1);
  EXPECT_NE(complaint(frames).find("frame 4: 100 x 192"), std::string::npos);

  frames = bracket(sensor, scene, -4, 4);
  frames[2].metadata.exposureSeconds = 0;
  EXPECT_NE(complaint(frames).find("exposure time is unknown"), std::string::npos);
  frames = bracket(sensor, scene, -4, 4);
  frames[2].metadata.gainDb = 6;
  EXPECT_NE(complaint(frames).find("keep the gain"), std::string::npos);

  // One flat grey: every place says the same.
  const auto flat = bracket(
      sensor, [](int, int, int) { return 0.3; }, 0, 5);
  EXPECT_NE(complaint(flat).find("too few"), std::string::npos) << complaint(flat);
}

TEST(ResponseCalibration, ASceneThatMovedIsRefused) {
  SimulatedSensor sensor;
  sensor.format = PixelFormat::kMono8;
  const auto textured = [](int x, int y) {
    return std::pow(10.0, -1.2 + 1.2 * std::sin(0.31 * x) * std::cos(0.23 * y));
  };
  std::vector<Frame> still, moved;
  for (int i = -4; i <= 4; ++i) {
    const auto seed = static_cast<unsigned>(i + 50);
    still.push_back(
        sensor.expose([&](int x, int y, int) { return textured(x, y); }, std::pow(2.0, i), seed));
    moved.push_back(sensor.expose([&](int x, int y, int) { return textured(x + 4 * i, y); },
                                  std::pow(2.0, i), seed));
  }
  EXPECT_EQ(complaint(still), "accepted");
  EXPECT_NE(complaint(moved).find("moved"), std::string::npos) << complaint(moved);
}

TEST(ResponseCalibration, TheMemorialBracketGivesAMonotoneCurve) {
  const std::filesystem::path folder =
      std::filesystem::path(LIGHTSKETCH_SOURCE_DIR) / "../shared/data/hdr/memorial";
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << folder << " is not here";
  const auto frames = readBracketFolder(folder);
  ASSERT_TRUE(frames) << frames.error().message;
  ASSERT_EQ(frames->size(), 16u);
  EXPECT_DOUBLE_EQ(frames->front().metadata.exposureSeconds, 32);
  EXPECT_DOUBLE_EQ(frames->back().metadata.exposureSeconds, 1.0 / 1024);
  const auto result =
      calibrateResponse({.brackets = {*frames}, .darkFrames = {}, .flatFrames = {}});
  ASSERT_TRUE(result) << result.error().message;
  EXPECT_FALSE(result->summary.linear);
  for (int c = 0; c < 3; ++c) {
    for (int count = 1; count < 256; ++count) {
      ASSERT_GT(result->sensor.response.exposure(count, c),
                result->sensor.response.exposure(count - 1, c));
    }
    // Scanned film: its base reads as 13 to 20 counts where no light fell (the darkest pixels of
    // the shortest exposures).
    EXPECT_GT(result->sensor.response.blackCount(c), 10);
    EXPECT_LT(result->sensor.response.blackCount(c), 20);
  }
}

}  // namespace
}  // namespace lightsketch
