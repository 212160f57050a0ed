// `lightsketch calibrate ...` from the outside: what it makes, and what it says of bad input.
#include <cmath>
#include <fstream>
#include <numbers>

#include "calibration/model/camera_model.h"
#include "capture/frame/json.h"
#include "pipeline/sketch/image_file.h"
#include "tests/calibration/lens/board_scene.h"
#include "tests/ui/cli/program_test.h"

namespace lightsketch {
namespace {

class Calibrate : public ProgramTest {
 protected:
  // 480 x 480, equidistant: 98 degrees off axis at the sides of the frame.
  EquidistantLens lens() const { return {480, 480, 140, 241, 239}; }
  BoardGeometry board() const {
    BoardGeometry board;
    board.kind = BoardGeometry::Kind::kChessboard;
    board.columns = 7;
    board.rows = 5;
    return board;
  }
  std::vector<std::string> lensCall(const fs::path& images, const std::string& corners = "7x5",
                                    const std::string& kind = "chessboard") const {
    return {"calibrate",
            "lens",
            images,
            "--board",
            kind,
            "--corners",
            corners,
            "--square",
            "30",
            "--model",
            "kb",
            "--splits",
            "2",
            "--out",
            path("lens.json"),
            "--report",
            path("lens.html"),
            "--quiet"};
  }

  // Pictures of boards tilted this way and that, up to `widest` degrees off axis.
  void writeBoards(const std::string& name, int count, double widest = 45) const {
    fs::create_directories(path(name));
    const BoardScene scene(board());
    for (int i = 0; i < count; ++i) {
      const double azimuth = 2.4 * i;  // the golden angle
      const double off = widest * std::numbers::pi / 180 * std::sqrt((i + 0.5) / count);
      const auto pose = boardTowards(board(), azimuth, off, 0.28 + 0.02 * (i % 3), 0.3 * (i % 5),
                                     i % 2 == 0 ? 0.5 : -0.4);
      ASSERT_TRUE(writePng(path(name) / fmt::format("{:02}.png", i),
                           scene.render(lens(), pose, 2, static_cast<unsigned>(i))));
    }
  }

  void writeLens(const std::string& name, double fieldDegrees) const {
    std::ofstream(path(name)) << fmt::format(
        R"({{"format": "lightsketch-camera", "formatVersion": 1, "model": "kannala-brandt",
        "parameters": {{"width": 960, "height": 960, "fx": 290, "fy": 291, "cx": 482, "cy": 477,
        "k": [-0.02, 0.004, -0.003, 0.0004], "p": [0, 0], "maxFieldAngleDegrees": {}}}}})",
        fieldDegrees);
  }
};

// --- Boards -------------------------------------------------------------------------------------

TEST_F(Calibrate, BoardIsPrintedInThreeFormats) {
  for (const auto& [file, magic] :
       {std::pair("b.pdf", "%PDF-"), {"b.svg", "<"}, {"b.png", "\x89PNG"}}) {
    const auto printed =
        run({"calibrate", "board", "--corners", "8x5", "--square", "30", "--out", path(file)});
    EXPECT_EQ(printed.exitCode, 0) << printed.error;
    EXPECT_NE(printed.out.find("100 mm"), std::string::npos) << printed.out;  // what to measure
    EXPECT_EQ(slurp(path(file)).rfind(magic, 0), 0u) << file;
  }
  EXPECT_NE(slurp(path("b.svg")).find("width=\"297.0000mm\""),
            std::string::npos);  // true scale: A4
  const auto picture = readImage(path("b.png"), TransferFunction::kLinear);
  ASSERT_TRUE(picture);
  // A4 at 300 dpi, whole pixels.
  EXPECT_NEAR(std::max(picture->width(), picture->height()), 297 / 25.4 * 300, 1);
}

TEST_F(Calibrate, BoardsTooLargeForThePaperAreRefusedWithASizeThatFits) {
  const auto call = [&](const std::string& square) {
    return std::vector<std::string>{"calibrate", "board",   "--corners", "10x7",  "--square",
                                    square,      "--paper", "A4",        "--out", path("b.pdf")};
  };
  expectRefusal(call("30"), "do not fit A4");
  const std::string said = run(call("30")).error;
  const std::string before = "; squares of ";
  const auto at = said.find(before);
  ASSERT_NE(at, std::string::npos) << said;
  const std::string fits =
      said.substr(at + before.size(), said.find(" mm do", at) - at - before.size());
  const auto printed = run(call(fits));
  EXPECT_EQ(printed.exitCode, 0) << fits << ": " << printed.error;

  expectRefusal({"calibrate", "board", "--corners", "5x5", "--out", path("b.gif")}, ".pdf");
  expectRefusal({"calibrate", "board", "--paper", "A9", "--out", path("b.pdf")}, "A9");
  expectRefusal({"calibrate", "board", "--dictionary", "DICT_9X9", "--corners", "5x5", "--out",
                 path("b.pdf")},
                "DICT_9X9");
  expectRefusal({"calibrate", "board", "--corners", "5x5", "--out", path("no/b.pdf")}, "no/b.pdf");
}

