#include "capture/device/aravis_camera.h"

#include <arv.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <condition_variable>
#include <mutex>
#include <numbers>
#include <optional>
#include <stop_token>
#include <thread>
#include <utility>

#include "capture/device/clock_mapping.h"
#include "capture/device/exposure_log.h"
#include "capture/device/gvcp_probe.h"

namespace lightsketch {
namespace {

constexpr int kBuffers = 8;  // each is copied out and handed back at once
constexpr int kSocketBufferBytes = 4 << 20;
constexpr auto kAnswerTimeout = std::chrono::seconds(1);
constexpr auto kHeartbeat = std::chrono::seconds(3);  // GigE Vision's default
constexpr auto kWatchInterval = std::chrono::milliseconds(500);
constexpr int kFirstComparisons = 16;
constexpr int kComparisons = 4;
// Without a latch the mapping leans on when frames start to arrive. What lies between the end of an
// exposure and that differs by camera; this is what we admit to.
constexpr auto kUnlatchedSigma = std::chrono::milliseconds(2);
constexpr auto kUnlatchedWindow = std::chrono::seconds(1);
constexpr int kSettlingFrames = 1;  // a change takes effect after one frame (measured)

// GigE Vision bootstrap registers.
constexpr std::uint64_t kTimestampControl = 0x0944;
constexpr std::uint64_t kTimestampLatched = 0x0948;
constexpr std::uint32_t kLatch = 2;

struct Unref {
  void operator()(void* object) const { g_object_unref(object); }
};
template <class T>
using Ref = std::unique_ptr<T, Unref>;

// For GLib's out parameters.
class GlibError {
 public:
  ~GlibError() { g_clear_error(&error_); }
  GlibError() = default;
  GlibError(const GlibError&) = delete;
  GlibError& operator=(const GlibError&) = delete;
  GError** out() {
    g_clear_error(&error_);
    return &error_;
  }
  explicit operator bool() const { return error_ != nullptr; }
  std::string_view message() const { return error_ == nullptr ? "unknown error" : error_->message; }

 private:
  GError* error_ = nullptr;
};

std::string orEmpty(const char* text) { return text == nullptr ? "" : text; }

// What Aravis' threads work on. Shared with them, because a dead camera is closed in the background
// and may outlive the Camera object.
struct Link {
  explicit Link(std::string cameraAddress) : address(std::move(cameraAddress)) {}

  const std::string address;
  std::atomic<bool> lost = false;

  std::mutex callbackMutex;  // Guards the callbacks, and is held while one runs.
  FrameCallback onFrame;
  EndCallback onEnd;

  std::mutex mutex;  // Guards the following.
  StreamStatistics statistics;
  ClockMapping clock;
  ExposureLog exposures{kSettlingFrames};
  bool latched = false;      // the clock is mapped by latching it; otherwise by arrivals
  bool warmedUp = false;     // the first frame of a session is often incomplete: it is dropped
  std::uint64_t lastId = 0;  // unwrapped; 0: none yet
  std::optional<Duration> leastDelay;  // unlatched: of this window
  std::int64_t windowBegin = 0;

