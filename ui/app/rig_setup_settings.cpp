#include "ui/app/rig_setup_settings.h"

#include <cmath>

#include "capture/frame/pixel_format.h"

namespace lightsketch {
namespace {

QString textOf(const std::filesystem::path& path) { return QString::fromStdString(path.string()); }

void saveCamera(QSettings& settings, const QString& group, const CameraSettings& camera) {
  settings.remove(group);
  const auto set = [&](const char* name, const QVariant& value) {
    settings.setValue(group + "/" + name, value);
  };
  if (camera.format) {
    const auto name = pixelFormatInfo(*camera.format).name;
    set("format", QString::fromUtf8(name.data(), static_cast<qsizetype>(name.size())));
  }
  if (const auto& r = camera.region) set("region", QVariantList{r->x, r->y, r->width, r->height});
  if (camera.exposureSeconds) set("exposureSeconds", *camera.exposureSeconds);
  if (camera.gainDb) set("gainDb", *camera.gainDb);
  if (camera.framesPerSecond) set("framesPerSecond", *camera.framesPerSecond);
}

CameraSettings loadCamera(const QSettings& settings, const QString& group,
                          const CameraSettings& usual) {
  CameraSettings camera = usual;
  const auto number = [&](const char* name, std::optional<double>& into) {
    bool ok = false;
    const double value = settings.value(group + "/" + name).toDouble(&ok);
    if (ok && std::isfinite(value)) into = value;
  };
  const std::string format = settings.value(group + "/format").toString().toStdString();
  if (const auto known = pixelFormatFromName(format)) camera.format = known;
  if (const auto r = settings.value(group + "/region").toList(); r.size() == 4) {
    camera.region = Region{r[0].toInt(), r[1].toInt(), r[2].toInt(), r[3].toInt()};
  }
  number("exposureSeconds", camera.exposureSeconds);
  number("gainDb", camera.gainDb);
  number("framesPerSecond", camera.framesPerSecond);
  return camera;
}

}  // namespace

void saveRigSetup(QSettings& settings, const RigSetup& setup) {
  settings.setValue("rig/simulated", setup.simulated);
  settings.setValue("rig/sceneCamera", QString::fromStdString(setup.sceneCamera));
  settings.setValue("rig/sourceCamera", QString::fromStdString(setup.sourceCamera));
  settings.setValue("rig/sourceModel", textOf(setup.sourceModel));
  settings.setValue("rig/rigGeometry", textOf(setup.rigGeometry));
  settings.setValue("rig/sceneResponse", textOf(setup.sceneResponse));
  settings.setValue("rig/sceneModel", textOf(setup.sceneModel));
  saveCamera(settings, "rig/scene", setup.scene);
  saveCamera(settings, "rig/source", setup.source);
}

RigSetup loadRigSetup(const QSettings& settings) {
  RigSetup setup;
  const auto text = [&](const char* name) { return settings.value(name).toString().toStdString(); };
  setup.simulated = settings.value("rig/simulated", setup.simulated).toBool();
  setup.sceneCamera = text("rig/sceneCamera");
  setup.sourceCamera = text("rig/sourceCamera");
  setup.sourceModel = text("rig/sourceModel");
  setup.rigGeometry = text("rig/rigGeometry");
  setup.sceneResponse = text("rig/sceneResponse");
  setup.sceneModel = text("rig/sceneModel");
  setup.scene = loadCamera(settings, "rig/scene", setup.scene);
  setup.source = loadCamera(settings, "rig/source", setup.source);
  return setup;
}

}  // namespace lightsketch
