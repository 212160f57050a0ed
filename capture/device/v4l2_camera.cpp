#include "capture/device/v4l2_camera.h"

#include <fcntl.h>
#include <linux/videodev2.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/ioctl.h>
#include <sys/mman.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cctype>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <future>
#include <limits>
#include <mutex>
#include <optional>
#include <set>
#include <thread>
#include <utility>

#include "capture/device/exposure_log.h"
#include "capture/device/v4l2_pixels.h"
#include "capture/device/v4l2_time.h"
#include "capture/frame/descriptor.h"

namespace lightsketch {
namespace {

namespace fs = std::filesystem;

constexpr std::uint32_t kBuffers = 8;  // each is copied out and handed back at once
constexpr auto kTick = std::chrono::milliseconds(200);
// A camera that runs freely and sends nothing for so long, beside the time that its frames take,
// does not come back by itself; as AravisCamera's heartbeat.
constexpr auto kSilence = std::chrono::seconds(3);
constexpr auto kStopPatience = std::chrono::seconds(1);
constexpr int kSettlingFrames = 3;  // UVC tells nothing about when a control takes effect
constexpr int kErrorsInARow = 10;
constexpr double kExposureUnit = 1e-4;  // s, of V4L2_CID_EXPOSURE_ABSOLUTE

// Which automatic overrules a control, and its value for "by hand".
struct Automatic {
  std::uint32_t manual;
  std::uint32_t automatic;
  int off;
};
constexpr std::array<Automatic, 9> kAutomatics{{
    {V4L2_CID_EXPOSURE_ABSOLUTE, V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_MANUAL},
    // Else the camera may give frames a longer exposure than their interval has room for.
    {V4L2_CID_EXPOSURE_ABSOLUTE, V4L2_CID_EXPOSURE_AUTO_PRIORITY, 0},
    {V4L2_CID_EXPOSURE, V4L2_CID_EXPOSURE_AUTO, V4L2_EXPOSURE_MANUAL},
    {V4L2_CID_GAIN, V4L2_CID_AUTOGAIN, 0},
    {V4L2_CID_WHITE_BALANCE_TEMPERATURE, V4L2_CID_AUTO_WHITE_BALANCE, 0},
    {V4L2_CID_RED_BALANCE, V4L2_CID_AUTO_WHITE_BALANCE, 0},
    {V4L2_CID_BLUE_BALANCE, V4L2_CID_AUTO_WHITE_BALANCE, 0},
    {V4L2_CID_BRIGHTNESS, V4L2_CID_AUTOBRIGHTNESS, 0},
    {V4L2_CID_FOCUS_ABSOLUTE, V4L2_CID_FOCUS_AUTO, 0},
}};

// 0, or what went wrong.
int request(int fd, unsigned long what, void* argument) {
  int result = 0;
  do {
    result = ::ioctl(fd, what, argument);
  } while (result < 0 && errno == EINTR);
  return result < 0 ? errno : 0;
}

std::string explain(int error) {
  switch (error) {
    case EBUSY:
      return "another program uses this camera; close that";
    case EACCES:
    case EPERM:
      return "not allowed; add yourself to the group 'video'";
    case ENODEV:
    case ENXIO:
      return "the camera is gone (unplugged or switched off)";
    case EIO:
      return "the driver reports that the camera or its link failed; plug it in again";
    default:
      return std::strerror(error);
  }
}

// As v4l2-ctl names controls: "Exposure Time, Absolute" is exposure_time_absolute.
std::string featureName(const char* control) {
  std::string name;
  for (const char* c = control; *c != 0; ++c) {
    if (std::isalnum(static_cast<unsigned char>(*c))) {
      name += static_cast<char>(std::tolower(static_cast<unsigned char>(*c)));
    } else if (!name.empty() && name.back() != '_') {
      name += '_';
    }
  }
  if (name.ends_with('_')) name.pop_back();
  return name;
}

std::optional<v4l2_queryctrl> findControl(int fd, std::uint32_t id) {
  v4l2_queryctrl control{};
  control.id = id;
  if (request(fd, VIDIOC_QUERYCTRL, &control) != 0) return std::nullopt;
  if ((control.flags & V4L2_CTRL_FLAG_DISABLED) != 0) return std::nullopt;
  return control;
}

std::optional<v4l2_queryctrl> findControl(int fd, const std::string& name) {
  v4l2_queryctrl control{};
  do {
    control.id |= V4L2_CTRL_FLAG_NEXT_CTRL;
    if (request(fd, VIDIOC_QUERYCTRL, &control) != 0) return std::nullopt;
  } while (control.type == V4L2_CTRL_TYPE_CTRL_CLASS ||
           featureName(reinterpret_cast<const char*>(control.name)) != name);
  return control;
}

bool sendsPictures(const v4l2_capability& capability) {
  const std::uint32_t has = (capability.capabilities & V4L2_CAP_DEVICE_CAPS) != 0
                                ? capability.device_caps
                                : capability.capabilities;
  return (has & V4L2_CAP_VIDEO_CAPTURE) != 0 && (has & V4L2_CAP_STREAMING) != 0;
}

CameraInfo infoOf(const std::string& path, const v4l2_capability& capability) {
  CameraInfo info;
  info.address = "v4l2:" + path;
  info.vendor = reinterpret_cast<const char*>(capability.driver);
  info.model = reinterpret_cast<const char*>(capability.card);
  info.serial = reinterpret_cast<const char*>(capability.bus_info);
  // A USB camera's own words, where it has them.
  std::error_code error;
  const fs::path node = fs::canonical(path, error);
  const fs::path usb = fs::path("/sys/class/video4linux") / node.filename() / "device" / "..";
  const auto read = [&](const char* file, std::string& into) {
    std::ifstream in(usb / file);
    for (std::string line; std::getline(in, line) && !line.empty();) into = line;
  };
  read("manufacturer", info.vendor);
  read("serial", info.serial);
  return info;
}

// What uvcvideo calls start of exposure is the arrival of the first packet, unless it was told to
// trust the camera's clock (read: uvc_video_clock_update).
V4l2Stamp stampOf(const v4l2_buffer& buffer, bool uvcWithoutClock) {
  if ((buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) != V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC) {
    return V4l2Stamp::kNone;
  }
  if ((buffer.flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK) != V4L2_BUF_FLAG_TSTAMP_SRC_SOE) {
    return V4l2Stamp::kFrameEnd;
  }
  return uvcWithoutClock ? V4l2Stamp::kReadoutStart : V4l2Stamp::kExposureStart;
}

bool isUvcWithoutClock(const v4l2_capability& capability) {
  if (std::strcmp(reinterpret_cast<const char*>(capability.driver), "uvcvideo") != 0) return false;
  std::ifstream parameter("/sys/module/uvcvideo/parameters/hwtimestamps");
  return parameter.get() != '1';
}

// What the stream's thread works on. Shared with it, because a camera that does not answer is
// closed in the background and may outlive the Camera object.
struct Link {
  Link(std::string cameraAddress, Descriptor cameraNode)
      : address(std::move(cameraAddress)), node(std::move(cameraNode)) {}

