// Two small cameras and a hand that share one world, without any network: 60 frames a second of a
// lamp that goes where it is told.
#pragma once

#include <Eigen/Core>
#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "calibration/model/camera_model.h"
#include "calibration/model/rig_geometry.h"
#include "capture/device/camera.h"

namespace lightsketch {

class FakeCamera;

class FakeRig {
 public:
  explicit FakeRig(bool guided);
  ~FakeRig();

  Camera& scene();
  Camera& source();
  std::shared_ptr<const CameraModel> model() const { return model_; }
  RigGeometry geometry() const;

  static constexpr double kLampRadius = 0.9;
  static constexpr int kSceneWidth = 32, kSceneHeight = 24;
  // Counts of 255 that the scene camera sees of a lamp in a direction, and without it.
  static double lampCounts(const Eigen::Vector3d& direction) { return 90 + 60 * direction.x(); }
  static constexpr double kAmbientCounts = 20;
  static constexpr double kExposureSeconds = 0.002;        // these are counts of
  static constexpr double kSourceExposureSeconds = 0.001;  // the source camera sees the room at 12
  static constexpr double kHighlight = 8;                  // brighter is the pixel in the corner

  // Knobs, set before the cameras start or from any thread.
  std::atomic<bool> lampVisible = true;  // to the source camera
  std::atomic<bool> saturate = false;    // the scene camera
  std::atomic<int> sceneFramesUntilLoss = -1;
  std::atomic<bool> sceneSilent = false;  // sends nothing
  std::atomic<int> sceneWidth = kSceneWidth;
  // Where the lamp is sent, and whether it is on: by the guide features or by a test.
  void send(bool lit, const Eigen::Vector3d& target);

 private:
  friend class FakeCamera;
  struct Lamp {
    bool lit;
    Eigen::Vector3d direction;
  };
  // The hand's way to a target, at one speed along a great circle.
  struct Move {
    TimePoint start;
    bool lit;
    Eigen::Vector3d from, target;
    Eigen::Vector3d at(TimePoint time) const;
  };
  Lamp lampAt(TimePoint time) const;
  std::shared_ptr<const CameraModel> model_;
  mutable std::mutex mutex_;  // Guards moves_.
  // All of them: a camera that a busy machine keeps waiting still sees the lamp where it was.
  std::vector<Move> moves_;
  std::unique_ptr<FakeCamera> scene_, source_;
};

}  // namespace lightsketch
