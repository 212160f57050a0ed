#include "capture/session/recorder.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <condition_variable>
#include <deque>
#include <iterator>
#include <mutex>
#include <thread>

#include "capture/frame/file.h"
#include "capture/session/bounded_queue.h"
#include "capture/session/guide.h"
#include "capture/session/pairing.h"
#include "pipeline/hdr/linearise.h"
#include "pipeline/hdr/merge.h"
#include "pipeline/sketch/image_file.h"

namespace lightsketch {

using Eigen::Vector3d;

struct RecorderControl::State {
  struct Wish {
    std::optional<std::pair<Vector3d, Angle>> region;  // to drop; none: undo
    std::string reason;
  };
  std::mutex mutex;  // Guards paused and wishes.
  bool paused = false;
  std::deque<Wish> wishes;

  // What a recording that goes on with other cameras takes over; only record() touches it.
  struct Done {
    std::vector<int> ids;
    bool dropped;  // else kept
  };
  std::vector<Done> history;          // the latest last
  std::optional<int> firstId;         // of the recording's frames
  std::optional<TimePoint> timeZero;  // of its midExposureSeconds
  bool learnt = false;                // the ambient light and the lights of the room
  RadianceImage ambient;
  std::vector<LampTracker> trackers;
};

namespace {

// What a busy machine or disk may take from us before a frame is let go.
constexpr double kQueueSeconds = 1;
constexpr std::size_t kFewestQueued = 8;
constexpr double kWriteQueueBytes = 256e6;               // frames in linear radiance are large
constexpr std::chrono::milliseconds kTick{100};          // between reports when no frame comes
constexpr std::chrono::milliseconds kBetweenLooks{500};  // at the links
constexpr double kSilenceSeconds = 5;     // a camera that sends nothing for so long is lost
constexpr double kPatienceSeconds = 0.2;  // for a late source frame, beyond the pairing limit
constexpr double kSettleSeconds = 0.7;    // from the wish for darkness to darkness, with a guide
constexpr double kDarkestSlack = 0.07;  // relative brightness at which frames count as equally dark
constexpr double kDarkestNoise = 5e-4;  // the same of full scale, for a dark room
constexpr double kAmbientGivesUpSeconds = 15;
// A source frame up to so much later than the scene frame is exposed together with it; earlier, the
// next one would have to be waited for. A lamp at 28 degrees a second moves 0.08 meanwhile.
constexpr double kAlignedSeconds = 0.003;
constexpr int kAlignments = 7;                             // measurements, one more than starts
constexpr double kAlignPatienceSeconds = kSilenceSeconds;  // for the first frames
constexpr std::array<double, 4> kRoomExposures{1.0 / 16, 1, 8, 64};  // of the source exposure
constexpr double kOutOfStepSeconds = 0.01;                           // worth a word

// The ambient light: the mean of the darkest frames. Starts anew when it gets darker, so that
// frames from before the lamp went off do not count.
class AmbientMean {
 public:
  void add(const RadianceImage& frame, double seconds) {
    double mean = 0;
    for (const float value : frame.values()) mean += value;
    mean /= static_cast<double>(frame.size());
    const double slack = count_ == 0 ? 0 : std::max(kDarkestSlack * level(), kDarkestNoise);
    if (count_ > 0 && mean > level() + slack) return;
    if (count_ == 0 || mean < level() - slack) {
      sum_ = RadianceImage(frame.width(), frame.height(), frame.channels());
      levels_ = 0;
      count_ = 0;
      since_ = seconds;
    }
    for (std::size_t i = 0; i < frame.size(); ++i) sum_.data()[i] += frame.data()[i];
    levels_ += mean;
    ++count_;
  }
  bool empty() const { return count_ == 0; }
  // Since when it has been this dark.
  double since() const { return since_; }
  RadianceImage mean() const {
    RadianceImage result = sum_;
    for (float& value : result.values()) value /= static_cast<float>(count_);
    return result;
  }

 private:
  double level() const { return levels_ / count_; }
  RadianceImage sum_;
  double levels_ = 0;
  int count_ = 0;
  double since_ = 0;
};

// Something for the thread that owns the sketch to write.
struct WriteJob {
  std::optional<FrameRecord> record;  // none: the ambient light, or a wish
  RadianceImage radiance;             // empty: still to be made of `raw`
  std::optional<Frame> raw;
  std::optional<RecorderControl::State::Wish> wish;
};

// The counts as they came, a mosaic as grey; two bytes a sample where the format has them.
Result<void> writeRaw(const Frame& frame, const std::filesystem::path& path) {
  const PixelFormatInfo& info = pixelFormatInfo(frame.format);
  if (info.bits <= 8) {
    Image<std::uint8_t> counts(frame.width, frame.height, info.channels);
    std::copy(frame.bytes.begin(), frame.bytes.end(), counts.values().begin());
    return writePng(path, counts);
  }
  Image<std::uint16_t> counts(frame.width, frame.height, info.channels);
  for (int y = 0; y < frame.height; ++y) {
    for (int x = 0; x < frame.width; ++x) {
      counts(x, y) = static_cast<std::uint16_t>(frame.sample(x, y));
    }
  }
  return writePng(path, counts);
}

// One sigma of a direction along its worst axis.
Angle worstSigma(const Eigen::Matrix3d& covariance) {
  const double worst = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(covariance).eigenvalues()[2];
  return Angle::radians(std::sqrt(std::max(worst, 0.0)));
}

// Stops the camera on every way out.
struct Streaming {
  explicit Streaming(Camera* streaming) : camera(streaming) {}
  Camera* camera;
  ~Streaming() { camera->stop(); }
};

Result<void> validate(const RecorderOptions& o) {
  const auto positive = [](double value, const char* name) -> Result<void> {
    if (value > 0) return {};
    return failure(ErrorCode::kInvalidArgument, "{} must be above 0, not {}", name, value);
  };
  RETURN_IF_ERROR(positive(o.sceneExposureSeconds, "the scene exposure"));
  RETURN_IF_ERROR(positive(o.sourceExposureSeconds, "the source exposure"));
  RETURN_IF_ERROR(positive(o.framesPerSecond, "the frame rate"));
  RETURN_IF_ERROR(positive(o.maxPairingSeconds, "the pairing limit"));
  RETURN_IF_ERROR(positive(o.maxLampMotion.radians(), "the lamp's motion limit"));
  if (o.timeLimitSeconds) RETURN_IF_ERROR(positive(*o.timeLimitSeconds, "the time limit"));
  if (!o.bracket.empty() && o.keepRaw) {
    return failure(ErrorCode::kInvalidArgument,
                   "a bracket is merged to one frame; it has no raw frame to keep");
  }
  for (const double factor : o.bracket) {
    RETURN_IF_ERROR(positive(factor, "an exposure of the bracket"));
    if (factor * o.sceneExposureSeconds > 0.95 / o.framesPerSecond) {
      return failure(ErrorCode::kInvalidArgument,
                     "the bracket's exposure of {:.3g} s does not fit into the frame interval; use "
                     "a shorter --exposure or a lower --rate",
                     factor * o.sceneExposureSeconds);
    }
  }
  if (!(o.coverageGoal > 0 && o.coverageGoal <= 1)) {
    return failure(ErrorCode::kInvalidArgument, "the coverage goal must be above 0 and at most 1");
  }
  if (!(o.ambientSeconds >= 0)) {
    return failure(ErrorCode::kInvalidArgument, "the ambient time must not be negative");
  }
  return {};
}

Result<LightGrid> gridFor(const RecorderOptions& o) {
  return LightGrid::create(
      o.directions, o.fullSphere ? LightGrid::Domain::kSphere : LightGrid::Domain::kHemisphere);
}

// Where lampScale is 1.
double referenceDistance(const RigGeometry& rig) { return rig.lampRadiusMetres.value_or(1.0); }

// A lamp above the scene's horizon, seen from a source camera that may stand in front of it, is at
// most this far below the camera's own: everything lower is a reflection off the table.
LampTrackerOptions trackerOptions(const CameraPose& pose, const RigGeometry& rig,
                                  const RecorderOptions& options) {
  LampTrackerOptions tracker;
  tracker.blackLevel = options.sourceBlackLevel;
  if (options.fullSphere || options.posesUnknown) return tracker;
  const Eigen::Isometry3d& sceneFromSource = pose.sceneFromCamera;
  const double ahead = std::max(0.0, sceneFromSource.translation().z());
  const double depression =
      rig.lampRadiusMetres ? std::asin(std::min(1.0, ahead / *rig.lampRadiusMetres)) : 0.0;
  tracker.allowedNormal = sceneFromSource.linear().transpose() * Vector3d::UnitZ();
  tracker.allowedMinimum = -std::sin(Angle::degrees(1).radians() + depression);
  return tracker;
}

std::size_t queuedFrames(const RecorderOptions& options) {
  return std::max(kFewestQueued,
                  static_cast<std::size_t>(std::ceil(kQueueSeconds * options.framesPerSecond)));
}

// At the highest rate at which frames are kept, several seconds of pictures of common sizes.
std::size_t queuedPictures(const SketchManifest& sketch) {
  const double bytes = 3.0 * sizeof(float) * sketch.width * sketch.height;
  return std::clamp(static_cast<std::size_t>(kWriteQueueBytes / bytes), kFewestQueued,
                    std::size_t{64});
}

// One source camera: its frames, what its tracker made of them, and the thread in between.
struct SourceStream {
  SourceStream(const SourceCamera& source, const CameraPose& cameraPose, const RigGeometry& rig,
               const RecorderOptions& options)
      : camera(source.camera),
        name(cameraPose.camera.empty() ? source.camera.info().address : cameraPose.camera),
        calibrationId(checksum(cameraModelToJson(*source.model).dump())),
        model(source.model),
        tracker(source.model, trackerOptions(cameraPose, rig, options)),
        queue(queuedFrames(options)) {}

