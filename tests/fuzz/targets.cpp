#include "tests/fuzz/targets.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include "calibration/lens/camera_formats.h"
#include "calibration/lens/foreign_lens.h"
#include "calibration/lens/mrcal_spline.h"
#include "calibration/model/camera_model.h"
#include "calibration/model/rig_geometry.h"
#include "calibration/model/sensor_model.h"
#include "calibration/radiometry/response_file.h"
#include "capture/device/gvcp_probe.h"
#include "capture/device/replay_camera.h"
#include "capture/frame/file.h"
#include "capture/frame/json.h"
#include "capture/frame/progress.h"
#include "pipeline/compress/hold_out.h"
#include "pipeline/illumination/illumination.h"
#include "pipeline/sketch/image_file.h"
#include "pipeline/sketch/lp.h"
#include "pipeline/sketch/sketch.h"
#include "tests/fuzz/scratch.h"

namespace lightsketch::fuzz {

void demand(bool holds, const char* what) {
  if (holds) return;
  std::fprintf(stderr, "fuzz: broken promise: %s\n", what);
  std::abort();
}

namespace {

// Inputs of several files are cut at lines that read "%%".
std::vector<std::string_view> partsOf(std::string_view input) {
  constexpr std::string_view kCut = "\n%%\n";
  std::vector<std::string_view> parts;
  for (;;) {
    const auto end = input.find(kCut);
    parts.push_back(input.substr(0, end));
    if (end == input.npos) return parts;
    input.remove_prefix(end + kCut.size());
  }
}

std::string_view partOr(const std::vector<std::string_view>& parts, std::size_t index,
                        std::string_view otherwise) {
  return index < parts.size() ? parts[index] : otherwise;
}

template <class T>
void demandMessage(const Result<T>& result) {
  demand(result || !result.error().message.empty(), "a failure says why");
}

// --- Lists of lights -----------------------------------------------------------------------------

const Scratch& folderOfImages() {
  static const Scratch scratch;
  static const bool filled = [] {
    for (const char* name : {"a.png", "b.png", "c d.png"}) scratch.write(name, "");
    return true;
  }();
  demand(filled, "images to be listed");
  return scratch;
}

bool checkList(const Result<LightList>& list, const std::filesystem::path& folder) {
  demandMessage(list);
  if (!list) return false;
  for (const LightListEntry& entry : list->entries) {
    demand(std::abs(entry.direction.norm() - 1) < 1e-9, "light directions are of unit length");
    demand(std::filesystem::is_regular_file(entry.file), "listed images exist");
    for (const double value : entry.intensity.value_or(std::array<double, 3>{1, 1, 1})) {
      demand(value > 0 && std::isfinite(value), "intensities are positive");
    }
  }
  demand(!list->entries.empty(), folder.c_str());
  return true;
}

bool runLp(std::string_view input) {
  const Scratch& scratch = folderOfImages();
  const auto parts = partsOf(input);
  scratch.write("list.lp", parts[0]);
  scratch.write("strengths.txt", partOr(parts, 1, ""));
  SilentProgress progress;
  return checkList(
      readLightList(scratch.path(), scratch / "list.lp",
                    parts.size() > 1 ? std::optional(scratch / "strengths.txt") : std::nullopt,
                    progress),
      scratch.path());
}

bool runDiligent(std::string_view input) {
  static const Scratch scratch;
  const auto parts = partsOf(input);
  scratch.write("001.png", "");
  scratch.write("002.png", "");
  scratch.write("light_directions.txt", parts[0]);
  scratch.write("filenames.txt", partOr(parts, 1, "001.png\n002.png\n"));
  scratch.write("light_intensities.txt", partOr(parts, 2, "1 1 1\n1 1 1\n"));
  SilentProgress progress;
  return checkList(readLightList(scratch.path(), std::nullopt, std::nullopt, progress),
                   scratch.path());
}

// --- Sketches ------------------------------------------------------------------------------------

constexpr std::string_view kManifest = R"({"format": "lightsketch-sketch", "formatVersion": 1,
"views": [{"projection": "perspective", "width": 8, "height": 6}],
"grid": {"directions": 64, "domain": "sphere"}, "ambientSubtracted": false, "software": "s",
"cameras": [], "provenance": {}})";

bool checkSketch(const Result<Sketch>& sketch) {
  demandMessage(sketch);
  if (!sketch) return false;
  const SketchManifest& manifest = sketch->manifest();
  demand(manifest.width > 0 && manifest.height > 0, "frames have a size");
  int next = 0;
  for (const FrameRecord& frame : sketch->frames()) {
    demand(frame.id == next++, "ids count from 0");
    demand(std::abs(frame.light.direction.norm() - 1) < 1e-6,
           "light directions are of unit length");
    const std::filesystem::path file(frame.file);
    demand(file.parent_path() == "frames" && file.filename() != "..", "frames lie in the sketch");
  }
  for (const int id : sketch->activeFrames()) demandMessage(sketch->readFrame(id));
  demandMessage(sketch->readAmbient());
  return true;
}

