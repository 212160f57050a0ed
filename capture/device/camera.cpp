#include "capture/device/camera.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <future>

#include "capture/device/aravis_camera.h"
#include "capture/device/gvcp_probe.h"
#include "capture/device/replay_camera.h"
#include "capture/device/v4l2_camera.h"

namespace lightsketch {
namespace {

// Where a simulated rig listens unless told otherwise.
const std::array<std::string, 2> kRigAddresses = {"127.0.0.11", "127.0.0.12"};

Result<std::unique_ptr<Camera>> openReplay(const std::string& target) {
  const std::string kQuery = "?rate=";
  const std::size_t query = target.rfind(kQuery);
  double rate = 1;
  if (query != std::string::npos) {
    const char* begin = target.data() + query + kQuery.size();
    const char* end = target.data() + target.size();
    const auto parsed = std::from_chars(begin, end, rate);
    if (parsed.ec != std::errc() || parsed.ptr != end || !(rate >= 0 && rate <= 1e6)) {
      return failure(ErrorCode::kInvalidArgument,
                     "replay:{}: the rate must be a number from 0 (as fast as possible) to 1e6",
                     target);
    }
  }
  return openReplayCamera(target.substr(0, query), rate);
}

}  // namespace

Result<std::vector<CameraInfo>> listCameras() {
  auto discovery = std::async(std::launch::async, discoverAravisCameras);
  std::vector<CameraInfo> cameras = probeCameras(kRigAddresses, std::chrono::milliseconds(500));
  for (CameraInfo& camera : discovery.get()) {
    const bool known = std::any_of(cameras.begin(), cameras.end(), [&](const CameraInfo& other) {
      return other.address == camera.address;
    });
    if (!known) cameras.push_back(std::move(camera));
  }
  for (CameraInfo& camera : listV4l2Cameras()) cameras.push_back(std::move(camera));
  std::sort(cameras.begin(), cameras.end(),
            [](const CameraInfo& a, const CameraInfo& b) { return a.address < b.address; });
  return cameras;
}

Result<std::unique_ptr<Camera>> openCamera(const std::string& address) {
  const std::size_t colon = address.find(':');
  const std::string scheme = address.substr(0, colon);
  const std::string target = colon == std::string::npos ? "" : address.substr(colon + 1);
  if (target.empty() || (scheme != "aravis" && scheme != "v4l2" && scheme != "replay")) {
    return failure(ErrorCode::kInvalidArgument,
                   "'{}' names no camera: expected aravis:ADDRESS, v4l2:/dev/video0 or "
                   "replay:FOLDER",
                   address);
  }
  if (scheme == "replay") return openReplay(target);

  auto camera = scheme == "v4l2" ? openV4l2Camera(target) : openAravisCamera(target);
  if (!camera && camera.error().code == ErrorCode::kNotFound) {
    std::string connected;
    ASSIGN_OR_RETURN(const auto cameras, listCameras());
    for (const CameraInfo& info : cameras) {
      connected += fmt::format("{}{} ({} {})", connected.empty() ? "" : ", ", info.address,
                               info.vendor, info.model);
    }
    camera.error().message += connected.empty() ? "; no camera is connected; start one, or the "
                                                  "simulated rig with 'lightsketch rig'"
                                                : "; connected: " + connected;
  }
  return camera;
}

Result<CameraSettings> configureNearest(Camera& camera, CameraSettings wanted, bool grey) {
  auto settings = camera.configure(wanted);
  if (!settings && wanted.format && settings.error().code == ErrorCode::kInvalidArgument) {
    wanted.format.reset();
    settings = camera.configure(wanted);
  }
  if (!settings || !settings->format || !grey) return settings;
  const PixelFormatInfo& info = pixelFormatInfo(*settings->format);
  if (!info.isBayer && info.channels == 1) return settings;
  wanted.format = PixelFormat::kMono8;
  return camera.configure(wanted);
}

}  // namespace lightsketch
