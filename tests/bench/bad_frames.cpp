// Bad frames found and put right or taken out: faults injected into a tenth of a rendered set like
// the rig's and of DiLiGenT's cat, and the real shadows of a hand-held capture. PSNR on clean
// held-out frames: of the clean set, of the faulty one, and after the check.
//
//   bench_bad_frames [PICTURE.png]    the picture: what was found in the hand-held capture
#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <numbers>
#include <numeric>
#include <random>
#include <string>
#include <vector>

#include "capture/frame/direction.h"
#include "capture/rig/scene_view.h"
#include "pipeline/compress/compress.h"
#include "pipeline/compress/hold_out.h"
#include "pipeline/illumination/illumination.h"
#include "pipeline/illumination/light_grid.h"
#include "pipeline/relight/relighter.h"
#include "pipeline/sketch/image_file.h"
#include "pipeline/sketch/import.h"
#include "pipeline/sketch/lp.h"
#include "pipeline/validate/frame_check.h"
#include "pipeline/validate/metrics.h"

using namespace lightsketch;
using Eigen::Vector3d;
namespace fs = std::filesystem;

namespace {

template <class T>
T orStop(Result<T> result, const char* what) {
  if (result) return std::move(*result);
  fmt::print(stderr, "bad_frames: {}: {}\n", what, result.error().message);
  std::exit(1);
}

struct Set {
  std::vector<Vector3d> directions;
  std::vector<RadianceImage> images;

  std::size_t size() const { return images.size(); }
  LightStack stack() const {
    return LightStack::of(
        images[0].width(), images[0].height(), directions,
        [this](int i) -> Result<RadianceImage> { return images[static_cast<std::size_t>(i)]; });
  }
  template <class Keep>
  Set where(Keep keep) const {
    Set part;
    for (std::size_t i = 0; i < size(); ++i) {
      if (!keep(i)) continue;
      part.directions.push_back(directions[i]);
      part.images.push_back(images[i]);
    }
    return part;
  }
};

RadianceImage halved(const RadianceImage& image) {
  RadianceImage small(image.width() / 2, image.height() / 2, 3);
  for (int y = 0; y < small.height(); ++y) {
    for (int x = 0; x < small.width(); ++x) {
      for (int c = 0; c < 3; ++c) {
        small(x, y, c) = 0.25f * (image(2 * x, 2 * y, c) + image(2 * x + 1, 2 * y, c) +
                                  image(2 * x, 2 * y + 1, c) + image(2 * x + 1, 2 * y + 1, c));
      }
    }
  }
  return small;
}

// --- The sets ---------------------------------------------------------------------------------

class HeldLamp final : public LampMotion {
 public:
  void advanceTo(double) override {}
  LampState at(double) const override { return state; }
  LampState state;
};

// The rig's still life under a hand-held lamp: off the grid by a degree or so, its distance off by
// 2 % (its brightness by 4 %).
Set renderedSet() {
  HeldLamp lamp;
  const Room room;
  const auto stillLife = orStop(StillLife::load({}), "still life");
  SceneView view(stillLife, room, lamp, 1);
  const RadianceImage dark = view.render(0, 0.02);
  const LightGrid grid = orStop(LightGrid::create(296), "grid");
  std::mt19937 random(5);
  std::normal_distribution<double> gaussian;
  Set set;
  lamp.state.lit = true;
  for (const Vector3d& node : grid.directions()) {
    if (node.z() < 0.1) continue;
    const Vector3d jitter(gaussian(random), gaussian(random), gaussian(random));
    const Vector3d direction = (node + 0.02 * jitter).normalized();
    lamp.state.position =
        kLampDistanceMetres * (1 + std::clamp(0.02 * gaussian(random), -0.08, 0.08)) * direction;
    RadianceImage picture = view.render(0, 0.02);
    for (std::size_t k = 0; k < picture.size(); ++k) picture.data()[k] -= dark.data()[k];
    set.directions.push_back(direction);
    set.images.push_back(halved(picture));
  }
  return set;
}

Set listedSet(const fs::path& folder, bool halve) {
  SilentProgress quiet;
  const LightList list = orStop(readLightList(folder, std::nullopt, std::nullopt, quiet), "list");
  double mean = 0;
  for (const auto& entry : list.entries) {
    if (entry.intensity)
      mean += std::accumulate(entry.intensity->begin(), entry.intensity->end(), 0.0);
  }
  mean /= 3 * static_cast<double>(list.entries.size());
  Set set;
  for (const auto& entry : list.entries) {
    RadianceImage image = orStop(
        readImage(entry.file, list.diligent ? TransferFunction::kLinear : TransferFunction::kSrgb),
        "image");
    if (entry.intensity) {
      for (std::size_t k = 0; k < image.size(); ++k) {
        image.data()[k] *= static_cast<float>(mean / (*entry.intensity)[k % 3]);
      }
    }
    set.directions.push_back(entry.direction);
    set.images.push_back(halve ? halved(image) : std::move(image));
  }
  return set;
}

// --- The faults -------------------------------------------------------------------------------

// A soft dark band, as of an arm, over about `part` of the picture.
void castShadow(RadianceImage& image, double part, std::mt19937& random) {
  std::uniform_real_distribution<double> uniform;
  const double turn = uniform(random) * 2 * std::numbers::pi;
  const double offset = 0.3 * (uniform(random) - 0.5);
  const double depth = 0.7 + 0.25 * uniform(random);
  constexpr double kSoft = 0.015;
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) {
      const double across = std::cos(turn) * (static_cast<double>(x) / image.width() - 0.5) +
                            std::sin(turn) * (static_cast<double>(y) / image.height() - 0.5);
      const double inside = 1 / (1 + std::exp((std::abs(across - offset) - part / 2) / kSoft));
      for (int c = 0; c < 3; ++c) image(x, y, c) *= static_cast<float>(1 - depth * inside);
    }
  }
}

