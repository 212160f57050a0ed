#include "pipeline/validate/report.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string>
#include <string_view>
#include <system_error>
#include <unordered_set>

#include "capture/frame/angle.h"
#include "capture/frame/file.h"
#include "capture/frame/html.h"
#include "capture/frame/json.h"
#include "pipeline/sketch/image_file.h"

namespace lightsketch {
namespace {

constexpr std::string_view kStyle = R"css(
:root {
  color-scheme: light dark;
  --paper: #ffffff; --panel: #f5f6f8; --ink: #1b1e23; --soft: #5c6470; --line: #dcdfe5;
  --accent: #1f5fbf; --mark: #fff3c9;
}
@media (prefers-color-scheme: dark) {
  :root {
    --paper: #14161a; --panel: #1d2026; --ink: #e7e9ed; --soft: #9aa3b0; --line: #333842;
    --accent: #7fb0ff; --mark: #3a3418;
  }
}
* { box-sizing: border-box; }
html { scroll-behavior: smooth; }
body {
  margin: 0; background: var(--paper); color: var(--ink);
  font: 15px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", "DejaVu Sans", sans-serif;
}
main { max-width: 1120px; margin: 0 auto; padding: 40px 28px 80px; }
h1 { font-size: 29px; line-height: 1.2; margin: 0 0 6px; letter-spacing: -0.01em; }
h2 { font-size: 20px; margin: 52px 0 6px; padding-top: 14px; border-top: 1px solid var(--line); }
p { margin: 6px 0 12px; max-width: 76ch; }
.soft, figcaption, caption { color: var(--soft); }
.lead { font-size: 17px; }
a { color: var(--accent); text-decoration: none; }
a:hover { text-decoration: underline; }
code { font-family: ui-monospace, "DejaVu Sans Mono", monospace; font-size: 0.9em; overflow-wrap: anywhere; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(158px, 1fr)); gap: 12px; margin: 22px 0 8px; }
.tile { background: var(--panel); border-radius: 10px; padding: 13px 16px 11px; }
.tile b { display: block; font-size: 25px; line-height: 1.25; font-variant-numeric: tabular-nums; letter-spacing: -0.01em; white-space: nowrap; }
.tile b small { font-size: 14px; font-weight: 500; color: var(--soft); }
.tile span { color: var(--soft); font-size: 13px; line-height: 1.35; display: block; }
.where { display: grid; grid-template-columns: minmax(300px, 540px) minmax(260px, 1fr); gap: 36px; align-items: center; margin-top: 14px; }
@media (max-width: 800px) { .where { grid-template-columns: 1fr; } }
.map svg { width: 100%; height: auto; display: block; }
.map text { fill: var(--soft); font-size: 12.5px; paint-order: stroke; stroke: var(--paper); stroke-width: 3px; stroke-linejoin: round; }
.map .ring { fill: none; stroke: var(--line); }
.map .rim { fill: var(--panel); stroke: var(--soft); }
.map .hull { fill: none; stroke: var(--ink); stroke-opacity: 0.65; stroke-dasharray: 5 4; stroke-width: 1.3; }
.map .captured { stroke: var(--ink); stroke-opacity: 0.5; stroke-linecap: round; fill: none; }
.map .dot { stroke: var(--paper); stroke-width: 1.4; }
.map a:hover .dot, .map a:focus .dot { stroke: var(--ink); stroke-width: 2.4; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: 5px 10px; border-bottom: 1px solid var(--line); vertical-align: top; }
th { font-weight: 600; color: var(--soft); font-size: 13px; line-height: 1.3; vertical-align: bottom; }
th:first-child, td:first-child, .left { text-align: left; }
table.facts td { text-align: left; }
table.facts td:first-child { color: var(--soft); width: 34%; }
table.facts td:last-child { overflow-wrap: anywhere; }
.wide { overflow-x: auto; }
#lights td { white-space: nowrap; }
#lights th { cursor: pointer; user-select: none; }
#lights th[aria-sort=ascending]::after { content: " \25B2"; font-size: 9px; }
#lights th[aria-sort=descending]::after { content: " \25BC"; font-size: 9px; }
#lights td.name { white-space: normal; overflow-wrap: anywhere; min-width: 9em; }
.chip { display: inline-block; width: 11px; height: 11px; border-radius: 50%; margin-right: 7px; vertical-align: -1px; border: 1px solid rgba(0, 0, 0, 0.25); }
figure.light { margin: 22px 0 30px; padding: 10px 12px 12px; border-radius: 10px; background: var(--panel); }
figure.light > figcaption { display: flex; flex-wrap: wrap; gap: 2px 18px; align-items: baseline; margin-bottom: 8px; }
figure.light > figcaption strong { color: var(--ink); font-size: 16px; }
.triple { display: grid; grid-template-columns: repeat(3, 1fr); gap: 8px; }
.triple div { font-size: 12.5px; color: var(--soft); }
.triple img { width: 100%; height: auto; display: block; border-radius: 4px; background: #000; }
.triple img.small { image-rendering: pixelated; }
:target { outline: 3px solid var(--accent); outline-offset: 2px; }
tr:target { background: var(--mark); }
footer { margin-top: 60px; color: var(--soft); font-size: 13px; border-top: 1px solid var(--line); padding-top: 12px; }
@media print {
  :root {
    color-scheme: light;
    --paper: #ffffff; --panel: #f5f6f8; --ink: #000000; --soft: #444444; --line: #bbbbbb;
    --accent: #000000; --mark: #ffffff;
  }
  body { font-size: 9.5pt; }
  main { max-width: none; padding: 0; }
  figure.light, .tile, tr, .where, .together { break-inside: avoid; }
  .tiles { grid-template-columns: repeat(3, 1fr); }
  .where { grid-template-columns: 3fr 2fr; gap: 18px; }
  .wide { overflow: visible; }
  #lights { font-size: 7.5pt; }
  #lights th, #lights td { padding: 3px 4px; }
  h2 { margin-top: 26px; }
  .where td, .where th { padding: 4px 5px; }
  .where td:first-child { white-space: nowrap; }
  figure.light { margin: 10px 0 12px; padding: 6px 8px; }
  h2 { break-after: avoid; }
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
}
)css";

// Sorting by a click on a column's head; the report reads well without.
constexpr std::string_view kScript = R"js(
const table = document.getElementById('lights');
table.querySelectorAll('th').forEach((head, column) => head.addEventListener('click', () => {
  const down = head.getAttribute('aria-sort') === 'ascending';
  table.querySelectorAll('th').forEach(other => other.removeAttribute('aria-sort'));
  head.setAttribute('aria-sort', down ? 'descending' : 'ascending');
  const key = row => {
    const value = row.cells[column].dataset.value;
    return value === undefined ? row.cells[column].textContent : Number(value);
  };
  const rows = [...table.tBodies[0].rows];
  rows.sort((a, b) => { const x = key(a), y = key(b); return (x < y ? -1 : x > y ? 1 : 0) * (down ? -1 : 1); });
  table.tBodies[0].append(...rows);
}));
)js";

