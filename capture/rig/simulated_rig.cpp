#include "capture/rig/simulated_rig.h"

#include <cmath>
#include <utility>
#include <vector>

#include "capture/rig/fisheye_lens.h"
#include "capture/rig/room.h"
#include "capture/rig/scene_view.h"
#include "capture/rig/sensor.h"
#include "capture/rig/simulated_hand.h"
#include "capture/rig/source_view.h"
#include "capture/rig/still_life.h"

namespace lightsketch {
namespace {

constexpr double kSceneExposureSeconds = 0.02;
constexpr double kSourceExposureSeconds = 0.001;

// Serves a loop of frames from memory, both cameras at the same place of the loop at the same time.
// They are rendered for the settings given at the start; other settings cost a rendering of their
// own, once.
class LoopedSource final : public FrameSource {
 public:
  LoopedSource(FrameSource& view, int frames, double framesPerSecond, double exposureSeconds)
      : view_(view), frames_(frames), framesPerSecond_(framesPerSecond) {
    ExposureRequest usual;
    usual.format = view.formats().front();
    usual.region = {0, 0, view.sensorWidth(), view.sensorHeight()};
    usual.exposureSeconds = exposureSeconds;
    fill(usual);
  }

  int sensorWidth() const override { return view_.sensorWidth(); }
  int sensorHeight() const override { return view_.sensorHeight(); }
  std::vector<PixelFormat> formats() const override { return view_.formats(); }
  void guide(const Guide& guide) override { view_.guide(guide); }
  void expose(const ExposureRequest& request, std::vector<std::uint8_t>& bytes) override {
    if (!isFor(request)) fill(request);
    const auto place = std::llround(request.timeSeconds * framesPerSecond_) % frames_;
    bytes = loop_[static_cast<std::size_t>(place)];
  }

 private:
  bool isFor(const ExposureRequest& r) const {
    return r.format == made_.format && r.region == made_.region &&
           r.exposureSeconds == made_.exposureSeconds && r.gainDb == made_.gainDb;
  }
  void fill(const ExposureRequest& request) {
    made_ = request;
    loop_.resize(static_cast<std::size_t>(frames_));
    for (int i = 0; i < frames_; ++i) {
      ExposureRequest one = request;
      one.index = static_cast<std::uint64_t>(i);
      one.timeSeconds = i / framesPerSecond_;
      view_.expose(one, loop_[static_cast<std::size_t>(i)]);
    }
  }

  FrameSource& view_;
  int frames_;
  double framesPerSecond_;
  ExposureRequest made_;
  std::vector<std::vector<std::uint8_t>> loop_;
};

}  // namespace

int sceneBlackLevelCounts(PixelFormat format) { return blackLevelCounts(format); }

struct SimulatedRig::State {
  SimulatedRigOptions options;
  LensFit lensFit;
  std::shared_ptr<const StillLife> stillLife;
  Room room;
  TimePoint startTime;
  std::unique_ptr<SimulatedHand> hand;   // absent where frames are rendered beforehand
  std::unique_ptr<SpiralMotion> spiral;  // then this is the lamp's path
  std::unique_ptr<SceneView> sceneView;
  std::unique_ptr<SourceView> sourceView;
  std::unique_ptr<LoopedSource> sceneLoop, sourceLoop;
  // Destroyed first: their threads call the views.
  std::unique_ptr<GigeDevice> sceneDevice, sourceDevice;

