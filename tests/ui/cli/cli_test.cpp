// The command line from the outside: what a script sees.
#include "tests/ui/cli/program_test.h"

#include <Eigen/Core>
#include <cmath>
#include <numbers>

#include "capture/frame/json.h"
#include "capture/frame/srgb.h"
#include "pipeline/sketch/image_file.h"

namespace lightsketch {
namespace {

class CommandLine : public ProgramTest {
 protected:
  // A matte bumpy plane under `count` lights, rendered here: 8-bit sRGB PNG and a .lp.
  void writeSet(const std::string& name, int count) const {
    fs::create_directories(path(name));
    std::ofstream lp(path(name) / "set.lp");
    lp << count << "\n";
    for (int i = 0; i < count; ++i) {
      const double z = 1 - (i + 0.5) / count * 0.9;
      const double angle = i * std::numbers::pi * (3 - std::sqrt(5.0));
      const Eigen::Vector3d light(std::sqrt(1 - z * z) * std::cos(angle),
                                  std::sqrt(1 - z * z) * std::sin(angle), z);
      RadianceImage image(40, 24, 3);
      for (int y = 0; y < 24; ++y) {
        for (int x = 0; x < 40; ++x) {
          const Eigen::Vector3d normal =
              Eigen::Vector3d(0.4 * std::sin(0.7 * x), 0.4 * std::cos(0.5 * y), 1).normalized();
          const double shading = std::max(0.0, normal.dot(light));
          for (int c = 0; c < 3; ++c)
            image(x, y, c) = static_cast<float>(shading * (0.9 - 0.2 * c));
        }
      }
      const std::string file = fmt::format("{:03}.png", i);
      ASSERT_TRUE(writePng(path(name) / file, image));
      lp << file << " " << light.x() << " " << light.y() << " " << light.z() << "\n";
    }
  }

