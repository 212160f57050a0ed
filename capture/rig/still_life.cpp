#include "capture/rig/still_life.h"

#include <embree3/rtcore.h>

#include <Eigen/LU>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <string>

#include "capture/frame/json.h"
#include "capture/rig/built_in_scene.h"
#include "capture/rig/mesh.h"
#include "capture/rig/noise.h"

namespace lightsketch {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

constexpr std::string_view kFormat = "lightsketch-scene";
constexpr int kFormatVersion = 1;

enum class Texture { kPlain, kWood, kWeave, kMarble, kFruit, kGlaze };
const std::map<std::string, Texture, std::less<>> kTextures = {
    {"plain", Texture::kPlain},   {"wood", Texture::kWood},   {"weave", Texture::kWeave},
    {"marble", Texture::kMarble}, {"fruit", Texture::kFruit}, {"glaze", Texture::kGlaze}};

struct Material {
  Texture texture = Texture::kPlain;
  Vector3f first, second;  // the texture's two colours, linear
  float scale = 0.01f;     // metres per feature
  Vector3f specular = Vector3f::Constant(0.04f);
  float roughness = 0.5f;
  float bump = 0;  // slope of the bumps
  float bumpScale = 0.001f;
  float translucency = 0;
  float thickness = 0;
  bool mirror = false;
};

struct Object {
  Mesh mesh;  // in the scene frame
  Eigen::Isometry3f objectFromScene;
  Material material;
};

float smooth(float low, float high, float x) {
  const float t = std::clamp((x - low) / (high - low), 0.0f, 1.0f);
  return t * t * (3 - 2 * t);
}

// Diffuse colour of a material at a point of the object's own frame. Solid textures: no seams.
Vector3f colourAt(const Material& m, const Vector3f& p) {
  const Vector3f q = p / m.scale;
  float mix = 0;
  switch (m.texture) {
    case Texture::kPlain:
      mix = fractalNoise(q, 4);
      break;
    case Texture::kWood: {
      // Boards along x, each cut from another place of the tree; rings stretched along the grain.
      const float board = std::floor(p.y() / 0.045f);
      const float shade = uniformFromHash(static_cast<std::uint64_t>(board + 1000));
      const Vector3f grain(0.07f * q.x() + 37 * shade, q.y() + 11 * shade, q.z());
      const float ring = 5 * fractalNoise(0.35f * grain, 3) + 0.25f * q.y();
      const float fibre = fractalNoise({1.2f * q.x(), 14 * q.y(), 14 * q.z()}, 3);
      mix = 0.55f * (0.5f + 0.5f * std::sin(6.0f * ring)) + 0.30f * fibre + 0.25f * (shade - 0.5f);
      const float seam = std::abs(p.y() / 0.045f - board - 0.5f);
      if (seam > 0.488f) return 0.25f * m.first;
      break;
    }
    case Texture::kWeave: {
      // Threads over and under, and two coloured stripes near the hem.
      const float thread = 0.5f + 0.25f * (std::sin(2 * std::numbers::pi_v<float> * q.x()) +
                                           std::sin(2 * std::numbers::pi_v<float> * q.y()));
      const float stripe = std::abs(std::fmod(std::abs(p.y()) / 0.03f, 1.0f) - 0.5f);
      const Vector3f base = stripe < 0.07f || std::abs(stripe - 0.14f) < 0.02f ? m.second : m.first;
      return base * (0.82f + 0.18f * thread) * (0.93f + 0.14f * fractalNoise(0.25f * q, 3));
    }
    case Texture::kMarble:
      mix = std::pow(std::abs(std::sin(2 * q.x() + q.y() + 6 * fractalNoise(q, 5))), 0.35f);
      mix = 1 - mix;
      break;
    case Texture::kFruit: {
      // Blush from one side, streaks along the meridians, pale dots.
      const float azimuth = std::atan2(p.y(), p.x());
      const float streak =
          fractalNoise({5 * std::cos(azimuth), 5 * std::sin(azimuth), 0.4f * q.z()}, 4);
      mix = smooth(0.25f, 0.75f, 0.5f + 0.45f * p.x() / m.scale * 0.5f + 0.7f * (streak - 0.5f));
      if (fractalNoise(9 * q, 1) > 0.86f) mix *= 0.6f;
      break;
    }
    case Texture::kGlaze: {
      // Painted bands and petals around the axis.
      const float azimuth = std::atan2(p.y(), p.x()) + 0.03f * fractalNoise(3 * q, 2);
      const float band = q.z() - std::floor(q.z());
      const float petal = std::abs(
          std::sin(4 * azimuth +
                   (std::fmod(std::floor(q.z()), 2.0f) != 0 ? std::numbers::pi_v<float> / 2 : 0)));
      const float edge = 0.5f + 0.42f * petal;
      mix = band < 0.08f || band > 0.94f ? 1.0f : (std::abs(band - edge) < 0.055f ? 0.9f : 0.0f);
      if (band < edge - 0.12f && band > 0.2f && petal > 0.75f) mix = 0.55f;
      mix *= 0.75f + 0.35f * fractalNoise(6 * q, 3);
      break;
    }
  }
  return m.first + std::clamp(mix, 0.0f, 1.0f) * (m.second - m.first);
}

// The normal tilted by the slope of fractal bumps, all in the object's frame.
Vector3f bumpedNormal(const Material& m, const Vector3f& p, const Vector3f& normal) {
  if (m.bump == 0) return normal;
  const Vector3f q = p / m.bumpScale;
  constexpr float kStep = 0.05f;
  const float here = fractalNoise(q, 2);
  Vector3f gradient;
  for (int i = 0; i < 3; ++i) {
    gradient[i] = (fractalNoise(q + kStep * Vector3f::Unit(i), 2) - here) / kStep;
  }
  gradient -= gradient.dot(normal) * normal;
  return (normal - m.bump * gradient).normalized();
}

// Reliefs for height-field tiles; x and y in metres from the centre, over a tile `size`.
float rosette(float x, float y, const Vector3f& size, float depth) {
  const float r = std::hypot(x, y) / (0.5f * std::min(size.x(), size.y()));
  const float azimuth = std::atan2(y, x);
  const float petals = 0.62f + 0.2f * std::cos(8 * azimuth);
  float h =
      0.55f * smooth(0.04f, -0.04f, r - petals) * (1 - 0.55f * std::abs(std::sin(4 * azimuth)));
  h += 0.5f * smooth(0.26f, 0.10f, r);                          // boss
  h += 0.45f * std::exp(-std::pow((r - 0.9f) / 0.045f, 2.0f));  // ring
  const float border = std::min(size.x() / 2 - std::abs(x), size.y() / 2 - std::abs(y));
  h += 0.6f * smooth(0.0035f, 0.0025f, border);
  return depth * h;
}

float clothFolds(float x, float y, float depth) {
  const Vector3f p(28 * x, 28 * y, 2.5f);
  const float wave = std::sin(75 * (x + 0.35f * y) + 5 * fractalNoise(0.5f * p, 3));
  const float ridge = std::pow(0.5f + 0.5f * wave, 3.0f);
  return depth * (0.75f * ridge * fractalNoise(0.6f * p, 2) + 0.35f * fractalNoise(p, 3));
}

// --- Reading -----------------------------------------------------------------------------------

Result<Vector3f> vectorField(const Json& json, std::string_view field, std::string_view where) {
  ASSIGN_OR_RETURN(const auto v, jsonVector(json, field, 3, where));
  return Vector3f(v.cast<float>());
}

// A field that may be left out, between bounds.
Result<float> optionalNumber(const Json& json, std::string_view field, double fallback, double low,
                             double high, std::string_view where) {
  if (!json.contains(field)) return static_cast<float>(fallback);
  ASSIGN_OR_RETURN(const double value, jsonNumber(json, field, where));
  if (value < low || value > high) {
    return failure(ErrorCode::kCorrupt, "{}: field '{}' is outside {}..{}", where, field, low,
                   high);
  }
  return static_cast<float>(value);
}

Result<Vector3f> sizeField(const Json& json, std::string_view field, std::string_view where) {
  ASSIGN_OR_RETURN(const auto size, vectorField(json, field, where));
  if (size.minCoeff() <= 0 || size.maxCoeff() > 10) {
    return failure(ErrorCode::kCorrupt, "{}: field '{}' must be positive and at most 10 m", where,
                   field);
  }
  return size;
}

Result<Material> readMaterial(const Json& json, const std::string& where) {
  Material m;
  ASSIGN_OR_RETURN(const auto texture, jsonString(json, "texture", where));
  const auto known = kTextures.find(texture);
  if (known == kTextures.end()) {
    return failure(ErrorCode::kUnsupported,
                   "{}: unknown texture '{}'; known: plain, wood, weave, marble, fruit, glaze",
                   where, texture);
  }
  m.texture = known->second;
  ASSIGN_OR_RETURN(m.first, vectorField(json, "first", where));
  ASSIGN_OR_RETURN(m.second, vectorField(json, "second", where));
  ASSIGN_OR_RETURN(m.scale, optionalNumber(json, "scale", 0.01, 1e-5, 10, where));
  if (json.contains("specular")) {
    ASSIGN_OR_RETURN(m.specular, vectorField(json, "specular", where));
  }
  ASSIGN_OR_RETURN(m.roughness, optionalNumber(json, "roughness", 0.5, 0.03, 1, where));
  ASSIGN_OR_RETURN(m.bump, optionalNumber(json, "bump", 0, 0, 2, where));
  ASSIGN_OR_RETURN(m.bumpScale, optionalNumber(json, "bumpScale", 0.001, 1e-5, 1, where));
  ASSIGN_OR_RETURN(m.translucency, optionalNumber(json, "translucency", 0, 0, 1, where));
  ASSIGN_OR_RETURN(m.thickness, optionalNumber(json, "thickness", 0, 0, 0.2, where));
  return m;
}

Result<std::vector<Eigen::VectorXd>> rowsField(const Json& json, const char* field, int columns,
                                               std::size_t fewest, const std::string& where) {
  if (!json.contains(field) || !json[field].is_array() || json[field].size() < fewest ||
      json[field].size() > 1000) {
    return failure(ErrorCode::kCorrupt, "{}: field '{}' must list {} to 1000 entries", where, field,
                   fewest);
  }
  std::vector<Eigen::VectorXd> rows;
  for (const Json& row : json[field]) {
    ASSIGN_OR_RETURN(auto values, jsonVector(Json{{field, row}}, field, columns, where));
    rows.push_back(std::move(values));
  }
  return rows;
}

Result<Mesh> readShape(const Json& json, const std::string& where) {
  ASSIGN_OR_RETURN(const auto shape, jsonString(json, "shape", where));
  if (shape == "ellipsoid") {
    ASSIGN_OR_RETURN(const auto radii, sizeField(json, "radii", where));
    return makeEllipsoid(radii);
  }
  if (shape == "torus") {
    ASSIGN_OR_RETURN(const float major, optionalNumber(json, "majorRadius", 0.01, 1e-4, 1, where));
    ASSIGN_OR_RETURN(const float minor, optionalNumber(json, "minorRadius", 0.002, 1e-5, 1, where));
    return makeTorus(major, minor);
  }
  if (shape == "box") {
    ASSIGN_OR_RETURN(const auto size, sizeField(json, "size", where));
    ASSIGN_OR_RETURN(const float bevel, optionalNumber(json, "bevel", 0.0005, 1e-6, 1, where));
    return makeBox(size, bevel);
  }
  if (shape == "openBox") {
    ASSIGN_OR_RETURN(const auto size, sizeField(json, "size", where));
    ASSIGN_OR_RETURN(const float wall, optionalNumber(json, "wall", 0.002, 1e-5, 1, where));
    return makeOpenBox(size, wall);
  }
  if (shape == "lathe") {
    ASSIGN_OR_RETURN(const auto rows, rowsField(json, "profile", 2, 2, where));
    std::vector<Vector2f> profile;
    for (const auto& row : rows) profile.push_back(row.cast<float>());
    return makeLathe(profile);
  }
  if (shape == "spheres") {
    ASSIGN_OR_RETURN(const auto rows, rowsField(json, "spheres", 4, 1, where));
    Mesh mesh;
    for (const auto& row : rows) {
      if (row[3] <= 0)
        return failure(ErrorCode::kCorrupt, "{}: a sphere's radius is not positive", where);
      mesh.append(makeEllipsoid(Vector3f::Constant(static_cast<float>(row[3]))),
                  row.head<3>().cast<float>());
    }
    return mesh;
  }
  if (shape == "rosetteTile" || shape == "cloth") {
    ASSIGN_OR_RETURN(const auto size, sizeField(json, "size", where));
    ASSIGN_OR_RETURN(const float depth, optionalNumber(json, "depth", 0.002, 0, 1, where));
    if (shape == "cloth") {
      return makeHeightField(size, 160, 160,
                             [=](float x, float y) { return clothFolds(x, y, depth); });
    }
    return makeHeightField(size, 220, 180,
                           [=](float x, float y) { return rosette(x, y, size, depth); });
  }
  return failure(ErrorCode::kUnsupported,
                 "{}: unknown shape '{}'; known: ellipsoid, torus, box, openBox, lathe, spheres, "
                 "rosetteTile, cloth",
                 where, shape);
}

Result<Object> readObject(const Json& json, const std::map<std::string, Material>& materials,
                          const std::string& where) {
  Object object;
  ASSIGN_OR_RETURN(object.mesh, readShape(json, where));
  ASSIGN_OR_RETURN(const auto name, jsonString(json, "material", where));
  const auto material = materials.find(name);
  if (material == materials.end()) {
    return failure(ErrorCode::kCorrupt, "{}: no material is called '{}'", where, name);
  }
  object.material = material->second;
  ASSIGN_OR_RETURN(const auto position, vectorField(json, "position", where));
  Vector3f degrees = Vector3f::Zero();
  if (json.contains("rotationDegrees")) {
    ASSIGN_OR_RETURN(degrees, vectorField(json, "rotationDegrees", where));
  }
  const Vector3f radians = degrees * (std::numbers::pi_v<float> / 180);
  Eigen::Isometry3f sceneFromObject = Eigen::Isometry3f::Identity();
  sceneFromObject.linear() = (Eigen::AngleAxisf(radians.z(), Vector3f::UnitZ()) *
                              Eigen::AngleAxisf(radians.y(), Vector3f::UnitY()) *
                              Eigen::AngleAxisf(radians.x(), Vector3f::UnitX()))
                                 .toRotationMatrix();
  sceneFromObject.translation() = position;
  for (auto& p : object.mesh.positions) p = sceneFromObject * p;
  for (auto& n : object.mesh.normals) n = sceneFromObject.linear() * n;
  object.objectFromScene = sceneFromObject.inverse();
  return object;
}

}  // namespace

