#include "tests/vm/usb_camera.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/socket.h>
#include <turbojpeg.h>

#include <algorithm>
#include <csignal>
#include <cstring>
#include <fstream>
#include <memory>
#include <stdexcept>

namespace lightsketch {
namespace {

namespace fs = std::filesystem;
using Bytes = std::vector<std::uint8_t>;

// USB/IP's messages (kernel: Documentation/usb/usbip_protocol.rst); all fields big endian.
constexpr std::size_t kHeader = 48;
constexpr std::uint32_t kSubmit = 1, kUnlink = 2, kSubmitReply = 3, kUnlinkReply = 4;
constexpr std::int32_t kStall = -32, kConnectionReset = -104;  // Linux' EPIPE, ECONNRESET
constexpr std::uint32_t kDevice = 0x10001, kHighSpeed = 3;

// USB Video Class 1.1.
constexpr std::uint8_t kSetCur = 0x01, kGetCur = 0x81, kGetMin = 0x82, kGetMax = 0x83,
                       kGetRes = 0x84, kGetLen = 0x85, kGetInfo = 0x86, kGetDef = 0x87;
constexpr unsigned kCommit = 2;
constexpr unsigned kCameraUnit = 1, kProcessingUnit = 2;
constexpr std::uint32_t kPayload = 16384;
constexpr std::uint8_t kEndOfFrame = 2, kError = 0x40, kEndOfHeader = 0x80;

constexpr std::array<std::array<int, 2>, 3> kSizes{{{320, 240}, {640, 480}, {800, 600}}};
constexpr std::uint8_t kMjpgSizes = 3, kYuyvSizes = 2;                       // of these
constexpr std::array<std::uint32_t, 3> kIntervals{333333, 666666, 2000000};  // 100 ns

constexpr auto kPatience = std::chrono::seconds(20);
constexpr auto kTick = std::chrono::milliseconds(20);
constexpr const char* kNodes = "/sys/class/video4linux";

constexpr int kBits = 16;  // of a frame's number, one block each
constexpr int kBlockHeight = 32;

void append(Bytes& to, const Bytes& more) { to.insert(to.end(), more.begin(), more.end()); }
void append16(Bytes& to, unsigned v) {
  append(to, {static_cast<std::uint8_t>(v), static_cast<std::uint8_t>(v >> 8)});
}
void append32(Bytes& to, std::uint32_t v) {
  append16(to, v & 0xffff);
  append16(to, v >> 16);
}
std::uint32_t big32(const std::uint8_t* p) {
  return static_cast<std::uint32_t>(p[0]) << 24 | static_cast<std::uint32_t>(p[1]) << 16 |
         static_cast<std::uint32_t>(p[2]) << 8 | p[3];
}
void putBig32(std::uint8_t* p, std::uint32_t v) {
  for (int i = 0; i < 4; ++i) p[i] = static_cast<std::uint8_t>(v >> (24 - 8 * i));
}

bool readAll(int fd, std::uint8_t* to, std::size_t size) {
  while (size > 0) {
    const auto n = ::recv(fd, to, size, 0);
    if (n <= 0) return false;
    to += n;
    size -= static_cast<std::size_t>(n);
  }
  return true;
}

Bytes deviceDescriptor() {
  // USB 2.0, "interface association" class, vendor 0x1209 product 0x0001, strings 1 to 3.
  return {18, 1, 0, 2, 0xEF, 2, 1, 64, 0x09, 0x12, 0x01, 0x00, 0, 1, 1, 2, 3, 1};
}

Bytes stringDescriptor(unsigned i) {
  if (i == 0) return {4, 3, 0x09, 0x04};  // English
  const std::array<std::string, 3> texts{"lightsketch", "Virtual webcam", "0042"};
  Bytes out{0, 3};
  for (const char c : texts[(i - 1) % texts.size()]) append16(out, static_cast<unsigned char>(c));
  out[0] = static_cast<std::uint8_t>(out.size());
  return out;
}

Bytes frameDescriptors(std::uint8_t subtype, std::size_t sizes) {
  Bytes out;
  for (std::size_t i = 0; i < sizes; ++i) {
    const auto [width, height] = kSizes[i];
    Bytes frame{0, 0x24, subtype, static_cast<std::uint8_t>(i + 1), 0};
    append16(frame, static_cast<unsigned>(width));
    append16(frame, static_cast<unsigned>(height));
    const auto bits = static_cast<std::uint32_t>(width * height * 16);
    append32(frame, bits * 5);
    append32(frame, bits * 30);
    append32(frame, bits / 8);
    append32(frame, kIntervals.front());
    frame.push_back(static_cast<std::uint8_t>(kIntervals.size()));
    for (const std::uint32_t interval : kIntervals) append32(frame, interval);
    frame[0] = static_cast<std::uint8_t>(frame.size());
    append(out, frame);
  }
  append(out, {6, 0x24, 0x0D, 1, 1, 4});  // colours: sRGB, BT.601
  return out;
}

Bytes configurationDescriptor() {
  // Camera terminal (exposure mode, its priority, exposure time), processing unit (brightness,
  // white balance, gain, automatic white balance), output terminal.
  Bytes units{18, 0x24, 2, kCameraUnit, 0x01, 0x02, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0x0E, 0, 0};
  append(units, {11, 0x24, 5, kProcessingUnit, kCameraUnit, 0, 0, 2, 0x41, 0x12, 0});
  append(units, {9, 0x24, 3, 3, 0x01, 0x01, 0, kProcessingUnit, 0});
  Bytes control{13, 0x24, 1, 0x10, 0x01};
  append16(control, static_cast<unsigned>(13 + units.size()));
  append32(control, 48'000'000);
  append(control, {1, 1});
  append(control, units);

  Bytes formats{11, 0x24, 6, 1, kMjpgSizes, 0, 1, 0, 0, 0, 0};  // MJPG
  append(formats, frameDescriptors(7, kMjpgSizes));
  append(formats, {27, 0x24, 4,    2, kYuyvSizes, 'Y',  'U',  'Y', '2', 0, 0, 0x10, 0, 0x80,
                   0,  0,    0xAA, 0, 0x38,       0x9B, 0x71, 16,  1,   0, 0, 0,    0});
  append(formats, frameDescriptors(5, kYuyvSizes));
  Bytes streaming{15, 0x24, 1, 2};
  append16(streaming, static_cast<unsigned>(15 + formats.size()));
  append(streaming, {0x81, 0, 3, 0, 0, 0, 1, 0, 0});
  append(streaming, formats);

  Bytes out{9, 2, 0, 0, 2, 1, 0, 0x80, 250};
  append(out, {8, 11, 0, 2, 0x0E, 3, 0, 2});    // both interfaces are one function
  append(out, {9, 4, 0, 0, 0, 0x0E, 1, 0, 2});  // video control
  append(out, control);
  append(out, {9, 4, 1, 0, 1, 0x0E, 2, 0, 0});  // video streaming, with one
  append(out, streaming);
  append(out, {7, 5, 0x81, 2, 0, 2, 0});  // bulk endpoint
  out[2] = static_cast<std::uint8_t>(out.size());
  out[3] = static_cast<std::uint8_t>(out.size() >> 8);
  return out;
}

// Those that send pictures: a camera's further nodes carry metadata.
std::vector<std::string> nodes() {
  std::vector<std::string> found;
  for (const auto& entry : fs::directory_iterator(kNodes)) {
    std::ifstream index(entry.path() / "index");
    if (index.get() == '0') found.push_back(entry.path().filename().string());
  }
  return found;
}

}  // namespace

int UsbCamera::levelOf(double exposureSeconds, int gain) {
  return std::min(230, 30 + static_cast<int>(exposureSeconds * 1e4 + 0.5) / 8 + gain / 4);
}

UsbCamera::Stamp UsbCamera::read(const Frame& frame) {
  Stamp stamp{0, static_cast<int>(frame.sample(frame.width / 2, frame.height / 2, 0))};
  const int block = frame.width / kBits;
  for (int i = 0; i < kBits; ++i) {
    if (frame.sample(i * block + block / 2, kBlockHeight / 2, 0) > 128) stamp.number |= 1u << i;
  }
  return stamp;
}

int UsbCamera::control(const std::string& name) const {
  const std::lock_guard lock(mutex_);
  return valueOf(name);
}

std::int32_t UsbCamera::valueOf(const std::string& name) const {
  for (const Control& control : controls_) {
    if (control.name == name) return control.value;
  }
  throw std::logic_error("no control " + name);
}

std::optional<std::string> UsbCamera::plug() {
  unplug();
  {
    const std::lock_guard lock(mutex_);
    controls_ = {
        {"exposure mode", kCameraUnit, 2, 1, 8, 0, 0, 9, 8, nullptr, 0},  // step: the modes it has
        {"exposure priority", kCameraUnit, 3, 1, 1, 0, 1, 1, 1, nullptr, 0},
        {"exposure", kCameraUnit, 4, 4, 333, 1, 2000, 1, 333, "exposure mode", 1},
        {"brightness", kProcessingUnit, 2, 2, 0, -64, 64, 1, 0, nullptr, 0},
        {"gain", kProcessingUnit, 4, 2, 16, 0, 255, 1, 16, nullptr, 0},
        {"temperature", kProcessingUnit, 10, 2, 4600, 2800, 6500, 10, 4600, "balance", 0},
        {"balance", kProcessingUnit, 11, 1, 1, 0, 1, 1, 1, nullptr, 0},
    };
  }
  sends_ = answers_ = true;
  streams_ = false;
  wanted_.clear();
  sent_ = frame_.size();

  const auto before = nodes();
  const TimePoint patience = Clock::now() + kPatience;
  // The controller needs a moment to notice that the last one was pulled out.
  for (bool attached = false; !attached;) {
    if (Clock::now() > patience) return std::nullopt;
    std::array<int, 2> ends{};
    if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends.data()) != 0) return std::nullopt;
    socket_ = Descriptor(ends[0]);
    const Descriptor theirs(ends[1]);
    const Descriptor attach(::open("/sys/devices/platform/vhci_hcd.0/attach", O_WRONLY));
    const std::string order = "0 " + std::to_string(theirs.get()) + " " + std::to_string(kDevice) +
                              " " + std::to_string(kHighSpeed);
    attached = attach && ::write(attach.get(), order.data(), order.size()) > 0;
    if (!attached) std::this_thread::sleep_for(kTick);
  }
  thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
  while (Clock::now() < patience) {
    for (const std::string& node : nodes()) {
      if (std::ranges::find(before, node) == before.end() && fs::exists("/dev/" + node)) {
        usb_ = fs::canonical(fs::path(kNodes) / node / "device" / "..");
        return "/dev/" + node;
      }
    }
    std::this_thread::sleep_for(kTick);
  }
  return std::nullopt;
}

