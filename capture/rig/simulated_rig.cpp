#include "capture/rig/simulated_rig.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>
#include <vector>

#include "capture/rig/fisheye_lens.h"
#include "capture/rig/play.h"
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

// Beside the still life, high enough to stay out of most shadows.
const MattePatch kReferencePatch{{0.084, 0.062, 0.006}, 0.016};

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

// A camera whose feature "RigProgram" is heard.
class ProgrammedSource final : public FrameSource {
 public:
  ProgrammedSource(FrameSource& view, std::function<void(RigProgram)> onProgram)
      : view_(view), onProgram_(std::move(onProgram)) {}

  int sensorWidth() const override { return view_.sensorWidth(); }
  int sensorHeight() const override { return view_.sensorHeight(); }
  std::vector<PixelFormat> formats() const override { return view_.formats(); }
  void guide(const Guide& guide) override { view_.guide(guide); }
  void startProgram(RigProgram program) override { onProgram_(program); }
  void expose(const ExposureRequest& request, std::vector<std::uint8_t>& bytes) override {
    view_.expose(request, bytes);
  }

 private:
  FrameSource& view_;
  std::function<void(RigProgram)> onProgram_;
};

// The lamp as the programs have it: guided, waved around the ball, or put away.
class ProgramMotion final : public LampMotion {
 public:
  ProgramMotion(const ProgramLog& programs, LampMotion& guided, const HandOptions& hand,
                double powerDrift, std::uint32_t seed)
      : programs_(programs),
        guided_(guided),
        powerDrift_(powerDrift),
        sweeping_(seed, sweeping(hand)) {}

  void advanceTo(double timeSeconds) override {
    const auto [program, since] = programs_.at(timeSeconds);
    if (program == RigProgram::kLamp) guided_.advanceTo(timeSeconds);
    if (program == RigProgram::kMirrorBall) sweeping_.advanceTo(timeSeconds - since);
  }
  LampState at(double timeSeconds) const override {
    const auto [program, since] = programs_.at(timeSeconds);
    const bool sweeps = program == RigProgram::kMirrorBall;
    LampState state = sweeps ? sweeping_.at(timeSeconds - since) : guided_.at(timeSeconds);
    state.lit = state.lit && (sweeps || program == RigProgram::kLamp);
    state.power = 1 + powerDrift_ * (0.6 * std::sin(0.31 * timeSeconds + 1.0) +
                                     0.4 * std::sin(0.73 * timeSeconds + 2.6));
    return state;
  }

 private:
  static HandOptions sweeping(HandOptions options) {
    options.sweeps = true;
    return options;
  }

  const ProgramLog& programs_;
  LampMotion& guided_;
  double powerDrift_;
  SimulatedHand sweeping_;
};

Result<void> validate(const SimulatedRigOptions& o) {
  if (o.framesPerSecond <= 0 || o.prerenderedFrames < 0 || o.packetLoss < 0 || o.packetLoss >= 1) {
    return failure(ErrorCode::kInvalidArgument,
                   "simulated rig: frame rate must be positive, packet loss within [0, 1)");
  }
  if (o.prerenderedFrames > 0 && o.program != RigProgram::kLamp) {
    return failure(ErrorCode::kInvalidArgument,
                   "simulated rig: only the lamp's program can be rendered beforehand");
  }
  if (!(o.ballRadiusMetres >= 0.005 && o.ballRadiusMetres <= 0.05)) {
    return failure(ErrorCode::kInvalidArgument,
                   "simulated rig: a mirror ball of {} m radius; give 0.005 to 0.05",
                   o.ballRadiusMetres);
  }
  if (!(o.minLampDistanceMetres >= 0.3 && o.minLampDistanceMetres <= o.maxLampDistanceMetres &&
        o.maxLampDistanceMetres <= 1.5)) {
    return failure(ErrorCode::kInvalidArgument,
                   "simulated rig: lamp between {} and {} m from the subject; give 0.3 to 1.5",
                   o.minLampDistanceMetres, o.maxLampDistanceMetres);
  }
  const auto nonsense = [](const SensorFlaws& f) {
    return !(f.vignetting >= 0 && f.vignetting < 1 && f.prnu >= 0 && f.prnu < 0.2 &&
             f.fixedPattern >= 0 && f.fixedPattern < 0.2 && f.darkCurrent >= 0 &&
             f.hotPixels >= 0 && f.hotPixels <= 10'000);
  };
  if (!(o.lampPowerDrift >= 0 && o.lampPowerDrift < 1) || nonsense(o.sceneFlaws) ||
      nonsense(o.sourceFlaws)) {
    return failure(
        ErrorCode::kInvalidArgument,
        "simulated rig: lamp drift and vignetting within [0, 1), pixel gains and offsets "
        "within [0, 0.2), no negative dark current, at most 10000 hot pixels");
  }
  return {};
}

}  // namespace