  const std::string address;
  const Descriptor node;
  std::atomic<bool> lost = false;

  std::mutex callbackMutex;  // Guards the callbacks, and is held while one runs.
  FrameCallback onFrame;
  EndCallback onEnd;

  std::mutex mutex;  // Guards the following.
  StreamStatistics statistics;
  ExposureLog exposures{kSettlingFrames};
  bool warmedUp = false;  // the first frame of a session is often broken: it is dropped
  std::optional<std::uint64_t> lastId;  // unwrapped

  int fd() const { return node.get(); }
  bool acceptSequence(std::uint32_t sequence);
  void end(const std::string& why);
};

// Unwraps a frame's number, counts what is missing before it. Caller holds the mutex.
bool Link::acceptSequence(std::uint32_t sequence) {
  if (!lastId) {
    lastId = sequence;
    return true;
  }
  const std::uint32_t step = sequence - static_cast<std::uint32_t>(*lastId);
  if (step == 0 || step > std::numeric_limits<std::uint32_t>::max() / 2) return false;
  statistics.lost += step - 1;
  *lastId += step;
  return true;
}

void Link::end(const std::string& why) {
  if (lost.exchange(true)) return;
  const std::lock_guard lock(callbackMutex);
  if (onEnd) onEnd(Error{ErrorCode::kDevice, address + ": " + why});
}

// The driver's buffers, queued, and the stream switched on; the other way round at the end.
class Buffers {
 public:
  static Result<std::unique_ptr<Buffers>> create(std::shared_ptr<Link> link);
  Buffers(const Buffers&) = delete;
  Buffers& operator=(const Buffers&) = delete;
  ~Buffers() {
    int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    request(link_->fd(), VIDIOC_STREAMOFF, &type);
    for (const auto& memory : memory_) {
      ::munmap(const_cast<std::uint8_t*>(memory.data()), memory.size());
    }
    v4l2_requestbuffers none{};
    none.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    none.memory = V4L2_MEMORY_MMAP;
    request(link_->fd(), VIDIOC_REQBUFS, &none);
  }

  int take(v4l2_buffer& buffer) const {
    buffer = {};
    buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    buffer.memory = V4L2_MEMORY_MMAP;
    return request(link_->fd(), VIDIOC_DQBUF, &buffer);
  }
  std::span<const std::uint8_t> bytes(const v4l2_buffer& buffer) const {
    const auto memory = memory_[buffer.index];
    return memory.first(std::min<std::size_t>(memory.size(), buffer.bytesused));
  }
  // A driver may refuse for once: what it did not take is offered again with the next.
  void giveBack(const v4l2_buffer& buffer) {
    waiting_.push_back(buffer);
    std::erase_if(waiting_,
                  [this](v4l2_buffer& b) { return request(link_->fd(), VIDIOC_QBUF, &b) == 0; });
  }

