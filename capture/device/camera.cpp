#include "capture/device/camera.h"
