#include "capture/device/gvcp_probe.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <string_view>

#include "capture/frame/descriptor.h"

namespace lightsketch {
namespace {

constexpr std::uint16_t kGvcpPort = 3956;
constexpr auto kRepeat = std::chrono::milliseconds(250);  // a datagram may be lost

sockaddr_in gvcpAddress(const std::string& ipv4Address) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(kGvcpPort);
  ::inet_pton(AF_INET, ipv4Address.c_str(), &address.sin_addr);
  return address;
}

constexpr std::size_t kHeaderSize = 8;

std::string toText(const in_addr& address) {
  std::array<char, INET_ADDRSTRLEN> text{};
  ::inet_ntop(AF_INET, &address, text.data(), text.size());
  return text.data();
}

}  // namespace

std::optional<CameraInfo> parseDiscoveryAnswer(std::span<const std::uint8_t> answer,
                                               const std::string& ipv4Address) {
  // Status 0, answer 0x0003. The payload is the first 248 bytes of the bootstrap registers (GigE
  // Vision 1.2, section 16.1).
  constexpr std::size_t kPayloadSize = 0xf8;
  if (answer.size() < kHeaderSize + kPayloadSize || answer[0] != 0 || answer[1] != 0 ||
      answer[2] != 0 || answer[3] != 3) {
    return std::nullopt;
  }
  const auto text = [&](std::size_t registerAddress, std::size_t maxSize) {
    const char* begin =
        reinterpret_cast<const char*>(answer.data()) + kHeaderSize + registerAddress;
    std::string found(begin, ::strnlen(begin, maxSize));
    // It goes to a terminal.
    std::replace_if(
        found.begin(), found.end(), [](char c) { return c < ' ' || c == 0x7f; }, '?');
    return found;
  };
  return CameraInfo{"aravis:" + ipv4Address, text(0x48, 32), text(0x68, 32), text(0xd8, 16)};
}

bool isIpv4Address(const std::string& text) {
  in_addr address{};
  return ::inet_pton(AF_INET, text.c_str(), &address) == 1;
}

std::vector<CameraInfo> probeCameras(std::span<const std::string> ipv4Addresses, Duration timeout) {
  // Discovery: key, flags (answer wanted), command 0x0002, no payload, request id.
  static constexpr std::array<std::uint8_t, kHeaderSize> kRequest = {0x42, 0x01, 0,    2,
                                                                     0,    0,    0xff, 0xff};
  std::vector<CameraInfo> found;
  const Descriptor socket(::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  const TimePoint end = Clock::now() + timeout;
  while (found.size() < ipv4Addresses.size() && Clock::now() < end) {
    for (const std::string& address : ipv4Addresses) {
      const sockaddr_in to = gvcpAddress(address);
      (void)::sendto(socket.get(), kRequest.data(), kRequest.size(), 0,
                     reinterpret_cast<const sockaddr*>(&to), sizeof to);
    }
    const TimePoint again = std::min(end, Clock::now() + kRepeat);
    while (found.size() < ipv4Addresses.size()) {
      const auto left = std::chrono::ceil<std::chrono::milliseconds>(again - Clock::now()).count();
      pollfd event{socket.get(), POLLIN, 0};
      if (left <= 0 || ::poll(&event, 1, static_cast<int>(left)) <= 0) break;
      std::array<std::uint8_t, 1024> answer;
      sockaddr_in from{};
      socklen_t length = sizeof from;
      const ssize_t size = ::recvfrom(socket.get(), answer.data(), answer.size(), MSG_DONTWAIT,
                                      reinterpret_cast<sockaddr*>(&from), &length);
      if (size < 0) continue;
      auto info = parseDiscoveryAnswer(std::span(answer).first(static_cast<std::size_t>(size)),
                                       toText(from.sin_addr));
      if (!info) continue;
      const bool known = std::any_of(found.begin(), found.end(), [&](const CameraInfo& other) {
        return other.address == info->address;
      });
      if (!known) found.push_back(std::move(*info));
    }
  }
  return found;
}

std::string localAddressTowards(const std::string& ipv4Address) {
  // Connecting a datagram socket sends nothing; it only makes the kernel choose a route.
  const Descriptor socket(::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  const sockaddr_in to = gvcpAddress(ipv4Address);
  sockaddr_in own{};
  socklen_t length = sizeof own;
  if (::connect(socket.get(), reinterpret_cast<const sockaddr*>(&to), sizeof to) != 0 ||
      ::getsockname(socket.get(), reinterpret_cast<sockaddr*>(&own), &length) != 0) {
    return {};
  }
  return toText(own.sin_addr);
}

}  // namespace lightsketch
