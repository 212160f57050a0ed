#include "calibration/lens/mrcal_spline.h"

#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <cmath>
#include <memory>
#include <numbers>

extern "C" {  // the header of 2.2 has no guard of its own
#include <mrcal/mrcal.h>
}

namespace lightsketch {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

mrcal_lensmodel_t lensModel(const SplinedLens& lens) {
  mrcal_lensmodel_t model{};
  mrcal_lensmodel_from_name(&model, lens.name().c_str());
  return model;
}

std::optional<Vector2d> projectBy(const mrcal_lensmodel_t& model, const double* values,
                                  const Vector3d& direction) {
  mrcal_point3_t p{};
  for (int i = 0; i < 3; ++i) p.xyz[i] = direction[i];
  mrcal_point2_t q{};
  if (!mrcal_project(&q, nullptr, nullptr, &p, 1, &model, values)) return std::nullopt;
  const Vector2d pixel(q.x + 0.5, q.y + 0.5);
  if (!pixel.allFinite()) return std::nullopt;
  return pixel;
}

// mrcal ends the program where it reads a spline of another order, and believes any size.
bool isUsable(const std::string& name) {
  mrcal_lensmodel_t model{};
  if (!mrcal_lensmodel_from_name(&model, name.c_str())) return false;
  if (model.type != MRCAL_LENSMODEL_SPLINED_STEREOGRAPHIC) return true;
  const auto& spline = model.LENSMODEL_SPLINED_STEREOGRAPHIC__config;
  return (spline.order == 2 || spline.order == 3) && spline.Nx > spline.order && spline.Nx <= 400 &&
         spline.Ny > spline.order && spline.Ny <= 400 && spline.fov_x_deg > 0 &&
         spline.fov_x_deg < 360;
}

}  // namespace

std::string SplinedLens::name() const {
  return fmt::format("LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx={0}_Ny={0}_fov_x_deg={1}", knots,
                     fieldDegrees);
}

Vector2d SplinedLens::project(const Vector3d& direction) const {
  return projectBy(lensModel(*this), values.data(), direction).value_or(Vector2d::Constant(NAN));
}

std::optional<Vector3d> SplinedLens::unproject(const Vector2d& pixel) const {
  const mrcal_lensmodel_t model = lensModel(*this);
  const mrcal_point2_t q{{pixel.x() - 0.5, pixel.y() - 0.5}};
  mrcal_point3_t v{};
  if (!mrcal_unproject(&v, &q, 1, &model, values.data())) return std::nullopt;
  const Vector3d direction = Vector3d(v.x, v.y, v.z).normalized();
  if (!direction.allFinite()) return std::nullopt;
  return direction;
}

std::vector<Vector3d> capDirections(Angle field, int count) {
  std::vector<Vector3d> directions{Vector3d::UnitZ()};
  const double limit = field.radians();
  const auto add = [&](double theta, double phi) {
    directions.emplace_back(std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi),
                            std::cos(theta));
  };
  for (int i = 0; i < count; ++i) {
    const double z = 1 - (1 - std::cos(limit)) * (i + 0.5) / count;
    add(std::acos(z), i * std::numbers::pi * (3 - std::sqrt(5.0)));
  }
  constexpr int kRim = 72;
  for (int i = 0; i < kRim; ++i) add(limit * (1 - 1e-9), 2 * std::numbers::pi * i / kRim);
  return directions;
}