std::string percent(double fraction) {
  return std::isfinite(fraction) ? fmt::format("{:.2f}&thinsp;%", 100 * fraction) : "&ndash;";
}

std::string ssimText(const std::optional<double>& ssim) {
  return ssim ? fmt::format("{:.4f}", *ssim) : "&ndash;";
}

std::string psnrText(const PictureError& error) {
  return error.identical ? "identical" : fmt::format("{:.2f}", error.psnr);
}

std::string withThousands(std::uint64_t value) {
  std::string digits = std::to_string(value);
  for (auto at = static_cast<std::ptrdiff_t>(digits.size()) - 3; at > 0; at -= 3) {
    digits.insert(static_cast<std::size_t>(at), "&#8239;");
  }
  return digits;
}

std::string nameOf(const HeldOutLight& light) {
  return light.origin.empty() ? std::string()
                              : fmt::format("<code>{}</code>", htmlEscaped(light.origin));
}

// --- Colour of a PSNR
// -----------------------------------------------------------------------------

// ColorBrewer 2 RdYlBu, five classes: readable with any colour vision; red is worst.
struct Stop {
  int r, g, b;
};
constexpr std::array<Stop, 5> kStops{
    {{215, 48, 39}, {252, 141, 89}, {254, 224, 144}, {145, 191, 219}, {69, 117, 180}}};

