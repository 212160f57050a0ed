#include "tests/capture/session/fake_rig.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <iterator>

namespace lightsketch {
namespace {

constexpr int kSourceSize = 240;
constexpr double kFramesPerSecond = 60;
constexpr double kHandSpeed = Angle::degrees(120).radians();  // per second

}  // namespace

class FakeCamera final : public Camera {
 public:
  FakeCamera(FakeRig& rig, bool isSource, bool guided)
      : rig_(rig), isSource_(isSource), guided_(guided) {
    info_ = {isSource ? "fake:source" : "fake:scene", "Fake", "Fake", isSource ? "F2" : "F1"};
  }
  ~FakeCamera() override { stop(); }

  const CameraInfo& info() const override { return info_; }
  Result<CameraSettings> configure(const CameraSettings& settings) override {
    const std::lock_guard lock(mutex_);
    if (settings.exposureSeconds) settings_.exposureSeconds = settings.exposureSeconds;
    if (settings.gainDb) settings_.gainDb = settings.gainDb;
    settings_.format = PixelFormat::kMono8;
    settings_.region = isSource_ ? Region{0, 0, kSourceSize, kSourceSize}
                                 : Region{0, 0, rig_.sceneWidth.load(), FakeRig::kSceneHeight};
    return settings_;
  }
  Result<void> start(FrameCallback onFrame, EndCallback onEnd) override {
    thread_ = std::jthread([this, onFrame, onEnd](const std::stop_token& stop) {
      const TimePoint start = Clock::now();
      for (std::uint64_t id = 0; !stop.stop_requested(); ++id) {
        // The two cameras are not in step.
        const double offset = isSource_ ? 0.0 : 0.4 / kFramesPerSecond;
        const TimePoint time =
            start + fromSeconds(offset + static_cast<double>(id) / kFramesPerSecond);
        std::this_thread::sleep_until(time);
        if (!isSource_ && rig_.sceneFramesUntilLoss >= 0 && rig_.sceneFramesUntilLoss-- == 0) {
          if (onEnd) onEnd({ErrorCode::kDevice, "fake:scene: control lost"});
          return;
        }
        if (!isSource_ && rig_.sceneSilent) continue;
        onFrame(draw(id, time));
        ++delivered_;
      }
    });
    return {};
  }
  void stop() override {
    thread_.request_stop();
    if (thread_.joinable()) thread_.join();
  }
  StreamStatistics statistics() const override {
    StreamStatistics statistics;
    statistics.delivered = delivered_;
    return statistics;
  }
  bool hasFeature(const std::string& name) const override {
    return isSource_ && guided_ && name.starts_with("Guide");
  }
  Result<void> setFeature(const std::string& name, double value) override {
    if (name == "GuideX") guide_.x() = value;
    if (name == "GuideY") guide_.y() = value;
    if (name == "GuideZ") guide_.z() = value;
    if (name == "GuideMode") rig_.send(value != 1, guide_.normalized());
    return {};
  }