// --- Lens: what is refused
// ------------------------------------------------------------------------

TEST_F(Calibrate, LensRefusesAnEmptyFolder) {
  fs::create_directory(path("empty"));
  expectRefusal(lensCall(path("empty")), "put JPEG, PNG, TIFF or EXR files of the board there");
  expectRefusal(lensCall(path("none")), "none");
  std::ofstream(path("torn.png")) << "no picture";
  expectRefusal(lensCall(path("torn.png")), "torn.png");
}

TEST_F(Calibrate, LensRefusesOneViewEvenOfItsOwnPrint) {
  ASSERT_EQ(run({"calibrate", "board", "--board", "chessboard", "--corners", "7x5", "--square",
                 "30", "--dpi", "60", "--paper", "fit", "--out", path("print.png")})
                .exitCode,
            0);
  expectRefusal(lensCall(path("print.png")),
                "1 of 1 views can be used, at least 4 are needed; take 20 to 40 pictures");
}

TEST_F(Calibrate, LensRefusesViewsThatAreAllAlike) {
  writeBoards("alike", 1);
  for (int i = 1; i < 8; ++i) {
    fs::copy_file(path("alike") / "00.png", path("alike") / fmt::format("{:02}.png", i));
  }
  expectRefusal(
      lensCall(path("alike")),
      "the 8 views are all alike, only 1 differ from one another; move and tilt the board");
}

TEST_F(Calibrate, LensRefusesAWrongBoardSize) {
  writeBoards("boards", 5);
  expectRefusal(lensCall(path("boards"), "6x4"),
                "a grid of 7 x 5 corners, ended on all sides, does not fit a board of 6 x 4");
  expectRefusal(lensCall(path("boards"), "7x5", "charuco"), "check --board, --corners");
}

// A mirrored chessboard is a chessboard; a mirrored ChArUco board is none.
TEST_F(Calibrate, LensRefusesMirroredPictures) {
  ASSERT_EQ(run({"calibrate", "board", "--corners", "7x5", "--square", "30", "--dpi", "80", "--out",
                 path("print.png")})
                .exitCode,
            0);
  expectRefusal(lensCall(path("print.png"), "7x5", "charuco"), "1 of 1 views can be used");
  const auto print = readImage(path("print.png"), TransferFunction::kLinear).value();
  RadianceImage mirrored = print;
  for (int y = 0; y < print.height(); ++y) {
    for (int x = 0; x < print.width(); ++x) {
      for (int c = 0; c < print.channels(); ++c) {
        mirrored(x, y, c) = print(print.width() - 1 - x, y, c);
      }
    }
  }
  ASSERT_TRUE(writePng(path("mirrored.png"), mirrored));
  expectRefusal(lensCall(path("mirrored.png"), "7x5", "charuco"), "the picture not mirrored?");
}

TEST_F(Calibrate, LensWantsOneSourceOfPictures) {
  expectRefusal({"calibrate", "lens", "--out", path("lens.json"), "--quiet"}, "--sketch");
  expectRefusal({"calibrate", "lens", path("a.png"), "--sketch", path("s"), "--out",
                 path("lens.json"), "--quiet"},
                "--sketch");
  expectRefusal(
      {"calibrate", "lens", "--sketch", path("none"), "--out", path("lens.json"), "--quiet"},
      "none");
  expectRefusal(
      {"calibrate", "lens", "--camera", "aravis:127.0.0.99", "--out", path("lens.json"), "--quiet"},
      "127.0.0.99");
}

// --- Lens: what comes out
// ---------------------------------------------------------------------------