struct ColourScale {
  double low = 0;
  double high = 1;
  bool clipped = false;  // some lights are better than `high`

  std::string operator()(double value) const {
    const double t = std::clamp((value - low) / (high - low), 0.0, 1.0) * (kStops.size() - 1);
    const auto index = std::min(static_cast<std::size_t>(t), kStops.size() - 2);
    const double f = t - static_cast<double>(index);
    const Stop& a = kStops[index];
    const Stop& b = kStops[index + 1];
    const auto mix = [f](int x, int y) { return static_cast<int>(std::lround(x + f * (y - x))); };
    return fmt::format("#{:02x}{:02x}{:02x}", mix(a.r, b.r), mix(a.g, b.g), mix(a.b, b.b));
  }
};

// From the worst light to the best, but not beyond 15 dB over the median: a nearly black picture,
// which any model predicts well, must not eat the scale.
ColourScale scaleOf(const ValidationReport& report) {
  ColourScale scale;
  scale.low = std::floor(report.worst().error.psnr);
  scale.high = std::ceil(std::min(report.best().error.psnr, report.median().error.psnr + 15));
  scale.high = std::max(scale.high, scale.low + 1);
  scale.clipped = report.best().error.psnr > scale.high;
  return scale;
}

// --- The map over the hemisphere
// ------------------------------------------------------------------

constexpr double kMapRadius = 230;  // of the hemisphere's rim, in SVG units
constexpr double kMapCentre = 300;

// Lambert's azimuthal equal-area projection about +z.
double mapRadius(double radians) {
  return kMapRadius * std::numbers::sqrt2 * std::sin(radians / 2);
}

Eigen::Vector2d onMap(const Eigen::Vector3d& direction, double scale) {
  const double flat = std::hypot(direction.x(), direction.y());
  const double radius = scale * mapRadius(std::atan2(flat, direction.z()));
  if (flat == 0) return {kMapCentre, kMapCentre};
  return {kMapCentre + radius * direction.x() / flat, kMapCentre - radius * direction.y() / flat};
}

