#include "ui/app/relight_scene.h"

#include <tbb/parallel_for.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "capture/frame/direction.h"
#include "capture/frame/srgb.h"
#include "pipeline/compress/compress.h"
#include "pipeline/compress/model.h"
#include "pipeline/sketch/image_file.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;
using Eigen::Vector3d;

std::size_t index(std::ptrdiff_t value) { return static_cast<std::size_t>(value); }

}  // namespace

Result<std::shared_ptr<RelightScene>> RelightScene::load(const fs::path& path) {
  ASSIGN_OR_RETURN(auto loaded, loadModel(path));
  auto model = std::make_shared<const RelightableModel>(std::move(loaded));
  ASSIGN_OR_RETURN(const auto interpolator, interpolatorFor(*model));
  ASSIGN_OR_RETURN(const auto lamps, SoftLamps::create(model->lights, interpolator));
  ASSIGN_OR_RETURN(auto relighter, Relighter::create(model));
  return std::make_shared<RelightScene>(
      RelightScene{path, std::move(model), interpolator, lamps, std::move(relighter)});
}

LightIntensities RelightScene::intensitiesOf(std::span<const DiscLamp> all) const {
  if (!model->singleLamp) return lamps.intensitiesOf(all);
  if (!all.empty()) {
    if (auto one = singleLamp({all[0].direction, all[0].colour}, interpolator)) {
      return *std::move(one);
    }
  }
  return LightIntensities::Zero(model->lightCount(), 3);
}

float toneMapped(float radiance, Tone tone) {
  constexpr float kKnee = 0.5f;
  if (tone == Tone::kPlain || radiance <= kKnee) return radiance;
  return 1 - (1 - kKnee) * std::exp((kKnee - radiance) / (1 - kKnee));
}

void ScreenRenderer::render(const Relighter& relighter, Tone tone, const RenderOptions& options,
                            std::span<std::byte> pixels, std::size_t strideBytes) {
  if (tone == Tone::kPlain) return relighter.renderBgra8(pixels, strideBytes, options);
  const BlockLayout& layout = relighter.model().layout;
  if (codeOf_.empty()) {
    for (int bits = 0; bits < 65536; ++bits) {
      const auto half = Eigen::numext::bit_cast<Eigen::half>(static_cast<std::uint16_t>(bits));
      codeOf_.push_back(srgbEncode8(toneMapped(static_cast<float>(half), Tone::kSoft)));
    }
  }
  const std::size_t halfStride = index(layout.width) * 6;
  halves_.resize(halfStride * index(layout.height));
  relighter.renderHalf(halves_, halfStride, 3, options);
  const PixelRectangle all{0, 0, layout.width, layout.height};
  const PixelRectangle& shown = options.visible ? *options.visible : all;
  const int left = std::clamp(shown.x, 0, layout.width);
  const int right = std::clamp(shown.x + shown.width, left, layout.width);
  const int top = std::clamp(shown.y, 0, layout.height);
  const int bottom = std::clamp(shown.y + shown.height, top, layout.height);
  tbb::parallel_for(tbb::blocked_range<int>(top, bottom, 32), [&](const auto& rows) {
    for (int y = rows.begin(); y < rows.end(); ++y) {
      const auto* in =
          reinterpret_cast<const std::uint16_t*>(halves_.data() + index(y) * halfStride);
      auto* out = reinterpret_cast<std::uint8_t*>(pixels.data() + index(y) * strideBytes);
      for (int x = left; x < right; ++x) {
        out[4 * x] = codeOf_[in[3 * x + 2]];
        out[4 * x + 1] = codeOf_[in[3 * x + 1]];
        out[4 * x + 2] = codeOf_[in[3 * x]];
        out[4 * x + 3] = 255;
      }
    }
  });
}

QImage screenImage(const RadianceImage& picture, float exposure, Tone tone) {
  QImage image(picture.width(), picture.height(), QImage::Format_RGB32);
  tbb::parallel_for(0, picture.height(), [&](int y) {
    const float* in = picture.row(y).data();
    auto* out = reinterpret_cast<QRgb*>(image.bits() + y * image.bytesPerLine());
    for (int x = 0; x < picture.width(); ++x, in += 3) {
      const auto code = [&](float value) {
        return srgbEncode8(toneMapped(exposure * value, tone));
      };
      out[x] = qRgb(code(in[0]), code(in[1]), code(in[2]));
    }
  });
  return image;
}

float autoExposure(const Relighter& relighter) {
  RadianceImage picture(relighter.model().layout.width, relighter.model().layout.height, 3);
  // A tenth of the bases shows how bright a picture is.
  relighter.render(picture, {.share = 0.1f, .visible = {}});
  std::vector<float> brightest;
  const std::size_t pixels = picture.size() / 3;
  const std::size_t step = std::max<std::size_t>(1, pixels / 50021);  // some 50,000 of them
  for (std::size_t i = 0; i < pixels; i += step) {
    const float* rgb = picture.data() + 3 * i;
    brightest.push_back(std::max({rgb[0], rgb[1], rgb[2]}));
  }
  const auto rank = brightest.begin() + static_cast<std::ptrdiff_t>(brightest.size() * 99 / 100);
  std::nth_element(brightest.begin(), rank, brightest.end());
  return *rank > 1e-9f ? 0.9f / *rank : 1;
}