int sceneBlackLevelCounts(PixelFormat format) { return blackLevelCounts(format); }

struct SimulatedRig::State {
  State(RigProgram program, HeldBoard&& board, const ChromeBall& ball,
        std::shared_ptr<const StillLife> bareTable, std::shared_ptr<const StillLife> tableWithBall)
      : play{ProgramLog(program), std::move(board), ball, std::move(bareTable),
             std::move(tableWithBall)} {}

  // A camera: what it sees, and the device that sends it.
  struct Source {
    std::string address;
    LensFit fit;
    std::unique_ptr<SourceView> view;
  };

  SimulatedRigOptions options;
  std::shared_ptr<const StillLife> stillLife;
  Room room;
  Play play;
  TimePoint startTime;
  std::unique_ptr<SimulatedHand> hand;   // absent where frames are rendered beforehand
  std::unique_ptr<SpiralMotion> spiral;  // then this is the lamp's path
  std::unique_ptr<ProgramMotion> motion;
  std::unique_ptr<SceneView> sceneView;
  std::vector<Source> sources;
  std::vector<std::unique_ptr<FrameSource>> served;  // what stands between views and devices
  // Destroyed first: their threads call the views.
  std::vector<std::unique_ptr<GigeDevice>> devices;  // null: unplugged
  std::vector<GigeDeviceOptions> deviceOptions;

  double now() const { return toSeconds(Clock::now() - startTime); }
  HandOptions handOptions() const {
    return {options.minLampDistanceMetres, options.maxLampDistanceMetres, false};
  }
  // Starts a device that serves a view, by way of a loop of frames rendered beforehand or of the
  // ear for programs.
  Result<void> serve(FrameSource& view, GigeDeviceOptions device);
};

Result<void> SimulatedRig::State::serve(FrameSource& view, GigeDeviceOptions device) {
  if (options.prerenderedFrames > 0) {
    served.push_back(std::make_unique<LoopedSource>(
        view, options.prerenderedFrames, options.framesPerSecond, device.defaultExposureSeconds));
  } else {
    served.push_back(std::make_unique<ProgrammedSource>(
        view, [this](RigProgram program) { play.programs.start(program, now()); }));
  }
  device.defaultFramesPerSecond = options.framesPerSecond;
  device.faults.loss = options.packetLoss;
  // As a gigabit line carries them; exposure and transfer have to fit into the frame interval.
  if (options.framesPerSecond > 20) device.packetsPerBurst = 40;
  device.program = options.program;
  device.seed = options.seed + static_cast<std::uint32_t>(devices.size());
  ASSIGN_OR_RETURN(auto started, GigeDevice::start(*served.back(), device, startTime));
  devices.push_back(std::move(started));
  deviceOptions.push_back(device);
  return {};
}

