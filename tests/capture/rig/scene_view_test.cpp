// The scene camera's pictures against what optics and the sensor's data sheet say.
#include "capture/rig/scene_view.h"

#include <gtest/gtest.h>

#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>

namespace lightsketch {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

class HeldLamp final : public LampMotion {
 public:
  void advanceTo(double) override {}
  LampState at(double) const override { return state; }
  LampState state{true, 0, Vector3d(0, 0, 0.9)};
};

// A white matte table at z = 0 with one box of 20 mm x 20 mm x 30 mm in its middle.
constexpr double kBoxHeight = 0.03;
constexpr const char* kScene = R"({
  "format": "lightsketch-scene", "formatVersion": 1,
  "camera": {"position": [0, -0.25, 0.4], "lookAt": [0, 0, 0], "up": [0, 0, 1],
             "horizontalFieldDegrees": 24},
  "table": {"height": 0, "halfSize": 0.5, "material": "white"},
  "materials": {"white": {"texture": "plain", "first": [0.7, 0.7, 0.7], "second": [0.7, 0.7, 0.7],
                          "specular": [0, 0, 0], "roughness": 1}},
  "objects": [{"shape": "box", "material": "white", "size": [0.02, 0.02, 0.03], "bevel": 0.0001,
               "position": [0, 0, 0.015]}]})";

struct Bench {
  HeldLamp lamp;
  Room room;
  std::shared_ptr<const StillLife> stillLife;
  std::unique_ptr<SceneView> view;

  Bench() {
    const auto path = std::filesystem::temp_directory_path() /
                      ("lightsketch_scene_view_test_" + std::to_string(::getpid()) + ".json");
    std::ofstream(path) << kScene;
    auto loaded = StillLife::load(path);
    std::filesystem::remove(path);
    if (!loaded) throw std::runtime_error(loaded.error().message);
    stillLife = *loaded;
    view = std::make_unique<SceneView>(stillLife, room, lamp, 1);
  }

  // The pixel that a point falls on: the pinhole formula, written out again.
  Eigen::Vector2i pixelOf(const Vector3d& point) const {
    const Vector3d p = stillLife->sceneFromCamera().inverse() * point;
    const double focal = 320 / std::tan(12 * M_PI / 180);
    return Vector2d(320 + focal * p.x() / p.z(), 240 + focal * p.y() / p.z()).cast<int>();
  }
  // Light of the lamp alone at a point.
  double lampLightAt(const Vector3d& point) {
    const auto pixel = pixelOf(point);
    lamp.state.lit = false;
    const double dark = view->render(0, 0.02)(pixel.x(), pixel.y(), 1);
    lamp.state.lit = true;
    return view->render(0, 0.02)(pixel.x(), pixel.y(), 1) - dark;
  }
  std::vector<std::uint16_t> expose(PixelFormat format, double seconds, std::uint64_t index,
                                    double gainDb = 0) {
    ExposureRequest request;
    request.index = index;
    request.format = format;
    request.region = {0, 0, SceneView::kWidth, SceneView::kHeight};
    request.exposureSeconds = seconds;
    request.gainDb = gainDb;
    std::vector<std::uint8_t> bytes;
    view->expose(request, bytes);
    const int size = pixelFormatInfo(format).bytesPerPixel;
    std::vector<std::uint16_t> samples;
    if (format == PixelFormat::kRgb8) {
      samples.assign(bytes.begin(), bytes.end());
    } else {
      EXPECT_EQ(size, 2);
      samples.resize(bytes.size() / 2);
      std::memcpy(samples.data(), bytes.data(), bytes.size());
    }
    return samples;
  }
};

Bench& bench() {
  static Bench instance;
  return instance;
}

// An even piece of the table, in front of the box: even columns and rows.
constexpr int kLeft = 60, kRight = 260, kTop = 340, kBottom = 440;

