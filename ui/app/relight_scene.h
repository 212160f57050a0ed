// What the relight page draws, without any widget: a model ready for light, lamps that go round,
// the path of a lamp, the screen's tone curve, films.
#pragma once

#include <QImage>
#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/illumination/soft_lamps.h"
#include "pipeline/job/jobs.h"
#include "pipeline/relight/relighter.h"
#include "pipeline/sketch/sketch.h"

namespace lightsketch {

// A model and what lights it. Immutable but for the relighter's light; the rest may be read from
// any thread.
struct RelightScene {
  static Result<std::shared_ptr<RelightScene>> load(const std::filesystem::path& path);

  // Lamps as intensities, also of a single-lamp model, which takes the first one as a point.
  LightIntensities intensitiesOf(std::span<const DiscLamp> lamps) const;
  int width() const { return model->layout.width; }
  int height() const { return model->layout.height; }

  std::filesystem::path file;
  std::shared_ptr<const RelightableModel> model;
  DirectionInterpolator interpolator;
  SoftLamps lamps;
  Relighter relighter;
};

// How radiance becomes what the screen shows: sRGB, clipped, or with highlights rolled off smoothly
// from half of white on.
enum class Tone { kPlain, kSoft };
float toneMapped(float radiance, Tone tone);

// Draws in 8 bits: BGRA, rows of strideBytes, as Relighter::renderBgra8 demands. The soft tone goes
// by half floats and a table, over all cores.
class ScreenRenderer {
 public:
  void render(const Relighter& relighter, Tone tone, const RenderOptions& options,
              std::span<std::byte> pixels, std::size_t strideBytes);

 private:
  std::vector<std::byte> halves_;
  std::vector<std::uint8_t> codeOf_;  // of a half float's bits
};

// A linear picture as the screen shows it.
QImage screenImage(const RadianceImage& picture, float exposure, Tone tone);

// The exposure that puts the brightest hundredth of the picture (the largest of its colours) at
// nine tenths of white. 1 for a black picture.
float autoExposure(const Relighter& relighter);

// Lamps after going round the scene's axis for so long: the first one turn in kOrbitSeconds, the
// second as fast the other way, the next two twice as fast, so that after kOrbitSeconds all stand
// where they began.
inline constexpr double kOrbitSeconds = 16;
void orbit(std::span<DiscLamp> lamps, double seconds);

// A lamp that moves along directions in time.
class LightPath {
 public:
  struct Point {
    double seconds = 0;
    DirectionalLamp lamp = {};
  };
  LightPath() = default;
  // The lamp's way while the sketch was recorded, pauses cut to one second; the frames of sets
  // without times follow each other in kStep seconds. Empty for less than two frames.
  static LightPath ofSketch(const Sketch& sketch);
  // The lamps of a lights file, one after the other.
  static LightPath ofLamps(std::span<const DirectionalLamp> lamps);

  static constexpr double kStep = 0.5;
  bool empty() const { return points_.empty(); }
  const std::vector<Point>& points() const { return points_; }
  double seconds() const { return points_.empty() ? 0 : points_.back().seconds; }
  // Along the great circle between two points; clamped at both ends.
  DirectionalLamp at(double seconds) const;

 private:
  std::vector<Point> points_;
};

// A light that changes, to be saved: intensitiesAt(t) from 0 to seconds, called on any one thread.
struct Film {
  double seconds = 0;
  std::function<LightIntensities(double)> intensitiesAt;
};

// Writes frame-0001.png and so on into a new folder, which appears when all of them are there.
struct FilmJob {
  std::shared_ptr<const RelightableModel> model;
  Film film;
  double framesPerSecond = 30;
  float exposure = 1;
  Tone tone = Tone::kPlain;
  std::filesystem::path out;
};
Result<JobResult> filmJob(const FilmJob& job, Progress& progress);

// Saves one picture: .exr linear, without exposure and tone; .png as the screen shows it.
Result<JobResult> savePictureJob(const RelightableModel& model, const LightIntensities& light,
                                 float exposure, Tone tone, const std::filesystem::path& out);

}  // namespace lightsketch