// A third each, among the frames that may be spoilt.
std::vector<FrameFault> injectFaults(Set& set, const std::vector<std::size_t>& candidates,
                                     std::size_t count, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> uniform;
  std::vector<std::size_t> order = candidates;
  std::shuffle(order.begin(), order.end(), random);
  std::vector<FrameFault> truth(set.size(), FrameFault::kNone);
  for (std::size_t k = 0; k < count; ++k) {
    const std::size_t i = order[k];
    RadianceImage& image = set.images[i];
    if (k % 3 == 0) {
      truth[i] = FrameFault::kShadow;
      castShadow(image, 0.15 + 0.35 * uniform(random), random);
    } else if (k % 3 == 1) {
      truth[i] = FrameFault::kDirection;
      Vector3d& direction = set.directions[i];
      const Vector3d u = direction.unitOrthogonal();
      const double turn = uniform(random) * 2 * std::numbers::pi;
      const Vector3d axis = std::cos(turn) * u + std::sin(turn) * direction.cross(u);
      direction = Eigen::AngleAxisd(Angle::degrees(5).radians(), axis) * direction;
    } else {
      truth[i] = FrameFault::kExposure;
      const double gain =
          uniform(random) < 0.5 ? 0.6 + 0.2 * uniform(random) : 1.25 + 0.45 * uniform(random);
      for (float& value : image.values()) value *= static_cast<float>(gain);
    }
  }
  return truth;
}

// What `lightsketch cull --apply` would leave.
Set culled(const Set& set, const FrameCheck& check) {
  Set result = set.where([&](std::size_t i) {
    return check.frames[i].fault == FrameFault::kNone || check.frames[i].correctable;
  });
  std::size_t to = 0;
  for (const FrameVerdict& verdict : check.frames) {
    if (verdict.fault != FrameFault::kNone && !verdict.correctable) continue;
    if (verdict.fault == FrameFault::kDirection) result.directions[to] = verdict.fitted;
    if (verdict.fault == FrameFault::kExposure) {
      for (float& value : result.images[to].values()) value /= static_cast<float>(verdict.gain);
    }
    ++to;
  }
  return result;
}

// --- Figures ----------------------------------------------------------------------------------

// A model of `training`, PSNR of each held-out frame in 8-bit sRGB at one exposure.
std::vector<double> heldOutPsnr(const Set& training, const Set& heldOut, float exposure) {
  CompressOptions options;
  options.blockRank = 32;
  options.rank = 300;
  SilentProgress quiet;
  const auto compressed = orStop(compress(training.stack(), options, quiet), "compress");
  const auto interpolator = orStop(interpolatorFor(compressed.model), "interpolator");
  std::vector<double> psnr;
  for (std::size_t i = 0; i < heldOut.size(); ++i) {
    const DirectionalLamp lamp{heldOut.directions[i], Vector3d::Ones()};
    const RadianceImage picture = orStop(
        relight(compressed.model, intensitiesOf(std::vector{lamp}, interpolator)), "relight");
    psnr.push_back(psnr8(toSrgb8(picture, exposure), toSrgb8(heldOut.images[i], exposure)));
  }
  return psnr;
}

double mean(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
}

FrameCheck check(const Set& set) {
  SilentProgress quiet;
  return orStop(checkFrames(set.stack(), {}, quiet), "check");
}

// So that a hundredth of the values is white or beyond.
float exposureOf(const Set& set) {
  std::vector<float> values;
  for (const auto& image : set.images) {
    for (std::size_t k = 0; k < image.size(); k += 101) values.push_back(image.data()[k]);
  }
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(values.size() * 99 / 100);
  std::nth_element(values.begin(), at, values.end());
  return 1 / *at;
}