std::string map(const ValidationReport& report, const ColourScale& colour,
                const std::unordered_set<std::size_t>& shown) {
  // Lights behind the subject: the whole sphere has to fit.
  const auto behind = [](const Eigen::Vector3d& d) { return d.z() < -0.05; };
  const bool sphere = std::ranges::any_of(report.capturedDirections, behind) ||
                      std::ranges::any_of(report.lights, behind, &HeldOutLight::direction);
  const double scale = sphere ? 1 / std::numbers::sqrt2 : 1;

  std::string svg =
      "<svg viewBox=\"30 34 540 600\" role=\"img\" aria-label=\"PSNR over the light "
      "directions\">\n";
  for (const int degrees : {180, 150, 120, 90, 60, 30}) {
    if (degrees > 90 && !sphere) continue;
    const double radius = scale * mapRadius(Angle::degrees(degrees).radians());
    svg += fmt::format("<circle class=\"{}\" cx=\"{}\" cy=\"{}\" r=\"{:.1f}\"/>\n",
                       degrees == (sphere ? 180 : 90) ? "rim" : "ring", kMapCentre, kMapCentre,
                       radius);
  }
  for (const int degrees : {30, 60, 90}) {
    const double at =
        scale * mapRadius(Angle::degrees(degrees).radians()) * std::numbers::sqrt2 / 2;
    svg += fmt::format("<text x=\"{:.1f}\" y=\"{:.1f}\">{}°</text>\n", kMapCentre + at + 3,
                       kMapCentre + at + 12, degrees);
  }
  const double rim = sphere ? kMapRadius : kMapRadius * scale;
  svg += fmt::format(
      "<text x=\"{0}\" y=\"{1:.1f}\" text-anchor=\"middle\">+y, up</text>"
      "<text x=\"{2:.1f}\" y=\"{3}\">+x</text>\n",
      kMapCentre, kMapCentre - rim - 10, kMapCentre + rim + 8, kMapCentre + 4);

  // The captured lights, one path.
  std::string path;
  for (const Eigen::Vector3d& direction : report.capturedDirections) {
    const Eigen::Vector2d p = onMap(direction, scale);
    path += fmt::format("M{:.1f} {:.1f}h0", p.x(), p.y());
  }
  svg += fmt::format("<path class=\"captured\" stroke-width=\"{}\" d=\"{}\"/>\n",
                     report.capturedDirections.size() > 400 ? 2.2 : 4.0, path);
  if (!report.hull.empty()) {
    std::string points;
    for (const Eigen::Vector3d& direction : report.hull) {
      const Eigen::Vector2d p = onMap(direction, scale);
      points += fmt::format("{:.1f},{:.1f} ", p.x(), p.y());
    }
    svg += fmt::format("<polygon class=\"hull\" points=\"{}\"/>\n", points);
  }

  // The held-out ones, the worst on top.
  const double size = report.lights.size() > 150 ? 5 : 7.5;
  for (auto at = report.worstFirst.rbegin(); at != report.worstFirst.rend(); ++at) {
    const HeldOutLight& light = report.lights[*at];
    const Eigen::Vector2d p = onMap(light.direction, scale);
    svg += fmt::format(
        "<a href=\"#{}-{}\"><circle class=\"dot\" cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"{}\" "
        "fill=\"{}\"><title>light {}{}{}: {} dB{}</title></circle></a>\n",
        shown.contains(*at) ? "pictures" : "light", light.id, p.x(), p.y(), size,
        colour(light.error.psnr), light.id, light.origin.empty() ? "" : ", ",
        htmlEscaped(light.origin), psnrText(light.error),
        light.insideHull ? "" : ", outside the hull");
  }

  // Legend.
  svg += "<defs><linearGradient id=\"scale\">";
  for (std::size_t i = 0; i < kStops.size(); ++i) {
    svg += fmt::format("<stop offset=\"{}\" stop-color=\"rgb({},{},{})\"/>",
                       static_cast<double>(i) / (kStops.size() - 1), kStops[i].r, kStops[i].g,
                       kStops[i].b);
  }
  svg += fmt::format(
      "</linearGradient></defs>\n<rect x=\"150\" y=\"562\" width=\"300\" height=\"12\" rx=\"6\" "
      "fill=\"url(#scale)\"/>\n"
      "<text x=\"150\" y=\"591\">{:.0f} dB, worse</text>"
      "<text x=\"300\" y=\"591\" text-anchor=\"middle\">{:.1f}</text>"
      "<text x=\"450\" y=\"591\" text-anchor=\"end\">better, {:.0f} dB{}</text>\n",
      colour.low, (colour.low + colour.high) / 2, colour.high, colour.clipped ? " and more" : "");
  svg += fmt::format(
      "<circle class=\"dot\" cx=\"112\" cy=\"618\" r=\"7\" fill=\"{}\"/>"
      "<text x=\"124\" y=\"622\">held out</text>"
      "<path class=\"captured\" stroke-width=\"5\" d=\"M222 618h0\"/>"
      "<text x=\"232\" y=\"622\">captured, seen by the model</text>",
      colour((colour.low + colour.high) / 2));
  if (!report.hull.empty()) {
    svg += "<path class=\"hull\" d=\"M424 618h30\"/><text x=\"462\" y=\"622\">their hull</text>";
  }
  return svg + "\n</svg>\n";
}

// --- Pictures
// -------------------------------------------------------------------------------------

Result<std::string> pictureTag(const Image<std::uint8_t>& picture, std::string_view alt) {
  ASSIGN_OR_RETURN(const std::string png, encodePng(picture));
  return fmt::format(
      "<img{} width=\"{}\" height=\"{}\" alt=\"{}\" src=\"data:image/png;base64,{}\">",
      picture.width() < 250 ? " class=\"small\"" : "", picture.width(), picture.height(), alt,
      base64(png));
}

Result<std::string> tripleTags(const PictureTriple& triple, std::string_view truth,
                               std::string_view relit) {
  const std::string difference =
      fmt::format("difference &times;&thinsp;{}, black: none", kDifferenceGain);
  ASSIGN_OR_RETURN(const std::string a, pictureTag(triple.truth, truth));
  ASSIGN_OR_RETURN(const std::string b, pictureTag(triple.relit, relit));
  ASSIGN_OR_RETURN(const std::string c, pictureTag(triple.difference, difference));
  return fmt::format(
      "<div class=\"triple\">\n<div>{}{}</div>\n<div>{}{}</div>\n<div>{}{}</div>\n</div>\n", a,
      truth, b, relit, c, difference);
}