 private:
  explicit Buffers(std::shared_ptr<Link> link) : link_(std::move(link)) {}

  const std::shared_ptr<Link> link_;
  std::vector<std::span<const std::uint8_t>> memory_;
  std::vector<v4l2_buffer> waiting_;
};

Result<std::unique_ptr<Buffers>> Buffers::create(std::shared_ptr<Link> link) {
  const auto failed = [&](std::string_view what, int error) {
    return failure(ErrorCode::kDevice, "{}: cannot {}: {}", link->address, what, explain(error));
  };
  std::unique_ptr<Buffers> buffers(new Buffers(link));
  v4l2_requestbuffers wanted{};
  wanted.count = kBuffers;
  wanted.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  wanted.memory = V4L2_MEMORY_MMAP;
  if (const int e = request(link->fd(), VIDIOC_REQBUFS, &wanted)) return failed("get buffers", e);
  for (std::uint32_t i = 0; i < wanted.count; ++i) {
    v4l2_buffer buffer{};
    buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    buffer.memory = V4L2_MEMORY_MMAP;
    buffer.index = i;
    if (const int e = request(link->fd(), VIDIOC_QUERYBUF, &buffer)) {
      return failed("get a buffer", e);
    }
    void* const memory = ::mmap(nullptr, buffer.length, PROT_READ | PROT_WRITE, MAP_SHARED,
                                link->fd(), buffer.m.offset);
    if (memory == MAP_FAILED) return failed("map a buffer", errno);
    buffers->memory_.emplace_back(static_cast<const std::uint8_t*>(memory), buffer.length);
    if (const int e = request(link->fd(), VIDIOC_QBUF, &buffer)) return failed("queue a buffer", e);
  }
  int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  if (const int e = request(link->fd(), VIDIOC_STREAMON, &type)) return failed("start", e);
  return buffers;
}

V4l2Layout layoutOf(const v4l2_pix_format& format) {
  std::uint32_t encoding = format.ycbcr_enc;
  if (encoding == V4L2_YCBCR_ENC_DEFAULT) encoding = V4L2_MAP_YCBCR_ENC_DEFAULT(format.colorspace);
  std::uint32_t range = format.quantization;
  if (range == V4L2_QUANTIZATION_DEFAULT) {
    range = V4L2_MAP_QUANTIZATION_DEFAULT(false, format.colorspace, encoding);
  }
  return {static_cast<int>(format.width), static_cast<int>(format.height),
          static_cast<int>(format.bytesperline), encoding == V4L2_YCBCR_ENC_709,
          range == V4L2_QUANTIZATION_FULL_RANGE};
}

// What does not change while a stream runs.
struct StreamPlan {
  V4l2Conversion conversion;
  V4l2Layout layout;
  Duration interval{0};
  bool uvcWithoutClock = false;
};

// Caller holds the link's mutex.
std::optional<Frame> makeFrame(Link& link, const StreamPlan& plan, const v4l2_buffer& buffer,
                               std::span<const std::uint8_t> bytes, TimePoint arrival) {
  const bool warmUp = !std::exchange(link.warmedUp, true);
  const bool inOrder = link.acceptSequence(buffer.sequence);
  if (warmUp) {
    ++link.statistics.skipped;
    return {};
  }
  Frame frame;
  if (!inOrder || (buffer.flags & V4L2_BUF_FLAG_ERROR) != 0 ||
      !unpackV4l2(plan.conversion, plan.layout, bytes, frame)) {
    ++link.statistics.incomplete;
    return {};
  }
  const Duration stamp = std::chrono::seconds(buffer.timestamp.tv_sec) +
                         std::chrono::microseconds(buffer.timestamp.tv_usec);
  const auto timeWith = [&](double exposureSeconds) {
    return v4l2FrameTime(stampOf(buffer, plan.uvcWithoutClock), TimePoint(stamp), arrival,
                         fromSeconds(exposureSeconds), plan.interval);
  };
  // Nobody tells when a control takes effect: what was still on its way when it was set is in
  // doubt.
  const V4l2FrameTime assumed = timeWith(link.exposures.current().seconds);
  const auto exposure = link.exposures.of(assumed.exposureStart, assumed.sigma);
  if (!exposure || link.exposures.isChangingAt(arrival)) {
    ++link.statistics.skipped;
    return {};
  }
  const V4l2FrameTime time = timeWith(exposure->seconds);
  FrameMetadata& metadata = frame.metadata;
  metadata.id = *link.lastId;
  metadata.deviceTimeNs = stamp.count();
  metadata.midExposure = time.exposureStart + fromSeconds(exposure->seconds / 2);
  metadata.timeUncertainty = time.sigma;
  metadata.arrival = arrival;
  metadata.exposureSeconds = exposure->seconds;
  metadata.gainDb = exposure->gainDb;
  return frame;
}

void deliver(Link& link, Frame&& frame) {
  const std::lock_guard callbackLock(link.callbackMutex);
  if (!link.onFrame) return;
  {
    const std::lock_guard lock(link.mutex);
    ++link.statistics.delivered;
  }
  link.onFrame(std::move(frame));
}

// Until told to stop or the camera is lost. Never waits in the driver.
void receive(Link& link, const StreamPlan& plan, Buffers& buffers, int stop) {
  TimePoint latest = Clock::now();
  int errors = 0;
  while (true) {
    std::array<pollfd, 2> events{{{link.fd(), POLLIN, 0}, {stop, POLLIN, 0}}};
    ::poll(events.data(), events.size(), static_cast<int>(kTick.count()));
    if (events[1].revents != 0) return;

    v4l2_buffer buffer;
    const int error = events[0].revents == 0 ? EAGAIN : buffers.take(buffer);
    if (error == 0) {
      const TimePoint arrival = latest = Clock::now();
      errors = 0;
      std::optional<Frame> frame;
      {
        const std::lock_guard lock(link.mutex);
        frame = makeFrame(link, plan, buffer, buffers.bytes(buffer), arrival);
      }
      buffers.giveBack(buffer);
      if (frame) deliver(link, std::move(*frame));
    } else if (error == EAGAIN && (events[0].revents & (POLLERR | POLLHUP)) == 0) {
      const Duration exposure = [&] {
        const std::lock_guard lock(link.mutex);
        return fromSeconds(link.exposures.current().seconds);
      }();
      if (Clock::now() - latest > kSilence + exposure + 4 * plan.interval) {
        return link.end("the camera sends no frames any more; unplug it and plug it in again");
      }
    } else if (error == EIO || error == ENODEV || ++errors == kErrorsInARow) {
      return link.end(explain(error == EAGAIN ? EIO : error));
    }
  }
}

// The stream with what it needs while it runs.
struct Stream {
  Descriptor stop;  // an eventfd
  std::future<void> done;
  std::thread thread;
};

class V4l2Camera final : public Camera {
 public:
  V4l2Camera(std::shared_ptr<Link> link, CameraInfo info, bool uvcWithoutClock)
      : link_(std::move(link)), info_(std::move(info)), uvcWithoutClock_(uvcWithoutClock) {}
  ~V4l2Camera() override { stop(); }