TEST(SceneView, WhiteUnderTheLampHasTwoThirdsOfTheRange) {
  Bench& b = bench();
  const Vector3d point(-0.05, -0.03, 0);
  b.lamp.state.position = point + Vector3d(0, 0, 0.9);
  // Radiance albedo x (0.9 / d)^2 x cosine; the rest of the room sends some percent back, the
  // lamp's green is 0.965.
  const double direct = 0.7 * 0.965;
  const double light = b.lampLightAt(point);
  EXPECT_GT(light, direct);
  EXPECT_LT(light, 1.06 * direct);
  EXPECT_NEAR(SceneView::kSignalPerSecond * 0.02, 0.65, 1e-9);
}

TEST(SceneView, LightFallsOffWithTheSquareOfTheDistance) {
  Bench& b = bench();
  const Vector3d point(-0.05, -0.03, 0);
  b.lamp.state.position = point + Vector3d(0, 0, 0.6);
  const double near = b.lampLightAt(point);
  b.lamp.state.position = point + Vector3d(0, 0, 1.2);
  const double far = b.lampLightAt(point);
  // The pixel's centre is up to 0.2 mm off the point: 1e-6. Float rounding dominates.
  EXPECT_NEAR(near / far, 4.0, 0.01);
}

TEST(SceneView, LightFallsOffWithTheCosine) {
  Bench& b = bench();
  const Vector3d point(-0.05, -0.03, 0);
  b.lamp.state.position = point + Vector3d(0, 0, 0.9);
  const double above = b.lampLightAt(point);
  b.lamp.state.position = point + 0.9 * Vector3d(-std::sin(M_PI / 3), 0, std::cos(M_PI / 3));
  const double oblique = b.lampLightAt(point);
  // Half, and the light sent back by the room, which knows no cosine: 3 percent of `above`.
  EXPECT_NEAR(oblique / above, 0.5, 0.03);
}

TEST(SceneView, ShadowLiesWhereGeometryPutsIt) {
  Bench& b = bench();
  // Light from the left at 45 degrees: the box throws a shadow as long as it is high, to the right.
  b.lamp.state.position = Vector3d(-0.636, 0, 0.636);
  const double edge = 0.01;  // the box's right face
  // Lamp at finite distance: the top right edge (0.01, y, 0.03) is projected on the table.
  const Vector3d corner(edge, 0, kBoxHeight);
  const Vector3d ray = corner - b.lamp.state.position;
  const double end = corner.x() - ray.x() / ray.z() * kBoxHeight;
  const double lit = b.lampLightAt(Vector3d(end + 0.01, 0, 0));
  // The penumbra: lamp of 15 mm radius at 0.9 m, occluder 42 mm away: +-0.7 mm, stretched to 1 mm
  // by the slant.
  EXPECT_LT(b.lampLightAt(Vector3d(end - 0.002, 0, 0)), 0.12 * lit);
  EXPECT_LT(b.lampLightAt(Vector3d((edge + end) / 2, 0, 0)), 0.12 * lit);
  EXPECT_GT(b.lampLightAt(Vector3d(end + 0.002, 0, 0)), 0.9 * lit);
  // On the lamp's own side there is none.
  EXPECT_GT(b.lampLightAt(Vector3d(-0.025, 0, 0)), 0.9 * lit);
  // And in the middle of the penumbra about half.
  const double middle = b.lampLightAt(Vector3d(end, 0, 0));
  EXPECT_GT(middle, 0.2 * lit);
  EXPECT_LT(middle, 0.8 * lit);
}

TEST(SceneView, SignalIsLinearInExposureAndGain) {
  Bench& b = bench();
  b.lamp.state = {true, 0, Vector3d(0, -0.2, 0.87)};
  const auto meanAboveBlack = [&](double seconds, double gainDb) {
    const auto samples = b.expose(PixelFormat::kBayerRG12, seconds, 5, gainDb);
    double sum = 0;
    int count = 0;
    for (int y = kTop; y < kBottom; ++y) {
      for (int x = kLeft; x < kRight; ++x, ++count) {
        sum += samples[static_cast<std::size_t>(y * SceneView::kWidth + x)];
      }
    }
    return sum / count - blackLevelCounts(PixelFormat::kBayerRG12);
  };
  const double once = meanAboveBlack(0.005, 0);
  ASSERT_GT(once, 200);
  // The mean of 20,000 samples with 1.4 percent of noise is good to 0.01 percent.
  EXPECT_NEAR(meanAboveBlack(0.02, 0) / once, 4, 0.01);
  EXPECT_NEAR(meanAboveBlack(0.005, 20 * std::log10(3.0)) / once, 3, 0.01);
}