std::string rankName(const ValidationReport& report, std::size_t light) {
  if (&report.lights[light] == &report.worst()) return "Worst light";
  if (&report.lights[light] == &report.best()) return "Best light";
  if (&report.lights[light] == &report.median()) return "Median light";
  const auto at = std::ranges::find(report.worstFirst, light);
  return fmt::format("{} of {} from the worst", at - report.worstFirst.begin() + 1,
                     report.worstFirst.size());
}

Result<std::string> lightFigure(const ValidationReport& report, const ShownLight& shown,
                                const ColourScale& colour) {
  const HeldOutLight& light = report.lights[shown.light];
  ASSIGN_OR_RETURN(const std::string pictures,
                   tripleTags(shown.pictures, "captured, held out", "relit by the model"));
  return fmt::format(
      "<figure class=\"light\" id=\"pictures-{0}\">\n<figcaption><strong><span class=\"chip\" "
      "style=\"background:{1}\"></span>{2}</strong> <span><a href=\"#light-{0}\">light {0}</a> "
      "{3}</span> <span>PSNR {4}{5}</span> <span>SSIM {6}</span> <span>relative error {7}</span> "
      "<span>{8} the hull, {9:.1f}° from the nearest capture</span></figcaption>\n{10}</figure>\n",
      light.id, colour(light.error.psnr), rankName(report, shown.light), nameOf(light),
      psnrText(light.error), light.error.identical ? "" : " dB", ssimText(light.error.ssim),
      percent(light.error.relative), light.insideHull ? "inside" : "outside",
      light.nearestCapturedDegrees, pictures);
}

// --- Tables
// ---------------------------------------------------------------------------------------

std::string meanRow(std::string_view name, const MeanError& mean) {
  if (mean.count == 0) {
    return fmt::format(
        "<tr><td>{}</td><td>0</td><td>&ndash;</td><td>&ndash;</td><td>&ndash;</td></tr>\n", name);
  }
  return fmt::format("<tr><td>{}</td><td>{}</td><td>{:.2f}</td><td>{}</td><td>{}</td></tr>\n", name,
                     mean.count, mean.psnr, ssimText(mean.ssim), percent(mean.relative));
}

std::string lightRow(const HeldOutLight& light, bool shown, const ColourScale& colour) {
  const Eigen::Vector3d& d = light.direction;
  const auto value = [](double number) { return std::isfinite(number) ? number : 1e9; };
  return fmt::format(
      "<tr id=\"light-{0}\"><td data-value=\"{0}\">{1}</td><td class=\"left name\">{2}</td>"
      "<td data-value=\"{3:.6f}\">{3:.3f}</td><td data-value=\"{4:.6f}\">{4:.3f}</td>"
      "<td data-value=\"{5:.6f}\">{5:.3f}</td><td>{6}</td><td data-value=\"{7:.4f}\">{7:.1f}°</td>"
      "<td data-value=\"{8:.6f}\"><span class=\"chip\" style=\"background:{9}\"></span>{10}</td>"
      "<td data-value=\"{11:.6f}\">{12}</td><td data-value=\"{13:.6f}\">{14}</td>"
      "<td data-value=\"{15:.6f}\">{15:.2f}</td></tr>\n",
      light.id,
      shown ? fmt::format("<a href=\"#pictures-{0}\" title=\"to its pictures\">{0}</a>", light.id)
            : std::to_string(light.id),
      nameOf(light), d.x(), d.y(), d.z(), light.insideHull ? "inside" : "outside",
      light.nearestCapturedDegrees, light.error.psnr, colour(light.error.psnr),
      psnrText(light.error), light.error.ssim.value_or(-1), ssimText(light.error.ssim),
      value(light.error.relative), percent(light.error.relative), light.error.linearPsnr);
}

std::string factRow(std::string_view name, std::string_view html) {
  return fmt::format("<tr><td>{}</td><td>{}</td></tr>\n", name, html);
}