  void importSet(const std::string& set, const std::string& sketch, int count = 64) const {
    writeSet(set, count);
    const auto outcome = run({"import", path(set), "--out", path(sketch), "--quiet"});
    ASSERT_EQ(outcome.exitCode, 0) << outcome.error;
  }
};

// --- The whole way ----------------------------------------------------------------------------

TEST_F(CommandLine, TakesASetFromImportToReport) {
  importSet("set", "sketch");
  ASSERT_EQ(run({"info", path("sketch")}).exitCode, 0);
  const auto compressed = run({"compress", path("sketch"), "--out", path("m.lsd"), "--hold-out",
                               "every:8:4", "--json", path("c.json"), "--quiet"});
  ASSERT_EQ(compressed.exitCode, 0) << compressed.error;
  ASSERT_EQ(run({"info", path("m.lsd")}).exitCode, 0);

  const auto relit =
      run({"relight", path("m.lsd"), "--light", "0.3,0.2,0.9", "--out", path("a.png")});
  ASSERT_EQ(relit.exitCode, 0) << relit.error;
  ASSERT_EQ(
      run({"relight", path("m.lsd"), "--light", "0,0,1", "--light=-1,0,1", "--out", path("b.exr")})
          .exitCode,
      0);
  RadianceImage sky(64, 32, 3, 1.0f);
  ASSERT_TRUE(writeExr(path("sky.exr"), sky));
  ASSERT_EQ(
      run({"relight", path("m.lsd"), "--environment", path("sky.exr"), "--out", path("c.exr")})
          .exitCode,
      0);

  // A model of square roots shows one lamp, and refuses to add.
  ASSERT_EQ(run({"compress", path("sketch"), "--single-lamp", "--hold-out", "every:8:4", "--out",
                 path("one.lsd"), "--quiet"})
                .exitCode,
            0);
  ASSERT_EQ(run({"relight", path("one.lsd"), "--light", "0.3,0.2,0.9", "--out", path("one.png")})
                .exitCode,
            0);
  expectRefusal(
      {"relight", path("one.lsd"), "--light", "0,0,1", "--light=-1,0,1", "--out", path("two.png")},
      "one.lsd: a single-lamp model");
  expectRefusal(
      {"relight", path("one.lsd"), "--environment", path("sky.exr"), "--out", path("two.png")},
      "one.lsd: a single-lamp model");
  const auto measured = run({"validate", path("sketch"), "--model", path("one.lsd"), "--report",
                             path("one-report"), "--quiet"});
  EXPECT_EQ(measured.exitCode, 0) << measured.error;

  // The relit picture is the analytic one: light (0.3, 0.2, 0.9) on the same bumps.
  const auto picture = readImage(path("a.png"));
  ASSERT_TRUE(picture);
  const Eigen::Vector3d light = Eigen::Vector3d(0.3, 0.2, 0.9).normalized();
  double squared = 0;
  for (int y = 0; y < 24; ++y) {
    for (int x = 0; x < 40; ++x) {
      const Eigen::Vector3d normal =
          Eigen::Vector3d(0.4 * std::sin(0.7 * x), 0.4 * std::cos(0.5 * y), 1).normalized();
      const double expected =
          srgbEncode(static_cast<float>(0.9 * std::max(0.0, normal.dot(light))));
      squared += std::pow(srgbEncode((*picture)(x, y, 0)) - expected, 2);
    }
  }
  // 40 dB: 1 percent rms; shading without shadows is smooth in the light, so interpolation is easy.
  EXPECT_GT(-10 * std::log10(squared / (24 * 40)), 40.0);

  const auto validated = run({"validate", path("sketch"), "--hold-out", "every:8:4", "--model",
                              path("m.lsd"), "--report", path("report"), "--json", path("v.json")});
  ASSERT_EQ(validated.exitCode, 0) << validated.error;
  EXPECT_TRUE(fs::exists(path("report") / "index.html"));
  EXPECT_TRUE(readJsonFile(path("v.json")));
  EXPECT_TRUE(readJsonFile(path("c.json")));

  ASSERT_EQ(run({"export", path("sketch"), "--format", "lp", "--out", path("again")}).exitCode, 0);
  const auto again = run({"import", path("again"), "--out", path("sketch2")});
  ASSERT_EQ(again.exitCode, 0) << again.error;
}

TEST_F(CommandLine, ValidateMakesItsOwnModel) {
  importSet("set", "sketch");
  const auto validated = run({"validate", path("sketch"), "--report", path("report"), "--quiet"});
  ASSERT_EQ(validated.exitCode, 0) << validated.error;
  EXPECT_TRUE(fs::exists(path("report") / "index.html"));
}

TEST_F(CommandLine, ValidateRefusesAModelThatSawTheHeldOutFrames) {
  importSet("set", "sketch");
  ASSERT_EQ(run({"compress", path("sketch"), "--out", path("m.lsd"), "--quiet"}).exitCode, 0);
  expectRefusal({"validate", path("sketch"), "--hold-out", "every:8:4", "--model", path("m.lsd"),
                 "--report", path("report"), "--quiet"},
                "hold-out");
}

// --- Wrong calls ------------------------------------------------------------------------------

TEST_F(CommandLine, WrongCallsExitWithTwo) {
  EXPECT_EQ(run({}).exitCode, 2);
  EXPECT_EQ(run({"paint"}).exitCode, 2);
  EXPECT_EQ(run({"compress"}).exitCode, 2);
  EXPECT_EQ(run({"relight", "m.lsd", "--out", "a.png"}).exitCode, 2);
  EXPECT_EQ(run({"relight", "m.lsd", "--light", "0,0,0", "--out", "a.png"}).exitCode, 2);
  EXPECT_EQ(run({"compress", "s", "--out", "m.lsd", "--rank", "many"}).exitCode, 2);
  EXPECT_EQ(run({"compress", "s", "--out", "m.lsd", "--block", "1"}).exitCode, 2);
  EXPECT_EQ(run({"--help"}).exitCode, 0);
  EXPECT_EQ(run({"record", "--help"}).exitCode, 0);
}

TEST_F(CommandLine, ValidateRefusesToMakeAModelThatIsThere) {
  for (const std::vector<std::string>& how : {std::vector<std::string>{"--quality", "small"},
                                              {"--psnr", "40"},
                                              {"--budget", "1MB"},
                                              {"--block-rank", "4"},
                                              {"--rank", "20"},
                                              {"--storage", "q8"},
                                              {"--memory", "32MB"},
                                              {"--single-lamp"},
                                              {"--block", "8"},
                                              {"--densify", "off"}}) {
    std::vector<std::string> arguments = {"validate", "s", "--report", "r"};
    arguments.insert(arguments.end(), how.begin(), how.end());
    // Alone it is well formed: only the sketch is missing.
    EXPECT_EQ(run(arguments).exitCode, 1) << how[0];
    arguments.insert(arguments.end(), {"--model", "m.lsd"});
    const auto outcome = run(arguments);
    EXPECT_EQ(outcome.exitCode, 2) << how[0];
    EXPECT_NE(outcome.error.find(how[0]), std::string::npos) << outcome.error;
  }
}

// --- Bad input: exit code 1, one line, nothing left behind --------------------------------------

TEST_F(CommandLine, RefusesWhatIsNotThere) {
  expectRefusal({"info", path("none")}, "none");
  expectRefusal({"import", path("none"), "--out", path("s"), "--quiet"}, "none");
  expectRefusal({"compress", path("none"), "--out", path("m.lsd"), "--quiet"}, "none");
  expectRefusal({"relight", path("none.lsd"), "--light", "0,0,1", "--out", path("a.png")},
                "none.lsd");
  expectRefusal({"validate", path("none"), "--report", path("r"), "--quiet"}, "none");
  expectRefusal({"export", path("none"), "--out", path("e"), "--quiet"}, "none");
}

TEST_F(CommandLine, RefusesAnUnknownCamera) {
  std::ofstream(path("camera.json")) << R"({"format": "lightsketch-camera", "formatVersion": 1,
    "model": "kannala-brandt", "parameters": {"width": 960, "height": 960, "fx": 290, "fy": 290,
    "cx": 480, "cy": 480, "k": [0, 0, 0, 0], "p": [0, 0], "maxFieldAngleDegrees": 92}})";
  expectRefusal({"record", "--scene", "firewire:1", "--source", "firewire:2", "--camera-model",
                 path("camera.json"), "--out", path("s"), "--quiet"},
                "firewire:1");
  expectRefusal({"record", "--scene", "replay:" + path("no").string(), "--source",
                 "replay:" + path("no").string(), "--camera-model", path("camera.json"), "--out",
                 path("s"), "--quiet"},
                "no");
  expectRefusal({"record", "--scene", "aravis:127.0.0.99", "--source", "aravis:127.0.0.98",
                 "--camera-model", path("camera.json"), "--out", path("s"), "--quiet"},
                "127.0.0.99");
  expectRefusal({"record", "--scene", "aravis:127.0.0.99", "--out", path("s"), "--quiet"},
                "--source");
}

