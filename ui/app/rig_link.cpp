#include "ui/app/rig_link.h"

#include <QStandardPaths>
#include <QTimer>
#include <condition_variable>
#include <deque>
#include <future>
#include <mutex>
#include <stdexcept>
#include <thread>

#include "calibration/model/camera_model.h"
#include "calibration/model/rig_geometry.h"

namespace lightsketch {
namespace {

// A page that is left for another often wants the cameras again a moment later.
constexpr int kCloseAfterMilliseconds = 2000;

QString describe(const CameraSettings& now) {
  QStringList parts;
  if (now.exposureSeconds) {
    parts << RigLink::tr("exposure %1 ms").arg(1e3 * *now.exposureSeconds, 0, 'g', 4);
  }
  if (now.gainDb) parts << RigLink::tr("gain %1 dB").arg(*now.gainDb, 0, 'f', 1);
  if (now.framesPerSecond) {
    parts << RigLink::tr("%1 frames/s").arg(*now.framesPerSecond, 0, 'g', 4);
  }
  if (now.region) {
    parts << RigLink::tr("%1 x %2 pixels").arg(now.region->width).arg(now.region->height);
  }
  return parts.join(RigLink::tr(", "));
}

void overlay(CameraSettings& onto, const CameraSettings& wish) {
  if (wish.format) onto.format = wish.format;
  if (wish.region) onto.region = wish.region;
  if (wish.exposureSeconds) onto.exposureSeconds = wish.exposureSeconds;
  if (wish.gainDb) onto.gainDb = wish.gainDb;
  if (wish.framesPerSecond) onto.framesPerSecond = wish.framesPerSecond;
}

}  // namespace

// The thread that touches cameras, in the order it is asked to. Its members are its thread's alone.
class RigLink::Worker {
 public:
  Worker(RigLink& link, std::shared_ptr<LiveView> sceneView, std::shared_ptr<LiveView> sourceView)
      : link_(link),
        sceneView_(std::move(sceneView)),
        sourceView_(std::move(sourceView)),
        thread_([this](const std::stop_token& stop) { run(stop); }) {}
  ~Worker() { stop(); }

  // The link is touched no more once it returns; what is posted later is not done.
  void stop() {
    thread_.request_stop();
    if (thread_.joinable()) thread_.join();
  }

  void post(std::function<void(Worker&)> work) {
    {
      const std::lock_guard lock(mutex_);
      if (ended_) return;
      work_.push_back(std::move(work));
    }
    changed_.notify_one();
  }

  // For other threads: waits until all that was asked before is done, closing the preview above
  // all, and the rig runs.
  Result<void> waitForRig(const RigSetup& setup) {
    auto promise = std::make_shared<std::promise<Result<void>>>();
    auto ready = promise->get_future();
    post([setup, promise = std::move(promise)](Worker& worker) {
      promise->set_value(worker.ensureRig(setup));
    });
    try {
      return ready.get();
    } catch (const std::future_error&) {
      return failure(ErrorCode::kCancelled, "the program is being closed");
    }
  }

  // On the worker's thread.
  Result<void> ensureRig(const RigSetup& setup) {
    if (!setup.simulated || rig_) return {};
    ASSIGN_OR_RETURN(rig_, SimulatedRig::start(setup.rig));
    const auto folder = calibrationFolder();
    std::error_code error;
    std::filesystem::create_directories(folder, error);
    RETURN_IF_ERROR(saveCameraModel(*rig_->calibratedSourceModel(), folder / "source.json"));
    return saveRigGeometry(rig_->geometry(), folder / "rig.json");
  }
  void dropRig() { rig_.reset(); }

  // What the two cameras, scene and source, really use.
  Result<std::pair<CameraSettings, CameraSettings>> open(const RigSetup& setup) {
    close();
    RETURN_IF_ERROR(ensureRig(setup));
    auto scene = openOne(link_.sceneAddress(setup), setup.scene, false, sceneView_, scene_);
    if (!scene) return tl::unexpected<Error>(scene.error());
    auto source = openOne(link_.sourceAddress(setup), setup.source, true, sourceView_, source_);
    if (!source) {
      close();
      return tl::unexpected<Error>(source.error());
    }
    return std::pair(*scene, *source);
  }
  void close() {
    for (auto* camera : {&scene_, &source_}) {
      if (*camera) (*camera)->stop();
      camera->reset();
    }
    publishStatistics();
    sceneView_->clear();
    sourceView_->clear();
  }

  // Nothing while it is closed. Format, region and rate cannot change while it streams.
  std::optional<Result<CameraSettings>> configure(bool scene, const CameraSettings& settings) {
    Camera* camera = scene ? scene_.get() : source_.get();
    if (!camera) return std::nullopt;
    if (!settings.format && !settings.region && !settings.framesPerSecond) {
      return camera->configure(settings);
    }
    camera->stop();
    const auto now = camera->configure(settings);
    if (const auto started = start(*camera); !started)
      return tl::unexpected<Error>(started.error());
    return now;
  }