std::string tile(std::string_view value, std::string_view unit, std::string_view label) {
  return fmt::format("<div class=\"tile\"><b>{}<small> {}</small></b><span>{}</span></div>\n",
                     value, unit, label);
}

// The compression's own figures, whatever they are.
std::string noteRows(const Json& notes) {
  std::string rows;
  if (!notes.is_object()) return rows;
  for (const auto& [key, value] : notes.items()) {
    const std::string text = value.is_string()
                                 ? value.get<std::string>()
                                 : value.dump(-1, ' ', false, Json::error_handler_t::replace);
    rows += factRow(htmlEscaped(key), fmt::format("<code>{}</code>", htmlEscaped(text)));
  }
  return rows;
}

std::string fileName(const std::string& path) {
  const std::filesystem::path clean(path);
  return (clean.has_filename() ? clean : clean.parent_path()).filename().string();
}

Result<std::string> superpositionSection(const Superposition& sum, const ValidationReport& report) {
  std::string page;
  ASSIGN_OR_RETURN(const std::string sumPictures,
                   tripleTags(sum.pictures, "weighted sum of the captures", "one relit picture"));
  page += fmt::format(
      "<section>\n<div class=\"together\">\n<h2>Superposition</h2>\n<p>Light adds up, so one "
      "picture relit under a whole "
      "environment must equal the sum of the captures, each weighted by the light that falls into "
      "its Voronoi cell. Environment: <code>{}</code>. The cells of the {} captures cover "
      "{:.2f}&thinsp;sr ({:.0f}&thinsp;% of a hemisphere).</p>\n<figure class=\"light\">\n"
      "<figcaption><strong>All lamps at once</strong> <span>PSNR {}{}</span> <span>SSIM {}</span> "
      "<span>relative error {}</span></figcaption>\n{}</figure>\n",
      htmlEscaped(sum.environment), report.captured, sum.coveredSolidAngle,
      100 * sum.coveredSolidAngle / (2 * std::numbers::pi), psnrText(sum.sameLamps),
      sum.sameLamps.identical ? "" : " dB", ssimText(sum.sameLamps.ssim),
      percent(sum.sameLamps.relative), sumPictures);
  page += "</div>\n";
  page +=
      "<table>\n<thead><tr><th>against the sum of the captures</th><th>PSNR<br>dB</th>"
      "<th>SSIM</th><th>relative<br>error</th></tr></thead>\n<tbody>\n";
  const auto sumRow = [](std::string_view name, const PictureError& error) {
    return fmt::format("<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>\n", name,
                       psnrText(error), ssimText(error.ssim), percent(error.relative));
  };
  page += sumRow("the model under the same lamps, one per capture", sum.sameLamps);
  page += sumRow("the model integrating the environment over its own lights&#8217; cells",
                 sum.ownCells);
  page += fmt::format(
      "</tbody>\n</table>\n<p class=\"soft\">Linearity: two coloured lamps together differ from "
      "the "
      "sum of their pictures by at most {:.1e} of the largest value, which is rounding.</p>\n"
      "</section>\n",
      sum.linearity);
  return page;
}

