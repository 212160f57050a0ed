// A report as `lightsketch validate` wrote it, as far as the Validate page shows it.
#pragma once

#include <Eigen/Core>
#include <QString>
#include <filesystem>
#include <memory>
#include <vector>

#include "capture/frame/json.h"
#include "capture/frame/result.h"

namespace lightsketch {

struct StoredReport {
  struct Light {
    int id = 0;
    QString origin;
    Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();
    bool insideHull = false;
    double nearest = 0;  // degrees
    double psnr = 0, ssim = 0, relative = 0;
  };
  std::filesystem::path folder;
  Json figures;
  std::vector<Light> lights;
  double pictureExposure = 1;

  // Fails where there is no report, or not one.
  static Result<std::shared_ptr<const StoredReport>> read(const std::filesystem::path& folder);
  // The mean errors, those of the worst, the median and the best light, and the size; HTML.
  QString table() const;
};

// NaN where it is not a number.
double numberAt(const Json& object, const char* name);
// A dash for NaN.
QString shown(double value, int digits);

}  // namespace lightsketch
