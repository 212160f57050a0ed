#include "capture/rig/simulated_rig.h"
