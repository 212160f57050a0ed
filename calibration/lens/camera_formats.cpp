#include "calibration/lens/camera_formats.h"

#include <ceres/ceres.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

#include "calibration/lens/foreign_lens.h"
#include "calibration/lens/mrcal_spline.h"
#include "calibration/model/fisheye_projection.h"
#include "capture/frame/direction.h"
#include "capture/frame/file.h"

namespace lightsketch {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr std::array<std::pair<CameraFormat, std::string_view>, 5> kNames{{
    {CameraFormat::kLightsketch, "lightsketch"},
    {CameraFormat::kOpenCv, "opencv"},
    {CameraFormat::kKalibr, "kalibr"},
    {CameraFormat::kKalibrDoubleSphere, "kalibr-ds"},
    {CameraFormat::kMrcal, "mrcal"},
}};

constexpr Angle kRightAngle = Angle::degrees(90);

// --- Refits --------------------------------------------------------------------------------------

bool insideOf(const std::vector<Vector2d>& polygon, const Vector2d& pixel) {
  std::vector<cv::Point2f> contour;
  for (const Vector2d& p : polygon) {
    contour.emplace_back(static_cast<float>(p.x()), static_cast<float>(p.y()));
  }
  return cv::pointPolygonTest(
             contour, {static_cast<float>(pixel.x()), static_cast<float>(pixel.y())}, false) >= 0;
}

// Largest angle off axis at which the lens still sees the picture, or the part of it that
// is said to be valid, and still spreads outwards.
Angle fieldOf(const ForeignLens& lens) {
  const auto centre = lens.project(Vector3d::UnitZ());
  if (!centre) return Angle();
  constexpr double kStep = 0.25;
  double seen = 0;
  double folds = 180;
  for (int i = 0; i < 72; ++i) {
    const double phi = 2 * std::numbers::pi * i / 72;
    double last = 0;
    for (double degrees = kStep; degrees < 179.9; degrees += kStep) {
      const double theta = Angle::degrees(degrees).radians();
      const auto pixel = lens.project(
          {std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi), std::cos(theta)});
      const double radius = pixel ? (*pixel - *centre).norm() : 0;
      if (!pixel || !(radius > last)) {
        folds = std::min(folds, degrees - 2 * kStep);
        break;
      }
      if (pixel->x() < 0 || pixel->y() < 0 || pixel->x() > lens.width || pixel->y() > lens.height ||
          (!lens.validRegion.empty() && !insideOf(lens.validRegion, *pixel))) {
        break;
      }
      seen = std::max(seen, degrees);
      last = radius;
    }
  }
  return Angle::degrees(std::min(seen, folds));
}

using Equation = std::function<std::optional<Vector2d>(const double*, const Vector3d&)>;

// Least squares over the field, in angle, for the parameters of `equation` that are not in `held`.
Result<void> fit(const Equation& equation, std::vector<double>& parameters,
                 const std::vector<int>& held, const ProjectDirection& truth, Angle field) {
  struct Sample {
    Vector3d direction;
    Vector2d pixel;
    Eigen::Matrix2d radiansPerPixel;
  };
  std::vector<Sample> samples;
  for (const Vector3d& v : capDirections(field * 0.9999, 1500)) {
    const Vector3d a = v.unitOrthogonal();
    const Vector3d b = v.cross(a);
    constexpr double kStep = 1e-5;
    const auto here = truth(v);
    const auto alongA = truth(v - kStep * a);
    const auto alongB = truth(v - kStep * b);
    if (!here || !alongA || !alongB) continue;
    Eigen::Matrix2d pixels;
    pixels << (*here - *alongA) / kStep, (*here - *alongB) / kStep;
    if (!(std::abs(pixels.determinant()) > 1e-6)) continue;
    samples.push_back({v, *here, pixels.inverse()});
  }
  if (samples.size() < 100) {
    return failure(ErrorCode::kInvalidArgument, "the lens sees too little to be fitted");
  }
  const auto residuals = [&](double const* const* values, double* out) {
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const auto pixel = equation(values[0], samples[i].direction);
      if (!pixel || !pixel->allFinite()) return false;
      const Vector2d error = samples[i].radiansPerPixel * (*pixel - samples[i].pixel);
      out[2 * i] = error.x();
      out[2 * i + 1] = error.y();
    }
    return true;
  };
  auto* cost = new ceres::DynamicNumericDiffCostFunction<decltype(residuals), ceres::CENTRAL>(
      &residuals, ceres::DO_NOT_TAKE_OWNERSHIP);
  cost->AddParameterBlock(static_cast<int>(parameters.size()));
  cost->SetNumResiduals(static_cast<int>(2 * samples.size()));
  ceres::Problem problem;
  problem.AddResidualBlock(cost, nullptr, parameters.data());
  if (!held.empty()) {
    problem.SetManifold(parameters.data(),
                        new ceres::SubsetManifold(static_cast<int>(parameters.size()), held));
  }
  ceres::Solver::Options options;
  options.max_num_iterations = 60;  // lenses that fit took 36 at most
  options.function_tolerance = 1e-14;
  options.parameter_tolerance = 1e-12;
  options.gradient_tolerance = 1e-16;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  if (!summary.IsSolutionUsable()) {
    return failure(ErrorCode::kInvalidArgument, "the lens could not be fitted");
  }
  return {};
}

