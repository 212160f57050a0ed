// A GigE Vision camera on a loopback address: GVCP control and GVSP streaming over UDP sockets, no
// root. Serves whatever pictures its FrameSource makes.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
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

// A network that several cameras share: what its queue has no room for is lost.
class SlowLink {
 public:
  SlowLink(double bytesPerSecond, double queueBytes)
      : bytesPerSecond_(bytesPerSecond), queueBytes_(queueBytes) {}
  // Whether a packet gets through. Thread-safe.
  bool pass(std::size_t bytes);

 private:
  const double bytesPerSecond_;
  const double queueBytes_;
  std::mutex mutex_;  // Guards the following.
  double queued_ = 0;
  TimePoint since_ = Clock::now();
};

// What goes wrong with a camera and on its wire. Probabilities are of packets where nothing else is
// said, drawn from the device's seed. Payload carries no checksum in GVSP, headers neither; UDP's
// protects both on a real wire, so what is damaged here is what a camera itself gets wrong.
struct GigeFaults {
  double loss = 0;              // not sent at first
  double resendLoss = 0;        // not sent again either
  bool resend = true;           // false: what is asked for again is refused as unavailable
  double duplicated = 0;        // sent twice
  double reordered = 0;         // sent after up to eight others
  double corruptedHeader = 0;   // one bit of the GVSP header or of the leader flipped, but none of
                                // the time of exposure
  double corruptedLength = 0;   // cut short, or longer; GVSP has only multiples of four
  double corruptedPayload = 0;  // one bit of the picture flipped
  double stalled = 0;           // of frames: nothing is sent for stallSeconds in their middle
  double stallSeconds = 0;
  bool frozen = false;  // neither answers nor sends
  bool silent = false;  // answers, but sends no frames
  bool zeroTimestamps = false;
  double frameClockSeconds = 0;   // the frames' time is of another epoch than the latched clock
  double deviceClockSeconds = 0;  // the clock has been set, latch and frames alike
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
  int packetsPerBurst = 24;        // pacing: so many times 1400 bytes, then a pause of 0.5 ms, so
                                   // that a default socket buffer (208 KiB) keeps up
  int mtu = 1500;                  // of the way to the host: larger packets get lost
  GigeFaults faults;               // at first; setFaults changes them
  std::shared_ptr<SlowLink> link;  // null: a link of one's own, fast enough
  std::uint32_t seed = 1;
  RigProgram program = RigProgram::kLamp;  // what "RigProgram" says at first
  std::uint32_t onlyFormat = 0;            // code of the only one offered, packed ones included
  bool chunks = false;                     // exposure, gain, time and CRC with every frame
  bool ptp = false;                        // a clock that can follow others'
  bool stamp = false;                      // frames begin with a stamp, see readStamp
};

// Runs on threads of its own from start() to destruction: one answers GVCP, one exposes and sends,
// so that a slow expose() never delays an answer. Stops streaming when the controller's heartbeat
// stops. Registers out of range are refused, format and region while streaming too.
//
// Triggers are Software and Line1, an edge of which is pulse().
class GigeDevice {
 public:
  // `source` must outlive the device. `startTime` is the rig's time zero. Fails if the address is
  // not one of this machine's or its port is taken.
  static Result<std::unique_ptr<GigeDevice>> start(FrameSource& source,
                                                   const GigeDeviceOptions& options,
                                                   TimePoint startTime);
  ~GigeDevice();
  std::uint64_t framesSent() const;
  void setFaults(const GigeFaults& faults);
  void pulse();

 private:
  struct State;
  explicit GigeDevice(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

// What a stamped frame says of itself, in its first 48 samples, four bits each: its index and time
// of mid-exposure (ExposureRequest), and a checksum of all the rest.
struct FrameStamp {
  std::uint64_t index = 0;
  double timeSeconds = 0;
};
// Nothing if one bit of the frame is not as it was sent.
std::optional<FrameStamp> readStamp(std::span<const std::uint8_t> bytes, PixelFormat format);

}  // namespace lightsketch