// Boards that stay within 50 degrees of a field of 98: the lens is found, the edge is not claimed.
TEST_F(Calibrate, LensSaysThatTheEdgeIsUnknownWhereNoBoardWas) {
  writeBoards("boards", 14, 30);
  auto call = lensCall(path("boards"));
  call.insert(call.end(), {"--json", path("lens.figures.json"), "--export",
                           "opencv=" + path("lens.yml").string()});
  const auto calibrated = run(call);
  ASSERT_EQ(calibrated.exitCode, 0) << calibrated.error;
  EXPECT_NE(calibrated.out.find("warning"), std::string::npos) << calibrated.out;
  EXPECT_NE(calibrated.out.find("edge"), std::string::npos) << calibrated.out;
  EXPECT_NE(calibrated.out.find("next"), std::string::npos) << calibrated.out;
  EXPECT_EQ(slurp(path("lens.html")).rfind("<!DOCTYPE html>", 0), 0u);
  EXPECT_TRUE(fs::exists(path("lens.yml")));
  const auto figures = readJsonFile(path("lens.figures.json"));
  ASSERT_TRUE(figures);
  EXPECT_FALSE((*figures)["warnings"].empty());

  const auto model = loadCameraModel(path("lens.json"));
  ASSERT_TRUE(model) << model.error().message;
  const EquidistantLens truth = lens();
  for (const double degrees : {0.0, 20.0, 40.0}) {
    const double theta = degrees * std::numbers::pi / 180;
    const auto pixel = (*model)->project({std::sin(theta), 0, std::cos(theta)});
    ASSERT_TRUE(pixel);
    // Corners of rendered 480-pixel pictures are good to 0.05 px each; hundreds of them are used.
    EXPECT_NEAR(pixel->x(), truth.cx + truth.focal * theta, 0.3) << degrees;
    EXPECT_NEAR(pixel->y(), truth.cy, 0.3) << degrees;
  }
  EXPECT_TRUE((*model)->covers({0, 0, 1}));
  EXPECT_FALSE((*model)->covers({1, 0, 0}));
  EXPECT_GT((*model)->directionCovariance({0.5, 0, 1}).trace(), 0);
}

// --- Convert
// ------------------------------------------------------------------------------------------

TEST_F(Calibrate, ConvertTakesALensToOtherProgramsAndBack) {
  writeLens("lens.json", 80);
  const auto before = loadCameraModel(path("lens.json")).value();
  for (const std::string format : {"opencv", "kalibr", "mrcal"}) {
    const fs::path foreign = path("foreign." + format);
    const auto there = run({"calibrate", "convert", path("lens.json"), "--to",
                            format + "=" + foreign.string(), "--json", path("there.json")});
    ASSERT_EQ(there.exitCode, 0) << there.error;
    const double claimed =
        readJsonFile(path("there.json")).value()["exports"][0]["largestErrorDegrees"];
    const auto back = run({"calibrate", "convert", foreign, "--to",
                           "lightsketch=" + path(format + ".json").string()});
    ASSERT_EQ(back.exitCode, 0) << back.error;
    const auto after = loadCameraModel(path(format + ".json")).value();
    double worst = 0;
    for (double theta = 0.05; theta < 1.3; theta += 0.05) {
      const Eigen::Vector3d direction(std::sin(theta) * 0.6, std::sin(theta) * 0.8,
                                      std::cos(theta));
      const auto pixel = before->project(direction).value();
      const auto again = after->unproject(pixel);
      ASSERT_TRUE(again) << format;
      worst = std::max(worst, std::acos(std::min(1.0, again->dot(direction))));
    }
    // Both ways lose at most what the way there says, and what a fit of the way back does.
    EXPECT_LT(worst * 180 / std::numbers::pi, 2 * claimed + 1e-3) << format;
    EXPECT_LT(worst * 180 / std::numbers::pi, 0.01) << format;
  }
}

TEST_F(Calibrate, ConvertSaysWhatOpenCvCannotHold) {
  writeLens("wide.json", 100);
  const auto converted = run({"calibrate", "convert", path("wide.json"), "--to",
                              "opencv=" + path("wide.yml").string(), "--json", path("f.json")});
  ASSERT_EQ(converted.exitCode, 0) << converted.error;
  EXPECT_NE(converted.out.find("lost"), std::string::npos) << converted.out;
  // OpenCV's fisheye divides by z: at least the 10 degrees beyond 90 are lost.
  EXPECT_GT(readJsonFile(path("f.json")).value()["exports"][0]["lostFieldDegrees"].get<double>(),
            9.9);
}

TEST_F(Calibrate, ConvertRefusesWhatItCannotRead) {
  writeLens("lens.json", 80);
  expectRefusal({"calibrate", "convert", path("none.json"), "--to", "opencv=" + path("a").string()},
                "none.json");
  expectRefusal({"calibrate", "convert", path("lens.json"), "--to", "paint=" + path("a").string()},
                "known");
  expectRefusal({"calibrate", "convert", path("lens.json"), "--to", "opencv"}, "FORMAT=FILE");
  std::ofstream(path("notes.yaml")) << "a: 1\n";
  expectRefusal(
      {"calibrate", "convert", path("notes.yaml"), "--to", "lightsketch=" + path("a").string()},
      "notes.yaml: no camera file that is known; give lightsketch JSON");
}

