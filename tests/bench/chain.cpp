// The whole chain on the simulated rig, from nothing: a board waved before all cameras gives lenses
// and poses, a mirror ball gives the poses again, then the lamp is recorded; directions in the
// journal against the rig's truth.
#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <thread>
#include <vector>

#include "capture/device/camera.h"
#include "capture/rig/simulated_rig.h"
#include "pipeline/job/calibrate_jobs.h"
#include "pipeline/job/jobs.h"
#include "pipeline/sketch/sketch.h"

using namespace lightsketch;
namespace fs = std::filesystem;

namespace {

class PlainProgress final : public Progress {
 public:
  void update(std::string_view, std::size_t, std::size_t) override {}
  void warn(std::string_view message) override {
    fmt::print("  ({})\n", message);
    std::fflush(stdout);
  }
  bool cancelled() const override { return false; }
};

template <class T>
T orStop(Result<T> result, const char* what) {
  if (result) return std::move(*result);
  fmt::print(stderr, "chain: {}: {}\n", what, result.error().message);
  std::exit(1);
}

double degrees(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return Angle::radians(std::atan2(a.cross(b).norm(), a.dot(b))).degrees();
}

double percentile(std::vector<double> values, double part) {
  std::sort(values.begin(), values.end());
  return values.empty()
             ? NAN
             : values[static_cast<std::size_t>(part * static_cast<double>(values.size() - 1))];
}

void setProgram(const std::string& address, RigProgram program) {
  const auto camera = orStop(openCamera(address), "camera");
  const auto set = camera->setFeature("RigProgram", static_cast<double>(program));
  if (!set) {
    fmt::print(stderr, "chain: {}\n", set.error().message);
    std::exit(1);
  }
  // The rig prepares another scene, for which cameras pause, as they do while a scene is rebuilt.
  std::this_thread::sleep_for(std::chrono::seconds(12));
}

// The calibrated scene frame is the calibration's own choice: where it lies in the rig's.
Eigen::Isometry3d trueFromCalibrated(const SimulatedRig& rig, const RigGeometry& calibrated) {
  return rig.geometry().sceneCamera.sceneFromCamera *
         calibrated.sceneCamera.sceneFromCamera.inverse();
}

void printPoses(const SimulatedRig& rig, const RigGeometry& calibrated) {
  const Eigen::Isometry3d frame = trueFromCalibrated(rig, calibrated);
  for (std::size_t i = 0; i < calibrated.sourceCameras.size(); ++i) {
    const Eigen::Isometry3d pose = frame * calibrated.sourceCameras[i].sceneFromCamera;
    const Eigen::Isometry3d truth = rig.geometry().sourceCameras[i].sceneFromCamera;
    const double turned = Eigen::AngleAxisd(pose.linear() * truth.linear().transpose()).angle();
    fmt::print("  source camera {}: {:.2f} mm and {:.3f} degrees off\n", i + 1,
               1e3 * (pose.translation() - truth.translation()).norm(),
               Angle::radians(turned).degrees());
  }
}

void printLens(const SimulatedRig& rig, const CameraModel& model, std::size_t source) {
  // After the best rotation, by the angle off axis.
  std::vector<Eigen::Vector3d> truths, seen;
  Eigen::Matrix3d products = Eigen::Matrix3d::Zero();
  for (double theta = 1; theta < 92; theta += 2) {
    for (double phi = 0; phi < 360; phi += 10) {
      const double t = Angle::degrees(theta).radians(), p = Angle::degrees(phi).radians();
      const Eigen::Vector3d d(std::sin(t) * std::cos(p), std::sin(t) * std::sin(p), std::cos(t));
      const auto pixel = rig.truePixel(d, source);
      if (!pixel) continue;
      const auto back = model.unproject(*pixel);
      if (!back || !model.covers(*back)) continue;
      truths.push_back(d);
      seen.push_back(*back);
      products += std::sin(t) * d * back->transpose();
    }
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(products, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Matrix3d turn = svd.matrixU() * svd.matrixV().transpose();
  std::vector<double> errors, sigmas;
  for (std::size_t i = 0; i < truths.size(); ++i) {
    errors.push_back(degrees(truths[i], turn * seen[i]));
    sigmas.push_back(
        Angle::radians(std::sqrt(model.directionCovariance(seen[i]).trace())).degrees());
  }
  fmt::print(
      "  lens {}: error median {:.4f}, 95 % {:.4f}, largest {:.4f} degrees over the covered "
      "field; claimed {:.4f} median\n",
      source + 1, percentile(errors, 0.5), percentile(errors, 0.95), percentile(errors, 1),
      percentile(sigmas, 0.5));
}

struct Errors {
  std::vector<double> direction, sigmas, distance;
};

Errors errorsOf(const SimulatedRig& rig, const Sketch& sketch, TimePoint timeZero,
                const RigGeometry& calibrated) {
  const Eigen::Isometry3d toCalibrated = trueFromCalibrated(rig, calibrated).inverse();
  const double offset = toSeconds(timeZero - rig.startTime());
  Errors errors;
  for (const int id : sketch.activeFrames()) {
    const FrameRecord& frame = sketch.frames()[static_cast<std::size_t>(id)];
    const Eigen::Vector3d lamp =
        toCalibrated * rig.truthAt(offset + frame.midExposureSeconds).lampInScene;
    const double error = degrees(frame.light.direction, lamp);
    errors.direction.push_back(error);
    const double sigma = std::sqrt(frame.light.covariance.trace());
    errors.sigmas.push_back(Angle::degrees(error).radians() / std::max(sigma, 1e-9));
    if (frame.light.position) {
      errors.distance.push_back(std::abs(frame.light.position->norm() / lamp.norm() - 1));
    }
  }
  return errors;
}

void print(const char* what, const Errors& e) {
  fmt::print(
      "{:<44} {:4} frames  median {:.3f}  95 % {:.3f}  largest {:.3f} degrees; in its own "
      "sigmas {:.2f}; distance off {:.1f} % median\n",
      what, e.direction.size(), percentile(e.direction, 0.5), percentile(e.direction, 0.95),
      percentile(e.direction, 1), percentile(e.sigmas, 0.5), 100 * percentile(e.distance, 0.5));
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  const fs::path out = argc > 1 ? argv[1] : fs::temp_directory_path() / "lightsketch-chain";
  fs::remove_all(out);
  fs::create_directories(out);
  PlainProgress progress;
  SimulatedRigOptions options;
  options.secondSource = "127.0.0.13";
  options.minLampDistanceMetres = 0.6;
  options.maxLampDistanceMetres = 1.5;
  options.program = RigProgram::kBoard;
  const auto rig = orStop(SimulatedRig::start(options), "rig");
  const std::string scene = "aravis:" + options.sceneAddress;
  const std::vector<std::string> sources = {"aravis:" + options.sourceAddress,
                                            "aravis:" + options.secondSource};

  fmt::print("lenses and poses by a board, {:.0f} s\n", rig->boardPeriodSeconds());
  RigCalibrationJob calibrate;
  calibrate.sceneCamera = scene;
  calibrate.sourceCameras = sources;
  calibrate.views = 1000;
  calibrate.timeLimitSeconds = rig->boardPeriodSeconds() - 10;
  calibrate.ask = [&rig](const std::string&) {  // the rig's hand lays it flat when its time comes
    for (;;) {
      const auto board = rig->boardAt(toSeconds(Clock::now() - rig->startTime()));
      if (board && board->still && board->sceneFromBoard(2, 2) < -0.9999) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
  };
  calibrate.out = out / "calibration";
  const JobResult calibration = orStop(rigCalibrationJob(calibrate, progress, {}), "calibrate rig");
  fmt::print("{}\n", calibration.text);
  const RigGeometry byBoard = orStop(loadRigGeometry(out / "calibration/rig.json"), "rig.json");
  std::vector<fs::path> models;
  for (std::size_t i = 0; i < sources.size(); ++i) {
    models.push_back(out / fmt::format("calibration/source-{}.json", i + 1));
    printLens(*rig, *orStop(loadCameraModel(models.back()), "model"), i);
  }
  printPoses(*rig, byBoard);

  fmt::print("poses by a mirror ball\n");
  setProgram(scene, RigProgram::kMirrorBall);
  RecordJob record;
  record.sceneCamera = scene;
  record.sourceCameras = sources;
  record.cameraModels = models;
  record.rigGeometry = out / "calibration/rig.json";  // its poses are not used
  record.recorder.posesUnknown = true;
  record.recorder.sceneExposureSeconds = 0.005;  // the lamp's image is bright, its sheen less so
  record.recorder.timeLimitSeconds = 28;
  record.recorder.sceneBlackLevel = sceneBlackLevelCounts(record.recorder.sceneFormat);
  record.sketch = out / "ball";
  fmt::print("{}\n", orStop(recordJob(record, progress, {}), "record the ball").text);
  PoseJob pose;
  pose.sceneModel = out / "calibration/scene.json";
  pose.sourceModels = models;
  pose.sketch = out / "ball";
  pose.ballRadiiMetres = {options.ballRadiusMetres};
  // What a person would say: where the ball roughly is, and by a ruler, to a millimetre or two,
  // how far the lenses are from it.
  const auto ball = rig->mirrorBall();
  const RigGeometry truth = rig->geometry();
  const Eigen::Vector3d seen = truth.sceneCamera.sceneFromCamera.inverse() * ball.centre;
  const double f = rig->sceneFocalLengthPixels();
  pose.balls = {{320 + f * seen.x() / seen.z() + 4, 240 + f * seen.y() / seen.z() - 3,
                 1.04 * f * ball.radius / seen.z()}};
  for (const double wrong : {0.0015, -0.001}) {
    const auto& camera = truth.sourceCameras[pose.sourceDistancesMetres.size()];
    pose.sourceDistancesMetres.push_back(
        (camera.sceneFromCamera.translation() - ball.centre).norm() + wrong);
  }
  pose.sceneFrom = out / "calibration/rig.json";  // the flat board says where the scene is
  pose.out = out / "rig-by-ball.json";
  fmt::print("{}\n", orStop(poseJob(pose, progress), "calibrate pose").text);
  const RigGeometry byBall = orStop(loadRigGeometry(pose.out), "rig-by-ball.json");
  printPoses(*rig, byBall);

  setProgram(scene, RigProgram::kLamp);
  for (const auto& [name, geometry, file] :
       {std::tuple{"two source cameras, posed by the board", byBoard, out / "calibration/rig.json"},
        std::tuple{"two source cameras, posed by the mirror ball", byBall, pose.out}}) {
    RecordJob lamp;
    lamp.sceneCamera = scene;
    lamp.sourceCameras = sources;
    lamp.cameraModels = models;
    lamp.rigGeometry = file;
    lamp.recorder.directions = 300;
    lamp.recorder.timeLimitSeconds = 40;
    lamp.recorder.sceneBlackLevel = record.recorder.sceneBlackLevel;
    lamp.sketch = out / fs::path(file).stem();
    const JobResult recorded = orStop(recordJob(lamp, progress, {}), "record");
    fmt::print("{}\n", recorded.text);
    const auto sketch = orStop(Sketch::open(lamp.sketch), "sketch");
    const TimePoint zero =
        TimePoint(fromSeconds(recorded.figures["timeZeroSeconds"].get<double>()));
    print(name, errorsOf(*rig, sketch, zero, geometry));
  }
}