Result<std::unique_ptr<SimulatedRig>> SimulatedRig::start(const SimulatedRigOptions& options) {
  RETURN_IF_ERROR(validate(options));
  ASSIGN_OR_RETURN(auto stillLife, StillLife::load(options.scene));
  if (options.referencePatch) {
    ASSIGN_OR_RETURN(stillLife, stillLife->arranged({true, std::nullopt, kReferencePatch}));
  }
  std::vector<std::pair<std::string, SourceSeat>> seats{{options.sourceAddress, firstSourceSeat()}};
  if (!options.secondSource.empty()) seats.emplace_back(options.secondSource, secondSourceSeat());

  // What the programs put before the cameras.
  const ChromeBall ball{{0, 0, stillLife->tableHeight() + options.ballRadiusMetres},
                        options.ballRadiusMetres};
  const double halfWidth = std::tan(stillLife->horizontalField().radians() / 2);
  BoardAudience audience{stillLife->sceneFromCamera(),
                         {halfWidth, halfWidth * SceneView::kHeight / SceneView::kWidth},
                         {},
                         stillLife->tableHeight()};
  for (const auto& seat : seats) {
    audience.sceneFromSources.push_back(seat.second.sceneFromCamera);
  }
  ASSIGN_OR_RETURN(auto board, HeldBoard::create(options.board, audience));
  ASSIGN_OR_RETURN(auto bareTable, stillLife->arranged({false, std::nullopt, std::nullopt}));
  ASSIGN_OR_RETURN(auto tableWithBall, stillLife->arranged({false, ball, std::nullopt}));
  auto state = std::make_unique<State>(options.program, std::move(board), ball,
                                       std::move(bareTable), std::move(tableWithBall));
  State& s = *state;
  s.options = options;
  s.stillLife = stillLife;

  if (options.prerenderedFrames > 0) {
    s.spiral = std::make_unique<SpiralMotion>(options.prerenderedFrames / options.framesPerSecond);
  } else {
    s.hand = std::make_unique<SimulatedHand>(options.seed, s.handOptions());
  }
  LampMotion& guided =
      s.hand ? static_cast<LampMotion&>(*s.hand) : static_cast<LampMotion&>(*s.spiral);
  s.motion = std::make_unique<ProgramMotion>(s.play.programs, guided, s.handOptions(),
                                             options.lampPowerDrift, options.seed + 77);
  s.sceneView = std::make_unique<SceneView>(s.stillLife, s.room, *s.motion, options.seed, &s.play,
                                            options.sceneFlaws);
  for (const auto& [address, seat] : seats) {
    State::Source source;
    source.address = address;
    ASSIGN_OR_RETURN(source.fit, fitKannalaBrandt(FisheyeLens(seat.lens)));
    source.view = std::make_unique<SourceView>(
        s.stillLife, s.room, *s.motion,
        options.seed + 1 + static_cast<std::uint32_t>(s.sources.size()),
        [&s](const Guide& guide) {
          if (s.hand) s.hand->guide(guide, s.now());
        },
        &s.play, seat, options.sourceFlaws);
    s.sources.push_back(std::move(source));
  }

  // Cameras with clocks of their own, as real ones have.
  s.startTime = Clock::now();
  GigeDeviceOptions scene;
  scene.address = options.sceneAddress;
  scene.model = "SimulatedScene";
  scene.serial = "SIM-SCENE-1";
  scene.defaultExposureSeconds = kSceneExposureSeconds;
  scene.clockOffsetSeconds = 12.3;
  scene.clockDriftPpm = 40;
  scene.stamp = options.stampFrames;
  RETURN_IF_ERROR(s.serve(*s.sceneView, scene));
  for (const State::Source& source : s.sources) {
    const bool first = &source == &s.sources.front();
    GigeDeviceOptions device;
    device.address = source.address;
    device.model = "SimulatedSource";
    device.serial = first ? "SIM-SOURCE-1" : "SIM-SOURCE-2";
    device.defaultExposureSeconds = kSourceExposureSeconds;
    device.clockOffsetSeconds = first ? 3471.9 : 801.4;
    device.clockDriftPpm = first ? -25 : 15;
    RETURN_IF_ERROR(s.serve(*source.view, device));
  }
  return std::unique_ptr<SimulatedRig>(new SimulatedRig(std::move(state)));
}

SimulatedRig::SimulatedRig(std::unique_ptr<State> state) : state_(std::move(state)) {}
SimulatedRig::~SimulatedRig() = default;

std::shared_ptr<const CameraModel> SimulatedRig::calibratedSourceModel(std::size_t source) const {
  return state_->sources.at(source).fit.model;
}

RigGeometry SimulatedRig::geometry() const {
  const SimulatedRigOptions& o = state_->options;
  RigGeometry geometry;
  geometry.sceneCamera = {o.sceneAddress, state_->stillLife->sceneFromCamera()};
  for (const State::Source& source : state_->sources) {
    geometry.sourceCameras.push_back({source.address, source.view->sceneFromCamera()});
  }
  if (o.minLampDistanceMetres == o.maxLampDistanceMetres) {
    geometry.lampRadiusMetres = o.minLampDistanceMetres;
  }
  return geometry;
}

std::size_t SimulatedRig::sourceCount() const { return state_->sources.size(); }

TimePoint SimulatedRig::startTime() const { return state_->startTime; }

LampTruth SimulatedRig::truthAt(double timeSeconds) const {
  const LampState lamp = state_->motion->at(timeSeconds);
  const RigProgram program = programAt(timeSeconds);
  LampTruth truth;
  truth.timeSeconds = timeSeconds;
  truth.lit = lamp.lit;
  truth.lampInScene = lamp.position;
  truth.power = lamp.power;
  for (const State::Source& source : state_->sources) {
    truth.sources.push_back(
        {source.view->seesLamp(lamp, program),
         (source.view->sceneFromCamera().inverse() * lamp.position).normalized()});
  }
  truth.visibleToSource = truth.sources.front().visible;
  truth.directionInSource = truth.sources.front().direction;
  return truth;
}

RigProgram SimulatedRig::programAt(double timeSeconds) const {
  return state_->play.programs.at(timeSeconds).program;
}