std::optional<Vector2d> fisheyeEquation(const double* p, const Vector3d& v) {
  Vector2d pixel;
  projectFisheyeDirection(p, v.data(), pixel.data());
  return pixel;
}

// Parameters of our lens, `held` of them zero, nearest to a projection.
Result<FisheyeParameters> fitFisheye(const ProjectDirection& truth, int width, int height,
                                     Angle field, const std::vector<int>& held) {
  const auto centre = truth(Vector3d::UnitZ());
  const auto aside = truth(Vector3d(1e-3, 0, 1));
  const auto below = truth(Vector3d(0, 1e-3, 1));
  if (!centre || !aside || !below) {
    return failure(ErrorCode::kInvalidArgument, "the lens does not see its own axis");
  }
  FisheyeParameters f;
  f.width = width;
  f.height = height;
  f.fx = (*aside - *centre).norm() / 1e-3;
  f.fy = (*below - *centre).norm() / 1e-3;
  f.cx = centre->x();
  f.cy = centre->y();
  f.maxFieldAngle = field;
  const Eigen::VectorXd start = f.vector();
  std::vector<double> values(start.begin(), start.end());
  RETURN_IF_ERROR(fit(fisheyeEquation, values, held, truth, field));
  f.setVector(Eigen::Map<const Eigen::VectorXd>(values.data(), FisheyeLayout::kCount));
  return f;
}

// Angle between what our model and a projection make of the same pixel.
Angle largestDifference(const CameraModel& model, const ProjectDirection& other, Angle field) {
  Angle largest;
  for (const Vector3d& v : capDirections(field * 0.9999, 4000)) {
    const auto pixel = other(v);
    if (!pixel) continue;
    const auto seen = model.unproject(*pixel);
    if (seen) {
      largest = std::max(largest, angleBetween(*seen, v));
      continue;
    }
    // Just outside the model's field: by the pixels that an angle takes there.
    const auto own = model.project(v);
    if (!own) continue;
    const Vector2d error = model.pixelsPerRadian(v).fullPivLu().solve(*pixel - *own);
    largest = std::max(largest, Angle::radians(error.norm()));
  }
  return largest;
}

std::string describeLoss(const CameraConversion& conversion) {
  std::string text = conversion.refit ? fmt::format("refit, off by at most {:.2g} degrees",
                                                    conversion.largestError.degrees())
                                      : std::string("exact");
  if (conversion.lostField.degrees() > 0.01) {
    text += fmt::format(", {:.1f} degrees of the field lost", conversion.lostField.degrees());
  }
  return text;
}

