#include "capture/device/aravis_camera.h"

#include <arv.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <numbers>
#include <optional>
#include <span>
#include <stop_token>
#include <thread>
#include <utility>

#include "capture/device/exposure_log.h"
#include "capture/device/frame_clock.h"
#include "capture/device/gvcp_probe.h"
#include "capture/device/wire_format.h"

namespace lightsketch {
namespace {

constexpr guint kMinBuffers = 8;  // each is copied out and handed back at once
constexpr guint kMaxBuffers = 32;
constexpr guint kBufferBytes = 64 << 20;  // together, unless that makes too few
constexpr int kSocketBufferBytes = 4 << 20;
constexpr guint kFrameRetentionUs = 400'000;  // a busy computer gets what it asked for again late
constexpr auto kAnswerTimeout = std::chrono::seconds(1);
constexpr auto kHeartbeat = std::chrono::seconds(3);  // GigE Vision's default
constexpr auto kWatchInterval = std::chrono::milliseconds(500);
constexpr int kFirstComparisons = 16;
constexpr int kComparisons = 4;
constexpr std::size_t kRepairMemory = 16;           // frames
constexpr auto kSilence = std::chrono::seconds(6);  // beyond what exposing takes
constexpr int kSettlingFrames = 1;  // a change takes effect after one frame (measured)

// GigE Vision bootstrap registers.
constexpr std::uint64_t kTimestampControl = 0x0944;
constexpr std::uint64_t kTimestampLatched = 0x0948;
constexpr std::uint32_t kLatch = 2;

constexpr std::array kChunks = {"ExposureTime", "Gain", "Timestamp", "PayloadCRC16"};
constexpr std::uint32_t kImageChunk = 1;
constexpr std::size_t kPacketHeaders = 20 + 8 + 8;  // IP, UDP, GVSP

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

// Aravis counts a packet as received before it looks at it, and may then leave it alone: too short,
// of an unknown kind, out of place. What it has not written over still carries these marks, one at
// the end of each packet's block. No picture of 10 to 14 bits has them.
constexpr std::array<std::uint8_t, 4> kMark = {0x5a, 0xc3, 0x96, 0xe1};
// Calls `visit` with the place of each block's mark.
template <class Visit>
void forEachMark(std::size_t bytes, std::size_t block, Visit visit) {
  if (block < kMark.size()) return;
  for (std::size_t end = block; end <= bytes; end += block) visit(end - kMark.size());
  if (bytes >= kMark.size()) visit(bytes - kMark.size());
}
bool allBlocksWritten(std::span<const std::uint8_t> payload, std::size_t block) {
  bool written = true;
  forEachMark(payload.size(), block, [&](std::size_t at) {
    if (std::equal(kMark.begin(), kMark.end(), payload.data() + at)) written = false;
  });
  return written;
}
void markAndPush(ArvStream* stream, ArvBuffer* buffer, std::size_t block) {
  std::size_t size = 0;
  auto* const data =  // ours until it is pushed
      static_cast<std::uint8_t*>(const_cast<void*>(arv_buffer_get_data(buffer, &size)));
  forEachMark(size, block,
              [&](std::size_t at) { std::copy(kMark.begin(), kMark.end(), data + at); });
  arv_stream_push_buffer(stream, buffer);
}

// What the stream was started with: what frames have to agree with.
struct Announced {
  WireFormat format;
  Region region;
  bool triggered = false;
  std::size_t block = 0;  // bytes of payload in a packet; 0: no packets
};

// Of packets, as Aravis counts them.
struct PacketCounts {
  std::uint64_t duplicated = 0, requested = 0, resent = 0, damaged = 0;
};

// What Aravis' threads work on. Shared with them, because a dead camera is closed in the background
// and may outlive the Camera object.
struct Link {
  explicit Link(std::string cameraAddress) : address(std::move(cameraAddress)) {}

  const std::string address;
  std::atomic<bool> lost = false;

  std::mutex control;  // Guards the feature tree, which Aravis does not.