struct StillLife::State {
  ~State() {
    if (scene) rtcReleaseScene(scene);
    if (device) rtcReleaseDevice(device);
  }
  Result<void> read(const Json& json, const std::string& where);
  Result<void> build();

  std::vector<Object> objects;  // the index is Embree's geometry id
  Eigen::Isometry3d sceneFromCamera = Eigen::Isometry3d::Identity();
  Angle horizontalField;
  double tableHeight = 0;
  double tableHalfSize = 0;
  RTCDevice device = nullptr;
  RTCScene scene = nullptr;
};

Result<void> StillLife::State::read(const Json& json, const std::string& where) {
  RETURN_IF_ERROR(checkFormat(json, kFormat, kFormatVersion, where));

  // The scene camera looks at the origin's neighbourhood with "up" upwards in the picture.
  if (!json.contains("camera")) {
    return failure(ErrorCode::kCorrupt, "{}: field 'camera' is missing", where);
  }
  const Json& camera = json["camera"];
  ASSIGN_OR_RETURN(const auto position, jsonVector(camera, "position", 3, where));
  ASSIGN_OR_RETURN(const auto lookAt, jsonVector(camera, "lookAt", 3, where));
  ASSIGN_OR_RETURN(const auto up, jsonVector(camera, "up", 3, where));
  ASSIGN_OR_RETURN(const double field, jsonNumber(camera, "horizontalFieldDegrees", where));
  const Eigen::Vector3d forward = lookAt - position;
  const Eigen::Vector3d right = forward.cross(Eigen::Vector3d(up));
  if (right.norm() < 1e-9 || field <= 0 || field > 120) {
    return failure(ErrorCode::kCorrupt, "{}: field 'camera' does not describe a view", where);
  }
  sceneFromCamera.linear().col(0) = right.normalized();
  sceneFromCamera.linear().col(1) = forward.cross(right).normalized();
  sceneFromCamera.linear().col(2) = forward.normalized();
  sceneFromCamera.translation() = position;
  horizontalField = Angle::degrees(field);

  std::map<std::string, Material> materials;
  if (!json.contains("materials") || !json["materials"].is_object()) {
    return failure(ErrorCode::kCorrupt, "{}: field 'materials' is missing", where);
  }
  for (const auto& [name, value] : json["materials"].items()) {
    ASSIGN_OR_RETURN(materials[name], readMaterial(value, where + ": material '" + name + "'"));
  }

  // The table top is a slab like any other; its surface is also what the source camera looks along.
  if (!json.contains("table") || !json.contains("objects") || !json["objects"].is_array() ||
      json["objects"].empty() || json["objects"].size() > 1000) {
    return failure(ErrorCode::kCorrupt, "{}: needs 'table' and 1 to 1000 'objects'", where);
  }
  const std::string tableWhere = where + ": table";
  ASSIGN_OR_RETURN(tableHeight, jsonNumber(json["table"], "height", tableWhere));
  ASSIGN_OR_RETURN(const float half,
                   optionalNumber(json["table"], "halfSize", 0.5, 0.05, 2, tableWhere));
  tableHalfSize = half;
  Json table = json["table"];
  constexpr double kTableThickness = 0.03;
  table["shape"] = "box";
  table["size"] = {2 * tableHalfSize, 2 * tableHalfSize, kTableThickness};
  table["position"] = {0, 0, tableHeight - kTableThickness / 2};
  ASSIGN_OR_RETURN(auto tableObject, readObject(table, materials, tableWhere));
  objects.push_back(std::move(tableObject));
  int number = 0;
  for (const Json& value : json["objects"]) {
    ASSIGN_OR_RETURN(auto object,
                     readObject(value, materials, fmt::format("{}: object {}", where, ++number)));
    objects.push_back(std::move(object));
  }
  return {};
}