  void receive(ArvBuffer* buffer, TimePoint arrival);
  std::optional<Frame> makeFrame(ArvBuffer* buffer, TimePoint arrival);
  bool acceptId(std::uint64_t id);
  void compareByArrival(std::int64_t deviceTimeNs, TimePoint leaderArrival);
  void end();
};

// Unwraps a frame id, counts what is missing before it. Caller holds the mutex.
bool Link::acceptId(std::uint64_t id) {
  constexpr std::uint64_t kCycle = 65535;  // 16-bit ids go 65535 -> 1; longer ones do not wrap
  std::uint64_t unwrapped = id;
  if (lastId != 0 && id <= kCycle) {
    const std::uint64_t last = (lastId - 1) % kCycle + 1;
    unwrapped = lastId + (id + kCycle - last) % kCycle;
  }
  if (unwrapped <= lastId) return false;
  if (lastId != 0) statistics.lost += unwrapped - lastId - 1;
  lastId = unwrapped;
  return true;
}

// The lower envelope of arrival over the device's time: the frame with the least delay in each
// window says when its exposure began, give or take the camera's overhead. Caller holds the mutex.
void Link::compareByArrival(std::int64_t deviceTimeNs, TimePoint leaderArrival) {
  const Duration delay = leaderArrival.time_since_epoch() -
                         fromSeconds(exposures.current().seconds) - Duration(deviceTimeNs);
  const bool first = !leastDelay && windowBegin == 0;
  leastDelay = std::min(leastDelay.value_or(delay), delay);
  if (first || Duration(deviceTimeNs - windowBegin) > kUnlatchedWindow) {
    clock.add(deviceTimeNs, TimePoint(*leastDelay + Duration(deviceTimeNs)), kUnlatchedSigma);
    leastDelay.reset();
    windowBegin = deviceTimeNs;
  }
}

// Caller holds the mutex.
std::optional<Frame> Link::makeFrame(ArvBuffer* buffer, TimePoint arrival) {
  const ArvBufferStatus status = arv_buffer_get_status(buffer);
  if (status == ARV_BUFFER_STATUS_CLEARED || status == ARV_BUFFER_STATUS_ABORTED) return {};
  const bool warmUp = !std::exchange(warmedUp, true);
  const bool inOrder = acceptId(arv_buffer_get_frame_id(buffer));

  // Accept only what is whole and of the shape it claims.
  Frame frame;
  bool whole = inOrder && status == ARV_BUFFER_STATUS_SUCCESS &&
               arv_buffer_get_payload_type(buffer) == ARV_BUFFER_PAYLOAD_TYPE_IMAGE;
  std::size_t size = 0;
  const void* data = whole ? arv_buffer_get_image_data(buffer, &size) : nullptr;
  if (whole) {
    const auto format = pixelFormatFromCode(arv_buffer_get_image_pixel_format(buffer));
    int paddingX = 0, paddingY = 0;
    arv_buffer_get_image_padding(buffer, &paddingX, &paddingY);
    frame.width = arv_buffer_get_image_width(buffer);
    frame.height = arv_buffer_get_image_height(buffer);
    whole = format && data != nullptr && frame.width > 0 && frame.height > 0 && paddingX == 0 &&
            paddingY == 0 &&
            size == static_cast<std::size_t>(frame.width) * static_cast<std::size_t>(frame.height) *
                        static_cast<std::size_t>(pixelFormatInfo(*format).bytesPerPixel);
    if (whole) frame.format = *format;
  }
  if (warmUp) {
    ++statistics.skipped;
    return {};
  }
  if (!whole) {
    ++statistics.incomplete;
    return {};
  }

  // Aravis notes on the wall clock when the leader came.
  const auto deviceTimeNs = static_cast<std::int64_t>(arv_buffer_get_timestamp(buffer));
  if (!latched) {
    const auto sinceLeader = std::chrono::microseconds(g_get_real_time()) -
                             Duration(arv_buffer_get_system_timestamp(buffer));
    compareByArrival(deviceTimeNs, arrival - sinceLeader);
  }
  const auto start = clock.map(deviceTimeNs);
  const auto exposure =
      start ? exposures.of(start->host, start->sigma) : std::optional<ExposureSetting>();
  if (!exposure) {
    ++statistics.skipped;
    return {};
  }
  FrameMetadata& metadata = frame.metadata;
  metadata.id = lastId;
  metadata.deviceTimeNs = deviceTimeNs;
  metadata.midExposure = start->host + fromSeconds(exposure->seconds / 2);
  metadata.timeUncertainty = start->sigma;
  metadata.arrival = arrival;
  metadata.exposureSeconds = exposure->seconds;
  metadata.gainDb = exposure->gainDb;
  const auto* bytes = static_cast<const std::uint8_t*>(data);
  frame.bytes.assign(bytes, bytes + size);
  return frame;
}

void Link::receive(ArvBuffer* buffer, TimePoint arrival) {
  std::optional<Frame> frame;
  {
    const std::lock_guard lock(mutex);
    frame = makeFrame(buffer, arrival);
  }
  if (!frame) return;
  const std::lock_guard callbackLock(callbackMutex);
  if (!onFrame) return;
  {
    const std::lock_guard lock(mutex);
    ++statistics.delivered;
  }
  onFrame(std::move(*frame));
}

void Link::end() {
  if (lost.exchange(true)) return;
  const std::lock_guard lock(callbackMutex);
  if (onEnd) {
    onEnd(Error{ErrorCode::kDevice, address + ": the camera does not answer any more (unplugged, "
                                              "switched off or its network failed)"});
  }
}

// The stream with what it needs while it runs.
struct Stream {
  Ref<ArvStream> stream;
  std::jthread watch;
};

// Called on Aravis' stream thread: the frame is copied there and the buffer handed back.
struct StreamContext {
  std::shared_ptr<Link> link;
  std::atomic<ArvStream*> stream = nullptr;
};
void onStreamEvent(void* context, ArvStreamCallbackType type, ArvBuffer*) {
  if (type != ARV_STREAM_CALLBACK_TYPE_BUFFER_DONE) return;
  const TimePoint arrival = Clock::now();
  auto& own = *static_cast<StreamContext*>(context);
  ArvStream* const stream = own.stream;
  ArvBuffer* const buffer = stream == nullptr ? nullptr : arv_stream_try_pop_buffer(stream);
  if (buffer == nullptr) return;
  own.link->receive(buffer, arrival);
  arv_stream_push_buffer(stream, buffer);
}

void onControlLost(ArvDevice*, void* link) { (*static_cast<std::shared_ptr<Link>*>(link))->end(); }

// Latches the device's clock between two readings of ours and keeps the quickest of `repeats`.
// False if the device cannot do it, or does not answer.
bool compareByLatch(ArvDevice* device, Link& link, std::uint64_t ticksPerSecond, int repeats) {
  std::optional<Duration> shortest;
  TimePoint host;
  std::uint64_t ticks = 0;
  for (int i = 0; i < repeats; ++i) {
    GlibError error;
    std::array<std::uint8_t, 8> latched{};
    const TimePoint before = Clock::now();
    if (!arv_device_write_register(device, kTimestampControl, kLatch, error.out())) return false;
    const TimePoint after = Clock::now();
    if (!arv_device_read_memory(device, kTimestampLatched, latched.size(), latched.data(),
                                error.out())) {
      return false;
    }
    if (shortest && after - before >= *shortest) continue;
    shortest = after - before;
    host = before + *shortest / 2;
    ticks = 0;
    for (const std::uint8_t byte : latched) ticks = ticks << 8 | byte;
  }
  // As Aravis turns ticks to nanoseconds.
  const std::uint64_t ns = ticks / ticksPerSecond * 1'000'000'000 +
                           ticks % ticksPerSecond * 1'000'000'000 / ticksPerSecond;
  // The latch fell anywhere within the round trip: a uniform distribution's sigma.
  const Duration sigma = fromSeconds(toSeconds(*shortest) / (2 * std::numbers::sqrt3));
  const std::lock_guard lock(link.mutex);
  link.clock.add(static_cast<std::int64_t>(ns), host, sigma);
  return true;
}

// Keeps the clocks compared and notices early when a GigE camera is gone: Aravis alone needs 6 to
// 10 s. A camera that is silent for as long as its heartbeat allows has dropped us anyway.
void watch(std::stop_token stop, ArvDevice* device, Link& link, const std::string& target,
           std::uint64_t ticksPerSecond) {
  std::mutex mutex;
  std::condition_variable_any wake;
  std::unique_lock lock(mutex);
  while (!wake.wait_for(lock, stop, kWatchInterval, [&] { return stop.stop_requested(); })) {
    if (isIpv4Address(target) && probeCameras({&target, 1}, kHeartbeat).empty()) return link.end();
    if (ticksPerSecond > 0) compareByLatch(device, link, ticksPerSecond, kComparisons);
  }
}

class AravisCamera final : public Camera {
 public:
  AravisCamera(std::string address, Ref<ArvCamera> camera, CameraInfo info)
      : target_(std::move(address)),
        info_(std::move(info)),
        camera_(std::move(camera)),
        link_(std::make_shared<Link>(info_.address)) {
    controlLost_ = g_signal_connect_data(
        device(), "control-lost", G_CALLBACK(onControlLost), new std::shared_ptr<Link>(link_),
        [](void* link, GClosure*) { delete static_cast<std::shared_ptr<Link>*>(link); },
        GConnectFlags{});
  }

