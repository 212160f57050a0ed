// The objects on the table: read from a scene file, built as meshes, ready for ray casting.
#pragma once

#include <Eigen/Geometry>
#include <filesystem>
#include <memory>
#include <optional>
#include <vector>

#include "capture/frame/angle.h"
#include "capture/frame/result.h"

struct RTCSceneTy;

namespace lightsketch {

// What a ray found, with the material evaluated there.
struct SurfacePoint {
  float distance = 0;
  int object = -1;
  Eigen::Vector3f position;
  Eigen::Vector3f normal;           // shading normal, on the side of the viewer
  Eigen::Vector3f geometricNormal;  // of the triangle, on the side of the viewer
  Eigen::Vector3f albedo;           // diffuse reflectance
  Eigen::Vector3f specular;         // reflectance at normal incidence
  float roughness = 1;              // GGX alpha is its square
  float translucency = 0;           // 0 opaque; how much light seeps through
  float thickness = 0;              // metres that light seeps through
  bool mirror = false;              // of chrome: no lobe, lights in it are drawn one by one
};

struct ChromeBall {
  Eigen::Vector3d centre;  // scene frame
  double radius = 0;       // metres
};

// A matte white square on a foot, facing up, in the scene camera's view.
struct MattePatch {
  Eigen::Vector3d centre;  // of its face, scene frame
  double side = 0;         // metres
};
inline constexpr float kReferencePatchAlbedo = 0.9f;

// What stands on the table.
struct Arrangement {
  bool objects = true;  // those of the scene file
  std::optional<ChromeBall> ball;
  std::optional<MattePatch> patch;
};

// Immutable, so thread-safe.
class StillLife {
 public:
  // An empty path: the still life that is built in. Fails with file and field.
  static Result<std::shared_ptr<const StillLife>> load(const std::filesystem::path& path);
  // The same table and camera, with other things on it.
  Result<std::shared_ptr<const StillLife>> arranged(const Arrangement& arrangement) const;
  ~StillLife();
  StillLife(const StillLife&) = delete;
  StillLife& operator=(const StillLife&) = delete;

  std::optional<SurfacePoint> hit(const Eigen::Vector3f& origin,
                                  const Eigen::Vector3f& direction) const;
  // The diffuse colour of what a ray meets, without texture: enough for light that bounces.
  struct Glance {
    Eigen::Vector3f albedo;
    Eigen::Vector3f normal;
  };
  std::optional<Glance> glance(const Eigen::Vector3f& origin,
                               const Eigen::Vector3f& direction) const;
  bool occluded(const Eigen::Vector3f& from, const Eigen::Vector3f& to) const;
  RTCSceneTy* embreeScene() const;

  const Eigen::Isometry3d& sceneFromCamera() const;
  Angle horizontalField() const;
  double tableHeight() const;  // z of the table top, metres
  // Half the side of the square table top, centred on the origin.
  double tableHalfSize() const;

 private:
  struct State;
  explicit StillLife(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace lightsketch
