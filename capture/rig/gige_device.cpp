#include "capture/rig/gige_device.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <cerrno>
#include <cmath>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <mutex>
#include <optional>
#include <random>
#include <span>
#include <stop_token>
#include <thread>
#include <utility>

#include "capture/device/wire_format.h"
#include "capture/frame/descriptor.h"
#include "capture/frame/file.h"
#include "capture/rig/genicam_xml.h"

namespace lightsketch {
namespace {

using Bytes = std::vector<std::uint8_t>;
using View = std::span<const std::uint8_t>;

// GVCP commands and status codes, GigE Vision 1.2, sections 16 to 19.
constexpr std::uint16_t kDiscovery = 0x0002;
constexpr std::uint16_t kPacketResend = 0x0040;
constexpr std::uint16_t kReadRegister = 0x0080;
constexpr std::uint16_t kWriteRegister = 0x0082;
constexpr std::uint16_t kReadMemory = 0x0084;
constexpr std::uint16_t kWriteMemory = 0x0086;

enum Status : std::uint16_t {
  kSuccess = 0x0000,
  kNotImplemented = 0x8001,
  kInvalidParameter = 0x8002,
  kInvalidAddress = 0x8003,
  kWriteProtect = 0x8004,
  kBadAlignment = 0x8005,
  kAccessDenied = 0x8006,
  kBusy = 0x8007,
  kPacketUnavailable = 0x800c,
};

constexpr std::size_t kGvcpHeader = 8;
constexpr std::size_t kMaxGvcpPayload = 540;
constexpr std::size_t kGvspHeader = 8;
constexpr std::uint32_t kPacketOverhead = 20 + 8 + kGvspHeader;  // IP, UDP, GVSP
constexpr std::size_t kCachedFrames = 16;
constexpr std::size_t kBurstUnit = 1400;
constexpr auto kBurstPause = std::chrono::microseconds(500);
constexpr std::size_t kStampDigits = 48;
constexpr auto kPtpLocks = std::chrono::milliseconds(300);  // after it was enabled
constexpr int kPollMilliseconds = 50;  // how long the destructor may wait for the control thread

std::uint16_t get16(View bytes, std::size_t at) {
  return static_cast<std::uint16_t>(bytes[at] << 8 | bytes[at + 1]);
}
std::uint32_t get32(View bytes, std::size_t at) {
  return static_cast<std::uint32_t>(get16(bytes, at)) << 16 | get16(bytes, at + 2);
}
void put16(Bytes& bytes, std::size_t at, std::uint32_t value) {
  bytes[at] = static_cast<std::uint8_t>(value >> 8);
  bytes[at + 1] = static_cast<std::uint8_t>(value);
}
void put32(Bytes& bytes, std::size_t at, std::uint32_t value) {
  put16(bytes, at, value >> 16);
  put16(bytes, at + 2, value);
}
double getDouble(View bytes, std::size_t at) {
  return std::bit_cast<double>(std::uint64_t{get32(bytes, at)} << 32 | get32(bytes, at + 4));
}
void putDouble(Bytes& bytes, std::size_t at, double value) {
  const auto bits = std::bit_cast<std::uint64_t>(value);
  put32(bytes, at, static_cast<std::uint32_t>(bits >> 32));
  put32(bytes, at + 4, static_cast<std::uint32_t>(bits));
}
void append32(Bytes& bytes, std::uint32_t value) {
  bytes.resize(bytes.size() + 4);
  put32(bytes, bytes.size() - 4, value);
}
void putText(Bytes& bytes, std::size_t at, std::size_t size, std::string_view text) {
  std::copy_n(text.begin(), std::min(text.size(), size - 1),
              bytes.begin() + static_cast<std::ptrdiff_t>(at));
}

sockaddr_in makeAddress(std::uint32_t ip, std::uint16_t port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(ip);
  address.sin_port = htons(port);
  return address;
}
bool sameHost(const sockaddr_in& a, const sockaddr_in& b) {
  return a.sin_addr.s_addr == b.sin_addr.s_addr;
}
bool sameSender(const sockaddr_in& a, const sockaddr_in& b) {
  return sameHost(a, b) && a.sin_port == b.sin_port;
}
void sendTo(const Descriptor& socket, const Bytes& packet, const sockaddr_in& to) {
  // A datagram that cannot be sent is a lost one, which the protocol is made for.
  (void)::sendto(socket.get(), packet.data(), packet.size(), 0,
                 reinterpret_cast<const sockaddr*>(&to), sizeof to);
}

// A frame as it goes over the wire; kept a while for resends.
struct SentFrame {
  std::uint16_t id = 0;
  std::uint64_t timestamp = 0;
  ExposureRequest request;
  WireFormat format;
  Bytes payload;  // the picture as it is sent, then its chunks
  bool hasChunks = false;
  std::size_t bytesPerPacket = 0;
  sockaddr_in destination{};

  std::uint32_t packetCount() const {  // leader, data, trailer
    return 2 + static_cast<std::uint32_t>((payload.size() + bytesPerPacket - 1) / bytesPerPacket);
  }

