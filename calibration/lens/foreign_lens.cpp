#include "calibration/lens/foreign_lens.h"

#include <expat.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <map>
#include <memory>
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>
#include <span>
#include <string_view>

#include "calibration/model/fisheye_projection.h"

namespace lightsketch {

using Eigen::Vector2d;
using Eigen::Vector3d;

ProjectDirection fisheyeProjection(const FisheyeParameters& parameters) {
  return [vector = parameters.vector()](const Vector3d& v) -> std::optional<Vector2d> {
    Vector2d pixel;
    projectFisheyeDirection(vector.data(), v.data(), pixel.data());
    return pixel;
  };
}

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

namespace {

// --- Lens equations of others, on their own parameters; pixels are ours --------------------------

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
      leaves[current].append(1, ' ').append(depth > 0 ? content : content.substr(2));
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
    if (c == '[' || c == ']' || c == ',') c = ' ';
  }
  std::vector<double> values;
  const char* at = text.c_str();
  for (;;) {
    // The dash of a list of lists is no sign.
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

// As flatYaml, of OpenCV's XML: its root left out. Not by cv::FileStorage, which crashes on files
// that are no XML.
Result<std::map<std::string, std::string>> flatXml(const std::string& text,
                                                   const std::string& where) {
  struct Reading {
    std::map<std::string, std::string> leaves;
    std::vector<std::string> path;  // dotted, from below the root to where it reads
  } reading;
  const std::unique_ptr<XML_ParserStruct, decltype(&XML_ParserFree)> parser(
      XML_ParserCreate(nullptr), &XML_ParserFree);
  XML_SetUserData(parser.get(), &reading);
  XML_SetElementHandler(
      parser.get(),
      [](void* data, const XML_Char* name, const XML_Char**) {
        auto& path = static_cast<Reading*>(data)->path;
        const bool within = !path.empty() && path.size() < 5;  // nothing known is deeper
        path.push_back(!within ? "" : path.back().empty() ? name : path.back() + "." + name);
      },
      [](void* data, const XML_Char*) { static_cast<Reading*>(data)->path.pop_back(); });
  XML_SetCharacterDataHandler(parser.get(), [](void* data, const XML_Char* characters, int count) {
    auto& into = *static_cast<Reading*>(data);
    into.leaves[into.path.back()].append(characters, static_cast<std::size_t>(count));
  });
  if (XML_Parse(parser.get(), text.data(), static_cast<int>(text.size()), 1) != XML_STATUS_OK) {
    return failure(ErrorCode::kCorrupt, "{}: line {}: {}", where,
                   XML_GetCurrentLineNumber(parser.get()),
                   XML_ErrorString(XML_GetErrorCode(parser.get())));
  }
  return std::move(reading.leaves);
}

}  // namespace

Result<ForeignLens> parseForeignLens(const std::string& text, const std::string& where) {
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
    return lens;
  }
  if (text.starts_with("<?xml")) {
    ASSIGN_OR_RETURN(auto leaves, flatXml(text, where));
    return openCvLens(Keys(std::move(leaves), where));
  }
  auto leaves = flatYaml(text);
  if (leaves.contains("cam0.camera_model") || leaves.contains("intrinsics")) {
    return kalibrLens(leaves, where);
  }
  if (text.starts_with("%YAML") || leaves.contains("camera_matrix.data") || leaves.contains("K")) {
    return openCvLens(Keys(std::move(leaves), where));
  }
  return failure(ErrorCode::kUnsupported,
                 "{}: no camera file that is known; give lightsketch JSON, OpenCV or ROS YAML, a "
                 "Kalibr camchain or an mrcal .cameramodel",
                 where);
}

}  // namespace lightsketch
