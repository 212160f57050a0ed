// Poses of source cameras from mirror balls at the subject while the lamp is waved: the scene
// camera sees the lamp in the balls, the source cameras see it themselves.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "calibration/pose/mirror_ball.h"
#include "calibration/pose/pose_calibration.h"
#include "capture/frame/result.h"

namespace lightsketch {

struct BallMoment {
  std::string name;
  std::vector<std::optional<PixelMeasurement>> highlights;  // by ball, in the scene camera
  std::vector<std::optional<PixelMeasurement>> lamps;       // by source camera
};

// A length with its one-sigma error.
struct MeasuredLength {
  double metres = 0;
  double sigmaMetres = 0;
};

struct BallSetup {
  RigCamera sceneCamera;
  std::vector<RigCamera> sourceCameras;
  // By ball: outline in the scene camera's picture, and radius.
  std::vector<BallCone> outlines;
  std::vector<double> radiiMetres;
  // The scene camera in the scene frame where it is known; else the first ball's centre becomes the
  // origin (sceneCameraFromBall).
  std::optional<CameraPose> sceneCameraPose;
  // What fixes the scale; see README.md. By source camera: how far it stands from the first ball's
  // centre, by a ruler; nothing or shorter where not measured.
  std::vector<std::optional<MeasuredLength>> sourceDistances;
  // By source camera: the first ball's outline in its own picture, where it sees the ball.
  std::vector<std::optional<BallCone>> sourceOutlines;
  // Geometric mean of the lamp's distances from the ball over the wave: an arm's length or so.
  MeasuredLength lampDistance{1.0, 0.5};
};

struct BallPoseOptions {
  double outlierSigmas = 4;  // moments beyond this many expected sigmas rms are left out
  Result<void> validate() const;
};

struct BallPoseCalibration {
  PoseCalibration pose;
  std::vector<MirrorBall> balls;  // scene frame
  struct Lamp {
    std::size_t moment = 0;  // index of what was given
    Eigen::Vector3d position;
  };
  std::vector<Lamp> lamps;  // scene frame, of the moments used
};

// Source poses, ball centres and the lamp of every moment in one least-squares problem: pixels of
// outlines, highlights and lamps against the exact reflection off the sphere, with a robust loss.
// Needs no guess: rotations come from reflected directions against source directions (Kabsch on
// the best of random pairs), then lamps on one sphere, then all. Fails with what to do for too few
// moments, a lamp that never moved, highlights all in one place, a radius that is missing.
Result<BallPoseCalibration> poseFromMirrorBalls(const BallSetup& setup,
                                                std::span<const BallMoment> moments,
                                                const BallPoseOptions& options = {});

}  // namespace lightsketch
