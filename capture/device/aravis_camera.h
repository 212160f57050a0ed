// GigE Vision and USB3 Vision cameras through Aravis.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "capture/device/camera.h"

namespace lightsketch {

// `address`: an IPv4 address, or a name as Aravis knows it (vendor-serial, MAC). Takes control of
// the camera until destruction.
Result<std::unique_ptr<Camera>> openAravisCamera(const std::string& address);

// What Aravis discovers by itself: about a second. Binds each network interface for that time.
std::vector<CameraInfo> discoverAravisCameras();

}  // namespace lightsketch