bool runSketch(std::string_view input) {
  static const Scratch scratch;
  const auto parts = partsOf(input);
  std::filesystem::create_directory(scratch / "frames");
  scratch.write("sketch.json", parts[0]);
  scratch.write("frames.jsonl", "");
  if (parts.size() > 1)
    scratch.write("rig.json", parts[1]);
  else
    std::filesystem::remove(scratch / "rig.json");
  return checkSketch(Sketch::open(scratch.path()));
}

// Lines get the checksum that they should have, so that the fuzzer gets behind it; those that begin
// with '!' stay as they are.
std::string sealed(std::string_view input) {
  std::string journal;
  while (!input.empty()) {
    const auto end = input.find('\n');
    std::string_view line = input.substr(0, end);
    if (line.starts_with('!')) {
      journal += line.substr(1);
    } else {
      if (line.ends_with('}')) line.remove_suffix(1);
      journal.append(line).append(",\"crc\":\"").append(checksum(line)).append("\"}");
    }
    if (end == input.npos) break;
    journal += '\n';
    input.remove_prefix(end + 1);
  }
  return journal;
}

bool runJournal(std::string_view input) {
  static const Scratch scratch;
  static const bool filled = [] {
    std::filesystem::create_directory(scratch / "frames");
    scratch.write("sketch.json", kManifest);
    return true;
  }();
  demand(filled, "a sketch");
  scratch.write("frames.jsonl", sealed(input));
  return checkSketch(Sketch::open(scratch.path()));
}

bool runRig(std::string_view input) {
  const auto json = parseJson(input, "rig.json");
  if (!json) return false;
  const auto rig = rigGeometryFromJson(*json, "rig.json");
  demandMessage(rig);
  if (!rig) return false;
  demand(rig->sceneCamera.sceneFromCamera.matrix().allFinite(), "poses are finite");
  demand(rigGeometryFromJson(rigGeometryToJson(*rig), "again").has_value(),
         "what was read can be written and read again");
  return true;
}

// --- Cameras -------------------------------------------------------------------------------------

void useLens(const CameraModel& model) {
  for (int i = 0; i < 24; ++i) {
    const double theta = 0.14 * i;
    const Eigen::Vector3d direction(std::sin(theta) * std::cos(i), std::sin(theta) * std::sin(i),
                                    std::cos(theta));
    (void)model.covers(direction);
    (void)model.directionCovariance(direction);
    if (const auto pixel = model.project(direction)) {
      if (const auto back = model.unproject(*pixel)) {
        demand(std::abs(back->norm() - 1) < 1e-6, "rays are of unit length");
      }
    }
  }
  (void)model.unproject({0.5, 0.5});
}

bool runCamera(std::string_view input) {
  const auto json = parseJson(input, "camera.json");
  if (!json) return false;
  const auto model = cameraModelFromJson(*json, "camera.json");
  demandMessage(model);
  if (!model) return false;
  useLens(**model);
  demand(cameraModelFromJson(cameraModelToJson(**model), "again").has_value(),
         "what was read can be written and read again");
  return true;
}

bool runForeignCamera(std::string_view input) {
  const auto lens = parseForeignLens(std::string(input), "camera.yaml");
  demandMessage(lens);
  if (!lens) return false;
  for (int i = 0; i < 24; ++i) {
    const double theta = 0.13 * i;
    (void)lens->project(
        {std::sin(theta) * std::cos(i), std::sin(theta) * std::sin(i), std::cos(theta)});
  }
  return true;
}

// The same all the way to a lens of ours, fits included.
bool runCameraConversion(std::string_view input) {
  static const Scratch scratch;
  scratch.write("camera", input);
  const auto camera = loadAnyCameraModel(scratch / "camera");
  demandMessage(camera);
  if (!camera) return false;
  useLens(*camera->model);
  return true;
}

bool runResponse(std::string_view input) {
  static const Scratch scratch;
  scratch.write("response.json", input);
  const auto sensor = loadResponse(scratch / "response.json");
  demandMessage(sensor);
  if (!sensor) return false;
  for (int colour = 0; colour < sensor->response.colours(); ++colour) {
    for (const double count : {-10.0, 0.0, 1.0, 100.0, sensor->response.maxCount(), 1e9}) {
      (void)sensor->response.exposure(count, colour);
      (void)sensor->response.slope(count, colour);
      (void)sensor->noise.countVariance(count, sensor->response, colour);
    }
    (void)sensor->response.blackCount(colour);
    if (sensor->flatField) (void)sensor->flatField->sensitivity(0.3, 0.7, colour);
  }
  for (const PixelPosition& pixel : sensor->hotPixels) {
    demand(pixel.x >= 0 && pixel.x < sensor->width && pixel.y >= 0 && pixel.y < sensor->height,
           "hot pixels lie in the picture");
  }
  return true;
}