TEST(SceneView, NoiseIsPhotonsAndReadNoise) {
  Bench& b = bench();
  b.lamp.state = {true, 0, Vector3d(0, -0.2, 0.87)};
  for (const double seconds : {0.0002, 0.004, 0.02}) {
    const auto first = b.expose(PixelFormat::kBayerRG12, seconds, 1);
    const auto second = b.expose(PixelFormat::kBayerRG12, seconds, 2);
    double difference2 = 0, mean = 0;
    int count = 0;
    for (int y = kTop; y < kBottom; ++y) {
      for (int x = kLeft; x < kRight; ++x, ++count) {
        const auto i = static_cast<std::size_t>(y * SceneView::kWidth + x);
        difference2 += std::pow(static_cast<double>(first[i]) - second[i], 2);
        mean += 0.5 * (first[i] + second[i]);
      }
    }
    mean = mean / count - 64;
    // 10500 electrons fill 4031 counts; 4 electrons of read noise; 1/12 from quantisation.
    const double countsPerElectron = 4031.0 / 10500;
    const double expected =
        mean * countsPerElectron + 16 * countsPerElectron * countsPerElectron + 1 / 12.0;
    // A variance from 20,000 samples is good to 1 percent, one sigma.
    EXPECT_NEAR(difference2 / count / 2 / expected, 1, 0.04) << seconds;
  }
}

TEST(SceneView, BayerSamplesAreTheColoursOfTheirPlaces) {
  Bench& b = bench();
  b.lamp.state = {true, 0, Vector3d(0, -0.2, 0.87)};
  const auto bayer = b.expose(PixelFormat::kBayerRG16, 0.02, 9);
  const auto rgb = b.expose(PixelFormat::kRgb8, 0.02, 9);
  double red = 0, green = 0, blue = 0, rgbMean[3] = {};
  int count = 0;
  for (int y = kTop; y < kBottom; y += 2) {
    for (int x = kLeft; x < kRight; x += 2, ++count) {
      const auto i = static_cast<std::size_t>(y * SceneView::kWidth + x);
      red += bayer[i];
      green += 0.5 * (bayer[i + 1] + bayer[i + SceneView::kWidth]);
      blue += bayer[i + SceneView::kWidth + 1];
      for (std::size_t c = 0; c < 3; ++c) rgbMean[c] += rgb[3 * i + c];
    }
  }
  const auto fraction16 = [&](double sum) { return (sum / count - 1024) / (65535 - 1024); };
  const auto fraction8 = [&](double sum) { return (sum / count - 4) / (255 - 4); };
  // The lamp is warm: red > green > blue on white, and each the same in both formats. 5000 samples
  // of 1.4 percent noise; RGB8 is linear.
  EXPECT_NEAR(fraction16(green) / fraction16(red), 0.965, 0.005);
  EXPECT_NEAR(fraction16(blue) / fraction16(red), 0.89, 0.01);
  EXPECT_NEAR(fraction8(rgbMean[0]) / fraction16(red), 1, 0.005);
  EXPECT_NEAR(fraction8(rgbMean[1]) / fraction16(green), 1, 0.005);
  EXPECT_NEAR(fraction8(rgbMean[2]) / fraction16(blue), 1, 0.005);
}

TEST(SceneView, SaturatesAtTheTopAndReadsBlackInTheDark) {
  Bench& b = bench();
  b.lamp.state = {true, 0, Vector3d(0, -0.2, 0.87)};
  const auto place = static_cast<std::size_t>(kTop * SceneView::kWidth + kLeft);
  EXPECT_EQ(b.expose(PixelFormat::kBayerRG12, 0.5, 1)[place], 4095);
  EXPECT_EQ(b.expose(PixelFormat::kBayerRG16, 0.5, 1)[place], 65535);
  EXPECT_EQ(b.expose(PixelFormat::kRgb8, 0.5, 1)[3 * place], 255);
  EXPECT_EQ(b.expose(PixelFormat::kBayerRG12, 0.5, 1).size(), 640u * 480u);
  double sum = 0;
  const auto dark = b.expose(PixelFormat::kBayerRG12, 1e-9, 1);
  for (const auto v : dark) sum += v;
  EXPECT_NEAR(sum / static_cast<double>(dark.size()), 64, 0.1);
}