  // Chooses the best format; `only` is the driver's format that the user insists on.
  Result<void> prepare(const std::string& only);

  const CameraInfo& info() const override { return info_; }
  Result<CameraSettings> configure(const CameraSettings& wanted) override;
  Result<void> start(FrameCallback onFrame, EndCallback onEnd) override;
  void stop() override;
  StreamStatistics statistics() const override {
    const std::lock_guard lock(link_->mutex);
    return link_->statistics;
  }
  std::vector<std::string> notes() const override;
  bool hasFeature(const std::string& name) const override {
    return findControl(link_->fd(), name).has_value();
  }
  Result<void> setFeature(const std::string& name, double value) override;

 private:
  int fd() const { return link_->fd(); }
  tl::unexpected<Error> failed(std::string_view what, int error) const {
    return failure(ErrorCode::kDevice, "{}: cannot {}: {}", info_.address, what, explain(error));
  }
  Result<void> checkAlive() const {
    if (!link_->lost) return {};
    return failure(ErrorCode::kDevice, "{}: the camera was lost; open it again", info_.address);
  }
  bool streams() const {
    const std::lock_guard lock(streamMutex_);
    return stream_.has_value();
  }

  std::vector<std::pair<int, int>> sizes(std::uint32_t fourcc) const;
  double fastest(std::uint32_t fourcc, int width, int height) const;
  bool canSend(std::uint32_t fourcc, int width, int height) const;
  Result<void> setFormat(const V4l2Conversion& conversion, int width, int height);
  Result<void> choose(PixelFormat format, const std::optional<Region>& region);
  void setFrameRate();
  Result<void> setControl(const v4l2_queryctrl& control, long long value);
  Result<void> setExposure(std::optional<double> seconds, std::optional<double> gainDb);
  ExposureSetting exposure() const;
  Result<CameraSettings> settings() const;

  const std::shared_ptr<Link> link_;
  const CameraInfo info_;
  const bool uvcWithoutClock_;

  mutable std::mutex control_;  // Guards the following.
  std::vector<V4l2Conversion> offered_;
  V4l2Conversion conversion_{};
  v4l2_pix_format format_{};
  std::optional<double> wantedRate_;
  double rate_ = 0;            // 0: the driver does not say
  std::string refusedFormat_;  // that would have been better

