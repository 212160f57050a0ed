#include "pipeline/hdr/merge.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "tests/calibration/radiometry/simulated_sensor.h"

namespace lightsketch {
namespace {

std::vector<Frame> bracket(const SimulatedSensor& sensor, const SimulatedSensor::Scene& scene,
                           int first, int last, unsigned seed = 1) {
  std::vector<Frame> frames;
  for (int i = first; i <= last; ++i) {
    frames.push_back(
        sensor.expose(scene, std::pow(2.0, i), seed + static_cast<unsigned>(i - first)));
  }
  return frames;
}

std::shared_ptr<SensorModel> modelOf(const SimulatedSensor& sensor) {
  auto model = std::make_shared<SensorModel>();
  model->format = sensor.format;
  model->width = sensor.width;
  model->height = sensor.height;
  const auto colours = static_cast<std::size_t>(colourChannels(sensor.format));
  const double top = (1 << pixelFormatInfo(sensor.format).bits) - 1;
  model->response =
      ResponseCurve::linear(std::vector<double>(colours, sensor.pedestal), top, top).value();
  model->noise.channels = {{sensor.fullWell, sensor.readNoise}};
  return model;
}

TEST(Merge, FourDecadesOfAnSrgbCameraComeOutWithinTheBar) {
  SimulatedSensor sensor;
  sensor.response = srgbSignal;
  const auto frames = bracket(
      sensor, [&](int x, int y, int) { return fourDecades(sensor, x, y); }, -4, 4);
  auto model = modelOf(sensor);
  std::vector<double> table;
  for (int count = 0; count < 256; ++count) table.push_back(srgbLight(count / 255.0));
  model->response = ResponseCurve::tabulated({table, table, table}, 255, 255).value();
  const auto map = mergeExposures(frames, {.sensor = model, .referenceExposureSeconds = 1});
  ASSERT_TRUE(map) << map.error().message;
  double error = 0, bias = 0;
  for (int y = 0; y < sensor.height; ++y) {
    for (int x = 0; x < sensor.width; ++x) {
      const double relative = map->radiance(x, y, 1) / fourDecades(sensor, x, y) - 1;
      error += std::abs(relative);
      bias += relative;
    }
  }
  const double n = 192.0 * 192.0;
  EXPECT_LT(error / n, 0.025);           // the bar; no factor is taken off
  EXPECT_LT(std::abs(bias / n), 0.003);  // 0.013 / sqrt(n) is the noise's share: this is bias
  EXPECT_EQ(map->saturatedFraction, 0);
}

TEST(Merge, SigmaIsTheTrueScatter) {
  SimulatedSensor sensor;
  sensor.format = PixelFormat::kMono12;
  sensor.width = 64;
  sensor.height = 64;
  sensor.pedestal = 64;
  for (const double light : {0.003, 0.05, 0.9}) {
    const auto frames = bracket(
        sensor, [&](int, int, int) { return light; }, -3, 3);
    const auto map = mergeExposures(
        frames, {.sensor = modelOf(sensor), .referenceExposureSeconds = 1, .sigma = true});
    ASSERT_TRUE(map);
    double mean = 0, square = 0, predicted = 0;
    for (int y = 0; y < 64; ++y) {
      for (int x = 0; x < 64; ++x) {
        const double v = static_cast<double>(map->radiance(x, y, 0));
        mean += v / 4096;
        square += v * v / 4096;
        predicted += static_cast<double>(map->sigma(x, y)) / 4096;
      }
    }
    const double scatter = std::sqrt(square - mean * mean);
    EXPECT_NEAR(scatter / predicted, 1, 0.05);                    // 1 / sqrt(2 x 4096) is 1.1 %
    EXPECT_NEAR(mean, light, 4 * predicted / 64 + 1e-4 * light);  // unbiased
  }
}

TEST(Merge, IsNotWorseThanItsBestFrameAndBeatsTheSumOfCounts) {
  SimulatedSensor sensor;
  sensor.format = PixelFormat::kMono12;
  sensor.pedestal = 64;
  sensor.readNoise = 30;  // where the read noise matters the plain sum loses
  const auto truth = [&](int x, int y) { return fourDecades(sensor, x, y); };
  const auto frames = bracket(
      sensor, [&](int x, int y, int) { return truth(x, y); }, -4, 4);
  const auto map =
      mergeExposures(frames, {.sensor = modelOf(sensor), .referenceExposureSeconds = 1});
  ASSERT_TRUE(map);
  double merged = 0, summed = 0, best = 0;
  for (int y = 0; y < sensor.height; ++y) {
    for (int x = 0; x < sensor.width; ++x) {
      double counts = 0, time = 0, longest = 0;
      for (const Frame& frame : frames) {
        const double e = (frame.sample(x, y) - 64.0) / 4031;
        if (frame.sample(x, y) >= 4000) continue;
        counts += e;
        time += frame.metadata.exposureSeconds;
        longest = e / frame.metadata.exposureSeconds;
      }
      merged += std::pow(map->radiance(x, y, 0) / truth(x, y) - 1, 2);
      summed += std::pow(counts / time / truth(x, y) - 1, 2);
      best += std::pow(longest / truth(x, y) - 1, 2);
    }
  }
  EXPECT_LT(merged, summed);
  EXPECT_LT(merged, best);
}

TEST(Merge, WhatIsSaturatedEverywhereIsFlaggedAndSetToItsLowerBound) {
  SimulatedSensor sensor;
  sensor.format = PixelFormat::kMono8;
  sensor.width = 16;
  sensor.height = 16;
  const auto frames = bracket(
      sensor, [](int x, int, int) { return x < 8 ? 50.0 : 0.2; }, -2, 2);
  const auto map = mergeExposures(frames, {.referenceExposureSeconds = 1});
  ASSERT_TRUE(map);
  EXPECT_DOUBLE_EQ(map->saturatedFraction, 0.5);
  EXPECT_EQ(map->saturated(3, 3), 1);
  EXPECT_EQ(map->saturated(12, 3), 0);
  EXPECT_FLOAT_EQ(map->radiance(3, 3, 0), 4.0f);  // more than fills the well in a quarter second
  EXPECT_NEAR(map->radiance(12, 3, 2), 0.2, 0.02);
}

TEST(Merge, MosaicsAreMergedBeforeTheDemosaic) {
  SimulatedSensor sensor;
  sensor.format = PixelFormat::kBayerRG12;
  sensor.width = 48;
  sensor.height = 40;
  sensor.pedestal = 64;
  const double colour[3] = {0.4, 0.1, 0.02};
  const auto frames = bracket(
      sensor, [&](int, int, int c) { return colour[c]; }, -3, 5);
  const auto map =
      mergeExposures(frames, {.blackLevel = 64, .referenceExposureSeconds = 1, .sigma = true});
  ASSERT_TRUE(map);
  EXPECT_EQ(map->sigma.channels(), 1);
  double mean[3] = {0, 0, 0};
  for (int y = 0; y < 40; ++y) {
    for (int x = 0; x < 48; ++x) {
      for (int c = 0; c < 3; ++c) mean[c] += map->radiance(x, y, c) / (48.0 * 40.0);
    }
  }
  for (int c = 0; c < 3; ++c) EXPECT_NEAR(mean[c] / colour[c], 1, 0.003);
}

TEST(Merge, OneFrameIsWhatLineariseMakesOfIt) {
  SimulatedSensor sensor;
  sensor.format = PixelFormat::kBayerRG12;
  sensor.width = 32;
  sensor.height = 32;
  const auto frames = bracket(
      sensor, [](int x, int y, int) { return 0.01 * (x + y); }, 0, 0);
  const auto merged = mergeBracketFrames(frames, {.referenceExposureSeconds = 2});
  const auto plain = linearise(frames[0], {.referenceExposureSeconds = 2});
  ASSERT_TRUE(merged && plain);
  for (std::size_t i = 0; i < plain->radiance.size(); ++i) {
    EXPECT_NEAR(merged->radiance.values()[i], plain->radiance.values()[i], 1e-5);
  }
}

TEST(Merge, GainCountsLikeExposure) {
  SimulatedSensor sensor;
  sensor.format = PixelFormat::kMono16;
  sensor.width = 16;
  sensor.height = 16;
  auto frames = bracket(
      sensor, [](int, int, int) { return 0.1; }, 0, 1);
  frames[1].metadata.exposureSeconds = 1;
  frames[1].metadata.gainDb = 20 * std::log10(2.0);
  const auto map = mergeExposures(frames, {.referenceExposureSeconds = 1});
  ASSERT_TRUE(map);
  EXPECT_NEAR(map->radiance(5, 5, 0), 0.1, 0.01);
}

TEST(Merge, RefusesWhatDoesNotBelongTogether) {
  SimulatedSensor sensor;
  sensor.format = PixelFormat::kMono8;
  sensor.width = 16;
  sensor.height = 16;
  auto frames = bracket(
      sensor, [](int, int, int) { return 0.1; }, 0, 2);
  EXPECT_FALSE(mergeExposures({}));
  frames[1].metadata.exposureSeconds = 0;
  EXPECT_NE(mergeExposures(frames).error().message.find("exposure time"), std::string::npos);
  frames = bracket(
      sensor, [](int, int, int) { return 0.1; }, 0, 2);
  sensor.width = 20;
  frames[2] = sensor.expose([](int, int, int) { return 0.1; }, 4, 9);
  EXPECT_NE(mergeExposures(frames).error().message.find("20 x 16"), std::string::npos);
}

TEST(Linearise, ASensorModelTakesOutDarkVignettingAndHotPixels) {
  SimulatedSensor sensor;
  sensor.format = PixelFormat::kBayerRG12;
  sensor.width = 64;
  sensor.height = 48;
  sensor.pedestal = 64;
  sensor.vignetting = 0.5;
  sensor.hotShare = 5e-3;
  sensor.fullWell = 1e6;  // what is left must be the corrections' error, not noise
  auto model = modelOf(sensor);
  model->darkCounts = Image<float>(64, 48, 1, 64);
  std::vector<double> nodes;
  for (int c = 0; c < 3; ++c) {
    for (int j = 0; j < 25; ++j) {
      for (int i = 0; i < 33; ++i) {
        const double u = i / 32.0 - 0.5, v = j / 24.0 - 0.5;
        nodes.push_back(1 - 0.5 * (u * u + v * v) / 0.5);
      }
    }
  }
  model->flatField = FlatField::create(33, 25, 3, nodes).value();
  int hot = 0;
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 64; ++x) {
      if (!sensor.hot(x, y)) continue;
      model->hotPixels.push_back({x, y});
      ++hot;
    }
  }
  ASSERT_GT(hot, 5);
  const Frame frame = sensor.expose([](int, int, int) { return 0.5; }, 1, 1);
  const auto corrected = linearise(frame, {.sensor = model});
  ASSERT_TRUE(corrected) << corrected.error().message;
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 64; ++x) {
      // Photon noise is 0.0007 in the centre and 0.001 in the corners; four sigma, weights to 1.5.
      for (int c = 0; c < 3; ++c) ASSERT_NEAR(corrected->radiance(x, y, c), 0.5, 0.006) << x << y;
    }
  }
  // Each correction is needed.
  model->hotPixels.clear();
  const auto withHot = linearise(frame, {.sensor = model});
  const auto largest = *std::ranges::max_element(withHot->radiance.values());
  EXPECT_GT(largest, 0.55f);
  Frame other = frame;
  other.format = PixelFormat::kMono12;
  EXPECT_FALSE(linearise(other, {.sensor = model}));
}

}  // namespace
}  // namespace lightsketch