  std::mutex callbackMutex;  // Guards the callbacks, and is held while one runs.
  FrameCallback onFrame;
  EndCallback onEnd;

  std::mutex mutex;  // Guards the following.
  Announced announced;
  StreamStatistics statistics;
  std::vector<std::string> notes;
  FrameClock clock;
  ExposureLog exposures{kSettlingFrames};
  bool warmedUp = false;     // the first frame of a session is often incomplete: it is dropped
  std::uint64_t lastId = 0;  // unwrapped; 0: none yet
  std::uint64_t damagedSinceLast = 0;
  // The frames that are being received, in their order.
  struct Begun {
    TimePoint firstPacket;
    std::uint64_t duplicated = 0;  // packets until then
    PacketCounts before;           // and some frames earlier
  };
  std::deque<Begun> begun;
  std::deque<PacketCounts> packetCounts;  // when each of the latest frames began
  TimePoint lastArrival;
  std::uint64_t duplicated = 0;        // packets so far, as Aravis counts them
  std::deque<std::uint64_t> repaired;  // the same of packets sent again, after each of some frames

  void begin(const Announced& stream, const ExposureSetting& exposure);
  void receive(ArvStream* stream, ArvChunkParser* parser, ArvBuffer* buffer, TimePoint arrival);
  std::optional<Frame> makeFrame(ArvStream* stream, ArvChunkParser* parser, ArvBuffer* buffer,
                                 TimePoint arrival);
  void beginFrame(ArvStream* stream);
  bool acceptId(std::uint64_t id);
  void end(std::string_view why);
};

void Link::begin(const Announced& stream, const ExposureSetting& exposure) {
  const std::lock_guard lock(mutex);
  announced = stream;
  statistics = {};
  clock.reset();
  exposures.reset(exposure);
  warmedUp = false;
  lastId = damagedSinceLast = 0;
  begun.clear();
  packetCounts.clear();
  lastArrival = Clock::now();
}

// Unwraps a whole frame's id, counts what is missing before it. False for what has been here
// already. Caller holds the mutex.
bool Link::acceptId(std::uint64_t id) {
  constexpr std::uint64_t kCycle = 65535;  // 16-bit ids go 65535 -> 1; longer ones do not wrap
  if (lastId == 0) {
    lastId = id;
  } else {
    const bool wraps = id <= kCycle;
    const std::uint64_t step =
        wraps ? (id + kCycle - (lastId - 1) % kCycle - 1) % kCycle : id - lastId;
    if (step == 0 || step > (wraps ? kCycle / 2 : id)) return false;
    statistics.lost += step - 1 - std::min(step - 1, damagedSinceLast);
    lastId += step;
  }
  damagedSinceLast = 0;
  return true;
}

std::uint64_t countOf(ArvStream* stream, const char* name) {
  return ARV_IS_GV_STREAM(stream) ? arv_stream_get_info_uint64_by_name(stream, name) : 0;
}
PacketCounts countPackets(ArvStream* stream) {
  return {countOf(stream, "n_duplicated_packets"), countOf(stream, "n_resend_requests"),
          countOf(stream, "n_resent_packets"),
          countOf(stream, "n_missing_packets") + countOf(stream, "n_error_packets")};
}

void Link::beginFrame(ArvStream* stream) {
  const TimePoint now = Clock::now();
  const std::lock_guard lock(mutex);
  packetCounts.push_back(countPackets(stream));
  if (packetCounts.size() > kRepairMemory) packetCounts.pop_front();
  begun.push_back({now, packetCounts.back().duplicated, packetCounts.front()});
}

// Of a packet with a wrong place in it Aravis keeps the payload where it was not meant to be: then
// it takes the right one for a duplicate, and misses another, maybe of a frame before. Either alone
// is harmless, and so is a duplicate that was asked for: an answer that came too late.
bool packetsInDoubt(ArvStream* stream, const Link::Begun& begun) {
  const PacketCounts now = countPackets(stream);
  const PacketCounts& before = begun.before;
  if (now.duplicated == begun.duplicated) return false;
  if (now.damaged != before.damaged) return true;
  const std::uint64_t answers = now.resent - before.resent;
  return answers > 0 &&
         answers + now.duplicated - before.duplicated > now.requested - before.requested;
}

// Walks the chunks from the last to the picture, which is the first (GigE Vision 2.0, section 27:
// each is followed by its id and length). The picture's bytes; 0 if the lengths do not add up.
std::size_t imageBytesBeforeChunks(std::span<const std::uint8_t> payload) {
  const auto word = [&](std::size_t at) {
    return static_cast<std::uint32_t>(payload[at]) << 24 |
           static_cast<std::uint32_t>(payload[at + 1]) << 16 |
           static_cast<std::uint32_t>(payload[at + 2]) << 8 | payload[at + 3];
  };
  std::size_t end = payload.size();
  while (end >= 8) {
    const std::uint32_t id = word(end - 8), length = word(end - 4);
    if (length > end - 8) return 0;
    end -= 8 + length;
    if (id == kImageChunk) return end == 0 ? length : 0;
  }
  return 0;
}

// Nothing if a checksum says that the payload is damaged.
std::optional<ToldExposure> readChunks(ArvChunkParser* parser, ArvBuffer* buffer,
                                       std::span<const std::uint8_t> payload) {
  ToldExposure values;
  GlibError error;
  const double exposure =
      arv_chunk_parser_get_float_value(parser, buffer, "ChunkExposureTime", error.out());
  if (!error) values.seconds = 1e-6 * exposure;
  const double gain = arv_chunk_parser_get_float_value(parser, buffer, "ChunkGain", error.out());
  if (!error) values.gainDb = gain;
  const gint64 crc =
      arv_chunk_parser_get_integer_value(parser, buffer, "ChunkPayloadCRC16", error.out());
  if (error) return values;
  // It covers what is before it, and is the last chunk, of two or four bytes.
  for (const std::size_t tail : {std::size_t{10}, std::size_t{12}}) {
    if (payload.size() > tail && crc16(payload.first(payload.size() - tail)) == crc) return values;
  }
  return std::nullopt;
}

// Caller holds the mutex.
std::optional<Frame> Link::makeFrame(ArvStream* stream, ArvChunkParser* parser, ArvBuffer* buffer,
                                     TimePoint arrival) {
  Begun frameBegun{arrival, 0, {}};
  if (!begun.empty()) {
    frameBegun = begun.front();
    begun.pop_front();
  }
  const ArvBufferStatus status = arv_buffer_get_status(buffer);
  if (status == ARV_BUFFER_STATUS_CLEARED || status == ARV_BUFFER_STATUS_ABORTED) return {};
  lastArrival = arrival;
  const bool warmUp = !std::exchange(warmedUp, true);

  // Accept only what is whole and of the shape that was announced.
  const Region& region = announced.region;
  const std::size_t pixels =
      static_cast<std::size_t>(region.width) * static_cast<std::size_t>(region.height);
  const std::size_t imageBytes = announced.format.bytes(pixels);
  bool whole = status == ARV_BUFFER_STATUS_SUCCESS &&
               arv_buffer_get_payload_type(buffer) == ARV_BUFFER_PAYLOAD_TYPE_IMAGE;
  std::span<const std::uint8_t> payload;
  if (whole) {
    std::size_t size = 0;
    const auto* data = static_cast<const std::uint8_t*>(arv_buffer_get_image_data(buffer, &size));
    Region sent;
    int paddingX = 0, paddingY = 0;
    arv_buffer_get_image_region(buffer, &sent.x, &sent.y, &sent.width, &sent.height);
    arv_buffer_get_image_padding(buffer, &paddingX, &paddingY);
    if (data != nullptr) payload = {data, size};
    whole = data != nullptr && sent == region && paddingX == 0 && paddingY == 0 &&
            arv_buffer_get_image_pixel_format(buffer) == announced.format.code &&
            allBlocksWritten(payload, announced.block) &&
            imageBytes == (arv_buffer_has_chunks(buffer) ? imageBytesBeforeChunks(payload) : size);
  }
  if (warmUp) {
    ++statistics.skipped;
    return {};
  }
  if (!whole) {
    ++statistics.incomplete;
    ++damagedSinceLast;
    return {};
  }
  std::optional<ToldExposure> chunks = ToldExposure{};
  if (parser != nullptr && arv_buffer_has_chunks(buffer)) {
    chunks = readChunks(parser, buffer, payload);
  }
  if (!chunks || packetsInDoubt(stream, frameBegun) || !acceptId(arv_buffer_get_frame_id(buffer))) {
    ++statistics.implausible;
    ++damagedSinceLast;
    return {};
  }

  const auto deviceTimeNs = static_cast<std::int64_t>(arv_buffer_get_timestamp(buffer));
  const auto start = clock.map(deviceTimeNs, frameBegun.firstPacket, arrival,
                               chunks->seconds.value_or(exposures.current().seconds));
  if (!start) {
    ++statistics.implausible;
    return {};
  }
  const auto exposure = exposures.of(start->host, start->sigma, *chunks);
  if (!exposure) {
    ++statistics.skipped;
    return {};
  }
  Frame frame;
  frame.format = announced.format.format;
  frame.width = region.width;
  frame.height = region.height;
  FrameMetadata& metadata = frame.metadata;
  metadata.id = lastId;
  metadata.deviceTimeNs = deviceTimeNs;
  metadata.midExposure = start->host + fromSeconds(exposure->seconds / 2);
  metadata.timeUncertainty = start->sigma;
  metadata.arrival = arrival;
  metadata.exposureSeconds = exposure->seconds;
  metadata.gainDb = exposure->gainDb;
  unpackPixels(announced.format, payload.first(imageBytes), pixels, frame.bytes);
  return frame;
}

void Link::receive(ArvStream* stream, ArvChunkParser* parser, ArvBuffer* buffer,
                   TimePoint arrival) {
  std::optional<Frame> frame;
  {
    const std::lock_guard lock(mutex);
    frame = makeFrame(stream, parser, buffer, arrival);
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

void Link::end(std::string_view why) {
  if (lost.exchange(true)) return;
  const std::lock_guard lock(callbackMutex);
  if (onEnd) onEnd(Error{ErrorCode::kDevice, fmt::format("{}: {}", address, why)});
}

constexpr std::string_view kGone =
    "the camera does not answer any more (unplugged, switched off or its network failed)";

// The stream with what it needs while it runs.
struct Stream {
  Ref<ArvStream> stream;
  std::jthread watch;
};

// Called on Aravis' stream thread: the frame is copied there and the buffer handed back.
struct StreamContext {
  std::shared_ptr<Link> link;
  Ref<ArvChunkParser> parser;  // null: no chunks
  std::atomic<ArvStream*> stream = nullptr;
};
void onStreamEvent(void* context, ArvStreamCallbackType type, ArvBuffer*) {
  const TimePoint arrival = Clock::now();
  auto& own = *static_cast<StreamContext*>(context);
  ArvStream* const stream = own.stream;
  if (stream == nullptr) return;
  if (type == ARV_STREAM_CALLBACK_TYPE_START_BUFFER) return own.link->beginFrame(stream);
  if (type != ARV_STREAM_CALLBACK_TYPE_BUFFER_DONE) return;
  while (ArvBuffer* const buffer = arv_stream_try_pop_buffer(stream)) {
    own.link->receive(stream, own.parser.get(), buffer, arrival);
    markAndPush(stream, buffer, own.link->announced.block);
  }
}

void onControlLost(ArvDevice*, void* link) {
  (*static_cast<std::shared_ptr<Link>*>(link))->end(kGone);
}

// How a device's clock is read: GigE Vision by registers, USB3 Vision by features.
struct ClockLatch {
  std::uint64_t ticksPerSecond = 0;  // 0: by features, whose values are nanoseconds

  bool trigger(ArvDevice* device) const {
    GlibError error;
    if (ticksPerSecond > 0) {
      arv_device_write_register(device, kTimestampControl, kLatch, error.out());
    } else {
      arv_device_execute_command(device, "TimestampLatch", error.out());
    }
    return !error;
  }
  std::optional<std::int64_t> nanoseconds(ArvDevice* device) const {
    GlibError error;
    if (ticksPerSecond == 0) {
      const gint64 ns =
          arv_device_get_integer_feature_value(device, "TimestampLatchValue", error.out());
      return error ? std::nullopt : std::optional<std::int64_t>(ns);
    }
    std::array<std::uint8_t, 8> latched{};
    arv_device_read_memory(device, kTimestampLatched, latched.size(), latched.data(), error.out());
    if (error) return std::nullopt;
    std::uint64_t ticks = 0;
    for (const std::uint8_t byte : latched) ticks = ticks << 8 | byte;
    // As Aravis turns ticks to nanoseconds.
    return static_cast<std::int64_t>(ticks / ticksPerSecond * 1'000'000'000 +
                                     ticks % ticksPerSecond * 1'000'000'000 / ticksPerSecond);
  }
};

// Latches the device's clock between two readings of ours and keeps the quickest of `repeats`.
// False if the device cannot do it, or does not answer.
bool compareByLatch(ArvDevice* device, Link& link, const ClockLatch& latch, int repeats) {
  std::optional<Duration> shortest;
  TimePoint host;
  std::int64_t ns = 0;
  for (int i = 0; i < repeats; ++i) {
    const TimePoint before = Clock::now();
    if (!latch.trigger(device)) return false;
    const TimePoint after = Clock::now();
    const auto latched = latch.nanoseconds(device);
    if (!latched) return false;
    if (shortest && after - before >= *shortest) continue;
    shortest = after - before;
    host = before + *shortest / 2;
    ns = *latched;
  }
  // The latch fell anywhere within the round trip: a uniform distribution's sigma.
  const Duration sigma = fromSeconds(toSeconds(*shortest) / (2 * std::numbers::sqrt3));
  const std::lock_guard lock(link.mutex);
  link.clock.compared(ns, host, sigma);
  return true;
}

// Keeps the clocks compared and notices early when a camera is gone: Aravis alone needs 6 to 10 s
// for GigE. A camera that is silent for as long as its heartbeat allows has dropped us anyway; one
// that answers and sends nothing has to be started again.
void watch(std::stop_token stop, ArvDevice* device, Link& link, const std::string& target,
           const std::optional<ClockLatch>& latch) {
  std::mutex mutex;
  std::condition_variable_any wake;
  std::unique_lock lock(mutex);
  while (!wake.wait_for(lock, stop, kWatchInterval, [&] { return stop.stop_requested(); })) {
    if (isIpv4Address(target) && probeCameras({&target, 1}, kHeartbeat).empty()) {
      return link.end(kGone);
    }
    bool silent;
    {
      const std::lock_guard linkLock(link.mutex);
      silent = !link.announced.triggered &&
               Clock::now() - link.lastArrival >
                   kSilence + 2 * fromSeconds(link.exposures.current().seconds);
    }
    if (silent) return link.end("the camera answers, but sends no frames any more");
    // The feature tree is not ours alone; there is another time.
    std::unique_lock control(link.control, std::defer_lock);
    if (latch && (latch->ticksPerSecond > 0 || control.try_lock())) {
      compareByLatch(device, link, *latch, kComparisons);
    }
  }
}

// What the system grants of a socket buffer, bytes.
std::uint64_t grantedSocketBuffer() {
  const int probe = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (probe < 0) return 0;
  int size = kSocketBufferBytes;
  socklen_t length = sizeof size;
  ::setsockopt(probe, SOL_SOCKET, SO_RCVBUF, &size, length);
  ::getsockopt(probe, SOL_SOCKET, SO_RCVBUF, &size, &length);
  ::close(probe);
  return static_cast<std::uint64_t>(size) / 2;  // Linux counts its own bookkeeping twice
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
    setUp();
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
  std::vector<std::string> notes() const override;
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

  void setUp();
  Result<void> setFormat(PixelFormat format);
  Result<void> setRegion(const Region& wanted);
  Result<void> setExposure(std::optional<double> seconds, std::optional<double> gainDb);
  Result<void> setFrameRate(double framesPerSecond);
  Result<void> setTrigger(const std::string& source);
  Result<CameraSettings> settings() const;
  Result<Announced> announced() const;
  Ref<ArvChunkParser> enableChunks();
  bool available(const char* feature) const {
    return arv_device_is_feature_available(device(), feature, nullptr) != FALSE;
  }
  Result<ExposureSetting> exposure() const;
  void addPacketCounts(StreamStatistics& statistics, ArvStream* stream) const;

  const std::string target_;
  const CameraInfo info_;
  Ref<ArvCamera> camera_;
  const std::shared_ptr<Link> link_;
  int packetBytes_ = 0;  // GigE Vision only, so is
  std::uint64_t socketBuffer_ = 0;
  gulong controlLost_ = 0;

  std::optional<Stream> stream_;  // Guarded by link_->control.
};

// What serves every stream.
void AravisCamera::setUp() {
  GlibError error;  // without any of this it works as well
  if (arv_camera_is_gv_device(camera_.get())) {
    // Fewer and larger packets where the network takes them.
    packetBytes_ = static_cast<int>(arv_camera_gv_auto_packet_size(camera_.get(), error.out()));
    socketBuffer_ = grantedSocketBuffer();
  }
  // A clock that follows others' is latched as any; but cameras then drift together.
  for (const char* const feature : {"PtpEnable", "GevIEEE1588"}) {
    if (available(feature)) arv_camera_set_boolean(camera_.get(), feature, TRUE, error.out());
  }
}

// The plain kind of the format, or one of its packed ones where the camera has no other.
Result<void> AravisCamera::setFormat(PixelFormat format) {
  GlibError error;
  std::string reason;
  for (const WireFormat& wire : wireFormatsOf(format)) {
    const std::string name(wire.name);
    arv_camera_set_pixel_format_from_string(camera_.get(), name.c_str(), error.out());
    if (!error) return {};
    if (reason.empty()) reason = error.message();
  }
  guint count = 0;
  const char** names =
      arv_camera_dup_available_pixel_formats_as_strings(camera_.get(), &count, error.out());
  std::string offered;
  for (guint i = 0; i < count; ++i) offered += (i == 0 ? "" : ", ") + orEmpty(names[i]);
  g_free(names);
  return failure(ErrorCode::kInvalidArgument, "{}: cannot set pixel format {} ({}); it offers {}",
                 info_.address, pixelFormatInfo(format).name, reason, offered);
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

Result<void> AravisCamera::setTrigger(const std::string& source) {
  GlibError error;
  const auto set = [&](const char* feature, const char* value) {
    if (!error) arv_camera_set_string(camera_.get(), feature, value, error.out());
  };
  if (!available("TriggerMode")) {
    if (source.empty()) return {};
    return failure(ErrorCode::kUnsupported, "{}: has no trigger; let it run freely", info_.address);
  }
  if (available("TriggerSelector")) set("TriggerSelector", "FrameStart");
  set("TriggerMode", source.empty() ? "Off" : "On");
  if (!source.empty()) {
    set("TriggerSource", source.c_str());
    if (available("TriggerActivation") && source != "Software") {
      set("TriggerActivation", "RisingEdge");
    }
  }
  if (!error) return {};
  const std::string reason(error.message());
  guint count = 0;
  const char** names = arv_camera_dup_available_trigger_sources(camera_.get(), &count, error.out());
  std::string offered;
  for (guint i = 0; i < count; ++i) offered += (i == 0 ? "" : ", ") + orEmpty(names[i]);
  g_free(names);
  arv_camera_set_string(camera_.get(), "TriggerMode", "Off", error.out());
  return failure(ErrorCode::kInvalidArgument, "{}: cannot wait for '{}' ({}); it offers {}",
                 info_.address, source, reason, offered);
}

Result<Announced> AravisCamera::announced() const {
  GlibError error;
  Announced stream;
  const ArvPixelFormat code = arv_camera_get_pixel_format(camera_.get(), error.out());
  if (error) return failed("read the pixel format", error);
  const auto format = wireFormatFromCode(code);
  if (!format) {
    return failure(ErrorCode::kUnsupported,
                   "{}: sends pixel format {:#010x}, which is not supported; choose another, such "
                   "as Mono8 or BayerRG12",
                   info_.address, code);
  }
  stream.format = *format;
  Region& region = stream.region;
  arv_camera_get_region(camera_.get(), &region.x, &region.y, &region.width, &region.height,
                        error.out());
  if (error) return failed("read the region", error);
  if (available("TriggerMode")) {
    const char* const mode = arv_camera_get_string(camera_.get(), "TriggerMode", error.out());
    stream.triggered = !error && orEmpty(mode) == "On";
  }
  if (packetBytes_ > 0) stream.block = static_cast<std::size_t>(packetBytes_) - kPacketHeaders;
  return stream;
}

// Exposure, gain and checksum of each frame, as far as the camera has them.
Ref<ArvChunkParser> AravisCamera::enableChunks() {
  GlibError error;
  if (!arv_camera_are_chunks_available(camera_.get(), error.out()) || error) return nullptr;
  arv_camera_set_chunk_mode(camera_.get(), TRUE, error.out());
  if (error) return nullptr;
  for (const char* const chunk : kChunks) {
    arv_camera_set_chunk_state(camera_.get(), chunk, TRUE, error.out());  // not all have all
  }
  return Ref<ArvChunkParser>(arv_camera_create_chunk_parser(camera_.get()));
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
  ASSIGN_OR_RETURN(const Announced stream, announced());
  settings.format = stream.format.format;
  settings.region = stream.region;
  settings.trigger =
      stream.triggered ? orEmpty(arv_camera_get_trigger_source(camera_.get(), error.out())) : "";
  if (error) return failed("read the trigger", error);
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
  const std::lock_guard lock(link_->control);
  if (stream_ && (wanted.format || wanted.region || wanted.framesPerSecond || wanted.trigger)) {
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
  if (wanted.trigger) RETURN_IF_ERROR(setTrigger(*wanted.trigger));
  return settings();
}

Result<void> AravisCamera::start(FrameCallback onFrame, EndCallback onEnd) {
  RETURN_IF_ERROR(checkAlive());
  const std::lock_guard lock(link_->control);
  if (stream_) {
    return failure(ErrorCode::kInvalidArgument, "{}: streams already", info_.address);
  }
  ASSIGN_OR_RETURN(const ExposureSetting setting, exposure());
  GlibError error;
  arv_camera_set_acquisition_mode(camera_.get(), ARV_ACQUISITION_MODE_CONTINUOUS, error.out());
  if (error) return failed("set continuous acquisition", error);
  Ref<ArvChunkParser> parser = enableChunks();
  ASSIGN_OR_RETURN(const Announced stream, announced());
  link_->begin(stream, setting);

  // A first mapping of the clocks, before frames load the link.
  const bool gige = arv_camera_is_gv_device(camera_.get()) != FALSE;
  std::optional<ClockLatch> latch{std::in_place};
  if (gige) {
    latch->ticksPerSecond =
        arv_gv_device_get_timestamp_tick_frequency(ARV_GV_DEVICE(device()), error.out());
  }
  if ((gige && latch->ticksPerSecond == 0) ||
      !compareByLatch(device(), *link_, *latch, kFirstComparisons)) {
    latch.reset();
  }

  // The packet socket has a race that lets foreign packets in; the default buffer loses packets.
  if (gige) {
    arv_camera_gv_set_stream_options(camera_.get(), ARV_GV_STREAM_OPTION_PACKET_SOCKET_DISABLED);
  }
  auto* const context = new StreamContext{link_, std::move(parser)};
  Stream running;
  running.stream.reset(arv_camera_create_stream_full(
      camera_.get(), onStreamEvent, context,
      [](void* own) { delete static_cast<StreamContext*>(own); }, error.out()));
  if (!running.stream) return failed("open a stream", error);
  context->stream = running.stream.get();
  if (gige) {
    g_object_set(running.stream.get(), "socket-buffer", ARV_GV_STREAM_SOCKET_BUFFER_FIXED,
                 "socket-buffer-size", kSocketBufferBytes, "frame-retention", kFrameRetentionUs,
                 nullptr);
  }
  const guint payload = arv_camera_get_payload(camera_.get(), error.out());
  if (error) return failed("read the size of a frame", error);
  // Frames wait for packets that are sent again while others begin.
  const guint buffers = std::clamp(kBufferBytes / std::max(payload, 1u), kMinBuffers, kMaxBuffers);
  for (guint i = 0; i < buffers; ++i) {
    markAndPush(running.stream.get(), arv_buffer_new_allocate(payload), stream.block);
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

  running.watch =
      std::jthread([own = device(), link = link_, target = target_, latch](std::stop_token stop) {
        watch(stop, own, *link, target, latch);
      });
  stream_ = std::move(running);
  return {};
}

void AravisCamera::stop() {
  {
    const std::lock_guard lock(link_->callbackMutex);
    link_->onFrame = nullptr;
    link_->onEnd = nullptr;
  }
  const std::lock_guard lock(link_->control);
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
  statistics.packetBytes = packetBytes_;
  statistics.socketBuffer = socketBuffer_;
}

StreamStatistics AravisCamera::statistics() const {
  const std::lock_guard lock(link_->control);
  const std::lock_guard linkLock(link_->mutex);
  StreamStatistics statistics = link_->statistics;
  if (stream_) addPacketCounts(statistics, stream_->stream.get());
  return statistics;
}

std::vector<std::string> AravisCamera::notes() const {
  std::vector<std::string> notes;
  if (socketBuffer_ != 0 && socketBuffer_ < kSocketBufferBytes) {
    notes.push_back(fmt::format(
        "{}: the system keeps its socket buffer at {} of {} KiB, so that a busy computer loses "
        "packets; raise it with: sudo sysctl net.core.rmem_max={}",
        info_.address, socketBuffer_ / 1024, kSocketBufferBytes / 1024, kSocketBufferBytes));
  }
  const std::lock_guard lock(link_->mutex);
  if (link_->clock.latchDisbelieved()) {
    notes.push_back(info_.address +
                    ": the times of its frames are not of the clock that it shows; frames are "
                    "timed by their arrival, which is less certain");
  }
  return notes;
}

bool AravisCamera::hasFeature(const std::string& name) const {
  const std::lock_guard lock(link_->control);
  GlibError error;
  return arv_camera_is_feature_available(camera_.get(), name.c_str(), error.out()) != FALSE;
}

Result<void> AravisCamera::setFeature(const std::string& name, double value) {
  RETURN_IF_ERROR(checkAlive());
  const std::lock_guard lock(link_->control);
  GlibError error;
  ArvGcNode* const node = arv_device_get_feature(device(), name.c_str());
  if (ARV_IS_GC_COMMAND(node)) {
    arv_camera_execute_command(camera_.get(), name.c_str(), error.out());
  } else if (ARV_IS_GC_FLOAT(node)) {
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
  if (arv_camera_is_gv_device(camera.get())) {
    // A program that crashed holds it until the heartbeat is over.
    auto* const device = ARV_GV_DEVICE(arv_camera_get_device(camera.get()));
    const TimePoint end = Clock::now() + kHeartbeat + std::chrono::seconds(1);
    while (!arv_gv_device_is_controller(device) && !arv_gv_device_take_control(device, nullptr)) {
      if (Clock::now() > end) {
        return failure(ErrorCode::kDevice,
                       "aravis:{}: another program controls this camera; close that", address);
      }
      std::this_thread::sleep_for(kWatchInterval / 2);
    }
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