void UsbCamera::unplug() {
  thread_ = {};
  socket_ = {};
  const TimePoint patience = Clock::now() + kPatience;
  while (!usb_.empty() && fs::exists(usb_) && Clock::now() < patience) {
    std::this_thread::sleep_for(kTick);
  }
  usb_.clear();
}

void UsbCamera::run(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    pollfd event{socket_.get(), POLLIN, 0};
    if (!answers_) {
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
      continue;
    }
    if (::poll(&event, 1, 5) > 0 && !serve()) return;
    sendPending();
  }
}

bool UsbCamera::serve() {
  std::array<std::uint8_t, kHeader> header;
  if (!readAll(socket_.get(), header.data(), header.size())) return false;
  const std::uint32_t command = big32(header.data());
  const std::uint32_t sequence = big32(&header[4]);
  if (command == kSubmit) {
    const bool in = big32(&header[12]) == 1;
    const std::uint32_t length = big32(&header[24]);
    Bytes data(in ? 0 : length);
    if (!readAll(socket_.get(), data.data(), data.size())) return false;
    if (big32(&header[16]) != 0) {
      wanted_.push_back({sequence, length});
      return true;
    }
    std::array<std::uint8_t, 8> setup;
    std::copy_n(&header[40], 8, setup.begin());
    answerControl(sequence, setup, data);
  } else if (command == kUnlink) {
    const std::uint32_t unlinked = big32(&header[20]);
    const bool found = std::erase_if(
        wanted_, [unlinked](const Wanted& wanted) { return wanted.sequence == unlinked; });
    std::array<std::uint8_t, kHeader> out{};
    putBig32(out.data(), kUnlinkReply);
    putBig32(&out[4], sequence);
    putBig32(&out[20], static_cast<std::uint32_t>(found ? kConnectionReset : 0));
    ::send(socket_.get(), out.data(), out.size(), MSG_NOSIGNAL);
    if (wanted_.empty()) sent_ = frame_.size();
  }
  return true;
}