void injected(const char* name, const Set& set, int seeds) {
  const auto isHeldOut = [](std::size_t i) { return i % 8 == 4; };
  const Set heldOut = set.where(isHeldOut);
  const Set clean = set.where([&](std::size_t i) { return !isHeldOut(i); });
  const float exposure = exposureOf(set);
  const double cleanPsnr = mean(heldOutPsnr(clean, heldOut, exposure));
  const FrameCheck ofClean = check(clean);
  fmt::print("\n{}: {} frames, {} held out; clean: {} false alarms, {:.2f} dB\n", name, set.size(),
             heldOut.size(), ofClean.bad().size(), cleanPsnr);
  fmt::print(
      "seed  shadow  direction  exposure  recall  precision  gain off  degrees off   faulty  "
      " culled  against clean\n");
  int found = 0, faults = 0, alarms = 0;
  double worst = 0;
  for (int seed = 1; seed <= seeds; ++seed) {
    Set faulty = clean;
    std::vector<std::size_t> all(faulty.size());
    std::iota(all.begin(), all.end(), std::size_t{0});
    const auto truth = injectFaults(faulty, all, set.size() / 10, static_cast<unsigned>(seed));
    const FrameCheck result = check(faulty);
    std::array<std::array<int, 2>, 5> per{};
    int falseAlarms = 0;
    std::vector<double> degrees;
    std::vector<double> gains;
    for (std::size_t i = 0; i < truth.size(); ++i) {
      const FrameVerdict& verdict = result.frames[i];
      const bool bad = verdict.fault != FrameFault::kNone;
      if (truth[i] == FrameFault::kNone) {
        falseAlarms += bad;
        continue;
      }
      ++per[static_cast<std::size_t>(truth[i])][1];
      per[static_cast<std::size_t>(truth[i])][0] += bad;
      if (verdict.correctable && truth[i] == FrameFault::kDirection) {
        degrees.push_back(angleBetween(verdict.fitted, clean.directions[i]).degrees());
      }
      if (verdict.correctable && truth[i] == FrameFault::kExposure) {
        const auto largest = std::max_element(clean.images[i].data(),
                                              clean.images[i].data() + clean.images[i].size()) -
                             clean.images[i].data();
        const double gain = faulty.images[i].data()[largest] / clean.images[i].data()[largest];
        gains.push_back(std::abs(verdict.gain / gain - 1));
      }
    }
    const auto medianOf = [](std::vector<double> values) {
      if (values.empty()) return NAN;
      std::ranges::sort(values);
      return static_cast<float>(values[values.size() / 2]);
    };
    int seedFound = 0, seedFaults = 0;
    for (const auto& [hit, of] : per) {
      seedFound += hit;
      seedFaults += of;
    }
    const double faultyPsnr = mean(heldOutPsnr(faulty, heldOut, exposure));
    const double culledPsnr = mean(heldOutPsnr(culled(faulty, result), heldOut, exposure));
    fmt::print(
        "{:4}  {:>6}  {:>9}  {:>8}  {:6.2f}  {:9.2f}  {:7.1f}%  {:11.2f}  {:6.2f}  {:7.2f}  "
        "{:+13.2f}\n",
        seed, fmt::format("{}/{}", per[1][0], per[1][1]),
        fmt::format("{}/{}", per[3][0], per[3][1]), fmt::format("{}/{}", per[2][0], per[2][1]),
        seedFound / static_cast<double>(seedFaults),
        seedFound / static_cast<double>(std::max(1, seedFound + falseAlarms)),
        100 * medianOf(gains), medianOf(degrees), faultyPsnr, culledPsnr, culledPsnr - cleanPsnr);
    std::fflush(stdout);
    found += seedFound;
    faults += seedFaults;
    alarms += falseAlarms;
    worst = std::min(worst, culledPsnr - cleanPsnr);
  }
  fmt::print(
      "all   recall {:.3f} (bar 0.90)  precision {:.3f} (bar 0.80)  worst against clean {:+.2f} dB "
      "(bar -0.20)\n",
      found / static_cast<double>(faults), found / static_cast<double>(found + alarms), worst);
}

