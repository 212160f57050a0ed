#include "capture/tracker/lamp_tracker.h"
