// A GigE Vision camera on a loopback address: GVCP control and GVSP streaming over UDP sockets, no
// root. Serves whatever pictures its FrameSource makes.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "capture/frame/frame.h"
#include "capture/frame/result.h"
#include "capture/rig/rig_program.h"

namespace lightsketch {

// What the camera's registers say when a frame is exposed.
struct ExposureRequest {
  std::uint64_t index = 0;  // frames since the device was started
  double timeSeconds = 0;   // true time of mid-exposure since the rig was started
  PixelFormat format = PixelFormat::kMono8;
  Region region;
  double exposureSeconds = 0;
  double gainDb = 0;
};

// What the program tells the person with the lamp, as features of the source camera ("GuideMode",
// "GuideX", "GuideY", "GuideZ"); the simulated hand obeys it in its own clumsy way.
struct Guide {
  enum class Mode { kWander = 0, kLampOff = 1, kFollow = 2 };
  Mode mode = Mode::kWander;
  Eigen::Vector3d target = Eigen::Vector3d::UnitZ();  // wanted light direction, scene frame
};

class FrameSource {
 public:
  virtual ~FrameSource() = default;
  virtual int sensorWidth() const = 0;
  virtual int sensorHeight() const = 0;
  virtual std::vector<PixelFormat> formats() const = 0;  // the first is the default
  // Fills `bytes` (region, format, little endian, no padding), which comes zeroed and of the right
  // size. Called on the device's frame thread; may take as long as it likes.
  virtual void expose(const ExposureRequest& request, std::vector<std::uint8_t>& bytes) = 0;
  // Called on the same thread as expose(), never during it, also while nothing streams.
  virtual void guide(const Guide&) {}
  // The feature "RigProgram" was written, on any camera; like guide().
  virtual void startProgram(RigProgram) {}
};

struct GigeDeviceOptions {
  std::string address = "127.0.0.11";
  int controlPort = 3956;  // GVCP; Aravis only talks to 3956
  std::string model = "SimulatedScene";
  std::string serial = "SIM-1";
  double defaultFramesPerSecond = 15;
  double defaultExposureSeconds = 0.01;
  double clockOffsetSeconds = 0;  // the device's clock against the host's
  double clockDriftPpm = 0;
  bool timestampLatch = true;      // false: like cameras that cannot be asked for their time
  std::uint16_t firstFrameId = 1;  // of every acquisition; ids are 16 bits wide and wrap 65535 -> 1
  int packetsPerBurst = 24;        // pacing: this many packets, then a pause of 0.5 ms, so that a
                                   // default socket buffer (208 KiB) keeps up
  double packetLoss = 0;           // fraction of packets not sent at first; resends are honoured
  std::uint32_t seed = 1;
  RigProgram program = RigProgram::kLamp;  // what "RigProgram" says at first
};

// Runs on threads of its own from start() to destruction: one answers GVCP, one exposes and sends,
// so that a slow expose() never delays an answer. Stops streaming when the controller's heartbeat
// stops. Registers out of range are refused, format and region while streaming too.
class GigeDevice {
 public:
  // `source` must outlive the device. `startTime` is the rig's time zero. Fails if the address is
  // not one of this machine's or its port is taken.
  static Result<std::unique_ptr<GigeDevice>> start(FrameSource& source,
                                                   const GigeDeviceOptions& options,
                                                   TimePoint startTime);
  ~GigeDevice();
  std::uint64_t framesSent() const;

 private:
  struct State;
  explicit GigeDevice(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace lightsketch