// `length`: of what was taken, where nothing is sent back.
void UsbCamera::reply(std::uint32_t sequence, std::int32_t status, const Bytes& data,
                      std::optional<std::size_t> length) const {
  Bytes out(kHeader);
  putBig32(out.data(), kSubmitReply);
  putBig32(&out[4], sequence);
  putBig32(&out[20], static_cast<std::uint32_t>(status));
  putBig32(&out[24], static_cast<std::uint32_t>(length.value_or(data.size())));
  append(out, data);
  ::send(socket_.get(), out.data(), out.size(), MSG_NOSIGNAL);
}

void UsbCamera::answerControl(std::uint32_t sequence, const std::array<std::uint8_t, 8>& setup,
                              const Bytes& data) {
  const std::uint8_t type = setup[0], request = setup[1];
  const unsigned value = static_cast<unsigned>(setup[2] | setup[3] << 8);
  const unsigned interface = setup[4], unit = setup[5];
  const std::size_t most = static_cast<std::size_t>(setup[6] | setup[7] << 8);
  if (request == 1 && (type & 0x60) == 0) {  // the endpoint's halt is cleared: the stream is off
    streams_ = false;
    wanted_.clear();
  }
  auto answer = (type & 0x60) == 0 ? standardReply(request, value)
                : interface == 1   ? streamingReply(request, value >> 8, data)
                                   : controlReply(request, unit, value >> 8, data);
  if (!answer) return reply(sequence, kStall, {});
  if (answer->size() > most) answer->resize(most);
  if ((type & 0x80) != 0) return reply(sequence, 0, *answer);
  reply(sequence, 0, {}, data.size());
}