Result<SplinedLens> fitSpline(const ProjectDirection& project, int width, int height, Angle field,
                              int knots) {
  SplinedLens lens;
  lens.width = width;
  lens.height = height;
  lens.knots = knots;
  // A little more than the field, so that its rim lies inside the knots. 2 tan(fov / 4) must stay
  // finite.
  lens.fieldDegrees = std::min(static_cast<int>(std::ceil(2 * field.degrees())) + 10, 340);
  const mrcal_lensmodel_t model = lensModel(lens);
  if (!mrcal_lensmodel_type_is_valid(model.type)) {
    return failure(ErrorCode::kInvalidArgument, "mrcal has no lens {}", lens.name());
  }
  const int count = mrcal_lensmodel_num_params(&model);
  lens.values.assign(static_cast<std::size_t>(count), 0.0);
  const auto centre = project(Vector3d::UnitZ());
  const auto aside = project(Vector3d(0.01, 0, 1));
  const auto below = project(Vector3d(0, 0.01, 1));
  if (!centre || !aside || !below) {
    return failure(ErrorCode::kInvalidArgument, "a lens that does not see its own axis");
  }
  // 0.9: a stereographic lens spreads the rim further than most fisheyes; this halves the knots'
  // work.
  lens.values[0] = 0.9 * (*aside - *centre).norm() / 0.01;
  lens.values[1] = 0.9 * (*below - *centre).norm() / 0.01;
  lens.values[2] = centre->x() - 0.5;
  lens.values[3] = centre->y() - 0.5;

  // Least squares for the knots. Those that no direction reaches are drawn to zero.
  const auto directions = capDirections(field, 12 * knots * knots);
  std::vector<Eigen::Triplet<double>> terms;
  std::vector<double> wanted;
  std::vector<double> gradient(2 * static_cast<std::size_t>(count));
  for (const Vector3d& direction : directions) {
    const auto pixel = project(direction);
    if (!pixel) continue;
    mrcal_point3_t p{};
    for (int i = 0; i < 3; ++i) p.xyz[i] = direction[i];
    mrcal_point2_t q{};
    mrcal_point3_t byPoint[2];
    mrcal_project(&q, byPoint, gradient.data(), &p, 1, &model, lens.values.data());
    for (int axis = 0; axis < 2; ++axis) {
      const int row = static_cast<int>(wanted.size());
      wanted.push_back((*pixel)[axis] - 0.5 - q.xy[axis]);
      for (int k = 4; k < count; ++k) {
        const double value = gradient[static_cast<std::size_t>(axis * count + k)];
        if (value != 0) terms.emplace_back(row, k - 4, value);
      }
    }
  }
  Eigen::SparseMatrix<double> jacobian(static_cast<Eigen::Index>(wanted.size()), count - 4);
  jacobian.setFromTriplets(terms.begin(), terms.end());
  const Eigen::VectorXd right =
      jacobian.transpose() *
      Eigen::Map<const Eigen::VectorXd>(wanted.data(), static_cast<Eigen::Index>(wanted.size()));
  Eigen::SparseMatrix<double> normal = jacobian.transpose() * jacobian;
  for (int k = 0; k < count - 4; ++k)
    normal.coeffRef(k, k) += 1e-11 * lens.values[0] * lens.values[0];
  const Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> solver(normal);
  const Eigen::VectorXd knotsFound = solver.solve(right);
  if (solver.info() != Eigen::Success || !knotsFound.allFinite()) {
    return failure(ErrorCode::kInvalidArgument, "mrcal's spline could not be fitted to the lens");
  }
  for (int k = 4; k < count; ++k) lens.values[static_cast<std::size_t>(k)] = knotsFound[k - 4];
  return lens;
}

std::string cameraModelText(const SplinedLens& lens, const std::vector<Vector2d>& validRegion,
                            const std::string& note) {
  std::string text =
      fmt::format("# {}\n{{\n    'lensmodel':  '{}',\n\n    'intrinsics': [ ", note, lens.name());
  // Shortest digits that read back as the same double; mrcal's own writer keeps six decimals.
  for (const double value : lens.values) text += fmt::format("{},", value);
  text += "],\n\n";
  if (!validRegion.empty()) {
    text += "    'valid_intrinsics_region': [\n";
    const auto vertex = [&](const Vector2d& p) {
      text += fmt::format("        [ {:.3f}, {:.3f} ],\n", p.x() - 0.5, p.y() - 0.5);
    };
    for (const Vector2d& p : validRegion) vertex(p);
    vertex(validRegion.front());
    text += "    ],\n\n";
  }
  text += fmt::format(
      "    'extrinsics': [ 0., 0., 0., 0., 0., 0., ],\n\n    'imagersize': [ {}, {} ],\n}}\n",
      lens.width, lens.height);
  return text;
}