  Camera& camera;
  const std::string name;
  const std::string calibrationId;
  const std::shared_ptr<const CameraModel> model;
  LampTracker tracker;  // its thread's
  BoundedQueue<Frame> queue;
  ObservationHistory history;
  std::atomic<Clock::rep> last{Clock::now().time_since_epoch().count()};
  std::atomic<Clock::rep> lastExposed{0};  // middle of the last frame's exposure; 0: none yet
  TimePoint started;                       // when its camera was told to
  std::mutex mutex;                        // Guards collecting and collected.
  double collecting = 0;                   // frames exposed for so many seconds are kept; 0: none
  std::vector<Frame> collected;
  std::jthread thread;
};

// What one recording is made of. record() builds it, starts its threads and ends them.
class Recording {
 public:
  Recording(Camera& sceneCamera, std::span<const SourceCamera> sources, const RigGeometry& rig,
            const RecorderOptions& options, Progress& progress,
            std::function<void(const RecorderState&)> onState, RecorderControl::State& control,
            Sketch sketch, Coverage coverage, const CameraSettings& sceneSettings)
      : sceneCamera_(sceneCamera),
        rig_(rig),
        options_(options),
        progress_(progress),
        onState_(std::move(onState)),
        control_(control),
        sketch_(std::move(sketch)),
        coverage_(std::move(coverage)),
        plan_(!options.bracket.empty()),
        wanted_(static_cast<int>(
            std::ceil(options.coverageGoal * static_cast<double>(coverage_.grid().size()) - 1e-9))),
        guide_(sources.front().camera, [&progress](const Error& error) {
          progress.warn("cannot show where to go: " + error.message);
        }) {
    for (std::size_t i = 0; i < sources.size(); ++i) {
      sources_.push_back(
          std::make_unique<SourceStream>(sources[i], rig.sourceCameras[i], rig, options));
    }
    linearise_.sensor = options.sceneSensor;
    linearise_.blackLevel = options.sceneBlackLevel;
    linearise_.referenceExposureSeconds = sceneSettings.exposureSeconds.value_or(0);
    linearise_.referenceGainDb = sceneSettings.gainDb.value_or(0);
    if (sceneSettings.region) {
      width_ = sceneSettings.region->width;
      height_ = sceneSettings.region->height;
    }
    for (const int id : sketch_.activeFrames()) {
      secondsBefore_ = std::max(secondsBefore_,
                                sketch_.frames()[static_cast<std::size_t>(id)].midExposureSeconds);
      ++summary_.resumedFrom;
    }
    exposing_ = options.sceneExposureSeconds;
    onDisk_.resize(static_cast<std::size_t>(coverage_.grid().size()));
    for (const int id : sketch_.activeFrames()) countOnDisk(id, 1);
    if (!control_.firstId) control_.firstId = static_cast<int>(sketch_.frames().size());
    ambientPhase_ = options.ambientSeconds > 0 && !control_.learnt;
    if (control_.trackers.size() == sources_.size()) {
      for (std::size_t i = 0; i < sources_.size(); ++i) {
        sources_[i]->tracker = std::move(control_.trackers[i]);
      }
    }
    control_.trackers.clear();
    state_.grid = std::make_shared<std::vector<Vector3d>>(coverage_.grid().directions());
  }

  // Takes reference exposure and ambient light over from a sketch that is gone on with.
  Result<void> resume() {
    const Json& provenance = sketch_.manifest().provenance;
    const std::string where = (sketch_.folder() / "sketch.json").string();
    ASSIGN_OR_RETURN(linearise_.referenceExposureSeconds,
                     jsonNumber(provenance, "referenceExposureSeconds", where));
    ASSIGN_OR_RETURN(linearise_.referenceGainDb, jsonNumber(provenance, "referenceGainDb", where));
    ASSIGN_OR_RETURN(auto ambient, sketch_.readAmbient());
    haveAmbientFile_ = ambient.has_value();
    if (sketch_.manifest().ambientSubtracted) {
      if (!ambient && !ambientPhase_) {
        return failure(ErrorCode::kInvalidArgument,
                       "{}: its frames are without ambient light, but none was recorded yet; allow "
                       "an ambient time",
                       sketch_.folder().string());
      }
      if (ambient && !control_.learnt) ambient_ = *ambient;
    }
    if (control_.learnt) ambient_ = control_.ambient;
    return {};
  }

