#include "pipeline/validate/frame_check_report.h"

#include <fmt/format.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <memory>
#include <mutex>
#include <optional>
#include <string_view>
#include <vector>

#include "capture/frame/html.h"
#include "capture/frame/srgb.h"
#include "pipeline/sketch/image_file.h"

namespace lightsketch {
namespace {

constexpr std::string_view kStyle = R"css(
:root { color-scheme: light dark; --paper: #ffffff; --panel: #f5f6f8; --ink: #1b1e23; --soft: #5c6470; --line: #dcdfe5; }
@media (prefers-color-scheme: dark) { :root { --paper: #14161a; --panel: #1d2026; --ink: #e7e9ed; --soft: #9aa3b0; --line: #333842; } }
body { margin: 0; background: var(--paper); color: var(--ink); font: 15px/1.55 system-ui, "Segoe UI", Roboto, "Noto Sans", "DejaVu Sans", sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 40px 28px 80px; }
h1 { font-size: 29px; line-height: 1.2; margin: 0 0 6px; }
h2 { font-size: 20px; margin: 44px 0 6px; padding-top: 14px; border-top: 1px solid var(--line); }
p { max-width: 76ch; }
.soft, figcaption, .triple div { color: var(--soft); }
.lead { font-size: 17px; }
.map { max-width: 560px; }
.map text { fill: var(--soft); font-size: 12.5px; }
.map .ring { fill: none; stroke: var(--line); }
.map .rim { fill: var(--panel); stroke: var(--soft); }
.map .good { fill: var(--ink); fill-opacity: 0.35; }
.map line { stroke-width: 1.6; }
figure { margin: 18px 0 24px; padding: 10px 12px 12px; border-radius: 10px; background: var(--panel); break-inside: avoid; }
figcaption { display: flex; flex-wrap: wrap; gap: 2px 18px; align-items: baseline; margin-bottom: 8px; }
figcaption strong { color: var(--ink); font-size: 16px; }
.triple { display: grid; grid-template-columns: repeat(3, 1fr); gap: 8px; font-size: 12.5px; }
.triple img { width: 100%; height: auto; display: block; border-radius: 4px; background: #000; image-rendering: pixelated; }
.chip { display: inline-block; width: 11px; height: 11px; border-radius: 50%; margin-right: 7px; vertical-align: -1px; }
:target { outline: 3px solid #1f5fbf; outline-offset: 2px; }
)css";

// ColorBrewer 2 Set1 without green: told apart by any eye.
const char* colourOf(FrameFault fault) {
  static constexpr const char* kColours[] = {"#888888", "#e41a1c", "#ff7f00", "#377eb8", "#984ea3"};
  return kColours[static_cast<int>(fault)];
}

// Lambert's azimuthal equal-area projection about +z; the whole sphere where lights are behind.
constexpr double kMapRadius = 230;
constexpr double kMapCentre = 250;
struct Map {
  double scale = 1;
  Eigen::Vector2d at(const Eigen::Vector3d& d) const {
    const double flat = std::hypot(d.x(), d.y());
    if (flat == 0) return {kMapCentre, kMapCentre};
    const double r = radius(std::atan2(flat, d.z()));
    return {kMapCentre + r * d.x() / flat, kMapCentre - r * d.y() / flat};
  }
  double radius(double angle) const {
    return scale * kMapRadius * std::sqrt(2.0) * std::sin(angle / 2);
  }
};

std::string mapOf(const FrameCheck& check) {
  const bool sphere = std::ranges::any_of(
      check.frames, [](const FrameVerdict& f) { return f.direction.z() < -0.05; });
  const Map map{sphere ? std::sqrt(0.5) : 1};
  std::string svg =
      "<svg viewBox=\"0 0 500 530\" role=\"img\" aria-label=\"the light directions\">\n";
  for (const int degrees : {180, 90, 60, 30}) {
    if (degrees > 90 && !sphere) continue;
    svg += fmt::format("<circle class=\"{}\" cx=\"{}\" cy=\"{}\" r=\"{:.1f}\"/>\n",
                       degrees == (sphere ? 180 : 90) ? "rim" : "ring", kMapCentre, kMapCentre,
                       map.radius(Angle::degrees(degrees).radians()));
  }
  for (const FrameVerdict& f : check.frames) {
    if (f.fault != FrameFault::kNone) continue;
    const Eigen::Vector2d p = map.at(f.direction);
    svg +=
        fmt::format("<circle class=\"good\" cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"2\"/>", p.x(), p.y());
  }
  for (const int i : check.bad()) {
    const FrameVerdict& f = check.frames[static_cast<std::size_t>(i)];
    const Eigen::Vector2d p = map.at(f.direction);
    const Eigen::Vector2d q = map.at(f.fitted);
    svg += fmt::format(
        "<a href=\"#frame-{}\"><circle cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"4.5\" fill=\"{}\">"
        "<title>frame {}: {}</title></circle></a>\n",
        f.id, p.x(), p.y(), colourOf(f.fault), f.id, htmlEscaped(f.reason()));
    if (f.fault == FrameFault::kDirection) {
      svg += fmt::format(
          "<line x1=\"{:.1f}\" y1=\"{:.1f}\" x2=\"{:.1f}\" y2=\"{:.1f}\" stroke=\"{}\"/>", p.x(),
          p.y(), q.x(), q.y(), colourOf(f.fault));
    }
  }
  double x = 20;
  for (const FrameFault fault : {FrameFault::kShadow, FrameFault::kExposure, FrameFault::kDirection,
                                 FrameFault::kOther, FrameFault::kNone}) {
    svg += fmt::format(
        "<circle cx=\"{}\" cy=\"515\" r=\"5\" fill=\"{}\"/><text x=\"{}\" "
        "y=\"519\">{} {}</text>",
        x, colourOf(fault), x + 9, nameOf(fault), check.count(fault));
    x += 97;
  }
  return svg + "\n</svg>\n";
}

// Block means.
RadianceImage shrunk(const RadianceImage& image, int factor) {
  RadianceImage small(image.width() / factor, image.height() / factor, 3);
  for (int y = 0; y < small.height(); ++y) {
    for (int x = 0; x < small.width(); ++x) {
      for (int c = 0; c < 3; ++c) {
        float sum = 0;
        for (int v = 0; v < factor; ++v) {
          for (int u = 0; u < factor; ++u) sum += image(x * factor + u, y * factor + v, c);
        }
        small(x, y, c) = sum / static_cast<float>(factor * factor);
      }
    }
  }
  return small;
}

// Luminance over prediction: white as predicted, blue darker, red brighter, full at a factor of 2;
// grey where both are dark.
Image<std::uint8_t> ratioPicture(const RadianceImage& captured, const RadianceImage& predicted,
                                 float exposure) {
  Image<std::uint8_t> picture(captured.width(), captured.height(), 3);
  for (int y = 0; y < picture.height(); ++y) {
    for (int x = 0; x < picture.width(); ++x) {
      float luma[2] = {0, 0};
      for (int c = 0; c < 3; ++c) {
        luma[0] += kRec709Luma[c] * captured(x, y, c);
        luma[1] += kRec709Luma[c] * predicted(x, y, c);
      }
      const float floor = 0.004f / exposure;
      const float t = std::clamp(
          std::log2((std::max(luma[0], 0.0f) + floor) / (std::max(luma[1], 0.0f) + floor)), -1.0f,
          1.0f);
      const auto fade = static_cast<std::uint8_t>(std::lround(255 * (1 - std::abs(t))));
      picture(x, y, 0) = t < 0 ? fade : std::uint8_t{255};
      picture(x, y, 1) = fade;
      picture(x, y, 2) = t > 0 ? fade : std::uint8_t{255};
    }
  }
  return picture;
}

struct Shown {
  int frame;
  RadianceImage captured;
  RadianceImage predicted;  // square roots until all frames were added; black without predictors
  std::mutex mutex;         // guards both
};

Result<std::string> imageTag(const Image<std::uint8_t>& picture, std::string_view what) {
  ASSIGN_OR_RETURN(const std::string png, encodePng(picture));
  return fmt::format(
      "<div><img width=\"{}\" height=\"{}\" alt=\"{}\" src=\"data:image/png;base64,{}\">{}</div>\n",
      picture.width(), picture.height(), what, base64(png), what);
}

// One pass over the stack: every image adds to the predictions that it is part of.
Result<void> draw(const LightStack& stack, const FrameCheck& check, int shrink,
                  std::vector<std::unique_ptr<Shown>>& shown, Progress& progress) {
  std::vector<std::vector<std::pair<Shown*, float>>> uses(check.frames.size());
  for (auto& s : shown) {
    s->predicted = RadianceImage(stack.width() / shrink, stack.height() / shrink, 3);
    uses[static_cast<std::size_t>(s->frame)].emplace_back(s.get(), 0.0f);
    for (const auto& [from, weight] : check.frames[static_cast<std::size_t>(s->frame)].prediction) {
      uses[static_cast<std::size_t>(from)].emplace_back(s.get(), static_cast<float>(weight));
    }
  }
  std::vector<std::optional<Error>> errors(check.frames.size());
  std::atomic<std::size_t> done = 0;
  tbb::parallel_for(std::size_t{0}, uses.size(), [&](std::size_t i) {
    progress.update("drawing the report", ++done, uses.size());
    if (uses[i].empty() || progress.cancelled()) return;
    const auto image = stack.read(static_cast<int>(i));
    if (!image) {
      errors[i] = image.error();
      return;
    }
    const RadianceImage small = shrunk(*image, shrink);
    for (const auto& [target, weight] : uses[i]) {
      const std::scoped_lock lock(target->mutex);
      if (target->frame == static_cast<int>(i)) {
        target->captured = small;
        continue;
      }
      for (std::size_t k = 0; k < small.size(); ++k) {
        target->predicted.data()[k] += weight * std::sqrt(std::max(0.0f, small.data()[k]));
      }
    }
  });
  if (progress.cancelled()) return failure(ErrorCode::kCancelled, "cancelled");
  for (auto& error : errors) {
    if (error) return tl::unexpected<Error>(std::move(*error));
  }
  for (auto& s : shown) {
    for (float& value : s->predicted.values())
      value = std::max(value, 0.0f) * std::max(value, 0.0f);
  }
  return {};
}

// So that 1 in 100 values of the predictions is brighter than 90 % grey.
float exposureFor(const std::vector<std::unique_ptr<Shown>>& shown) {
  std::vector<float> values;
  for (const auto& s : shown) {
    for (std::size_t k = 0; k < s->predicted.size(); k += 7) {
      values.push_back(s->predicted.data()[k]);
    }
  }
  if (values.empty()) return 1;
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(values.size() * 99 / 100);
  std::nth_element(values.begin(), at, values.end());
  return *at > 1e-6f ? srgbDecode(0.9f) / *at : 1.0f;
}

std::string evidence(const FrameVerdict& f) {
  std::string text = fmt::format(
      "<span>brightness &times;{:.2f} (z {:.1f})</span> <span>direction {:.1f}&deg; off, sigma "
      "{:.1f}&deg; (z {:.1f})</span> <span>shadow z {:.1f}</span> <span>rest z {:.1f}</span> "
      "<span>residual {:.4f}, after the fit {:.4f}</span>",
      f.gain, f.exposureScore, f.shift.degrees(), f.shiftSigma.degrees(), f.directionScore,
      f.shadowScore, f.residualScore, f.residual, f.residualFitted);
  return text;
}

}  // namespace

Result<std::vector<FrameCheckPictures>> frameCheckPictures(const LightStack& stack,
                                                           const FrameCheck& check,
                                                           const FrameCheckReportOptions& options,
                                                           Progress& progress) {
  const std::vector<int> bad = check.bad();
  std::vector<std::unique_ptr<Shown>> shown;
  for (const int i : bad) {
    if (static_cast<int>(shown.size()) == options.pictures) break;
    shown.push_back(std::make_unique<Shown>());
    shown.back()->frame = i;
  }
  const int shrink = std::max(1, (stack.width() + options.width - 1) / options.width);
  RETURN_IF_ERROR(
      draw(stack, check, std::min({shrink, stack.width(), stack.height()}), shown, progress));
  const float exposure = exposureFor(shown);
  std::vector<FrameCheckPictures> pictures;
  for (const auto& s : shown) {
    pictures.push_back({s->frame, toSrgb8(s->captured, exposure), toSrgb8(s->predicted, exposure),
                        ratioPicture(s->captured, s->predicted, exposure)});
  }
  return pictures;
}

Result<std::string> frameCheckPage(const LightStack& stack, const FrameCheck& check,
                                   const FrameCheckReportOptions& options, Progress& progress) {
  const std::vector<int> bad = check.bad();
  ASSIGN_OR_RETURN(const auto shown, frameCheckPictures(stack, check, options, progress));

  std::string page = fmt::format(
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n"
      "<title>Frames of {0}</title>\n<style>{1}</style>\n</head>\n<body>\n<main>\n"
      "<h1>Frames of &ldquo;{0}&rdquo; that do not fit</h1>\n"
      "<p class=\"lead\">{2} of {3} frames differ from what their neighbours say: {4} lie in a "
      "shadow, {5} have a brightness of their own, {6} a wrong direction, {7} something "
      "else.</p>\n<p>{8}</p>\n",
      htmlEscaped(options.title), kStyle, bad.size(), check.frames.size(),
      check.count(FrameFault::kShadow), check.count(FrameFault::kExposure),
      check.count(FrameFault::kDirection), check.count(FrameFault::kOther),
      htmlEscaped(options.action));
  page += "<h2>Where their light came from</h2>\n<div class=\"map\">\n" + mapOf(check) +
          "</div>\n<p class=\"soft\">Equal-area projection: the centre is towards the viewer (+z), "
          "the rim of the hemisphere grazes the picture plane. A line leads from a wrong direction "
          "to the one that fits.</p>\n";
  page += fmt::format(
      "<h2>Captured, predicted, ratio</h2>\n<p class=\"soft\">{} of {} frames at fault, the worst "
      "first, at one common exposure. Predicted from neighbouring frames, the frame itself left "
      "out. Ratio: white as predicted, blue darker, red brighter, full colour from a factor of "
      "2. z: robust z-scores against the set's own spread.</p>\n",
      shown.size(), bad.size());
  for (const auto& s : shown) {
    const FrameVerdict& f = check.frames[static_cast<std::size_t>(s.frame)];
    ASSIGN_OR_RETURN(const std::string captured, imageTag(s.captured, "captured"));
    ASSIGN_OR_RETURN(const std::string predicted, imageTag(s.predicted, "predicted"));
    ASSIGN_OR_RETURN(const std::string ratio, imageTag(s.ratio, "ratio"));
    page += fmt::format(
        "<figure id=\"frame-{}\">\n<figcaption><strong><span class=\"chip\" "
        "style=\"background:{}\"></span>frame {}: {}</strong> {}</figcaption>\n<div "
        "class=\"triple\">\n{}{}{}</div>\n</figure>\n",
        f.id, colourOf(f.fault), f.id, htmlEscaped(f.reason()), evidence(f), captured, predicted,
        ratio);
  }
  return page +
         "<p class=\"soft\">Every figure stands in <code>cull.json</code> beside this "
         "file.</p>\n</main>\n</body>\n</html>\n";
}

}  // namespace lightsketch
