// When a V4L2 frame was exposed, from the driver's stamp.
#pragma once

#include "capture/frame/time.h"

namespace lightsketch {

// What a stamp tells. Drivers say it by flags; see V4l2Camera for the one that is wrong about it.
enum class V4l2Stamp {
  kExposureStart,
  kReadoutStart,  // the first byte has arrived
  kFrameEnd,      // the last has
  kNone,          // no clock of ours: the arrival is all there is
};

struct V4l2FrameTime {
  TimePoint exposureStart;
  Duration sigma;
};

// A stamp that cannot be true (after the arrival, or more than a second older than the frame can
// be: cleared, from another clock, jumped) counts as none. Readout and transfer take between
// nothing and a frame interval, unless the stamp was taken before them: half of it is taken off,
// with the sigma of a uniform distribution.
V4l2FrameTime v4l2FrameTime(V4l2Stamp kind, TimePoint stamp, TimePoint arrival, Duration exposure,
                            Duration frameInterval);

}  // namespace lightsketch
