// A camera that can be let go of while it does not answer.
#pragma once

#include <memory>

#include "capture/device/camera.h"

namespace lightsketch {

// Every call to a camera that was unplugged blocks for seconds, closing it included. Here all calls
// are made, in their order, on a thread that owns the camera; whoever calls waits for a fraction of
// a second where nothing depends on the answer (setFeature, statistics, stop, destruction), and
// leaves the rest to that thread. No callback runs after stop() all the same.
std::unique_ptr<Camera> makeDetachable(std::unique_ptr<Camera> camera);

}  // namespace lightsketch