TEST_F(CommandLine, RefusesZeroCaptures) {
  fs::create_directory(path("empty"));
  expectRefusal({"import", path("empty"), "--out", path("s"), "--quiet"}, "empty");
  std::ofstream(path("empty") / "set.lp") << "0\n";
  expectRefusal({"import", path("empty"), "--out", path("s"), "--quiet"}, "set.lp");
}

TEST_F(CommandLine, RefusesNonsenseInALightFile) {
  writeSet("set", 64);
  std::string text = slurp(path("set") / "set.lp");
  const auto damage = [&](const std::string& changed) {
    std::ofstream(path("set") / "set.lp") << changed;
  };
  damage("many\n" + text);
  expectRefusal({"import", path("set"), "--out", path("s"), "--quiet"}, "set.lp: line 1");
  std::string broken = text;
  broken.replace(broken.find("002.png") + 8, 3, "abc");
  damage(broken);
  expectRefusal({"import", path("set"), "--out", path("s"), "--quiet"}, "set.lp: line 4");
  damage(text.substr(0, text.find("002.png") + 10));  // truncated in the middle of a line
  expectRefusal({"import", path("set"), "--out", path("s"), "--quiet"}, "set.lp: line 4");
}

TEST_F(CommandLine, RefusesDamagedSketches) {
  importSet("set", "sketch");
  const auto compress = [&](const std::string& what) {
    expectRefusal({"compress", path("sketch"), "--out", path("m.lsd"), "--quiet"}, what);
  };
  // A truncated frame.
  const fs::path frame = path("sketch") / "frames" / "000010.exr";
  const std::string whole = slurp(frame);
  std::ofstream(frame, std::ios::binary) << whole.substr(0, whole.size() / 2);
  compress("000010.exr");
  std::ofstream(frame, std::ios::binary) << whole;
  // Truncated JSON.
  const std::string manifest = slurp(path("sketch") / "sketch.json");
  std::ofstream(path("sketch") / "sketch.json") << manifest.substr(0, manifest.size() / 2);
  compress("sketch.json");
  std::ofstream(path("sketch") / "sketch.json") << manifest;
  // A newer version.
  Json newer = Json::parse(manifest);
  newer["formatVersion"] = 99;
  std::ofstream(path("sketch") / "sketch.json") << newer.dump();
  compress("newer");
  std::ofstream(path("sketch") / "sketch.json") << manifest;
  // A flipped byte in the middle of the journal.
  std::string journal = slurp(path("sketch") / "frames.jsonl");
  journal[journal.size() / 2] = static_cast<char>(journal[journal.size() / 2] ^ 4);
  std::ofstream(path("sketch") / "frames.jsonl", std::ios::binary) << journal;
  compress("frames.jsonl");
}

