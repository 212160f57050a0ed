// A camera, whatever it is connected by. Addresses:
//   aravis:127.0.0.11       a GigE Vision camera by its IPv4 address, or any name Aravis knows
//   v4l2:/dev/video0        a camera that the kernel drives; ?format=MJPG: in that format only
//   replay:FOLDER           a stream kept by ReplayWriter, at the speed it was recorded
//   replay:FOLDER?rate=2    twice as fast; rate=0: as fast as the callback returns
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "capture/frame/frame.h"
#include "capture/frame/result.h"

namespace lightsketch {

struct CameraInfo {
  std::string address;
  std::string vendor;
  std::string model;
  std::string serial;
};

// What to ask for; absent fields are left as the camera has them.
struct CameraSettings {
  std::optional<PixelFormat> format;
  std::optional<Region> region;  // Region{}: the whole sensor
  std::optional<double> exposureSeconds;
  std::optional<double> gainDb;
  std::optional<double> framesPerSecond;
  // What starts each exposure: "" the camera's own rate, "Software" setFeature("TriggerSoftware"),
  // or an input such as "Line1". Not all cameras have any other than "".
  std::optional<std::string> trigger;
};

struct StreamStatistics {
  std::uint64_t delivered = 0;   // frames handed to the callback
  std::uint64_t incomplete = 0;  // frames with packets missing or of a wrong shape; not handed on
  std::uint64_t skipped = 0;     // whole frames not handed on: the warm-up frame, and those whose
                                 // exposure is in doubt because it was just being changed
  std::uint64_t lost = 0;        // gaps in the device's frame counter
  std::uint64_t underruns = 0;   // frames for which no buffer was free; part of `lost`
  std::uint64_t packetsReceived = 0;  // 0 where the link has no packets
  std::uint64_t packetsMissing = 0;
  std::uint64_t packetsResent = 0;
  int packetBytes = 0;             // as negotiated with the camera
  std::uint64_t socketBuffer = 0;  // bytes that the system really keeps for packets
  std::uint64_t implausible = 0;   // whole frames withheld because a packet's place, a checksum or
                                   // the time of exposure cannot be right
};

using FrameCallback = std::function<void(Frame&&)>;
// Called once when the camera is lost (kDevice: unplugged, control lost) or when a replay has ended
// (kCancelled) or cannot go on (what is wrong with its files). Neither callback may call stop().
using EndCallback = std::function<void(const Error&)>;

class Camera {
 public:
  virtual ~Camera() = default;

  virtual const CameraInfo& info() const = 0;
  // Returns what the camera really uses now, every field set. May be called while streaming for
  // exposure and gain: frames exposed before carry the old values, frames in doubt are skipped.
  // Fails with kInvalidArgument and the limits if the camera cannot do it. A replay is what it is:
  // it returns its recording's values, whatever was asked.
  virtual Result<CameraSettings> configure(const CameraSettings& settings) = 0;
  // Frames come on a thread of the camera's own, in order; the callback must only enqueue.
  virtual Result<void> start(FrameCallback onFrame, EndCallback onEnd = {}) = 0;
  // No callback runs after it returns. Bounded in time, also for a camera that is gone.
  virtual void stop() = 0;
  virtual StreamStatistics statistics() const = 0;
  // Whether frames come from now on, at moments that starting it chooses; false for a recording.
  virtual bool isLive() const { return true; }

  // What the user should know of how it is set up, a line each: a format that was fallen back to, a
  // socket buffer that the system keeps small. Complete once it streams.
  virtual std::vector<std::string> notes() const { return {}; }

  // GenICam features by name, for what only some cameras have. Setting a command executes it.
  virtual bool hasFeature(const std::string& name) const = 0;
  virtual Result<void> setFeature(const std::string& name, double value) = 0;
};

// What is connected; also finds a simulated rig that runs on its default addresses.
Result<std::vector<CameraInfo>> listCameras();
// Fails with kNotFound and a message that says what was tried and what is connected.
Result<std::unique_ptr<Camera>> openCamera(const std::string& address);
// The wanted pixel format is a preference: a camera that does not offer it stays in the one it has,
// which the answer tells. With `grey`, one that would send colours sends Mono8.
Result<CameraSettings> configureNearest(Camera& camera, CameraSettings wanted, bool grey = false);
// How whoever needs a camera gets it by its address: openCamera, or something around it that also
// looks at the frames.
using CameraOpener = std::function<Result<std::unique_ptr<Camera>>(const std::string& address)>;

}  // namespace lightsketch