Result<std::string> html(const ValidationReport& report) {
  const ColourScale colour = scaleOf(report);
  std::unordered_set<std::size_t> shown;
  for (const ShownLight& light : report.shown) shown.insert(light.light);

  std::string page = fmt::format(
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n"
      "<title>Validation of {0}</title>\n<style>{1}</style>\n</head>\n<body>\n<main>\n"
      "<header>\n<h1>How well &ldquo;{0}&rdquo; relights</h1>\n"
      "<p class=\"lead\">{2} of {3} captures were held back. The model, made from the other {4}, "
      "predicts them with a mean PSNR of <strong>{5:.2f}&thinsp;dB</strong>; the worst "
      "is at {6:.2f}, the best at {7:.2f}.</p>\n</header>\n",
      htmlEscaped(fileName(report.sketch)), kStyle, report.all.count,
      report.all.count + report.captured, report.captured, report.all.psnr,
      report.worst().error.psnr, report.best().error.psnr);

  page += "<div class=\"tiles\">\n";
  page += tile(fmt::format("{:.2f}", report.all.psnr), "dB", "mean PSNR, 8-bit sRGB");
  page += tile(ssimText(report.all.ssim), "", "mean SSIM");
  page += tile(fmt::format("{:.2f}", 100 * report.all.relative), "%",
               "mean relative error in linear light");
  if (report.superposition) {
    page += tile(fmt::format("{:.2f}", report.superposition->sameLamps.psnr), "dB",
                 "superposition, against the sum of the captures");
  }
  if (report.size) {
    page += tile(
        fmt::format("{:.{}f}", report.size->bitsPerPixel, report.size->bitsPerPixel < 1000 ? 1 : 0),
        "bit / pixel", "of the model file, all lights together");
    page += tile(
        fmt::format("{:.{}f}", report.size->ratioToHalf, report.size->ratioToHalf < 10 ? 2 : 0),
        ": 1", "captures in half float : model file");
  }
  page += "</div>\n";

  page += "<section>\n<h2>Where the error is</h2>\n<div class=\"where\">\n<div class=\"map\">\n";
  page += map(report, colour, shown);
  page +=
      "</div>\n<div>\n<p>The light directions as the subject sees them, in an equal-area "
      "projection: "
      "the centre is towards the viewer (+z), the circle at 90° grazes the picture plane. "
      "Each dot is a held-out light coloured by its PSNR; it leads to its pictures or its line in "
      "the table.</p>\n"
      "<table>\n<thead><tr><th></th><th>lights</th><th>PSNR<br>dB</th><th>SSIM</th>"
      "<th>relative<br>error</th></tr></thead>\n<tbody>\n";
  page += meanRow("<strong>all</strong>", report.all);
  page += meanRow("inside the hull", report.inside);
  page += meanRow("outside the hull", report.outside);
  page +=
      "</tbody>\n</table>\n<p class=\"soft\">Inside the hull of the captured directions the model "
      "interpolates; outside it extrapolates, which is harder. Every light counts the same in the "
      "means.</p>\n</div>\n</div>\n</section>\n";

  page += fmt::format(
      "<section>\n<h2>Captured, relit, difference</h2>\n<p>{} of {} held-out lights, from the "
      "worst "
      "to the best by PSNR, at one common exposure{}{}. The difference is the absolute one of the "
      "8-bit pictures, times {}.</p>\n",
      report.shown.size(), report.lights.size(),
      report.pictureExposure == report.exposure
          ? std::string()
          : fmt::format(" ({:.2f} times the one that PSNR and SSIM are measured at)",
                        report.pictureExposure / report.exposure),
      report.pictureShrink == 1 ? std::string()
                                : fmt::format(", shrunk to 1/{}", report.pictureShrink),
      kDifferenceGain);
  for (const ShownLight& light : report.shown) {
    ASSIGN_OR_RETURN(const std::string figure, lightFigure(report, light, colour));
    page += figure;
  }
  page += "</section>\n";

  page +=
      "<section>\n<h2>Every held-out light</h2>\n<p class=\"soft\">Worst first; a click on a "
      "column's head sorts by it. The directions point from the subject to the lamp (x right, y "
      "up, "
      "z towards the viewer).</p>\n<div class=\"wide\">\n<table id=\"lights\">\n<thead><tr>"
      "<th>light</th><th class=\"left\">file</th><th>x</th><th>y</th><th>z</th><th>hull</th>"
      "<th>nearest<br>capture</th><th aria-sort=\"ascending\">PSNR<br>dB</th><th>SSIM</th>"
      "<th>relative<br>error</th><th>linear<br>PSNR, dB</th></tr></thead>\n<tbody>\n";
  for (const std::size_t light : report.worstFirst) {
    page += lightRow(report.lights[light], shown.contains(light), colour);
  }
  page += "</tbody>\n</table>\n</div>\n</section>\n";

  if (report.superposition) {
    ASSIGN_OR_RETURN(const std::string section,
                     superpositionSection(*report.superposition, report));
    page += section;
  } else {
    page +=
        "<section>\n<h2>Superposition</h2>\n<p>This is a single-lamp model: it holds square roots, "
        "which do not add up, so it shows one lamp at a time.</p>\n</section>\n";
  }

  page += "<section>\n<h2>How it was made</h2>\n<table class=\"facts\">\n<tbody>\n";
  page += factRow("sketch", fmt::format("<code>{}</code>", htmlEscaped(report.sketch)));
  if (!report.model.empty()) {
    page += factRow("model", fmt::format("<code>{}</code>", htmlEscaped(report.model)));
  }
  page += factRow("picture", fmt::format("{} &times; {} pixels", report.width, report.height));
  page += factRow("hold-out rule", fmt::format("<code>{}</code>; the model has seen none of these "
                                               "frames (checked by id)",
                                               htmlEscaped(report.holdOutRule)));
  page += factRow("made from", fmt::format("{} captures, held as {} lights", report.captured,
                                           report.modelLights));
  page += factRow(
      "factorisation",
      fmt::format("blocks of {0} &times; {0} pixels, {1} basis pictures in all, {2} "
                  "coefficients per light and colour; stored as {3}",
                  report.blockSize, withThousands(static_cast<std::uint64_t>(report.basisRows)),
                  report.rank, report.storage));
  page += factRow("between the lights", htmlEscaped(report.interpolation));
  if (report.size) {
    page += factRow(
        "file", fmt::format("{} bytes, {:.2f} bits per pixel; {:.2f} : 1 of the captures in half "
                            "float, {:.2f} : 1 in float",
                            withThousands(report.size->bytes), report.size->bitsPerPixel,
                            report.size->ratioToHalf, report.size->ratioToFloat));
  }
  page += factRow("software", htmlEscaped(report.software));
  page += noteRows(report.modelNotes);
  page += "</tbody>\n</table>\n</section>\n";

  page += fmt::format(
      "<section>\n<h2>What the figures mean</h2>\n<table "
      "class=\"facts\">\n<tbody>\n{}{}{}{}</tbody>\n"
      "</table>\n</section>\n"
      "<footer>Every figure stands in <code>report.json</code>, the lights also in "
      "<code>lights.csv</code>, beside this file.</footer>\n</main>\n<script>{}</script>\n</body>\n"
      "</html>\n",
      factRow("PSNR",
              fmt::format("Radiance times {:g}, sRGB-encoded, rounded and clipped to 8 bits; "
                          "mean squared error over all pixels and channels against a peak of "
                          "255. Identical pictures count as 100 dB.",
                          report.exposure)),
      factRow("SSIM",
              "Wang, Bovik, Sheikh, Simoncelli 2004: 11 &times; 11 Gaussian windows of sigma "
              "1.5, K1 = 0.01, K2 = 0.03, on the luma of the same 8-bit pictures. 1 is "
              "identical."),
      factRow("relative error",
              "Root mean square of the error over that of the truth, in linear "
              "light, nothing clipped."),
      factRow("linear PSNR",
              "In linear light, nothing clipped, against the radiance that shows as "
              "white."),
      kScript);
  return page;
}

