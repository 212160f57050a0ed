#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <string_view>
#include <system_error>

#include "calibration/radiometry/response_file.h"
#include "calibration/radiometry/summary_json.h"
#include "capture/frame/file.h"

namespace lightsketch {
namespace {

constexpr std::string_view kStyle = R"css(
:root { color-scheme: light dark; --paper: #fff; --panel: #f5f6f8; --ink: #1b1e23; --soft: #5c6470; --line: #dcdfe5; }
@media (prefers-color-scheme: dark) {
  :root { --paper: #14161a; --panel: #1d2026; --ink: #e7e9ed; --soft: #9aa3b0; --line: #333842; }
}
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 15px/1.55 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 40px 28px 80px; }
h1 { font-size: 29px; margin: 0 0 6px; } h2 { font-size: 20px; margin: 40px 0 6px; padding-top: 14px; border-top: 1px solid var(--line); }
p { max-width: 76ch; margin: 6px 0 12px; } .soft { color: var(--soft); }
.plots { display: grid; grid-template-columns: repeat(auto-fit, minmax(440px, 1fr)); gap: 24px; }
svg { width: 100%; height: auto; display: block; }
svg text { fill: var(--soft); font-size: 12px; } .grid { stroke: var(--line); } .frame { fill: var(--panel); stroke: var(--line); }
.c0 { stroke: #c4423a; fill: #c4423a; } .c1 { stroke: #2f8f4a; fill: #2f8f4a; } .c2 { stroke: #3a6fc4; fill: #3a6fc4; } .g0 { stroke: var(--ink); fill: var(--ink); }
path { fill: none !important; stroke-width: 1.8; } circle { stroke: none; fill-opacity: 0.45; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; width: 100%; }
th, td { text-align: right; padding: 5px 10px; border-bottom: 1px solid var(--line); } th:first-child, td:first-child { text-align: left; }
th { color: var(--soft); font-size: 13px; vertical-align: bottom; }
@media print { main { max-width: none; padding: 0; } svg, tr { break-inside: avoid; } }
)css";

std::string colourClass(const ResponseSummary& summary, int colour) {
  return summary.colours.size() == 1 ? "g0" : fmt::format("c{}", colour);
}

// A frame with ticks; what is drawn in it is clipped to it.
class Plot {
 public:
  struct Axis {
    std::string label;
    double low, high;
    bool logarithmic = false;
  };
  Plot(Axis x, Axis y) : x_(std::move(x)), y_(std::move(y)) {
    svg_ = fmt::format(
        "<svg viewBox=\"0 0 520 360\" role=\"img\"><rect class=\"frame\" x=\"{}\" "
        "y=\"{}\" width=\"{}\" height=\"{}\"/>\n",
        kLeft, kTop, kWidth, kHeight);
    for (const double tick : ticks(x_)) {
      const double at = px(tick);
      svg_ += fmt::format(
          "<line class=\"grid\" x1=\"{0:.1f}\" x2=\"{0:.1f}\" y1=\"{1}\" y2=\"{2}\"/>"
          "<text x=\"{0:.1f}\" y=\"{3}\" text-anchor=\"middle\">{4:g}</text>\n",
          at, kTop, kTop + kHeight, kTop + kHeight + 16, tick);
    }
    for (const double tick : ticks(y_)) {
      const double at = py(tick);
      svg_ += fmt::format(
          "<line class=\"grid\" y1=\"{0:.1f}\" y2=\"{0:.1f}\" x1=\"{1}\" x2=\"{2}\"/>"
          "<text x=\"{3}\" y=\"{4:.1f}\" text-anchor=\"end\">{5:g}</text>\n",
          at, kLeft, kLeft + kWidth, kLeft - 6, at + 4, tick);
    }
    svg_ += fmt::format(
        "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">{}</text>"
        "<text x=\"{}\" y=\"14\">{}</text>\n",
        kLeft + kWidth / 2, kTop + kHeight + 36, x_.label, kLeft, y_.label);
  }
  template <class F>
  void curve(const std::string& style, F f) {
    std::string path;
    bool pen = false;
    for (int i = 0; i <= 240; ++i) {
      const double t = i / 240.0;
      const double x =
          x_.logarithmic ? x_.low * std::pow(x_.high / x_.low, t) : x_.low + t * (x_.high - x_.low);
      const double y = f(x);
      const bool inside = y >= y_.low && y <= y_.high;
      if (inside) path += fmt::format("{}{:.1f} {:.1f}", pen ? 'L' : 'M', px(x), py(y));
      pen = inside;
    }
    svg_ += fmt::format("<path class=\"{}\" d=\"{}\"/>\n", style, path);
  }
  void point(const std::string& style, double x, double y, double radius) {
    if (!(x >= x_.low && x <= x_.high && y >= y_.low && y <= y_.high)) return;
    svg_ += fmt::format("<circle class=\"{}\" cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"{}\"/>", style, px(x),
                        py(y), radius);
  }
  std::string finish() && { return svg_ + "</svg>\n"; }

 private:
  static constexpr double kLeft = 62, kTop = 24, kWidth = 440, kHeight = 290;

  static double part(const Axis& axis, double value) {
    return axis.logarithmic ? std::log(value / axis.low) / std::log(axis.high / axis.low)
                            : (value - axis.low) / (axis.high - axis.low);
  }
  double px(double x) const { return kLeft + kWidth * part(x_, x); }
  double py(double y) const { return kTop + kHeight * (1 - part(y_, y)); }
  static std::vector<double> ticks(const Axis& axis) {
    std::vector<double> list;
    if (axis.logarithmic) {
      for (double t = std::pow(10, std::ceil(std::log10(axis.low) - 1e-9)); t <= axis.high * 1.001;
           t *= 10) {
        list.push_back(t);
      }
      return list;
    }
    // 1, 2 or 5 times a power of ten, about six of them.
    const double rough = (axis.high - axis.low) / 6;
    const double power = std::pow(10, std::floor(std::log10(rough)));
    const double step = power * (rough / power < 1.5 ? 1 : rough / power < 3.5 ? 2 : 5);
    for (double t = std::ceil(axis.low / step) * step; t <= axis.high * 1.0001 + 1e-12; t += step) {
      list.push_back(std::abs(t) < step * 1e-6 ? 0 : t);
    }
    return list;
  }

  Axis x_, y_;
  std::string svg_;
};

std::string curvePlot(const ResponseCalibration& calibration) {
  const ResponseCurve& response = calibration.sensor.response;
  Plot plot({"count", 0, response.maxCount()}, {"exposure (1 is saturation)", 0, 1.02});
  for (int c = 0; c < response.colours(); ++c) {
    plot.curve(colourClass(calibration.summary, c),
               [&](double count) { return response.exposure(count, c); });
  }
  return std::move(plot).finish();
}

std::string residualPlot(const ResponseCalibration& calibration) {
  const ResponseSummary& summary = calibration.summary;
  double reach = 0;
  for (const auto& colour : summary.colours) reach = std::max(reach, 4 * colour.residual);
  reach = std::max(reach, 1.0);
  Plot plot({"predicted count", 0, calibration.sensor.response.maxCount()},
            {"seen minus predicted, counts", -reach, reach});
  for (const auto& p : summary.residuals) plot.point(colourClass(summary, p.colour), p.x, p.y, 1.4);
  return std::move(plot).finish();
}

std::string transferPlot(const ResponseCalibration& calibration) {
  const ResponseSummary& summary = calibration.summary;
  double low = 1, lowVariance = 1, highVariance = 0;
  for (const auto& p : summary.photonTransfer) {
    if (p.x > 0) low = std::min(low, p.x);
    if (p.y > 0) lowVariance = std::min(lowVariance, p.y);
    highVariance = std::max(highVariance, p.y);
  }
  if (!(highVariance > 0)) return "";
  Plot plot({"exposure (1 is saturation)", std::max(low / 2, 1e-5), 1.2, true},
            {"variance of the exposure", lowVariance / 3, highVariance * 3, true});
  for (const auto& p : summary.photonTransfer) {
    plot.point(colourClass(summary, p.colour), p.x, p.y, 2.6);
  }
  for (std::size_t c = 0; c < summary.colours.size(); ++c) {
    plot.curve(colourClass(summary, static_cast<int>(c)), [&](double exposure) {
      return calibration.sensor.noise.exposureVariance(exposure, 0, static_cast<int>(c),
                                                       calibration.sensor.noise.gainDb);
    });
  }
  return std::move(plot).finish();
}

std::string hotPixelMap(const SensorModel& sensor) {
  // Beyond some thousand the map shows where they crowd, not each of them.
  const std::size_t stride = sensor.hotPixels.size() / 4000 + 1;
  std::string svg = fmt::format(
      "<svg viewBox=\"0 0 {0} {1}\" role=\"img\"><rect class=\"frame\" width=\"{0}\" "
      "height=\"{1}\"/>\n",
      sensor.width, sensor.height);
  const double radius = std::max(sensor.width, sensor.height) / 250.0;
  for (std::size_t i = 0; i < sensor.hotPixels.size(); i += stride) {
    svg += fmt::format("<circle class=\"c0\" cx=\"{}\" cy=\"{}\" r=\"{:.1f}\"/>",
                       sensor.hotPixels[i].x + 0.5, sensor.hotPixels[i].y + 0.5, radius);
  }
  return svg + "</svg>\n";
}

// Contour lines of one colour by marching squares over the grid's cells.
std::string flatMap(const SensorModel& sensor, int colour, const std::string& style) {
  const FlatField& field = *sensor.flatField;
  const double width = 480;
  const double height = width * sensor.height / sensor.width;
  std::string svg = fmt::format(
      "<svg viewBox=\"0 0 {0} {1:.0f}\" role=\"img\"><rect class=\"frame\" width=\"{0}\" "
      "height=\"{1:.0f}\"/>\n",
      width, height);
  double lowest = 1;
  for (int j = 0; j < field.rows(); ++j) {
    for (int i = 0; i < field.columns(); ++i) lowest = std::min(lowest, field.node(i, j, colour));
  }
  const double interval = 1 - lowest > 0.4 ? 0.1 : 1 - lowest > 0.15 ? 0.05 : 0.01;
  for (double level = 1 - interval; level > lowest; level -= interval) {
    std::string path;
    std::array<double, 2> label{-1, -1};
    for (int j = 0; j + 1 < field.rows(); ++j) {
      for (int i = 0; i + 1 < field.columns(); ++i) {
        const std::array<std::array<int, 2>, 4> corner{
            {{i, j}, {i + 1, j}, {i + 1, j + 1}, {i, j + 1}}};
        std::vector<std::array<double, 2>> crossings;
        for (std::size_t e = 0; e < 4; ++e) {
          const auto& a = corner[e];
          const auto& b = corner[(e + 1) % 4];
          const double va = field.node(a[0], a[1], colour) - level;
          const double vb = field.node(b[0], b[1], colour) - level;
          if ((va < 0) == (vb < 0)) continue;
          const double t = va / (va - vb);
          crossings.push_back({(a[0] + t * (b[0] - a[0])) / (field.columns() - 1) * width,
                               (a[1] + t * (b[1] - a[1])) / (field.rows() - 1) * height});
        }
        for (std::size_t k = 0; k + 1 < crossings.size(); k += 2) {
          path += fmt::format("M{:.1f} {:.1f}L{:.1f} {:.1f}", crossings[k][0], crossings[k][1],
                              crossings[k + 1][0], crossings[k + 1][1]);
          if (crossings[k][0] > label[0]) label = crossings[k];
        }
      }
    }
    svg += fmt::format("<path class=\"{}\" d=\"{}\"/>", style, path);
    if (label[0] >= 0) {
      svg += fmt::format("<text x=\"{:.1f}\" y=\"{:.1f}\" text-anchor=\"end\">{:.0f} %</text>\n",
                         std::min(label[0] + 2, width - 3), label[1] - 3, 100 * level);
    }
  }
  return svg + "</svg>\n";
}

std::string html(const ResponseCalibration& calibration) {
  const SensorModel& sensor = calibration.sensor;
  const ResponseSummary& summary = calibration.summary;
  double deviation = 0;
  for (const auto& colour : summary.colours)
    deviation = std::max(deviation, colour.linearDeviation);
  std::string page = fmt::format(
      "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta "
      "name=\"viewport\" content=\"width=device-width\">\n<title>Response</title>\n<style>{}"
      "</style>\n</head>\n<body>\n<main>\n<h1>The sensor is {}</h1>\n<p>Its curve leaves a "
      "straight "
      "line by at most {:.2f} % of full scale. {} &times; {} {}, saturation at {:g} of {:g} "
      "counts.</p>\n",
      kStyle, summary.linear ? "linear" : "not linear", 100 * deviation, sensor.width,
      sensor.height, pixelFormatInfo(sensor.format).name, sensor.response.saturationCount(),
      sensor.response.maxCount());
  page +=
      "<table>\n<thead><tr><th>colour</th><th>black level<br>counts</th><th>deviation<br>from a "
      "line</th><th>residual<br>counts</th><th>known from .. to<br>counts</th><th>curve, one "
      "sigma</th><th>electrons<br>to saturation</th><th>read noise<br>electrons</th><th>counts"
      "<br>per electron</th></tr></thead>\n<tbody>\n";
  for (std::size_t c = 0; c < summary.colours.size(); ++c) {
    const auto& colour = summary.colours[c];
    const auto i = static_cast<int>(c);
    const ChannelNoise& noise = sensor.noise.channel(i);
    const auto withSigma = [&](double value, double sigma, int digits) {
      return summary.noiseFromPairs
                 ? fmt::format("{:.{}f} &plusmn; {:.{}f}", value, digits, sigma, digits)
                 : fmt::format("about {:.{}f}", value, digits);
    };
    page += fmt::format(
        "<tr><td>{}</td><td>{:.2f} &plusmn; {:.2f}{}</td><td>{:.2f} "
        "%</td><td>{:.2f}</td><td>{:.0f} "
        ".. {:.0f}</td><td>{:.2f} %</td><td>{}</td><td>{}</td><td>{:.4f}</td></tr>\n",
        colour.name, colour.blackCount, colour.blackSigma, colour.blackClipped ? ", clipped" : "",
        100 * colour.linearDeviation, colour.residual, colour.lowestCount, colour.highestCount,
        100 * colour.curveSigma, withSigma(noise.electronsAtSaturation, colour.electronsSigma, 0),
        withSigma(noise.readNoiseElectrons, colour.readNoiseSigma, 1),
        sensor.noise.countsPerElectron(sensor.response, i));
  }
  page += "</tbody>\n</table>\n<div class=\"plots\">\n<section><h2>Response</h2>\n" +
          curvePlot(calibration) +
          fmt::format(
              "<p class=\"soft\">Outside the counts that the bracket reached the curve is "
              "extrapolated.</p></section>\n<section><h2>Residuals</h2>\n{}<p "
              "class=\"soft\">{} places of the scene; {:.1f} % of them contradict "
              "themselves between exposures. A trend along the counts would mean that the "
              "curve is wrong.</p></section>\n",
              residualPlot(calibration), summary.places, 100 * summary.disagreeing);
  page += fmt::format(
      "<section><h2>Photon transfer</h2>\n{}<p class=\"soft\">{} Line: the model, variance = "
      "exposure / electrons + (read noise / electrons)&sup2;.</p></section>\n",
      transferPlot(calibration),
      summary.noiseFromPairs
          ? "From differences of two frames of the same exposure, rounding's 1/12 taken off."
          : "From the residuals of the curve: an estimate only. Take two frames per exposure for "
            "a measurement.");
  if (summary.darkFrames > 0) {
    page += fmt::format(
        "<section><h2>Hot pixels: {}</h2>\n{}<p class=\"soft\">From {} dark "
        "frames.</p></section>\n",
        sensor.hotPixels.size(), hotPixelMap(sensor), summary.darkFrames);
  }
  if (sensor.flatField) {
    for (int c = 0; c < sensor.flatField->colours(); ++c) {
      page += fmt::format(
          "<section><h2>Flat field, {}</h2>\n{}<p class=\"soft\">Falls to {:.1f} %; nodes &plusmn; "
          "{:.2f} %.</p></section>\n",
          summary.colours[static_cast<std::size_t>(c)].name,
          flatMap(sensor, c, colourClass(summary, c)),
          100 * summary.colours[static_cast<std::size_t>(c)].flatLowest,
          100 * summary.colours[static_cast<std::size_t>(c)].flatSigma);
    }
  }
  page +=
      "</div>\n<h2>Exposures</h2>\n<table>\n<thead><tr><th>bracket</th><th>nominal "
      "s</th><th>frames</th><th>true against nominal</th></tr></thead>\n<tbody>\n";
  for (const auto& exposure : summary.exposures) {
    page += fmt::format("<tr><td>{}</td><td>{:g}</td><td>{}</td><td>{}</td></tr>\n",
                        exposure.bracket + 1, exposure.seconds, exposure.frames,
                        summary.timesEstimated ? fmt::format("{:+.2f} %", 100 * exposure.timeError)
                                               : std::string("taken as given"));
  }
  return page + "</tbody>\n</table>\n</main>\n</body>\n</html>\n";
}

}  // namespace

Json toJson(const ResponseSummary& summary) {
  Json json = {{"linear", summary.linear},
               {"timesEstimated", summary.timesEstimated},
               {"noiseFromPairs", summary.noiseFromPairs},
               {"disagreeing", summary.disagreeing},
               {"places", summary.places},
               {"darkFrames", summary.darkFrames},
               {"flatFrames", summary.flatFrames},
               {"colours", Json::array()},
               {"exposures", Json::array()}};
  for (const auto& colour : summary.colours) {
    json["colours"].push_back({{"name", colour.name},
                               {"blackCount", colour.blackCount},
                               {"blackSigma", colour.blackSigma},
                               {"blackClipped", colour.blackClipped},
                               {"linearDeviation", colour.linearDeviation},
                               {"residual", colour.residual},
                               {"lowestCount", colour.lowestCount},
                               {"highestCount", colour.highestCount},
                               {"curveSigma", colour.curveSigma},
                               {"electronsSigma", colour.electronsSigma},
                               {"readNoiseSigma", colour.readNoiseSigma},
                               {"flatSigma", colour.flatSigma},
                               {"flatLowest", colour.flatLowest}});
  }
  for (const auto& exposure : summary.exposures) {
    json["exposures"].push_back({{"bracket", exposure.bracket},
                                 {"seconds", exposure.seconds},
                                 {"frames", exposure.frames},
                                 {"timeError", exposure.timeError}});
  }
  return json;
}

Result<void> writeResponseReport(const ResponseCalibration& calibration,
                                 const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) {
    return failure(ErrorCode::kIo, "{}: cannot create the folder: {}", folder.string(),
                   error.message());
  }
  Json json = sensorModelToJson(calibration.sensor);
  json["summary"] = toJson(calibration.summary);
  RETURN_IF_ERROR(writeJsonFile(folder / "report.json", json));
  return writeFileAtomically(folder / "index.html", html(calibration));
}

}  // namespace lightsketch