  Result<RecorderSummary> run(std::stop_token stop);

 private:
  struct Lit {
    LightDirection light;
    std::vector<SeenLamp> seen;      // by which source cameras, at the frame's time
    std::vector<PairedLamp> paired;  // the same
    Angle motion;
  };

  // Ends the recording; the first reason counts.
  void end(std::string why, bool drain) {
    {
      const std::lock_guard lock(mutex_);
      if (!ended_.empty()) return;
      ended_ = std::move(why);
      drain_ = drain;
    }
    changed_.notify_all();
  }
  void fail(Error error) {
    {
      const std::lock_guard lock(mutex_);
      if (!error_) error_ = std::move(error);
    }
    changed_.notify_all();
  }
  void cameraEnded(const char* which, const Error& error) {
    if (error.code == ErrorCode::kCancelled) {
      end(fmt::format("the {} camera's recording ended", which), true);
    } else {
      lost_ = true;
      end(fmt::format("the {} camera was lost: {}", which, error.message), true);
    }
  }
  void enqueue(BoundedQueue<Frame>& queue, std::atomic<Clock::rep>& last,
               std::atomic<Clock::rep>& lastExposed, Frame&& frame) {
    last = Clock::now().time_since_epoch().count();
    lastExposed = frame.metadata.midExposure.time_since_epoch().count();
    queue.push(std::move(frame));
  }
  Result<void> startSource(SourceStream& source);
  Result<void> alignPhases(const std::stop_token& stop);
  Result<void> measureRooms(const std::stop_token& stop);
  bool silent(const std::atomic<Clock::rep>& last) const {
    const double limit = kSilenceSeconds + 10 * options_.sceneExposureSeconds;
    return toSeconds(Clock::now() - TimePoint(TimePoint::duration(last.load()))) > limit;
  }

  void trackSource(SourceStream& source);
  void judgeScene();
  void writeSketch();

  Result<void> takeAmbient(const Frame& frame);
  void waitForSource(SourceStream& source, const FrameMetadata& scene);
  tl::expected<Lit, Refusal> lightOn(const Frame& frame);
  Result<Refusal> judge(const Frame& frame);
  Result<bool> goOnWithBracket(const Frame& frame, const Lit& lit);
  Result<void> endBracket();
  Result<void> expose(double seconds);
  void guideOn(double seconds);
  void tick();
  void report();
  void lookAtLinks();
  std::uint64_t dropped() const;
  void passWishesOn();
  void followTheSketch();
  Result<void> fulfil(const RecorderControl::State::Wish& wish);
  Result<void> dropOrRestore(std::span<const int> ids, bool drop, const std::string& reason);
  void countOnDisk(int id, int change);
  RecorderSummary summarise();

  Camera& sceneCamera_;
  std::vector<std::unique_ptr<SourceStream>> sources_;
  const RigGeometry& rig_;
  const RecorderOptions& options_;
  Progress& progress_;
  const std::function<void(const RecorderState&)> onState_;
  RecorderControl::State& control_;

  // The writer's while threads run.
  Sketch sketch_;
  std::vector<int> onDisk_;  // frames per cell
  // Nobody's to change: the options since the start, the ambient light since the first frame after
  // its phase was judged.
  LineariseOptions linearise_;
  RadianceImage ambient_;  // to subtract; empty: nothing
  // The judge's while threads run.
  Coverage coverage_;
  GuidePlan plan_;
  AmbientMean ambientMean_;
  bool haveAmbientFile_ = false;
  std::optional<TimePoint> firstFrame_;
  RecorderState state_;
  std::optional<Vector3d> judgedDirection_;  // of the frame that is being judged
  RecorderSummary summary_;
  int width_ = 0;
  int height_ = 0;
  std::optional<double> lampDistance_;  // as triangulated last, metres
  std::vector<Frame> bracket_;          // so far
  Vector3d bracketDirection_ = Vector3d::UnitZ();
  double exposing_ = 0;  // seconds that the scene camera is set to

  const int wanted_;
  double secondsBefore_ = 0;  // a resumed recording's clock goes on from here
  const TimePoint start_ = Clock::now();
  std::atomic<bool> ambientPhase_ = false;
  std::atomic<bool> lost_ = false;
  std::atomic<int> durable_ = 0;       // directions on disk
  std::atomic<int> written_ = 0;       // frames on disk
  std::atomic<bool> aligning_ = true;  // frames do not count yet
  std::atomic<Clock::rep> lastSceneExposed_{0};
  std::atomic<Clock::rep> lastScene_{Clock::now().time_since_epoch().count()};
  BoundedQueue<Frame> sceneQueue_{queuedFrames(options_)};
  BoundedQueue<WriteJob> writeQueue_{queuedPictures(sketch_.manifest())};

  std::mutex mutex_;  // Guards everything below but guide_.
  std::condition_variable changed_;
  std::string ended_;
  bool drain_ = false;
  std::optional<Error> error_;
  // What became of frames that were written before: their light, and whether they were dropped.
  std::vector<std::pair<Vector3d, bool>> changes_;
  StreamStatistics sceneLink_;
  std::vector<StreamStatistics> sourceLinks_;

