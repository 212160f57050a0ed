// Cameras that the kernel drives: USB cameras and frame grabbers, through V4L2.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "capture/device/camera.h"

namespace lightsketch {

// `target`: a device node or a link to one, "/dev/video0", "/dev/v4l/by-id/usb-...". With
// "?format=MJPG" only that format of the driver's is used; otherwise the deepest linear one is
// chosen here, and configure() takes what is best for the format that it is asked for.
//
// Regions are picture sizes: x and y are 0. A gain of 0 dB is the control's least value; others
// have no unit, so they are set by name. Features are the driver's controls, named as v4l2-ctl
// does ("exposure_time_absolute"); setting one switches the automatic off that would overrule it.
Result<std::unique_ptr<Camera>> openV4l2Camera(const std::string& target);

// The nodes that send pictures; of a camera's several nodes most send something else.
std::vector<CameraInfo> listV4l2Cameras();

}  // namespace lightsketch