TEST_F(CommandLine, ChecksAndRepairsASketch) {
  importSet("set", "sketch");
  ASSERT_EQ(run({"check", path("sketch"), "--quiet"}).exitCode, 0);
  const fs::path frame = path("sketch") / "frames" / "000010.exr";
  std::ofstream(frame, std::ios::binary) << "nothing";
  std::string journal = slurp(path("sketch") / "frames.jsonl");
  journal[journal.size() / 2] = static_cast<char>(journal[journal.size() / 2] ^ 4);
  std::ofstream(path("sketch") / "frames.jsonl", std::ios::binary) << journal;

  const auto found = run({"check", path("sketch"), "--quiet", "--json", path("check.json")});
  EXPECT_EQ(found.exitCode, 1);
  EXPECT_NE(found.out.find("frames.jsonl: line "), std::string::npos) << found.out;
  EXPECT_NE(found.out.find("frames/000010.exr"), std::string::npos) << found.out;
  EXPECT_EQ(std::count(found.error.begin(), found.error.end(), '\n'), 1) << found.error;
  EXPECT_NE(found.error.find("2 damaged places"), std::string::npos) << found.error;
  EXPECT_EQ(Json::parse(slurp(path("check.json")))["damaged"], 2);

  const auto repaired = run({"check", path("sketch"), "--repair", "--quiet"});
  ASSERT_EQ(repaired.exitCode, 0) << repaired.error;
  EXPECT_EQ(slurp(path("sketch") / "frames.jsonl.damaged"), journal);
  const auto clean = run({"check", path("sketch"), "--quiet"});
  EXPECT_EQ(clean.exitCode, 0) << clean.out;
  EXPECT_NE(clean.out.find("63 whole frames"), std::string::npos) << clean.out;

  ASSERT_EQ(run({"compress", path("sketch"), "--out", path("m.lsd"), "--quiet"}).exitCode, 0);
  EXPECT_EQ(run({"check", path("m.lsd")}).exitCode, 0);
  std::string model = slurp(path("m.lsd"));
  model[model.size() / 2] = static_cast<char>(model[model.size() / 2] ^ 1);
  std::ofstream(path("m.lsd"), std::ios::binary) << model;
  expectRefusal({"check", path("m.lsd")}, "m.lsd");
  expectRefusal({"check", path("none")}, "none");
}

TEST_F(CommandLine, RefusesDamagedModels) {
  importSet("set", "sketch");
  ASSERT_EQ(run({"compress", path("sketch"), "--out", path("m.lsd"), "--quiet"}).exitCode, 0);
  const std::string whole = slurp(path("m.lsd"));
  for (const std::size_t length :
       {std::size_t{0}, std::size_t{100}, whole.size() / 2, whole.size() - 1}) {
    std::ofstream(path("m.lsd"), std::ios::binary) << whole.substr(0, length);
    expectRefusal({"relight", path("m.lsd"), "--light", "0,0,1", "--out", path("a.png")}, "m.lsd");
  }
  std::string flipped = whole;
  flipped[whole.size() / 3] = static_cast<char>(flipped[whole.size() / 3] ^ 1);
  std::ofstream(path("m.lsd"), std::ios::binary) << flipped;
  expectRefusal({"relight", path("m.lsd"), "--light", "0,0,1", "--out", path("a.png")}, "m.lsd");
}