  ~AravisCamera() override {
    stop();
    g_signal_handler_disconnect(device(), controlLost_);
    closeInBackgroundIf(!answers(), {}, std::move(camera_));
  }

  const CameraInfo& info() const override { return info_; }
  Result<CameraSettings> configure(const CameraSettings& settings) override;
  Result<void> start(FrameCallback onFrame, EndCallback onEnd) override;
  void stop() override;
  StreamStatistics statistics() const override;
  bool hasFeature(const std::string& name) const override;
  Result<void> setFeature(const std::string& name, double value) override;

 private:
  ArvDevice* device() const { return arv_camera_get_device(camera_.get()); }

  tl::unexpected<Error> failed(std::string_view what, const GlibError& error) const {
    return failure(ErrorCode::kDevice, "{}: cannot {}: {}", info_.address, what, error.message());
  }
  Result<void> checkAlive() const {
    if (!link_->lost) return {};
    return failure(ErrorCode::kDevice, "{}: the camera was lost; open it again", info_.address);
  }

  // Whether talking to the camera is worth it: each call to a dead one blocks for seconds.
  bool answers() const {
    if (link_->lost) return false;
    return !isIpv4Address(target_) || !probeCameras({&target_, 1}, kAnswerTimeout).empty();
  }

  // Closing a camera that does not answer takes Aravis many seconds; nobody has to wait for it.
  static void closeInBackgroundIf(bool dead, std::optional<Stream> stream, Ref<ArvCamera> camera) {
    const auto close = [](std::optional<Stream> ownStream, Ref<ArvCamera> ownCamera) {
      ownStream.reset();
      ownCamera.reset();
    };
    if (dead) {
      std::thread(close, std::move(stream), std::move(camera)).detach();
    } else {
      close(std::move(stream), std::move(camera));
    }
  }