  mutable std::mutex streamMutex_;  // Guards stream_.
  std::optional<Stream> stream_;
};

std::vector<std::pair<int, int>> V4l2Camera::sizes(std::uint32_t fourcc) const {
  std::vector<std::pair<int, int>> sizes;
  v4l2_frmsizeenum size{};
  size.pixel_format = fourcc;
  for (; request(fd(), VIDIOC_ENUM_FRAMESIZES, &size) == 0; ++size.index) {
    if (size.type != V4L2_FRMSIZE_TYPE_DISCRETE) {
      return {{size.stepwise.max_width, size.stepwise.max_height}};
    }
    sizes.emplace_back(size.discrete.width, size.discrete.height);
  }
  std::ranges::sort(sizes, {}, [](const auto& s) { return s.first * s.second; });
  return sizes;
}

// Frames a second; infinite if the driver does not say.
double V4l2Camera::fastest(std::uint32_t fourcc, int width, int height) const {
  v4l2_frmivalenum interval{};
  interval.pixel_format = fourcc;
  interval.width = static_cast<std::uint32_t>(width);
  interval.height = static_cast<std::uint32_t>(height);
  double rate = 0;
  for (; request(fd(), VIDIOC_ENUM_FRAMEINTERVALS, &interval) == 0; ++interval.index) {
    const bool discrete = interval.type == V4L2_FRMIVAL_TYPE_DISCRETE;
    const v4l2_fract least = discrete ? interval.discrete : interval.stepwise.min;
    rate = std::max(rate, static_cast<double>(least.denominator) / least.numerator);
    if (!discrete) break;
  }
  return rate > 0 ? rate : std::numeric_limits<double>::infinity();
}

bool V4l2Camera::canSend(std::uint32_t fourcc, int width, int height) const {
  v4l2_format format{};
  format.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  format.fmt.pix.width = static_cast<std::uint32_t>(width);
  format.fmt.pix.height = static_cast<std::uint32_t>(height);
  format.fmt.pix.pixelformat = fourcc;
  format.fmt.pix.field = V4L2_FIELD_NONE;
  return request(fd(), VIDIOC_TRY_FMT, &format) == 0 && format.fmt.pix.pixelformat == fourcc &&
         format.fmt.pix.width == static_cast<std::uint32_t>(width) &&
         format.fmt.pix.height == static_cast<std::uint32_t>(height);
}

Result<void> V4l2Camera::setFormat(const V4l2Conversion& conversion, int width, int height) {
  v4l2_format format{};
  format.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  format.fmt.pix.width = static_cast<std::uint32_t>(width);
  format.fmt.pix.height = static_cast<std::uint32_t>(height);
  format.fmt.pix.pixelformat = conversion.fourcc;
  format.fmt.pix.field = V4L2_FIELD_NONE;
  const std::string name = fourccName(conversion.fourcc);
  if (const int error = request(fd(), VIDIOC_S_FMT, &format)) {
    return failed("set the format " + name, error);
  }
  // A driver that cannot do it takes something else without a word.
  if (format.fmt.pix.pixelformat != conversion.fourcc) {
    return failure(ErrorCode::kDevice, "{}: asked for {}, the driver took {} instead",
                   info_.address, name, fourccName(format.fmt.pix.pixelformat));
  }
  if (format.fmt.pix.field != V4L2_FIELD_NONE) {
    return failure(ErrorCode::kUnsupported,
                   "{}: sends interlaced pictures, of which each is two moments", info_.address);
  }
  format_ = format.fmt.pix;
  conversion_ = conversion;
  setFrameRate();  // which the format may have changed
  return {};
}

Result<void> V4l2Camera::prepare(const std::string& only) {
  std::string sent;
  v4l2_fmtdesc description{};
  description.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  std::vector<std::uint32_t> fourccs;
  for (; request(fd(), VIDIOC_ENUM_FMT, &description) == 0; ++description.index) {
    const std::string name = fourccName(description.pixelformat);
    sent += (sent.empty() ? "" : ", ") + name;
    if (only.empty() || name == only) fourccs.push_back(description.pixelformat);
  }
  for (const V4l2Conversion& conversion : v4l2Conversions()) {
    if (std::ranges::find(fourccs, conversion.fourcc) != fourccs.end()) {
      offered_.push_back(conversion);
    }
  }
  if (offered_.empty()) {
    return failure(ErrorCode::kUnsupported, "{}: sends {}; {}", info_.address,
                   sent.empty() ? "nothing" : sent,
                   only.empty() ? "none of these is understood" : only + " was asked for");
  }
  v4l2_format now{};
  now.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  if (const int error = request(fd(), VIDIOC_G_FMT, &now)) return failed("read the format", error);
  Result<void> done;
  for (const V4l2Conversion& conversion : offered_) {
    done = setFormat(conversion, static_cast<int>(now.fmt.pix.width),
                     static_cast<int>(now.fmt.pix.height));
    if (done) return {};
    refusedFormat_ = done.error().message;
  }
  return done;
}

// The best of the driver's formats that become `format`, at a size and the wanted rate.
Result<void> V4l2Camera::choose(PixelFormat format, const std::optional<Region>& region) {
  std::vector<V4l2Conversion> candidates;
  std::string names;
  for (const V4l2Conversion& conversion : offered_) {
    const std::string name(pixelFormatInfo(conversion.format).name);
    if (conversion.format == format) candidates.push_back(conversion);
    if (names.find(name + ",") == std::string::npos) names += name + ", ";
  }
  names.resize(names.size() - 2);
  if (candidates.empty()) {
    return failure(ErrorCode::kInvalidArgument, "{}: cannot set pixel format {}; it offers {}",
                   info_.address, pixelFormatInfo(format).name, names);
  }
  if (region && (region->x != 0 || region->y != 0)) {
    return failure(ErrorCode::kInvalidArgument,
                   "{}: has picture sizes, but no regions; x and y must be 0", info_.address);
  }

  // The largest, which only differs where the whole sensor is asked for; of these the first that is
  // fast enough, or else the fastest.
  const V4l2Conversion* best = nullptr;
  std::pair<int, int> bestSize;
  double bestRate = 0;
  std::set<std::pair<int, int>> allSizes;
  for (const V4l2Conversion& candidate : candidates) {
    const auto offered = sizes(candidate.fourcc);
    allSizes.insert(offered.begin(), offered.end());
    std::pair<int, int> size(static_cast<int>(format_.width), static_cast<int>(format_.height));
    if (region == Region{} && !offered.empty()) size = offered.back();
    if (region && region != Region{}) size = {region->width, region->height};
    if (!canSend(candidate.fourcc, size.first, size.second)) continue;
    const double rate =
        std::min(fastest(candidate.fourcc, size.first, size.second), wantedRate_.value_or(1e-9));
    const int more = size.first * size.second - bestSize.first * bestSize.second;
    if (best == nullptr || more > 0 || (more == 0 && rate > bestRate * 1.01)) {
      best = &candidate;
      bestSize = size;
      bestRate = rate;
    }
  }
  if (best == nullptr) {
    std::string offered;
    for (const auto& [width, height] : allSizes) {
      offered += fmt::format("{}{}x{}", offered.empty() ? "" : ", ", width, height);
    }
    return failure(ErrorCode::kInvalidArgument, "{}: cannot send {}x{} pixels as {}; it offers {}",
                   info_.address, region ? region->width : static_cast<int>(format_.width),
                   region ? region->height : static_cast<int>(format_.height),
                   pixelFormatInfo(format).name, offered);
  }
  RETURN_IF_ERROR(setFormat(*best, bestSize.first, bestSize.second));
  refusedFormat_.clear();
  return {};
}

// What the driver makes of the wish is read back: it takes the nearest it can.
void V4l2Camera::setFrameRate() {
  v4l2_streamparm parameters{};
  parameters.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  rate_ = 0;
  if (request(fd(), VIDIOC_G_PARM, &parameters) != 0) return;
  v4l2_fract& interval = parameters.parm.capture.timeperframe;
  if (wantedRate_) {
    interval.numerator = 1000;
    interval.denominator = static_cast<std::uint32_t>(std::lround(1000 * *wantedRate_));
    if (request(fd(), VIDIOC_S_PARM, &parameters) != 0 &&
        request(fd(), VIDIOC_G_PARM, &parameters) != 0) {
      return;
    }
  }
  if (interval.numerator > 0) {
    rate_ = static_cast<double>(interval.denominator) / interval.numerator;
  }
}

Result<void> V4l2Camera::setControl(const v4l2_queryctrl& control, long long value) {
  const std::string name = featureName(reinterpret_cast<const char*>(control.name));
  for (const Automatic& overrules : kAutomatics) {
    if (overrules.manual != control.id) continue;
    const auto automatic = findControl(fd(), overrules.automatic);
    if (automatic) RETURN_IF_ERROR(setControl(*automatic, overrules.off));
  }
  if ((control.flags & V4L2_CTRL_FLAG_READ_ONLY) != 0) {
    return failure(ErrorCode::kInvalidArgument, "{}: {} can only be read", info_.address, name);
  }
  v4l2_control wanted{control.id, static_cast<std::int32_t>(value)};
  const bool isButton = control.type == V4L2_CTRL_TYPE_BUTTON;
  if (!isButton && (value < control.minimum || value > control.maximum)) {
    return failure(ErrorCode::kInvalidArgument, "{}: {} {} is outside the camera's {} to {}",
                   info_.address, name, value, control.minimum, control.maximum);
  }
  if (control.type == V4L2_CTRL_TYPE_INTEGER && control.step > 1) {
    const long long steps =
        std::llround(static_cast<double>(value - control.minimum) / control.step);
    wanted.value = std::min(static_cast<std::int32_t>(control.minimum + steps * control.step),
                            control.maximum);
  }
  if (const int error = request(fd(), VIDIOC_S_CTRL, &wanted)) {
    return failed(fmt::format("set {} to {}", name, value), error);
  }
  if (isButton || (control.flags & (V4L2_CTRL_FLAG_WRITE_ONLY | V4L2_CTRL_FLAG_VOLATILE |
                                    V4L2_CTRL_FLAG_EXECUTE_ON_WRITE)) != 0) {
    return {};
  }
  v4l2_control now{control.id, 0};
  if (const int error = request(fd(), VIDIOC_G_CTRL, &now)) return failed("read " + name, error);
  if (now.value == wanted.value) return {};
  return failure(ErrorCode::kDevice, "{}: {} was set to {}, the camera made it {}", info_.address,
                 name, wanted.value, now.value);
}

Result<void> V4l2Camera::setFeature(const std::string& name, double value) {
  RETURN_IF_ERROR(checkAlive());
  const std::lock_guard lock(control_);
  const auto control = findControl(fd(), name);
  if (!control)
    return failure(ErrorCode::kNotFound, "{}: has no control '{}'", info_.address, name);
  return setControl(*control, std::llround(std::clamp(value, -1e12, 1e12)));
}

Result<void> V4l2Camera::setExposure(std::optional<double> seconds, std::optional<double> gainDb) {
  const auto time = findControl(fd(), V4L2_CID_EXPOSURE_ABSOLUTE);
  const auto gain = findControl(fd(), V4L2_CID_GAIN);
  if (seconds && !time) {
    return failure(ErrorCode::kUnsupported, "{}: has no control of the exposure time",
                   info_.address);
  }
  if (seconds && !(*seconds >= kExposureUnit * (time->minimum - 0.5) &&
                   *seconds <= kExposureUnit * (time->maximum + 0.5))) {
    return failure(ErrorCode::kInvalidArgument,
                   "{}: an exposure of {} s is outside the camera's {:.6g} to {:.6g} s",
                   info_.address, *seconds, kExposureUnit * time->minimum,
                   kExposureUnit * time->maximum);
  }
  if (gainDb && *gainDb != 0) {
    return failure(ErrorCode::kInvalidArgument,
                   "{}: a gain of {} dB cannot be asked for: its gain has no unit; 0 is its least",
                   info_.address, *gainDb);
  }
  {
    const std::lock_guard lock(link_->mutex);
    link_->exposures.beginChange();
  }
  // What is set by hand must not be set by the camera, nor what would change colours from one frame
  // to the next.
  Result<void> done;
  if (const auto balance = findControl(fd(), V4L2_CID_AUTO_WHITE_BALANCE)) {
    done = setControl(*balance, 0);
  }
  if (seconds && done) done = setControl(*time, std::llround(*seconds / kExposureUnit));
  if (gainDb && gain && done) done = setControl(*gain, gain->minimum);
  const std::lock_guard lock(link_->mutex);
  link_->exposures.endChange(exposure());
  return done;
}

ExposureSetting V4l2Camera::exposure() const {
  v4l2_control time{V4L2_CID_EXPOSURE_ABSOLUTE, 0};
  if (request(fd(), VIDIOC_G_CTRL, &time) == 0) return {kExposureUnit * time.value, 0};
  return {rate_ > 0 ? 1 / rate_ : 0, 0};  // it cannot be longer
}

Result<CameraSettings> V4l2Camera::settings() const {
  RETURN_IF_ERROR(checkAlive());
  CameraSettings settings;
  settings.format = conversion_.format;
  settings.region = Region{0, 0, static_cast<int>(format_.width), static_cast<int>(format_.height)};
  const ExposureSetting now = exposure();
  settings.exposureSeconds = now.seconds;
  settings.gainDb = now.gainDb;
  settings.framesPerSecond = rate_;
  settings.trigger = "";
  return settings;
}

std::vector<std::string> V4l2Camera::notes() const {
  const std::lock_guard lock(control_);
  std::vector<std::string> notes;
  if (!refusedFormat_.empty()) notes.push_back(refusedFormat_);
  if (!conversion_.linear) {
    const std::string_view loss = conversion_.fourcc == V4L2_PIX_FMT_MJPEG ? ", with JPEG's loss"
                                  : conversion_.isExact                    ? ""
                                                        : ", colour shared by neighbours";
    notes.push_back(fmt::format("{}: {} from {}: 8 bits made for the eye{}", info_.address,
                                pixelFormatInfo(conversion_.format).name,
                                fourccName(conversion_.fourcc), loss));
  }
  if (wantedRate_ && !(std::abs(rate_ / *wantedRate_ - 1) < 0.01)) {
    notes.push_back(fmt::format("{}: {:.4g} frames/s were asked for, the camera makes {}",
                                info_.address, *wantedRate_,
                                rate_ > 0 ? fmt::format("{:.4g}", rate_) : "as many as it will"));
  }
  return notes;
}

Result<CameraSettings> V4l2Camera::configure(const CameraSettings& wanted) {
  RETURN_IF_ERROR(checkAlive());
  if (wanted.trigger.value_or("") != "") {
    return failure(ErrorCode::kUnsupported, "{}: V4L2 knows no trigger; the camera runs freely",
                   info_.address);
  }
  const std::lock_guard lock(control_);
  if (wanted.format || wanted.region || wanted.framesPerSecond) {
    if (streams()) {
      return failure(ErrorCode::kInvalidArgument,
                     "{}: only exposure and gain can change while streaming; stop the camera first",
                     info_.address);
    }
    if (wanted.framesPerSecond && !(*wanted.framesPerSecond > 0 && *wanted.framesPerSecond < 1e6)) {
      return failure(ErrorCode::kInvalidArgument, "{}: {} frames/s make no sense", info_.address,
                     *wanted.framesPerSecond);
    }
    if (wanted.framesPerSecond) wantedRate_ = wanted.framesPerSecond;
    RETURN_IF_ERROR(choose(wanted.format.value_or(conversion_.format), wanted.region));
  }
  if (wanted.exposureSeconds || wanted.gainDb) {
    RETURN_IF_ERROR(setExposure(wanted.exposureSeconds, wanted.gainDb));
  }
  return settings();
}

Result<void> V4l2Camera::start(FrameCallback onFrame, EndCallback onEnd) {
  RETURN_IF_ERROR(checkAlive());
  const std::lock_guard lock(control_);
  const std::lock_guard streamLock(streamMutex_);
  if (stream_) return failure(ErrorCode::kInvalidArgument, "{}: streams already", info_.address);
  {
    const std::lock_guard linkLock(link_->mutex);
    link_->statistics = {};
    link_->exposures.reset(exposure());
    link_->warmedUp = false;
    link_->lastId.reset();
  }
  const StreamPlan plan{conversion_, layoutOf(format_), fromSeconds(rate_ > 0 ? 1 / rate_ : 0),
                        uvcWithoutClock_};
  ASSIGN_OR_RETURN(std::unique_ptr<Buffers> buffers, Buffers::create(link_));
  {
    const std::lock_guard callbackLock(link_->callbackMutex);
    link_->onFrame = std::move(onFrame);
    link_->onEnd = std::move(onEnd);
  }
  Stream stream;
  stream.stop = Descriptor(::eventfd(0, EFD_CLOEXEC));
  std::packaged_task<void()> work(
      [link = link_, plan, own = std::move(buffers),
       stop = Descriptor(::fcntl(stream.stop.get(), F_DUPFD_CLOEXEC, 0))]() mutable {
        receive(*link, plan, *own, stop.get());
        own.reset();
      });
  stream.done = work.get_future();
  stream.thread = std::thread(std::move(work));
  stream_ = std::move(stream);
  return {};
}

void V4l2Camera::stop() {
  {
    const std::lock_guard lock(link_->callbackMutex);
    link_->onFrame = nullptr;
    link_->onEnd = nullptr;
  }
  const std::lock_guard lock(streamMutex_);
  if (!stream_) return;
  const std::uint64_t one = 1;
  (void)!::write(stream_->stop.get(), &one, sizeof(one));
  // Switching the stream of a camera off that does not answer takes the kernel many seconds; nobody
  // has to wait for it.
  if (stream_->done.wait_for(kStopPatience) == std::future_status::ready) {
    stream_->thread.join();
  } else {
    link_->lost = true;
    stream_->thread.detach();
  }
  stream_.reset();
}

}  // namespace

Result<std::unique_ptr<Camera>> openV4l2Camera(const std::string& target) {
  const std::string kQuery = "?format=";
  const std::size_t query = target.find(kQuery);
  const std::string path = target.substr(0, query);
  const std::string only = query == std::string::npos ? "" : target.substr(query + kQuery.size());
  const std::string address = "v4l2:" + path;
  Descriptor node(::open(path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC));
  if (!node) {
    const bool absent = errno == ENOENT || errno == ENODEV || errno == ENXIO || errno == ENOTDIR;
    return failure(absent ? ErrorCode::kNotFound : ErrorCode::kDevice, "{}: {}", address,
                   absent ? "no such camera" : "cannot be opened: " + explain(errno));
  }
  v4l2_capability capability{};
  if (request(node.get(), VIDIOC_QUERYCAP, &capability) != 0 || !sendsPictures(capability)) {
    return failure(ErrorCode::kUnsupported,
                   "{}: sends no pictures; 'lightsketch cameras' lists what does", address);
  }
  // From now on other programs can look, but change nothing. Not every driver keeps to it.
  std::uint32_t priority = V4L2_PRIORITY_RECORD;
  if (request(node.get(), VIDIOC_S_PRIORITY, &priority) == EBUSY) {
    return failure(ErrorCode::kDevice, "{}: {}", address, explain(EBUSY));
  }
  auto camera =
      std::make_unique<V4l2Camera>(std::make_shared<Link>(address, std::move(node)),
                                   infoOf(path, capability), isUvcWithoutClock(capability));
  RETURN_IF_ERROR(camera->prepare(only));
  return camera;
}

std::vector<CameraInfo> listV4l2Cameras() {
  std::vector<CameraInfo> cameras;
  for (int i = 0; i < 64; ++i) {  // as many as a kernel is built for
    const std::string path = fmt::format("/dev/video{}", i);
    const Descriptor node(::open(path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC));
    v4l2_capability capability{};
    if (node && request(node.get(), VIDIOC_QUERYCAP, &capability) == 0 &&
        sendsPictures(capability)) {
      cameras.push_back(infoOf(path, capability));
    }
  }
  return cameras;
}

}  // namespace lightsketch