 private:
  Frame draw(std::uint64_t id, TimePoint time) {
    const auto lamp = rig_.lampAt(time);
    Frame frame;
    frame.metadata.id = id;
    frame.metadata.midExposure = frame.metadata.arrival = time;
    {
      const std::lock_guard lock(mutex_);
      frame.metadata.exposureSeconds = settings_.exposureSeconds.value_or(0.01);
      frame.metadata.gainDb = settings_.gainDb.value_or(0);
    }
    frame.width = isSource_ ? kSourceSize : rig_.sceneWidth.load();
    frame.height = isSource_ ? kSourceSize : FakeRig::kSceneHeight;
    const std::size_t pixels =
        static_cast<std::size_t>(frame.width) * static_cast<std::size_t>(frame.height);
    if (!isSource_) {
      const double counts =
          rig_.saturate
              ? 255
              : FakeRig::kAmbientCounts + (lamp.lit ? FakeRig::lampCounts(lamp.direction) : 0);
      const double exposed = counts * frame.metadata.exposureSeconds / FakeRig::kExposureSeconds;
      frame.bytes.assign(pixels, static_cast<std::uint8_t>(std::lround(std::min(exposed, 255.0))));
      // A highlight in one corner, four times too bright for the usual exposure.
      if (lamp.lit) {
        frame.bytes[0] =
            static_cast<std::uint8_t>(std::lround(std::min(exposed * FakeRig::kHighlight, 255.0)));
      }
      return frame;
    }
    const double scale = frame.metadata.exposureSeconds / FakeRig::kSourceExposureSeconds;
    frame.bytes.assign(pixels, static_cast<std::uint8_t>(std::lround(std::min(12 * scale, 255.0))));
    const RigGeometry geometry = rig_.geometry();
    const Eigen::Vector3d position = FakeRig::kLampRadius * lamp.direction;
    const auto centre =
        rig_.model()->project(geometry.sourceCameras[0].sceneFromCamera.inverse() * position);
    if (!lamp.lit || !rig_.lampVisible || !centre) return frame;
    for (int y = 0; y < kSourceSize; ++y) {
      for (int x = 0; x < kSourceSize; ++x) {
        const double r = std::hypot(x + 0.5 - centre->x(), y + 0.5 - centre->y());
        if (r > 20) continue;
        const double value =
            scale * (12 + 900 * std::clamp(3.5 - r, 0.0, 1.0) + 2000 / std::pow(2 + r, 3));
        frame.bytes[static_cast<std::size_t>(y * kSourceSize + x)] =
            static_cast<std::uint8_t>(std::min(255.0, value));
      }
    }
    return frame;
  }

  FakeRig& rig_;
  const bool isSource_;
  const bool guided_;
  CameraInfo info_;
  std::mutex mutex_;  // Guards settings_.
  CameraSettings settings_;
  Eigen::Vector3d guide_ = Eigen::Vector3d::UnitZ();
  std::atomic<std::uint64_t> delivered_ = 0;
  std::jthread thread_;
};

FakeRig::FakeRig(bool guided) {
  FisheyeParameters lens;
  lens.width = lens.height = kSourceSize;
  lens.fx = lens.fy = 66;
  lens.cx = lens.cy = kSourceSize / 2.0;
  lens.maxFieldAngle = Angle::degrees(98);
  model_ = FisheyeModel::create(lens).value();
  const Eigen::Vector3d begin = Eigen::Vector3d(0.2, 0.1, 1).normalized();
  moves_.push_back({Clock::now(), true, begin, begin});
  scene_ = std::make_unique<FakeCamera>(*this, false, guided);
  source_ = std::make_unique<FakeCamera>(*this, true, guided);
}

FakeRig::~FakeRig() {
  scene_->stop();
  source_->stop();
}

Camera& FakeRig::scene() { return *scene_; }
Camera& FakeRig::source() { return *source_; }

RigGeometry FakeRig::geometry() const {
  RigGeometry rig;
  CameraPose pose;
  pose.camera = "fake:source";
  pose.sceneFromCamera.linear() = Eigen::Vector3d(-1, -1, 1).asDiagonal();  // looks at the viewer
  pose.sceneFromCamera.translation() = Eigen::Vector3d(0.1, 0, 0.02);
  rig.sourceCameras.push_back(pose);
  rig.lampRadiusMetres = kLampRadius;
  return rig;
}

void FakeRig::send(bool lit, const Eigen::Vector3d& target) {
  const std::lock_guard lock(mutex_);
  const TimePoint now = Clock::now();
  moves_.push_back({now, lit, moves_.back().at(now), target.normalized()});
}

Eigen::Vector3d FakeRig::Move::at(TimePoint time) const {
  const double angle = std::atan2(from.cross(target).norm(), from.dot(target));
  const double gone = std::max(0.0, toSeconds(time - start)) * kHandSpeed;
  if (gone >= angle) return target;
  return (std::sin(angle - gone) * from + std::sin(gone) * target) / std::sin(angle);
}

FakeRig::Lamp FakeRig::lampAt(TimePoint time) const {
  const std::lock_guard lock(mutex_);
  const auto next = std::ranges::upper_bound(moves_, time, {}, &Move::start);
  const Move& move = next == moves_.begin() ? *next : *std::prev(next);
  // A hand is never quite still.
  const double t = toSeconds(time.time_since_epoch());
  const Eigen::Vector3d tremor(0.012 * std::sin(23 * t), 0.012 * std::cos(19 * t), 0);
  return {move.lit, (move.at(time) + tremor).normalized()};
}

}  // namespace lightsketch
