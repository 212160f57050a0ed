// The simulated camera's protocol, spoken byte by byte.
#include "capture/rig/gige_device.h"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <bit>
#include <random>
#include <string>

#include "capture/rig/genicam_xml.h"
#include "tests/capture/device/pattern_source.h"

namespace lightsketch {
namespace {

using Bytes = std::vector<std::uint8_t>;

const std::string kAddress = ownAddress(3);

void append32(Bytes& bytes, std::uint32_t value) {
  for (int shift = 24; shift >= 0; shift -= 8) {
    bytes.push_back(static_cast<std::uint8_t>(value >> shift));
  }
}
std::uint32_t word(const Bytes& bytes, std::size_t at) {
  return static_cast<std::uint32_t>(bytes.at(at) << 24 | bytes.at(at + 1) << 16 |
                                    bytes.at(at + 2) << 8 | bytes.at(at + 3));
}

// A GVCP client that holds its own port.
class Client {
 public:
  Client() : fd_(::socket(AF_INET, SOCK_DGRAM, 0)) {
    address_.sin_family = AF_INET;
    address_.sin_port = htons(3956);
    ::inet_pton(AF_INET, kAddress.c_str(), &address_.sin_addr);
  }
  ~Client() { ::close(fd_); }
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;

  void sendRaw(const Bytes& packet) {
    ::sendto(fd_, packet.data(), packet.size(), 0, reinterpret_cast<sockaddr*>(&address_),
             sizeof address_);
  }
  // Empty if nothing comes.
  Bytes receive(int milliseconds = 3000) {
    pollfd event{fd_, POLLIN, 0};
    if (::poll(&event, 1, milliseconds) <= 0) return {};
    Bytes packet(65536);
    const ssize_t size = ::recv(fd_, packet.data(), packet.size(), 0);
    packet.resize(static_cast<std::size_t>(std::max<ssize_t>(size, 0)));
    return packet;
  }
  Bytes request(std::uint16_t command, const Bytes& payload) {
    ++id_;
    Bytes packet = {0x42,
                    1,
                    static_cast<std::uint8_t>(command >> 8),
                    static_cast<std::uint8_t>(command),
                    static_cast<std::uint8_t>(payload.size() >> 8),
                    static_cast<std::uint8_t>(payload.size()),
                    static_cast<std::uint8_t>(id_ >> 8),
                    static_cast<std::uint8_t>(id_)};
    packet.insert(packet.end(), payload.begin(), payload.end());
    sendRaw(packet);
    for (;;) {  // answers to earlier packets may lie before ours
      Bytes answer = receive();
      if (answer.empty()) return answer;
      if (answer.size() >= 8 && (answer[6] << 8 | answer[7]) == id_) {
        EXPECT_EQ(answer[2] << 8 | answer[3], command + 1);
        EXPECT_EQ(static_cast<std::size_t>(answer[4] << 8 | answer[5]), answer.size() - 8);
        return answer;
      }
    }
  }
  static int status(const Bytes& answer) {
    return answer.size() < 8 ? -1 : answer[0] << 8 | answer[1];
  }
  int write(std::uint32_t address, std::uint32_t value) {
    Bytes payload;
    append32(payload, address);
    append32(payload, value);
    return status(request(0x82, payload));
  }
  int writeDouble(std::uint32_t address, double value) {
    const auto bits = std::bit_cast<std::uint64_t>(value);
    Bytes payload;
    append32(payload, address);
    append32(payload, static_cast<std::uint32_t>(bits >> 32));
    append32(payload, static_cast<std::uint32_t>(bits));
    return status(request(0x86, payload));
  }
  std::uint32_t read(std::uint32_t address) {
    Bytes payload;
    append32(payload, address);
    const Bytes answer = request(0x80, payload);
    return answer.size() == 12 ? word(answer, 8) : 0xdeadbeef;
  }
  Bytes readMemory(std::uint32_t address, std::uint32_t size) {
    Bytes payload;
    append32(payload, address);
    append32(payload, size);
    return request(0x84, payload);
  }
  std::uint16_t port() const {
    sockaddr_in own{};
    socklen_t length = sizeof own;
    ::getsockname(fd_, reinterpret_cast<sockaddr*>(&own), &length);
    return ntohs(own.sin_port);
  }
  void bindHere() {
    sockaddr_in own{};
    own.sin_family = AF_INET;
    own.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    ASSERT_EQ(::bind(fd_, reinterpret_cast<sockaddr*>(&own), sizeof own), 0);
  }
  // Streams to `receiver`.
  void startStream(const Client& receiver) {
    EXPECT_EQ(write(gige::kControlPrivilege, 2), 0);
    EXPECT_EQ(write(gige::kStreamAddress, INADDR_LOOPBACK), 0);
    EXPECT_EQ(write(gige::kStreamPort, receiver.port()), 0);
    EXPECT_EQ(write(gige::kAcquisition, 1), 0);
  }

