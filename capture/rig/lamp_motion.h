// Where the lamp is, for whoever draws it.
#pragma once

#include <Eigen/Core>

namespace lightsketch {

inline constexpr double kLampRadiusMetres = 0.015;  // a small frosted bulb
inline constexpr double kLampDistanceMetres = 0.9;  // where the hand means to hold it

struct LampState {
  bool lit = false;
  // How far the hand has slid between the lamp and the source camera: 0 not at all, 1 all of it.
  double cover = 0;
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  // scene frame, metres
  double power = 1;                                    // of its light, against the nominal one
};

class LampMotion {
 public:
  virtual ~LampMotion() = default;
  // Called before a frame is made: everything up to `timeSeconds` must be known afterwards.
  virtual void advanceTo(double timeSeconds) = 0;
  // Thread-safe. Times since the rig's start; later ones than were advanced to give the last state.
  virtual LampState at(double timeSeconds) const = 0;
};

}  // namespace lightsketch