// An object of one colour that stands where its mesh is put.
Object plainObject(Mesh mesh, const Vector3f& position, const Vector3f& albedo) {
  Object object;
  object.mesh = std::move(mesh);
  for (auto& p : object.mesh.positions) p += position;
  object.objectFromScene = Eigen::Isometry3f::Identity();
  object.objectFromScene.translation() = -position;
  object.material.first = object.material.second = albedo;
  object.material.specular.setZero();
  object.material.roughness = 1;
  return object;
}

Result<void> StillLife::State::build() {
  device = rtcNewDevice(nullptr);
  if (!device) return failure(ErrorCode::kDevice, "simulated rig: Embree cannot start");
  scene = rtcNewScene(device);
  rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_HIGH);
  for (const auto& object : objects) {
    const RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    const Mesh& mesh = object.mesh;
    auto* vertices = static_cast<float*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                3 * sizeof(float), mesh.positions.size()));
    auto* indices = static_cast<std::uint32_t*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                3 * sizeof(std::uint32_t), mesh.triangles.size()));
    if (!vertices || !indices) return failure(ErrorCode::kDevice, "simulated rig: out of memory");
    for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
      for (int k = 0; k < 3; ++k)
        vertices[3 * i + static_cast<std::size_t>(k)] = mesh.positions[i][k];
    }
    for (std::size_t i = 0; i < mesh.triangles.size(); ++i) {
      for (std::size_t k = 0; k < 3; ++k) indices[3 * i + k] = mesh.triangles[i][k];
    }
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    rtcReleaseGeometry(geometry);
  }
  rtcCommitScene(scene);
  if (rtcGetDeviceError(device) != RTC_ERROR_NONE) {
    return failure(ErrorCode::kDevice, "simulated rig: Embree cannot build the scene");
  }
  return {};
}

