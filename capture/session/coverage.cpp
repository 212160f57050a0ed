#include "capture/session/coverage.h"
