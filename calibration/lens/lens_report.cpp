#include "calibration/lens/lens_report.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "calibration/model/fisheye_projection.h"
#include "capture/frame/file.h"
#include "capture/frame/html.h"

namespace lightsketch {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr std::string_view kStyle = R"css(
:root {
  color-scheme: light dark;
  --paper: #ffffff; --panel: #f5f6f8; --ink: #1b1e23; --soft: #5c6470; --line: #dcdfe5;
  --accent: #1f5fbf; --bad: #c8321f; --second: #b0640a; --third: #2a7f3f; --mark: #fff3c9;
}
@media (prefers-color-scheme: dark) {
  :root {
    --paper: #14161a; --panel: #1d2026; --ink: #e7e9ed; --soft: #9aa3b0; --line: #333842;
    --accent: #7fb0ff; --bad: #ff7d6b; --second: #f0b060; --third: #7fd08f; --mark: #3a3418;
  }
}
* { box-sizing: border-box; }
body {
  margin: 0; background: var(--paper); color: var(--ink);
  font: 15px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", "DejaVu Sans", sans-serif;
}
main { max-width: 1120px; margin: 0 auto; padding: 40px 28px 80px; }
h1 { font-size: 29px; line-height: 1.2; margin: 0 0 6px; letter-spacing: -0.01em; }
h2 { font-size: 20px; margin: 48px 0 6px; padding-top: 14px; border-top: 1px solid var(--line); }
p { margin: 6px 0 12px; max-width: 76ch; }
.soft, figcaption { color: var(--soft); }
.lead { font-size: 17px; }
code { font-family: ui-monospace, "DejaVu Sans Mono", monospace; font-size: 0.9em; overflow-wrap: anywhere; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(158px, 1fr)); gap: 12px; margin: 22px 0 8px; }
.tile { background: var(--panel); border-radius: 10px; padding: 13px 16px 11px; }
.tile b { display: block; font-size: 25px; line-height: 1.25; font-variant-numeric: tabular-nums; white-space: nowrap; }
.tile b small { font-size: 14px; font-weight: 500; color: var(--soft); }
.tile span { color: var(--soft); font-size: 13px; line-height: 1.35; display: block; }
.todo { background: var(--mark); border-radius: 10px; padding: 12px 18px; margin: 18px 0; }
.todo ul { margin: 4px 0; padding-left: 20px; }
.two { display: grid; grid-template-columns: 1fr 1fr; gap: 28px; margin-top: 14px; }
@media (max-width: 800px) { .two { grid-template-columns: 1fr; } }
figure { margin: 0; }
figcaption { font-size: 13.5px; }
svg { width: 100%; height: auto; display: block; }
svg text { fill: var(--soft); font-size: 12.5px; }
svg .halo { paint-order: stroke; stroke: var(--paper); stroke-width: 3px; stroke-linejoin: round; }
.rim { fill: var(--panel); stroke: var(--soft); }
.ring { fill: none; stroke: var(--line); }
.frame { fill: var(--panel); stroke: var(--line); }
.grid { stroke: var(--line); fill: none; }
.covered { fill: none; stroke: var(--ink); stroke-width: 1.8; }
.corner { stroke: var(--accent); stroke-linecap: round; stroke-width: 3.2; fill: none; stroke-opacity: 0.75; }
.thrown { stroke: var(--bad); stroke-linecap: round; stroke-width: 5; fill: none; }
.vector { stroke: var(--accent); stroke-width: 1.1; fill: none; }
.vector.out { stroke: var(--bad); }
.foot { stroke: var(--ink); stroke-width: 2.2; stroke-linecap: round; fill: none; stroke-opacity: 0.7; }
.line { fill: none; stroke-width: 2.2; stroke-linejoin: round; }
.a { stroke: var(--accent); } .b { stroke: var(--second); } .c { stroke: var(--third); }
text.a { fill: var(--accent); stroke: none; } text.b { fill: var(--second); stroke: none; }
text.c { fill: var(--third); stroke: none; }
.dashed { stroke-dasharray: 6 4; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: 5px 10px; border-bottom: 1px solid var(--line); vertical-align: top; }
th { font-weight: 600; color: var(--soft); font-size: 13px; line-height: 1.3; vertical-align: bottom; }
th:first-child, td:first-child, .left { text-align: left; }
td.left { overflow-wrap: anywhere; }
tr.chosen { background: var(--mark); }
.bad { color: var(--bad); }
.wide { overflow-x: auto; }
details { margin: 10px 0; }
summary { cursor: pointer; color: var(--accent); }
footer { margin-top: 60px; color: var(--soft); font-size: 13px; border-top: 1px solid var(--line); padding-top: 12px; }
@media print {
  body { font-size: 9.5pt; }
  main { max-width: none; padding: 0; }
  figure, .tile, tr { break-inside: avoid; }
  h2 { break-after: avoid; margin-top: 26px; }
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
}
)css";

// Two digits that count.
std::string degreesText(Angle angle) {
  const double d = angle.degrees();
  if (!std::isfinite(d)) return "&ndash;";
  return fmt::format("{:.{}f}", d, d >= 9.5 ? 1 : d >= 0.95 ? 2 : 3);
}