namespace {

RTCRayHit castRay(RTCScene scene, const Vector3f& origin, const Vector3f& direction) {
  RTCRayHit ray{};
  ray.ray.org_x = origin.x();
  ray.ray.org_y = origin.y();
  ray.ray.org_z = origin.z();
  ray.ray.dir_x = direction.x();
  ray.ray.dir_y = direction.y();
  ray.ray.dir_z = direction.z();
  ray.ray.tnear = 0;
  ray.ray.tfar = std::numeric_limits<float>::infinity();
  ray.ray.mask = ~0u;
  ray.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcIntersect1(scene, &context, &ray);
  return ray;
}

}  // namespace

Result<std::shared_ptr<const StillLife>> StillLife::load(const std::filesystem::path& path) {
  const std::string where = path.empty() ? "built-in scene" : path.string();
  auto json = path.empty() ? parseJson(kBuiltInScene, where) : readJsonFile(path);
  if (!json) return tl::unexpected<Error>(std::move(json).error());
  auto state = std::make_unique<State>();
  RETURN_IF_ERROR(state->read(*json, where));
  RETURN_IF_ERROR(state->build());
  return std::shared_ptr<const StillLife>(new StillLife(std::move(state)));
}

Result<std::shared_ptr<const StillLife>> StillLife::arranged(const Arrangement& a) const {
  auto state = std::make_unique<State>();
  state->sceneFromCamera = state_->sceneFromCamera;
  state->horizontalField = state_->horizontalField;
  state->tableHeight = state_->tableHeight;
  state->tableHalfSize = state_->tableHalfSize;
  const auto& objects = state_->objects;  // the first is the table
  state->objects.assign(objects.begin(), a.objects ? objects.end() : objects.begin() + 1);
  if (a.ball) {
    Object ball = plainObject(makeEllipsoid(Vector3f::Constant(static_cast<float>(a.ball->radius))),
                              a.ball->centre.cast<float>(), Vector3f::Zero());
    // Chrome at normal incidence, linear sRGB.
    ball.material.specular = Vector3f(0.549f, 0.556f, 0.554f);
    ball.material.roughness = 0.03f;
    ball.material.mirror = true;
    state->objects.push_back(std::move(ball));
  }
  if (a.patch) {
    const double height = a.patch->centre.z() - tableHeight();
    const Vector3f size(static_cast<float>(a.patch->side), static_cast<float>(a.patch->side),
                        static_cast<float>(height));
    const Vector3f middle = (a.patch->centre - Eigen::Vector3d(0, 0, 0.5 * height)).cast<float>();
    state->objects.push_back(
        plainObject(makeBox(size, 0.0005f), middle, Vector3f::Constant(kReferencePatchAlbedo)));
  }
  RETURN_IF_ERROR(state->build());
  return std::shared_ptr<const StillLife>(new StillLife(std::move(state)));
}