// --- Response, poses, finished sketches
// ---------------------------------------------------------------

TEST_F(Calibrate, ResponseRefusesBracketsWithoutTimes) {
  const auto refused = [&](const std::string& what) {
    expectRefusal({"calibrate", "response", path("bracket"), "--out", path("r.json"), "--quiet"},
                  what);
  };
  refused("bracket");
  fs::create_directory(path("bracket"));
  refused("holds no PNG, TIFF or JPEG pictures");
  Image<std::uint8_t> grey(32, 24, 1);
  for (int i = 0; i < 3; ++i) {
    ASSERT_TRUE(writePng(path("bracket") / fmt::format("{}.png", i), grey));
  }
  refused("text file of exposure times");
  std::ofstream(path("bracket") / "times.txt") << "0.1\n0.2\n";
  refused("2 exposure times for 3 pictures");
  expectRefusal({"calibrate", "response", "--out", path("r.json"), "--quiet"}, "--camera");
}

TEST_F(Calibrate, PoseRefusesWhatIsNotThere) {
  writeLens("lens.json", 100);
  const auto refused = [&](std::vector<std::string> arguments, const std::string& what) {
    arguments.insert(arguments.begin(),
                     {"calibrate", "pose", "--out", path("rig.json"), "--quiet"});
    expectRefusal(arguments, what);
  };
  refused({"--scene-model", path("none.json"), "--source-model", path("lens.json"), "--sketch",
           path("ball")},
          "none.json");
  refused({"--scene-model", path("lens.json"), "--source-model", path("lens.json")},
          "--scene-images");
  refused({"--scene-model", path("lens.json"), "--source-model", path("lens.json"), "--sketch",
           path("ball"), "--ball-radius", "25"},
          "ball");
  refused({"--scene-model", path("lens.json"), "--source-model", path("lens.json"),
           "--scene-images", path("scene")},
          "0 --source-images for 1 --source-model");
  refused({"--scene-model", path("lens.json"), "--source-model", path("lens.json"),
           "--scene-images", path("scene"), "--source-images", path("source")},
          "scene");
}

TEST_F(Calibrate, RigRefusesAFormerRigThatIsNotThereBeforeItOpensACamera) {
  expectRefusal(
      {"calibrate", "rig", "--scene", "aravis:127.0.0.99", "--source", "aravis:127.0.0.98",
       "--scene-from", path("none.json"), "--out", path("c"), "--quiet"},
      "none.json");
}

TEST_F(Calibrate, ApplyAndCheckRefuseWhatIsNotThere) {
  writeLens("lens.json", 100);
  expectRefusal(
      {"calibrate", "apply", path("none"), "--camera-model", path("lens.json"), "--quiet"}, "none");
  expectRefusal({"calibrate", "check", path("none"), "--quiet"}, "none");
}

// --- Wrong calls
// --------------------------------------------------------------------------------------

TEST_F(Calibrate, WrongCallsExitWithTwo) {
  const auto code = [&](std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), "calibrate");
    return run(arguments).exitCode;
  };
  EXPECT_EQ(code({}), 2);
  EXPECT_EQ(code({"paint"}), 2);
  EXPECT_EQ(code({"board", "--out", "b.pdf", "--corners", "8"}), 2);
  EXPECT_EQ(code({"board", "--out", "b.pdf", "--corners", "2x2"}), 2);
  EXPECT_EQ(code({"board", "--out", "b.pdf", "--board", "hexagon"}), 2);
  EXPECT_EQ(code({"lens", "a.png"}), 2);
  EXPECT_EQ(code({"lens", "a.png", "--out", "l.json", "--model", "spline"}), 2);
  EXPECT_EQ(code({"pose", "--out", "rig.json"}), 2);
  EXPECT_EQ(code({"response", "bracket"}), 2);
  EXPECT_EQ(code({"apply", "s"}), 2);
  EXPECT_EQ(code({"apply", "s", "--camera-model", "l.json", "--patch", "1,2,3"}), 2);
  EXPECT_EQ(code({"check", "s", "--ball", "1,2,x"}), 2);
  EXPECT_EQ(code({"convert", "l.json"}), 2);
  const auto help = run({"calibrate", "lens", "--help"});
  EXPECT_EQ(help.exitCode, 0);
  EXPECT_NE(help.out.find("Example"), std::string::npos);
}

}  // namespace
}  // namespace lightsketch