std::string plural(std::size_t count, std::string_view one) {
  return fmt::format("{} {}{}", count, one, count == 1 ? "" : "s");
}

// --- What the field looks like -------------------------------------------------------------------

constexpr double kBin = 5;  // degrees of field angle, as in SplitHalf

struct FieldSample {
  Vector3d direction;
  double theta = 0;
  double phi = 0;
  bool covered = false;
  Angle sigma;           // predicted, root of the trace: both axes together
  Angle halfDifference;  // predicted between two halves
};

Angle sigmaOf(const FisheyeModel& model, const Vector3d& direction) {
  return Angle::radians(std::sqrt(model.directionCovariance(direction).trace()));
}

// Two lenses from half the views have twice the variance each, so their difference has four times;
// what the lens does beyond its model they share.
Angle halfDifferenceOf(const FisheyeModel& model, const Vector3d& direction) {
  const double shared = 2 * std::pow(model.uncertainty().modelError.radians(), 2);
  const double own = std::max(0.0, model.directionCovariance(direction).trace() - shared);
  return Angle::radians(2 * std::sqrt(own));
}

Vector3d directionOf(double theta, double phi) {
  return {std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi), std::cos(theta)};
}

// Middles of cells of 2.5 degrees by azimuth, out to the model's end.
std::vector<FieldSample> sampleField(const FisheyeModel& model) {
  std::vector<FieldSample> samples;
  for (double degrees = 1.25; degrees < model.maxFieldAngle().degrees(); degrees += 2.5) {
    const double theta = Angle::degrees(degrees).radians();
    for (int i = 0; i < 72; ++i) {
      FieldSample s;
      s.theta = theta;
      s.phi = 2 * std::numbers::pi * (i + 0.5) / 72;
      s.direction = directionOf(theta, s.phi);
      s.covered = model.covers(s.direction);
      s.sigma = sigmaOf(model, s.direction);
      s.halfDifference = halfDifferenceOf(model, s.direction);
      samples.push_back(s);
    }
  }
  return samples;
}

// Rms per bin of field angle over the covered field; NaN where nothing is covered.
std::vector<Angle> binned(const std::vector<FieldSample>& samples, Angle FieldSample::*value) {
  std::vector<double> sums;
  std::vector<int> counts;
  for (const FieldSample& s : samples) {
    const auto bin = static_cast<std::size_t>(Angle::radians(s.theta).degrees() / kBin);
    if (bin >= sums.size()) {
      sums.resize(bin + 1, 0);
      counts.resize(bin + 1, 0);
    }
    if (!s.covered) continue;
    sums[bin] += std::pow((s.*value).radians(), 2);
    ++counts[bin];
  }
  std::vector<Angle> result;
  for (std::size_t i = 0; i < sums.size(); ++i) {
    result.push_back(Angle::radians(std::sqrt(sums[i] / counts[i])));
  }
  return result;
}

// Without the bins beyond the last that says something.
std::vector<Angle> trimmed(std::vector<Angle> values) {
  while (!values.empty() && !std::isfinite(values.back().radians())) values.pop_back();
  return values;
}

// Rms over the covered solid angle.
Angle overCovered(const std::vector<FieldSample>& samples, Angle FieldSample::*value) {
  double sum = 0;
  double weight = 0;
  for (const FieldSample& s : samples) {
    if (!s.covered) continue;
    sum += std::sin(s.theta) * std::pow((s.*value).radians(), 2);
    weight += std::sin(s.theta);
  }
  return Angle::radians(std::sqrt(sum / weight));
}

struct CoveredRange {
  Angle least;
  Angle most;
  bool known = false;
};

CoveredRange coveredRange(const FisheyeModel& model) {
  const auto& field = model.uncertainty().coveredField;
  if (field.empty()) return {};
  const auto [least, most] = std::minmax_element(field.begin(), field.end());
  return {*least, *most, true};
}

// --- The field as a disc: angle off axis is distance from the middle, azimuth as in the picture
// ---

constexpr double kDisc = 240;
constexpr double kMiddle = 270;

