// Mirror balls in a recorded sketch.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "calibration/pose/ball_detection.h"
#include "calibration/pose/ball_pose.h"
#include "capture/frame/progress.h"
#include "capture/frame/result.h"
#include "pipeline/sketch/sketch.h"

namespace lightsketch {

// What a sketch's frames have in common, from some of them, spread over all.
struct SketchOverview {
  RadianceImage minimum;  // per pixel: what does not come from the moving lamp
  RadianceImage mean;     // highlights count no more than white: good for outlines
};
Result<SketchOverview> overviewOf(const Sketch& sketch, std::span<const int> ids,
                                  Progress& progress);

// The outline as it is seen or, where it does not show (a chrome ball mirrors at its rim what is
// right behind it), as the hint has it, uncertain by 3 percent of the radius.
Result<BallCone> outlineOf(const SketchOverview& overview, const CameraModel& model,
                           const std::optional<BallHint>& hint);

struct BallSketch {
  BallSetup setup;
  std::vector<BallMoment> moments;
};

// Outlines, highlights and lamp pixels of a sketch in which the lamp was waved around mirror balls
// at the subject, as poseFromMirrorBalls() wants them. `sourceCameras` are named as in the journal.
// `hints`: where the balls are, to a few percent of their radius; none for one ball that can be
// found by itself. Where an outline does not show, the hint itself is taken for it. Frames
// whose highlight is doubtful simply lack it. Fails where a ball is not found.
Result<BallSketch> ballsInSketch(const Sketch& sketch, const RigCamera& sceneCamera,
                                 std::span<const RigCamera> sourceCameras,
                                 std::span<const BallHint> hints,
                                 std::span<const double> radiiMetres, Progress& progress);

}  // namespace lightsketch