std::optional<Bytes> UsbCamera::standardReply(std::uint8_t request, unsigned value) const {
  switch (request) {
    case 6:  // GET_DESCRIPTOR
      if (value >> 8 == 1) return deviceDescriptor();
      if (value >> 8 == 2) return configurationDescriptor();
      if (value >> 8 == 3) return stringDescriptor(value & 0xff);
      return std::nullopt;
    case 0:  // GET_STATUS
      return Bytes{0, 0};
    case 8:  // GET_CONFIGURATION
      return Bytes{1};
    case 10:  // GET_INTERFACE
      return Bytes{0};
    case 1:   // CLEAR_FEATURE
    case 3:   // SET_FEATURE
    case 9:   // SET_CONFIGURATION
    case 11:  // SET_INTERFACE
      return Bytes{};
    default:
      return std::nullopt;
  }
}

// Format, size and rate are negotiated ("probe") and fixed ("commit"), which starts the stream.
std::optional<Bytes> UsbCamera::streamingReply(std::uint8_t request, unsigned selector,
                                               const Bytes& data) {
  if (request == kGetLen) return Bytes{34, 0};
  if (request == kGetInfo) return Bytes{3};
  if (request == kSetCur) {
    if (data.size() < 8) return std::nullopt;
    format_ = std::clamp<std::uint8_t>(data[2], 1, 2);
    size_ = std::clamp<std::uint8_t>(data[3], 1, format_ == 1 ? kMjpgSizes : kYuyvSizes);
    const std::uint32_t asked = static_cast<std::uint32_t>(data[4] | data[5] << 8 | data[6] << 16) |
                                static_cast<std::uint32_t>(data[7]) << 24;
    interval_ = *std::ranges::min_element(kIntervals, {}, [asked](std::uint32_t interval) {
      return interval > asked ? interval - asked : asked - interval;
    });
    if (selector == kCommit) {
      streams_ = true;
      next_ = Clock::now();
      sent_ = frame_.size();
    }
    return Bytes{};
  }
  const auto [width, height] = kSizes[static_cast<std::size_t>(size_ - 1)];
  Bytes out{1, 0, format_, size_};
  append32(out, interval_);
  out.resize(18);
  append32(out, static_cast<std::uint32_t>(width * height * 2));
  append32(out, kPayload);
  append32(out, 48'000'000);
  append(out, {3, 0, 0, 0});
  return out;
}