class Disc {
 public:
  explicit Disc(Angle rim) : rim_(rim.radians()) {}
  Vector2d at(double theta, double phi) const {
    const double r = kDisc * theta / rim_;
    return {kMiddle + r * std::cos(phi), kMiddle + r * std::sin(phi)};
  }
  Vector2d at(const Vector3d& d) const {
    return at(std::atan2(d.head<2>().norm(), d.z()), std::atan2(d.y(), d.x()));
  }
  std::string begin(std::string_view label) const {
    return fmt::format(
        "<svg viewBox=\"0 0 540 {}\" role=\"img\" aria-label=\"{}\">\n"
        "<circle class=\"rim\" cx=\"{}\" cy=\"{}\" r=\"{}\"/>\n",
        590, label, kMiddle, kMiddle, kDisc);
  }
  std::string rings() const {
    std::string svg;
    for (int degrees = 30; Angle::degrees(degrees).radians() < rim_; degrees += 30) {
      const double r = kDisc * Angle::degrees(degrees).radians() / rim_;
      svg += fmt::format(
          "<circle class=\"ring\" cx=\"{0}\" cy=\"{0}\" r=\"{1:.1f}\"/>"
          "<text class=\"halo\" x=\"{2:.1f}\" y=\"{0}\" dy=\"4\">{3}°</text>\n",
          kMiddle, r, kMiddle + r + 3, degrees);
    }
    return svg +
           fmt::format("<text x=\"{0}\" y=\"22\" text-anchor=\"middle\">up in the picture</text>\n",
                       kMiddle);
  }
  // The outline of the covered field.
  std::string covered(const FisheyeModel& model) const {
    const auto& field = model.uncertainty().coveredField;
    if (field.empty()) return {};
    std::string path;
    const auto count = static_cast<double>(field.size());
    for (std::size_t i = 0; i < field.size(); ++i) {
      for (int step = 0; step <= 4; ++step) {
        const double phi = 2 * std::numbers::pi * (static_cast<double>(i) + step / 4.0) / count;
        const Vector2d p = at(std::min(field[i].radians(), rim_), phi);
        path += fmt::format("{}{:.1f} {:.1f}", path.empty() ? 'M' : 'L', p.x(), p.y());
      }
    }
    return fmt::format("<path class=\"covered\" d=\"{}Z\"/>\n", path);
  }

 private:
  double rim_;
};

// ColorBrewer 2 YlGnBu, five classes: readable with any colour vision; dark is uncertain.
constexpr std::array<std::array<int, 3>, 5> kStops{
    {{255, 255, 204}, {161, 218, 180}, {65, 182, 196}, {44, 127, 184}, {37, 52, 148}}};