  std::pair<StreamStatistics, StreamStatistics> statistics() const {
    const std::lock_guard lock(statisticsMutex_);
    return statistics_;
  }
  void publishStatistics() {
    const std::lock_guard lock(statisticsMutex_);
    statistics_ = {scene_ ? scene_->statistics() : StreamStatistics{},
                   source_ ? source_->statistics() : StreamStatistics{}};
  }

  static std::filesystem::path calibrationFolder() {
    return std::filesystem::path(
               QStandardPaths::writableLocation(QStandardPaths::AppDataLocation).toStdString()) /
           "simulated-rig";
  }

 private:
  Result<CameraSettings> openOne(const std::string& address, const CameraSettings& settings,
                                 bool grey, const std::shared_ptr<LiveView>& view,
                                 std::unique_ptr<Camera>& into) {
    if (address.empty()) {
      return failure(ErrorCode::kInvalidArgument,
                     "choose both cameras on the Rig page, or use the simulated rig");
    }
    ASSIGN_OR_RETURN(auto camera, openCamera(address));
    ASSIGN_OR_RETURN(const CameraSettings now, configureNearest(*camera, settings, grey));
    into = tapped(std::move(camera), view);
    RETURN_IF_ERROR(start(*into));
    return now;
  }

  Result<void> start(Camera& camera) {
    return camera.start([](Frame&&) {},
                        [link = &link_](const Error& error) {
                          QMetaObject::invokeMethod(link, [link, text = error.message] {
                            if (link->state_ == State::kLive) {
                              link->apply(State::kFailed, QString::fromStdString(text));
                            }
                          });
                        });
  }

  void run(const std::stop_token& stop) {
    while (true) {
      std::function<void(Worker&)> next;
      {
        std::unique_lock lock(mutex_);
        changed_.wait_for(lock, stop, std::chrono::milliseconds(250),
                          [&] { return !work_.empty(); });
        if (stop.stop_requested()) break;
        if (!work_.empty()) {
          next = std::move(work_.front());
          work_.pop_front();
        }
      }
      if (next) next(*this);
      publishStatistics();
    }
    close();
    rig_.reset();
    const std::lock_guard lock(mutex_);
    ended_ = true;
    work_.clear();
  }