  // GVSP packet (GigE Vision 1.2, section 23): status, block id, format and packet id, content.
  void packet(std::uint32_t index, Status status, Bytes& out) const {
    enum : std::uint32_t { kLeader = 1, kTrailer = 2, kData = 3 };
    const std::uint32_t kImagePayload = hasChunks ? 0x4001 : 1;
    std::uint32_t kind = kData;
    out.assign(kGvspHeader, 0);
    if (status != kSuccess) {
      // A refusal carries the header alone.
    } else if (index == 0) {
      kind = kLeader;
      out.resize(kGvspHeader + 36, 0);
      put16(out, 10, kImagePayload);
      put32(out, 12, static_cast<std::uint32_t>(timestamp >> 32));
      put32(out, 16, static_cast<std::uint32_t>(timestamp));
      put32(out, 20, format.code);
      put32(out, 24, static_cast<std::uint32_t>(request.region.width));
      put32(out, 28, static_cast<std::uint32_t>(request.region.height));
      put32(out, 32, static_cast<std::uint32_t>(request.region.x));
      put32(out, 36, static_cast<std::uint32_t>(request.region.y));
    } else if (index + 1 == packetCount()) {
      kind = kTrailer;
      out.resize(kGvspHeader + 8, 0);
      put16(out, 10, kImagePayload);
      put32(out, 12, static_cast<std::uint32_t>(request.region.height));
    } else {
      const std::size_t begin = (index - 1) * bytesPerPacket;
      const std::size_t end = std::min(begin + bytesPerPacket, payload.size());
      out.insert(out.end(), payload.begin() + static_cast<std::ptrdiff_t>(begin),
                 payload.begin() + static_cast<std::ptrdiff_t>(end));
    }
    put16(out, 0, status);
    put16(out, 2, id);
    put32(out, 4, kind << 24 | index);
  }
};

// What the frame thread needs to know to expose one frame.
struct Snapshot {
  ExposureRequest request;
  WireFormat format;
  bool chunkMode = false;
  std::array<bool, gige::kChunkCount> chunks{};
  std::uint16_t id = 0;
  std::uint64_t acquisition = 0;
  std::size_t bytesPerPacket = 0;
  sockaddr_in destination{};
};

std::uint8_t hexDigit(char digit) {
  return static_cast<std::uint8_t>(digit <= '9' ? digit - '0' : digit - 'a' + 10);
}
std::size_t stampStep(PixelFormat format) { return pixelFormatInfo(format).bits > 8 ? 2 : 1; }

// See readStamp.
void stampFrame(const ExposureRequest& request, Bytes& image) {
  const std::size_t step = stampStep(request.format);
  const std::size_t size = kStampDigits * step;
  if (image.size() < size) return;
  const std::string digits =
      fmt::format("{:016x}{:016x}", request.index, std::llround(1e9 * request.timeSeconds)) +
      checksum(std::as_bytes(View(image).subspan(size)));
  std::fill_n(image.begin(), size, std::uint8_t{0});
  for (std::size_t i = 0; i < digits.size(); ++i) image[i * step] = hexDigit(digits[i]);
}

void appendChunks(const Snapshot& shot, std::uint64_t timestamp, Bytes& payload) {
  const auto finish = [&](std::uint32_t id, std::size_t length) {
    append32(payload, id);
    append32(payload, static_cast<std::uint32_t>(length));
  };
  const auto add = [&](bool wanted, std::uint32_t id, std::uint64_t value) {
    if (!wanted) return;
    append32(payload, static_cast<std::uint32_t>(value >> 32));
    append32(payload, static_cast<std::uint32_t>(value));
    finish(id, 8);
  };
  finish(gige::kImageChunk, payload.size());
  add(shot.chunks[0], gige::kExposureChunk,
      std::bit_cast<std::uint64_t>(shot.request.exposureSeconds * 1e6));
  add(shot.chunks[1], gige::kGainChunk, std::bit_cast<std::uint64_t>(shot.request.gainDb));
  add(shot.chunks[2], gige::kTimestampChunk, timestamp);
  if (shot.chunks[3]) {
    append32(payload, crc16(payload));
    finish(gige::kCrcChunk, 4);
  }
}

}  // namespace

struct GigeDevice::State {
  State(FrameSource& frameSource, GigeDeviceOptions deviceOptions, TimePoint zero)
      : source(frameSource),
        options(std::move(deviceOptions)),
        startTime(zero),
        faults(options.faults),
        random(options.seed),
        resendRandom(options.seed + 1) {}

  Result<void> open();
  void run() {
    control = std::jthread([this](std::stop_token stop) { controlLoop(stop); });
    frames = std::jthread([this](std::stop_token stop) { frameLoop(stop); });
  }

  // Control thread.
  void controlLoop(std::stop_token stop);
  void handle(View packet, const sockaddr_in& from);
  Status readMemory(std::uint32_t address, std::size_t size, Bytes& out) const;
  Status write(std::uint32_t address, View value, const sockaddr_in& from);
  void resend(View payload, const sockaddr_in& from);
  void afterWrite(std::uint32_t address, const sockaddr_in& from);
  void releaseControl();
  bool acceptable(View registersToBe) const;

  // Frame thread.
  void frameLoop(std::stop_token stop);
  bool streaming() const {
    return controller && get32(registers, gige::kAcquisition) == 1 &&
           get32(registers, gige::kStreamPort) != 0;
  }
  Snapshot snapshot();
  void exposeAndSend(Snapshot shot, TimePoint exposureStart, std::stop_token stop);
  void send(std::shared_ptr<const SentFrame> frame, std::stop_token stop);
  void sendPacket(const Bytes& packet, const sockaddr_in& to);
  void damage(const GigeFaults& now, bool leader, Bytes& packet);
  std::uint32_t payloadSize() const;