void orbit(std::span<DiscLamp> lamps, double seconds) {
  for (std::size_t i = 0; i < lamps.size(); ++i) {
    const double turns =
        (i % 2 == 0 ? 1 : -1) * static_cast<double>(i / 2 + 1) * seconds / kOrbitSeconds;
    lamps[i].direction =
        Eigen::AngleAxisd(2 * std::numbers::pi * turns, Vector3d::UnitZ()) * lamps[i].direction;
  }
}

LightPath LightPath::ofSketch(const Sketch& sketch) {
  constexpr double kLongestPause = 1;
  LightPath path;
  double before = 0;
  for (const int id : sketch.activeFrames()) {
    const FrameRecord& frame = sketch.frames()[index(id)];
    const double pause = frame.midExposureSeconds - before;
    before = frame.midExposureSeconds;
    const double step = pause > 0 ? std::min(pause, kLongestPause) : kStep;
    path.points_.push_back(
        {path.empty() ? 0 : path.seconds() + step, {frame.light.direction, Vector3d::Ones()}});
  }
  if (path.points_.size() < 2) path.points_.clear();
  return path;
}

LightPath LightPath::ofLamps(std::span<const DirectionalLamp> lamps) {
  LightPath path;
  for (const DirectionalLamp& lamp : lamps) {
    path.points_.push_back({path.empty() ? 0 : path.seconds() + kStep, lamp});
  }
  return path;
}

DirectionalLamp LightPath::at(double seconds) const {
  const auto after =
      std::upper_bound(points_.begin(), points_.end(), seconds,
                       [](double value, const Point& point) { return value < point.seconds; });
  if (after == points_.begin()) return points_.front().lamp;
  if (after == points_.end()) return points_.back().lamp;
  const Point& from = after[-1];
  const double part = (seconds - from.seconds) / (after->seconds - from.seconds);
  const Eigen::Quaterniond whole =
      Eigen::Quaterniond::FromTwoVectors(from.lamp.direction, after->lamp.direction);
  return {Eigen::Quaterniond::Identity().slerp(part, whole) * from.lamp.direction,
          (1 - part) * from.lamp.colour + part * after->lamp.colour};
}

namespace {

Image<std::uint8_t> screenPicture(const QImage& image) {
  Image<std::uint8_t> picture(image.width(), image.height(), 3);
  for (int y = 0; y < image.height(); ++y) {
    const auto* in = reinterpret_cast<const QRgb*>(image.constScanLine(y));
    std::uint8_t* out = picture.row(y).data();
    for (int x = 0; x < image.width(); ++x, out += 3) {
      out[0] = static_cast<std::uint8_t>(qRed(in[x]));
      out[1] = static_cast<std::uint8_t>(qGreen(in[x]));
      out[2] = static_cast<std::uint8_t>(qBlue(in[x]));
    }
  }
  return picture;
}

}  // namespace

Result<JobResult> filmJob(const FilmJob& job, Progress& progress) {
  if (fs::exists(job.out)) {
    return failure(ErrorCode::kInvalidArgument, "{}: exists already; choose another folder",
                   job.out.string());
  }
  ASSIGN_OR_RETURN(auto relighter, Relighter::create(job.model));
  const fs::path partial = job.out.string() + ".partial";
  std::error_code error;
  fs::remove_all(partial, error);
  fs::create_directories(partial, error);
  if (error) {
    return failure(ErrorCode::kIo, "{}: cannot be created: {}", partial.string(), error.message());
  }
  const auto frames = static_cast<int>(std::lround(job.film.seconds * job.framesPerSecond));
  RadianceImage picture(job.model->layout.width, job.model->layout.height, 3);
  const auto writeAll = [&]() -> Result<void> {
    for (int i = 0; i < frames; ++i) {
      progress.update("saving pictures", index(i), index(frames));
      if (progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
      RETURN_IF_ERROR(relighter.setLight(job.film.intensitiesAt(i / job.framesPerSecond)));
      relighter.render(picture);
      RETURN_IF_ERROR(writePng(partial / fmt::format("frame-{:04}.png", i + 1),
                               screenPicture(screenImage(picture, job.exposure, job.tone))));
    }
    return {};
  };
  if (auto written = writeAll(); !written) {
    fs::remove_all(partial, error);
    return tl::unexpected<Error>(std::move(written).error());
  }
  fs::rename(partial, job.out, error);
  if (error) {
    return failure(ErrorCode::kIo, "{}: cannot be renamed to {}: {}", partial.string(),
                   job.out.string(), error.message());
  }
  return JobResult{
      fmt::format("{}: {} pictures, {:g} a second", job.out.string(), frames, job.framesPerSecond),
      {{"out", job.out.string()}, {"frames", frames}}};
}

Result<JobResult> savePictureJob(const RelightableModel& model, const LightIntensities& light,
                                 float exposure, Tone tone, const fs::path& out) {
  ASSIGN_OR_RETURN(const auto picture, relight(model, light));
  if (out.extension() == ".exr") {
    RETURN_IF_ERROR(writeExr(out, picture));
  } else if (out.extension() == ".png") {
    RETURN_IF_ERROR(writePng(out, screenPicture(screenImage(picture, exposure, tone))));
  } else {
    return failure(ErrorCode::kInvalidArgument,
                   "{}: the picture must be .exr (linear) or .png (as on the screen)",
                   out.string());
  }
  return JobResult{fmt::format("{}: {} x {}", out.string(), picture.width(), picture.height()),
                   {{"out", out.string()}}};
}

}  // namespace lightsketch
