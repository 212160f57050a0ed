#include "ui/app/stored_report.h"

#include <QObject>
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace lightsketch {

double numberAt(const Json& object, const char* name) {
  const auto at = object.find(name);
  return at != object.end() && at->is_number() ? at->get<double>() : std::nan("");
}

QString shown(double value, int digits) {
  return std::isfinite(value) ? QString::number(value, 'f', digits) : QString("\u2013");
}

Result<std::shared_ptr<const StoredReport>> StoredReport::read(
    const std::filesystem::path& folder) {
  auto report = std::make_shared<StoredReport>();
  report->folder = folder;
  ASSIGN_OR_RETURN(report->figures, readJsonFile(folder / "report.json"));
  try {
    const Json& figures = report->figures;
    if (figures.at("format") != "lightsketch-validation") throw std::runtime_error("");
    report->pictureExposure = figures.value("pictureExposure", 1.0);
    for (const Json& entry : figures.at("lights")) {
      Light light;
      light.id = entry.at("id").get<int>();
      light.origin = QString::fromStdString(entry.value("origin", std::string()));
      const auto xyz = entry.at("direction").get<std::vector<double>>();
      light.direction = {xyz.at(0), xyz.at(1), xyz.at(2)};
      light.insideHull = entry.at("insideHull").get<bool>();
      light.nearest = numberAt(entry, "nearestCapturedDegrees");
      light.psnr = numberAt(entry, "psnrDb");
      light.ssim = numberAt(entry, "ssim");
      light.relative = numberAt(entry, "relativeError");
      report->lights.push_back(light);
    }
  } catch (const std::exception&) {
    return failure(ErrorCode::kCorrupt,
                   "{}: not what `lightsketch validate` wrote; validate the sketch again",
                   (folder / "report.json").string());
  }
  return report;
}

QString StoredReport::table() const {
  QString text = "<table cellspacing='0' cellpadding='3' width='100%'><tr>";
  for (const QString& head : {QString(), QObject::tr("lights"), QObject::tr("PSNR dB"),
                              QObject::tr("SSIM"), QObject::tr("error %")})
    text += QString("<th align='%1'>%2</th>").arg(head.isEmpty() ? "left" : "right", head);
  text += "</tr>";
  const auto line = [&](const QString& name, const QString& count, const Json& error, bool bold) {
    text += QString("<tr><td>%1</td><td align='right'>%2</td>").arg(name, count);
    const std::pair<double, int> values[] = {{numberAt(error, "psnrDb"), 2},
                                             {numberAt(error, "ssim"), 4},
                                             {100 * numberAt(error, "relativeError"), 2}};
    for (const auto& [value, digits] : values) {
      text += QString(bold ? "<td align='right'><b>%1</b></td>" : "<td align='right'>%1</td>")
                  .arg(shown(value, digits));
    }
    text += "</tr>";
  };
  const auto mean = [&](const char* key, const QString& name, bool bold) {
    const Json error = figures.value(key, Json::object());
    line(name, QString::number(error.value("count", 0)), error, bold);
  };
  mean("mean", QObject::tr("<b>all kept back</b>"), true);
  mean("insideHull", QObject::tr("inside"), false);
  mean("outsideHull", QObject::tr("outside"), false);
  for (const auto& [key, name] : {std::pair{"worst", QObject::tr("worst")},
                                  {"median", QObject::tr("median")},
                                  {"best", QObject::tr("best")}}) {
    const int id = figures.value(key, -1);
    const auto& entries = figures.at("lights");
    const auto at = std::ranges::find_if(
        entries, [&](const Json& light) { return light.at("id").get<int>() == id; });
    if (at != entries.end()) line(name, QString("#%1").arg(id), *at, false);
  }
  text += "</table>";
  if (const auto size = figures.find("size"); size != figures.end()) {
    text += QObject::tr(
                "<p style='margin:4px'>%1 MB, %2 bits per pixel, %3 : 1 against half floats</p>")
                .arg(numberAt(*size, "bytes") / 1e6, 0, 'f', 2)
                .arg(numberAt(*size, "bitsPerPixel"), 0, 'f', 1)
                .arg(numberAt(*size, "ratioToHalf"), 0, 'f', 0);
  }
  return text;
}

}  // namespace lightsketch