  LampMotion& motion() {
    return hand ? static_cast<LampMotion&>(*hand) : static_cast<LampMotion&>(*spiral);
  }
};

Result<std::unique_ptr<SimulatedRig>> SimulatedRig::start(const SimulatedRigOptions& options) {
  if (options.framesPerSecond <= 0 || options.prerenderedFrames < 0 || options.packetLoss < 0 ||
      options.packetLoss >= 1) {
    return failure(ErrorCode::kInvalidArgument,
                   "simulated rig: frame rate must be positive, packet loss within [0, 1)");
  }
  auto state = std::make_unique<State>();
  State& s = *state;
  s.options = options;
  ASSIGN_OR_RETURN(s.lensFit, fitKannalaBrandt(FisheyeLens()));
  ASSIGN_OR_RETURN(s.stillLife, StillLife::load(options.scene));
  if (options.prerenderedFrames > 0) {
    s.spiral = std::make_unique<SpiralMotion>(options.prerenderedFrames / options.framesPerSecond);
  } else {
    s.hand = std::make_unique<SimulatedHand>(options.seed);
  }
  s.sceneView = std::make_unique<SceneView>(s.stillLife, s.room, s.motion(), options.seed);
  s.sourceView = std::make_unique<SourceView>(
      s.stillLife, s.room, s.motion(), options.seed + 1, [&s](const Guide& guide) {
        if (s.hand) s.hand->guide(guide, toSeconds(Clock::now() - s.startTime));
      });
  if (options.prerenderedFrames > 0) {
    s.sceneLoop = std::make_unique<LoopedSource>(*s.sceneView, options.prerenderedFrames,
                                                 options.framesPerSecond, kSceneExposureSeconds);
    s.sourceLoop = std::make_unique<LoopedSource>(*s.sourceView, options.prerenderedFrames,
                                                  options.framesPerSecond, kSourceExposureSeconds);
  }

  // Two cameras with clocks of their own, as real ones have.
  GigeDeviceOptions scene;
  scene.address = options.sceneAddress;
  scene.model = "SimulatedScene";
  scene.serial = "SIM-SCENE-1";
  scene.defaultFramesPerSecond = options.framesPerSecond;
  scene.defaultExposureSeconds = kSceneExposureSeconds;
  scene.clockOffsetSeconds = 12.3;
  scene.clockDriftPpm = 40;
  scene.packetLoss = options.packetLoss;
  scene.seed = options.seed;
  GigeDeviceOptions source = scene;
  source.address = options.sourceAddress;
  source.model = "SimulatedSource";
  source.serial = "SIM-SOURCE-1";
  source.defaultExposureSeconds = kSourceExposureSeconds;
  source.clockOffsetSeconds = 3471.9;
  source.clockDriftPpm = -25;
  source.seed = options.seed + 1;

  s.startTime = Clock::now();
  FrameSource& sceneFrames = s.sceneLoop ? static_cast<FrameSource&>(*s.sceneLoop) : *s.sceneView;
  FrameSource& sourceFrames =
      s.sourceLoop ? static_cast<FrameSource&>(*s.sourceLoop) : *s.sourceView;
  ASSIGN_OR_RETURN(s.sceneDevice, GigeDevice::start(sceneFrames, scene, s.startTime));
  ASSIGN_OR_RETURN(s.sourceDevice, GigeDevice::start(sourceFrames, source, s.startTime));
  return std::unique_ptr<SimulatedRig>(new SimulatedRig(std::move(state)));
}

SimulatedRig::SimulatedRig(std::unique_ptr<State> state) : state_(std::move(state)) {}
SimulatedRig::~SimulatedRig() = default;

std::shared_ptr<const CameraModel> SimulatedRig::calibratedSourceModel() const {
  return state_->lensFit.model;
}

RigGeometry SimulatedRig::geometry() const {
  RigGeometry geometry;
  geometry.sceneCamera = {state_->options.sceneAddress, state_->stillLife->sceneFromCamera()};
  geometry.sourceCameras = {{state_->options.sourceAddress, state_->sourceView->sceneFromCamera()}};
  geometry.lampRadiusMetres = kLampDistanceMetres;
  return geometry;
}

TimePoint SimulatedRig::startTime() const { return state_->startTime; }

LampTruth SimulatedRig::truthAt(double timeSeconds) const {
  const LampState lamp = state_->motion().at(timeSeconds);
  LampTruth truth;
  truth.timeSeconds = timeSeconds;
  truth.lit = lamp.lit;
  truth.visibleToSource = state_->sourceView->seesLamp(lamp);
  truth.lampInScene = lamp.position;
  truth.directionInSource =
      (state_->sourceView->sceneFromCamera().inverse() * lamp.position).normalized();
  return truth;
}

std::uint64_t SimulatedRig::framesSent() const {
  return state_->sceneDevice->framesSent() + state_->sourceDevice->framesSent();
}

}  // namespace lightsketch
