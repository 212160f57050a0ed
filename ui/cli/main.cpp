// The command line: parses, calls a job, prints. Exit 0: done. 1: it failed, with one line on
// standard error. 2: the call was wrong.
#include <fmt/format.h>
#include <glog/logging.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <charconv>
#include <csignal>
#include <cstdio>
#include <functional>
#include <optional>
#include <stop_token>
#include <string>
#include <thread>
#include <vector>

#include "capture/frame/json.h"
#include "pipeline/job/bench_job.h"
#include "pipeline/job/check_job.h"
#include "pipeline/job/jobs.h"
#include "ui/cli/calibrate_commands.h"
#include "ui/cli/command.h"

namespace lightsketch {
namespace {

// Set by Ctrl-C; long work polls it and leaves nothing half made.
std::atomic<bool> interrupted{false};
static_assert(std::atomic<bool>::is_always_lock_free, "a signal handler may only touch such");

extern "C" void onInterrupt(int) { interrupted = true; }

// A stop_token that follows the interrupt flag.
class InterruptWatch {
 public:
  InterruptWatch()
      : watcher_([this](const std::stop_token& end) {
          while (!end.stop_requested() && !interrupted) {
            std::this_thread::sleep_for(std::chrono::milliseconds(50));
          }
          if (interrupted) source_.request_stop();
        }) {}
  std::stop_token token() const { return source_.get_token(); }