  RigLink& link_;
  const std::shared_ptr<LiveView> sceneView_;
  const std::shared_ptr<LiveView> sourceView_;
  std::unique_ptr<SimulatedRig> rig_;
  std::unique_ptr<Camera> scene_;
  std::unique_ptr<Camera> source_;
  mutable std::mutex statisticsMutex_;  // Guards statistics_.
  std::pair<StreamStatistics, StreamStatistics> statistics_;
  std::mutex mutex_;  // Guards work_ and ended_.
  std::condition_variable_any changed_;
  std::deque<std::function<void(Worker&)>> work_;
  bool ended_ = false;
  std::jthread thread_;  // last: it uses all of the above
};

RigLink::RigLink(QObject* parent)
    : QObject(parent),
      sceneView_(std::make_shared<LiveView>()),
      sourceView_(std::make_shared<LiveView>()),
      worker_(std::make_shared<Worker>(*this, sceneView_, sourceView_)) {}

RigLink::~RigLink() { worker_->stop(); }

void RigLink::search() {
  worker_->post([this](Worker&) {
    auto cameras = listCameras().value_or(std::vector<CameraInfo>());
    QMetaObject::invokeMethod(this, [this, cameras = std::move(cameras)] {
      cameras_ = cameras;
      Q_EMIT found();
    });
  });
}

void RigLink::setSetup(const RigSetup& setup) {
  setup_ = setup;
  Q_EMIT setupChanged();
  worker_->post([](Worker& worker) {
    worker.close();
    worker.dropRig();
  });
  if (state_ == State::kLent) return;
  apply(State::kClosed, {});
  if (watchers_ > 0) reopen();
}

void RigLink::watch(bool on) {
  watchers_ += on ? 1 : -1;
  if (on && state_ == State::kClosed) reopen();
  if (on || watchers_ > 0) return;
  QTimer::singleShot(kCloseAfterMilliseconds, this, [this] {
    if (watchers_ > 0 || state_ == State::kLent) return;
    worker_->post([](Worker& worker) { worker.close(); });
    apply(State::kClosed, {});
  });
}

void RigLink::reopen() {
  if (state_ == State::kLent || state_ == State::kOpening) return;
  apply(State::kOpening, {});
  worker_->post([this, setup = setup_, attempt = ++attempt_](Worker& worker) {
    const auto opened = worker.open(setup);
    QMetaObject::invokeMethod(this, [this, opened, attempt] {
      if (state_ != State::kOpening || attempt != attempt_) return;
      if (opened) {
        apply(State::kLive, {});
        tell(true, opened->first);
        tell(false, opened->second);
      } else {
        apply(State::kFailed, QString::fromStdString(opened.error().message));
      }
    });
  });
}

void RigLink::setCalibration(const CalibrationFiles& files) {
  static_cast<CalibrationFiles&>(setup_) = files;
  Q_EMIT setupChanged();
}

void RigLink::configure(bool scene, const CameraSettings& settings) {
  worker_->post([this, scene, settings](Worker& worker) {
    const auto now = worker.configure(scene, settings);
    QMetaObject::invokeMethod(this, [this, scene, settings, now] {
      if (!now || *now) {
        overlay(scene ? setup_.scene : setup_.source, settings);
        Q_EMIT setupChanged();
      }
      if (now) tell(scene, *now);
    });
  });
}

void RigLink::tell(bool scene, const Result<CameraSettings>& now) {
  if (now) (scene ? sceneSettings_ : sourceSettings_) = *now;
  Q_EMIT configured(scene, now ? describe(*now) : QString::fromStdString(now.error().message),
                    now.has_value());
}

void RigLink::configureScene(const CameraSettings& settings) { configure(true, settings); }
void RigLink::configureSource(const CameraSettings& settings) { configure(false, settings); }

StreamStatistics RigLink::sceneStatistics() const { return worker_->statistics().first; }
StreamStatistics RigLink::sourceStatistics() const { return worker_->statistics().second; }

void RigLink::lend() {
  if (state_ == State::kLent) throw std::logic_error("RigLink::lend: lent already");
  apply(State::kLent, {});
  worker_->post([](Worker& worker) { worker.close(); });
}

void RigLink::giveBack() {
  if (state_ != State::kLent) throw std::logic_error("RigLink::giveBack: not lent");
  sceneView_->clear();
  sourceView_->clear();
  apply(State::kClosed, {});
  if (watchers_ > 0) reopen();
}

// A job that is not waited for may still be in it when this link is gone.
CameraOpener RigLink::opener() {
  return [worker = worker_, setup = setup_, scene = sceneView_,
          source = sourceView_](const std::string& address) -> Result<std::unique_ptr<Camera>> {
    RETURN_IF_ERROR(worker->waitForRig(setup));
    ASSIGN_OR_RETURN(auto camera, openCamera(address));
    if (address == sceneAddress(setup)) return tapped(std::move(camera), scene);
    if (address == sourceAddress(setup)) return tapped(std::move(camera), source);
    return camera;
  };
}

std::string RigLink::sceneAddress(const RigSetup& setup) {
  return setup.simulated ? "aravis:" + setup.rig.sceneAddress : setup.sceneCamera;
}
std::string RigLink::sourceAddress(const RigSetup& setup) {
  return setup.simulated ? "aravis:" + setup.rig.sourceAddress : setup.sourceCamera;
}

std::filesystem::path RigLink::sourceModel() const {
  return setup_.simulated && setup_.sourceModel.empty()
             ? Worker::calibrationFolder() / "source.json"
             : setup_.sourceModel;
}
std::filesystem::path RigLink::rigGeometry() const {
  return setup_.simulated && setup_.rigGeometry.empty() ? Worker::calibrationFolder() / "rig.json"
                                                        : setup_.rigGeometry;
}

RecordJob RigLink::recordJob() {
  RecordJob job;
  job.open = opener();
  job.sceneCamera = sceneAddress(setup_);
  job.sourceCameras = {sourceAddress(setup_)};
  job.cameraModels = {sourceModel()};
  job.rigGeometry = rigGeometry();
  job.sceneResponse = setup_.sceneResponse;
  RecorderOptions& options = job.recorder;
  options.sceneFormat = setup_.scene.format.value_or(options.sceneFormat);
  options.sceneExposureSeconds =
      setup_.scene.exposureSeconds.value_or(options.sceneExposureSeconds);
  options.sceneGainDb = setup_.scene.gainDb.value_or(0);
  options.sourceExposureSeconds =
      setup_.source.exposureSeconds.value_or(options.sourceExposureSeconds);
  options.sourceGainDb = setup_.source.gainDb.value_or(0);
  options.framesPerSecond = setup_.scene.framesPerSecond.value_or(options.framesPerSecond);
  if (setup_.simulated) options.sceneBlackLevel = sceneBlackLevelCounts(options.sceneFormat);
  return job;
}

void RigLink::apply(State state, const QString& trouble) {
  if (state_ == state && trouble_ == trouble) return;
  state_ = state;
  trouble_ = trouble;
  if (state != State::kLive) sceneSettings_ = sourceSettings_ = {};
  Q_EMIT stateChanged();
}

}  // namespace lightsketch