std::vector<Vector2d> coveredPolygon(const FisheyeModel& model) {
  const auto& covered = model.uncertainty().coveredField;
  std::vector<Vector2d> polygon;
  for (std::size_t i = 0; i < covered.size(); ++i) {
    const double phi =
        2 * std::numbers::pi * (static_cast<double>(i) + 0.5) / static_cast<double>(covered.size());
    const double theta = std::min(covered[i], model.maxFieldAngle()).radians();
    const auto pixel = model.project(
        {std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi), std::cos(theta)});
    if (pixel) polygon.push_back(*pixel);
  }
  return polygon.size() == covered.size() ? polygon : std::vector<Vector2d>{};
}

Result<MrcalLens> parseCameraModel(const std::string& text, const std::string& where) {
  // mrcal prints what it does not know; ask first.
  for (std::size_t begin = text.find("LENSMODEL_"); begin != text.npos;
       begin = text.find("LENSMODEL_", begin + 1)) {
    const std::string said = text.substr(begin, text.find_first_of("'\"", begin) - begin);
    if (!isUsable(said)) {
      return failure(ErrorCode::kUnsupported, "{}: mrcal knows no lens '{}'", where,
                     said.substr(0, 80));
    }
  }
  // Its reader runs past the end of a text that stops inside quotes; these close any.
  const std::string closed = text + "\n#'\"\n";
  const std::shared_ptr<mrcal_cameramodel_t> read(
      mrcal_read_cameramodel_string(closed.data(), static_cast<int>(closed.size())),
      [](mrcal_cameramodel_t* model) {
        if (model != nullptr) mrcal_free_cameramodel(&model);
      });
  if (!read) {
    return failure(ErrorCode::kCorrupt,
                   "{}: mrcal cannot read it as a .cameramodel file; write it again with mrcal",
                   where);
  }
  char name[256];
  if (!mrcal_lensmodel_name(name, sizeof name, &read->lensmodel)) {
    return failure(ErrorCode::kUnsupported, "{}: unknown mrcal lens", where);
  }
  MrcalLens lens;
  lens.name = name;
  lens.width = static_cast<int>(read->imagersize[0]);
  lens.height = static_cast<int>(read->imagersize[1]);
  const bool behind = mrcal_lensmodel_metadata(&read->lensmodel).can_project_behind_camera;
  lens.project = [read, behind](const Vector3d& direction) -> std::optional<Vector2d> {
    if (!behind && !(direction.z() > 0)) return std::nullopt;
    return projectBy(read->lensmodel, read->intrinsics, direction);
  };
  // mrcal's C reader skips the region: numbers between its brackets.
  if (const auto key = text.find("valid_intrinsics_region"); key != std::string::npos) {
    std::vector<double> numbers;
    int depth = 0;
    for (std::size_t i = text.find('[', key); i < text.size(); ++i) {
      if (text[i] == '[') ++depth;
      if (text[i] == ']' && --depth == 0) break;
      if (std::isdigit(static_cast<unsigned char>(text[i])) || text[i] == '-' || text[i] == '.') {
        char* end = nullptr;
        numbers.push_back(std::strtod(text.c_str() + i, &end));
        if (end == text.c_str() + i)
          return failure(ErrorCode::kCorrupt, "{}: valid_intrinsics_region is not a list of points",
                         where);
        i = static_cast<std::size_t>(end - text.c_str()) - 1;
      }
    }
    for (std::size_t i = 0; i + 1 < numbers.size(); i += 2) {
      lens.validRegion.emplace_back(numbers[i] + 0.5, numbers[i + 1] + 0.5);
    }
  }
  return lens;
}

}  // namespace lightsketch
