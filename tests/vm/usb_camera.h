// A USB camera without hardware: a USB Video Class 1.1 device in this process, plugged into the
// kernel's virtual host controller (vhci_hcd, USB/IP), so that the real uvcvideo drives it.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "capture/frame/descriptor.h"
#include "capture/frame/frame.h"
#include "capture/frame/time.h"

namespace lightsketch {

// MJPG and YUYV of 320 x 240 and 640 x 480, MJPG alone also of 800 x 600, at 30, 15 or 5 frames/s;
// exposure, gain and white balance, each with an automatic that is on at first and overrules the
// control.
class UsbCamera {
 public:
  // What a frame shows: its number, and the exposure and gain that it was made with.
  struct Stamp {
    unsigned number;  // below kNumbers
    int level;        // of the flat field below the number
  };
  static constexpr unsigned kNumbers = 1 << 16;
  // Of frames made with the controls at these values.
  static int levelOf(double exposureSeconds, int gain);
  // Of a Mono8 or RGB8 frame.
  static Stamp read(const Frame& frame);

  UsbCamera() = default;
  ~UsbCamera() { unplug(); }
  // The device node, once the driver has made it; nothing if it does not.
  std::optional<std::string> plug();
  // Returns when the driver has noticed.
  void unplug();

  void sendFrames(bool send) { sends_ = send; }        // otherwise it answers requests only
  void answer(bool answer) { answers_ = answer; }      // otherwise it is frozen
  void markNextFrameBroken() { marksBroken_ = true; }  // by the header's error bit
  void cutNextFrame() { cuts_ = true; }                // the picture ends half-way, unmarked
  // As the driver has set it: "exposure", "gain", "temperature".
  int control(const std::string& name) const;

 private:
  struct Control {
    const char* name;
    std::uint8_t unit;
    std::uint8_t selector;
    std::size_t bytes;
    std::int32_t value, least, most, step, usual;
    const char* automatic;  // overrules it unless ...
    std::int32_t byHand;    // ... at this value
  };
  struct Wanted {  // a bulk request that waits for a part of a frame
    std::uint32_t sequence;
    std::uint32_t length;
  };
  using Bytes = std::vector<std::uint8_t>;

  void run(const std::stop_token& stop);
  bool serve();
  void answerControl(std::uint32_t sequence, const std::array<std::uint8_t, 8>& setup,
                     const Bytes& data);
  std::optional<Bytes> standardReply(std::uint8_t request, unsigned value) const;
  std::optional<Bytes> streamingReply(std::uint8_t request, unsigned selector, const Bytes& data);
  std::optional<Bytes> controlReply(std::uint8_t request, unsigned unit, unsigned selector,
                                    const Bytes& data);
  void reply(std::uint32_t sequence, std::int32_t status, const Bytes& data,
             std::optional<std::size_t> length = std::nullopt) const;
  void sendPending();
  void makeFrame();
  std::int32_t valueOf(const std::string& name) const;

  std::atomic<bool> sends_ = true;
  std::atomic<bool> answers_ = true;
  std::atomic<bool> marksBroken_ = false;
  std::atomic<bool> cuts_ = false;

  mutable std::mutex mutex_;  // Guards controls_.
  std::vector<Control> controls_;

  std::filesystem::path usb_;  // its folder in /sys; empty: not plugged in

  // The serving thread's own.
  Descriptor socket_;
  std::uint8_t format_ = 1;          // 1 MJPG, 2 YUYV
  std::uint8_t size_ = 1;            // from 1
  std::uint32_t interval_ = 333333;  // 100 ns
  bool streams_ = false;
  std::deque<Wanted> wanted_;
  Bytes frame_;
  std::size_t sent_ = 0;  // bytes of frame_; all of them: the next frame is to come
  bool broken_ = false;
  bool odd_ = false;
  unsigned number_ = 0;
  TimePoint next_;

  std::jthread thread_;
};

}  // namespace lightsketch