bool runBracket(std::string_view input) {
  static const Scratch scratch;
  static const bool filled = [] {
    for (const char* name : {"a.png", "b.png", "c.png"}) {
      if (!writePng(scratch / name, Image<std::uint8_t>(4, 3, 1, 100))) return false;
    }
    return true;
  }();
  demand(filled, "a bracket");
  scratch.write("times.txt", input);
  const auto frames = readBracketFolder(scratch.path());
  demandMessage(frames);
  if (!frames) return false;
  for (const Frame& frame : *frames) {
    demand(frame.metadata.exposureSeconds > 0 && std::isfinite(frame.metadata.exposureSeconds),
           "exposure times are positive");
  }
  return true;
}

bool runReplay(std::string_view input) {
  static const Scratch scratch;
  static const bool filled =
      writePng(scratch / "a.png", Image<std::uint8_t>(4, 3, 1, 100)).has_value();
  demand(filled, "a recorded stream");
  scratch.write("frames.jsonl", input);
  const auto camera = openReplayCamera(scratch.path(), 0);
  demandMessage(camera);
  return camera.has_value();
}

bool runDiscoveryAnswer(std::string_view input) {
  const std::span bytes(reinterpret_cast<const std::uint8_t*>(input.data()), input.size());
  const auto camera = parseDiscoveryAnswer(bytes, "127.0.0.1");
  if (!camera) return false;
  demand(camera->vendor.size() <= 32 && camera->model.size() <= 32 && camera->serial.size() <= 16,
         "names end with their registers");
  return true;
}

// --- What relighting and validation are told -----------------------------------------------------

bool runLights(std::string_view input) {
  static const Scratch scratch;
  scratch.write("lights.json", input);
  const auto lamps = readLights(scratch / "lights.json");
  demandMessage(lamps);
  if (!lamps) return false;
  demand(!lamps->empty(), "a lights file holds a light");
  for (const DirectionalLamp& lamp : *lamps) {
    demand(std::abs(lamp.direction.norm() - 1) < 1e-9 && lamp.colour.allFinite(),
           "lamps are finite, their directions of unit length");
  }
  return true;
}

// First line: the rule. The rest: the file that "list:" names.
bool runHoldOut(std::string_view input) {
  static const Scratch scratch;
  static const Sketch sketch = [] {
    SketchManifest manifest;
    manifest.width = manifest.height = 4;
    auto made = Sketch::create(scratch / "s", manifest).value();
    for (int i = 0; i < 12; ++i) {
      FrameRecord record;
      record.light.direction = {std::sin(0.1 * i), 0, std::cos(0.1 * i)};
      made.append(record, RadianceImage(4, 4, 3, 0.5f)).value();
    }
    return made;
  }();
  const auto end = std::min(input.find('\n'), input.size());
  std::string rule(input.substr(0, end));
  scratch.write("list.txt", input.substr(std::min(end + 1, input.size())));
  if (rule.starts_with("list:")) rule = "list:" + (scratch / "list.txt").string();
  const auto split = applyHoldOut(sketch, rule);
  demandMessage(split);
  if (!split) return false;
  for (const auto* ids : {&split->training, &split->heldOut, &split->margin}) {
    for (const int id : *ids) demand(id >= 0 && id < 12, "frames that are there");
  }
  return true;
}

constexpr Target kTargets[] = {
    {"lp", runLp},
    {"diligent", runDiligent},
    {"sketch", runSketch},
    {"journal", runJournal},
    {"rig", runRig},
    {"camera", runCamera},
    {"foreign_camera", runForeignCamera},
    {"camera_conversion", runCameraConversion},
    {"response", runResponse},
    {"bracket", runBracket},
    {"replay", runReplay},
    {"discovery_answer", runDiscoveryAnswer},
    {"lights", runLights},
    {"hold_out", runHoldOut},
    {"model", runModel, true},
    {"exr", runExr, true},
};

}  // namespace

std::span<const Target> targets() { return kTargets; }

const Target* findTarget(std::string_view name) {
  const auto found = std::ranges::find(kTargets, name, &Target::name);
  return found == std::end(kTargets) ? nullptr : &*found;
}

}  // namespace lightsketch::fuzz