std::string colourOf(double fraction) {
  const double t = std::clamp(fraction, 0.0, 1.0) * (kStops.size() - 1);
  const auto index = std::min(static_cast<std::size_t>(t), kStops.size() - 2);
  const double f = t - static_cast<double>(index);
  const auto mix = [&](std::size_t c) {
    return static_cast<int>(
        std::lround(kStops[index][c] + f * (kStops[index + 1][c] - kStops[index][c])));
  };
  return fmt::format("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2));
}

std::string coverageMap(const LensCalibration& calibration, Angle rim) {
  const FisheyeModel& model = *calibration.model;
  const Disc disc(rim);
  std::string used;
  std::string thrown;
  for (const ViewResult& view : calibration.views) {
    for (const CornerResidual& corner : view.corners) {
      const auto direction = model.unproject(corner.pixel);
      if (!direction) continue;
      const Vector2d p = disc.at(*direction);
      const bool out = !view.rejected.empty() || !corner.rejected.empty();
      (out ? thrown : used) += fmt::format("M{:.1f} {:.1f}h0", p.x(), p.y());
    }
  }
  return disc.begin("where the corners fell") + disc.rings() +
         fmt::format("<path class=\"corner\" d=\"{}\"/>\n<path class=\"thrown\" d=\"{}\"/>\n", used,
                     thrown) +
         disc.covered(model) +
         "<path class=\"corner\" d=\"M60 548h0\"/><text x=\"70\" y=\"552\">corner used</text>"
         "<path class=\"thrown\" d=\"M190 548h0\"/><text x=\"200\" y=\"552\">thrown out</text>"
         "<path class=\"covered\" d=\"M320 548h26\"/><text x=\"352\" y=\"552\">covered "
         "field</text>\n"
         "</svg>\n";
}

std::string uncertaintyMap(const LensCalibration& calibration,
                           const std::vector<FieldSample>& samples, Angle rim) {
  const Disc disc(rim);
  double most = 1e-9;
  double least = 1e9;
  for (const FieldSample& s : samples) {
    if (!s.covered) continue;
    most = std::max(most, s.sigma.degrees());
    least = std::min(least, s.sigma.degrees());
  }
  // By factors: the rim is often ten times worse than the middle.
  least = std::max(std::min(least, most / 2), 1e-6);
  const auto fraction = [&](double degrees) {
    return std::log(std::max(degrees, least) / least) / std::log(most / least);
  };
  std::string svg = disc.begin("uncertainty of the direction");
  const double half = Angle::degrees(1.25).radians();
  const double turn = std::numbers::pi / 72;
  for (const FieldSample& s : samples) {
    if (!s.covered) continue;
    const Vector2d a = disc.at(s.theta - half, s.phi - turn);
    const Vector2d b = disc.at(s.theta + half, s.phi - turn);
    const Vector2d c = disc.at(s.theta + half, s.phi + turn);
    const Vector2d d = disc.at(s.theta - half, s.phi + turn);
    const std::string colour = colourOf(fraction(s.sigma.degrees()));
    svg += fmt::format(
        "<path fill=\"{0}\" stroke=\"{0}\" stroke-width=\"0.6\" d=\"M{1:.1f} {2:.1f}L{3:.1f} "
        "{4:.1f} {5:.1f} {6:.1f} {7:.1f} {8:.1f}Z\"/>\n",
        colour, a.x(), a.y(), b.x(), b.y(), c.x(), c.y(), d.x(), d.y());
  }
  svg += disc.rings() + disc.covered(*calibration.model);
  svg += "<defs><linearGradient id=\"sigma\">";
  for (std::size_t i = 0; i < kStops.size(); ++i) {
    svg += fmt::format("<stop offset=\"{}\" stop-color=\"{}\"/>",
                       static_cast<double>(i) / (kStops.size() - 1),
                       colourOf(static_cast<double>(i) / (kStops.size() - 1)));
  }
  svg += fmt::format(
      "</linearGradient></defs><rect x=\"120\" y=\"536\" width=\"300\" height=\"12\" rx=\"6\" "
      "fill=\"url(#sigma)\"/>\n<text x=\"120\" y=\"566\">{}°</text>"
      "<text x=\"270\" y=\"566\" text-anchor=\"middle\">{}</text>"
      "<text x=\"420\" y=\"566\" text-anchor=\"end\">{}°</text>\n</svg>\n",
      degreesText(Angle::degrees(least)), degreesText(Angle::degrees(std::sqrt(least * most))),
      degreesText(Angle::degrees(most)));
  return svg;
}

// --- Charts over the field angle -----------------------------------------------------------------

double niceCeiling(double value) {
  const double power = std::pow(10, std::floor(std::log10(value)));
  for (const double step : {1.0, 1.5, 2.0, 3.0, 5.0, 10.0}) {
    if (step * power >= value) return step * power;
  }
  return value;
}

struct Curve {
  std::string_view style;  // CSS classes
  std::string name;
  std::vector<double> values;  // per bin; NaN: a gap
};

// Curves over field angle, bins of 5 degrees.
std::string chart(const std::vector<Curve>& curves, std::string_view unit, std::string_view label) {
  constexpr double kLeft = 58, kTop = 26, kWidth = 470, kHeight = 250;
  std::size_t bins = 1;
  double most = 0;
  for (const Curve& curve : curves) {
    bins = std::max(bins, curve.values.size());
    for (const double value : curve.values) {
      if (std::isfinite(value)) most = std::max(most, value);
    }
  }
  if (!(most > 0)) most = 1;
  const double top = niceCeiling(most);
  const auto x = [&](double degrees) {
    return kLeft + kWidth * degrees / (kBin * static_cast<double>(bins));
  };
  const auto y = [&](double value) { return kTop + kHeight * (1 - value / top); };
  std::string svg = fmt::format(
      "<svg viewBox=\"0 0 545 {}\" role=\"img\" aria-label=\"{}\">\n<rect class=\"frame\" x=\"{}\" "
      "y=\"{}\" width=\"{}\" height=\"{}\"/>\n",
      330 + 18 * static_cast<int>(curves.size()), label, kLeft, kTop, kWidth, kHeight);
  for (int i = 0; i <= 4; ++i) {
    const double value = top * i / 4;
    svg += fmt::format(
        "<path class=\"grid\" d=\"M{0} {1:.1f}h{2}\"/><text x=\"{3}\" y=\"{4:.1f}\" "
        "text-anchor=\"end\">{5:.3g}</text>\n",
        kLeft, y(value), kWidth, kLeft - 6, y(value) + 4, value);
  }
  svg += fmt::format("<text x=\"{}\" y=\"{}\">{}</text>\n", 4, 11, unit);
  const int tick = bins > 12 ? 15 : 10;
  for (int degrees = 0; degrees <= static_cast<int>(kBin * static_cast<double>(bins));
       degrees += tick) {
    svg += fmt::format("<text x=\"{:.1f}\" y=\"{}\" text-anchor=\"middle\">{}°</text>\n",
                       x(degrees), kTop + kHeight + 18, degrees);
  }
  svg += fmt::format(
      "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">angle off the optical axis</text>\n",
      kLeft + kWidth / 2, kTop + kHeight + 36);
  int entry = 0;
  for (const Curve& curve : curves) {
    std::string path;
    bool down = false;
    for (std::size_t i = 0; i < curve.values.size(); ++i) {
      if (!std::isfinite(curve.values[i])) {
        down = false;
        continue;
      }
      path += fmt::format("{}{:.1f} {:.1f}", down ? 'L' : 'M',
                          x(kBin * (static_cast<double>(i) + 0.5)), y(curve.values[i]));
      down = true;
    }
    const double at = kTop + kHeight + 58 + 18 * entry++;
    svg += fmt::format(
        "<path class=\"line {0}\" d=\"{1}\"/><path class=\"line {0}\" d=\"M{2} {3}h30\"/>"
        "<text x=\"{4}\" y=\"{5}\">{6}</text>\n",
        curve.style, path, kLeft, at - 4, kLeft + 38, at, curve.name);
  }
  return svg + "</svg>\n";
}

std::vector<double> inDegrees(const std::vector<Angle>& angles) {
  std::vector<double> values;
  for (const Angle angle : angles) values.push_back(angle.degrees());
  return values;
}

// --- Residuals -----------------------------------------------------------------------------------

struct ResidualBins {
  std::vector<double> radial;      // rms, pixels
  std::vector<double> tangential;  // rms
  std::vector<double> drift;       // mean radial: what the lens cannot follow
  std::vector<int> counts;
};

ResidualBins residualBins(const LensCalibration& calibration) {
  ResidualBins bins;
  const FisheyeModel& model = *calibration.model;
  const Vector2d centre(model.values().cx, model.values().cy);
  for (const ViewResult& view : calibration.views) {
    if (!view.rejected.empty()) continue;
    for (const CornerResidual& corner : view.corners) {
      if (!corner.rejected.empty()) continue;
      const auto bin = static_cast<std::size_t>(std::max(0.0, corner.fieldAngle.degrees()) / kBin);
      if (bin > 40) continue;
      if (bin >= bins.counts.size()) {
        bins.radial.resize(bin + 1, 0);
        bins.tangential.resize(bin + 1, 0);
        bins.drift.resize(bin + 1, 0);
        bins.counts.resize(bin + 1, 0);
      }
      const Vector2d outwards = (corner.pixel - centre).stableNormalized();
      const double radial = corner.residual.dot(outwards);
      const double tangential =
          corner.residual.x() * -outwards.y() + corner.residual.y() * outwards.x();
      bins.radial[bin] += radial * radial;
      bins.tangential[bin] += tangential * tangential;
      bins.drift[bin] += radial;
      ++bins.counts[bin];
    }
  }
  for (std::size_t i = 0; i < bins.counts.size(); ++i) {
    const double n = bins.counts[i];
    bins.radial[i] = n > 0 ? std::sqrt(bins.radial[i] / n) : std::nan("");
    bins.tangential[i] = n > 0 ? std::sqrt(bins.tangential[i] / n) : std::nan("");
    bins.drift[i] = n > 0 ? std::abs(bins.drift[i] / n) : std::nan("");
  }
  return bins;
}

std::string residualPicture(const LensCalibration& calibration) {
  const FisheyeModel& model = *calibration.model;
  const double scale = 540.0 / model.width();
  const double height = scale * model.height();
  // A typical residual is drawn 4 to 8 units long.
  const double magnify =
      niceCeiling(4 / scale / std::max(1e-6, std::sqrt(2.0) * calibration.residualPixels));
  std::string used;
  std::string thrown;
  std::string feet;
  for (const ViewResult& view : calibration.views) {
    for (const CornerResidual& corner : view.corners) {
      const bool out = !view.rejected.empty() || !corner.rejected.empty();
      Vector2d arrow = scale * magnify * corner.residual;
      // What is far off would cross the picture; its direction is enough.
      if (arrow.norm() > 60) arrow *= 60 / arrow.norm();
      if (!arrow.allFinite()) arrow.setZero();
      const Vector2d p = scale * corner.pixel;
      (out ? thrown : used) +=
          fmt::format("M{:.1f} {:.1f}l{:.1f} {:.1f}", p.x(), p.y(), arrow.x(), arrow.y());
      feet += fmt::format("M{:.1f} {:.1f}h0", p.x(), p.y());
    }
  }
  return fmt::format(
      "<svg viewBox=\"0 0 540 {0:.0f}\" role=\"img\" aria-label=\"residuals over the picture\">\n"
      "<rect class=\"frame\" x=\"0.5\" y=\"0.5\" width=\"539\" height=\"{1:.1f}\"/>\n"
      "<path class=\"vector\" d=\"{2}\"/>\n<path class=\"vector out\" d=\"{3}\"/>\n"
      "<path class=\"foot\" d=\"{10}\"/>\n"
      "<path class=\"line a\" d=\"M12 {4:.1f}h{5:.1f}\"/>"
      "<text x=\"{6:.1f}\" y=\"{7:.1f}\">{8:.3g} px, {9:.0f} times enlarged</text>\n</svg>\n",
      height + 30, height - 1, used, thrown, height + 16, 20.0, 40.0, height + 20,
      20 / (scale * magnify), magnify, feet);
}

// --- Tables --------------------------------------------------------------------------------------

std::string tile(std::string_view value, std::string_view unit, std::string_view label) {
  return fmt::format("<div class=\"tile\"><b>{}<small> {}</small></b><span>{}</span></div>\n",
                     value, unit, label);
}

std::string fieldTable(const LensCalibration& calibration, const std::vector<Angle>& sigma,
                       const std::vector<Angle>& predicted, const std::optional<MrcalCheck>& mrcal,
                       const ResidualBins& residuals) {
  std::string rows;
  const auto entry = [](const std::vector<Angle>& values, std::size_t i) {
    return i < values.size() ? degreesText(values[i]) : std::string("&ndash;");
  };
  for (std::size_t i = 0; i < sigma.size(); ++i) {
    const int corners = i < residuals.counts.size() ? residuals.counts[i] : 0;
    rows += fmt::format(
        "<tr><td>{:.0f}° to {:.0f}°</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>{}</tr>\n",
        kBin * static_cast<double>(i), kBin * static_cast<double>(i + 1), corners, entry(sigma, i),
        entry(calibration.splitHalf.byFieldAngle, i), entry(predicted, i),
        mrcal ? fmt::format("<td>{}</td>", entry(mrcal->byFieldAngle, i)) : std::string());
  }
  return fmt::format(
      "<div class=\"wide\"><table>\n<thead><tr><th>off axis</th><th>corners</th><th>uncertainty"
      "<br>degrees</th><th>halves differ by<br>degrees</th><th>as predicted<br>degrees</th>{}"
      "</tr></thead>\n<tbody>\n{}</tbody>\n</table></div>\n",
      mrcal ? "<th>mrcal differs by<br>degrees</th>" : "", rows);
}

std::string viewTable(const LensCalibration& calibration) {
  std::string rows;
  for (const ViewResult& view : calibration.views) {
    std::size_t used = 0;
    double squares = 0;
    Angle farthest;
    for (const CornerResidual& corner : view.corners) {
      farthest = std::max(farthest, corner.fieldAngle);
      if (!corner.rejected.empty() || !view.rejected.empty()) continue;
      ++used;
      squares += corner.residual.squaredNorm();
    }
    rows += fmt::format(
        "<tr><td><code>{}</code></td><td>{}</td><td>{}</td><td>{}</td><td>{}</td>"
        "<td class=\"left{}\">{}</td></tr>\n",
        htmlEscaped(view.name), view.corners.size(), used, degreesText(farthest) + "°",
        used > 0 ? fmt::format("{:.3f}", std::sqrt(squares / (2 * static_cast<double>(used))))
                 : std::string("&ndash;"),
        view.rejected.empty() ? "" : " bad", htmlEscaped(view.rejected));
  }
  return "<div class=\"wide\"><table>\n<thead><tr><th>view</th><th>corners<br>found</th><th>corners"
         "<br>used</th><th>out to</th><th>residual rms<br>pixels</th><th class=\"left\">thrown out"
         "</th></tr></thead>\n<tbody>\n" +
         rows + "</tbody>\n</table></div>\n";
}

std::string thrownCorners(const LensCalibration& calibration) {
  std::string rows;
  std::size_t count = 0;
  for (const ViewResult& view : calibration.views) {
    if (!view.rejected.empty()) continue;
    for (const CornerResidual& corner : view.corners) {
      if (corner.rejected.empty()) continue;
      ++count;
      rows += fmt::format(
          "<tr><td><code>{}</code></td><td>{}, {}</td><td>{:.1f}, {:.1f}</td><td>{}°</td>"
          "<td>{:.2f}</td><td class=\"left\">{}</td></tr>\n",
          htmlEscaped(view.name), corner.column, corner.row, corner.pixel.x(), corner.pixel.y(),
          degreesText(corner.fieldAngle), corner.residual.norm(), htmlEscaped(corner.rejected));
    }
  }
  if (count == 0) return "<p>No single corner was thrown out.</p>\n";
  return fmt::format(
      "<details{}><summary>{} thrown out, each with its reason</summary>\n<div "
      "class=\"wide\"><table>\n<thead><tr><th>view</th><th>column, row</th><th>pixel</th><th>off "
      "axis</th><th>off by<br>pixels</th><th class=\"left\">why</th></tr></thead>\n<tbody>\n{}"
      "</tbody>\n</table></div>\n</details>\n",
      count <= 20 ? " open" : "", plural(count, "corner"), rows);
}

std::string parameterTable(const FisheyeModel& model) {
  static constexpr std::array<const char*, FisheyeLayout::kCount> kNames{
      "fx, pixels", "fy, pixels", "cx, pixels", "cy, pixels", "k0",         "k1",
      "k2",         "k3",         "k4",         "k5",         "p0",         "p1",
      "s0",         "s1",         "s2",         "s3",         "pupil a, m", "pupil b, m"};
  const Eigen::VectorXd values = model.values().vector();
  const Eigen::MatrixXd& covariance = model.uncertainty().covariance;
  std::string rows;
  for (int i = 0; i < FisheyeLayout::kCount; ++i) {
    const double sigma = covariance.size() ? std::sqrt(covariance(i, i)) : 0;
    if (values[i] == 0 && sigma == 0) continue;
    rows += fmt::format("<tr><td>{}</td><td>{:.6g}</td><td>{}</td></tr>\n",
                        kNames[static_cast<std::size_t>(i)], values[i],
                        sigma > 0 ? fmt::format("{:.2g}", sigma) : std::string("&ndash;"));
  }
  return "<table>\n<thead><tr><th>parameter</th><th>value</th><th>one sigma</th></tr></thead>\n"
         "<tbody>\n" +
         rows + "</tbody>\n</table>\n";
}

std::string list(const std::vector<std::string>& lines) {
  std::string items;
  for (const std::string& line : lines) items += fmt::format("<li>{}</li>\n", htmlEscaped(line));
  return "<ul>\n" + items + "</ul>\n";
}

}  // namespace