  GuideWriter guide_;
};

void Recording::trackSource(SourceStream& source) {
  while (auto frame = source.queue.pop()) {
    if (aligning_) continue;
    // The last of the room's exposures.
    if (!options_.bracket.empty() &&
        frame->metadata.exposureSeconds > 1.5 * options_.sourceExposureSeconds) {
      continue;
    }
    if (ambientPhase_) {
      if (auto status = source.tracker.learnBackground(*frame); !status) {
        return fail(status.error());
      }
      source.history.add(frame->metadata.midExposure, {});
      continue;
    }
    auto result = source.tracker.track(*frame);
    if (!result) return fail(result.error());
    source.history.add(frame->metadata.midExposure, std::move(*result));
  }
  source.history.end();
}

void Recording::countOnDisk(int id, int change) {
  if (options_.posesUnknown) return;
  const FrameRecord& frame = sketch_.frames()[static_cast<std::size_t>(id)];
  const auto cell = coverage_.cellOf(frame.light.direction);
  if (!cell) return;
  int& frames = onDisk_[static_cast<std::size_t>(*cell)];
  const bool before = frames > 0;
  frames += change;
  durable_ += (frames > 0) - before;
}

Result<void> Recording::dropOrRestore(std::span<const int> ids, bool drop,
                                      const std::string& reason) {
  int own = 0;
  std::vector<std::pair<Vector3d, bool>> changes;
  for (const int id : ids) {
    RETURN_IF_ERROR(drop ? sketch_.drop(id, reason) : sketch_.restore(id));
    countOnDisk(id, drop ? -1 : 1);
    own += id >= *control_.firstId;
    changes.emplace_back(sketch_.frames()[static_cast<std::size_t>(id)].light.direction, drop);
  }
  written_ += drop ? -own : own;
  const std::lock_guard lock(mutex_);
  changes_.insert(changes_.end(), changes.begin(), changes.end());
  return {};
}

Result<void> Recording::fulfil(const RecorderControl::State::Wish& wish) {
  if (!wish.region) {
    if (control_.history.empty()) return {};
    const auto last = std::move(control_.history.back());
    control_.history.pop_back();
    return dropOrRestore(last.ids, !last.dropped, "taken back");
  }
  const auto& [centre, radius] = *wish.region;
  std::vector<int> ids = sketch_.activeFrames();
  std::erase_if(ids, [&, &centre = centre, &radius = radius](int id) {
    const Vector3d& d = sketch_.frames()[static_cast<std::size_t>(id)].light.direction;
    return std::atan2(d.cross(centre).norm(), d.dot(centre)) > radius.radians();
  });
  RETURN_IF_ERROR(dropOrRestore(ids, true, wish.reason));
  if (!ids.empty()) control_.history.push_back({std::move(ids), true});
  return {};
}

void Recording::writeSketch() {
  while (auto job = writeQueue_.pop()) {
    if (job->wish) {
      if (auto status = fulfil(*job->wish); !status) return fail(status.error());
      continue;
    }
    if (!job->record) {
      if (auto status = sketch_.writeAmbient(job->radiance); !status) return fail(status.error());
      continue;
    }
    if (job->radiance.empty()) {
      auto linear = linearise(*job->raw, linearise_);
      if (!linear) return fail(linear.error());
      job->radiance = std::move(linear->radiance);
    }
    for (std::size_t i = 0; i < ambient_.size(); ++i) {
      job->radiance.data()[i] -= ambient_.data()[i];
    }
    // Before the journal says that the frame is there.
    if (options_.keepRaw) {
      const auto path =
          sketch_.folder() / "frames" / fmt::format("{:06}.raw.png", sketch_.frames().size());
      if (auto status = writeRaw(*job->raw, path); !status) return fail(status.error());
    }
    auto id = sketch_.append(std::move(*job->record), job->radiance);
    if (!id) return fail(id.error());
    ++written_;
    countOnDisk(*id, 1);
    control_.history.push_back({{*id}, false});
  }
}

// What the person wanted goes the way of the frames that were kept before.
void Recording::passWishesOn() {
  std::deque<RecorderControl::State::Wish> wishes;
  {
    const std::lock_guard lock(control_.mutex);
    state_.paused = control_.paused;
    wishes.swap(control_.wishes);
  }
  for (auto& wish : wishes) writeQueue_.pushAnyway({{}, {}, {}, std::move(wish)});
}

void Recording::followTheSketch() {
  std::vector<std::pair<Vector3d, bool>> changes;
  {
    const std::lock_guard lock(mutex_);
    changes.swap(changes_);
  }
  for (const auto& [direction, dropped] : changes) {
    dropped ? coverage_.remove(direction) : coverage_.add(direction);
  }
}

// Between frames, and every 100 ms where none comes.
void Recording::tick() {
  passWishesOn();
  followTheSketch();
  state_.judged.reset();
}

void Recording::judgeScene() {
  while (true) {
    const auto frame = sceneQueue_.popWithin(kTick);
    if (!frame && sceneQueue_.over()) break;
    tick();
    if (!frame || aligning_) {
      report();
      continue;
    }
    const TimePoint time = frame->metadata.midExposure;
    if (!firstFrame_) {
      firstFrame_ = time;
      if (!control_.timeZero) control_.timeZero = time - fromSeconds(secondsBefore_);
    }
    if (width_ != 0 && (frame->width != width_ || frame->height != height_)) {
      return fail({ErrorCode::kDevice,
                   fmt::format("scene frame {}: {} x {} pixels, expected {} x {}",
                               frame->metadata.id, frame->width, frame->height, width_, height_)});
    }
    if (ambientPhase_) {
      if (auto status = state_.paused ? Result<void>() : takeAmbient(*frame); !status) {
        return fail(status.error());
      }
      report();
      continue;
    }
    if (!state_.paused) {
      const auto refusal = judge(*frame);
      if (!refusal) return fail(refusal.error());
      ++summary_.offered;
      if (*refusal != Refusal::kNone) ++summary_.refusals[*refusal];
      state_.lastRefusal = *refusal;
      state_.judged = {*refusal, judgedDirection_, frame->metadata.arrival, Clock::now()};
    }
    guideOn(toSeconds(time - *firstFrame_));
    report();
    if (coverage_.capturedCount() >= wanted_) {
      end("coverage goal reached", false);
      return;
    }
  }
}

Result<void> Recording::takeAmbient(const Frame& frame) {
  const double seconds = toSeconds(frame.metadata.midExposure - *firstFrame_);
  const double settle = guide_.supported() ? kSettleSeconds : 0;
  state_.lampWantedOff = true;
  guide_.show(GuideWriter::Mode::kLampOff);
  if (seconds < settle) return {};
  ASSIGN_OR_RETURN(auto linear, linearise(frame, linearise_));
  ambientMean_.add(linear.radiance, seconds);
  if (seconds - ambientMean_.since() < options_.ambientSeconds &&
      seconds < kAmbientGivesUpSeconds + options_.ambientSeconds) {
    return {};
  }
  if (seconds - ambientMean_.since() < options_.ambientSeconds) {
    progress_.warn(
        "the scene kept getting darker while the ambient light was measured; if frames look too "
        "dark, "
        "record again with the lamp off at the start");
  }
  if (sketch_.manifest().ambientSubtracted) ambient_ = ambientMean_.mean();
  // One that is there already belongs to the frames of before.
  if (!haveAmbientFile_) writeQueue_.pushAnyway({{}, ambientMean_.mean(), {}, {}});
  ambientMean_ = {};
  control_.ambient = ambient_;
  control_.learnt = true;
  state_.lampWantedOff = false;
  ambientPhase_ = false;
  guideOn(seconds);
  return {};
}

// Until the source frame after the scene frame is tracked. It is on its way when the scene frame is
// here, so that a camera that has fallen silent costs each frame its patience only once.
void Recording::waitForSource(SourceStream& source, const FrameMetadata& scene) {
  const TimePoint from = sceneCamera_.isLive() ? scene.arrival : Clock::now();
  const TimePoint until = from + fromSeconds(options_.maxPairingSeconds + kPatienceSeconds);
  while (!source.history.waitFor(scene.midExposure,
                                 std::clamp<Duration>(until - Clock::now(), Duration(0), kTick))) {
    if (Clock::now() >= until) return;
    tick();
    report();
  }
}

// The light at the scene frame's time, from every source camera that saw the lamp.
tl::expected<Recording::Lit, Refusal> Recording::lightOn(const Frame& frame) {
  const FrameMetadata& metadata = frame.metadata;
  Lit lit;
  Refusal refusal = Refusal::kUnpaired;  // the one that got furthest
  for (std::size_t i = 0; i < sources_.size(); ++i) {
    ObservationHistory& history = sources_[i]->history;
    waitForSource(*sources_[i], metadata);
    auto paired =
        history.at(metadata.midExposure, metadata.timeUncertainty, options_.maxPairingSeconds);
    if (!paired) {
      if (paired.error() == PairingFailure::kLampNotSeen && refusal == Refusal::kUnpaired) {
        refusal = Refusal::kLampNotSeen;
      }
      continue;
    }
    if (paired->lamp.beyondCalibration) {
      refusal = Refusal::kBeyondCalibration;
      continue;
    }
    state_.pairingErrorSeconds = std::min(paired->secondsToBefore, paired->secondsToAfter);
    lit.motion =
        std::max(lit.motion, Angle::radians(paired->radiansPerSecond * metadata.exposureSeconds));
    lit.seen.push_back({i, paired->lamp});
    lit.paired.push_back(std::move(*paired));
  }
  if (lit.seen.empty()) return tl::unexpected(refusal);
  const std::span<const SeenLamp> used(lit.seen);
  auto light = lightAtSubject(options_.posesUnknown ? used.first(1) : used, rig_);
  if (light) judgedDirection_ = light->direction;
  if (lit.motion > options_.maxLampMotion) return tl::unexpected(Refusal::kLampTooFast);
  if (!light) return tl::unexpected(Refusal::kUncertain);
  // Of several cameras one sees the lamp: its distance is only known if somebody said it.
  if (sources_.size() > 1 && used.size() == 1 && !options_.posesUnknown && !light->position) {
    return tl::unexpected(Refusal::kUncertain);
  }
  lit.light = std::move(*light);
  if (!(worstSigma(lit.light.covariance) <= options_.maxDirectionSigma)) {
    return tl::unexpected(Refusal::kUncertain);
  }
  return lit;
}

Result<Refusal> Recording::judge(const Frame& frame) {
  const FrameMetadata& metadata = frame.metadata;
  judgedDirection_.reset();
  const auto lit = lightOn(frame);
  if (!lit) {
    RETURN_IF_ERROR(endBracket());
    return lit.error();
  }
  const LightDirection& light = lit->light;
  if (lit->seen.size() > 1 && light.position) lampDistance_ = light.position->norm();
  const auto cell = coverage_.cellOf(light.direction);
  if (!options_.posesUnknown && (!cell || coverage_.captured(*cell))) {
    RETURN_IF_ERROR(endBracket());
    return cell ? Refusal::kNotNew : Refusal::kOutsideGrid;
  }

  // Only now does the frame cost something: demosaicing takes ten times as long as all of the
  // above, so that the writer does it, once the frame is accepted.
  LinearFrame linear;
  if (options_.bracket.empty()) {
    ASSIGN_OR_RETURN(linear.saturatedFraction, saturatedFraction(frame, linearise_));
  } else {
    ASSIGN_OR_RETURN(const bool whole, goOnWithBracket(frame, *lit));
    if (!whole) return Refusal::kBracketing;
    MergeOptions merge;
    merge.sensor = options_.sceneSensor;
    merge.blackLevel = options_.sceneBlackLevel;
    merge.referenceExposureSeconds = linearise_.referenceExposureSeconds;
    merge.referenceGainDb = linearise_.referenceGainDb;
    ASSIGN_OR_RETURN(linear, mergeBracketFrames(bracket_, merge));
    RETURN_IF_ERROR(endBracket());
  }
  if (linear.saturatedFraction > options_.maxSaturatedFraction) return Refusal::kSaturated;

  FrameRecord record;
  record.light = light;
  for (std::size_t i = 0; i < lit->seen.size(); ++i) {
    const SeenLamp& seen = lit->seen[i];
    const SourceStream& source = *sources_[seen.camera];
    // So that a later calibration finds all but the lens's own error in the pixel.
    const Vector3d& d = seen.lamp.directionInSource;
    Eigen::Matrix<double, 3, 2> tangent;  // pixelsPerRadian's own axes
    tangent.col(0) = d.unitOrthogonal();
    tangent.col(1) = d.cross(tangent.col(0));
    const Eigen::Matrix<double, 2, 3> scale =
        source.model->pixelsPerRadian(d) * tangent.transpose();
    record.lampPixels.push_back(
        {source.name, seen.lamp.pixel,
         seen.lamp.covariance +
             scale * lit->paired[i].interpolationCovariance * scale.transpose()});
    record.calibrationId += (record.calibrationId.empty() ? "" : "+") + source.calibrationId;
  }
  if (light.position)
    record.lampScale.fill(lampFallOff(light.position->norm(), referenceDistance(rig_)));
  record.exposureSeconds =
      options_.bracket.empty() ? metadata.exposureSeconds : linearise_.referenceExposureSeconds;
  record.gainDb = metadata.gainDb;
  record.midExposureSeconds = toSeconds(metadata.midExposure - *control_.timeZero);
  const PairedLamp& paired = lit->paired.front();
  record.pairingErrorSeconds = std::min(paired.secondsToBefore, paired.secondsToAfter);
  record.saturatedFraction = linear.saturatedFraction;
  record.gates = {{"cell", cell.value_or(-1)},
                  {"lampMotionDegrees", lit->motion.degrees()},
                  {"sourceSecondsBefore", paired.secondsToBefore},
                  {"sourceSecondsAfter", paired.secondsToAfter},
                  {"timeUncertaintySeconds", toSeconds(metadata.timeUncertainty)},
                  {"lampConfidence", paired.lamp.confidence},
                  {"lampFlux", paired.lamp.flux}};
  if (!options_.bracket.empty()) record.gates["bracket"] = options_.bracket;
  // A disk that cannot keep up costs this frame, not the stream; its direction stays open.
  if (writeQueue_.push({std::move(record),
                        std::move(linear.radiance),
                        options_.bracket.empty() ? std::optional(frame) : std::nullopt,
                        {}})) {
    coverage_.add(light.direction);
  }
  return Refusal::kNone;
}

// Adds the frame to the bracket if it has the exposure that is due and the lamp is where it was at
// the bracket's start; begins anew where it is not. True once the bracket is whole.
Result<bool> Recording::goOnWithBracket(const Frame& frame, const Lit& lit) {
  if (!bracket_.empty() && std::acos(std::clamp(lit.light.direction.dot(bracketDirection_), -1.0,
                                                1.0)) > options_.maxLampMotion.radians()) {
    RETURN_IF_ERROR(endBracket());
  }
  const double due = options_.bracket[bracket_.size()] * options_.sceneExposureSeconds;
  if (std::abs(frame.metadata.exposureSeconds / due - 1) < 0.01) {
    if (bracket_.empty()) bracketDirection_ = lit.light.direction;
    bracket_.push_back(frame);
    if (bracket_.size() == options_.bracket.size()) return true;
  }
  RETURN_IF_ERROR(expose(options_.bracket[bracket_.size()] * options_.sceneExposureSeconds));
  return false;
}

// Back to the exposure that the next bracket begins with.
Result<void> Recording::endBracket() {
  if (options_.bracket.empty()) return {};
  bracket_.clear();
  return expose(options_.bracket.front() * options_.sceneExposureSeconds);
}

Result<void> Recording::expose(double seconds) {
  if (seconds == exposing_) return {};
  CameraSettings settings;
  settings.exposureSeconds = seconds;
  ASSIGN_OR_RETURN(const CameraSettings now, sceneCamera_.configure(settings));
  if (now.exposureSeconds && std::abs(*now.exposureSeconds / seconds - 1) > 0.01) {
    return failure(ErrorCode::kDevice, "scene camera {} exposes for {} s where {} s are asked for",
                   sceneCamera_.info().address, *now.exposureSeconds, seconds);
  }
  exposing_ = seconds;
  return {};
}

void Recording::guideOn(double seconds) {
  // One camera's view is enough to lead the person, at the distance that the lamp had last.
  RigGeometry rig = rig_;
  if (lampDistance_) rig.lampRadiusMetres = lampDistance_;
  state_.lampDirection.reset();
  state_.lamp.reset();
  state_.lampTrouble = sources_.front()->history.trouble();
  for (std::size_t i = 0; i < sources_.size() && !state_.lampDirection; ++i) {
    const auto latest = sources_[i]->history.latest();
    if (!latest) continue;
    const auto before = lightAtSubject(std::array{SeenLamp{i, latest->first}}, rig);
    const auto now = lightAtSubject(std::array{SeenLamp{i, latest->second}}, rig);
    if (!before || !now) continue;
    const double dt = toSeconds(latest->second.time - latest->first.time);
    plan_.update(coverage_, seconds, now->direction,
                 (now->direction - before->direction) / std::max(dt, 1e-3));
    state_.lampDirection = now->direction;
    state_.directionSigma = worstSigma(now->covariance);
    state_.lamp = latest->second;
    state_.lampCamera = static_cast<int>(i);
    state_.lampTrouble.clear();
  }
  if (!state_.lampDirection) plan_.updateUnseen(coverage_, seconds);
  for (const int cell : plan_.takeFailed()) coverage_.postpone(cell);
  if (const auto target = plan_.target()) {
    state_.nextDirection = coverage_.grid().directions()[static_cast<std::size_t>(*target)];
    guide_.show(GuideWriter::Mode::kFollow, *state_.nextDirection);
  } else {
    state_.nextDirection.reset();
  }
}

void Recording::report() {
  progress_.update("recording", static_cast<std::size_t>(std::min(durable_.load(), wanted_)),
                   static_cast<std::size_t>(wanted_));
  state_.recorded = written_;
  state_.coverage = static_cast<double>(durable_) / static_cast<double>(coverage_.grid().size());
  if (!onState_) return;
  state_.refusals = summary_.refusals;
  state_.droppedByQueues = dropped();
  std::vector<bool> captured(onDisk_.size());
  for (std::size_t i = 0; i < captured.size(); ++i) {
    captured[i] = coverage_.captured(static_cast<int>(i));
  }
  if (!state_.captured || captured != *state_.captured) {
    state_.captured = std::make_shared<std::vector<bool>>(std::move(captured));
  }
  {
    const std::lock_guard lock(mutex_);
    state_.scene = sceneLink_;
    state_.sources = sourceLinks_;
  }
  onState_(state_);
}

// Asking a camera that is being lost takes long: not on the judge's thread.
void Recording::lookAtLinks() {
  StreamStatistics scene = sceneCamera_.statistics();
  std::vector<StreamStatistics> sources;
  for (const auto& source : sources_) sources.push_back(source->camera.statistics());
  const std::lock_guard lock(mutex_);
  sceneLink_ = std::move(scene);
  sourceLinks_ = std::move(sources);
}

std::uint64_t Recording::dropped() const {
  std::uint64_t count = sceneQueue_.refused() + writeQueue_.refused();
  for (const auto& source : sources_) count += source->queue.refused();
  return count;
}

Result<void> Recording::startSource(SourceStream& source) {
  source.lastExposed = 0;
  source.started = Clock::now();
  return source.camera.start(
      [this, &source](Frame&& frame) {
        {
          const std::lock_guard lock(source.mutex);
          if (std::abs(frame.metadata.exposureSeconds - source.collecting) <
              0.01 * source.collecting) {
            source.collected.push_back(frame);
          }
        }
        enqueue(source.queue, source.last, source.lastExposed, std::move(frame));
      },
      [this](const Error& error) { cameraEnded("source", error); });
}

// Cameras that run freely at one rate keep the phase they were started with. A source frame exposed
// together with the scene frame leaves nothing to interpolate, which a hand's tremor is too fast
// for, and comes as soon as that: so a source camera whose phase is off is started again, as much
// earlier or later.
Result<void> Recording::alignPhases(const std::stop_token& stop) {
  const double period = 1 / options_.framesPerSecond;
  const auto over = [&] {
    const std::lock_guard lock(mutex_);
    return stop.stop_requested() || progress_.cancelled() || error_ || !ended_.empty();
  };
  for (const auto& source : sources_) {
    if (!source->camera.isLive() || !sceneCamera_.isLive()) continue;
    for (int attempt = 0; attempt < kAlignments; ++attempt) {
      const TimePoint patience = Clock::now() + fromSeconds(kAlignPatienceSeconds + 2 * period);
      while ((source->lastExposed == 0 || lastSceneExposed_ == 0) && Clock::now() < patience) {
        if (over()) return {};
        std::this_thread::sleep_for(std::chrono::milliseconds(5));
      }
      // Silence is for run() to notice.
      if (source->lastExposed == 0 || lastSceneExposed_ == 0) return {};
      const Duration late(Duration::rep(source->lastExposed - lastSceneExposed_));
      const double offset = std::remainder(toSeconds(late), period);
      if (offset >= 0 && offset < kAlignedSeconds) break;
      if (attempt + 1 == kAlignments) {
        if (std::abs(offset) > kOutOfStepSeconds) {
          progress_.warn(
              fmt::format("source camera {} is {:.0f} ms out of step with the scene "
                          "camera; a trigger line would bring them together",
                          source->name, 1e3 * offset));
        }
        break;
      }
      source->camera.stop();
      // The same latency as last time brings its frames as much earlier.
      const double since =
          toSeconds(Clock::now() - source->started) + offset - 0.5 * kAlignedSeconds;
      const double wait = std::ceil(since / period) * period - since;
      std::this_thread::sleep_for(fromSeconds(wait));
      RETURN_IF_ERROR(startSource(*source));
    }
  }
  return {};
}

// With a bracket, what each source camera sees at first, lamp and room, as one HDR picture.
Result<void> Recording::measureRooms(const std::stop_token& stop) {
  if (options_.bracket.empty()) return {};
  for (std::size_t i = 0; i < sources_.size(); ++i) {
    SourceStream& source = *sources_[i];
    const auto file = sketch_.folder() / fmt::format("room-{}.exr", i + 1);
    if (!source.camera.isLive() || std::filesystem::exists(file)) continue;
    CameraSettings settings;
    std::vector<Frame> bracket;
    for (const double factor : kRoomExposures) {
      settings.exposureSeconds =
          std::min(factor * options_.sourceExposureSeconds, 0.9 / options_.framesPerSecond);
      ASSIGN_OR_RETURN(const CameraSettings now, source.camera.configure(settings));
      {
        const std::lock_guard lock(source.mutex);
        source.collecting = now.exposureSeconds.value_or(*settings.exposureSeconds);
      }
      const TimePoint patience = Clock::now() + fromSeconds(kAlignPatienceSeconds);
      for (bool enough = false; !enough && Clock::now() < patience;) {
        if (stop.stop_requested() || progress_.cancelled()) break;
        std::this_thread::sleep_for(std::chrono::milliseconds(5));
        const std::lock_guard lock(source.mutex);
        enough = source.collected.size() >= 2;
      }
      const std::lock_guard lock(source.mutex);
      source.collecting = 0;
      std::move(source.collected.begin(), source.collected.end(), std::back_inserter(bracket));
      source.collected.clear();
    }
    settings.exposureSeconds = options_.sourceExposureSeconds;
    RETURN_IF_ERROR(source.camera.configure(settings));
    if (bracket.empty()) continue;  // silence is for run() to notice
    MergeOptions merge;
    merge.blackLevel = options_.sourceBlackLevel;
    merge.referenceExposureSeconds = options_.sourceExposureSeconds;
    ASSIGN_OR_RETURN(const RadianceMap room, mergeExposures(bracket, merge));
    RETURN_IF_ERROR(writeExr(file, room.radiance));
  }
  return {};
}

Result<RecorderSummary> Recording::run(std::stop_token stop) {
  if (coverage_.capturedCount() >= wanted_) {
    ended_ = "nothing to do, the coverage goal was reached before";
    return summarise();
  }
  std::jthread writer([this] { writeSketch(); });
  std::jthread judge([this] { judgeScene(); });
  for (const auto& source : sources_) {
    source->thread = std::jthread([this, &source = *source] { trackSource(source); });
  }
  const auto finish = [&](bool drain) {
    for (const auto& source : sources_) source->queue.close(!drain);
    for (const auto& source : sources_) {
      if (source->thread.joinable()) source->thread.join();
      source->history.end();
    }
    sceneQueue_.close(!drain);
    if (judge.joinable()) judge.join();
    passWishesOn();
    writeQueue_.close();
    if (writer.joinable()) writer.join();
  };

  Result<void> started;
  {
    // Sources first, so that the first scene frames find their partners.
    std::vector<std::unique_ptr<Streaming>> streaming;
    for (const auto& source : sources_) {
      streaming.push_back(std::make_unique<Streaming>(&source->camera));
      started = startSource(*source);
      if (!started) break;
    }
    streaming.push_back(std::make_unique<Streaming>(&sceneCamera_));
    if (started) {
      started = sceneCamera_.start(
          [this](Frame&& frame) {
            enqueue(sceneQueue_, lastScene_, lastSceneExposed_, std::move(frame));
          },
          [this](const Error& error) { cameraEnded("scene", error); });
    }
    if (started) {
      started = alignPhases(stop);
      if (started) started = measureRooms(stop);
      if (!started && started.error().code == ErrorCode::kDevice) {
        cameraEnded("source", started.error());
        started = {};
      }
    }
    TimePoint looked = Clock::now();
    aligning_ = false;
    lastScene_ = Clock::now().time_since_epoch().count();
    for (const auto& source : sources_) source->last = lastScene_.load();
    while (started) {
      std::unique_lock lock(mutex_);
      if (changed_.wait_for(lock, std::chrono::milliseconds(50),
                            [&] { return error_ || !ended_.empty(); })) {
        break;
      }
      lock.unlock();
      if (Clock::now() - looked > kBetweenLooks) {
        looked = Clock::now();
        lookAtLinks();
      }
      if (stop.stop_requested() || progress_.cancelled()) end("stopped", false);
      if (options_.timeLimitSeconds &&
          toSeconds(Clock::now() - start_) > *options_.timeLimitSeconds) {
        end("time limit reached", false);
      }
      const auto silence = [&](const char* which, const Camera& camera) {
        cameraEnded(which,
                    {ErrorCode::kDevice, fmt::format("{} sent no frame for {} s",
                                                     camera.info().address, kSilenceSeconds)});
      };
      if (silent(lastScene_)) silence("scene", sceneCamera_);
      for (const auto& source : sources_) {
        if (silent(source->last)) silence("source", source->camera);
      }
    }
    guide_.stop();
    // Frames that were sent before a camera ended are judged; after any other end nobody waits.
    lookAtLinks();
    summary_.scene = sceneLink_;
    summary_.sources = sourceLinks_;
  }
  bool drain;
  {
    const std::lock_guard lock(mutex_);
    drain = drain_ && !error_;
  }
  finish(drain);
  for (const auto& source : sources_) control_.trackers.push_back(std::move(source->tracker));
  if (!started) return tl::unexpected(started.error());
  if (error_) return tl::unexpected(*error_);
  tick();
  report();
  return summarise();
}

RecorderSummary Recording::summarise() {
  summary_.ended = ended_;
  summary_.cameraLost = lost_;
  summary_.timeZero = control_.timeZero.value_or(start_ - fromSeconds(secondsBefore_));
  summary_.recorded = written_;
  summary_.captured = durable_;
  summary_.directions = coverage_.grid().size();
  summary_.coverage = coverage_.fraction();
  summary_.seconds = toSeconds(Clock::now() - start_);
  summary_.droppedByQueues = dropped();
  return summary_;
}

// The cameras' model beside the frames, under the id that the frames name.
Result<void> keepModel(const std::filesystem::path& sketchFolder, const CameraModel& model) {
  const auto folder = sketchFolder / "calibration";
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) {
    return failure(ErrorCode::kIo, "{}: cannot create: {}", folder.string(), error.message());
  }
  return saveCameraModel(model, folder / (checksum(cameraModelToJson(model).dump()) + ".json"));
}

Result<Sketch> openToGoOn(const std::filesystem::path& folder, const RecorderOptions& options,
                          int width, int height, const RigGeometry& rig) {
  ASSIGN_OR_RETURN(auto sketch, Sketch::openForAppend(folder));
  const SketchManifest& m = sketch.manifest();
  if (m.width != width || m.height != height) {
    return failure(ErrorCode::kInvalidArgument,
                   "{}: holds frames of {} x {}, the scene camera sends {} x {}; record to another "
                   "folder",
                   folder.string(), m.width, m.height, width, height);
  }
  if (m.directions != options.directions || m.fullSphere != options.fullSphere) {
    return failure(
        ErrorCode::kInvalidArgument,
        "{}: was begun with {} directions on the {}, now {} on the {} are asked for; use "
        "the same or another folder",
        folder.string(), m.directions, m.fullSphere ? "sphere" : "hemisphere", options.directions,
        options.fullSphere ? "sphere" : "hemisphere");
  }
  if (sketch.rig() && rigGeometryToJson(*sketch.rig()) != rigGeometryToJson(rig)) {
    return failure(
        ErrorCode::kInvalidArgument,
        "{}: its rig.json places the cameras otherwise than they are placed now; use --rig "
        "{} or record to another folder",
        folder.string(), (folder / "rig.json").string());
  }
  return sketch;
}

Json describe(const char* role, const CameraInfo& info) {
  return {
      {"role", role}, {"address", info.address}, {"model", info.model}, {"serial", info.serial}};
}

}  // namespace

