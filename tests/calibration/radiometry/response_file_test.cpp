#include "calibration/radiometry/response_file.h"

#include <gtest/gtest.h>

#include <fstream>

#include "capture/frame/file.h"
#include "pipeline/sketch/image_file.h"
#include "tests/calibration/radiometry/simulated_sensor.h"
#include "tests/capture/frame/temporary_folder.h"

namespace lightsketch {
namespace {

ResponseCalibration sample() {
  ResponseCalibration calibration;
  SensorModel& sensor = calibration.sensor;
  sensor.format = PixelFormat::kBayerRG12;
  sensor.width = 20;
  sensor.height = 18;
  sensor.response = ResponseCurve::linear({64, 65, 66.5}, 4095, 4000).value();
  sensor.noise.gainDb = 6;
  sensor.noise.channels = {{10'500, 4}, {10'400, 4.5}, {9'000, 5}};
  sensor.hotPixels = {{3, 4}, {19, 17}};
  sensor.darkCounts = Image<float>(20, 18, 1, 64);
  sensor.darkCounts(3, 4) = 2000.25f;
  sensor.darkCounts(5, 5) = 63.5f;
  sensor.darkExposureSeconds = 0.5;
  sensor.flatField = FlatField::create(2, 2, 3, std::vector<double>(12, 0.5)).value();
  calibration.summary.colours.resize(3);
  calibration.summary.colours[0].name = "red";
  calibration.summary.flatFrames = 1;
  calibration.summary.darkFrames = 1;
  return calibration;
}

TEST(ResponseFile, RoundTrip) {
  const TemporaryFolder folder;
  const ResponseCalibration calibration = sample();
  ASSERT_TRUE(saveResponse(calibration, folder / "camera.json"));
  const auto loaded = loadResponse(folder / "camera.json");
  ASSERT_TRUE(loaded) << loaded.error().message;
  const SensorModel& sensor = calibration.sensor;
  EXPECT_EQ(loaded->format, sensor.format);
  EXPECT_EQ(loaded->width, 20);
  EXPECT_EQ(loaded->response.saturationCount(), 4000);
  EXPECT_TRUE(loaded->response.isLinear());
  for (int c = 0; c < 3; ++c) {
    EXPECT_DOUBLE_EQ(loaded->response.exposure(777, c), sensor.response.exposure(777, c));
    EXPECT_EQ(loaded->noise.channel(c).readNoiseElectrons,
              sensor.noise.channel(c).readNoiseElectrons);
  }
  EXPECT_EQ(loaded->hotPixels, sensor.hotPixels);
  EXPECT_EQ(loaded->flatField->node(1, 1, 2), 1);  // scaled to its peak
  ASSERT_TRUE(loaded->darkCounts.sameShape(sensor.darkCounts));
  // 16 bits over 1937 counts: half a step is 0.015.
  for (std::size_t i = 0; i < sensor.darkCounts.size(); ++i) {
    EXPECT_NEAR(loaded->darkCounts.values()[i], sensor.darkCounts.values()[i], 0.016);
  }
}

TEST(ResponseFile, RefusesAForeignDarkFrameAndDamage) {
  const TemporaryFolder folder;
  ASSERT_TRUE(saveResponse(sample(), folder / "camera.json"));
  const Json good = readJsonFile(folder / "camera.json").value();
  const auto complaint = [&](const Json& json) {
    EXPECT_TRUE(writeJsonFile(folder / "camera.json", json));
    const auto loaded = loadResponse(folder / "camera.json");
    return loaded ? std::string("accepted") : loaded.error().message;
  };
  ASSERT_EQ(complaint(good), "accepted");
  Json json = good;
  json["dark"]["file"] = "../camera.dark.png";
  EXPECT_NE(complaint(json).find("not beside it"), std::string::npos);
  json = good;
  json["response"]["exposure"][1] = {0.5, 0.2};
  EXPECT_NE(complaint(json).find("does not rise"), std::string::npos);
  json = good;
  json["noise"]["channels"][0]["electronsAtSaturation"] = -1;
  EXPECT_NE(complaint(json).find("electrons"), std::string::npos);
  json = good;
  json["hotPixels"][0] = {20, 3};
  EXPECT_NE(complaint(json).find("outside the picture"), std::string::npos);
  json = good;
  json["formatVersion"] = 99;
  EXPECT_NE(complaint(json).find("newer"), std::string::npos);
  json = good;
  json["flatField"]["sensitivity"].erase(0);
  EXPECT_NE(complaint(json).find("sensitivity"), std::string::npos);
  ASSERT_TRUE(writePng(folder / "camera.dark.png", Image<std::uint16_t>(20, 18, 1, 64)));
  EXPECT_NE(complaint(good).find("not the dark frame"), std::string::npos);
}

TEST(BracketFolder, ReadsRawCountsAndTimesByOrderOrByName) {
  const TemporaryFolder folder;
  for (int i = 0; i < 3; ++i) {
    ASSERT_TRUE(writePng(folder / fmt::format("b{}.png", i),
                         Image<std::uint8_t>(4, 3, 3, static_cast<std::uint8_t>(10 * i + 7))));
  }
  const auto times = [&](std::string_view text) {
    EXPECT_TRUE(writeFileAtomically(folder / "times.txt", text));
    return readBracketFolder(folder.path());
  };
  auto frames = times("# seconds\n2\n1/4\n0.125\n\n");
  ASSERT_TRUE(frames) << frames.error().message;
  ASSERT_EQ(frames->size(), 3u);
  EXPECT_EQ((*frames)[1].metadata.exposureSeconds, 0.25);
  EXPECT_EQ((*frames)[2].format, PixelFormat::kRgb8);
  EXPECT_EQ((*frames)[2].sample(3, 2, 1), 27u);
  frames = times("b2.png 1\nb0.png 4\nb1.png 2\n");
  ASSERT_TRUE(frames) << frames.error().message;
  EXPECT_EQ((*frames)[0].metadata.exposureSeconds, 4);

  EXPECT_NE(times("1\n2\n").error().message.find("2 exposure times for 3 pictures"),
            std::string::npos);
  EXPECT_NE(times("1\nfast\n2\n").error().message.find("line 2"), std::string::npos);
  EXPECT_NE(times("1\n1/0\n2\n").error().message.find("line 2"), std::string::npos);
  EXPECT_NE(times("b0.png 1\nb1.png 2\nb9.png 3\n").error().message.find("b2.png"),
            std::string::npos);
  std::ofstream(folder / "b1.png") << "not a picture";
  EXPECT_NE(times("1\n2\n3\n").error().message.find("b1.png"), std::string::npos);
}

TEST(ResponseReport, StandsAloneAndShowsEverySection) {
  const TemporaryFolder folder;
  ASSERT_TRUE(writeResponseReport(sample(), folder / "report"));
  const std::string page = readFile(folder / "report" / "index.html").value();
  for (const char* section : {"Response", "Residuals", "Photon transfer", "Hot pixels: 2",
                              "Flat field", "Exposures", "10500"}) {
    EXPECT_NE(page.find(section), std::string::npos) << section;
  }
  EXPECT_EQ(page.find("http"), std::string::npos);  // nothing from outside
  EXPECT_EQ(page.find("nan"), std::string::npos);
  EXPECT_TRUE(readJsonFile(folder / "report" / "report.json"));
}

}  // namespace
}  // namespace lightsketch
