#include "calibration/lens/camera_formats.h"

#include <ceres/ceres.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <memory>
#include <numbers>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <span>

#include "calibration/lens/mrcal_spline.h"
#include "calibration/model/fisheye_projection.h"
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
// Readers of the other formats skip this key; ours needs it to give back the field it was given.
constexpr const char* kFieldKey = "lightsketch_max_field_angle_degrees";

constexpr Angle kRightAngle = Angle::degrees(90);

Angle angleBetween(const Vector3d& a, const Vector3d& b) {
  return Angle::radians(std::atan2(a.cross(b).norm(), a.dot(b)));
}

// --- Lens equations of others, on their own parameters; pixels are ours --------------------------

// A lens read from a file: a projection, and the parameters if it is one that we hold as it is.
struct ForeignLens {
  std::string kind;  // for the user: "OpenCV fisheye"
  int width = 0;
  int height = 0;
  ProjectDirection project;
  std::optional<FisheyeParameters> same;
  std::optional<Angle> field;
  std::vector<Vector2d> validRegion;
  std::string remark;
};

// Kalibr's and OpenCV's intrinsics: fx, fy, cx, cy and the skew of cv::omnidir.
struct Intrinsics {
  double fx = 0, fy = 0, cx = 0, cy = 0, skew = 0;
  Vector2d pixel(const Vector2d& n) const {
    return {fx * n.x() + skew * n.y() + cx + 0.5, fy * n.y() + cy + 0.5};
  }
};

FisheyeParameters kannalaBrandt(const Intrinsics& c, std::span<const double> k, int width,
                                int height) {
  FisheyeParameters f;
  f.width = width;
  f.height = height;
  f.fx = c.fx;
  f.fy = c.fy;
  f.cx = c.cx + 0.5;
  f.cy = c.cy + 0.5;
  std::copy(k.begin(), k.end(), f.k.begin());
  return f;
}

ProjectDirection fisheyeProjection(const FisheyeParameters& parameters) {
  return [vector = parameters.vector()](const Vector3d& v) -> std::optional<Vector2d> {
    Vector2d pixel;
    projectFisheyeDirection(vector.data(), v.data(), pixel.data());
    return pixel;
  };
}

// OpenCV's pinhole with radial, tangential, rational, thin-prism and tilt terms: OpenCV evaluates
// it itself.
ProjectDirection pinholeProjection(const Intrinsics& c, std::vector<double> distortion) {
  return [c, distortion = std::move(distortion)](const Vector3d& v) -> std::optional<Vector2d> {
    if (!(v.z() > 1e-6 * v.norm())) return std::nullopt;
    const std::vector<cv::Point3d> points{{v.x() / v.z(), v.y() / v.z(), 1}};
    std::vector<cv::Point2d> pixels;
    const cv::Matx33d k(c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1);
    cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), k, distortion, pixels);
    return Vector2d(pixels[0].x + 0.5, pixels[0].y + 0.5);
  };
}

// Mei and Rives 2007, as cv::omnidir and Kalibr's omni-radtan have it.
ProjectDirection omniProjection(const Intrinsics& c, double xi, const std::array<double, 4>& d) {
  return [c, xi, d](const Vector3d& v) -> std::optional<Vector2d> {
    const double denominator = v.z() + xi * v.norm();
    if (!(denominator > 1e-9 * v.norm())) return std::nullopt;
    // Beyond this angle the sphere's far side comes back.
    if (xi > 1 && v.z() < -v.norm() / xi) return std::nullopt;
    const Vector2d n = v.head<2>() / denominator;
    const double r2 = n.squaredNorm();
    const double radial = 1 + r2 * (d[0] + r2 * d[1]);
    return c.pixel({n.x() * radial + 2 * d[2] * n.x() * n.y() + d[3] * (r2 + 2 * n.x() * n.x()),
                    n.y() * radial + d[2] * (r2 + 2 * n.y() * n.y()) + 2 * d[3] * n.x() * n.y()});
  };
}

// Usenko, Demmel, Cremers 2018, eq. 40 to 45; parameters fx, fy, cx, cy (theirs), xi, alpha.
std::optional<Vector2d> doubleSphere(const double* p, const Vector3d& v) {
  const double xi = p[4];
  const double alpha = p[5];
  const double d1 = v.norm();
  const double w1 = alpha > 0.5 ? (1 - alpha) / alpha : alpha / (1 - alpha);
  const double w2 = (w1 + xi) / std::sqrt(std::max(1e-12, 2 * w1 * xi + xi * xi + 1));
  if (!(v.z() > -w2 * d1)) return std::nullopt;
  const double shifted = xi * d1 + v.z();
  const double d2 = std::sqrt(v.head<2>().squaredNorm() + shifted * shifted);
  const double denominator = alpha * d2 + (1 - alpha) * shifted;
  return Vector2d(p[0] * v.x() / denominator + p[2] + 0.5, p[1] * v.y() / denominator + p[3] + 0.5);
}

