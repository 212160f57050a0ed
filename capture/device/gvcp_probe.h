// Asks addresses directly whether a GigE Vision camera answers there.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "capture/device/camera.h"
#include "capture/frame/time.h"

namespace lightsketch {

bool isIpv4Address(const std::string& text);

// Sends GVCP discovery requests to each IPv4 address itself (no broadcast, no binding to an
// interface), a few times within `timeout`, and returns who answered as soon as all have. Finds
// cameras on loopback addresses, which discovery by broadcast cannot.
std::vector<CameraInfo> probeCameras(std::span<const std::string> ipv4Addresses, Duration timeout);

// What a datagram from that address says of its camera; nothing if it is no answer to a discovery.
std::optional<CameraInfo> parseDiscoveryAnswer(std::span<const std::uint8_t> answer,
                                               const std::string& ipv4Address);

// The address that this machine uses towards `ipv4Address`, as the kernel routes; empty if none.
std::string localAddressTowards(const std::string& ipv4Address);

}  // namespace lightsketch