std::optional<Bytes> UsbCamera::controlReply(std::uint8_t request, unsigned unit, unsigned selector,
                                             const Bytes& data) {
  const std::lock_guard lock(mutex_);
  for (Control& control : controls_) {
    if (control.unit != unit || control.selector != selector) continue;
    if (request == kSetCur) {
      std::uint32_t value = 0;
      for (std::size_t i = 0; i < data.size() && i < 4; ++i) {
        value |= static_cast<std::uint32_t>(data[i]) << (8 * i);
      }
      if (control.automatic != nullptr && valueOf(control.automatic) != control.byHand) {
        return std::nullopt;
      }
      control.value =
          control.bytes == 2 ? static_cast<std::int16_t>(value) : static_cast<std::int32_t>(value);
      return Bytes{};
    }
    if (request == kGetLen) return Bytes{static_cast<std::uint8_t>(control.bytes), 0};
    if (request == kGetInfo) return Bytes{3};  // can be read and set
    const std::int32_t value = request == kGetCur   ? control.value
                               : request == kGetMin ? control.least
                               : request == kGetMax ? control.most
                               : request == kGetRes ? control.step
                                                    : control.usual;
    if (request < kGetCur || request > kGetDef) return std::nullopt;
    Bytes out;
    append32(out, static_cast<std::uint32_t>(value));
    out.resize(control.bytes);
    return out;
  }
  return std::nullopt;
}

void UsbCamera::makeFrame() {
  const auto [width, height] = kSizes[static_cast<std::size_t>(size_ - 1)];
  const auto w = static_cast<std::size_t>(width), h = static_cast<std::size_t>(height);
  std::uint8_t level = 0, blue = 0;
  {
    const std::lock_guard lock(mutex_);
    level = static_cast<std::uint8_t>(levelOf(valueOf("exposure") * 1e-4, valueOf("gain")));
    blue = static_cast<std::uint8_t>(128 + (valueOf("temperature") - 4600) / 100);
  }
  Bytes luma(w * h, level);
  for (std::size_t y = 0; y < kBlockHeight; ++y) {
    for (std::size_t x = 0; x < w; ++x) {
      luma[y * w + x] = (number_ >> (x / (w / kBits)) & 1) != 0 ? 220 : 40;
    }
  }
  if (format_ == 1) {
    unsigned char* jpeg = nullptr;
    unsigned long size = 0;
    const std::unique_ptr<void, int (*)(tjhandle)> encoder(tjInitCompress(), tjDestroy);
    tjCompress2(encoder.get(), luma.data(), width, 0, height, TJPF_GRAY, &jpeg, &size, TJSAMP_GRAY,
                90, 0);
    frame_.assign(jpeg, jpeg + size);
    tjFree(jpeg);
  } else {
    frame_.clear();
    for (std::size_t i = 0; i < luma.size(); i += 2) {
      append(frame_, {luma[i], blue, luma[i + 1], 128});
    }
  }
  number_ = (number_ + 1) % kNumbers;
  if (cuts_.exchange(false)) frame_.resize(frame_.size() / 2);
  broken_ = marksBroken_.exchange(false);
  odd_ = !odd_;
  sent_ = 0;
}

void UsbCamera::sendPending() {
  while (streams_ && sends_ && !wanted_.empty()) {
    if (sent_ == frame_.size()) {
      if (Clock::now() < next_) return;
      makeFrame();
      next_ = std::max(next_ + Duration(std::int64_t{interval_} * 100), Clock::now());
    }
    const Wanted wanted = wanted_.front();
    wanted_.pop_front();
    const std::size_t part = std::min<std::size_t>(wanted.length - 2, frame_.size() - sent_);
    Bytes payload{2, kEndOfHeader};
    if (odd_) payload[1] |= 1;
    if (broken_) payload[1] |= kError;
    payload.insert(payload.end(), frame_.begin() + static_cast<std::ptrdiff_t>(sent_),
                   frame_.begin() + static_cast<std::ptrdiff_t>(sent_ + part));
    sent_ += part;
    if (sent_ == frame_.size()) payload[1] |= kEndOfFrame;
    reply(wanted.sequence, 0, payload);
  }
}

}  // namespace lightsketch