// Thumbnails of up to 20 frames a line, a line each for shadow, exposure, direction, other and
// good.
void drawFound(const Set& set, const FrameCheck& result, const fs::path& path) {
  constexpr int kAcross = 20;
  const int width = set.images[0].width() / 2;
  const int height = set.images[0].height() / 2;
  Image<std::uint8_t> sheet(kAcross * width, 7 * height, 3);
  int line = 0;
  const std::pair<FrameFault, int> lines[] = {{FrameFault::kShadow, 3},
                                              {FrameFault::kExposure, 1},
                                              {FrameFault::kDirection, 1},
                                              {FrameFault::kNone, 2}};
  for (const auto& [fault, count] : lines) {
    std::vector<std::size_t> frames;
    for (std::size_t i = 0; i < set.size(); ++i) {
      if (result.frames[i].fault == fault) frames.push_back(i);
    }
    const std::size_t shown = std::min(frames.size(), static_cast<std::size_t>(kAcross * count));
    for (std::size_t k = 0; k < shown; ++k) {
      const auto picture = toSrgb8(halved(set.images[frames[k * frames.size() / shown]]));
      const int x = static_cast<int>(k) % kAcross * width;
      const int y = (line + static_cast<int>(k) / kAcross) * height;
      for (int v = 0; v < height; ++v) {
        std::ranges::copy(picture.row(v), sheet.row(y + v).begin() + 3 * x);
      }
    }
    line += count;
  }
  orStop(writePng(path, sheet).map([] { return 0; }), "picture");
}

void handHeld(const fs::path& folder, const fs::path& picture) {
  const Set set = listedSet(folder, false);
  const auto start = std::chrono::steady_clock::now();
  const FrameCheck ofAll = check(set);
  const double seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  fmt::print(
      "\nrelief_handheld: {} frames: {} in a shadow, {} brightness, {} direction, {} other; {:.0f} "
      "s\n",
      set.size(), ofAll.count(FrameFault::kShadow), ofAll.count(FrameFault::kExposure),
      ofAll.count(FrameFault::kDirection), ofAll.count(FrameFault::kOther), seconds);
  if (!picture.empty()) drawFound(set, ofAll, picture);

  // The rule needs a sketch: a hold-out by direction.
  const fs::path sketchFolder =
      fs::temp_directory_path() / fmt::format("lightsketch_bad_frames_{}", std::rand());
  ImportOptions import;
  import.folder = folder;
  import.out = sketchFolder;
  SilentProgress quiet;
  orStop(importSet(import, quiet), "import");
  const HoldOut holdOut =
      orStop(applyHoldOut(orStop(Sketch::open(sketchFolder), "sketch"), "cells:8:4"), "hold-out");
  fs::remove_all(sketchFolder);
  const auto among = [](const std::vector<int>& ids) {
    return
        [&ids](std::size_t i) { return std::ranges::find(ids, static_cast<int>(i)) != ids.end(); };
  };
  const Set training = set.where(among(holdOut.training));
  const Set heldOut = set.where(among(holdOut.heldOut));
  // Only what the model may see decides what it is made from.
  const FrameCheck ofTraining = check(training);
  const auto with = heldOutPsnr(training, heldOut, 1);
  const auto without = heldOutPsnr(culled(training, ofTraining), heldOut, 1);
  const Set dropped = training.where(
      [&](std::size_t i) { return ofTraining.frames[i].fault == FrameFault::kNone; });
  const auto droppedOnly = heldOutPsnr(dropped, heldOut, 1);
  std::vector<double> good[3];
  for (std::size_t i = 0; i < with.size(); ++i) {
    if (ofAll.frames[static_cast<std::size_t>(holdOut.heldOut[i])].fault != FrameFault::kNone)
      continue;
    good[0].push_back(with[i]);
    good[1].push_back(without[i]);
    good[2].push_back(droppedOnly[i]);
  }
  fmt::print("cells:8:4, {} training frames of which {} bad, {} held out of which {} good\n",
             training.size(), ofTraining.bad().size(), heldOut.size(), good[0].size());
  fmt::print("PSNR of identical held-out frames, dB      all   good ones\n");
  fmt::print("  all training frames                   {:6.2f}      {:6.2f}\n", mean(with),
             mean(good[0]));
  fmt::print("  culled (dropped and corrected)        {:6.2f}      {:6.2f}\n", mean(without),
             mean(good[1]));
  fmt::print("  every bad frame dropped               {:6.2f}      {:6.2f}\n", mean(droppedOnly),
             mean(good[2]));
}

}  // namespace

int main(int argc, char** argv) {
  const fs::path data = fs::path(LIGHTSKETCH_SOURCE_DIR) / "../shared/data/rti";
  if (fs::exists(data / "relief_handheld")) {
    handHeld(data / "relief_handheld", argc > 1 ? argv[1] : "");
  } else {
    fmt::print("{}: not here, skipped\n", (data / "relief_handheld").string());
  }
  if (fs::exists(data / "diligent_cat")) {
    injected("DiLiGenT cat", listedSet(data / "diligent_cat", true), 5);
  } else {
    fmt::print("{}: not here, skipped\n", (data / "diligent_cat").string());
  }
  injected("the rig's still life, rendered", renderedSet(), 5);
}