// The field per sector of azimuth that a polygon in the picture leaves; empty for no polygon.
std::vector<Angle> coveredBy(const std::vector<Vector2d>& polygon, const CameraModel& model) {
  if (polygon.size() < 3) return {};
  constexpr int kSectors = 72;
  std::vector<Angle> covered;
  for (int i = 0; i < kSectors; ++i) {
    const double phi = 2 * std::numbers::pi * (i + 0.5) / kSectors;
    double inside = 0;
    for (double degrees = 0.5; degrees <= model.maxFieldAngle().degrees(); degrees += 0.25) {
      const double theta = Angle::degrees(degrees).radians();
      const auto pixel = model.project(
          {std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi), std::cos(theta)});
      if (!pixel) break;
      if (!insideOf(polygon, *pixel)) break;
      inside = degrees;
    }
    covered.push_back(Angle::degrees(inside));
  }
  return covered;
}

Result<LoadedCamera> toOurs(const ForeignLens& lens, const std::string& where) {
  if (lens.width <= 0 || lens.height <= 0 || lens.width > 100'000 || lens.height > 100'000) {
    return failure(ErrorCode::kCorrupt, "{}: the picture's size is missing or wrong", where);
  }
  const Angle seen = fieldOf(lens);
  // Outside the valid region a spline may do anything: nothing is fitted there.
  const ProjectDirection truth = [&](const Vector3d& v) {
    auto pixel = lens.project(v);
    if (pixel && !lens.field && !lens.validRegion.empty() && !insideOf(lens.validRegion, *pixel)) {
      pixel.reset();
    }
    return pixel;
  };
  const Angle wanted = lens.field ? std::min(*lens.field, Angle::degrees(180)) : seen;
  if (!(seen.degrees() > 1 && wanted.degrees() > 1)) {
    return failure(ErrorCode::kCorrupt, "{}: {}: the lens sees nothing of its picture", where,
                   lens.kind);
  }
  CameraConversion conversion;
  conversion.refit = !lens.same;
  std::shared_ptr<const FisheyeModel> model;
  const auto attempt = [&](Angle field) -> Result<bool> {
    FisheyeParameters tried;
    if (lens.same) {
      tried = *lens.same;
      tried.maxFieldAngle = field;
    } else {
      auto fitted = fitFisheye(truth, lens.width, lens.height, field,
                               {FisheyeLayout::kPupil, FisheyeLayout::kPupil + 1});
      if (!fitted) {
        return failure(ErrorCode::kUnsupported, "{}: {}: {}", where, lens.kind,
                       fitted.error().message);
      }
      tried = *fitted;
    }
    auto made = FisheyeModel::create(tried);
    if (made) model = *made;
    return made.has_value();
  };
  // A polynomial may turn back at the rim: then less of the field is kept, as much as half a degree
  // allows. Every attempt is a fit, so the loss is doubled until one succeeds, then halved.
  constexpr double kFinest = 0.5;
  const double most = std::min(30.0, wanted.degrees() - 1);
  double lost = 0;
  double tooLittle = 0;
  while (true) {
    ASSIGN_OR_RETURN(const bool made, attempt(wanted - Angle::degrees(lost)));
    if (made || lost >= most) break;
    tooLittle = lost;
    lost = std::min(std::max(2 * lost, kFinest), most);
  }
  if (!model) {
    return failure(ErrorCode::kUnsupported, "{}: {}: no fisheye of ours comes near this lens",
                   where, lens.kind);
  }
  while (lost - tooLittle > kFinest) {
    const double between = (lost + tooLittle) / 2;
    ASSIGN_OR_RETURN(const bool made, attempt(wanted - Angle::degrees(between)));
    (made ? lost : tooLittle) = between;
  }
  LensUncertainty uncertainty;
  uncertainty.coveredField = coveredBy(lens.validRegion, *model);
  if (!uncertainty.coveredField.empty()) {
    ASSIGN_OR_RETURN(model, FisheyeModel::create(model->values(), uncertainty));
  }
  conversion.lostField = wanted - model->maxFieldAngle();
  if (conversion.refit) {
    conversion.largestError = largestDifference(*model, truth, model->maxFieldAngle());
  }
  conversion.text =
      fmt::format("{}: {}, as {}: {}; valid to {:.1f} degrees off axis{}", where, lens.kind,
                  model->modelName(), describeLoss(conversion), model->maxFieldAngle().degrees(),
                  lens.remark.empty() ? std::string() : "; " + lens.remark);
  return LoadedCamera{model, conversion};
}