TEST_F(CommandLine, AFullDiskLeavesNothingHalfMade) {
  writeSet("set", 64);
  // Files may not grow beyond this, which is what a full disk does to a writer.
  expectRefusal({"import", path("set"), "--out", path("s"), "--quiet"}, "s", 1500);
  importSet("set", "sketch");
  // Known before decoding where the file system can reserve room, else while decoding.
  expectRefusal({"compress", path("sketch"), "--out", path("m.lsd"), "--quiet"}, "set TMPDIR",
                20'000);
  ASSERT_EQ(run({"compress", path("sketch"), "--out", path("m.lsd"), "--quiet"}).exitCode, 0);
  expectRefusal({"relight", path("m.lsd"), "--light", "0,0,1", "--out", path("a.png")}, "a.png",
                500);
  expectRefusal({"relight", path("m.lsd"), "--light", "0,0,1", "--out", path("a.exr")}, "a.exr",
                500);
}

TEST_F(CommandLine, RefusesBadRelightingInput) {
  importSet("set", "sketch");
  ASSERT_EQ(run({"compress", path("sketch"), "--out", path("m.lsd"), "--quiet"}).exitCode, 0);
  expectRefusal({"relight", path("m.lsd"), "--light", "0,0,1", "--out", path("a.gif")}, "a.gif");
  expectRefusal({"relight", path("m.lsd"), "--light", "0,0,1", "--out", path("no/a.png")}, "a.png");
  expectRefusal(
      {"relight", path("m.lsd"), "--environment", path("none.hdr"), "--out", path("a.png")},
      "none.hdr");
  std::ofstream(path("lights.json")) << "{\"format\": \"lightsketch-lights\"";
  expectRefusal({"relight", path("m.lsd"), "--lights", path("lights.json"), "--out", path("a.png")},
                "lights.json");
  // An existing sketch is not overwritten by an import.
  expectRefusal({"import", path("set"), "--out", path("sketch"), "--quiet"}, "exists");
}

TEST_F(CommandLine, BenchHasEveryFigure) {
  const auto outcome = run({"bench", "--quick", "--quiet", "--json", path("figures.json"), "--plot",
                            path("growth.svg")});
  ASSERT_EQ(outcome.exitCode, 0) << outcome.error;
  const Json figures = Json::parse(slurp(path("figures.json")));
  const auto expectPositive = [](const Json& object, const std::vector<std::string>& names) {
    for (const auto& name : names) {
      ASSERT_TRUE(object.contains(name)) << name;
      EXPECT_GT(object[name].get<double>(), 0) << name;
    }
  };
  expectPositive(figures["limits"], {"readBytesPerSecond", "multiplyAddFlopPerSecond"});
  ASSERT_EQ(figures["render"].size(), 4u);  // two sizes, f16 and q8
  for (const Json& row : figures["render"]) {
    expectPositive(row, {"seconds", "framesPerSecond", "ofMemoryBandwidth", "ofMultiplyAddPeak"});
    EXPECT_LE(row["largestLevelError"].get<int>(), 1);
  }
  expectPositive(figures["render"][0], {"oneLightSeconds", "allLightsSeconds"});
  ASSERT_EQ(figures["load"].size(), 2u);  // q8 and packed
  for (const Json& row : figures["load"]) {
    expectPositive(row, {"fileBytes", "seconds", "limitSeconds", "ratio"});
  }
  expectPositive(figures["compress"], {"waitSeconds", "stage1Seconds", "stage2Seconds",
                                       "limitSeconds", "ofLimit", "exactStage2Seconds"});
  // 0 where the system does not say.
  EXPECT_GE(figures["compress"]["residentBytes"].get<double>(), 0);
  ASSERT_EQ(figures["growth"].size(), 4u);  // two numbers of lights, two of pixels
  for (const Json& row : figures["growth"]) {
    expectPositive(row, {"seconds"});
    EXPECT_GE(row["residentBytes"].get<double>(), 0);
  }
  EXPECT_NE(slurp(path("growth.svg")).find("</svg>"), std::string::npos);
  // Nothing is left of the models that it loads.
  EXPECT_EQ(entriesBelow(path("")).size(), 2u);
}

}  // namespace
}  // namespace lightsketch