  Result<void> setFormat(PixelFormat format);
  Result<void> setRegion(const Region& wanted);
  Result<void> setExposure(std::optional<double> seconds, std::optional<double> gainDb);
  Result<void> setFrameRate(double framesPerSecond);
  Result<CameraSettings> settings() const;
  Result<ExposureSetting> exposure() const;
  void addPacketCounts(StreamStatistics& statistics, ArvStream* stream) const;

  const std::string target_;
  const CameraInfo info_;
  Ref<ArvCamera> camera_;
  const std::shared_ptr<Link> link_;
  gulong controlLost_ = 0;

  mutable std::mutex control_;  // Guards the feature tree, which Aravis does not, and stream_.
  std::optional<Stream> stream_;
};

Result<void> AravisCamera::setFormat(PixelFormat format) {
  const std::string name(pixelFormatInfo(format).name);
  GlibError error;
  arv_camera_set_pixel_format_from_string(camera_.get(), name.c_str(), error.out());
  if (!error) return {};
  const std::string reason(error.message());
  guint count = 0;
  const char** names =
      arv_camera_dup_available_pixel_formats_as_strings(camera_.get(), &count, error.out());
  std::string offered;
  for (guint i = 0; i < count; ++i) offered += (i == 0 ? "" : ", ") + orEmpty(names[i]);
  g_free(names);
  return failure(ErrorCode::kInvalidArgument, "{}: cannot set pixel format {} ({}); it offers {}",
                 info_.address, name, reason, offered);
}

Result<void> AravisCamera::setRegion(const Region& wanted) {
  GlibError error;
  int width = 0, height = 0;
  arv_camera_get_sensor_size(camera_.get(), &width, &height, error.out());
  if (error) return failed("read the sensor's size", error);
  const Region region = wanted == Region{} ? Region{0, 0, width, height} : wanted;
  if (region.x < 0 || region.y < 0 || region.width < 1 || region.height < 1 ||
      region.x > width - region.width || region.y > height - region.height) {
    return failure(ErrorCode::kInvalidArgument,
                   "{}: the region {}x{} at ({}, {}) leaves the sensor of {}x{}", info_.address,
                   region.width, region.height, region.x, region.y, width, height);
  }
  // Offsets first to zero, so that no step leaves the sensor.
  for (const auto& [feature, value] :
       {std::pair{"OffsetX", 0}, std::pair{"OffsetY", 0}, std::pair{"Width", region.width},
        std::pair{"Height", region.height}, std::pair{"OffsetX", region.x},
        std::pair{"OffsetY", region.y}}) {
    arv_camera_set_integer(camera_.get(), feature, value, error.out());
    if (error) return failed(fmt::format("set {} to {}", feature, value), error);
  }
  return {};
}

Result<void> AravisCamera::setExposure(std::optional<double> seconds,
                                       std::optional<double> gainDb) {
  GlibError error;
  double min = 0, max = 0;
  if (seconds) {
    arv_camera_get_exposure_time_bounds(camera_.get(), &min, &max, error.out());
    if (error) return failed("read the limits of the exposure time", error);
    if (!(*seconds * 1e6 >= min && *seconds * 1e6 <= max)) {
      return failure(ErrorCode::kInvalidArgument,
                     "{}: an exposure of {} s is outside the camera's {:.6g} to {:.6g} s",
                     info_.address, *seconds, min * 1e-6, max * 1e-6);
    }
  }
  // Not every camera has a gain; none is what 0 dB asks for.
  if (gainDb && *gainDb == 0 && !arv_camera_is_gain_available(camera_.get(), error.out())) {
    gainDb.reset();
  }
  if (gainDb) {
    arv_camera_get_gain_bounds(camera_.get(), &min, &max, error.out());
    if (error) return failed("read the limits of the gain", error);
    if (!(*gainDb >= min && *gainDb <= max)) {
      return failure(ErrorCode::kInvalidArgument,
                     "{}: a gain of {} dB is outside the camera's {:.6g} to {:.6g} dB",
                     info_.address, *gainDb, min, max);
    }
  }

  {
    const std::lock_guard lock(link_->mutex);
    link_->exposures.beginChange();
  }
  // What is set by hand must not be set by the camera.
  Result<void> done;
  if (seconds && arv_camera_is_exposure_auto_available(camera_.get(), error.out())) {
    arv_camera_set_exposure_time_auto(camera_.get(), ARV_AUTO_OFF, error.out());
  }
  if (seconds && !error) arv_camera_set_exposure_time(camera_.get(), *seconds * 1e6, error.out());
  if (error) done = failed("set the exposure time", error);
  if (gainDb && done && arv_camera_is_gain_auto_available(camera_.get(), error.out())) {
    arv_camera_set_gain_auto(camera_.get(), ARV_AUTO_OFF, error.out());
  }
  if (gainDb && done && !error) arv_camera_set_gain(camera_.get(), *gainDb, error.out());
  if (done && error) done = failed("set the gain", error);
  const auto actual = exposure();  // what the camera made of it, also if it refused
  const std::lock_guard lock(link_->mutex);
  link_->exposures.endChange(actual.value_or(link_->exposures.current()));
  if (!done) return done;
  if (!actual) return tl::unexpected(actual.error());
  return {};
}

Result<void> AravisCamera::setFrameRate(double framesPerSecond) {
  GlibError error;
  double min = 0, max = 0;
  // A camera without a rate of its own sends as fast as it exposes.
  if (!arv_camera_is_frame_rate_available(camera_.get(), error.out())) return {};
  arv_camera_get_frame_rate_bounds(camera_.get(), &min, &max, error.out());
  if (error) return failed("read the limits of the frame rate", error);
  if (!(framesPerSecond >= min && framesPerSecond <= max)) {
    return failure(ErrorCode::kInvalidArgument,
                   "{}: {} frames/s is outside the camera's {:.6g} to {:.6g}", info_.address,
                   framesPerSecond, min, max);
  }
  arv_camera_set_frame_rate(camera_.get(), framesPerSecond, error.out());
  if (error) return failed("set the frame rate", error);
  return {};
}

Result<ExposureSetting> AravisCamera::exposure() const {
  GlibError error;
  ExposureSetting setting;
  setting.seconds = 1e-6 * arv_camera_get_exposure_time(camera_.get(), error.out());
  if (error) return failed("read the exposure time", error);
  if (arv_camera_is_gain_available(camera_.get(), error.out())) {
    setting.gainDb = arv_camera_get_gain(camera_.get(), error.out());
  }
  if (error) return failed("read the gain", error);
  return setting;
}

Result<CameraSettings> AravisCamera::settings() const {
  GlibError error;
  CameraSettings settings;
  const ArvPixelFormat code = arv_camera_get_pixel_format(camera_.get(), error.out());
  if (error) return failed("read the pixel format", error);
  settings.format = pixelFormatFromCode(code);
  if (!settings.format) {
    return failure(ErrorCode::kUnsupported,
                   "{}: sends pixel format {:#010x}, which is not supported; choose another, such "
                   "as Mono8 or BayerRG12",
                   info_.address, code);
  }
  Region region;
  arv_camera_get_region(camera_.get(), &region.x, &region.y, &region.width, &region.height,
                        error.out());
  if (error) return failed("read the region", error);
  settings.region = region;
  ASSIGN_OR_RETURN(const ExposureSetting setting, exposure());
  settings.exposureSeconds = setting.seconds;
  settings.gainDb = setting.gainDb;
  settings.framesPerSecond = 0;  // as it comes
  if (arv_camera_is_frame_rate_available(camera_.get(), error.out())) {
    settings.framesPerSecond = arv_camera_get_frame_rate(camera_.get(), error.out());
  }
  if (error) return failed("read the frame rate", error);
  return settings;
}

Result<CameraSettings> AravisCamera::configure(const CameraSettings& wanted) {
  RETURN_IF_ERROR(checkAlive());
  const std::lock_guard lock(control_);
  if (stream_ && (wanted.format || wanted.region || wanted.framesPerSecond)) {
    return failure(ErrorCode::kInvalidArgument,
                   "{}: only exposure and gain can change while streaming; stop the camera first",
                   info_.address);
  }
  if (wanted.format) RETURN_IF_ERROR(setFormat(*wanted.format));
  if (wanted.region) RETURN_IF_ERROR(setRegion(*wanted.region));
  if (wanted.exposureSeconds || wanted.gainDb) {
    RETURN_IF_ERROR(setExposure(wanted.exposureSeconds, wanted.gainDb));
  }
  if (wanted.framesPerSecond) RETURN_IF_ERROR(setFrameRate(*wanted.framesPerSecond));
  return settings();
}

Result<void> AravisCamera::start(FrameCallback onFrame, EndCallback onEnd) {
  RETURN_IF_ERROR(checkAlive());
  const std::lock_guard lock(control_);
  if (stream_) {
    return failure(ErrorCode::kInvalidArgument, "{}: streams already", info_.address);
  }
  ASSIGN_OR_RETURN(const CameraSettings now, settings());
  GlibError error;
  arv_camera_set_acquisition_mode(camera_.get(), ARV_ACQUISITION_MODE_CONTINUOUS, error.out());
  if (error) return failed("set continuous acquisition", error);

  // A first mapping of the clocks, before frames load the link.
  const bool gige = arv_camera_is_gv_device(camera_.get()) != FALSE;
  std::uint64_t ticksPerSecond = 0;
  if (gige) {
    ticksPerSecond =
        arv_gv_device_get_timestamp_tick_frequency(ARV_GV_DEVICE(device()), error.out());
  }
  {
    const std::lock_guard linkLock(link_->mutex);
    link_->statistics = {};
    link_->clock = {};
    link_->exposures.reset({*now.exposureSeconds, *now.gainDb});
    link_->warmedUp = false;
    link_->lastId = 0;
    link_->leastDelay.reset();
    link_->windowBegin = 0;
  }
  const bool latched =
      ticksPerSecond > 0 && compareByLatch(device(), *link_, ticksPerSecond, kFirstComparisons);
  {
    const std::lock_guard linkLock(link_->mutex);
    link_->latched = latched;
  }

  // The packet socket has a race that lets foreign packets in; the default buffer loses packets.
  if (gige) {
    arv_camera_gv_set_stream_options(camera_.get(), ARV_GV_STREAM_OPTION_PACKET_SOCKET_DISABLED);
  }
  auto* const context = new StreamContext{link_};
  Stream stream;
  stream.stream.reset(arv_camera_create_stream_full(
      camera_.get(), onStreamEvent, context,
      [](void* own) { delete static_cast<StreamContext*>(own); }, error.out()));
  if (!stream.stream) return failed("open a stream", error);
  context->stream = stream.stream.get();
  if (gige) {
    g_object_set(stream.stream.get(), "socket-buffer", ARV_GV_STREAM_SOCKET_BUFFER_FIXED,
                 "socket-buffer-size", kSocketBufferBytes, nullptr);
  }
  const guint payload = arv_camera_get_payload(camera_.get(), error.out());
  if (error) return failed("read the size of a frame", error);
  for (int i = 0; i < kBuffers; ++i) {
    arv_stream_push_buffer(stream.stream.get(), arv_buffer_new_allocate(payload));
  }

  {
    const std::lock_guard callbackLock(link_->callbackMutex);
    link_->onFrame = std::move(onFrame);
    link_->onEnd = std::move(onEnd);
  }
  arv_camera_start_acquisition(camera_.get(), error.out());
  if (error) {
    const std::lock_guard callbackLock(link_->callbackMutex);
    link_->onFrame = nullptr;
    link_->onEnd = nullptr;
    return failed("start", error);
  }

  if (gige) {
    stream.watch = std::jthread([own = device(), link = link_, target = target_,
                                 ticks = latched ? ticksPerSecond : 0](std::stop_token stop) {
      watch(stop, own, *link, target, ticks);
    });
  }
  stream_ = std::move(stream);
  return {};
}

void AravisCamera::stop() {
  {
    const std::lock_guard lock(link_->callbackMutex);
    link_->onFrame = nullptr;
    link_->onEnd = nullptr;
  }
  const std::lock_guard lock(control_);
  if (!stream_) return;
  stream_->watch.request_stop();
  const bool dead = !answers();
  if (dead) {
    link_->lost = true;
  } else {
    GlibError error;  // that it could not be stopped shows in nothing that is still to come
    arv_camera_stop_acquisition(camera_.get(), error.out());
  }
  {
    const std::lock_guard linkLock(link_->mutex);
    addPacketCounts(link_->statistics, stream_->stream.get());
  }
  closeInBackgroundIf(dead, std::exchange(stream_, std::nullopt),
                      Ref<ArvCamera>(ARV_CAMERA(g_object_ref(camera_.get()))));
}

void AravisCamera::addPacketCounts(StreamStatistics& statistics, ArvStream* stream) const {
  guint64 completed = 0, failures = 0, underruns = 0;
  arv_stream_get_statistics(stream, &completed, &failures, &underruns);
  statistics.underruns = underruns;
  if (!ARV_IS_GV_STREAM(stream)) return;
  statistics.packetsReceived = arv_stream_get_info_uint64_by_name(stream, "n_received_packets");
  statistics.packetsMissing = arv_stream_get_info_uint64_by_name(stream, "n_missing_packets");
  statistics.packetsResent = arv_stream_get_info_uint64_by_name(stream, "n_resent_packets");
}

StreamStatistics AravisCamera::statistics() const {
  const std::lock_guard lock(control_);
  const std::lock_guard linkLock(link_->mutex);
  StreamStatistics statistics = link_->statistics;
  if (stream_) addPacketCounts(statistics, stream_->stream.get());
  return statistics;
}

bool AravisCamera::hasFeature(const std::string& name) const {
  const std::lock_guard lock(control_);
  GlibError error;
  return arv_camera_is_feature_available(camera_.get(), name.c_str(), error.out()) != FALSE;
}

Result<void> AravisCamera::setFeature(const std::string& name, double value) {
  RETURN_IF_ERROR(checkAlive());
  const std::lock_guard lock(control_);
  GlibError error;
  ArvGcNode* const node = arv_device_get_feature(device(), name.c_str());
  if (ARV_IS_GC_FLOAT(node)) {
    arv_camera_set_float(camera_.get(), name.c_str(), value, error.out());
  } else if (ARV_IS_GC_BOOLEAN(node)) {
    arv_camera_set_boolean(camera_.get(), name.c_str(), value != 0, error.out());
  } else if (ARV_IS_GC_INTEGER(node)) {
    arv_camera_set_integer(camera_.get(), name.c_str(), std::llround(value), error.out());
  } else {
    return failure(ErrorCode::kNotFound, "{}: has no numeric feature '{}'", info_.address, name);
  }
  if (error) return failed(fmt::format("set {} to {}", name, value), error);
  return {};
}

// Aravis reports trouble on the terminal by default, and offers a fake camera of its own.
void prepareAravis() {
  static std::once_flag once;
  std::call_once(once, [] {
    arv_debug_enable("all:0");
    arv_disable_interface("Fake");
  });
}

Result<Ref<ArvCamera>> connect(const std::string& target) {
  GlibError error;
  if (!isIpv4Address(target)) {
    Ref<ArvCamera> camera(arv_camera_new(target.c_str(), error.out()));
    if (!camera) {
      return failure(ErrorCode::kNotFound, "aravis:{}: no such camera ({})", target,
                     error.message());
    }
    return camera;
  }
  // Aravis would search all interfaces; asking the address itself is quicker and binds only the
  // interface that the kernel routes to it by.
  if (probeCameras({&target, 1}, kAnswerTimeout).empty()) {
    return failure(ErrorCode::kNotFound,
                   "aravis:{}: no camera answers there (asked for one second)", target);
  }
  const Ref<GInetAddress> address(g_inet_address_new_from_string(target.c_str()));
  const Ref<GInetAddress> own(g_inet_address_new_from_string(localAddressTowards(target).c_str()));
  const Ref<ArvDevice> device(arv_gv_device_new(own.get(), address.get(), error.out()));
  Ref<ArvCamera> camera(device ? arv_camera_new_with_device(device.get(), error.out()) : nullptr);
  if (!camera) {
    return failure(ErrorCode::kDevice, "aravis:{}: cannot be opened: {}", target, error.message());
  }
  return camera;
}

}  // namespace

Result<std::unique_ptr<Camera>> openAravisCamera(const std::string& address) {
  prepareAravis();
  ASSIGN_OR_RETURN(Ref<ArvCamera> camera, connect(address));
  if (arv_camera_is_gv_device(camera.get()) &&
      !arv_gv_device_is_controller(ARV_GV_DEVICE(arv_camera_get_device(camera.get())))) {
    return failure(ErrorCode::kDevice,
                   "aravis:{}: another program controls this camera; close that, or wait 3 s if it "
                   "crashed",
                   address);
  }
  CameraInfo info{"aravis:" + address, orEmpty(arv_camera_get_vendor_name(camera.get(), nullptr)),
                  orEmpty(arv_camera_get_model_name(camera.get(), nullptr)),
                  orEmpty(arv_camera_get_device_serial_number(camera.get(), nullptr))};
  return std::make_unique<AravisCamera>(address, std::move(camera), std::move(info));
}

std::vector<CameraInfo> discoverAravisCameras() {
  prepareAravis();
  arv_update_device_list();
  std::vector<CameraInfo> cameras;
  for (unsigned i = 0; i < arv_get_n_devices(); ++i) {
    const std::string address = orEmpty(arv_get_device_address(i));
    cameras.push_back(
        {"aravis:" + (isIpv4Address(address) ? address : orEmpty(arv_get_device_id(i))),
         orEmpty(arv_get_device_vendor(i)), orEmpty(arv_get_device_model(i)),
         orEmpty(arv_get_device_serial_nbr(i))});
  }
  return cameras;
}

}  // namespace lightsketch