  std::uint64_t deviceClock(TimePoint time) const;
  sockaddr_in streamDestination() const {
    return makeAddress(get32(registers, gige::kStreamAddress),
                       static_cast<std::uint16_t>(get32(registers, gige::kStreamPort)));
  }
  Duration framePeriod() const { return fromSeconds(1.0 / getDouble(registers, gige::kFrameRate)); }

  FrameSource& source;
  const GigeDeviceOptions options;
  const TimePoint startTime;
  std::vector<WireFormat> formats;
  std::string xml;
  Descriptor gvcp{::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0)};
  Descriptor gvsp{::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0)};

  mutable std::mutex mutex;  // Guards the following.
  std::condition_variable_any changed;
  Bytes registers = Bytes(gige::kRegistersEnd, 0);
  std::optional<sockaddr_in> controller;
  TimePoint lastHeartbeat;
  std::uint64_t acquisition = 0;  // counts starts and stops: a frame of an older one is not sent
  std::optional<Guide> pendingGuide;
  std::optional<RigProgram> pendingProgram;
  int triggers = 0;  // not answered yet
  std::optional<TimePoint> ptpSince;
  GigeFaults faults;

  std::mutex cacheMutex;  // Guards cache.
  std::deque<std::shared_ptr<const SentFrame>> cache;

  // The frame thread's own.
  std::mt19937 random;
  std::mt19937 resendRandom;  // the control thread's
  std::uint64_t frameIndex = 0;
  std::uint16_t nextId = 1;

  std::atomic<std::uint64_t> sent = 0;
  std::jthread control;  // last: both end before anything else does
  std::jthread frames;
};