 private:
  int fd_;
  sockaddr_in address_{};
  std::uint16_t id_ = 0;
};

class GigeDeviceTest : public ::testing::Test {
 protected:
  GigeDeviceTest() {
    GigeDeviceOptions options;
    options.address = kAddress;
    options.defaultFramesPerSecond = 100;
    options.defaultExposureSeconds = 0.001;
    auto started = GigeDevice::start(source_, options, Clock::now());
    if (!started) ADD_FAILURE() << started.error().message;
    device_ = std::move(started).value();
  }

  PatternSource source_{64, 48, {PixelFormat::kMono8, PixelFormat::kMono12}};
  std::unique_ptr<GigeDevice> device_;
  Client client_;
};

TEST_F(GigeDeviceTest, AnswersDiscoveryWithItsNames) {
  const Bytes answer = client_.request(0x02, {});
  ASSERT_EQ(answer.size(), 8 + 0xf8u);
  in_addr ip{};
  ::inet_pton(AF_INET, kAddress.c_str(), &ip);
  EXPECT_EQ(word(answer, 8 + gige::kCurrentIp), ntohl(ip.s_addr));
  EXPECT_STREQ(reinterpret_cast<const char*>(&answer[8 + gige::kManufacturer]), "lightsketch");
  EXPECT_STREQ(reinterpret_cast<const char*>(&answer[8 + gige::kModel]), "SimulatedScene");
  EXPECT_STREQ(reinterpret_cast<const char*>(&answer[8 + gige::kSerial]), "SIM-1");
}

TEST_F(GigeDeviceTest, ServesItsDescription) {
  const Bytes url = client_.readMemory(gige::kXmlUrl, 512);
  unsigned address = 0, size = 0;
  ASSERT_EQ(std::sscanf(reinterpret_cast<const char*>(&url.at(12)), "Local:camera.xml;%x;%x",
                        &address, &size),
            2);
  std::string xml;
  for (unsigned at = 0; at < size; at += 512) {
    const Bytes part = client_.readMemory(address + at, std::min(512u, size - at));
    ASSERT_EQ(Client::status(part), 0);
    xml.append(part.begin() + 12, part.end());
  }
  EXPECT_EQ(xml.size(), size);
  EXPECT_EQ(xml.rfind("<?xml", 0), 0u);
  EXPECT_NE(xml.find("</RegisterDescription>"), std::string::npos);
  EXPECT_NE(xml.find("\"Mono12\""), std::string::npos);
}

TEST_F(GigeDeviceTest, RefusesWhatGvcpSaysIsWrong) {
  constexpr int kInvalidParameter = 0x8002, kInvalidAddress = 0x8003, kWriteProtect = 0x8004,
                kBadAlignment = 0x8005, kAccessDenied = 0x8006, kBusy = 0x8007,
                kNotImplemented = 0x8001;
  Client other;
  EXPECT_EQ(client_.write(gige::kWidth, 32), kAccessDenied);  // not in control
  EXPECT_EQ(client_.write(gige::kControlPrivilege, 2), 0);
  EXPECT_EQ(other.write(gige::kControlPrivilege, 2), kAccessDenied);
  EXPECT_EQ(other.write(gige::kControlPrivilege, 0), kAccessDenied);
  EXPECT_EQ(other.read(gige::kControlPrivilege), 2u);  // reading is free

  EXPECT_EQ(client_.write(gige::kWidth, 32), 0);
  EXPECT_EQ(client_.read(gige::kPayloadSize), 32 * 48u);
  EXPECT_EQ(client_.write(gige::kWidth, 33), kInvalidParameter);
  EXPECT_EQ(client_.write(gige::kWidth, 66), kInvalidParameter);
  EXPECT_EQ(client_.write(gige::kOffsetX, 34), kInvalidParameter);
  EXPECT_EQ(client_.write(gige::kOffsetX, 0xfffffffe), kInvalidParameter);
  EXPECT_EQ(client_.write(gige::kPixelFormat, 1), kInvalidParameter);
  EXPECT_EQ(client_.write(gige::kPixelFormat, 0x02180014), kInvalidParameter);  // RGB8: not offered
  EXPECT_EQ(client_.write(gige::kStreamPacketSize, 100), kInvalidParameter);
  EXPECT_EQ(client_.writeDouble(gige::kExposureTime, -1), kInvalidParameter);
  EXPECT_EQ(client_.writeDouble(gige::kExposureTime, NAN), kInvalidParameter);
  EXPECT_EQ(client_.writeDouble(gige::kExposureTime, 2000), 0);
  EXPECT_EQ(client_.write(gige::kModel, 0), kWriteProtect);
  EXPECT_EQ(client_.write(gige::kXml, 0), kWriteProtect);
  EXPECT_EQ(client_.write(gige::kRegistersEnd, 0), kInvalidAddress);
  EXPECT_EQ(client_.write(gige::kWidth + 1, 0), kBadAlignment);
  EXPECT_EQ(Client::status(client_.readMemory(gige::kRegistersEnd - 4, 8)), kInvalidAddress);
  EXPECT_EQ(Client::status(client_.readMemory(0xfffffffc, 536)), kInvalidAddress);
  EXPECT_EQ(Client::status(client_.readMemory(0, 0xffff)), kInvalidParameter);
  EXPECT_EQ(Client::status(client_.readMemory(2, 4)), kBadAlignment);
  EXPECT_EQ(Client::status(client_.request(0x1234, {})), kNotImplemented);

  Client receiver;
  receiver.bindHere();
  client_.startStream(receiver);
  EXPECT_EQ(client_.write(gige::kWidth, 40), kBusy);
  EXPECT_EQ(client_.writeDouble(gige::kGain, 6), 0);
  EXPECT_EQ(client_.write(gige::kAcquisition, 0), 0);
  EXPECT_EQ(client_.write(gige::kWidth, 40), 0);
}

TEST_F(GigeDeviceTest, SurvivesMalformedPackets) {
  EXPECT_EQ(client_.write(gige::kControlPrivilege, 2), 0);
  Client stranger;
  std::mt19937 random(3);
  const auto any = [&](unsigned below) {
    return static_cast<std::uint8_t>(std::uniform_int_distribution<unsigned>(0, below - 1)(random));
  };
  constexpr std::array<std::uint8_t, 8> kCommands = {0x02, 0x40, 0x80, 0x82,
                                                     0x84, 0x86, 0x04, 0x88};
  for (int i = 0; i < 4000; ++i) {
    // Half with a plausible header whose size may lie, half noise; from the controller and not.
    Bytes packet(std::uniform_int_distribution<std::size_t>(0, i % 50 == 0 ? 3000 : 40)(random));
    for (auto& byte : packet) byte = any(256);
    if (i % 2 == 0 && packet.size() >= 8) {
      packet[0] = 0x42;
      packet[2] = 0;
      packet[3] = kCommands[any(8)];
      packet[4] = 0;
      packet[5] = static_cast<std::uint8_t>(i % 4 == 0 ? any(255) : packet.size() - 8);
      if (packet.size() >= 12) packet[8] = packet[9] = 0;  // low addresses, where registers are
    }
    (i % 3 == 0 ? client_ : stranger).sendRaw(packet);
    if (i % 100 == 0) {
      ASSERT_EQ(client_.read(gige::kSensorWidth), 64u) << i;
    }
  }
  EXPECT_EQ(client_.read(gige::kSensorHeight), 48u);
}

TEST_F(GigeDeviceTest, StreamsWholeFramesAndResendsWhatIsAskedFor) {
  Client receiver;
  receiver.bindHere();
  EXPECT_EQ(client_.write(gige::kControlPrivilege, 2), 0);
  EXPECT_EQ(client_.write(gige::kStreamPacketSize, 1036), 0);  // 1000 bytes of picture a packet
  client_.startStream(receiver);
  // 64 x 48 bytes: leader, four data packets, trailer.
  Bytes picture;
  int frame = 0;
  for (;;) {
    const Bytes packet = receiver.receive();
    ASSERT_GE(packet.size(), 8u);
    EXPECT_EQ(word(packet, 0) >> 16, 0u);
    const std::uint32_t kind = word(packet, 4) >> 24, index = word(packet, 4) & 0xffffff;
    if (frame == 0) frame = packet[2] << 8 | packet[3];
    ASSERT_EQ(packet[2] << 8 | packet[3], frame);
    EXPECT_EQ(kind, index == 0 ? 1u : index == 5 ? 2u : 3u);
    if (kind == 1) {
      EXPECT_EQ(word(packet, 20), 0x01080001u);
      EXPECT_EQ(word(packet, 24), 64u);
      EXPECT_EQ(word(packet, 28), 48u);
    }
    if (kind == 3) picture.insert(picture.end(), packet.begin() + 8, packet.end());
    if (kind == 2) break;
  }
  EXPECT_EQ(frame, 1);
  EXPECT_EQ(picture, patternBytes(0, PixelFormat::kMono8, {0, 0, 64, 48}));

  // Packets 2 and 3 of a recent frame once more, asked for from the stream's own socket.
  ASSERT_TRUE(eventually([&] { return device_->framesSent() > 5; }));
  EXPECT_EQ(client_.write(gige::kAcquisition, 0), 0);
  std::uint16_t last = 0;
  for (Bytes packet = receiver.receive(300); !packet.empty(); packet = receiver.receive(300)) {
    last = static_cast<std::uint16_t>(packet[2] << 8 | packet[3]);
  }
  const auto ask = [&](std::uint16_t id, std::uint32_t first, std::uint32_t end) {
    Bytes packet = {0x42, 0, 0, 0x40, 0, 12, 0, 9, 0, 0};
    packet.push_back(static_cast<std::uint8_t>(id >> 8));
    packet.push_back(static_cast<std::uint8_t>(id));
    append32(packet, first);
    append32(packet, end);
    receiver.sendRaw(packet);
  };
  ask(last, 2, 3);
  const Bytes whole = patternBytes(last - 1u, PixelFormat::kMono8, {0, 0, 64, 48});
  for (const std::uint32_t index : {2u, 3u}) {
    const Bytes packet = receiver.receive();
    ASSERT_EQ(packet.size(), 1008u);
    EXPECT_EQ(word(packet, 4), 3u << 24 | index);
    EXPECT_TRUE(std::equal(packet.begin() + 8, packet.end(), whole.begin() + (index - 1) * 1000));
  }
  // What is not kept any more is said to be so; a range without end stays within the frame.
  ask(static_cast<std::uint16_t>(last + 1000), 2, 3);
  const Bytes gone = receiver.receive();
  ASSERT_EQ(gone.size(), 8u);
  EXPECT_EQ(word(gone, 0) >> 16, 0x800cu);
  ask(last, 5, 0xffffff);
  EXPECT_FALSE(receiver.receive().empty());
  EXPECT_TRUE(receiver.receive(300).empty());
}

TEST_F(GigeDeviceTest, MissingHeartbeatStopsTheStreamAndFreesControl) {
  Client receiver;
  receiver.bindHere();
  client_.startStream(receiver);
  EXPECT_EQ(client_.write(gige::kHeartbeatTimeout, 500), 0);
  ASSERT_TRUE(eventually([&] { return device_->framesSent() > 3; }));
  Client other;
  ASSERT_TRUE(eventually([&] { return other.read(gige::kControlPrivilege) == 0; }));
  EXPECT_EQ(other.read(gige::kAcquisition), 0u);
  EXPECT_EQ(other.write(gige::kControlPrivilege, 2), 0);
  EXPECT_EQ(client_.write(gige::kAcquisition, 1), 0x8006);
  // At most one frame was on its way.
  const std::uint64_t sent = device_->framesSent();
  std::this_thread::sleep_for(std::chrono::milliseconds(200));
  EXPECT_LE(device_->framesSent(), sent + 1);
}

TEST_F(GigeDeviceTest, TakenAddressIsNamed) {
  GigeDeviceOptions options;
  options.address = kAddress;
  const auto second = GigeDevice::start(source_, options, Clock::now());
  ASSERT_FALSE(second);
  EXPECT_NE(second.error().message.find(kAddress + ":3956 is in use"), std::string::npos)
      << second.error().message;
}

TEST(GigeDeviceStart, ForeignOrNonsensicalOptionsAreRefused) {
  PatternSource source(64, 48, {PixelFormat::kMono8});
  PatternSource odd(63, 48, {PixelFormat::kMono8});
  PatternSource none(64, 48, {});
  const auto message = [](FrameSource& frames, const GigeDeviceOptions& options) {
    const auto device = GigeDevice::start(frames, options, Clock::now());
    return device ? std::string() : device.error().message;
  };
  GigeDeviceOptions options;
  options.address = "192.0.2.1";  // RFC 5737: nobody's
  EXPECT_NE(message(source, options).find("192.0.2.1"), std::string::npos);
  options.address = "localhost.";
  EXPECT_NE(message(source, options).find("not an IPv4 address"), std::string::npos);
  options.address = ownAddress(4);
  EXPECT_EQ(message(source, options), "");
  EXPECT_NE(message(odd, options), "");
  EXPECT_NE(message(none, options), "");
  options.defaultFramesPerSecond = 0;
  EXPECT_NE(message(source, options).find(ownAddress(4)), std::string::npos);
}

}  // namespace
}  // namespace lightsketch