StillLife::StillLife(std::unique_ptr<State> state) : state_(std::move(state)) {}
StillLife::~StillLife() = default;

std::optional<SurfacePoint> StillLife::hit(const Vector3f& origin,
                                           const Vector3f& direction) const {
  const RTCRayHit ray = castRay(state_->scene, origin, direction);
  if (ray.hit.geomID == RTC_INVALID_GEOMETRY_ID) return std::nullopt;
  const Object& object = state_->objects[ray.hit.geomID];
  const auto& corners = object.mesh.triangles[ray.hit.primID];

  SurfacePoint point;
  point.distance = ray.ray.tfar * direction.norm();
  point.object = static_cast<int>(ray.hit.geomID);
  point.position = origin + ray.ray.tfar * direction;
  point.geometricNormal = Vector3f(ray.hit.Ng_x, ray.hit.Ng_y, ray.hit.Ng_z).normalized();
  Vector3f normal = (1 - ray.hit.u - ray.hit.v) * object.mesh.normals[corners[0]] +
                    ray.hit.u * object.mesh.normals[corners[1]] +
                    ray.hit.v * object.mesh.normals[corners[2]];
  const Vector3f local = object.objectFromScene * point.position;
  normal =
      object.objectFromScene.linear().transpose() *
      bumpedNormal(object.material, local, (object.objectFromScene.linear() * normal).normalized());
  if (point.geometricNormal.dot(direction) > 0) point.geometricNormal *= -1;
  if (normal.dot(point.geometricNormal) < 0) normal *= -1;
  point.normal = normal;
  point.albedo = colourAt(object.material, local);
  point.specular = object.material.specular;
  point.roughness = object.material.roughness;
  point.translucency = object.material.translucency;
  point.thickness = object.material.thickness;
  point.mirror = object.material.mirror;
  return point;
}