Result<void> GigeDevice::State::open() {
  in_addr parsed{};
  if (::inet_pton(AF_INET, options.address.c_str(), &parsed) != 1) {
    return failure(ErrorCode::kInvalidArgument, "simulated camera: '{}' is not an IPv4 address",
                   options.address);
  }
  const std::uint32_t ip = ntohl(parsed.s_addr);
  const auto width = static_cast<std::uint32_t>(source.sensorWidth());
  const auto height = static_cast<std::uint32_t>(source.sensorHeight());
  for (const PixelFormat format : source.formats()) {
    for (const WireFormat& wire : wireFormatsOf(format)) {
      if (options.onlyFormat == 0 ? wire.packing == WireFormat::Packing::kNone
                                  : wire.code == options.onlyFormat) {
        formats.push_back(wire);
      }
    }
  }
  const double exposureUs = options.defaultExposureSeconds * 1e6;
  if (formats.empty() || options.firstFrameId == 0 || options.packetsPerBurst < 1 ||
      options.controlPort < 1 || options.controlPort > 65535) {
    return failure(ErrorCode::kInvalidArgument,
                   "simulated camera {}: needs a pixel format, a first frame id and a burst of at "
                   "least 1, and a port",
                   options.address);
  }

  for (const auto& [socket, port] : {std::pair<const Descriptor*, int>{&gvcp, options.controlPort},
                                     std::pair<const Descriptor*, int>{&gvsp, 0}}) {
    const sockaddr_in own = makeAddress(ip, static_cast<std::uint16_t>(port));
    if (socket->get() < 0 ||
        ::bind(socket->get(), reinterpret_cast<const sockaddr*>(&own), sizeof own) != 0) {
      const int error = errno;
      if (error == EADDRINUSE) {
        return failure(ErrorCode::kDevice,
                       "simulated camera: {}:{} is in use, perhaps by another simulated rig; stop "
                       "it or choose another address",
                       options.address, port);
      }
      return failure(ErrorCode::kDevice,
                     "simulated camera: cannot listen on {}:{}: {}; choose an address of this "
                     "machine, such as 127.0.0.11",
                     options.address, port, systemMessage(error));
    }
  }
  sockaddr_in streamAddress{};
  socklen_t length = sizeof streamAddress;
  ::getsockname(gvsp.get(), reinterpret_cast<sockaddr*>(&streamAddress), &length);

  // Bootstrap registers.
  xml = gige::genicamXml({formats, options.chunks, options.ptp});
  Bytes& r = registers;
  put32(r, gige::kVersion, 0x00010002);
  put32(r, gige::kDeviceMode, 0x80000001);  // big endian, UTF-8
  put32(r, gige::kMacHigh, 0x0200);         // locally administered; distinct per address
  put32(r, gige::kMacLow, ip);
  put32(r, gige::kSupportedIpConfiguration, 1);
  put32(r, gige::kCurrentIpConfiguration, 1);
  put32(r, gige::kCurrentIp, ip);
  put32(r, gige::kSubnetMask, 0xff000000);
  putText(r, gige::kManufacturer, 32, "lightsketch");
  putText(r, gige::kModel, 32, options.model);
  putText(r, gige::kDeviceVersion, 32, "1");
  putText(r, gige::kManufacturerInfo, 48, "simulated camera");
  putText(r, gige::kSerial, 16, options.serial);
  putText(r, gige::kXmlUrl, 512, fmt::format("Local:camera.xml;{:x};{:x}", gige::kXml, xml.size()));
  put32(r, gige::kNetworkInterfaceCount, 1);
  put32(r, gige::kStreamChannelCount, 1);
  put32(r, gige::kCapability, 1u << 30 | 1u << 2 | 1u << 1);  // serial, resend, WRITEMEM
  put32(r, gige::kHeartbeatTimeout, 3000);
  put32(r, gige::kTickFrequencyLow, 1'000'000'000);
  put32(r, gige::kStreamPacketSize, 1400);
  put32(r, gige::kStreamSourcePort, ntohs(streamAddress.sin_port));

  // The camera's own.
  put32(r, gige::kWidth, width);
  put32(r, gige::kHeight, height);
  put32(r, gige::kSensorWidth, width);
  put32(r, gige::kSensorHeight, height);
  put32(r, gige::kPixelFormat, formats.front().code);
  putDouble(r, gige::kExposureTime, exposureUs);
  putDouble(r, gige::kFrameRate, options.defaultFramesPerSecond);
  putDouble(r, gige::kGuideZ, 1);
  putDouble(r, gige::kRigProgram, static_cast<double>(options.program));
  afterWrite(gige::kWidth, {});
  if (!acceptable(r)) {
    return failure(ErrorCode::kInvalidArgument,
                   "simulated camera {}: sensor {}x{}, exposure {} s or {} frames/s out of range",
                   options.address, width, height, options.defaultExposureSeconds,
                   options.defaultFramesPerSecond);
  }
  return {};
}

// Caller holds the mutex.
std::uint64_t GigeDevice::State::deviceClock(TimePoint time) const {
  if (ptpSince && time > *ptpSince + kPtpLocks) {  // the grandmaster's, of 2001
    return static_cast<std::uint64_t>((time.time_since_epoch() + fromSeconds(1e9)).count());
  }
  const double drift = 1e-6 * options.clockDriftPpm * toSeconds(time - startTime);
  return static_cast<std::uint64_t>(
      (time.time_since_epoch() +
       fromSeconds(options.clockOffsetSeconds + faults.deviceClockSeconds + drift))
          .count());
}

// --- Control -------------------------------------------------------------------------------------

void GigeDevice::State::controlLoop(std::stop_token stop) {
  std::array<std::uint8_t, 2048> buffer;
  while (!stop.stop_requested()) {
    pollfd event{gvcp.get(), POLLIN, 0};
    if (::poll(&event, 1, kPollMilliseconds) > 0) {
      sockaddr_in from{};
      socklen_t length = sizeof from;
      const ssize_t size = ::recvfrom(gvcp.get(), buffer.data(), buffer.size(), MSG_DONTWAIT,
                                      reinterpret_cast<sockaddr*>(&from), &length);
      if (size > 0) handle(View(buffer).first(static_cast<std::size_t>(size)), from);
    }
    const std::lock_guard lock(mutex);
    if (ptpSince && Clock::now() > *ptpSince + kPtpLocks) put32(registers, gige::kPtpStatus, 2);
    const auto timeout = std::chrono::milliseconds(get32(registers, gige::kHeartbeatTimeout));
    if (controller && Clock::now() - lastHeartbeat > timeout) releaseControl();
  }
}

void GigeDevice::State::handle(View packet, const sockaddr_in& from) {
  // Header: key 0x42, flags, command, payload size, request id. Anything else is not for us.
  if (packet.size() < kGvcpHeader || packet[0] != 0x42) return;
  const bool wantsAnswer = (packet[1] & 1) != 0;
  const std::uint16_t command = get16(packet, 2);
  const std::size_t size = get16(packet, 4);
  if (size > packet.size() - kGvcpHeader || size > kMaxGvcpPayload) return;
  const View payload = packet.subspan(kGvcpHeader, size);
  {
    const std::lock_guard lock(mutex);
    if (faults.frozen) return;
  }
  if (command == kPacketResend) return resend(payload, from);

  Bytes answer(kGvcpHeader, 0);
  Status status = kSuccess;
  {
    const std::lock_guard lock(mutex);
    if (controller && sameSender(*controller, from)) lastHeartbeat = Clock::now();
    switch (command) {
      case kDiscovery:
        status = readMemory(0, gige::kDiscoverySize, answer);
        break;
      case kReadRegister:
        if (size == 0 || size % 4 != 0) status = kInvalidParameter;
        for (std::size_t i = 0; status == kSuccess && i < size; i += 4) {
          status = readMemory(get32(payload, i), 4, answer);
        }
        break;
      case kWriteRegister: {
        if (size == 0 || size % 8 != 0) status = kInvalidParameter;
        std::uint32_t written = 0;
        for (std::size_t i = 0; status == kSuccess && i < size; i += 8) {
          status = write(get32(payload, i), payload.subspan(i + 4, 4), from);
          if (status == kSuccess) ++written;
        }
        answer.resize(kGvcpHeader + 4, 0);
        put16(answer, 10, written);
        break;
      }
      case kReadMemory:
        if (size != 8 || get16(payload, 6) % 4 != 0 || get16(payload, 6) > kMaxGvcpPayload - 4) {
          status = kInvalidParameter;
        } else {
          answer.insert(answer.end(), payload.begin(), payload.begin() + 4);
          status = readMemory(get32(payload, 0), get16(payload, 6), answer);
        }
        break;
      case kWriteMemory:
        if (size < 8 || size % 4 != 0) {
          status = kInvalidParameter;
        } else {
          status = write(get32(payload, 0), payload.subspan(4), from);
          answer.resize(kGvcpHeader + 4, 0);
          put16(answer, 10, status == kSuccess ? static_cast<std::uint32_t>(size - 4) : 0);
        }
        break;
      default:
        status = kNotImplemented;
    }
  }
  if (!wantsAnswer) return;
  if (status != kSuccess && command != kWriteRegister && command != kWriteMemory) {
    answer.resize(kGvcpHeader);
  }
  put16(answer, 0, status);
  put16(answer, 2, command + 1u);
  put16(answer, 4, static_cast<std::uint32_t>(answer.size() - kGvcpHeader));
  put16(answer, 6, get16(packet, 6));
  sendTo(gvcp, answer, from);
}

Status GigeDevice::State::readMemory(std::uint32_t address, std::size_t size, Bytes& out) const {
  if (address % 4 != 0) return kBadAlignment;
  const auto copy = [&](const auto& memory, std::size_t at) {
    if (at > memory.size() || size > memory.size() - at) return kInvalidAddress;
    out.insert(out.end(), memory.begin() + static_cast<std::ptrdiff_t>(at),
               memory.begin() + static_cast<std::ptrdiff_t>(at + size));
    return kSuccess;
  };
  return address >= gige::kXml ? copy(xml, address - gige::kXml) : copy(registers, address);
}

Status GigeDevice::State::write(std::uint32_t address, View value, const sockaddr_in& from) {
  using namespace gige;
  static constexpr std::array kAlways = {
      kHeartbeatTimeout, kTimestampControl, kControlPrivilege, kAcquisitionMode,
      kAcquisition,      kExposureTime,     kExposureTime + 4, kGain,
      kGain + 4,         kFrameRate,        kFrameRate + 4,    kGuideMode,
      kGuideMode + 4,    kGuideX,           kGuideX + 4,       kGuideY,
      kGuideY + 4,       kGuideZ,           kGuideZ + 4,       kRigProgram,
      kRigProgram + 4,   kTriggerSoftware,  kChunkSelector};
  static constexpr std::array kWhileStopped = {
      kWidth,           kHeight,           kOffsetX,           kOffsetY,       kPixelFormat,
      kStreamPort,      kStreamPacketSize, kStreamPacketDelay, kStreamAddress, kTriggerMode,
      kTriggerSource,   kPtpEnable,        kChunkMode,         kChunkEnable,   kChunkEnable + 4,
      kChunkEnable + 8, kChunkEnable + 12};
  if (address % 4 != 0) return kBadAlignment;
  if (controller ? !sameSender(*controller, from) : address != kControlPrivilege) {
    return kAccessDenied;
  }
  if (address == kTimestampControl && !options.timestampLatch) return kInvalidAddress;

  // All of it or nothing.
  Bytes next = registers;
  for (std::size_t i = 0; i < value.size(); i += 4) {
    const std::size_t at = address + i;
    const auto is = [at](std::uint32_t writable) { return writable == at; };
    if (at + 4 > next.size()) return at >= kXml ? kWriteProtect : kInvalidAddress;
    if (std::any_of(kWhileStopped.begin(), kWhileStopped.end(), is)) {
      const bool closesStream = at == kStreamPort && get32(value, i) == 0;
      if (get32(registers, kAcquisition) == 1 && !closesStream) return kBusy;
    } else if (std::none_of(kAlways.begin(), kAlways.end(), is)) {
      return kWriteProtect;
    }
    put32(next, at, get32(value, i));
  }
  if (!acceptable(next)) return kInvalidParameter;
  registers = std::move(next);
  for (std::size_t i = 0; i < value.size(); i += 4) {
    afterWrite(address + static_cast<std::uint32_t>(i), from);
  }
  changed.notify_all();
  return kSuccess;
}

bool GigeDevice::State::acceptable(View r) const {
  using namespace gige;
  const auto fits = [&](std::uint32_t side, std::uint32_t offset, std::uint32_t sensor) {
    const std::uint32_t s = get32(r, side), o = get32(r, offset), limit = get32(r, sensor);
    return s >= kMinSide && s <= limit && o <= limit - s && s % kSideStep == 0 &&
           o % kSideStep == 0;
  };
  const auto within = [&](std::uint32_t address, double min, double max) {
    const double value = getDouble(r, address);
    return value >= min && value <= max;  // false for NaN
  };
  const auto known = [&](const WireFormat& format) {
    return format.code == get32(r, kPixelFormat);
  };
  const std::uint32_t packetSize = get32(r, kStreamPacketSize) & 0xffff;
  return fits(kWidth, kOffsetX, kSensorWidth) && fits(kHeight, kOffsetY, kSensorHeight) &&
         std::any_of(formats.begin(), formats.end(), known) &&
         within(kExposureTime, kMinExposureUs, kMaxExposureUs) && within(kGain, 0, kMaxGainDb) &&
         within(kFrameRate, kMinFrameRate, kMaxFrameRate) && within(kGuideMode, 0, 2) &&
         within(kGuideX, -1, 1) && within(kGuideY, -1, 1) && within(kGuideZ, -1, 1) &&
         within(kRigProgram, 0, kRigProgramCount - 1) && packetSize >= kMinPacketSize &&
         packetSize <= kMaxPacketSize && get32(r, kHeartbeatTimeout) >= 500 &&
         get32(r, kAcquisition) <= 1 && get32(r, kAcquisitionMode) == 0 &&
         get32(r, kTriggerMode) <= 1 && get32(r, kTriggerSource) <= 1 &&
         get32(r, kPtpEnable) <= (options.ptp ? 1u : 0u) &&
         get32(r, kChunkMode) <= (options.chunks ? 1u : 0u) &&
         get32(r, kChunkSelector) < kChunkCount;
}

// What a write sets off beyond its register.
void GigeDevice::State::afterWrite(std::uint32_t address, const sockaddr_in& from) {
  using namespace gige;
  switch (address) {
    case kControlPrivilege:
      if ((get32(registers, kControlPrivilege) & 3) == 0) return releaseControl();
      controller = from;
      lastHeartbeat = Clock::now();
      break;
    case kTimestampControl: {
      if ((get32(registers, kTimestampControl) & 2) != 0) {
        const std::uint64_t now = deviceClock(Clock::now());
        put32(registers, kTimestampHigh, static_cast<std::uint32_t>(now >> 32));
        put32(registers, kTimestampLow, static_cast<std::uint32_t>(now));
      }
      put32(registers, kTimestampControl, 0);
      break;
    }
    case kStreamPacketSize: {
      const std::uint32_t value = get32(registers, kStreamPacketSize);
      put32(registers, kStreamPacketSize, value & 0x7fffffff);
      if ((value & 0x80000000) != 0) {
        sendPacket(Bytes((value & 0xffff) - 28, 0), streamDestination());
      }
      break;
    }
    case kWidth:
    case kHeight:
    case kPixelFormat:
    case kChunkMode:
    case kChunkEnable:
    case kChunkEnable + 4:
    case kChunkEnable + 8:
    case kChunkEnable + 12:
      put32(registers, kPayloadSize, payloadSize());
      break;
    case kAcquisition:
      ++acquisition;
      triggers = 0;
      break;
    case kTriggerSoftware:
      if (get32(registers, kTriggerSource) == 0) ++triggers;
      break;
    case kPtpEnable:
      ptpSince.reset();
      if (get32(registers, kPtpEnable) == 1) ptpSince = Clock::now();
      put32(registers, kPtpStatus, get32(registers, kPtpEnable));
      break;
    case kGuideMode + 4: {
      const double mode = std::round(getDouble(registers, kGuideMode));
      pendingGuide = Guide{static_cast<Guide::Mode>(static_cast<int>(mode)),
                           {getDouble(registers, kGuideX), getDouble(registers, kGuideY),
                            getDouble(registers, kGuideZ)}};
      break;
    }
    case kRigProgram + 4:
      pendingProgram = static_cast<RigProgram>(std::lround(getDouble(registers, kRigProgram)));
      break;
    default:
      break;
  }
}

std::uint32_t GigeDevice::State::payloadSize() const {
  using namespace gige;
  const WireFormat format = *wireFormatFromCode(get32(registers, kPixelFormat));
  auto size = static_cast<std::uint32_t>(
      format.bytes(std::size_t{get32(registers, kWidth)} * get32(registers, kHeight)));
  if (get32(registers, kChunkMode) == 0) return size;
  size += 8;
  for (std::uint32_t i = 0; i < kChunkCount; ++i) {
    if (get32(registers, kChunkEnable + 4 * i) != 0) size += 8 + (i + 1 == kChunkCount ? 4 : 8);
  }
  return size;
}

void GigeDevice::State::releaseControl() {
  controller.reset();
  put32(registers, gige::kControlPrivilege, 0);
  put32(registers, gige::kAcquisition, 0);
  put32(registers, gige::kStreamPort, 0);
  ++acquisition;
  changed.notify_all();
}

void GigeDevice::State::resend(View payload, const sockaddr_in& from) {
  // Channel, block id, first and last packet. Aravis asks from its stream's socket, so only the
  // host can be checked.
  if (payload.size() < 12) return;
  {
    const std::lock_guard lock(mutex);
    if (!controller || !sameHost(*controller, from)) return;
  }
  GigeFaults now;
  {
    const std::lock_guard lock(mutex);
    now = faults;
  }
  const std::uint16_t id = get16(payload, 2);
  const std::uint32_t first = get32(payload, 4) & 0xffffff;
  const std::uint32_t last = get32(payload, 8) & 0xffffff;
  std::shared_ptr<const SentFrame> frame;
  {
    const std::lock_guard lock(cacheMutex);
    const auto found = std::find_if(cache.begin(), cache.end(),
                                    [id](const auto& cached) { return cached->id == id; });
    if (found != cache.end() && now.resend) frame = *found;
  }
  Bytes packet;
  if (!frame) {
    SentFrame unknown;
    unknown.id = id;
    unknown.packet(first, kPacketUnavailable, packet);
    const std::lock_guard lock(mutex);
    return sendTo(gvsp, packet, streamDestination());
  }
  std::bernoulli_distribution lost(now.resendLoss);
  for (std::uint32_t i = first; i <= last && i < frame->packetCount(); ++i) {
    if (lost(resendRandom)) continue;
    frame->packet(i, kSuccess, packet);
    sendPacket(packet, frame->destination);
  }
}

// --- Frames --------------------------------------------------------------------------------------

void GigeDevice::State::frameLoop(std::stop_token stop) {
  std::uint64_t current = 0;  // acquisition
  TimePoint next;
  std::unique_lock lock(mutex);
  const auto told = [&] { return pendingGuide || pendingProgram; };
  const auto waitsForTrigger = [&] { return get32(registers, gige::kTriggerMode) == 1; };
  while (changed.wait(lock, stop, [&] { return told() || streaming(); })) {
    if (pendingProgram) {
      const RigProgram program = *std::exchange(pendingProgram, std::nullopt);
      lock.unlock();
      source.startProgram(program);
      lock.lock();
      continue;
    }
    if (pendingGuide) {
      const Guide guide = *std::exchange(pendingGuide, std::nullopt);
      lock.unlock();
      source.guide(guide);
      lock.lock();
      continue;
    }
    if (acquisition != current) {
      current = acquisition;
      next = Clock::now();
      nextId = options.firstFrameId;
    }
    const auto interrupted = [&] { return told() || acquisition != current; };
    if (waitsForTrigger()) {
      changed.wait(lock, stop, [&] { return interrupted() || triggers > 0; });
      if (interrupted()) continue;
      if (stop.stop_requested()) return;
      --triggers;
    } else if (changed.wait_until(lock, stop, next, interrupted)) {
      continue;
    }
    if (stop.stop_requested()) return;

    const TimePoint start = Clock::now();
    const Snapshot shot = snapshot();
    lock.unlock();
    exposeAndSend(shot, start, stop);
    lock.lock();
    // A frame that took too long costs the next ones; the camera's beat goes on.
    const Duration period = framePeriod();
    next += period;
    const TimePoint now = Clock::now();
    if (next < now) next += (now - next + period - Duration(1)) / period * period;
  }
}

Snapshot GigeDevice::State::snapshot() {
  using namespace gige;
  const auto number = [&](std::uint32_t address) {
    return static_cast<int>(get32(registers, address));
  };
  Snapshot shot;
  shot.request.index = frameIndex++;
  shot.format = *wireFormatFromCode(get32(registers, kPixelFormat));
  shot.request.format = shot.format.format;
  shot.chunkMode = get32(registers, kChunkMode) == 1;
  for (std::uint32_t i = 0; i < kChunkCount; ++i) {
    shot.chunks[i] = shot.chunkMode && get32(registers, kChunkEnable + 4 * i) == 1;
  }
  shot.request.region = {number(kOffsetX), number(kOffsetY), number(kWidth), number(kHeight)};
  shot.request.exposureSeconds = 1e-6 * getDouble(registers, kExposureTime);
  shot.request.gainDb = getDouble(registers, kGain);
  shot.id = std::exchange(
      nextId, nextId == 65535 ? std::uint16_t{1} : static_cast<std::uint16_t>(nextId + 1));
  shot.acquisition = acquisition;
  shot.bytesPerPacket = (get32(registers, kStreamPacketSize) & 0xffff) - kPacketOverhead;
  shot.destination = streamDestination();
  return shot;
}

void GigeDevice::State::exposeAndSend(Snapshot shot, TimePoint exposureStart,
                                      std::stop_token stop) {
  const double exposure = shot.request.exposureSeconds;
  shot.request.timeSeconds = toSeconds(exposureStart - startTime) + exposure / 2;
  const auto frame = std::make_shared<SentFrame>();
  frame->id = shot.id;
  {
    const std::lock_guard lock(mutex);
    frame->timestamp =
        faults.zeroTimestamps
            ? 0
            : deviceClock(exposureStart) +
                  static_cast<std::uint64_t>(fromSeconds(faults.frameClockSeconds).count());
  }
  frame->request = shot.request;
  frame->format = shot.format;
  frame->bytesPerPacket = shot.bytesPerPacket;
  frame->destination = shot.destination;
  const std::size_t pixels = static_cast<std::size_t>(shot.request.region.width) *
                             static_cast<std::size_t>(shot.request.region.height);
  Bytes image(pixels *
              static_cast<std::size_t>(pixelFormatInfo(shot.request.format).bytesPerPixel));
  const std::size_t size = image.size();
  source.expose(shot.request, image);
  image.resize(size);
  if (options.stamp) stampFrame(shot.request, image);
  frame->payload = packPixels(shot.format, image);
  frame->hasChunks = shot.chunkMode;
  if (shot.chunkMode) appendChunks(shot, frame->timestamp, frame->payload);

  // No camera sends before its exposure is over, nor after it was told to stop.
  {
    std::unique_lock lock(mutex);
    changed.wait_until(lock, stop, exposureStart + fromSeconds(exposure),
                       [&] { return acquisition != shot.acquisition; });
    if (acquisition != shot.acquisition || stop.stop_requested()) return;
  }
  send(frame, stop);
}

void GigeDevice::State::sendPacket(const Bytes& packet, const sockaddr_in& to) {
  if (packet.size() + 28 > static_cast<std::size_t>(options.mtu)) return;
  if (!options.link || options.link->pass(packet.size() + kPacketOverhead)) {
    sendTo(gvsp, packet, to);
  }
}

void GigeDevice::State::damage(const GigeFaults& now, bool leader, Bytes& packet) {
  const auto below = [&](std::size_t end) { return static_cast<std::size_t>(random() % end); };
  const auto chosen = [&](double chance) {
    return chance > 0 && std::bernoulli_distribution(chance)(random);
  };
  const auto flip = [&](std::size_t byte) {
    packet[byte] ^= static_cast<std::uint8_t>(1u << below(8));
  };
  if (chosen(now.corruptedHeader)) {
    // The leader's time of exposure is bytes 12 to 19.
    const std::size_t byte = below(leader ? kGvspHeader + 28 : kGvspHeader);
    flip(byte < 12 ? byte : byte + 8);
  }
  if (chosen(now.corruptedPayload) && !leader && packet.size() > kGvspHeader + 8) {
    flip(kGvspHeader + below(packet.size() - kGvspHeader));
  }
  if (chosen(now.corruptedLength)) packet.resize((8 + below(2 * packet.size())) / 4 * 4, 0xa5);
}

void GigeDevice::State::send(std::shared_ptr<const SentFrame> frame, std::stop_token stop) {
  {
    const std::lock_guard lock(cacheMutex);
    cache.push_back(frame);
    if (cache.size() > kCachedFrames) cache.pop_front();
  }
  GigeFaults now;
  {
    const std::lock_guard lock(mutex);
    now = faults;
  }
  if (now.frozen || now.silent) return;
  const auto chosen = [&](double chance) {
    return chance > 0 && std::bernoulli_distribution(chance)(random);
  };
  const auto below = [&](std::uint32_t end) { return static_cast<std::uint32_t>(random() % end); };
  const std::uint32_t count = frame->packetCount();
  const std::uint32_t stallsAt = chosen(now.stalled) ? below(count) : count;
  std::vector<std::pair<std::uint32_t, Bytes>> late;  // and after which packet
  const auto sendLate = [&](std::uint32_t sentUpTo) {
    std::erase_if(late, [&](const auto& waiting) {
      if (waiting.first > sentUpTo) return false;
      sendPacket(waiting.second, frame->destination);
      return true;
    });
  };
  Bytes packet;
  std::size_t burst = 0;
  TimePoint due = Clock::now();
  for (std::uint32_t i = 0; i < count && !stop.stop_requested(); ++i) {
    if (burst >= static_cast<std::size_t>(options.packetsPerBurst) * kBurstUnit) {
      burst = 0;
      // Oversleeping is made up for, but never by more than one burst at once.
      due = std::max(due + kBurstPause, Clock::now() - kBurstPause);
      std::this_thread::sleep_until(due);
    }
    if (i == stallsAt) {
      std::unique_lock lock(mutex);
      changed.wait_for(lock, stop, fromSeconds(now.stallSeconds), [] { return false; });
    }
    if (chosen(now.loss)) continue;
    frame->packet(i, kSuccess, packet);
    burst += packet.size();
    damage(now, i == 0, packet);
    if (chosen(now.duplicated)) sendPacket(packet, frame->destination);
    if (chosen(now.reordered)) {
      late.emplace_back(i + 1 + below(8), packet);
    } else {
      sendPacket(packet, frame->destination);
    }
    sendLate(i);
  }
  sendLate(count + 8);
  ++sent;
}

// --- The public face -----------------------------------------------------------------------------

Result<std::unique_ptr<GigeDevice>> GigeDevice::start(FrameSource& source,
                                                      const GigeDeviceOptions& options,
                                                      TimePoint startTime) {
  auto state = std::make_unique<State>(source, options, startTime);
  RETURN_IF_ERROR(state->open());
  state->run();
  return std::unique_ptr<GigeDevice>(new GigeDevice(std::move(state)));
}

GigeDevice::GigeDevice(std::unique_ptr<State> state) : state_(std::move(state)) {}
GigeDevice::~GigeDevice() = default;

std::uint64_t GigeDevice::framesSent() const { return state_->sent; }

void GigeDevice::setFaults(const GigeFaults& faults) {
  const std::lock_guard lock(state_->mutex);
  state_->faults = faults;
}

void GigeDevice::pulse() {
  {
    const std::lock_guard lock(state_->mutex);
    if (get32(state_->registers, gige::kTriggerSource) == 1) ++state_->triggers;
  }
  state_->changed.notify_all();
}

bool SlowLink::pass(std::size_t bytes) {
  const std::lock_guard lock(mutex_);
  const TimePoint now = Clock::now();
  queued_ = std::max(0.0, queued_ - bytesPerSecond_ * toSeconds(now - since_));
  since_ = now;
  const auto size = static_cast<double>(bytes);
  if (queued_ + size > queueBytes_) return false;
  queued_ += size;
  return true;
}

std::optional<FrameStamp> readStamp(std::span<const std::uint8_t> bytes, PixelFormat format) {
  const std::size_t step = stampStep(format);
  if (bytes.size() < kStampDigits * step) return std::nullopt;
  const std::string sum = checksum(std::as_bytes(bytes.subspan(kStampDigits * step)));
  std::array<std::uint64_t, 2> values{};
  for (std::size_t i = 0; i < kStampDigits; ++i) {
    const std::uint8_t digit = bytes[i * step];
    if (digit > 15 || (step == 2 && bytes[i * step + 1] != 0)) return std::nullopt;
    if (i < 32) {
      values[i / 16] = values[i / 16] << 4 | digit;
    } else if (digit != hexDigit(sum[i - 32])) {
      return std::nullopt;
    }
  }
  return FrameStamp{values[0], 1e-9 * static_cast<double>(values[1])};
}

}  // namespace lightsketch
