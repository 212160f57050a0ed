#include "capture/rig/mesh.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

namespace lightsketch {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

constexpr float kPi = std::numbers::pi_v<float>;

// Two triangles for every cell of a grid of (columns + 1) x (rows + 1) vertices; counter-clockwise
// seen from the side that x cross y points to.
void addGridTriangles(Mesh& mesh, std::uint32_t first, int columns, int rows) {
  const auto stride = static_cast<std::uint32_t>(columns + 1);
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      const std::uint32_t a =
          first + static_cast<std::uint32_t>(row) * stride + static_cast<std::uint32_t>(column);
      mesh.triangles.push_back({a, a + 1, a + stride + 1});
      mesh.triangles.push_back({a, a + stride + 1, a + stride});
    }
  }
}

}  // namespace

void Mesh::append(const Mesh& other, const Vector3f& offset) {
  const auto first = static_cast<std::uint32_t>(positions.size());
  for (const auto& p : other.positions) positions.push_back(p + offset);
  normals.insert(normals.end(), other.normals.begin(), other.normals.end());
  for (const auto& t : other.triangles) {
    triangles.push_back({t[0] + first, t[1] + first, t[2] + first});
  }
}

Mesh makeEllipsoid(const Vector3f& radii) {
  constexpr int kColumns = 96, kRows = 48;
  Mesh mesh;
  for (int row = 0; row <= kRows; ++row) {
    const float polar = kPi * (static_cast<float>(row) / kRows - 0.5f);
    for (int column = 0; column <= kColumns; ++column) {
      const float azimuth = 2 * kPi * static_cast<float>(column) / kColumns;
      const Vector3f unit(std::cos(polar) * std::cos(azimuth), std::cos(polar) * std::sin(azimuth),
                          std::sin(polar));
      mesh.positions.push_back(unit.cwiseProduct(radii));
      mesh.normals.push_back(unit.cwiseQuotient(radii).normalized());
    }
  }
  addGridTriangles(mesh, 0, kColumns, kRows);
  return mesh;
}

Mesh makeTorus(float majorRadius, float minorRadius) {
  constexpr int kColumns = 128, kRows = 32;
  Mesh mesh;
  for (int row = 0; row <= kRows; ++row) {
    const float b = 2 * kPi * static_cast<float>(row) / kRows;
    for (int column = 0; column <= kColumns; ++column) {
      const float a = 2 * kPi * static_cast<float>(column) / kColumns;
      const Vector3f normal(std::cos(b) * std::cos(a), std::cos(b) * std::sin(a), std::sin(b));
      mesh.positions.push_back(majorRadius * Vector3f(std::cos(a), std::sin(a), 0) +
                               minorRadius * normal);
      mesh.normals.push_back(normal);
    }
  }
  addGridTriangles(mesh, 0, kColumns, kRows);
  return mesh;
}

Mesh makeBox(const Vector3f& size, float bevel) {
  const Vector3f half = size / 2;
  const float r = std::min(bevel, 0.49f * size.minCoeff());
  constexpr int kBevelSteps = 6;
  Mesh mesh;
  for (int axis = 0; axis < 3; ++axis) {
    for (const float side : {-1.0f, 1.0f}) {
      const int u = (axis + (side > 0 ? 1 : 2)) % 3;
      const int v = (axis + (side > 0 ? 2 : 1)) % 3;
      const auto stations = [&](int i) {
        std::vector<float> s;
        for (int k = 0; k <= kBevelSteps; ++k) {
          s.push_back(-half[i] + r * static_cast<float>(k) / kBevelSteps);
        }
        for (int k = 0; k <= kBevelSteps; ++k) {
          s.push_back(half[i] - r + r * static_cast<float>(k) / kBevelSteps);
        }
        return s;
      };
      const auto us = stations(u), vs = stations(v);
      const auto first = static_cast<std::uint32_t>(mesh.positions.size());
      for (const float b : vs) {
        for (const float a : us) {
          Vector3f p;
          p[axis] = side * half[axis];
          p[u] = a;
          p[v] = b;
          const Vector3f core =
              p.cwiseMax(-half + Vector3f::Constant(r)).cwiseMin(half - Vector3f::Constant(r));
          const Vector3f normal = (p - core).normalized();
          mesh.positions.push_back(core + r * normal);
          mesh.normals.push_back(normal);
        }
      }
      addGridTriangles(mesh, first, static_cast<int>(us.size()) - 1,
                       static_cast<int>(vs.size()) - 1);
    }
  }
  return mesh;
}