// --- Writing -------------------------------------------------------------------------------------

std::string text17(double value) { return fmt::format("{:.17g}", value); }

std::string openCvText(const FisheyeParameters& f, const std::string& note) {
  const auto matrix = [](int rows, int columns, std::initializer_list<double> values) {
    std::string text = fmt::format(
        " !!opencv-matrix\n   rows: {}\n   cols: {}\n   dt: d\n   data: [ ", rows, columns);
    const char* separator = "";
    for (const double value : values) {
      // OpenCV's reader wants a point or an exponent in a real number.
      std::string number = text17(value);
      if (number.find_first_of(".e") == std::string::npos) number += ".";
      text += separator + number;
      separator = ", ";
    }
    return text + " ]\n";
  };
  return fmt::format(
      "%YAML:1.0\n---\n# {}\n# Pixel centres at whole numbers, as OpenCV has them.\n"
      "image_width: {}\nimage_height: {}\nfisheye_model: 1\ndistortion_model: \"equidistant\"\n"
      "camera_matrix:{}distortion_coefficients:{}{}: {}\n",
      note, f.width, f.height, matrix(3, 3, {f.fx, 0, f.cx - 0.5, 0, f.fy, f.cy - 0.5, 0, 0, 1}),
      matrix(4, 1, {f.k[0], f.k[1], f.k[2], f.k[3]}), kFieldKey, text17(f.maxFieldAngle.degrees()));
}

std::string kalibrText(std::string_view camera, std::string_view distortion,
                       const std::vector<double>& intrinsics,
                       const std::vector<double>& coefficients, const CameraModel& model,
                       Angle field, const std::string& note) {
  const auto list = [](const std::vector<double>& values) {
    std::string text = "[";
    for (const double value : values) text += (text.size() > 1 ? ", " : "") + text17(value);
    return text + "]";
  };
  return fmt::format(
      "# {}\ncam0:\n  cam_overlaps: []\n  camera_model: {}\n  distortion_coeffs: {}\n"
      "  distortion_model: {}\n  intrinsics: {}\n  resolution: [{}, {}]\n"
      "  rostopic: /cam0/image_raw\n  {}: {}\n",
      note, camera, list(coefficients), distortion, list(intrinsics), model.width(), model.height(),
      kFieldKey, text17(field.degrees()));
}

}  // namespace

Result<CameraFormat> cameraFormatFromName(std::string_view name) {
  std::string known;
  for (const auto& [format, its] : kNames) {
    if (name == its) return format;
    known += (known.empty() ? "" : ", ") + std::string(its);
  }
  return failure(ErrorCode::kInvalidArgument, "unknown camera format '{}'; known: {}", name, known);
}

std::string_view cameraFormatName(CameraFormat format) {
  for (const auto& [known, name] : kNames) {
    if (known == format) return name;
  }
  throw std::logic_error("a camera format without a name");
}

Result<LoadedCamera> loadAnyCameraModel(const std::filesystem::path& path) {
  ASSIGN_OR_RETURN(const std::string text, readFile(path, std::uint64_t{1} << 26));
  const std::string where = path.string();
  const auto first = text.find_first_not_of(" \t\r\n");
  if (first != std::string::npos && text[first] == '{' &&
      text.find("LENSMODEL_") == std::string::npos) {
    ASSIGN_OR_RETURN(auto model, loadCameraModel(path));
    CameraConversion conversion;
    conversion.text = fmt::format("{}: lightsketch {}: exact", where, model->modelName());
    return LoadedCamera{std::move(model), conversion};
  }
  ASSIGN_OR_RETURN(const ForeignLens lens, parseForeignLens(text, where));
  return toOurs(lens, where);
}