std::optional<BoardTruth> SimulatedRig::boardAt(double timeSeconds) const {
  const auto [program, since] = state_->play.programs.at(timeSeconds);
  if (program != RigProgram::kBoard) return std::nullopt;
  const HeldBoard& board = state_->play.board;
  return BoardTruth{board.sceneFromBoardAt(timeSeconds - since),
                    board.stillAt(timeSeconds - since)};
}

Eigen::Vector3d SimulatedRig::boardCorner(int column, int row) const {
  return state_->play.board.corner(column, row);
}

double SimulatedRig::boardPeriodSeconds() const { return state_->play.board.periodSeconds(); }

ChromeBall SimulatedRig::mirrorBall() const { return state_->play.ball; }

std::optional<Eigen::Vector3d> SimulatedRig::trueDirection(const Eigen::Vector2d& pixel,
                                                           std::size_t source) const {
  return state_->sources.at(source).view->lens().unproject(pixel);
}

std::optional<Eigen::Vector2d> SimulatedRig::truePixel(const Eigen::Vector3d& directionInSource,
                                                       std::size_t source) const {
  return state_->sources.at(source).view->lens().project(directionInSource);
}

std::optional<PatchTruth> SimulatedRig::referencePatch() const {
  if (!state_->options.referencePatch) return std::nullopt;
  const Eigen::Isometry3d cameraFromScene = state_->stillLife->sceneFromCamera().inverse();
  const double focal = sceneFocalLengthPixels();
  // The largest upright rectangle that fits between the corners, less a margin for the edges.
  std::vector<double> xs, ys;
  for (const double a : {-0.5, 0.5}) {
    for (const double b : {-0.5, 0.5}) {
      const Eigen::Vector3d p = cameraFromScene * (kReferencePatch.centre +
                                                   kReferencePatch.side * Eigen::Vector3d(a, b, 0));
      xs.push_back(focal * p.x() / p.z() + SceneView::kWidth / 2.0);
      ys.push_back(focal * p.y() / p.z() + SceneView::kHeight / 2.0);
    }
  }
  std::sort(xs.begin(), xs.end());
  std::sort(ys.begin(), ys.end());
  constexpr double kMargin = 3;
  const int x = static_cast<int>(std::ceil(xs[1] + kMargin));
  const int y = static_cast<int>(std::ceil(ys[1] + kMargin));
  return PatchTruth{
      {x, y, static_cast<int>(xs[2] - kMargin) - x, static_cast<int>(ys[2] - kMargin) - y},
      kReferencePatch.centre,
      kReferencePatchAlbedo};
}

double SimulatedRig::trueSceneSignal(PixelFormat format, double counts) const {
  return signalOfCounts(state_->options.sceneFlaws.eightBitResponse, format, counts);
}

double SimulatedRig::trueSourceSignal(PixelFormat format, double counts) const {
  return signalOfCounts(state_->options.sourceFlaws.eightBitResponse, format, counts);
}

std::vector<Eigen::Vector2i> SimulatedRig::sceneHotPixels() const {
  return state_->sceneView->pixels().hotPixels();
}

std::vector<Eigen::Vector2i> SimulatedRig::sourceHotPixels(std::size_t source) const {
  return state_->sources.at(source).view->pixels().hotPixels();
}

double SimulatedRig::sceneFalloff(const Eigen::Vector2d& pixel) const {
  return state_->sceneView->pixels().falloff(pixel);
}

double SimulatedRig::sourceFalloff(const Eigen::Vector2d& pixel, std::size_t source) const {
  const SourceView& view = *state_->sources.at(source).view;
  return view.falloff(pixel) * view.pixels().falloff(pixel);
}

double SimulatedRig::sceneFocalLengthPixels() const {
  return state_->sceneView->focalLengthPixels();
}

std::uint64_t SimulatedRig::framesSent() const {
  std::uint64_t sent = 0;
  for (const auto& device : state_->devices) sent += device ? device->framesSent() : 0;
  return sent;
}

void SimulatedRig::setFaults(std::size_t camera, const GigeFaults& faults) {
  if (const auto& device = state_->devices.at(camera)) device->setFaults(faults);
}

void SimulatedRig::unplug(std::size_t camera) { state_->devices.at(camera).reset(); }

Result<void> SimulatedRig::plugIn(std::size_t camera) {
  if (state_->devices.at(camera)) return {};
  ASSIGN_OR_RETURN(
      state_->devices[camera],
      GigeDevice::start(*state_->served[camera], state_->deviceOptions[camera], state_->startTime));
  return {};
}

}  // namespace lightsketch