RecorderControl::RecorderControl() : state_(std::make_unique<State>()) {}
RecorderControl::~RecorderControl() = default;

void RecorderControl::pause(bool paused) {
  const std::lock_guard lock(state_->mutex);
  state_->paused = paused;
}

void RecorderControl::undo() {
  const std::lock_guard lock(state_->mutex);
  state_->wishes.push_back({});
}

void RecorderControl::dropRegion(const Vector3d& centre, Angle radius, std::string reason) {
  const std::lock_guard lock(state_->mutex);
  state_->wishes.push_back(
      {std::pair(centre.normalized(), radius), reason.empty() ? "region" : std::move(reason)});
}

std::string describe(Refusal refusal) {
  switch (refusal) {
    case Refusal::kNone:
      return "accepted";
    case Refusal::kLampNotSeen:
      return "lamp not seen";
    case Refusal::kLampTooFast:
      return "lamp too fast";
    case Refusal::kSaturated:
      return "saturated";
    case Refusal::kNotNew:
      return "direction not new";
    case Refusal::kUnpaired:
      return "no source frames at its time";
    case Refusal::kOutsideGrid:
      return "below the wanted directions";
    case Refusal::kBeyondCalibration:
      return "beyond the calibrated field";
    case Refusal::kUncertain:
      return "light's direction too uncertain";
    case Refusal::kBracketing:
      return "part of a bracket";
  }
  return "unknown";
}