std::string lensReportHtml(const LensReport& report) {
  const LensCalibration& calibration = report.calibration;
  const FisheyeModel& model = *calibration.model;
  const auto samples = sampleField(model);
  const CoveredRange covered = coveredRange(model);
  const Angle sigma = overCovered(samples, &FieldSample::sigma);
  const auto sigmaBins = trimmed(binned(samples, &FieldSample::sigma));
  const auto predictedBins = trimmed(binned(samples, &FieldSample::halfDifference));
  const ResidualBins residuals = residualBins(calibration);
  const SplitHalf& halves = calibration.splitHalf;
  // A little beyond the corners: the model's own end may be far outside the picture.
  const Angle rim =
      std::min(model.maxFieldAngle(),
               covered.known ? covered.most + Angle::degrees(12) : Angle::degrees(180));

  std::string page = fmt::format(
      "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta "
      "name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>Lens of {0}"
      "</title>\n<style>{1}</style>\n</head>\n<body>\n<main>\n<header>\n<h1>The lens of &ldquo;{0}"
      "&rdquo;</h1>\n<p class=\"lead\">Inside the covered field{2} the direction of a pixel is "
      "known to <strong>{3}&thinsp;degrees</strong> (one sigma, rms over the field).{4} Beyond it "
      "nothing is known, and directions there are flagged.</p>\n</header>\n",
      htmlEscaped(report.title), kStyle,
      covered.known ? fmt::format(", out to {}° to {}° off the axis depending on the side,",
                                  degreesText(covered.least), degreesText(covered.most))
                    : std::string(),
      degreesText(sigma),
      halves.splits > 0
          ? fmt::format(" Lenses from two random halves of the views differ by {} degrees there, "
                        "where {} were predicted.",
                        degreesText(halves.rms), degreesText(halves.predicted))
          : std::string());

  page += "<div class=\"tiles\">\n";
  if (covered.known) {
    page +=
        tile(fmt::format("{:.0f}&ndash;{:.0f}", covered.least.degrees(), covered.most.degrees()),
             "degrees", "covered field off the axis, least and most over the azimuth");
  }
  page +=
      tile(degreesText(sigma), "degrees", "predicted uncertainty of a direction, covered field");
  if (halves.splits > 0) {
    page += tile(degreesText(halves.rms), "degrees",
                 fmt::format("two halves of the views differ, rms over {} splits; predicted {}",
                             halves.splits, degreesText(halves.predicted)));
  }
  if (report.mrcal) {
    page += tile(degreesText(report.mrcal->rms), "degrees",
                 fmt::format("mrcal&#39;s lens differs, rms; at most {}",
                             degreesText(report.mrcal->largest)));
  }
  page += tile(fmt::format("{}", calibration.viewsUsed),
               fmt::format("of {}", calibration.views.size()), "views used");
  std::size_t corners = 0;
  for (const ViewResult& view : calibration.views) corners += view.corners.size();
  page += tile(fmt::format("{}", calibration.cornersUsed), fmt::format("of {}", corners),
               "corners used");
  page += "</div>\n";

  if (!calibration.warnings.empty() || !calibration.advice.empty()) {
    page += "<div class=\"todo\">\n";
    if (!calibration.warnings.empty()) {
      page += "<strong>Mind</strong>\n" + list(calibration.warnings);
    }
    if (!calibration.advice.empty()) {
      page += "<strong>What to shoot next</strong>\n" + list(calibration.advice);
    }
    page += "</div>\n";
  }

  page +=
      "<section>\n<h2>Where the lens is known</h2>\n<div class=\"two\">\n<figure>\n" +
      coverageMap(calibration, rim) +
      "<figcaption>Where the corners fell, seen along the axis: the distance from the middle is "
      "the "
      "angle off the axis. The covered field ends one degree inside the outermost corner of each "
      "azimuth.</figcaption>\n</figure>\n<figure>\n" +
      uncertaintyMap(calibration, samples, rim) +
      "<figcaption>Uncertainty of the direction in degrees (one sigma, both axes together) from "
      "the "
      "solve&#39;s covariance and what the lens does beyond its model, after the best common "
      "rotation.</figcaption>\n</figure>\n</div>\n</section>\n";

  std::vector<Curve> trust{{"a", "predicted uncertainty, one sigma", inDegrees(sigmaBins)}};
  if (halves.splits > 0) {
    trust.push_back({"b", "difference between lenses from two halves of the views, rms",
                     inDegrees(trimmed(halves.byFieldAngle))});
    trust.push_back({"b dashed", "the same difference as the covariance predicts it",
                     inDegrees(predictedBins)});
  }
  if (report.mrcal) {
    trust.push_back({"c", "difference from mrcal&#39;s splined lens, rms",
                     inDegrees(trimmed(report.mrcal->byFieldAngle))});
  }
  page += "<section>\n<h2>How far it can be trusted</h2>\n<div class=\"two\">\n<figure>\n" +
          chart(trust, "degrees", "uncertainty by field angle") + "</figure>\n<div>\n";
  if (halves.splits > 0) {
    const double ratio = halves.rms.radians() / halves.predicted.radians();
    page += fmt::format(
        "<p>The views were split at random into halves {} times and the lens solved from each half "
        "alone. The two differ by {} degrees rms inside the field that both cover and by {} in the "
        "worst direction. That is {:.2f} times what the covariance predicts: {}.</p>\n",
        halves.splits, degreesText(halves.rms), degreesText(halves.largest), ratio,
        ratio > 2 ? "the prediction is too confident: the lens does something that the model does "
                    "not know; trust the measured difference"
        : ratio < 0.5 ? "the prediction is too cautious"
                      : "the prediction can be believed");
  }
  if (report.mrcal) {
    page += fmt::format(
        "<p>mrcal solved its own lens, <code>{}</code>, from the same corners: it differs by {} "
        "degrees rms and at most {} over the covered field. It shares the corners, so a mistake in "
        "the board does not show here.{}</p>\n",
        htmlEscaped(report.mrcal->lens), degreesText(report.mrcal->rms),
        degreesText(report.mrcal->largest),
        model.values().pupilMetres == std::array<double, 2>{}
            ? ""
            : " Our lens has a moving pupil and mrcal&#39;s has none, which is part of it.");
  }
  page +=
      "<p class=\"soft\">A small residual does not make a lens right: it says nothing about "
      "directions where no corner fell.</p>\n</div>\n</div>\n" +
      fieldTable(calibration, sigmaBins, predictedBins, report.mrcal, residuals) + "</section>\n";

  page += fmt::format(
      "<section>\n<h2>Residuals</h2>\n<p>How far the solved lens puts the corners from where they "
      "were seen, {:.3f}&thinsp;pixels rms per coordinate over the {} corners used. Arrows that "
      "agree with their neighbours are what the lens cannot follow; arrows at random are "
      "noise.</p>\n"
      "<div class=\"two\">\n<figure>\n{}<figcaption>Over the picture, from the corner as seen "
      "(dot) to where it was predicted; thrown out ones in red.</figcaption>\n</figure>\n<figure>\n"
      "{}<figcaption>By field angle. A mean radial residual that is not zero is an error of the "
      "model, not noise.</figcaption>\n</figure>\n</div>\n</section>\n",
      calibration.residualPixels, calibration.cornersUsed, residualPicture(calibration),
      chart({{"a", "radial, rms", residuals.radial},
             {"b", "tangential, rms", residuals.tangential},
             {"c", "radial, mean without its sign", residuals.drift}},
            "pixels", "residuals by field angle"));

  if (!calibration.trials.empty()) {
    page +=
        "<section>\n<h2>Which lens equation</h2>\n<p>A richer equation is taken only where views "
        "that the solve did not see say that it is better.</p>\n<table>\n<thead><tr><th>family</th>"
        "<th>unseen views<br>pixels rms</th><th>halves differ by<br>degrees</th><th></th></tr>"
        "</thead>\n<tbody>\n";
    for (const FamilyTrial& trial : calibration.trials) {
      page += fmt::format("<tr{}><td>{}</td><td>{:.3f}</td><td>{}</td><td>{}</td></tr>\n",
                          trial.chosen ? " class=\"chosen\"" : "",
                          htmlEscaped(describe(trial.family)), trial.heldOutPixels,
                          degreesText(trial.splitHalf), trial.chosen ? "chosen" : "");
    }
    page += "</tbody>\n</table>\n</section>\n";
  }

  page += "<section>\n<h2>Views and corners</h2>\n" + viewTable(calibration) +
          thrownCorners(calibration);
  std::string without;
  std::size_t withoutCount = 0;
  for (const BoardDetection& picture : report.pictures) {
    if (picture.reason.empty()) continue;
    ++withoutCount;
    without += fmt::format("<tr><td><code>{}</code></td><td class=\"left\">{}</td></tr>\n",
                           htmlEscaped(picture.view.name), htmlEscaped(picture.reason));
  }
  if (withoutCount > 0) {
    page += fmt::format(
        "<h3>{} without a board</h3>\n<table>\n<thead><tr><th>picture</th><th class=\"left\">why"
        "</th></tr></thead>\n<tbody>\n{}</tbody>\n</table>\n",
        plural(withoutCount, "picture"), without);
  }
  page += "</section>\n";

  page += fmt::format(
      "<section>\n<h2>The lens itself</h2>\n<div class=\"two\">\n<div>\n{}</div>\n<div>\n<p>{}, "
      "{} &times; {} pixels. The board is bent by {:.2f}&thinsp;mm along its columns&#39; "
      "direction "
      "and {:.2f}&thinsp;mm along its rows&#39;, which the solve took into account. Solved in "
      "{:.2f}&thinsp;s.</p>\n<p class=\"soft\">Pixels: the centre of the top-left pixel is at "
      "(0.5, "
      "0.5). What the lens does beyond its equation: {} degrees, one sigma.</p>\n</div>\n</div>\n"
      "</section>\n<footer>{}</footer>\n</main>\n</body>\n</html>\n",
      parameterTable(model), htmlEscaped(describe(calibration.family)), model.width(),
      model.height(), 1000 * calibration.warpMetres.x(), 1000 * calibration.warpMetres.y(),
      calibration.solveSeconds, degreesText(model.uncertainty().modelError),
      htmlEscaped(report.software));
  return page;
}

Result<void> writeLensReport(const LensReport& report, const std::filesystem::path& path) {
  return writeFileAtomically(path, lensReportHtml(report));
}

}  // namespace lightsketch