 private:
  std::stop_source source_;
  std::jthread watcher_;
};

// --- Options that are more than a number ------------------------------------------------------

// "10" or "full" (as 0, which the jobs take as full).
std::function<void(const std::string&)> rankInto(std::optional<int>& target) {
  return [&target](const std::string& text) {
    if (text == "full") {
      target = 0;
      return;
    }
    std::size_t used = 0;
    int value = 0;
    try {
      value = std::stoi(text, &used);
    } catch (const std::exception&) {
      used = 0;
    }
    if (used != text.size() || text.empty() || value < 1) {
      throw CLI::ValidationError("expected a whole number of at least 1, or 'full', not '" + text +
                                 "'");
    }
    target = value;
  };
}

void addCompressOptions(CLI::App& command, CompressOptions& options) {
  command.add_option("--block", options.blockSize, "block size in pixels, 2 to 64")
      ->check(CLI::Range(2, 64))
      ->capture_default_str();
  const auto* ranks = "The paper's setting";
  const auto* targets = "What the model is to be (one of these; ranks and rounding follow)";
  static const std::map<std::string, Quality> kQuality = {
      {nameOf(Quality::kSmall), Quality::kSmall},
      {nameOf(Quality::kStandard), Quality::kStandard},
      {nameOf(Quality::kArchive), Quality::kArchive}};
  command.add_option("--quality", options.quality, "small, standard or archive (default standard)")
      ->transform(CLI::CheckedTransformer(kQuality))
      ->group(targets);
  command
      .add_option("--budget", options.budgetBytes, "the best model whose file has at most BYTES")
      ->type_name("BYTES")
      ->transform(CLI::AsSizeValue(true))
      ->group(targets);
  command
      .add_option("--psnr", options.psnr,
                  "the smallest model that gives captured pictures back with DB decibels (8-bit "
                  "sRGB PSNR, mean over up to 64 of them)")
      ->type_name("DB")
      ->group(targets);
  command
      .add_option_function<std::string>("--block-rank", rankInto(options.blockRank),
                                        "basis pictures per block, or 'full' (default 10)")
      ->group(ranks);
  command
      .add_option_function<std::string>("--rank", rankInto(options.rank),
                                        "rank of the second stage, or 'full' (default 200)")
      ->group(ranks);
  static const std::map<std::string, Storage> kStorage = {
      {"f32", Storage::kFloat32}, {"f16", Storage::kFloat16}, {"q8", Storage::kQ8}};
  command
      .add_option("--storage", options.storage,
                  "numbers in the file: f32, f16, or q8 for basis pictures in 8 bits (default "
                  "f16)")
      ->transform(CLI::CheckedTransformer(kStorage))
      ->group(ranks);
  command.add_flag(
      "--single-lamp", options.singleLamp,
      "factor square roots: better pictures in as many bytes, but of one lamp only; sums "
      "of lights and environments are refused");
  command
      .add_option("--memory", options.memoryLimitBytes,
                  "for the pictures being worked on, at least 16 MiB (default 1500 MB); the "
                  "model's factors E and U come on top")
      ->type_name("BYTES")
      ->transform(CLI::AsSizeValue(true));
  command.add_option_function<std::string>(
      "--densify",
      [&options](const std::string& text) {
        if (text == "auto")
          options.densify = CompressOptions::kDensifyAuto;
        else if (text == "off")
          options.densify = CompressOptions::kDensifyOff;
        else {
          int value = 0;
          const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
          if (error != std::errc() || end != text.data() + text.size() || value < 64 ||
              value > 10'000) {
            throw CLI::ValidationError("expected auto, off, or 64 to 10000, not '" + text + "'");
          }
          options.densify = value;
        }
      },
      "interpolate sparse captures to this many directions before factoring: auto, off or a "
      "number");
}

Eigen::Vector3d parseDirection(const std::string& text) {
  Eigen::Vector3d v;
  int used = 0;
  if (std::sscanf(text.c_str(), "%lf,%lf,%lf%n", &v.x(), &v.y(), &v.z(), &used) != 3 ||
      static_cast<std::size_t>(used) != text.size() || !v.allFinite() || v.norm() < 1e-9) {
    throw CLI::ValidationError("--light: expected X,Y,Z with at least one not 0, not '" + text +
                               "'");
  }
  return v.normalized();
}

void addRigOptions(CLI::App& command, SimulatedRigOptions& rig) {
  command
      .add_option("--scene-address", rig.sceneAddress, "loopback address of the rig's scene camera")
      ->capture_default_str();
  command
      .add_option("--source-address", rig.sourceAddress,
                  "loopback address of the rig's source camera")
      ->capture_default_str();
  command.add_option("--seed", rig.seed, "seed of the simulated hand and noise")
      ->capture_default_str();
  command.add_option("--packet-loss", rig.packetLoss, "fraction of packets that the rig loses")
      ->check(CLI::Range(0.0, 0.5))
      ->capture_default_str();
  command
      .add_option("--prerendered", rig.prerenderedFrames,
                  "serve this many frames rendered beforehand instead of tracing live")
      ->check(CLI::Range(0, 10'000))
      ->capture_default_str();
}

// --- The commands -----------------------------------------------------------------------------

struct Commands {
  explicit Commands(CLI::App& app) {
    addCameras(app);
    addRig(app);
    calibrate_.emplace(app, common, action);
    addRecord(app);
    addImport(app);
    addExport(app);
    addCompress(app);
    addRelight(app);
    addValidate(app);
    addCull(app);
    addDropAndRestore(app);
    addCheck(app);
    addInfo(app);
    addDemo(app);
    addBench(app);
  }

  Common common;
  Action action;
  std::string complaint;  // of a job that did its work and found something amiss: exit code 1

 private:
  CLI::App* add(CLI::App& app, const std::string& name, const std::string& description,
                const std::string& example) {
    return addCommand(app, name, description, example, common);
  }

  void addCameras(CLI::App& app) {
    add(app, "cameras", "list what is connected", "lightsketch cameras")->callback([this] {
      action = [](ProgressBar&, const std::stop_token&) { return listCamerasJob(); };
    });
  }

  void addRig(CLI::App& app) {
    auto* command =
        add(app, "rig", "run the simulated rig until stopped; prints its two addresses",
            "lightsketch rig --calibration rig &\n  lightsketch record --scene aravis:127.0.0.11 "
            "--source aravis:127.0.0.12 --camera-model rig/source.json --rig rig/rig.json --out "
            "sketch");
    addRigOptions(*command, rig_.rig);
    command->add_option("--rate", rig_.rig.framesPerSecond, "frames a second")
        ->check(CLI::Range(1.0, 120.0))
        ->capture_default_str();
    command->add_option_function<std::string>(
        "--program",
        [this](const std::string& name) {
          const auto program = rigProgramFromName(name);
          if (!program) {
            throw CLI::ValidationError(
                "expected lamp, board, ball, diffuser, dark or still, not '" + name + "'");
          }
          rig_.rig.program = *program;
        },
        "what happens before the cameras: lamp (default), board, ball, diffuser, dark or still");
    command->add_option("--second-source", rig_.rig.secondSource,
                        "address of a second source camera, such as 127.0.0.13");
    command->add_option("--calibration", rig_.calibrationFolder,
                        "write source.json and rig.json, as a calibration would, to this folder");
    command->callback([this] {
      action = [this](ProgressBar&, const std::stop_token& stop) {
        return rigJob(
            rig_,
            [](const std::string& text) {
              fmt::print("{}\n", text);
              std::fflush(stdout);
            },
            stop);
      };
    });
  }

  void addRecord(CLI::App& app) {
    auto* command =
        add(app, "record",
            "record a sketch: track the lamp, keep a frame for every new light direction. With no "
            "camera "
            "named, the simulated rig is recorded. An existing sketch is gone on with.",
            "lightsketch record --scene aravis:192.168.1.20 --source aravis:192.168.1.21 "
            "--camera-model source.json --directions 300 --out vase");
    command->add_option("--scene", record_.sceneCamera,
                        "scene camera, e.g. aravis:192.168.1.20 or v4l2:/dev/video0");
    command
        ->add_option("--source", record_.sourceCameras,
                     "fisheye source camera; may be repeated: two that see the lamp tell its "
                     "distance")
        ->allow_extra_args(false);
    command
        ->add_option("--camera-model", record_.cameraModels,
                     "calibration of the source camera; one for each, in their order")
        ->allow_extra_args(false);
    command
        ->add_option("--lamp-radius", record_.lampRadiusMetres,
                     "metres from the subject at which the lamp is held, for one source camera")
        ->check(CLI::PositiveNumber);
    command->add_option("--rig", record_.rigGeometry, "poses of the cameras (rig.json)");
    command->add_option("--out", record_.sketch, "the sketch, a folder")->required();
    auto& recorder = record_.recorder;
    command->add_option("--directions", recorder.directions, "light directions to cover")
        ->check(CLI::Range(64, 10'000))
        ->capture_default_str();
    command->add_flag("--sphere", recorder.fullSphere, "cover the sphere, not the hemisphere");
    command
        ->add_option("--coverage", recorder.coverageGoal, "stop at this fraction of the directions")
        ->check(CLI::Range(0.01, 1.0))
        ->capture_default_str();
    command->add_option("--time-limit", recorder.timeLimitSeconds, "stop after this many seconds")
        ->check(CLI::PositiveNumber);
    command->add_option("--exposure", recorder.sceneExposureSeconds, "scene camera, seconds")
        ->check(CLI::PositiveNumber)
        ->capture_default_str();
    command->add_option("--gain", recorder.sceneGainDb, "scene camera, dB")->capture_default_str();
    command
        ->add_option("--source-exposure", recorder.sourceExposureSeconds, "source camera, seconds")
        ->check(CLI::PositiveNumber)
        ->capture_default_str();
    command->add_option("--black-level", recorder.sceneBlackLevel, "scene camera's zero, in counts")
        ->check(CLI::NonNegativeNumber)
        ->capture_default_str();
    command->add_option("--rate", recorder.framesPerSecond, "frames a second")
        ->check(CLI::Range(0.1, 1000.0))
        ->capture_default_str();
    command
        ->add_option("--ambient-seconds", recorder.ambientSeconds,
                     "at the start, with the lamp off: take the ambient frame")
        ->check(CLI::NonNegativeNumber)
        ->capture_default_str();
    command->add_option("--response", record_.sceneResponse,
                        "response file of the scene camera (calibrate response); its pixel format "
                        "is used");
    command->add_flag_callback(
        "--bracket",
        [this] {
          record_.recorder.bracket = {1.0 / 16, 1.0 / 4, 1, 3};
        },
        "four exposures a direction, 1/16 to 3 times --exposure, merged; hold the lamp still for "
        "each");
    command->add_flag("--poses-unknown", recorder.posesUnknown,
                      "the source cameras' poses are still to be found: for `calibrate pose` with "
                      "a mirror ball");
    command->add_flag("--keep-raw", recorder.keepRaw,
                      "keep the sensor's own counts beside each frame (frames/000123.raw.png)");
    command->add_flag("!--keep-ambient", recorder.subtractAmbient,
                      "keep the ambient light in the frames, and its picture beside them");
    record_.reconnectSeconds = 60;
    command
        ->add_option("--reconnect", record_.reconnectSeconds,
                     "wait this many seconds for a camera that was lost, and go on; 0: end")
        ->type_name("SECONDS")
        ->check(CLI::NonNegativeNumber)
        ->capture_default_str();
    command->add_option("--trigger", record_.trigger,
                        "input of the cameras that starts each exposure, such as Line1; without "
                        "it they run freely");
    addRigOptions(*command, record_.simulatedRig);
    command->callback([this] {
      action = [this](ProgressBar& bar, const std::stop_token& stop) {
        return recordJob(record_, bar, stop, [&bar](const RecorderState& state) {
          if (!state.waitingFor.empty())
            bar.setNote("waiting for the camera");
          else if (state.lampWantedOff)
            bar.setNote("lamp OFF: ambient frame");
          else if (state.lastRefusal != Refusal::kNone)
            bar.setNote(describe(state.lastRefusal));
          else
            bar.setNote("");
        });
      };
    });
  }

  void addImport(CLI::App& app) {
    auto* command = add(app, "import",
                        "turn a multi-light set (.lp or DiLiGenT files, with images) into a sketch",
                        "lightsketch import coin/ --out coin.sketch");
    command->add_option("folder", import_.folder, "images and their light file")->required();
    command->add_option("--lp", import_.lp, "light file, if not the one in the folder");
    command->add_option("--light-intensities", import_.intensities,
                        "the lamp's strength per image: a line each, one or three numbers");
    static const std::map<std::string, TransferFunction> kTransfer = {
        {"srgb", TransferFunction::kSrgb}, {"linear", TransferFunction::kLinear}};
    command
        ->add_option("--transfer", import_.transfer,
                     "how integer pixels are encoded: srgb or linear (default: linear in DiLiGenT "
                     "folders, else srgb)")
        ->transform(CLI::CheckedTransformer(kTransfer));
    command->add_option("--out", import_.out, "the sketch, a folder")->required();
    command->callback([this] {
      action = [this](ProgressBar& bar, const std::stop_token&) { return importJob(import_, bar); };
    });
  }

  void addExport(CLI::App& app) {
    auto* command = add(app, "export", "write a sketch for other programs",
                        "lightsketch export vase --format lp --out vase-lp");
    command->add_option("sketch", export_.sketch, "the sketch")->required();
    command
        ->add_option("--format", export_.format,
                     "lp: images and a .lp file, as RTI programs read them")
        ->check(CLI::IsMember({"lp"}))
        ->capture_default_str();
    static const std::map<std::string, ExportLpOptions::Format> kImages = {
        {"png16", ExportLpOptions::Format::kPng16},
        {"png8", ExportLpOptions::Format::kPng8},
        {"exr", ExportLpOptions::Format::kExr}};
    command
        ->add_option("--images", export_.lp.format,
                     "png16, png8 (sRGB) or exr (linear); default png16")
        ->transform(CLI::CheckedTransformer(kImages));
    command->add_option("--out", export_.out, "a new folder")->required();
    command->callback([this] {
      action = [this](ProgressBar& bar, const std::stop_token&) { return exportJob(export_, bar); };
    });
  }

  void addCompress(CLI::App& app) {
    auto* command = add(app, "compress", "factor a sketch into a relightable model",
                        "lightsketch compress vase --out vase.lsd");
    command->add_option("sketch", compress_.sketch, "the sketch")->required();
    command->add_option("--out", compress_.out, "the model, .lsd")->required();
    command->add_option("--hold-out", compress_.options.holdOutRule,
                        "frames kept back to measure with: every:8:4, cells:8:4 or list:FILE");
    addCompressOptions(*command, compress_.options);
    command->add_option("--near-light", compress_.nearLight,
                        "the lamp was near: 'flat' for a flat subject, or an EXR of depths along "
                        "the scene camera's axis in metres; every block then has its own light "
                        "directions and every pixel its own distance");
    command->add_option("--scene-model", compress_.sceneModel,
                        "camera file of the scene camera, for --near-light");
    command->callback([this] {
      action = [this](ProgressBar& bar, const std::stop_token&) {
        return compressJob(compress_, bar);
      };
    });
  }

  void addRelight(CLI::App& app) {
    auto* command = add(app, "relight", "draw a model under other light",
                        "lightsketch relight vase.lsd --light 0.5,0.5,0.7 --out vase.png");
    command->add_option("model", relight_.model, "the model, .lsd")->required();
    command
        ->add_option_function<std::vector<std::string>>(
            "--light",
            [this](const std::vector<std::string>& texts) {
              for (const auto& text : texts) {
                DirectionalLamp lamp;
                lamp.direction = parseDirection(text);
                relight_.lamps.push_back(lamp);
              }
            },
            "direction X,Y,Z towards a lamp (x right, y up, z to the viewer); may be repeated")
        ->allow_extra_args(false)
        ->take_all();
    command->add_option("--lights", relight_.lightsFile, "lamps with directions and colours, JSON");
    command->add_option("--environment", relight_.environment,
                        "lat-long environment map, HDR or EXR");
    command->add_option("--rotate", relight_.environmentOptions.rotationDegrees,
                        "turn the environment about the vertical, degrees");
    command
        ->add_option("--lamp-irradiance", relight_.environmentOptions.lampIrradiance,
                     "irradiance of the captured lamp in the map's units (default pi: a white "
                     "matte surface under the lamp has radiance 1)")
        ->check(CLI::PositiveNumber);
    command->add_option("--exposure", relight_.exposure, "factor for a PNG")
        ->check(CLI::PositiveNumber)
        ->capture_default_str();
    command->add_option("--out", relight_.out, "picture: .exr (linear) or .png (sRGB)")->required();
    command->callback([this] {
      const int kinds = (relight_.lamps.empty() ? 0 : 1) + (relight_.lightsFile.empty() ? 0 : 1) +
                        (relight_.environment.empty() ? 0 : 1);
      if (kinds != 1) {
        throw CLI::ValidationError("give exactly one of --light, --lights and --environment");
      }
      action = [this](ProgressBar&, const std::stop_token&) { return relightJob(relight_); };
    });
  }

  void addValidate(CLI::App& app) {
    auto* command = add(app, "validate", "measure a model against captures that it has not seen",
                        "lightsketch validate vase --hold-out cells:8:4 --report vase-report");
    command->add_option("sketch", validate_.sketch, "the sketch")->required();
    command->add_option("--hold-out", validate_.holdOutRule,
                        "frames to measure on: every:8:4 (index modulo 8 is 4), cells:8:4 (whole "
                        "direction cells) or list:FILE");
    auto* model =
        command->add_option("--model", validate_.model,
                            "model made with the same --hold-out; without it one is made here");
    command->add_option("--environment", validate_.environment,
                        "environment map for the superposition check (default: a built-in sky)");
    command->add_option("--report", validate_.report, "folder for the report")->required();
    // How a model is to be made says nothing about one that is there.
    const std::size_t others = command->get_options().size();
    addCompressOptions(*command, validate_.compress);
    const auto options = command->get_options();
    for (std::size_t i = others; i < options.size(); ++i) options[i]->excludes(model);
    command->callback([this] {
      action = [this](ProgressBar& bar, const std::stop_token&) {
        return validateJob(validate_, bar);
      };
    });
  }

  void addCull(CLI::App& app) {
    auto* command = add(
        app, "cull",
        "find frames in somebody's shadow, with a brightness of their own or a wrong direction; "
        "drop or correct them",
        "lightsketch cull vase --report vase-cull\n  lightsketch cull vase --report vase-cull "
        "--apply\n  lightsketch cull vase --undo vase-cull/cull.json");
    command->add_option("sketch", cull_.sketch, "the sketch")->required();
    auto* report = command->add_option("--report", cull_.report,
                                       "folder for what was found: index.html and cull.json");
    command
        ->add_flag("--apply", cull_.apply,
                   "drop what is beyond help, correct brightness and directions, as events in the "
                   "journal; without it nothing is changed")
        ->needs(report);
    command
        ->add_option("--undo", cull_.undo,
                     "take back what an earlier --apply did; its cull.json says what")
        ->excludes("--apply")
        ->excludes(report);
    command->callback([this] {
      action = [this](ProgressBar& bar, const std::stop_token&) { return cullJob(cull_, bar); };
    });
  }

  void addDropAndRestore(CLI::App& app) {
    auto* drop = add(app, "drop", "take frames out of a sketch; their pictures stay on disk",
                     "lightsketch drop vase 17 18 --reason \"my sleeve\"");
    drop->add_option("sketch", drop_.sketch, "the sketch")->required();
    drop->add_option("frames", drop_.ids, "ids of the frames")->required();
    drop->add_option("--reason", drop_.reason, "why, for the journal")->required();
    drop->callback([this] {
      action = [this](ProgressBar&, const std::stop_token&) { return dropJob(drop_); };
    });
    auto* restore =
        add(app, "restore", "take dropped frames back in", "lightsketch restore vase 17 18");
    restore->add_option("sketch", drop_.sketch, "the sketch")->required();
    restore->add_option("frames", drop_.ids, "ids of the frames")->required();
    restore->callback([this] {
      action = [this](ProgressBar&, const std::stop_token&) { return restoreJob(drop_); };
    });
  }

  void addCheck(CLI::App& app) {
    auto* command =
        add(app, "check", "whether a sketch, model or camera model is whole; exit code 1 if not",
            "lightsketch check vase\n  lightsketch check vase --repair");
    command->add_option("file", check_.file, "sketch or file")->required();
    command->add_flag("--repair", check_.repair,
                      "make a sketch usable again without losing a whole frame; what is replaced "
                      "stays beside as NAME.damaged");
    command->callback([this] {
      action = [this](ProgressBar& bar, const std::stop_token&) -> Result<JobResult> {
        ASSIGN_OR_RETURN(auto result, checkJob(check_, bar));
        if (const auto places = result.figures["damaged"].get<std::size_t>(); places > 0) {
          complaint = fmt::format(
              "{}: {} damaged place{}; mend with: lightsketch check {} --repair",
              check_.file.string(), places, places == 1 ? "" : "s", check_.file.string());
        }
        return result;
      };
    });
  }

  void addInfo(CLI::App& app) {
    auto* command = add(app, "info", "what a sketch, model, camera model or picture holds",
                        "lightsketch info vase");
    command->add_option("file", info_, "file or folder")->required();
    command->callback([this] {
      action = [this](ProgressBar&, const std::stop_token&) { return infoJob(info_); };
    });
  }

  void addDemo(CLI::App& app) {
    auto* command =
        add(app, "demo", "the whole job on the simulated rig", "lightsketch demo --out demo");
    command->add_option("--out", demo_.out, "a new folder, or that of a former demo")
        ->capture_default_str();
    command->add_option("--directions", demo_.directions, "light directions to cover")
        ->check(CLI::Range(64, 10'000))
        ->capture_default_str();
    addRigOptions(*command, demo_.rig);
    command->callback([this] {
      action = [this](ProgressBar& bar, const std::stop_token& stop) {
        return demoJob(demo_, bar, stop);
      };
    });
  }

  void addBench(CLI::App& app) {
    auto* command =
        add(app, "bench", "measure this machine, and the engine against what the machine allows",
            "lightsketch bench --plot growth.svg");
    command->add_flag("--quick", bench_.quick,
                      "small pictures and few lights: whether all works, no figures to quote");
    command->add_option("--plot", bench_.plot,
                        "SVG of how time and memory grow with lights and with pixels");
    command->callback([this] {
      action = [this](ProgressBar& bar, const std::stop_token&) { return benchJob(bench_, bar); };
    });
  }

  RigJob rig_;
  RecordJob record_;
  ImportOptions import_;
  ExportJob export_;
  CompressJob compress_;
  RelightJob relight_;
  ValidateJob validate_;
  CullJob cull_;
  DropJob drop_;
  CheckJob check_;
  std::filesystem::path info_;
  DemoJob demo_;
  BenchJob bench_;
  std::optional<CalibrateCommands> calibrate_;
};

// One line, whatever a hostile file made the message quote.
int fail(std::string message) {
  std::replace_if(
      message.begin(), message.end(), [](unsigned char c) { return c < ' ' || c == 0x7f; }, '?');
  fmt::print(stderr, "lightsketch: {}\n", message);
  return 1;
}

int run(int argc, char** argv) {
  CLI::App app(
      "Wave a lamp around a scene for a few minutes; get a picture that can be lit by anything, "
      "with "
      "its error measured.\n\nThe usual way: record (or import), compress, relight, validate. "
      "`lightsketch COMMAND --help` explains each.",
      "lightsketch");
  app.set_version_flag("--version", kSoftware);
  app.require_subcommand(1);
  app.fallthrough(false);
  Commands commands(app);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }

  FLAGS_minloglevel = google::GLOG_FATAL;  // Ceres warns of steps that it then mends itself
  std::signal(SIGINT, onInterrupt);
  std::signal(SIGTERM, onInterrupt);
  std::signal(SIGPIPE, SIG_IGN);
  std::signal(SIGXFSZ, SIG_IGN);
  Result<JobResult> result = [&] {
    const InterruptWatch watch;
    ProgressBar bar(commands.common.quiet, interrupted);
    return commands.action(bar, watch.token());
  }();
  if (!result) return fail(result.error().message);
  if (!commands.common.jsonFile.empty()) {
    const auto written = writeJsonFile(commands.common.jsonFile, result->figures);
    if (!written) return fail(written.error().message);
  }
  fmt::print("{}\n", result->text);
  return commands.complaint.empty() ? 0 : fail(commands.complaint);
}

}  // namespace
}  // namespace lightsketch

int main(int argc, char** argv) {
  try {
    return lightsketch::run(argc, argv);
  } catch (const std::exception& error) {
    return lightsketch::fail(fmt::format("internal error: {}", error.what()));
  }
}