Mesh makeOpenBox(const Vector3f& size, float wall) {
  const float bevel = 0.2f * wall;
  Mesh mesh;
  mesh.append(makeBox({size.x(), size.y(), wall}, bevel), {0, 0, wall / 2});
  for (const float side : {-1.0f, 1.0f}) {
    mesh.append(makeBox({size.x(), wall, size.z()}, bevel),
                {0, side * (size.y() - wall) / 2, size.z() / 2});
    mesh.append(makeBox({wall, size.y() - 2 * wall, size.z()}, bevel),
                {side * (size.x() - wall) / 2, 0, size.z() / 2});
  }
  return mesh;
}

Mesh makeLathe(const std::vector<Vector2f>& profile) {
  constexpr int kColumns = 128, kStepsPerSpan = 12;
  const int spans = static_cast<int>(profile.size()) - 1;
  const auto control = [&](int i) {
    return profile[static_cast<std::size_t>(std::clamp(i, 0, spans))];
  };
  Mesh mesh;
  for (int row = 0; row <= spans * kStepsPerSpan; ++row) {
    const int span = std::min(row / kStepsPerSpan, spans - 1);
    const float t = static_cast<float>(row - span * kStepsPerSpan) / kStepsPerSpan;
    const Vector2f p0 = control(span - 1), p1 = control(span), p2 = control(span + 1),
                   p3 = control(span + 2);
    Vector2f point = 0.5f * (2 * p1 + t * (p2 - p0) + t * t * (2 * p0 - 5 * p1 + 4 * p2 - p3) +
                             t * t * t * (3 * p1 - p0 - 3 * p2 + p3));
    point.x() = std::max(point.x(), 0.0f);
    Vector2f tangent = 0.5f * ((p2 - p0) + 2 * t * (2 * p0 - 5 * p1 + 4 * p2 - p3) +
                               3 * t * t * (3 * p1 - p0 - 3 * p2 + p3));
    tangent.normalize();
    for (int column = 0; column <= kColumns; ++column) {
      const float a = 2 * kPi * static_cast<float>(column) / kColumns;
      mesh.positions.push_back({point.x() * std::cos(a), point.x() * std::sin(a), point.y()});
      mesh.normals.push_back(
          Vector3f(tangent.y() * std::cos(a), tangent.y() * std::sin(a), -tangent.x()));
    }
  }
  addGridTriangles(mesh, 0, kColumns, spans * kStepsPerSpan);
  return mesh;
}

Mesh makeHeightField(const Vector3f& size, int columns, int rows,
                     const std::function<float(float, float)>& height) {
  Mesh mesh;
  const float dx = size.x() / static_cast<float>(columns);
  const float dy = size.y() / static_cast<float>(rows);
  const auto z = [&](float x, float y) { return size.z() + height(x, y); };
  // One ring of vertices more, on the ground below the rim: the slab's sides.
  for (int row = -1; row <= rows + 1; ++row) {
    for (int column = -1; column <= columns + 1; ++column) {
      const float x = -size.x() / 2 + dx * static_cast<float>(std::clamp(column, 0, columns));
      const float y = -size.y() / 2 + dy * static_cast<float>(std::clamp(row, 0, rows));
      const bool ground = row < 0 || row > rows || column < 0 || column > columns;
      mesh.positions.push_back({x, y, ground ? 0.0f : z(x, y)});
      const float e = 0.5f * std::min(dx, dy);
      mesh.normals.push_back(
          Vector3f(z(x - e, y) - z(x + e, y), z(x, y - e) - z(x, y + e), 2 * e).normalized());
    }
  }
  addGridTriangles(mesh, 0, columns + 2, rows + 2);
  return mesh;
}

}  // namespace lightsketch