TEST(SceneView, NoiseComesFromTheSeedAndTheFrameNumber) {
  Bench& b = bench();
  const auto once = b.expose(PixelFormat::kBayerRG12, 0.01, 3);
  EXPECT_EQ(b.expose(PixelFormat::kBayerRG12, 0.01, 3), once);
  EXPECT_NE(b.expose(PixelFormat::kBayerRG12, 0.01, 4), once);
}

TEST(SceneView, RegionIsAPieceOfTheWhole) {
  Bench& b = bench();
  const auto whole = b.view->render(0, 0.01);
  ExposureRequest request;
  request.format = PixelFormat::kBayerRG12;
  request.region = {100, 200, 64, 32};
  request.exposureSeconds = 0.02;
  std::vector<std::uint8_t> bytes;
  b.view->expose(request, bytes);
  ASSERT_EQ(bytes.size(), 64u * 32u * 2u);
  std::uint16_t sample;
  std::memcpy(&sample, bytes.data() + 2 * (10 * 64 + 20), 2);
  // Red lies on even columns and rows of the sensor; noise is 70 counts at most here.
  const double expected = 64 + 4031 * 0.65 * whole(120, 210, 0);
  EXPECT_NEAR(sample, expected, 5 * std::sqrt(expected * 0.384) + 5);
}

TEST(StillLife, BuiltInSceneShowsItsObjectsAndFitsTheSample) {
  const auto builtIn = StillLife::load({});
  ASSERT_TRUE(builtIn) << builtIn.error().message;
  const auto fromFile =
      StillLife::load(std::filesystem::path(LIGHTSKETCH_SOURCE_DIR) / "samples/still_life.json");
  ASSERT_TRUE(fromFile) << fromFile.error().message;
  const Eigen::Vector3f eye = (*builtIn)->sceneFromCamera().translation().cast<float>();
  const Eigen::Vector3f orange(0.033f, 0.008f, -0.014f);
  const auto hit = (*builtIn)->hit(eye, orange - eye);
  const auto same = (*fromFile)->hit(eye, orange - eye);
  ASSERT_TRUE(hit && same);
  EXPECT_GT(hit->albedo.x(), 3 * hit->albedo.z());
  EXPECT_EQ(hit->position, same->position);
}

TEST(StillLife, RefusesDamagedScenesInWords) {
  const auto path = std::filesystem::temp_directory_path() /
                    ("lightsketch_still_life_test_" + std::to_string(::getpid()) + ".json");
  const auto messageFor = [&](std::string text) {
    std::ofstream(path) << text;
    const auto loaded = StillLife::load(path);
    return loaded ? std::string("loaded") : loaded.error().message;
  };
  const std::string good = kScene;
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string text = good;
    text.replace(text.find(from), from.size(), to);
    return messageFor(text);
  };
  EXPECT_EQ(messageFor(good), "loaded");
  EXPECT_NE(with("\"box\"", "\"teapot\"").find("object 1: unknown shape 'teapot'"),
            std::string::npos);
  EXPECT_NE(with("[0.02, 0.02, 0.03]", "[0.02, -1, 0.03]").find("'size'"), std::string::npos);
  EXPECT_NE(with("\"roughness\": 1", "\"roughness\": 40").find("'roughness'"), std::string::npos);
  EXPECT_NE(with("\"formatVersion\": 1", "\"formatVersion\": 9").find("newer"), std::string::npos);
  EXPECT_NE(with("[0, 0, 0], \"up\"", "[0, 0], \"up\"").find("'lookAt'"), std::string::npos);
  EXPECT_NE(messageFor(good.substr(0, 300)).find(path.string()), std::string::npos);
  std::filesystem::remove(path);
}

}  // namespace
}  // namespace lightsketch