std::optional<StillLife::Glance> StillLife::glance(const Vector3f& origin,
                                                   const Vector3f& direction) const {
  const RTCRayHit ray = castRay(state_->scene, origin, direction);
  if (ray.hit.geomID == RTC_INVALID_GEOMETRY_ID) return std::nullopt;
  const Material& material = state_->objects[ray.hit.geomID].material;
  Vector3f normal = Vector3f(ray.hit.Ng_x, ray.hit.Ng_y, ray.hit.Ng_z).normalized();
  if (normal.dot(direction) > 0) normal *= -1;
  return Glance{0.5f * (material.first + material.second), normal};
}

bool StillLife::occluded(const Vector3f& from, const Vector3f& to) const {
  RTCRay ray{};
  ray.org_x = from.x();
  ray.org_y = from.y();
  ray.org_z = from.z();
  const Vector3f d = to - from;
  ray.dir_x = d.x();
  ray.dir_y = d.y();
  ray.dir_z = d.z();
  ray.tfar = 1;
  ray.mask = ~0u;
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcOccluded1(state_->scene, &context, &ray);
  return ray.tfar < 0;
}

RTCScene StillLife::embreeScene() const { return state_->scene; }
const Eigen::Isometry3d& StillLife::sceneFromCamera() const { return state_->sceneFromCamera; }
Angle StillLife::horizontalField() const { return state_->horizontalField; }
double StillLife::tableHeight() const { return state_->tableHeight; }
double StillLife::tableHalfSize() const { return state_->tableHalfSize; }

}  // namespace lightsketch
