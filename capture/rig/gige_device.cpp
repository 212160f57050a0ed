#include "capture/rig/gige_device.h"