// Khomutenko, Garcia, Martinet 2016, eq. 4.
ProjectDirection extendedUnified(const Intrinsics& c, double alpha, double beta) {
  return [c, alpha, beta](const Vector3d& v) -> std::optional<Vector2d> {
    const double d = std::sqrt(beta * v.head<2>().squaredNorm() + v.z() * v.z());
    const double denominator = alpha * d + (1 - alpha) * v.z();
    const double w = alpha > 0.5 ? (1 - alpha) / alpha : alpha / (1 - alpha);
    if (!(denominator > 1e-9 * v.norm()) || !(v.z() > -w * d)) return std::nullopt;
    return c.pixel(v.head<2>() / denominator);
  };
}

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
  options.max_num_iterations = 200;
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
  FisheyeParameters parameters;
  CameraConversion conversion;
  conversion.refit = !lens.same;
  std::shared_ptr<const FisheyeModel> model;
  // A polynomial may turn back at the rim: then less of the field is kept.
  for (Angle field = wanted; !model; field = field - Angle::degrees(0.5)) {
    if (field.degrees() < 1 || (wanted - field).degrees() > 30) {
      return failure(ErrorCode::kUnsupported, "{}: {}: no fisheye of ours comes near this lens",
                     where, lens.kind);
    }
    if (lens.same) {
      parameters = *lens.same;
      parameters.maxFieldAngle = field;
    } else {
      auto fitted = fitFisheye(truth, lens.width, lens.height, field,
                               {FisheyeLayout::kPupil, FisheyeLayout::kPupil + 1});
      if (!fitted) {
        return failure(ErrorCode::kUnsupported, "{}: {}: {}", where, lens.kind,
                       fitted.error().message);
      }
      parameters = *fitted;
    }
    if (auto made = FisheyeModel::create(parameters)) model = *made;
  }
  LensUncertainty uncertainty;
  uncertainty.coveredField = coveredBy(lens.validRegion, *model);
  if (!uncertainty.coveredField.empty()) {
    ASSIGN_OR_RETURN(model, FisheyeModel::create(parameters, uncertainty));
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

// --- Reading -------------------------------------------------------------------------------------

// YAML as calibrators write it: maps by indentation, flow and block lists of numbers, scalars.
// Every leaf under its path of keys ("cam0.intrinsics"), text as it stands, lists without brackets.
std::map<std::string, std::string> flatYaml(const std::string& text) {
  std::map<std::string, std::string> leaves;
  std::vector<std::pair<std::size_t, std::string>> path;  // indentation, key
  std::size_t depth = 0;                                  // of open brackets
  std::string current;
  std::size_t start = 0;
  while (start < text.size()) {
    const std::size_t end = std::min(text.find('\n', start), text.size());
    std::string line = text.substr(start, end - start);
    start = end + 1;
    if (const auto comment = line.find('#'); comment != std::string::npos) line.resize(comment);
    while (!line.empty() && std::isspace(static_cast<unsigned char>(line.back()))) line.pop_back();
    const std::size_t indent = line.find_first_not_of(' ');
    if (indent == std::string::npos || line[indent] == '%' || line == "---") continue;
    std::string content = line.substr(indent);
    const auto count = [&content](char c) {
      return static_cast<std::size_t>(std::count(content.begin(), content.end(), c));
    };
    if (depth > 0 || content.starts_with("- ")) {
      // A list goes on, or an item of a block list.
      leaves[current] += " " + (depth > 0 ? content : content.substr(2));
    } else {
      const auto colon = content.find(':');
      if (colon == std::string::npos) continue;
      while (!path.empty() && path.back().first >= indent) path.pop_back();
      path.emplace_back(indent, content.substr(0, colon));
      current.clear();
      for (const auto& [ignored, key] : path) current += (current.empty() ? "" : ".") + key;
      const auto value = content.find_first_not_of(' ', colon + 1);
      leaves[current] = value == std::string::npos ? "" : content.substr(value);
    }
    depth += count('[');
    depth -= std::min(depth, count(']'));
  }
  return leaves;
}

std::optional<std::vector<double>> numbersIn(std::string text) {
  for (char& c : text) {
    if (c == '[' || c == ']' || c == ',' || c == '-') {
      // A minus sign stays, the dash of a list of lists goes.
      if (c != '-') c = ' ';
    }
  }
  std::vector<double> values;
  const char* at = text.c_str();
  for (;;) {
    while (std::isspace(static_cast<unsigned char>(*at)) || (*at == '-' && at[1] == ' ')) ++at;
    if (*at == '\0') return values;
    char* end = nullptr;
    const double value = std::strtod(at, &end);
    if (end == at || !std::isfinite(value)) return std::nullopt;
    values.push_back(value);
    at = end;
  }
}

class Keys {
 public:
  Keys(std::map<std::string, std::string> leaves, std::string where)
      : leaves_(std::move(leaves)), where_(std::move(where)) {}

  const std::string& where() const { return where_; }
  // The first of several spellings that is there.
  std::optional<std::string> find(std::initializer_list<const char*> names) const {
    for (const char* name : names) {
      const auto found = leaves_.find(name);
      if (found != leaves_.end()) return found->second;
    }
    return std::nullopt;
  }
  std::optional<double> number(std::initializer_list<const char*> names) const {
    const auto text = find(names);
    const auto values = text ? numbersIn(*text) : std::nullopt;
    if (!values || values->size() != 1) return std::nullopt;
    return values->front();
  }
  Result<std::vector<double>> list(std::initializer_list<const char*> names) const {
    const auto text = find(names);
    if (!text) {
      return failure(ErrorCode::kCorrupt, "{}: no field {}", where_, *names.begin());
    }
    auto values = numbersIn(*text);
    if (!values) {
      return failure(ErrorCode::kCorrupt, "{}: {} is not a list of numbers: '{}'", where_,
                     *names.begin(), text->substr(0, 60));
    }
    return *values;
  }

 private:
  std::map<std::string, std::string> leaves_;
  std::string where_;
};

std::string unquoted(std::string text) {
  std::erase_if(text, [](char c) { return c == '"' || c == '\'' || c == ' '; });
  return text;
}

// Image size under any of the names in use.
Result<std::pair<int, int>> pictureSize(const Keys& keys) {
  const auto inRange = [](double v) { return v >= 1 && v <= 100'000; };
  auto width = keys.number({"image_width", "width", "imageWidth"});
  auto height = keys.number({"image_height", "height", "imageHeight"});
  if (!width || !height) {
    for (const char* name : {"image_size", "imageSize", "size", "resolution"}) {
      const auto both = keys.list({name});
      if (both && both->size() == 2) {
        width = (*both)[0];
        height = (*both)[1];
      }
    }
  }
  if (!width || !height || !inRange(*width) || !inRange(*height)) {
    return failure(ErrorCode::kCorrupt,
                   "{}: no picture size; add image_width and image_height (pixels)", keys.where());
  }
  return std::pair(static_cast<int>(*width), static_cast<int>(*height));
}

Result<ForeignLens> openCvLens(const Keys& keys) {
  ASSIGN_OR_RETURN(const auto size, pictureSize(keys));
  ASSIGN_OR_RETURN(const auto k, keys.list({"camera_matrix.data", "K.data", "cameraMatrix.data",
                                            "Camera_Matrix.data", "camera_matrix", "K"}));
  if (k.size() != 9 || !(k[0] > 0) || !(k[4] > 0)) {
    return failure(ErrorCode::kCorrupt, "{}: camera_matrix is not 3 x 3 with focal lengths",
                   keys.where());
  }
  std::vector<double> d;
  if (keys.find({"distortion_coefficients.data", "D.data", "dist_coeffs.data", "distCoeffs.data",
                 "Distortion_Coefficients.data", "distortion_coefficients", "D"})) {
    ASSIGN_OR_RETURN(d, keys.list({"distortion_coefficients.data", "D.data", "dist_coeffs.data",
                                   "distCoeffs.data", "Distortion_Coefficients.data",
                                   "distortion_coefficients", "D"}));
  }
  ForeignLens lens;
  lens.width = size.first;
  lens.height = size.second;
  if (const auto field = keys.number({kFieldKey})) lens.field = Angle::degrees(*field);
  Intrinsics c{k[0], k[4], k[2], k[5], k[1]};
  const std::string model =
      unquoted(keys.find({"distortion_model", "camera_model", "model"}).value_or(""));
  const auto flag = keys.number({"fisheye_model"});
  std::optional<double> xi = keys.number({"xi"});
  if (!xi && keys.find({"xi.data"})) {
    ASSIGN_OR_RETURN(const auto values, keys.list({"xi.data"}));
    if (values.size() == 1) xi = values.front();
  }
  if (xi) {
    if (d.size() != 4) {
      return failure(ErrorCode::kCorrupt, "{}: cv::omnidir has 4 distortion coefficients, not {}",
                     keys.where(), d.size());
    }
    lens.kind = "OpenCV omnidir";
    lens.project = omniProjection(c, *xi, {d[0], d[1], d[2], d[3]});
    return lens;
  }
  // Four coefficients are fisheye ones unless the file names a pinhole: cv::calibrateCamera writes
  // five or more.
  const bool namedPinhole = model == "plumb_bob" || model == "radtan" ||
                            model == "rational_polynomial" || (flag && *flag == 0);
  const bool namedFisheye = model == "equidistant" || model == "fisheye" ||
                            model == "kannala_brandt" || (flag && *flag != 0);
  if (d.size() == 4 && !namedPinhole) {
    lens.kind = namedFisheye ? "OpenCV fisheye"
                             : "OpenCV with 4 coefficients, taken as fisheye (distortion_model: "
                               "plumb_bob would say pinhole)";
    if (c.skew == 0) {
      lens.same = kannalaBrandt(c, d, lens.width, lens.height);
      lens.project = fisheyeProjection(*lens.same);
    } else {
      lens.project = [c, d](const Vector3d& v) -> std::optional<Vector2d> {
        const double theta = std::atan2(v.head<2>().norm(), v.z());
        const double t2 = theta * theta;
        const double r = theta * (1 + t2 * (d[0] + t2 * (d[1] + t2 * (d[2] + t2 * d[3]))));
        if (v.head<2>().norm() == 0) return c.pixel({0, 0});
        return c.pixel(r * v.head<2>().normalized());
      };
    }
    return lens;
  }
  if (d.empty()) d.assign(5, 0.0);
  if (namedFisheye ||
      (d.size() != 4 && d.size() != 5 && d.size() != 8 && d.size() != 12 && d.size() != 14)) {
    return failure(ErrorCode::kCorrupt,
                   "{}: {} distortion coefficients; OpenCV has 4, 5, 8, 12 or 14", keys.where(),
                   d.size());
  }
  lens.kind = fmt::format("OpenCV pinhole with {} coefficients", d.size());
  lens.project = pinholeProjection(c, d);
  return lens;
}

Result<ForeignLens> kalibrLens(const std::map<std::string, std::string>& leaves,
                               const std::string& where) {
  // The keys of cam0, or those of a file of one camera without that level.
  std::map<std::string, std::string> own;
  const bool named = leaves.contains("cam0.camera_model");
  for (const auto& [key, value] : leaves) {
    if (!named) own[key] = value;
    if (named && key.starts_with("cam0.")) own[key.substr(5)] = value;
  }
  const Keys keys(own, named ? where + ": cam0" : where);
  const std::string camera = unquoted(keys.find({"camera_model"}).value_or(""));
  const std::string distortion = unquoted(keys.find({"distortion_model"}).value_or("none"));
  ASSIGN_OR_RETURN(const auto size, pictureSize(keys));
  ASSIGN_OR_RETURN(const auto i, keys.list({"intrinsics"}));
  std::vector<double> d;
  if (keys.find({"distortion_coeffs"})) {
    ASSIGN_OR_RETURN(d, keys.list({"distortion_coeffs"}));
  }
  ForeignLens lens;
  lens.kind = fmt::format("Kalibr {}-{}", camera, distortion);
  lens.width = size.first;
  lens.height = size.second;
  if (leaves.contains("cam1.camera_model")) lens.remark = "the first camera of several";
  if (const auto field = keys.number({kFieldKey})) lens.field = Angle::degrees(*field);
  const std::size_t before = camera == "pinhole" ? 0 : camera == "omni" ? 1 : 2;
  const std::size_t coefficients = distortion == "none" ? 0 : 4;
  if (i.size() != before + 4 || (coefficients != 0 && d.size() != coefficients)) {
    return failure(ErrorCode::kCorrupt, "{}: {} with {} intrinsics and {} distortion coefficients",
                   keys.where(), lens.kind, i.size(), d.size());
  }
  const Intrinsics c{i[before], i[before + 1], i[before + 2], i[before + 3], 0};
  if (!(c.fx > 0 && c.fy > 0)) {
    return failure(ErrorCode::kCorrupt, "{}: focal lengths must be positive", keys.where());
  }
  d.resize(4, 0.0);
  const bool radtan = distortion == "radtan" || distortion == "none";
  if (camera == "pinhole" && (distortion == "equidistant" || distortion == "equi")) {
    lens.same = kannalaBrandt(c, d, lens.width, lens.height);
    lens.project = fisheyeProjection(*lens.same);
  } else if (camera == "pinhole" && radtan) {
    lens.project = pinholeProjection(c, d);
  } else if (camera == "omni" && radtan) {
    lens.project = omniProjection(c, i[0], {d[0], d[1], d[2], d[3]});
  } else if (camera == "ds" && distortion == "none") {
    lens.project = [p = std::array{c.fx, c.fy, c.cx, c.cy, i[0], i[1]}](const Vector3d& v) {
      return doubleSphere(p.data(), v);
    };
  } else if (camera == "eucm" && distortion == "none") {
    lens.project = extendedUnified(c, i[0], i[1]);
  } else {
    return failure(ErrorCode::kUnsupported,
                   "{}: {} is not read; known: pinhole-equidistant, pinhole-radtan, omni-radtan, "
                   "ds-none, eucm-none",
                   keys.where(), lens.kind);
  }
  return lens;
}

// OpenCV's own reader flattens what it knows: numbers, texts, matrices.
Result<std::map<std::string, std::string>> openCvLeaves(const std::string& text,
                                                        const std::string& where) {
  std::map<std::string, std::string> leaves;
  try {
    const cv::FileStorage file(text, cv::FileStorage::READ | cv::FileStorage::MEMORY);
    for (const cv::FileNode node : file.root()) {
      const std::string name = node.name();
      if (node.isInt() || node.isReal()) {
        leaves[name] = fmt::format("{}", static_cast<double>(node));
      } else if (node.isString()) {
        leaves[name] = static_cast<std::string>(node);
      } else if (node.isSeq()) {
        for (const cv::FileNode item : node) {
          if (item.isInt() || item.isReal()) {
            leaves[name] += fmt::format("{} ", static_cast<double>(item));
          }
        }
      } else if (node.isMap() && !node["data"].empty()) {
        cv::Mat matrix;
        node >> matrix;
        matrix.convertTo(matrix, CV_64F);
        for (int i = 0; i < static_cast<int>(matrix.total()); ++i) {
          leaves[name + ".data"] += fmt::format("{} ", matrix.at<double>(i));
        }
      }
    }
  } catch (const cv::Exception& error) {
    return failure(ErrorCode::kCorrupt, "{}: OpenCV cannot read it: {}", where, error.err);
  }
  return leaves;
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
  if (text.find("LENSMODEL_") != std::string::npos) {
    ASSIGN_OR_RETURN(const MrcalLens read, parseCameraModel(text, where));
    ForeignLens lens;
    lens.kind = "mrcal " + read.name.substr(0, read.name.find("_order"));
    lens.width = read.width;
    lens.height = read.height;
    lens.project = read.project;
    lens.validRegion = read.validRegion;
    if (const auto at = text.find(kFieldKey); at != std::string::npos) {
      const double field =
          std::strtod(text.c_str() + at + std::string_view(kFieldKey).size() + 1, nullptr);
      if (field > 1) lens.field = Angle::degrees(field);
    }
    return toOurs(lens, where);
  }
  if (text.starts_with("%YAML") || text.starts_with("<?xml")) {
    ASSIGN_OR_RETURN(auto leaves, openCvLeaves(text, where));
    ASSIGN_OR_RETURN(const auto lens, openCvLens(Keys(std::move(leaves), where)));
    return toOurs(lens, where);
  }
  const auto first = text.find_first_not_of(" \t\r\n");
  if (first != std::string::npos && text[first] == '{') {
    ASSIGN_OR_RETURN(auto model, loadCameraModel(path));
    CameraConversion conversion;
    conversion.text = fmt::format("{}: lightsketch {}: exact", where, model->modelName());
    return LoadedCamera{std::move(model), conversion};
  }
  auto leaves = flatYaml(text);
  if (leaves.contains("cam0.camera_model") || leaves.contains("intrinsics")) {
    ASSIGN_OR_RETURN(const auto lens, kalibrLens(leaves, where));
    return toOurs(lens, where);
  }
  if (leaves.contains("camera_matrix.data") || leaves.contains("K")) {
    ASSIGN_OR_RETURN(const auto lens, openCvLens(Keys(std::move(leaves), where)));
    return toOurs(lens, where);
  }
  return failure(ErrorCode::kUnsupported,
                 "{}: no camera file that is known; give lightsketch JSON, OpenCV or ROS YAML, a "
                 "Kalibr camchain or an mrcal .cameramodel",
                 where);
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
