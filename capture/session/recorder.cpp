#include "capture/session/recorder.h"