std::string csvField(std::string_view text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"') out += '"';
    out += c;
  }
  return out + '"';
}

std::string csv(const ValidationReport& report) {
  std::string text =
      "id,origin,x,y,z,inside_hull,nearest_capture_degrees,psnr_db,ssim,relative_error,"
      "linear_psnr_db\n";
  for (const HeldOutLight& light : report.lights) {
    const Eigen::Vector3d& d = light.direction;
    text += fmt::format("{},{},{:.6f},{:.6f},{:.6f},{},{:.3f},{:.4f},{},{:.6f},{:.4f}\n", light.id,
                        csvField(light.origin), d.x(), d.y(), d.z(), light.insideHull ? 1 : 0,
                        light.nearestCapturedDegrees, light.error.psnr,
                        light.error.ssim ? fmt::format("{:.6f}", *light.error.ssim) : "",
                        light.error.relative, light.error.linearPsnr);
  }
  return text;
}

}  // namespace

Result<void> writeReport(const ValidationReport& report, const std::filesystem::path& folder) {
  ASSIGN_OR_RETURN(const std::string page, html(report));
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) {
    return failure(ErrorCode::kIo, "{}: cannot create the folder: {}", folder.string(),
                   error.message());
  }
  RETURN_IF_ERROR(writeJsonFile(folder / "report.json", toJson(report)));
  RETURN_IF_ERROR(writeFileAtomically(folder / "lights.csv", csv(report)));
  return writeFileAtomically(folder / "index.html", page);
}

}  // namespace lightsketch