std::string RecorderSummary::describe() const {
  std::string text =
      fmt::format("{} frames recorded in {:.0f} s ({}); {} of {} directions captured, {:.1f} %\n",
                  recorded, seconds, ended, captured, directions, 100 * coverage);
  if (reconnections > 0) {
    text += fmt::format("lost cameras were found again and gone on with {} times\n", reconnections);
  }
  text += fmt::format("{} frames judged", offered);
  const char* separator = "; refused: ";
  for (const auto& [refusal, count] : refusals) {
    text += fmt::format("{}{}: {}", separator, lightsketch::describe(refusal), count);
    separator = ", ";
  }
  const auto link = [](const char* name, const StreamStatistics& s) {
    return fmt::format(
        "\n{} camera: {} frames, {} incomplete, {} lost; {} packets, {} missing, {} "
        "resent",
        name, s.delivered, s.incomplete, s.lost, s.packetsReceived, s.packetsMissing,
        s.packetsResent);
  };
  text += link("scene", scene);
  for (const StreamStatistics& source : sources) text += link("source", source);
  text +=
      fmt::format("\n{} frames dropped because the program could not keep up\n", droppedByQueues);
  return text;
}

Result<RecorderSummary> record(Camera& sceneCamera, std::span<const SourceCamera> sources,
                               const RigGeometry& rig, const std::filesystem::path& sketchFolder,
                               const RecorderOptions& options, Progress& progress,
                               std::stop_token stop,
                               std::function<void(const RecorderState&)> onState,
                               RecorderControl* control) {
  RETURN_IF_ERROR(validate(options));
  if (sources.empty() || sources.size() != rig.sourceCameras.size()) {
    return failure(ErrorCode::kInvalidArgument,
                   "{} source camera(s), but the rig holds poses of {}; every source camera needs "
                   "its own, see --rig",
                   sources.size(), rig.sourceCameras.size());
  }
  ASSIGN_OR_RETURN(auto grid, gridFor(options));

  CameraSettings wanted;
  wanted.framesPerSecond = options.framesPerSecond;
  wanted.exposureSeconds = options.sourceExposureSeconds;
  wanted.gainDb = options.sourceGainDb;
  for (const SourceCamera& source : sources) {
    if (!source.model) {
      return failure(ErrorCode::kInvalidArgument,
                     "source camera {} has no model; see --camera-model",
                     source.camera.info().address);
    }
    ASSIGN_OR_RETURN(const CameraSettings settings, configureNearest(source.camera, wanted, true));
    if (settings.region && (settings.region->width != source.model->width() ||
                            settings.region->height != source.model->height())) {
      return failure(ErrorCode::kInvalidArgument,
                     "source camera {} sends {} x {} pixels, but its model is for {} x {}",
                     source.camera.info().address, settings.region->width, settings.region->height,
                     source.model->width(), source.model->height());
    }
  }
  wanted.exposureSeconds = options.sceneExposureSeconds;
  wanted.gainDb = options.sceneGainDb;
  wanted.format = options.sceneFormat;
  ASSIGN_OR_RETURN(const CameraSettings scene, configureNearest(sceneCamera, wanted));
  if (sceneCamera.isLive() && scene.format && scene.format != wanted.format) {
    progress.warn(fmt::format("scene camera {}: {} is not offered, it sends {}",
                              sceneCamera.info().address, pixelFormatInfo(*wanted.format).name,
                              pixelFormatInfo(*scene.format).name));
  }
  if (!scene.region || !scene.exposureSeconds) {
    return failure(ErrorCode::kDevice, "scene camera {} does not tell its region and exposure",
                   sceneCamera.info().address);
  }

  const bool goOn = std::filesystem::exists(sketchFolder / "sketch.json");
  SketchManifest manifest;
  manifest.width = scene.region->width;
  manifest.height = scene.region->height;
  manifest.directions = options.directions;
  manifest.fullSphere = options.fullSphere;
  manifest.ambientSubtracted = options.subtractAmbient && options.ambientSeconds > 0;
  manifest.software = "lightsketch " LIGHTSKETCH_VERSION;
  manifest.cameras = Json::array({describe("scene", sceneCamera.info())});
  for (const SourceCamera& source : sources) {
    manifest.cameras.push_back(describe("source", source.camera.info()));
  }
  manifest.provenance = {{"method", "recorded"},
                         {"referenceExposureSeconds", *scene.exposureSeconds},
                         {"referenceGainDb", scene.gainDb.value_or(0)},
                         {"referenceDistanceMetres", referenceDistance(rig)},
                         {"demosaic", "Malvar, He and Cutler 2004"}};
  auto opened = goOn ? openToGoOn(sketchFolder, options, manifest.width, manifest.height, rig)
                     : Sketch::create(sketchFolder, manifest, rig);
  ASSIGN_OR_RETURN(Sketch sketch, std::move(opened));
  for (const SourceCamera& source : sources) {
    RETURN_IF_ERROR(keepModel(sketchFolder, *source.model));
  }

  Coverage coverage(std::move(grid));
  for (const int id : sketch.activeFrames()) {
    coverage.add(sketch.frames()[static_cast<std::size_t>(id)].light.direction);
  }
  RecorderControl own;
  Recording recording(sceneCamera, sources, rig, options, progress, std::move(onState),
                      (control == nullptr ? own : *control).state(), std::move(sketch),
                      std::move(coverage), scene);
  if (goOn) RETURN_IF_ERROR(recording.resume());
  return recording.run(stop);
}

}  // namespace lightsketch