Result<CameraConversion> exportCameraModel(const CameraModel& model, CameraFormat format,
                                           const std::filesystem::path& path) {
  CameraConversion conversion;
  const auto finish = [&](std::string_view kept) -> CameraConversion {
    conversion.text =
        fmt::format("{}: {}: {}{}", path.string(), kept, describeLoss(conversion),
                    format == CameraFormat::kLightsketch ? "" : "; the uncertainty stays behind");
    return conversion;
  };
  if (format == CameraFormat::kLightsketch) {
    RETURN_IF_ERROR(saveCameraModel(model, path));
    return finish("lightsketch " + model.modelName());
  }
  const auto* fisheye = dynamic_cast<const FisheyeModel*>(&model);
  const bool pupil = fisheye != nullptr && fisheye->values().pupilMetres != std::array<double, 2>{};
  const ProjectDirection truth = [&](const Vector3d& v) { return model.project(v); };
  const std::string note = "written by lightsketch " LIGHTSKETCH_VERSION;
  const Angle whole = model.maxFieldAngle();

  if (format == CameraFormat::kMrcal) {
    ASSIGN_OR_RETURN(const SplinedLens lens,
                     fitSpline(truth, model.width(), model.height(), whole, 30));
    conversion.refit = true;
    conversion.largestError = largestDifference(
        model, [&](const Vector3d& v) { return std::optional(lens.project(v)); }, whole);
    RETURN_IF_ERROR(writeFileAtomically(
        path, cameraModelText(lens, fisheye ? coveredPolygon(*fisheye) : std::vector<Vector2d>{},
                              fmt::format("{}; {} {:.17g}", note, kFieldKey, whole.degrees()))));
    return finish(pupil ? "mrcal spline without the moving pupil" : "mrcal spline");
  }
  if (format == CameraFormat::kKalibrDoubleSphere) {
    // From an equidistant start; xi and alpha of a typical fisheye.
    ASSIGN_OR_RETURN(const auto start,
                     fitFisheye(truth, model.width(), model.height(), Angle::degrees(20),
                                {4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17}));
    std::vector<double> values{start.fx * 0.8, start.fy * 0.8, start.cx - 0.5,
                               start.cy - 0.5, -0.2,           0.6};
    RETURN_IF_ERROR(fit(doubleSphere, values, {}, truth, whole));
    conversion.refit = true;
    conversion.largestError = largestDifference(
        model, [&](const Vector3d& v) { return doubleSphere(values.data(), v); }, whole);
    RETURN_IF_ERROR(writeFileAtomically(
        path,
        kalibrText("ds", "none", {values[4], values[5], values[0], values[1], values[2], values[3]},
                   {}, model, whole, note)));
    return finish("Kalibr ds-none");
  }
  // Kannala-Brandt without tangential terms. OpenCV and Kalibr divide by z before they apply it, so
  // that they see nothing from 90 degrees on.
  FisheyeParameters f;
  const Angle kept = std::min(whole, kRightAngle);
  const bool exact = fisheye != nullptr && fisheye->modelName() == "kannala-brandt" && !pupil &&
                     fisheye->values().p == std::array<double, 2>{};
  if (exact) {
    f = fisheye->values();
  } else {
    // k0 to k3 and the core are free.
    ASSIGN_OR_RETURN(f, fitFisheye(truth, model.width(), model.height(), kept,
                                   {8, 9, 10, 11, 12, 13, 14, 15, 16, 17}));
    conversion.refit = true;
    conversion.largestError = largestDifference(model, fisheyeProjection(f), kept);
  }
  conversion.lostField = whole - kept;
  if (format == CameraFormat::kOpenCv) {
    RETURN_IF_ERROR(writeFileAtomically(path, openCvText(f, note)));
    return finish("OpenCV fisheye");
  }
  RETURN_IF_ERROR(writeFileAtomically(
      path, kalibrText("pinhole", "equidistant", {f.fx, f.fy, f.cx - 0.5, f.cy - 0.5},
                       {f.k[0], f.k[1], f.k[2], f.k[3]}, model, f.maxFieldAngle, note)));
  return finish("Kalibr pinhole-equi");
}

}  // namespace lightsketch
