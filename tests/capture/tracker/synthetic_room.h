// A source camera's pictures for tests, drawn simply and independently of the simulated rig: a disc
// with a wide halo, mirrored in planes, before static lights, with noise and saturation.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <random>
#include <vector>

#include "calibration/model/camera_model.h"
#include "capture/frame/frame.h"

namespace lightsketch {

// Points in metres, source camera frame (x right, y down, z forward).
struct Mirror {
  Eigen::Vector3d normal;  // unit, towards the camera's side
  double distance = 0;     // of the camera from the plane
  double extent = 1e9;     // the plane reflects only this close to `centre`
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  // of the piece that reflects
};

struct LampPicture {
  Eigen::Vector3d lamp{0, 0, 1};
  bool lit = true;
  double covered = 0;     // fraction of the lamp's diameter hidden from the camera, 1: all
  double coverAngle = 0;  // from which side
  double power = 1;
};

class SyntheticRoom {
 public:
  explicit SyntheticRoom(std::uint32_t seed, PixelFormat format = PixelFormat::kMono8);

  std::shared_ptr<const CameraModel> model() const { return model_; }
  // `time` becomes the frame's mid-exposure, counted from the clock's zero.
  Frame draw(double time, const LampPicture& picture);
  // Where the mirrors show the lamp, with the reflectance, 0 where they do not.
  std::vector<std::pair<Eigen::Vector3d, double>> reflections(const Eigen::Vector3d& lamp) const;
  // Saturated discs of the room's own.
  const std::vector<Eigen::Vector3d>& ceilingLamps() const { return ceilingLamps_; }

  std::vector<Mirror> mirrors;
  double flicker = 0;  // relative change of the ceiling lamps from frame to frame

 private:
  void addDisc(const Eigen::Vector3d& direction, double radius, double radiance, double covered,
               double coverAngle);
  std::shared_ptr<const CameraModel> model_;
  PixelFormat format_;
  std::mt19937 random_;
  std::vector<Eigen::Vector3d> ceilingLamps_;
  std::vector<float> room_;
  std::vector<float> canvas_;  // 1: saturation
  std::vector<float> noise_;
};

}  // namespace lightsketch
