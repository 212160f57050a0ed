#include "ui/cli/calibrate_commands.h"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <cstdio>
#include <iostream>
#include <map>
#include <string>
#include <vector>

namespace lightsketch {
namespace {

// "a,b,c" as exactly `count` numbers.
std::vector<double> numbers(const std::string& text, std::size_t count, const char* expected) {
  std::vector<double> values;
  std::size_t at = 0;
  while (at <= text.size()) {
    const std::size_t end = std::min(text.find(',', at), text.size());
    try {
      std::size_t used = 0;
      values.push_back(std::stod(text.substr(at, end - at), &used));
      if (used != end - at) values.clear();
    } catch (const std::exception&) {
      values.clear();
    }
    if (values.empty()) break;
    at = end + 1;
  }
  if (values.size() != count) {
    throw CLI::ValidationError(fmt::format("expected {}, not '{}'", expected, text));
  }
  return values;
}

// The board is described by the same options everywhere; `calibrate board` prints them on it.
void addBoardOptions(CLI::App& command, BoardGeometry& board) {
  static const std::map<std::string, BoardGeometry::Kind> kKinds = {
      {"charuco", BoardGeometry::Kind::kCharuco}, {"chessboard", BoardGeometry::Kind::kChessboard}};
  command.add_option("--board", board.kind, "charuco (default) or chessboard")
      ->transform(CLI::CheckedTransformer(kKinds));
  command.add_option_function<std::string>(
      "--corners",
      [&board](const std::string& text) {
        int used = 0;
        if (std::sscanf(text.c_str(), "%dx%d%n", &board.columns, &board.rows, &used) != 2 ||
            static_cast<std::size_t>(used) != text.size() || board.columns < 3 || board.rows < 3 ||
            board.columns > 100 || board.rows > 100) {
          throw CLI::ValidationError("expected COLUMNSxROWS of inner corners, such as 10x7, not '" +
                                     text + "'");
        }
      },
      fmt::format("inner corners, COLUMNSxROWS (default {}x{}; one less than squares each way)",
                  board.columns, board.rows));
  command
      .add_option_function<double>(
          "--square", [&board](double mm) { board.spacingMetres = mm / 1000; },
          fmt::format("side of a square in millimetres (default {:g})", 1000 * board.spacingMetres))
      ->check(CLI::Range(0.1, 10'000.0));
  command.add_option("--marker", board.markerFraction, "ChArUco: marker's side over the square's")
      ->check(CLI::Range(0.2, 0.95))
      ->capture_default_str();
  command.add_option("--dictionary", board.dictionary, "ChArUco: OpenCV's name of the markers")
      ->capture_default_str();
}

void addLensOptions(CLI::App& command, LensCalibrationOptions& options) {
  command.add_option_function<std::string>(
      "--model",
      [&options](const std::string& name) {
        static const std::map<std::string, LensFamily> kFamilies = {
            {"kb", LensFamily::kKannalaBrandt},
            {"fisheye624", LensFamily::kFisheye624},
            {"kb-pupil", LensFamily::kKannalaBrandtPupil},
            {"fisheye624-pupil", LensFamily::kFisheye624Pupil}};
        if (name == "auto") return;
        const auto found = kFamilies.find(name);
        if (found == kFamilies.end()) {
          throw CLI::ValidationError(
              "expected auto, kb, fisheye624, kb-pupil or fisheye624-pupil, not '" + name + "'");
        }
        options.family = found->second;
      },
      "auto (default): Kannala-Brandt, or more where split halves of the views agree better with "
      "it; or kb, fisheye624, kb-pupil, fisheye624-pupil");
  command.add_flag("!--flat-board", options.solveWarp, "the board is truly flat: solve no bend");
  command.add_option("--splits", options.splits, "random halves that the result is tested with")
      ->check(CLI::Range(0, 100))
      ->capture_default_str();
  command.add_option("--seed", options.seed, "of the random halves")->capture_default_str();
}

bool askPerson(const std::string& wish) {
  fmt::print(stderr, "\n{}, then press Enter (Ctrl-D: give up) ", wish);
  std::string answer;
  return static_cast<bool>(std::getline(std::cin, answer));
}

std::function<void(const LiveViewState&)> noteOn(ProgressBar& bar) {
  return [&bar](const LiveViewState& state) {
    std::string note;
    for (std::size_t i = 0; i < state.verdicts.size(); ++i) {
      if (i > 0) note += " | ";
      note += fmt::format("{}: {}", state.counts[i], describe(state.verdicts[i]));
    }
    bar.setNote(note);
  };
}

}  // namespace

CalibrateCommands::CalibrateCommands(CLI::App& app, Common& common, Action& action)
    : common_(common), action_(action) {
  CLI::App* calibrate = app.add_subcommand(
      "calibrate",
      "lens, poses and response of the cameras.\nThe usual way: print a board (calibrate board), "
      "wave it before all cameras (calibrate rig) or one (calibrate lens); find the poses with it "
      "or with a mirror ball at the subject (calibrate pose). `calibrate apply` gives finished "
      "sketches new directions.");
  calibrate->require_subcommand(1);
  addBoard(*calibrate);
  addLens(*calibrate);
  addRig(*calibrate);
  addPose(*calibrate);
  addResponse(*calibrate);
  addApply(*calibrate);
  addCheck(*calibrate);
  addConvert(*calibrate);
}

void CalibrateCommands::addBoard(CLI::App& app) {
  auto* command =
      addCommand(app, "board", "print a calibration board at true scale",
                 "lightsketch calibrate board --corners 8x5 --square 30 --out board.pdf", common_);
  addBoardOptions(*command, board_.board);
  command
      ->add_option("--paper", board_.paper,
                   "A4, A3, letter, 420x297 (mm), ...; auto: the smallest of A4, A3, A2 that it "
                   "fits on; fit: just large enough")
      ->capture_default_str();
  command->add_option("--dpi", board_.dpi, "of a PNG")
      ->check(CLI::Range(30.0, 2400.0))
      ->capture_default_str();
  command->add_option("--out", board_.out, "FILE.pdf, FILE.svg or FILE.png")->required();
  command->callback([this] {
    action_ = [this](ProgressBar&, const std::stop_token&) { return printBoardJob(board_); };
  });
}

void CalibrateCommands::addLens(CLI::App& app) {
  auto* command = addCommand(
      app, "lens",
      "a camera's lens, fisheye or not, from pictures of a board: with its uncertainty over the "
      "whole field and the field that was covered. Bring the board close, tilt it, and into the "
      "rim of the picture: parts of it count.",
      "lightsketch calibrate lens board/*.png --corners 8x5 --square 30 --out source.json --report "
      "lens.html",
      common_);
  command->add_option("images", lens_.images, "pictures, or folders of them");
  command->add_option("--sketch", lens_.sketch, "take the frames of this sketch");
  command->add_option("--camera", lens_.camera, "take views from this camera, live");
  command->add_option("--views", lens_.views, "views to take from a live camera")
      ->check(CLI::Range(3, 1000))
      ->capture_default_str();
  command->add_option("--time-limit", lens_.timeLimitSeconds, "of a live camera, seconds")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  addBoardOptions(*command, lens_.board);
  addLensOptions(*command, lens_.options);
  command->add_flag("--mrcal", lens_.crossCheck, "cross-check with mrcal's splined model");
  command->add_option("--out", lens_.out, "camera file, JSON")->required();
  command->add_option("--report", lens_.report, "the report, an HTML file");
  command
      ->add_option("--export", lens_.exports,
                   "for other programs: mrcal=FILE, opencv=FILE or kalibr=FILE; may be repeated")
      ->allow_extra_args(false);
  command->callback([this] {
    action_ = [this](ProgressBar& bar, const std::stop_token& stop) {
      return lensJob(lens_, bar, stop, noteOn(bar));
    };
  });
}

void CalibrateCommands::addRig(CLI::App& app) {
  auto* command = addCommand(
      app, "rig",
      "every lens and all poses at once: wave one board before all cameras, live. Hold it still "
      "now and then; some places should be seen by the scene camera and a source camera at once.",
      "lightsketch calibrate rig --scene aravis:192.168.1.20 --source aravis:192.168.1.21 "
      "--corners "
      "8x5 --square 30 --out calibration",
      common_);
  command->add_option("--scene", rig_.sceneCamera, "scene camera")->required();
  command->add_option("--source", rig_.sourceCameras, "source camera; may be repeated")
      ->required()
      ->allow_extra_args(false);
  command->add_option("--views", rig_.views, "views wanted per camera")
      ->check(CLI::Range(3, 1000))
      ->capture_default_str();
  command->add_option("--time-limit", rig_.timeLimitSeconds, "seconds")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  addBoardOptions(*command, rig_.board);
  addLensOptions(*command, rig_.options);
  command->add_option("--scene-from", rig_.sceneFrom,
                      "keep the scene camera's pose of this rig; without it you are asked at the "
                      "end to lay the board flat at the subject, and its centre is the origin");
  command->add_option("--out", rig_.out, "a new folder")->required();
  command->callback([this] {
    action_ = [this](ProgressBar& bar, const std::stop_token& stop) {
      rig_.ask = askPerson;
      return rigCalibrationJob(rig_, bar, stop, noteOn(bar));
    };
  });
}

void CalibrateCommands::addPose(CLI::App& app) {
  auto* command = addCommand(
      app, "pose",
      "where the source cameras stand: from pairs of pictures of one board, or from a mirror ball "
      "at the subject. For the ball, record a sketch with it in the scene's place while the lamp "
      "is waved for 20 seconds (record --poses-unknown).",
      "lightsketch calibrate pose --sketch ball --ball-radius 25 --scene-model scene.json "
      "--source-model source.json --out rig.json",
      common_);
  command->add_option("--scene-model", pose_.sceneModel, "camera file of the scene camera")
      ->required();
  command
      ->add_option("--source-model", pose_.sourceModels,
                   "camera file of a source camera; one for each")
      ->required()
      ->allow_extra_args(false);
  command->add_option("--scene-images", pose_.sceneImages, "folder of the scene camera's pictures");
  command
      ->add_option("--source-images", pose_.sourceImages,
                   "folder of a source camera's pictures, taken at the same moments, in order")
      ->allow_extra_args(false);
  addBoardOptions(*command, pose_.board);
  command->add_option("--flat", pose_.flatView,
                      "the scene picture in which the board lies flat at the subject");
  command->add_option("--sketch", pose_.sketch, "sketch of a lamp waved over a mirror ball");
  command
      ->add_option_function<std::vector<std::string>>(
          "--ball",
          [this](const std::vector<std::string>& texts) {
            for (const std::string& text : texts) {
              const auto v = numbers(text, 3, "X,Y,RADIUS in pixels");
              pose_.balls.push_back({v[0], v[1], v[2]});
            }
          },
          "roughly where a ball is in the scene picture, X,Y,RADIUS in pixels; needed where it is "
          "not found by itself; may be repeated")
      ->allow_extra_args(false);
  command
      ->add_option_function<std::vector<double>>(
          "--ball-radius",
          [this](const std::vector<double>& radii) {
            for (const double mm : radii) pose_.ballRadiiMetres.push_back(mm / 1000);
          },
          "radius of the ball in millimetres; one for each ball")
      ->allow_extra_args(false);
  command
      ->add_option_function<std::vector<double>>(
          "--source-distance",
          [this](const std::vector<double>& distances) {
            for (const double mm : distances) pose_.sourceDistancesMetres.push_back(mm / 1000);
          },
          "how far a source camera's lens is from the first ball's centre, in millimetres, by a "
          "ruler; one for each camera. One ball alone hardly fixes the scale; two balls apart, or "
          "this, do")
      ->allow_extra_args(false);
  command
      ->add_option("--lamp-distance", pose_.lampDistanceMetres,
                   "the lamp's mean distance from the ball in metres, to a tenth, if nothing "
                   "better is known")
      ->check(CLI::PositiveNumber);
  command->add_option("--scene-from", pose_.sceneFrom, "keep the scene camera's pose of this rig");
  command->add_option("--out", pose_.out, "rig.json")->required();
  command->callback([this] {
    action_ = [this](ProgressBar& bar, const std::stop_token&) { return poseJob(pose_, bar); };
  });
}

void CalibrateCommands::addResponse(CLI::App& app) {
  auto* command = addCommand(
      app, "response",
      "what a camera's counts mean: response curve or black level, noise, hot pixels, dark frame "
      "and flat field; from brackets of a still scene under steady light, in folders or live. A "
      "folder holds pictures and one text file with their exposure times in seconds, a line each.",
      "lightsketch calibrate response bracket/ --dark dark/ --out camera.json --report report",
      common_);
  command->add_option("brackets", response_.brackets, "folders, a bracket each");
  command->add_option("--dark", response_.dark, "folder of pictures with the lens covered");
  command->add_option("--diffuser", response_.diffuser, "folder of pictures of an even diffuser");
  command->add_option("--camera", response_.camera, "take the bracket from this camera, live");
  command->add_option_function<std::string>(
      "--format",
      [this](const std::string& name) {
        response_.format = pixelFormatFromName(name);
        if (!response_.format) {
          throw CLI::ValidationError("expected a pixel format such as RGB8 or BayerRG12, not '" +
                                     name + "'");
        }
      },
      "live: pixel format that the camera is to send, such as BayerRG12");
  command->add_option("--shortest", response_.shortestSeconds, "live: shortest exposure, seconds")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--longest", response_.longestSeconds, "live: longest exposure, seconds")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--frames", response_.framesPerExposure, "live: frames per exposure")
      ->check(CLI::Range(1, 100))
      ->capture_default_str();
  command->add_flag("--take-dark", response_.takeDark, "live: then also with the lens covered");
  command->add_flag("--take-diffuser", response_.takeDiffuser,
                    "live: then also of an even diffuser");
  command->add_option("--out", response_.out, "response file, JSON")->required();
  command->add_option("--report", response_.report, "a new folder for the HTML report");
  command->callback([this] {
    response_.ask = askPerson;
    action_ = [this](ProgressBar& bar, const std::stop_token& stop) {
      return responseJob(response_, bar, stop);
    };
  });
}

void CalibrateCommands::addApply(CLI::App& app) {
  auto* command = addCommand(
      app, "apply",
      "give a finished sketch new light directions, positions and fall-off from a new calibration; "
      "nothing is rewritten, the journal gets events",
      "lightsketch calibrate apply vase --camera-model source.json --rig rig.json", common_);
  command->add_option("sketch", apply_.sketch, "the sketch")->required();
  command
      ->add_option("--camera-model", apply_.sourceModels,
                   "calibration of a source camera; one for all, or one for each")
      ->required()
      ->allow_extra_args(false);
  command->add_option("--rig", apply_.rigGeometry, "poses (default: the sketch's own)");
  command
      ->add_option("--lamp-radius", apply_.lampRadiusMetres,
                   "metres from the subject to the lamp, for frames that one camera saw")
      ->check(CLI::PositiveNumber);
  command->add_option_function<std::string>(
      "--patch",
      [this](const std::string& text) {
        const auto v = numbers(text, 4, "X,Y,WIDTH,HEIGHT in pixels");
        for (const double value : v) {
          if (!(std::abs(value) < 1e6)) throw CLI::ValidationError("--patch: out of any picture");
        }
        apply_.patch = {static_cast<int>(v[0]), static_cast<int>(v[1]), static_cast<int>(v[2]),
                        static_cast<int>(v[3])};
      },
      "a matte patch that faces +z, X,Y,WIDTH,HEIGHT in the scene picture: fixes the lamp's power "
      "per frame");
  command->add_option_function<std::string>(
      "--ball",
      [this](const std::string& text) {
        const auto v = numbers(text, 3, "X,Y,RADIUS in pixels");
        apply_.ball = {v[0], v[1], v[2]};
      },
      "roughly where a mirror ball is in the scene picture; needed where it is not found by "
      "itself");
  command->add_option_function<double>(
      "--ball-radius", [this](double mm) { apply_.ballRadiusMetres = mm / 1000; },
      "its radius in millimetres: tells where the lamp was in frames that one source camera saw");
  command->add_option("--scene-model", apply_.sceneModel,
                      "camera file of the scene camera, for the ball");
  command->callback([this] {
    action_ = [this](ProgressBar& bar, const std::stop_token&) {
      return applyCalibrationJob(apply_, bar);
    };
  });
}

void CalibrateCommands::addCheck(CLI::App& app) {
  auto* command = addCommand(
      app, "check", "check every light direction of a sketch by a mirror ball in its pictures",
      "lightsketch calibrate check vase --ball 410,300,42", common_);
  command->add_option("sketch", check_.sketch, "the sketch")->required();
  command->add_option_function<std::string>(
      "--ball",
      [this](const std::string& text) {
        const auto v = numbers(text, 3, "X,Y,RADIUS in pixels");
        check_.ball = {v[0], v[1], v[2]};
      },
      "roughly where the ball is, X,Y,RADIUS in pixels; needed where it is not found by itself");
  command->add_option("--scene-model", check_.sceneModel,
                      "camera file of the scene camera (default: orthographic)");
  command->add_option_function<double>(
      "--ball-radius", [this](double mm) { check_.ballRadiusMetres = mm / 1000; },
      "radius of the ball in millimetres, with --scene-model");
  command->callback([this] {
    action_ = [this](ProgressBar& bar, const std::stop_token&) {
      return checkDirectionsJob(check_, bar);
    };
  });
}

void CalibrateCommands::addConvert(CLI::App& app) {
  auto* command = addCommand(
      app, "convert",
      "a camera file for another program; where its format lacks the model, the nearest one that "
      "it has, with the largest error",
      "lightsketch calibrate convert source.cameramodel --to lightsketch=source.json", common_);
  command->add_option("file", convert_.in, "ours, mrcal's, OpenCV's or Kalibr's")->required();
  command
      ->add_option("--to", convert_.exports,
                   "lightsketch=FILE, mrcal=FILE, opencv=FILE or kalibr=FILE; may be repeated")
      ->required()
      ->allow_extra_args(false);
  command->callback([this] {
    action_ = [this](ProgressBar&, const std::stop_token&) { return convertCameraJob(convert_); };
  });
}

}  // namespace lightsketch
